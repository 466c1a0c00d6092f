//! What a study compares with: its reference, and images of others.

use super::Files;
use super::measure::Bench;
use super::others::{Noise, PeerImage};
use super::plan::Settings;
use super::record::{Errors, NoiseSource, Peer, Reference, Study};
use crate::image::subject::Subject;
use crate::image::{ImageKind, Picture, Region, exr, load};
use crate::lab::reference::{self, Start};
use crate::run::{Job, hex};
use crate::scene::Scene;
use crate::{Error, Result};
use std::path::Path;

/// What a reference is looked at with.
pub fn exposure(scene: &Scene, reference: &Path) -> Result<f32> {
    Ok(load::exposure_of(reference)?.unwrap_or(scene.film.exposure))
}

/// The image that all are compared with.
pub struct Target {
    /// The image.
    pub picture: Picture,
    /// What is known of it.
    pub about: Reference,
}

impl Target {
    /// Reads it, and refuses an image of something else as far as it tells what it shows.
    pub fn read(path: &Path, scene: &Scene, settings: &Settings, job: &Job) -> Result<Self> {
        let frame = exr::read(path)?;
        let (width, height) = (scene.film.width, scene.film.height);
        let refused = |what: String| Error::input(what).at(path.display());
        if (frame.width, frame.height) != (width, height) {
            return Err(refused(format!(
                "the reference has {}x{} pixels, the scene {width}x{height}",
                frame.width, frame.height
            )));
        }
        let camera = scene.camera(settings.camera.as_deref())?;
        let here = Subject {
            scene: Some(hex(&scene.hash)),
            camera: Some(camera.name.clone()),
            segments: Some(settings.max_depth),
        };
        let differences = Subject::of(&frame.attributes).differences(&here);
        if !differences.is_empty() {
            return Err(refused(format!(
                "the reference shows something else than the study (the former first): {}",
                differences.join("; ")
            ))
            .hint(format!(
                "render one of this scene and camera: lvox reference `max_depth` {}",
                settings.max_depth
            )));
        }
        let region = Region::full(width, height);
        let picture = frame
            .picture("", &region)
            .map_err(|e| e.at(path.display()))?;
        let broken = picture.non_finite();
        if broken > 0 {
            job.progress.warn(&format!(
                "{}: {broken} pixels are infinite or not a number",
                path.display()
            ));
        }
        let name = path.file_name().unwrap_or(path.as_os_str());
        let about = Reference {
            source: name.to_string_lossy().into_owned(),
            relmse: frame
                .picture("variance", &region)
                .ok()
                .map(|v| reference::expected_relmse(&picture.pixels, &v.pixels))
                // A single sequence of samples tells no variance.
                .filter(|v| v.is_finite()),
            exposure: exposure(scene, path)?,
            noise: NoiseSource::Variance,
        };
        Ok(Self { picture, about })
    }
}

/// Renders the reference that was not given, or goes on with it.
pub fn render_reference(bench: &Bench, files: &Files, start: Start, job: &Job) -> Result<Target> {
    let (scene, settings) = (bench.scene, bench.settings);
    let path = files.reference();
    let monte_carlo = reference::Settings {
        camera: settings.camera.clone(),
        max_depth: settings.max_depth,
        spp: Some(settings.reference_spp),
        seed: settings.seed,
        ..reference::Settings::default()
    };
    reference::run(scene, &monte_carlo, bench.region(), &path, start, job)?;
    let mut target = Target::read(&path, scene, settings, job)?;
    job.heed_warnings()?;
    let spp = settings.reference_spp;
    target.about.source = format!("path tracing with {spp} samples per pixel");
    Ok(target)
}

/// Images of others, read before the work: those of other renderers, and a second reference.
pub struct Others {
    /// The reference that was given.
    pub reference: Option<Target>,
    peers: Vec<(Peer, Picture)>,
    second: Option<Picture>,
    given: Option<f64>,
}

impl Others {
    /// Reads them.
    ///
    /// # Errors
    /// What is no image of radiance of as many pixels as the scene has.
    pub fn read(scene: &Scene, settings: &Settings, reference: Option<Target>) -> Result<Self> {
        let film = Region::full(scene.film.width, scene.film.height);
        let read = |path: &Path| {
            // Values of eight bits are no radiance.
            if matches!(ImageKind::of(path)?, Some(ImageKind::Png)) {
                let what = format!("{}: expected radiance, found a PNG file", path.display());
                return Err(Error::input(what).hint("take the .exr or .npy of it"));
            }
            let picture = load::picture(path, "", scene.film.exposure, None)?;
            let [width, height] = [picture.width, picture.height];
            if [width as u32, height as u32] != [film.width(), film.height()] {
                return Err(Error::input(format!(
                    "{}: expected {}x{} pixels, as the scene has, found {width}x{height}",
                    path.display(),
                    film.width(),
                    film.height()
                )));
            }
            Ok(picture)
        };
        let peer = |image: &PeerImage| {
            let name = image.path.file_name().unwrap_or(image.path.as_os_str());
            let peer = Peer {
                name: image.name.clone(),
                cpu_secs: image.cpu_secs,
                errors: Errors::default(),
                source: name.to_string_lossy().into_owned(),
            };
            Ok((peer, read(&image.path)?))
        };
        let (second, given) = match &settings.reference_noise {
            None => (None, None),
            Some(Noise::Given(value)) => (None, Some(*value)),
            Some(Noise::Image(path)) => (Some(read(path)?), None),
        };
        Ok(Self {
            reference,
            peers: settings
                .peer_images
                .iter()
                .map(peer)
                .collect::<Result<_>>()?,
            second,
            given,
        })
    }

    /// Compares them with the reference.
    pub fn judge(self, study: &mut Study, target: &Picture, bench: &Bench) -> Result<()> {
        let exposure = study.reference.exposure;
        for (mut peer, picture) in self.peers {
            peer.errors = bench.judge(&picture, target, exposure)?.0;
            study.peers.push(peer);
        }
        if let Some(second) = self.second {
            let (errors, _) = bench.judge(&second, target, exposure)?;
            // Each of the two is as far from the truth.
            study.reference.relmse = errors.relmse.map(|v| 0.5 * v);
            study.reference.noise = NoiseSource::Image;
        }
        if let Some(given) = self.given {
            study.reference.relmse = Some(given);
            study.reference.noise = NoiseSource::Given;
        }
        Ok(())
    }
}

//! scene → image by unbiased Monte Carlo path tracing: what the point-based pipeline is judged by.
//!
//! It shares scene and tracing code with the pipeline and nothing else. Every sample is a pure
//! function of the scene, the settings, the pixel and the sample's number; sums are taken in that
//! order, so images do not depend on tiles, threads or interruptions.

mod flight;
mod path;
mod sample;
mod sampler;
mod sky;
mod sources;
pub mod sums;

pub use path::PathTracer;
pub use sampler::Sampler;
pub use sums::Sums;

use crate::image::exr::{self, Precision};
use crate::image::metrics::linear::RELATIVE_FLOOR;
use crate::image::mix::GROUP;
use crate::image::samples::{Origin, Row};
use crate::image::{COLOR_SPACE, CameraMatrices, Frame, ImageKind, Onlooker, Region, npy};
use crate::math::{Rgb, sampling};
use crate::run::{Budget, Job, Task, hex, memory};
use crate::scene::{Camera, CameraRay, Film, Scene};
use crate::trace::Tracer;
use crate::{Error, Kind, Result};
use rayon::prelude::*;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Digest of the sources that samples come from. Samples may go on in any build of the same
/// sources, since compilers change no more than the last digit; images kept for hours of work would
/// be lost with every build otherwise.
const CODE: &str = env!("LVOX_PATH_TRACER");

/// How to render.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// Name of the camera; the scene's first if `None`.
    pub camera: Option<String>,
    /// Most segments of a path from camera to light: 1 is emission seen directly, 2 adds direct
    /// light, 3 one bounce of indirect light off a surface or inside a medium; 0 has no limit.
    pub max_depth: u32,
    /// Samples of each pixel; no limit if `None`.
    pub spp: Option<u32>,
    /// Wall-clock seconds of this run, loading excluded; no limit if `None`.
    pub secs: Option<f64>,
    /// Independent sequences that the samples of a pixel go to in turn. Their spread tells the
    /// variance; with 1 there is the least noise (relMSE 1.35 to 1.6 times lower than with 4 at 16
    /// to 64 samples) but no word on how much.
    pub strands: u32,
    /// Key of all random choices.
    pub seed: u64,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            camera: None,
            max_depth: 0,
            spp: Some(64),
            secs: None,
            strands: 4,
            seed: 0,
        }
    }
}

/// Whether a run goes on from what earlier ones have kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Start {
    /// It does, and adds to that.
    Resume,
    /// What is kept is replaced.
    Afresh,
}

/// Time after which sums are saved, against the loss of the machine.
const SAVE_EVERY: Duration = Duration::from_secs(300);

/// Time after which what there is may be shown: to make a picture of sums takes much less.
const SHOW_EVERY: Duration = Duration::from_secs(2);

/// Time after which a pass should end: short enough for a deadline, long enough for caches.
const PASS: Duration = Duration::from_millis(500);

impl Settings {
    /// Refuses settings that make no sense.
    ///
    /// # Errors
    /// Names the setting, what it may be and what it was.
    pub fn check(&self) -> Result<()> {
        if self.spp == Some(0) {
            return Err(Error::input("`spp` must be at least 1"));
        }
        if !(1..=64).contains(&self.strands) {
            return Err(Error::input(format!(
                "`strands` must be 1 to 64, found {}",
                self.strands
            )));
        }
        match self.secs {
            Some(s) if !(s > 0.0 && s <= 1e9) => Err(Error::input(format!(
                "`time` must be more than 0 and at most 1e9 seconds, found {s}"
            ))),
            None if self.spp.is_none() => Err(Error::input("neither `spp` nor `time` was given")),
            _ => Ok(()),
        }
    }

    /// What tells samples of different runs apart: all that pixels depend on but their number of
    /// samples.
    fn origin(&self, scene: &Scene) -> Result<Origin> {
        let camera = &scene.camera(self.camera.as_deref())?.name;
        let settings = [
            ("method", "path tracing".into()),
            ("camera", camera.as_str().into()),
            ("max_depth", self.max_depth.into()),
            ("strands", self.strands.into()),
            ("seed", self.seed.into()),
        ];
        let frame = scene.frame.map(|frame| ("frame", frame.into()));
        Ok(Origin {
            code: CODE.into(),
            scene: hex(&scene.hash),
            film: [scene.film.width, scene.film.height],
            settings: (settings.into_iter().chain(frame))
                .map(|(name, v)| (name.to_owned(), v))
                .collect(),
        })
    }
}

/// Where the sums of an image are kept: `image.exr` has its own in `image.exr.sums`.
#[must_use]
pub fn sums_path(image: &Path) -> PathBuf {
    let mut name = image.as_os_str().to_owned();
    name.push(".sums");
    name.into()
}

/// Refuses what [`run`] would refuse before its first sample. Returns the bytes that it holds.
///
/// # Errors
/// As [`begin`].
pub fn check_memory(scene: &Scene, settings: &Settings, region: Region, job: &Job) -> Result<u64> {
    begin(scene, settings, region, job)?;
    Ok(budget(scene, settings, region, job).bytes())
}

fn budget(scene: &Scene, settings: &Settings, region: Region, job: &Job) -> Budget {
    (scene.budget(scene.bytes_of_grids(), job))
        .with("what rays need of it", Tracer::bytes_for(scene))
        .with("sums of samples", Sums::bytes(&region, settings.strands))
}

/// No samples yet, for these settings.
///
/// # Errors
/// A setting out of range, a region outside the frame, or sums beyond the memory limit or what the
/// machine has.
pub fn begin(scene: &Scene, settings: &Settings, region: Region, job: &Job) -> Result<Sums> {
    settings.check()?;
    let origin = settings.origin(scene)?;
    region.check(scene.film.width, scene.film.height)?;
    let what = format_args!("summing samples of {} pixels", region.pixels());
    budget(scene, settings, region, job).within(
        what,
        job.memory_limit,
        "raise `memory_limit`, or render a part: `region` X0 Y0 X1 Y1",
    )?;
    let needed = Sums::bytes(&region, settings.strands);
    memory::check(what, needed).map_err(|e| {
        e.hint("render a part: `region` X0 Y0 X1 Y1; or a smaller film: `resolution` WxH")
    })?;
    Ok(Sums::new(region, settings.strands, origin))
}

/// Renders into an OpenEXR or NumPy file of 32-bit floats, with the variance of each pixel's mean
/// in the layer `variance`. Sums are kept beside it ([`sums_path`]); a later run with more samples
/// or time goes on from there, with the same result as one run would have had; [`Start::Afresh`]
/// replaces them. On a stop what is there is written before the error is returned; an image only if
/// every pixel has a sample.
///
/// # Errors
/// A setting out of range, kept sums of other settings, an output that cannot be written, or a stop
/// on request.
pub fn run(
    scene: &Scene,
    settings: &Settings,
    region: Region,
    image: &Path,
    start: Start,
    job: &Job,
) -> Result<()> {
    run_before(scene, settings, region, image, start, None, job)
}

/// The same before one who looks on, and sees the whole region every few seconds and at the end.
///
/// # Errors
/// As [`run`].
pub fn run_before(
    scene: &Scene,
    settings: &Settings,
    region: Region,
    image: &Path,
    start: Start,
    onlooker: Option<&dyn Onlooker>,
    job: &Job,
) -> Result<()> {
    let mut sums = begin(scene, settings, region, job)?;
    let kept = sums_path(image);
    if start == Start::Resume
        && let Some(found) = Sums::read(&kept, &sums)?
    {
        sums = found;
        tell_of_kept(&sums, settings, &kept, job);
    }
    job.heed_warnings()?;
    // Before every pixel has a sample there is no image, and what is kept of earlier runs is worth
    // more.
    let save = |sums: &Sums| -> Result<()> {
        let is_whole = sums.counts().0 > 0;
        if is_whole || start == Start::Resume {
            sums.write(&kept)?;
        }
        if is_whole {
            let frame = frame(scene, sums);
            if let Some(found) = frame.not_finite() {
                job.progress.warn(&format!("{}: {found}", image.display()));
            }
            match ImageKind::named(image)? {
                ImageKind::Npy => npy::write(image, &frame)?,
                _ => exr::write(image, &frame, Precision::Float)?,
            }
        }
        Ok(())
    };
    job.stage("reference", |counts| {
        let before = sums.samples();
        let started = Instant::now();
        let seen = |sums: &Sums| {
            if let Some(onlooker) = onlooker {
                let (means, _) = sums.estimates();
                let plane = |c: usize| means.iter().map(|mean| mean[c]).collect();
                onlooker.see(sums.region, &[0, 1, 2].map(plane));
            }
        };
        let saved = &mut |s: &Sums| save(s);
        let result = accumulate_before(scene, settings, &mut sums, job, saved, &seen);
        seen(&sums);
        let secs = started.elapsed().as_secs_f64();
        let samples = sums.samples() - before;
        let (least, most) = sums.counts();
        counts.insert("samples".into(), samples as f64);
        counts.insert("samples_per_sec".into(), samples as f64 / secs.max(1e-9));
        counts.insert("spp_min".into(), f64::from(least));
        counts.insert("spp_max".into(), f64::from(most));
        counts.insert("relmse_estimate".into(), relmse(&sums));
        match result {
            Err(e) if e.kind() != Kind::Cancelled => Err(e),
            stopped => {
                save(&sums)?;
                stopped.map_err(|e| match (least, start) {
                    (0, Start::Afresh) => {
                        e.hint("nothing was replaced: some pixels have no sample yet")
                    }
                    _ => e.hint(format!(
                        "{least} to {most} samples per pixel are kept; the same command goes on"
                    )),
                })
            }
        }
    })
}

/// Says what a run that goes on begins with.
fn tell_of_kept(sums: &Sums, settings: &Settings, kept: &Path, job: &Job) {
    let (least, most) = sums.counts();
    job.progress
        .say(&format!("going on from {least} samples per pixel"));
    if let Some(spp) = settings.spp.filter(|&spp| spp < most) {
        job.progress.warn(&format!(
            "{} keeps {most} samples per pixel, more than `spp` {spp}, and the image has them \
             all; `overwrite` begins anew",
            kept.display()
        ));
    }
    warn_of_not_finite(sums, job);
}

/// The image of sums.
#[must_use]
pub fn frame(scene: &Scene, sums: &Sums) -> Frame {
    let mut frame = sums.frame(scene.film.width, scene.film.height);
    let (least, most) = sums.counts();
    let spp = if least == most {
        least.to_string()
    } else {
        format!("{least} to {most}")
    };
    for (name, value) in [
        ("version", env!("CARGO_PKG_VERSION").into()),
        ("exposure", scene.film.exposure.to_string()),
        ("scene", sums.origin.scene.clone()),
        ("settings", sums.origin.settings_json()),
        ("spp", spp),
    ] {
        frame.attributes.insert(format!("lvox/{name}"), value);
    }
    if let Some(group) = &scene.group {
        frame.attributes.insert(GROUP.into(), group.clone());
    }
    let [name, value] = COLOR_SPACE.map(str::to_owned);
    frame.attributes.insert(name, value);
    let camera = sums.origin.settings.get("camera");
    let camera = camera.and_then(|name| scene.camera(name.as_str()).ok());
    frame.camera = camera.map(|camera| {
        let [world_to_camera, world_to_ndc] = camera.matrices(&scene.film, scene.world_from_scene);
        CameraMatrices {
            world_to_camera,
            world_to_ndc,
        }
    });
    frame
}

/// The relMSE that is expected against the truth.
#[must_use]
pub fn relmse(sums: &Sums) -> f64 {
    let (means, variances) = sums.estimates();
    expected_relmse(&means, &variances)
}

/// Mean over pixels and channels of variance / (mean^2 + floor), with the floor of the metric,
/// 0.01.
#[must_use]
pub fn expected_relmse(means: &[[f32; 3]], variances: &[[f32; 3]]) -> f64 {
    let terms = means.as_flattened().iter().zip(variances.as_flattened());
    let sum: f64 = terms
        .map(|(&m, &v)| f64::from(v) / (f64::from(m).powi(2) + RELATIVE_FLOOR))
        .sum();
    sum / (3 * means.len()) as f64
}

/// Adds samples until there are `settings.spp` in every pixel or `settings.secs` are over; at least
/// one in every pixel. `save` is called now and then.
///
/// # Errors
/// A stop on request, or what `save` gives; the sums hold whole rows then as always.
pub fn accumulate(
    scene: &Scene,
    settings: &Settings,
    sums: &mut Sums,
    job: &Job,
    save: &mut dyn FnMut(&Sums) -> Result<()>,
) -> Result<()> {
    accumulate_before(scene, settings, sums, job, save, &|_| ())
}

/// The same, and shows sums to one who looks on.
fn accumulate_before(
    scene: &Scene,
    settings: &Settings,
    sums: &mut Sums,
    job: &Job,
    save: &mut dyn FnMut(&Sums) -> Result<()>,
    show: &dyn Fn(&Sums),
) -> Result<()> {
    let started = Instant::now();
    let deadline = settings
        .secs
        .map(|secs| started + Duration::from_secs_f64(secs));
    let paths = PathTracer::new(scene, settings.max_depth, &job.cancel)?;
    let camera = scene.camera(settings.camera.as_deref())?;
    let strands = sums.strands;
    let target = settings.spp.unwrap_or(u32::MAX);
    let not_finite_before = sums.not_finite();
    let region = sums.region;
    let goal = settings.spp.map_or(0, |spp| {
        (region.pixels() as u64 * u64::from(spp)).saturating_sub(sums.samples())
    });
    let task = job.progress.task("reference", goal, "samples");
    let sample = |x: u32, y: u32, i: u32| {
        let strand = i % strands;
        let key = sampling::hash(&[settings.seed, u64::from(x), u64::from(y), u64::from(strand)]);
        let mut sampler = Sampler::new(key, i / strands);
        let ray = camera_ray(camera, &scene.film, [x as f32, y as f32], &mut sampler);
        paths.radiance(ray.origin, ray.direction, &mut sampler)
    };
    let add = |row: &mut Row, spp: u32, task: &Task| {
        let end = (row.count.saturating_add(spp)).min(target);
        if row.count >= end {
            return;
        }
        let pixels = row.sums.chunks_exact_mut(strands as usize);
        for (x, pixel) in (region.x0..region.x1).zip(pixels) {
            for i in row.count..end {
                let Rgb(light) = sample(x, row.y, i);
                if light.iter().all(|v| v.is_finite()) {
                    let sum = &mut pixel[(i % strands) as usize];
                    *sum = [0, 1, 2].map(|c| sum[c] + f64::from(light[c]));
                } else {
                    row.not_finite = row.not_finite.saturating_add(1);
                }
            }
        }
        task.add(u64::from(region.width()) * u64::from(end - row.count));
        row.count = end;
    };
    let (mut saved, mut shown) = (Instant::now(), Instant::now());
    let mut spp = 1_u32;
    loop {
        let (least, _) = sums.counts();
        let late = || least > 0 && deadline.is_some_and(|d| Instant::now() >= d);
        if least >= target || late() {
            break;
        }
        let pass = Instant::now();
        // Rows that an interruption left behind catch up first.
        sums.rows.par_iter_mut().try_for_each(|row| {
            job.cancel.check()?;
            if !late() {
                let ahead = row.count - least;
                add(row, spp.saturating_sub(ahead), &task);
            }
            Ok::<(), Error>(())
        })?;
        scene.check_file()?;
        if saved.elapsed() > SAVE_EVERY {
            save(sums)?;
            saved = Instant::now();
        }
        if shown.elapsed() > SHOW_EVERY {
            show(sums);
            shown = Instant::now();
        }
        spp = spp_of_next_pass(spp, pass.elapsed());
    }
    if sums.not_finite() > not_finite_before {
        warn_of_not_finite(sums, job);
    }
    Ok(())
}

/// A ray through a pixel, of the film's top left corner: at a point of its square, of the lens, and
/// at a moment.
pub fn camera_ray(
    camera: &Camera,
    film: &Film,
    [x, y]: [f32; 2],
    sampler: &mut Sampler,
) -> CameraRay {
    let [u, v, on_lens @ ..] = sampler.next4();
    let at = [x + u, y + v];
    if camera.is_pinhole() {
        let (origin, direction) = (camera.origin(), camera.direction(film, at[0], at[1]));
        return CameraRay { origin, direction };
    }
    let time = match camera.path.is_empty() {
        true => 0.0,
        false => sampler.next4()[0],
    };
    camera.ray(film, at, on_lens, time)
}

/// More samples where a pass was short, fewer where it was long.
fn spp_of_next_pass(spp: u32, took: Duration) -> u32 {
    if took < PASS / 2 {
        spp * 2
    } else if took > PASS * 2 {
        (spp / 2).max(1)
    } else {
        spp
    }
}

/// Of all samples there are, not of those of this run alone: the image has them all.
fn warn_of_not_finite(sums: &Sums, job: &Job) {
    let n = sums.not_finite();
    if n > 0 {
        job.progress.warn(&format!(
            "{n} samples were infinite or not a number and count as black"
        ));
    }
}

#[cfg(test)]
mod tests;

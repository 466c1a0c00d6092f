//! Options of shading, and of the image it makes, for the verbs that shade.

use super::files::{Files, check_writable};
use super::parse;
use super::region_options::RegionOptions;
use crate::formats::Overwrite;
use crate::image::exr::{self, Precision};
use crate::image::{Frame, ImageKind, png, tone};
use crate::lab::tune::{self, Outcome};
use crate::run::Job;
use crate::scene::Scene;
use crate::shade::{self, Aov, Kernel, Method, Quality, Settings};
use crate::tree::OpenTree;
use crate::{Error, Result};
use clap::Args;
use std::path::PathBuf;

/// How to shade, as typed.
#[derive(Debug, Args)]
#[command(next_help_heading = "Shading")]
pub struct ShadeOptions {
    /// Write the image to this .exr or .png file
    #[arg(short, long, value_name = "FILE", help_heading = None)]
    output: PathBuf,

    /// Look through this camera of the scene [default: its first]
    #[arg(long, value_name = "NAME")]
    camera: Option<String>,

    /// Start from these settings, which the options below override one by one
    #[arg(long, value_name = "PRESET", default_value = "good", value_parser = parse::one_of(&Quality::ALL))]
    quality: Quality,

    /// Pick the cheapest settings whose error is about E: trimmed relMSE against the truth, as
    /// `lvox compare` prints it; those given by options below are kept. Tiles and processes pick
    /// the same
    #[arg(long, value_name = "E", conflicts_with = "quality")]
    target_error: Option<f64>,

    /// Rays of each gather on a surface; half as many where the lattice had none to spread
    /// [default: 24, 40, 64 by quality]
    #[arg(long, value_name = "N")]
    samples: Option<u32>,

    /// Take a node whole where it is seen under less than this, steradians, half of that in frames
    /// with bright patches, four times that by rays of media; 0 for as fine as surfels are.
    /// --kernel plain takes none [default: 0.02, 0.02, 0.01 by quality]
    #[arg(long, value_name = "SR")]
    max_solid_angle: Option<f32>,

    /// Tell light that comes from near by apart in patches as large as so many surfels; 32 or more
    /// need no more of the tree than its nodes, and blur contacts. Fewer in frames of more than
    /// 8192 gathers. No matter with --kernel cone and plain [default: 32, 1, 1 by quality]
    #[arg(long, value_name = "N")]
    patch_surfels: Option<u32>,

    /// Let nothing further away than this send indirect light, scene units; walls and media beyond
    /// it still hide the environment, which is seen where nothing is [default: no limit]
    #[arg(long, value_name = "D")]
    max_dist: Option<f32>,

    /// What ends gather rays: the scene's own triangles, which send what the tree says (traced);
    /// surfels and nodes of the tree (cone); or surfels alone, as in the paper (plain)
    #[arg(long, value_name = "KERNEL", default_value = "traced", value_parser = parse::one_of(&Kernel::ALL))]
    kernel: Kernel,

    /// Let all take part in indirect light (extended), or surfels alone, as before media were in
    /// the cloud
    #[arg(long, value_name = "METHOD", default_value = "extended", value_parser = parse::one_of(&Method::ALL))]
    method: Method,

    /// Leave it to chance which gather rays meet the few places that send most of a frame's light,
    /// as where the sun falls into a room; else, if there are such, a fifth as many rays go to
    /// them, and two fifths fewer elsewhere
    #[arg(long)]
    no_bright_patches: bool,

    /// Pixels between gathers on surfaces, with others between those where light may change within
    /// that; 1 gathers at every pixel [default: 6, 4, 3 by quality]
    #[arg(long, value_name = "N")]
    lattice: Option<u32>,

    /// Rays of each gather inside media; none with --method traditional [default: 3, 6, 16 by
    /// quality]
    #[arg(long, value_name = "N")]
    volume_samples: Option<u32>,

    /// Primary rays a pixel; 1 for rays through the corners of pixels, which neighbours share
    /// [default: 1]
    #[arg(long, value_name = "N")]
    pixel_samples: Option<u32>,

    /// Corners of pixels from one primary ray to the next where those around end on one triangle, 1
    /// or 2; 2 may miss what is thinner than two pixels. No matter with --pixel-samples above 1
    /// [default: 2, 1, 1 by quality]
    #[arg(long, value_name = "N")]
    corner_spacing: Option<u32>,

    /// Primary rays inside a pixel whose corners disagree, beside those; with --pixel-samples above
    /// 1, all of a pixel where its first ones disagree [default: 6, 16, 48 by quality]
    #[arg(long, value_name = "N")]
    edge_samples: Option<u32>,

    /// Shadow rays to each area light from the end of each primary ray inside a pixel, those of
    /// --edge-samples and of --pixel-samples above 1; corners that pixels share take one, and four
    /// in penumbrae [default: 1]
    #[arg(long, value_name = "N")]
    shadow_rays: Option<u32>,

    #[command(flatten)]
    region: RegionOptions,

    /// Add these layers to an .exr image
    #[arg(long, value_name = "LAYER", value_delimiter = ',', value_parser = parse::one_of(&Aov::ALL))]
    aov: Vec<Aov>,

    /// Store 32-bit instead of 16-bit floats in an .exr image
    #[arg(long)]
    float: bool,
}

impl ShadeOptions {
    /// Adds what it writes.
    pub fn files(&self, files: Files) -> Files {
        files.writes("--output", &self.output)
    }

    /// Fails now rather than after the work.
    pub fn check(&self) -> Result<()> {
        let is_png = ImageKind::named(&self.output)? == ImageKind::Png;
        for (option, given) in [("--aov", !self.aov.is_empty()), ("--float", self.float)] {
            if is_png && given {
                return Err(Error::input(format!(
                    "{option} needs an .exr image, found --output {}",
                    self.output.display()
                ))
                .hint("name the output .exr, or leave the option out"));
            }
        }
        check_writable(&self.output, Overwrite::Replace)?;
        if let Some(target) = self.target_error {
            tune::check(target)?;
        }
        self.settings(0).check()
    }

    fn uses_nodes(&self) -> bool {
        !matches!(self.kernel, Kernel::Plain)
    }

    fn lights_media(&self) -> bool {
        matches!(self.method, Method::Extended)
    }

    /// The same for what depends on the scene.
    pub fn check_with(&self, scene: &Scene, job: &Job) -> Result<()> {
        scene.camera(self.camera.as_deref())?;
        let region = self.region.of(&scene.film)?;
        let mut settings = self.settings(0);
        if self.target_error.is_some() && self.lattice.is_none() {
            // What will be picked is not known yet.
            settings.lattice = Settings::COARSEST_LATTICE;
        }
        shade::check_memory(scene, &settings, region, &self.aov, job)
    }

    fn settings(&self, seed: u64) -> Settings {
        self.over(Settings::of(self.quality), seed)
    }

    /// Settings with what was given one by one.
    fn over(&self, preset: Settings, seed: u64) -> Settings {
        Settings {
            camera: self.camera.clone(),
            samples: self.samples.unwrap_or(preset.samples),
            max_solid_angle: self.max_solid_angle.unwrap_or(preset.max_solid_angle),
            patch_surfels: self.patch_surfels.unwrap_or(preset.patch_surfels),
            max_dist: self.max_dist,
            kernel: self.kernel,
            method: self.method,
            bright_patches: !self.no_bright_patches,
            lattice: self.lattice.unwrap_or(preset.lattice),
            volume_samples: self.volume_samples.unwrap_or(preset.volume_samples),
            pixel_samples: self.pixel_samples.unwrap_or(preset.pixel_samples),
            corner_spacing: self.corner_spacing.unwrap_or(preset.corner_spacing),
            edge_samples: self.edge_samples.unwrap_or(preset.edge_samples),
            shadow_rays: self.shadow_rays.unwrap_or(preset.shadow_rays),
            seed,
        }
    }

    /// Picks settings for an error, and says which.
    fn pick(
        &self,
        target: f64,
        scene: &Scene,
        store: &OpenTree,
        seed: u64,
        job: &Job,
    ) -> Result<Settings> {
        let choice = tune::choose(scene, store, target, |rung| self.over(rung, seed), job)?;
        let (s, expected) = (choice.settings, choice.expected);
        let mut options = format!("--samples {}", s.samples);
        if self.uses_nodes() {
            options += &format!(" --max-solid-angle {}", s.max_solid_angle);
        }
        if matches!(self.kernel, Kernel::Traced) {
            options += &format!(" --patch-surfels {}", s.patch_surfels);
        }
        options += &format!(" --lattice {}", s.lattice);
        if self.lights_media() {
            options += &format!(" --volume-samples {}", s.volume_samples);
        }
        job.progress.say(&format!(
            "target error {target:.1e}: shading with {options} --pixel-samples {} --corner-spacing {} \
             --edge-samples {} --shadow-rays {}, expected error {expected:.1e}",
            s.pixel_samples, s.corner_spacing, s.edge_samples, s.shadow_rays,
        ));
        match choice.outcome {
            Outcome::OutOfReach => job.progress.warn(&format!(
                "the target error {target:.1e} is out of reach of sampling: about {expected:.1e} is what to expect. The \
                 rest is bias of the tree and of interpolation; a tree with more --surfels may have less"
            )),
            Outcome::Better => job.progress.say(&format!(
                "the coarsest settings are expected to have less error than {target:.1e}"
            )),
            Outcome::Met => {}
        }
        Ok(s)
    }

    /// Shades and writes the image.
    pub fn run(&self, scene: &Scene, store: &OpenTree, seed: u64, job: &Job) -> Result<()> {
        let region = self.region.of(&scene.film)?;
        let settings = match self.target_error {
            Some(target) => self.pick(target, scene, store, seed, job)?,
            None => self.settings(seed),
        };
        job.heed_warnings()?;
        let frame = shade::run(scene, store, &settings, region, &self.aov, job)?;
        job.report
            .stage("write", |_| match ImageKind::named(&self.output)? {
                ImageKind::Exr => {
                    let precision = if self.float {
                        Precision::Float
                    } else {
                        Precision::Half
                    };
                    self.warn_of_clamped(&frame, precision, job);
                    job.heed_warnings()?;
                    exr::write(&self.output, &frame, precision)
                }
                ImageKind::Png => {
                    let picture = frame.picture("", &frame.region)?;
                    png::write(&self.output, &tone::map(&picture, scene.film.exposure))
                }
            })
    }

    /// Says what halves could not hold.
    fn warn_of_clamped(&self, frame: &Frame, precision: Precision, job: &Job) {
        let clamped = exr::clamped(frame, precision);
        if clamped.samples > 0 {
            job.progress.warn(&format!(
                "{}: {} samples in {} channels ({}) are beyond 65504, the largest 16-bit float, and are stored as that; \
                 use --float to keep them",
                self.output.display(),
                clamped.samples,
                clamped.channels.len(),
                clamped.channels.join(", ")
            ));
        }
    }
}

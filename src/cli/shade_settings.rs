//! Options of how to shade, for the verbs that shade or look at what shading takes.

use super::parse;
use crate::Result;
use crate::lab::tune::{self, Outcome};
use crate::run::Job;
use crate::scene::Scene;
use crate::shade::{Kernel, Method, Quality, Settings};
use crate::tree::OpenTree;
use clap::Args;

/// How to shade, as typed.
#[derive(Clone, Debug, Args)]
#[command(next_help_heading = "Shading")]
pub struct ShadeSettings {
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

    /// Cast this many rays in each gather of indirect light on a surface, and half as many in the
    /// gathers that fill gaps between others [default: 24, 40, 64 by quality]
    #[arg(long, value_name = "N")]
    samples: Option<u32>,

    /// Let a node of the tree stand for all surfels below it where it is seen under less than this
    /// solid angle, in steradians, and a cube of lvoxels under a quarter of it. Smaller is slower
    /// and sharper; 0 uses single surfels and lvoxels. Frames with bright patches use half of it,
    /// rays of media four times [default: 0.02, 0.02, 0.01 by quality]
    #[arg(long, value_name = "SR")]
    max_solid_angle: Option<f32>,

    /// Average the light that surfaces send over patches as large as this many surfels. Fewer keep
    /// contacts between surfaces sharper; 32 or more are fastest, as they need the nodes of the
    /// tree alone. Only with --kernel traced [default: 32, 1, 1 by quality]
    #[arg(long, value_name = "N")]
    patch_surfels: Option<u32>,

    /// Ignore indirect light from farther away than this, in scene units. What is farther still
    /// hides the environment [default: no limit]
    #[arg(long, value_name = "D")]
    max_dist: Option<f32>,

    /// How the surface at the end of a gather ray is found: by the scene's own triangles, with the
    /// light that the tree holds for them (traced); by surfels and nodes of the tree (cone); or by
    /// surfels alone, as in the paper (plain)
    #[arg(long, value_name = "KERNEL", default_value = "traced", value_parser = parse::one_of(&Kernel::ALL))]
    kernel: Kernel,

    /// Take indirect light from surfaces and media (extended), or from surfaces alone, as before
    /// media were in the cloud (traditional)
    #[arg(long, value_name = "METHOD", default_value = "extended", value_parser = parse::one_of(&Method::ALL))]
    method: Method,

    /// Do not send extra gather rays to the few places that send most of a frame's light, such as
    /// where the sun falls into a room. Without them such light is found by chance, with more noise
    #[arg(long)]
    no_bright_patches: bool,

    /// Gather on surfaces at every Nth pixel across and down, with more gathers where light may
    /// change between those; 1 gathers at every pixel [default: 6, 4, 3 by quality]
    #[arg(long, value_name = "N")]
    lattice: Option<u32>,

    /// Cast this many rays in each gather inside media; none are cast with --method traditional
    /// [default: 3, 6, 16 by quality]
    #[arg(long, value_name = "N")]
    volume_samples: Option<u32>,

    /// Cast this many camera rays through each pixel; 1 casts them through the corners of pixels,
    /// which neighbours share [default: 1]
    #[arg(long, value_name = "N")]
    pixel_samples: Option<u32>,

    /// Cast a camera ray at every corner of a pixel (1), or at every second one where those around
    /// see the same triangle (2); 2 may miss what is thinner than two pixels. Only without
    /// --pixel-samples above 1 [default: 2, 1, 1 by quality]
    #[arg(long, value_name = "N")]
    corner_spacing: Option<u32>,

    /// Cast this many camera rays more in pixels whose corners differ, three times as many where
    /// masks cut surfaces out. With --pixel-samples above 1, cast this many in all where the first
    /// ones differ [default: 6, 16, 48 by quality]
    #[arg(long, value_name = "N")]
    edge_samples: Option<u32>,

    /// Cast this many shadow rays to each area light for every camera ray inside a pixel (those of
    /// --edge-samples, and of --pixel-samples above 1). Corners of pixels cast one, and four in
    /// penumbrae [default: 1]
    #[arg(long, value_name = "N")]
    shadow_rays: Option<u32>,

    /// Hide the environment where nothing is before it, to put another background there; it lights
    /// the scene as ever. Adds alpha
    #[arg(long)]
    no_background: bool,
}

impl ShadeSettings {
    /// Fails now rather than after the work.
    pub fn check(&self) -> Result<()> {
        if let Some(target) = self.target_error {
            tune::check(target)?;
        }
        self.settings(0).check()
    }

    fn uses_nodes(&self) -> bool {
        !matches!(self.kernel, Kernel::Plain)
    }

    /// Whether indirect light comes from media, too.
    pub fn lights_media(&self) -> bool {
        matches!(self.method, Method::Extended)
    }

    /// Whether the environment is seen.
    pub fn shows_background(&self) -> bool {
        !self.no_background
    }

    /// Says so where a camera that moves has no frame to be at.
    pub fn say_frame(&self, scene: &Scene, job: &Job) -> Result<()> {
        let camera = scene.camera(self.camera.as_deref())?;
        if let Some(first) = camera.keys.first().filter(|_| scene.frame.is_none()) {
            job.progress.say(&format!(
                "camera `{}` moves: without --frames it is where it is in frame {}",
                camera.name, first.frame
            ));
        }
        Ok(())
    }

    /// The settings that take the least memory of those that may be picked for a scene.
    ///
    /// # Errors
    /// A camera that the scene does not have.
    pub fn least(&self, scene: &Scene) -> Result<Settings> {
        scene.camera(self.camera.as_deref())?;
        let mut settings = self.settings(0);
        if self.target_error.is_some() && self.lattice.is_none() {
            // What will be picked is not known yet.
            settings.lattice = Settings::COARSEST_LATTICE;
        }
        Ok(settings)
    }

    /// The settings, picked for an error if one is asked for.
    ///
    /// # Errors
    /// As [`tune::choose`].
    pub fn resolve(
        &self,
        scene: &Scene,
        store: &OpenTree,
        seed: u64,
        job: &Job,
    ) -> Result<Settings> {
        match self.target_error {
            Some(target) => self.pick(target, scene, store, seed, job),
            None => Ok(self.settings(seed)),
        }
    }

    /// The settings as they are typed; `None` if an error has to pick them first.
    pub fn typed(&self, seed: u64) -> Option<Settings> {
        self.target_error.is_none().then(|| self.settings(seed))
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
            background: !self.no_background,
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
        // The path tracer sees the environment.
        let with_background = |rung| Settings {
            background: true,
            ..self.over(rung, seed)
        };
        let choice = tune::choose(scene, store, target, with_background, job)?;
        let (mut s, expected) = (choice.settings, choice.expected);
        s.background = self.shows_background();
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
            "target error {target:.1e}: shading with {options} --pixel-samples {} --corner-spacing \
             {} --edge-samples {} --shadow-rays {}, expected error {expected:.1e}",
            s.pixel_samples, s.corner_spacing, s.edge_samples, s.shadow_rays,
        ));
        match choice.outcome {
            Outcome::OutOfReach => job.progress.warn(&format!(
                "the target error {target:.1e} is out of reach of sampling: about {expected:.1e} \
                 is what to expect. The rest is bias of the tree and of interpolation; a tree with \
                 more --surfels may have less"
            )),
            Outcome::Better => job.progress.say(&format!(
                "the coarsest settings are expected to have less error than {target:.1e}"
            )),
            Outcome::Met => {}
        }
        Ok(s)
    }
}

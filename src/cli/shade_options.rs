//! Options of shading, and of the image it makes, for the verbs that shade.

use super::files::{Files, check_writable};
use super::parse;
use super::region_options::RegionOptions;
use super::shade_settings::ShadeSettings;
use crate::formats::Overwrite;
use crate::image::exr::{self, Precision};
use crate::image::{Frame, ImageKind, png, tone};
use crate::run::Job;
use crate::scene::Scene;
use crate::shade::{self, Aov};
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

    #[command(flatten)]
    pub settings: ShadeSettings,

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
        self.settings.check()
    }

    /// The same for what depends on the scene.
    pub fn check_with(&self, scene: &Scene, tree_bytes: u64, job: &Job) -> Result<u64> {
        let settings = self.settings.least(scene)?;
        let region = self.region.of(&scene.film)?;
        shade::check_memory(scene, &settings, region, &self.aov, tree_bytes, job)
    }

    /// Shades and writes the image.
    pub fn run(&self, scene: &Scene, store: &OpenTree, seed: u64, job: &Job) -> Result<()> {
        let region = self.region.of(&scene.film)?;
        let settings = self.settings.resolve(scene, store, seed, job)?;
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

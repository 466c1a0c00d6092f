//! Options of shading, and of the image it makes, for the verbs that shade.

use super::files::{Files, check_writable};
use super::options::Resume;
use super::parse;
use super::region_options::RegionOptions;
use super::shade_settings::ShadeSettings;
use super::tev::{TevOptions, channels};
use crate::formats::{Overwrite, TreeMeta};
use crate::image::exr::Precision;
use crate::image::{Exposure, ImageKind, Onlooker, Region, write};
use crate::run::Job;
use crate::scene::Scene;
use crate::shade::{self, Aov, Settings};
use crate::tree::{OpenTree, TreeNeeds};
use crate::{Error, Result};
use clap::Args;
use std::path::{Path, PathBuf};

/// How to shade, as typed.
#[derive(Clone, Debug, Args)]
#[command(next_help_heading = "Shading")]
pub struct ShadeOptions {
    /// Write the image to this .exr or .png file, or as an array of float32 (rows, columns,
    /// channels) to this .npy file
    #[arg(short, long, value_name = "FILE", help_heading = None)]
    output: PathBuf,

    #[command(flatten)]
    pub settings: ShadeSettings,

    #[command(flatten)]
    region: RegionOptions,

    /// Add these layers to an .exr or .npy image. depth is the least distance along the camera's
    /// axis (1e10 on the background) and position the point of it; distance is the mean along the
    /// rays; albedo and normal are what denoisers take
    #[arg(long, value_name = "LAYER", value_delimiter = ',', value_parser = parse::one_of(&Aov::ALL))]
    aov: Vec<Aov>,

    /// Add alpha to the image, the share of the background that surfaces and media hide: a channel
    /// A of an .exr, whose colours are premultiplied, or the transparency of a .png
    #[arg(long)]
    alpha: bool,

    /// Look at a .png with this factor on radiance, or with one that makes one lit pixel in fifty
    /// of the whole frame brighter than white (auto) [default: the exposure of the scene's film]
    #[arg(long, value_name = "E|auto", value_parser = parse::exposure)]
    exposure: Option<Exposure>,

    #[command(flatten)]
    tev: TevOptions,

    /// Store 32-bit instead of 16-bit floats in an .exr image
    #[arg(long)]
    float: bool,
}

impl ShadeOptions {
    /// The same, to another image, with every bit.
    pub fn to(&self, output: PathBuf) -> Self {
        Self {
            output,
            exposure: None,
            float: true,
            ..self.clone()
        }
    }

    /// The image that it makes, as it was asked for.
    pub fn target(&self) -> (&Path, Precision, Option<Exposure>) {
        (&self.output, self.precision(), self.exposure)
    }

    /// Adds what it writes.
    pub fn files(&self, files: Files) -> Files {
        self.region.files(files).writes("--output", &self.output)
    }

    /// Fails now rather than after the work.
    pub fn check(&self) -> Result<()> {
        let kind = ImageKind::named(&self.output)?;
        let is_png = kind == ImageKind::Png;
        for (option, given, goes, end) in [
            ("--aov", !self.aov.is_empty(), !is_png, ".exr"),
            ("--float", self.float, kind == ImageKind::Exr, ".exr"),
            ("--exposure", self.exposure.is_some(), is_png, ".png"),
        ] {
            if given && !goes {
                return Err(Error::input(format!(
                    "{option} needs an {end} image, found --output {}",
                    self.output.display()
                ))
                .hint(format!("name the output {end}, or leave the option out")));
            }
        }
        if self.exposure == Some(Exposure::Automatic) && self.region.is_given() {
            return Err(Error::input(
                "--exposure auto is that of a whole frame, found a part of one",
            )
            .hint("make tiles as .exr, and merge them to a .png with --exposure auto"));
        }
        check_writable(&self.output, Overwrite::Replace)?;
        self.settings.check()
    }

    /// The pixels that it makes.
    pub fn region(&self, scene: &Scene) -> Result<Region> {
        self.region.of(&scene.film)
    }

    /// The same for what depends on the scene.
    pub fn check_with(&self, scene: &Scene, tree: TreeNeeds, job: &Job) -> Result<u64> {
        let settings = self.settings.least(scene)?;
        self.settings.say_frame(scene, job)?;
        self.tev.check(job);
        let region = self.region.of(&scene.film)?;
        shade::check_memory(scene, &settings, region, &self.aovs(), tree, job)
    }

    /// The image that it makes, as it may be there already; `None` for one that says nothing of its
    /// origin.
    fn image<'a>(&'a self, scene: &Scene, aovs: &'a [Aov]) -> Result<Option<shade::Image<'a>>> {
        let is_exr = ImageKind::named(&self.output)? == ImageKind::Exr;
        let region = self.region.of(&scene.film)?;
        Ok(is_exr.then_some(shade::Image {
            path: &self.output,
            region,
            aovs,
            precision: self.precision(),
        }))
    }

    /// Whether the image is there already, of a tree that has to be made yet. Of settings for an
    /// error it is not known before there is one.
    pub fn is_made_by(
        &self,
        resume: Resume,
        scene: &Scene,
        tree: &TreeMeta,
        seed: u64,
        job: &Job,
    ) -> Result<bool> {
        let aovs = self.aovs();
        let image = self.image(scene, &aovs)?;
        let Some((image, settings)) = image.zip(self.settings.typed(seed)) else {
            return Ok(false);
        };
        let is_same = || image.is_made_by(scene, tree, &settings);
        Ok(resume.is_made(&self.output, is_same, job))
    }

    /// Whether the image is there already.
    pub fn is_made(
        &self,
        resume: Resume,
        scene: &Scene,
        store: &OpenTree,
        settings: &Settings,
        job: &Job,
    ) -> Result<bool> {
        let aovs = self.aovs();
        let Some(image) = self.image(scene, &aovs)? else {
            return Ok(false);
        };
        let is_same = || image.is_made(scene, store, settings);
        Ok(resume.is_made(&self.output, is_same, job))
    }

    /// The layers, and alpha where it is asked for or told by what is left out.
    fn aovs(&self) -> Vec<Aov> {
        let has_alpha = self.alpha || !self.settings.shows_background();
        let alpha = has_alpha.then_some(Aov::Alpha);
        self.aov.iter().copied().chain(alpha).collect()
    }

    fn precision(&self) -> Precision {
        match self.float {
            true => Precision::Float,
            false => Precision::Half,
        }
    }

    /// Shades and writes the image.
    pub fn run(
        &self,
        scene: &Scene,
        store: &OpenTree,
        settings: &Settings,
        job: &Job,
    ) -> Result<()> {
        let region = self.region.of(&scene.film)?;
        job.heed_warnings()?;
        let aovs = self.aovs();
        let shown = channels(aovs.contains(&Aov::Alpha));
        let size = [scene.film.width, scene.film.height];
        let tev = self.tev.open(&self.output, size, shown);
        let onlooker = tev.as_ref().map(|tev| tev as &dyn Onlooker);
        let frame = shade::run_before(scene, store, settings, region, &aovs, onlooker, job);
        if let Some(tev) = tev {
            tev.close();
        }
        let frame = frame?;
        job.stage("write", |_| {
            let of_film = Exposure::Fixed(scene.film.exposure);
            let exposure = Some(self.exposure.unwrap_or(of_film));
            write(&self.output, &frame, self.precision(), exposure, job)
        })
    }
}

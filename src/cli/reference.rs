//! `lvox reference`

use super::files::{Files, check_writable};
use super::options::{Context, Memory, Seed, Temporary};
use super::plan::{Plan, Planning};
use super::region_options::RegionOptions;
use super::scene_input::SceneInput;
use super::tev::{TevOptions, channels};
use crate::formats::Overwrite;
use crate::image::{ImageKind, Onlooker};
use crate::lab::reference::{self, Settings};
use crate::run::StageReport;
use crate::{Error, Result};
use std::path::PathBuf;

/// Render a scene by unbiased Monte Carlo path tracing, to judge other images by
///
/// Write radiance and, in the layer `variance`, the variance of each pixel's mean, as 32-bit
/// floats. Sums are kept in FILE.sums: a later run with more samples or time goes on from there,
/// with the same result as one run would have had. So does the same command after a stop; --force
/// begins anew. Sums of a build whose path tracer had other sources are refused.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    scene: SceneInput,

    /// Write the image to this .exr file, or as an array of float32 (rows, columns; R G B, and
    /// their variance) to this .npy file
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,

    /// Look through this camera of the scene [default: its first]
    #[arg(long, value_name = "NAME")]
    camera: Option<String>,

    /// Stop at this many samples per pixel; more that are kept stay in the image [default: 64,
    /// without --time]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    spp: Option<u32>,

    /// Stop after this many seconds, each pixel sampled once at least
    #[arg(long, value_name = "SECS")]
    time: Option<f64>,

    /// Count paths of at most this many segments: 1 for emission seen directly, 2 for direct light,
    /// 3 for one bounce of indirect light (what shade computes from a tree without bounces), 0 for
    /// all
    #[arg(long, value_name = "N", default_value_t = Settings::default().max_depth)]
    max_depth: u32,

    /// Sample each pixel by this many independent sequences, whose spread tells the variance; 1 has
    /// the least noise and tells no variance
    #[arg(long, value_name = "N", default_value_t = Settings::default().strands)]
    strands: u32,

    #[command(flatten)]
    region: RegionOptions,

    #[command(flatten)]
    planning: Planning,

    #[command(flatten)]
    tev: TevOptions,

    #[command(flatten)]
    pub memory: Memory,

    #[command(flatten)]
    pub temporary: Temporary,

    #[command(flatten)]
    seed: Seed,
}

impl Args {
    /// What it reads and writes.
    pub fn files(&self) -> Files {
        self.region
            .files(self.scene.files())
            .writes("--output", &self.output)
            .writes("--output (its sums)", &reference::sums_path(&self.output))
    }

    pub fn run(self, context: &Context) -> Result<()> {
        let kind = ImageKind::named(&self.output).ok();
        if !matches!(kind, Some(ImageKind::Exr | ImageKind::Npy)) {
            return Err(Error::input(format!(
                "{}: a reference has to be named .exr or .npy",
                self.output.display()
            )));
        }
        let files = self.files();
        let settings = Settings {
            camera: self.camera,
            max_depth: self.max_depth,
            spp: match (self.spp, self.time) {
                (None, None) => Settings::default().spp,
                (spp, _) => spp,
            },
            secs: self.time,
            strands: self.strands,
            seed: self.seed.seed,
        };
        settings.check()?;
        check_writable(&self.output, Overwrite::Replace)?;
        check_writable(&reference::sums_path(&self.output), Overwrite::Replace)?;
        self.tev.check(&context.job);
        let scene = self.scene.load(context)?;
        let region = self.region.of(&scene.film)?;
        if self.planning.plan {
            let held = reference::check_memory(&scene, &settings, region, &context.job)?;
            let plan = Plan::of(&files, held).with_scene(&scene);
            let plan = plan.with("pixels", region.pixels() as u64);
            return plan.taking(settings.secs).print(self.planning);
        }
        let size = [scene.film.width, scene.film.height];
        let tev = self.tev.open(&self.output, size, channels(false));
        let onlooker = tev.as_ref().map(|tev| tev as &dyn Onlooker);
        let made = reference::run_before(
            &scene,
            &settings,
            region,
            &self.output,
            context.start(),
            onlooker,
            &context.job,
        );
        if let Some(tev) = tev {
            tev.close();
        }
        made?;
        if let Some(text) = reached(&context.job.report.stages()) {
            context.job.progress.say(&text);
        }
        Ok(())
    }
}

/// What the image is worth as a reference.
fn reached(stages: &[StageReport]) -> Option<String> {
    let counts = &stages.iter().rfind(|s| s.stage == "reference")?.counts;
    let (least, most) = (counts.get("spp_min")?, counts.get("spp_max")?);
    let samples = if least < most {
        format!("{least} to {most}")
    } else {
        most.to_string()
    };
    let noise = match counts.get("relmse_estimate").filter(|v| v.is_finite()) {
        Some(relmse) => format!("its noise is of relMSE {relmse:.2e}"),
        None => "one sequence of samples does not tell its noise".into(),
    };
    Some(format!("{samples} samples per pixel; {noise}"))
}

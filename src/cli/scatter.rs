//! `lvox scatter`

use super::files::{Files, check_writable};
use super::options::{Context, Memory, Resume, Seed, Temporary};
use super::plan::{Plan, Planning};
use super::times;
use super::tree_input::TreeInput;
use crate::Result;
use crate::formats::FileKind;
use crate::scatter::{self, Settings};
use std::path::PathBuf;

/// Light the media of a scene for all cameras, so that no frame and no tile has to
///
/// What arrives at points inside media does not depend on the camera. `lvox shade --scatter` takes
/// it from this file, and looks itself where it comes closer than the points stand, or media are
/// too dense for them.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    input: TreeInput,

    /// Write the light to this .lvs file
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,

    /// Rays of each gather inside media [default: 16]
    #[arg(long, value_name = "N")]
    volume_samples: Option<u32>,

    /// Take a node whole where it is seen under less than a quarter of this, steradians [default:
    /// 0.01]
    #[arg(long, value_name = "SR")]
    max_solid_angle: Option<f32>,

    /// Shadow rays to each area light from each point [default: 16]
    #[arg(long, value_name = "N")]
    shadow_rays: Option<u32>,

    #[command(flatten)]
    planning: Planning,

    #[command(flatten)]
    pub resume: Resume,

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
        self.input.files().writes("--output", &self.output)
    }

    fn settings(&self) -> Settings {
        let default = Settings::default();
        Settings {
            volume_samples: self.volume_samples.unwrap_or(default.volume_samples),
            max_solid_angle: self.max_solid_angle.unwrap_or(default.max_solid_angle),
            shadow_rays: self.shadow_rays.unwrap_or(default.shadow_rays),
            seed: self.seed.seed,
        }
    }

    pub fn run(self, context: &Context) -> Result<()> {
        let overwrite = (self.resume).overwrite(&self.output, FileKind::Scatter, context);
        check_writable(&self.output, overwrite)?;
        let settings = self.settings();
        settings.check()?;
        let job = &context.job;
        let (scene, store, _) = self.input.open(context)?;
        if self.planning.plan {
            let held = scatter::check_memory(&scene, job)?;
            let plan = Plan::of(&self.files(), held).with_scene(&scene);
            return plan.with_tree(&store).print(self.planning);
        }
        let is_same = || scatter::has_made(&self.output, &scene, &store, &settings);
        if self.resume.is_made(&self.output, is_same, job) {
            return Ok(());
        }
        let store = store.beside(scatter::check_memory(&scene, job)?)?;
        job.heed_warnings()?;
        scatter::run(&scene, &store, &self.output, &settings, overwrite, job)?;
        times::say(context, "scatter", &[]);
        Ok(())
    }
}

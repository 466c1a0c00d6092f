//! `lvox bake`

use super::bake_options::BakeOptions;
use super::files::{Files, check_writable};
use super::options::{Context, Memory, Resume, Seed, Temporary};
use super::plan::{Plan, Planning};
use super::scene_input::SceneInput;
use crate::Result;
use crate::bake::{Part, Settings};
use crate::formats::FileKind;
use crate::run::usage;
use std::path::PathBuf;

/// Bake a scene into a cloud of surfels and lvoxels with their direct light
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    scene: SceneInput,

    /// Write the cloud to this .lvc file
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,

    #[command(flatten)]
    bake: BakeOptions,

    /// Bake only part I of N, counted from 0, for several processes or machines; `lvox build` takes
    /// all parts together
    #[arg(long, value_name = "I/N")]
    part: Option<Part>,

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
        self.scene.files().writes("--output", &self.output)
    }

    pub fn run(self, context: &Context) -> Result<()> {
        let overwrite = (self.resume).overwrite(&self.output, FileKind::Cloud, context);
        check_writable(&self.output, overwrite)?;
        let settings = Settings {
            part: self.part.unwrap_or(Part::WHOLE),
            ..self.bake.settings(self.seed.seed)
        };
        settings.check()?;
        let scene = self.scene.load(context)?;
        let job = &context.job;
        job.heed_warnings()?;
        if self.planning.plan {
            let before = usage::cpu_secs();
            let planned = crate::bake::plan(&scene, &settings, job)?;
            return Plan::of(&self.files(), planned.memory_bytes)
                .with_scene(&scene)
                .with("surfels", planned.surfels)
                .with("lvoxels", planned.lvoxels)
                .writing(planned.cloud_bytes)
                .taking(Some(before + planned.cpu_secs))
                .print(self.planning);
        }
        let is_same = || crate::bake::has_made(&self.output, &scene, &settings);
        if !self.resume.is_made(&self.output, is_same, job) {
            crate::bake::run(&scene, &settings, &self.output, overwrite, job)?;
        }
        Ok(())
    }
}

//! `lvox bake`

use super::bake_options::BakeOptions;
use super::files::{Files, check_writable};
use super::options::{Context, Memory, Seed};
use super::scene_input::SceneInput;
use crate::Result;
use crate::bake::{Part, Settings};
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
    pub memory: Memory,

    #[command(flatten)]
    seed: Seed,
}

impl Args {
    /// What it reads and writes.
    pub fn files(&self) -> Files {
        self.scene.files().writes("--output", &self.output)
    }

    pub fn run(self, context: &Context) -> Result<()> {
        check_writable(&self.output, context.overwrite)?;
        let settings = Settings {
            part: self.part.unwrap_or(Part::WHOLE),
            ..self.bake.settings(self.seed.seed)
        };
        settings.check()?;
        let scene = self.scene.load(context)?;
        context.job.heed_warnings()?;
        crate::bake::run(
            &scene,
            &settings,
            &self.output,
            context.overwrite,
            &context.job,
        )?;
        Ok(())
    }
}

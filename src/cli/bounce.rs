//! `lvox bounce`

use super::files::{Files, check_writable};
use super::options::{Context, Memory, Resume, Seed, Temporary};
use super::parse;
use super::plan::{Plan, Planning};
use super::times;
use super::tree_input::TreeInput;
use crate::Result;
use crate::bounce::{self, Bounces, Settings};
use crate::formats::FileKind;
use std::path::PathBuf;

/// Let light bounce between surfaces and scatter in media, once for all frames
///
/// A frame shaded from the tree of `lvox build` has direct light and one bounce. Shaded from the
/// tree that this writes it has every bounce and every order of scattering, in the same time.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    input: TreeInput,

    /// Write the tree with the light of all bounces to this .lvt file
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,

    /// Let frames have so many bounces: a number, with 1 the light of the tree as it is, or `all`
    #[arg(long, value_name = "N", default_value_t = Bounces::All, value_parser = parse::bounces)]
    bounces: Bounces,

    /// Rays of each of the places at which light is gathered [default: 16]
    #[arg(long, value_name = "N")]
    samples: Option<u32>,

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
            bounces: self.bounces,
            samples: self.samples.unwrap_or(default.samples),
            seed: self.seed.seed,
        }
    }

    pub fn run(self, context: &Context) -> Result<()> {
        let overwrite = (self.resume).overwrite(&self.output, FileKind::Tree, context);
        check_writable(&self.output, overwrite)?;
        let settings = self.settings();
        settings.check()?;
        let job = &context.job;
        let (scene, store, tree) = self.input.open(context)?;
        bounce::check_tree(store.tree()).map_err(|e| e.at(tree.display()))?;
        if self.planning.plan {
            let held = bounce::check_memory(&scene, store.tree(), &settings, job)?;
            let plan = Plan::of(&self.files(), held).with_scene(&scene);
            return plan.with_tree(&store).print(self.planning);
        }
        let is_same = || bounce::has_made(&self.output, &store, &settings);
        if self.resume.is_made(&self.output, is_same, job) {
            return Ok(());
        }
        let held = bounce::check_memory(&scene, store.tree(), &settings, job)?;
        let store = store.beside(held)?;
        job.heed_warnings()?;
        bounce::run(&scene, &store, &self.output, &settings, overwrite, job)?;
        times::say(context, "bounce", &[]);
        Ok(())
    }
}

//! `lvox render`

use super::bake_options::BakeOptions;
use super::files::{Files, check_writable};
use super::options::{Context, Memory, Seed, Temporary};
use super::output;
use super::parse;
use super::scene_input::SceneInput;
use super::shade_options::ShadeOptions;
use crate::Result;
use crate::bounce::{self, Bounces};
use crate::formats::Overwrite;
use crate::tree::OpenTree;
use std::path::PathBuf;

/// Render a scene: bake, build and shade in one go
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    scene: SceneInput,

    /// Keep the tree in this .lvt file, for `lvox shade` [default: it is deleted]
    #[arg(long, value_name = "FILE")]
    keep_tree: Option<PathBuf>,

    #[command(flatten)]
    bake: BakeOptions,

    /// Let light bounce and scatter so many times: `all`, or a number, with 1 as in the paper
    /// [default: all; 1 with --method traditional]
    #[arg(long, value_name = "N", value_parser = parse::bounces)]
    bounces: Option<Bounces>,

    #[command(flatten)]
    shade: ShadeOptions,

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
        let files = self.shade.files(self.scene.files());
        match &self.keep_tree {
            Some(tree) => files.writes("--keep-tree", tree),
            None => files,
        }
    }

    pub fn run(self, context: &Context) -> Result<()> {
        let job = &context.job;
        self.shade.check()?;
        crate::build::check_memory(job.memory_limit)?;
        if let Some(path) = &self.keep_tree {
            check_writable(path, context.overwrite)?;
        }
        let settings = self.bake.settings(self.seed.seed);
        settings.check()?;
        let scene = self.scene.load(context)?;
        let others = self.shade.check_with(&scene, 0, job)?;
        job.heed_warnings()?;
        let folder = job.temporary_folder()?;
        let cloud = folder.path().join("scene.lvc");
        let kept = self.keep_tree.clone();
        let tree = kept.unwrap_or_else(|| folder.path().join("scene.lvt"));
        let bounces = self
            .bounces
            .unwrap_or(match self.shade.settings.lights_media() {
                true => Bounces::All,
                false => Bounces::Count(1),
            });
        let is_bounced = bounces != Bounces::Count(1);
        let built = match is_bounced {
            true => folder.path().join("built.lvt"),
            false => tree.clone(),
        };
        crate::bake::run(&scene, &settings, &cloud, Overwrite::Refuse, job)?;
        crate::build::run(
            &cloud,
            &built,
            &crate::build::Settings::default(),
            context.overwrite,
            job,
        )?;
        if is_bounced {
            let settings = bounce::Settings {
                bounces,
                seed: self.seed.seed,
                ..bounce::Settings::default()
            };
            let store = OpenTree::open(&built, job.memory_limit)?;
            let held = bounce::check_memory(&scene, store.tree(), &settings, job)?;
            let store = store.beside(held)?;
            bounce::run(&scene, &store, &tree, &settings, context.overwrite, job)?;
        }
        let store = OpenTree::open(&tree, job.memory_limit)?.beside(others)?;
        self.shade.run(&scene, &store, self.seed.seed, job)?;
        output::say_times(job, "shade", &["bake", "build", "bounce", "pilot"]);
        Ok(())
    }
}

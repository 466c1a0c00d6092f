//! `lvox shade`

use super::files::Files;
use super::options::{Context, Memory, Resume, Seed, Temporary};
use super::out_of_date::warn_if_out_of_date;
use super::plan::{Plan, Planning};
use super::shade_options::ShadeOptions;
use super::times;
use super::tree_input::TreeInput;
use crate::{Result, shade};
use std::path::PathBuf;

/// Shade an image, or a tile of it, from a scene and its tree
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    input: TreeInput,

    /// Take light inside media from this file of `lvox scatter`, which was made from the tree
    /// [default: that of a packed scene, without --tree]
    #[arg(long, value_name = "FILE")]
    scatter: Option<PathBuf>,

    #[command(flatten)]
    shade: ShadeOptions,

    /// Keep the light of surfaces in this file, and take from it what other frames and tiles of the
    /// same scene, tree and quality have put there, also while they run. Pictures are the same
    /// without; on one machine many tiles together are then little slower than their frame
    #[arg(long, value_name = "FILE")]
    pub radiance_cache: Option<PathBuf>,

    /// Keep the gathers of this frame in this file, and take from it what its other tiles have put
    /// there, also while they run: those beside each other share half of a small tile's. Pictures
    /// are the same without
    #[arg(long, value_name = "FILE")]
    pub gather_cache: Option<PathBuf>,

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
        let files = self.input.files();
        self.shade.files(match &self.scatter {
            Some(scatter) => files.reads("--scatter", scatter),
            None => files,
        })
    }

    pub fn run(self, context: &Context) -> Result<()> {
        self.shade.check()?;
        let job = &context.job;
        let (scene, mut store, path) = self.input.open(context)?;
        let packed = || self.input.packed_light(&scene);
        let light = self.scatter.clone().or_else(packed);
        if let Some(light) = &light {
            store = store.with_scatter(light)?;
        }
        let others = self.shade.check_with(&scene, store.needs(), job)?;
        store = store.beside(others)?;
        if let Some((scatter, path)) = store.scatter.as_ref().zip(light.as_ref()) {
            let meta = scatter.meta();
            warn_if_out_of_date(&scene, (&meta.scene_hash, &meta.settings), path, context)?;
        }
        context.job.heed_warnings()?;
        let settings = self
            .shade
            .settings
            .resolve(&scene, &store, self.seed.seed, job)?;
        if self.planning.plan {
            let region = self.shade.region(&scene)?;
            let costs = shade::costs(&scene, &store, &settings, job)?;
            let plan = Plan::of(&self.files(), others).with_scene(&scene);
            let plan = plan
                .with_tree(&store)
                .with("pixels", region.pixels() as u64)
                .taking(Some(costs.cost(&region) * 1e-9));
            return plan.print(self.planning);
        }
        let is_made = (self.shade).is_made(self.resume, &scene, &store, &settings, job)?;
        if !is_made {
            self.shade.run(&scene, &store, &settings, job)?;
            times::say(context, "shade", &["pilot"]);
        }
        self.input.leave(scene, store, path, context);
        Ok(())
    }
}

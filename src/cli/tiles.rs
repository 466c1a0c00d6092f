//! `lvox tiles`

use super::files::{Files, check_writable};
use super::options::{Context, Memory, Seed, Temporary};
use super::output;
use super::plan::{Plan, Planning};
use super::shade_settings::ShadeSettings;
use super::tree_input::TreeInput;
use crate::Result;
use crate::formats::Overwrite;
use crate::image::{Region, tile_list};
use crate::run::Output;
use crate::shade;
use std::path::PathBuf;

/// Cut a frame into tiles that take about as long as each other
///
/// A pilot counts what a few pixels and gathers all over the frame take. Print a line for each
/// tile: options for `lvox shade`, which also takes one of them by --tile I/N --tiles FILE. Results
/// do not depend on threads and memory.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    input: TreeInput,

    /// Take light inside media from this file of `lvox scatter`, as `lvox shade` will
    #[arg(long, value_name = "FILE")]
    scatter: Option<PathBuf>,

    /// Cut into so many tiles
    #[arg(short = 'n', long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    count: u32,

    /// Write the list to this file, which is replaced if it is there [default: stdout]
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,

    #[command(flatten)]
    settings: ShadeSettings,

    /// Keep the light of surfaces that the pilot meets in this file, as `lvox shade` does, and take
    /// it from there
    #[arg(long, value_name = "FILE")]
    pub radiance_cache: Option<PathBuf>,

    #[command(flatten)]
    ignored: OfShadeAlone,

    #[command(flatten)]
    pub memory: Memory,

    #[command(flatten)]
    pub temporary: Temporary,

    #[command(flatten)]
    seed: Seed,

    #[command(flatten)]
    planning: Planning,
}

/// Options of `lvox shade` that make no difference to what tiles take, so that the options of one
/// may be given to the other.
#[derive(Debug, clap::Args)]
struct OfShadeAlone {
    #[arg(long, hide = true)]
    aov: Vec<String>,

    #[arg(long, hide = true)]
    float: bool,

    #[arg(long, hide = true)]
    gather_cache: Option<PathBuf>,
}

impl Args {
    /// What it reads and writes.
    pub fn files(&self) -> Files {
        let mut files = self.input.files();
        if let Some(scatter) = &self.scatter {
            files = files.reads("--scatter", scatter);
        }
        match &self.output {
            Some(output) => files.writes("--output", output),
            None => files,
        }
    }

    pub fn run(self, context: &Context) -> Result<()> {
        let job = &context.job;
        self.settings.check()?;
        if let Some(output) = &self.output {
            check_writable(output, Overwrite::Replace)?;
        }
        let (scene, mut store, path) = self.input.open(context)?;
        let packed = || self.input.packed_light(&scene);
        if let Some(light) = self.scatter.clone().or_else(packed) {
            store = store.with_scatter(&light)?;
        }
        let least = self.settings.least(&scene)?;
        // More tiles than pixels are refused before the work.
        let film = scene.film;
        Region::tile(film.width, film.height, 0, self.count)?;
        let pixel = Region::full(1, 1);
        let others = shade::check_memory(&scene, &least, pixel, &[], store.needs(), job)?;
        store = store.beside(others)?;
        job.heed_warnings()?;
        if self.planning.plan {
            let plan = Plan::of(&self.files(), others)
                .with_scene(&scene)
                .with_tree(&store);
            let pixels = Region::full(film.width, film.height).pixels() as u64;
            let plan = plan.with("pixels", pixels).with("tiles", self.count.into());
            return plan.print(self.planning);
        }
        let settings = (self.settings).resolve(&scene, &store, self.seed.seed, job)?;
        let costs = shade::costs(&scene, &store, &settings, job)?;
        let tiles = costs.cut(self.count)?;
        let most = tiles.iter().map(|t| costs.cost(t)).fold(0.0, f64::max);
        let mean = tiles.iter().map(|t| costs.cost(t)).sum::<f64>() / f64::from(self.count);
        job.progress.say(&format!(
            "{} tiles; the slowest is expected to take {:.2} times the mean",
            self.count,
            if mean > 0.0 { most / mean } else { 1.0 }
        ));
        job.heed_warnings()?;
        let lines = tile_list::to_lines(&tiles);
        match &self.output {
            Some(output) => Output::write_all_to(output, lines.as_bytes())?,
            None => output::print(&lines)?,
        }
        self.input.leave(scene, store, path, context);
        Ok(())
    }
}

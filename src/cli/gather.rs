//! `lvox gather`

use super::files::{Files, check_writable};
use super::options::{Context, Memory, Seed, Temporary};
use super::out_of_date::warn_if_out_of_date;
use super::parse;
use super::plan::{Plan, Planning};
use super::times;
use crate::points::{self, Over, PointFile, Settings};
use crate::run::Part;
use crate::scene::Scene;
use crate::scene::load::{self, is_packed};
use crate::shade::Quality;
use crate::tree::OpenTree;
use crate::{Error, Result};
use std::path::PathBuf;

/// Gather light at points of other programs, from a tree alone
///
/// Each point with a normal gets the irradiance (W/m2) that surfaces and media send to it: what the
/// layer `indirect` of `shade` has, times pi over the albedo. What lights and the environment send
/// straight to it is not in that. A point without a normal gets the mean radiance (W/m2/sr) over
/// the sphere; 4 pi times that is the fluence.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Gather from this tree: .lvt, or .lvp of `lvox pack` with a tree in it
    #[arg(value_name = "TREE")]
    tree: PathBuf,

    /// Gather at these points, in world space: a PLY file with `x y z` and, for normals, `nx ny nz`
    /// as properties of `vertex`; or .npy, N x 6 or N x 3 of float32 or float64
    #[arg(value_name = "POINTS")]
    points: PathBuf,

    /// Write to this file. A .ply has what the points have, and further properties; a .npy has N x
    /// C of float32, in this order: irradiance_r, _g, _b (mean_radiance_r, … over the sphere),
    /// occlusion and distance if asked for
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,

    /// Look along the hemisphere above normals, by the cosine, or along the sphere [default: the
    /// hemisphere where there are normals]
    #[arg(long, value_name = "DIRECTIONS", value_parser = parse::one_of(&Over::ALL))]
    over: Option<Over>,

    /// Add the share of those directions that surfaces cover, 0 to 1
    #[arg(long)]
    occlusion: bool,

    /// Add how far away light changes, scene units: the harmonic mean of the distance to what is
    /// seen, or twice that by the light from there where it is less; infinite if nothing is seen.
    /// Media count by the share of the light that they stop
    #[arg(long)]
    distance: bool,

    /// How the surface at the end of a ray is found: by surfels and nodes of the tree (cone), or by
    /// the triangles of a packed scene (traced) [default: traced where there are triangles]
    #[arg(long, value_name = "KERNEL", value_parser = parse::one_of(&Kernel::ALL))]
    kernel: Option<Kernel>,

    /// Cast as many rays at each point as this says: draft 64, good 256, best 1024
    #[arg(long, value_name = "PRESET", default_value = "good", value_parser = parse::one_of(&Quality::ALL))]
    quality: Quality,

    /// Cast this many rays at each point instead
    #[arg(long, value_name = "N", conflicts_with = "quality")]
    samples: Option<u32>,

    /// Take a node whole where it is seen under less than this, steradians [default: 0.02, 0.02,
    /// 0.01 by quality]
    #[arg(long, value_name = "SR")]
    max_solid_angle: Option<f32>,

    /// Start rays this far off their point along its normal, scene units: for points that lie
    /// behind the surfaces of the tree
    #[arg(long, value_name = "D", default_value_t = 0.0)]
    bias: f32,

    /// Gather at part I of N of the points alone, counted from 0. The files of all parts one after
    /// the other (cat) are the file of the whole: the first has its header
    #[arg(long, value_name = "I/N")]
    part: Option<Part>,

    #[command(flatten)]
    planning: Planning,

    #[command(flatten)]
    pub memory: Memory,

    #[command(flatten)]
    pub temporary: Temporary,

    #[command(flatten)]
    seed: Seed,
}

/// How the surface that ends a ray is found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kernel {
    Cone,
    Traced,
}

impl Kernel {
    const ALL: [(&'static str, Self); 2] = [("cone", Self::Cone), ("traced", Self::Traced)];
}

impl Args {
    /// What it reads and writes.
    pub fn files(&self) -> Files {
        Files::default()
            .reads("tree", &self.tree)
            .reads("points", &self.points)
            .writes("--output", &self.output)
    }

    fn settings(&self) -> Settings {
        let (samples, max_solid_angle) = match self.quality {
            Quality::Draft => (64, 0.02),
            Quality::Good => (256, 0.02),
            Quality::Best => (1024, 0.01),
        };
        Settings {
            samples: self.samples.unwrap_or(samples),
            max_solid_angle: self.max_solid_angle.unwrap_or(max_solid_angle),
            over: self.over,
            occlusion: self.occlusion,
            distance: self.distance,
            bias: self.bias,
            seed: self.seed.seed,
            part: self.part.unwrap_or(Part::WHOLE),
        }
    }

    /// The scene that is packed with the tree, if its triangles are to end rays.
    fn scene(&self, tree: &OpenTree, context: &Context) -> Result<Option<Scene>> {
        let job = &context.job;
        match (self.kernel, is_packed(&self.tree)) {
            (Some(Kernel::Cone), _) | (None, false) => return Ok(None),
            (Some(Kernel::Traced), false) => {
                return Err(Error::input(format!(
                    "--kernel traced needs triangles, {} has none",
                    self.tree.display()
                ))
                .hint("pack the scene with the tree, and name that file: lvox pack"));
            }
            (_, true) => {}
        }
        let scene = job.stage("load", |_| {
            Scene::load_with(&self.tree, &load::Settings::default(), job)
        })?;
        let scene = scene.in_frame(tree.world_from_scene())?;
        let cloud = &tree.tree().meta().cloud;
        let origin = (&cloud.scene_hash, &cloud.settings[..]);
        warn_if_out_of_date(&scene, origin, &self.tree, context)?;
        Ok(Some(scene))
    }

    pub fn run(self, context: &Context) -> Result<()> {
        check_writable(&self.output, context.overwrite)?;
        let settings = self.settings();
        let points = PointFile::open(&self.points)?;
        points::check(&points, &self.output, &settings)?;
        let job = &context.job;
        let tree = OpenTree::open(&self.tree, job.memory_limit)?;
        let scene = self.scene(&tree, context)?;
        let held = points::check_memory(scene.as_ref(), tree.least_bytes(), job)?;
        let tree = tree.beside(held)?;
        job.heed_warnings()?;
        if self.planning.plan {
            let plan = Plan::of(&self.files(), held).with_tree(&tree);
            let plan = match &scene {
                Some(scene) => plan.with_scene(scene),
                None => plan,
            };
            let part = settings.part.of(points.count());
            let plan = plan.with("points", part.end - part.start);
            return plan.print(self.planning);
        }
        let summary = points::run(
            &tree,
            scene.as_ref(),
            &points,
            &self.output,
            &settings,
            context.overwrite,
            job,
        )?;
        job.progress.say(&format!(
            "{}: {} points with {}",
            self.output.display(),
            summary.points,
            summary.columns.join(" ")
        ));
        if let [first, ..] = points.left_out() {
            job.progress.say(&format!(
                "elements that are no points are left out: `{first}`"
            ));
        }
        times::say(context, "gather", &[]);
        Ok(())
    }
}

//! `lvox render`

use super::bake_options::BakeOptions;
use super::files::{Files, check_writable};
use super::kept::KeptTree;
use super::mix::add_up;
use super::options::{Context, Memory, Resume, Seed, Temporary};
use super::parse;
use super::plan::{Plan, Planning};
use super::scene_input::SceneInput;
use super::shade_options::ShadeOptions;
use super::times;
use crate::bounce::Bounces;
use crate::formats::{FileKind, Overwrite, TreeMeta};
use crate::run::Job;
use crate::scene::Scene;
use crate::tree::{OpenTree, TreeNeeds};
use crate::{Error, Result, bake, bounce, build};
use std::path::{Path, PathBuf};

/// Render a scene: bake, build, bounce and shade in one go
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    scene: SceneInput,

    /// Keep the tree in this .lvt file, for `lvox shade` [default: it is deleted]
    #[arg(long, value_name = "FILE")]
    keep_tree: Option<PathBuf>,

    /// Render the light of each group of the scene's lights apart, and write their sum with a layer
    /// light.NAME for each, which `lvox mix` lights anew
    #[arg(long, conflicts_with_all = ["keep_tree", "group", "resume", "plan"])]
    groups: bool,

    #[command(flatten)]
    bake: BakeOptions,

    /// Let light bounce and scatter so many times: `all`, or a number, with 1 as in the paper
    /// [default: all; 1 with --method traditional]
    #[arg(long, value_name = "N", value_parser = parse::bounces)]
    bounces: Option<Bounces>,

    #[command(flatten)]
    shade: ShadeOptions,

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
        let files = self.shade.files(self.scene.files());
        match &self.keep_tree {
            Some(tree) => files.writes("--keep-tree", tree),
            None => files,
        }
    }

    pub fn run(self, context: &Context) -> Result<()> {
        match self.groups {
            true => self.run_groups(context),
            false => self.run_as(&self.scene, &self.shade, context),
        }
    }

    /// Renders the light of each group, and adds them up.
    fn run_groups(&self, context: &Context) -> Result<()> {
        self.shade.check()?;
        let scene = self.scene.load(context)?;
        let groups = scene.groups.clone();
        self.scene.leave(scene, context);
        if groups.is_empty() {
            return Err(
                Error::input("the scene has no lights that could be in groups")
                    .hint("groups are those of a scene file (.toml)"),
            );
        }
        let folder = context.job.temporary_folder()?;
        let mut images = Vec::with_capacity(groups.len());
        for group in groups {
            let image = folder.path().join(format!("{group}.exr"));
            context.job.progress.say(&format!("group {group}"));
            let shade = self.shade.to(image.clone());
            self.run_as(&self.scene.lit_by(&group), &shade, context)?;
            images.push((group, image));
        }
        let images = images
            .iter()
            .map(|(group, image)| (Some(group.clone()), &**image));
        add_up(images, &[], self.shade.target(), context)
    }

    fn run_as(&self, scene: &SceneInput, shade: &ShadeOptions, context: &Context) -> Result<()> {
        let (input, options) = (scene, shade);
        let job = &context.job;
        options.check()?;
        crate::build::check_memory(job.memory_limit)?;
        if let Some(path) = &self.keep_tree
            && !context.kept.borrow().has_tree(path)
        {
            let overwrite = self.overwrite(context);
            refuse_tree(path, overwrite)?;
            check_writable(path, overwrite)?;
        }
        let bake = self.bake.settings(self.seed.seed);
        bake.check()?;
        let scene = input.load(context)?;
        let settings = self.stages(bake);
        let others = options.check_with(&scene, TreeNeeds::default(), job)?;
        job.heed_warnings()?;
        if self.planning.plan {
            let region = options.region(&scene)?;
            let held = others.max(bake::check_memory(&scene, &settings.bake, job)?);
            let plan = Plan::of(&self.files(), held).with_scene(&scene);
            let plan = plan.with("pixels", region.pixels() as u64);
            return plan.print(self.planning);
        }
        let (wanted, seed) = (settings.origin(&scene)?, self.seed.seed);
        let is_made = options.is_made_by(self.resume, &scene, &wanted, seed, job)?;
        if !is_made {
            let mut tree = self.tree(&scene, &settings, &wanted, context)?;
            if job.memory_limit.is_some() {
                tree.store = OpenTree::open(&tree.path, job.memory_limit)?.beside(others)?;
            }
            let shading = &options.settings;
            let settings = shading.resolve(&scene, &tree.store, seed, job)?;
            // Before there was a tree it was not known which settings an error takes.
            let resume = match shading.typed(seed) {
                Some(_) => Resume::default(),
                None => self.resume,
            };
            if !options.is_made(resume, &scene, &tree.store, &settings, job)? {
                options.run(&scene, &tree.store, &settings, job)?;
                times::say(context, "shade", &["bake", "build", "bounce", "pilot"]);
            }
            if context.frame.is_some() {
                context.kept.borrow_mut().leave_tree(tree);
            }
        }
        input.leave(scene, context);
        Ok(())
    }

    /// Whether the kept tree may be replaced.
    fn overwrite(&self, context: &Context) -> Overwrite {
        match &self.keep_tree {
            Some(path) => self.resume.overwrite(path, FileKind::Tree, context),
            None => Overwrite::Refuse,
        }
    }

    /// Settings of the stages before the last one.
    fn stages(&self, bake: bake::Settings) -> Stages {
        let usual = match self.shade.settings.lights_media() {
            true => Bounces::All,
            false => Bounces::Count(1),
        };
        let bounces = self.bounces.unwrap_or(usual);
        Stages {
            bake,
            build: build::Settings::default(),
            bounce: (bounces != Bounces::Count(1)).then(|| bounce::Settings {
                bounces,
                seed: self.seed.seed,
                ..bounce::Settings::default()
            }),
        }
    }

    /// The tree that is wanted: that of the frame before, one that is kept from an earlier run, or
    /// a new one.
    fn tree(
        &self,
        scene: &Scene,
        settings: &Stages,
        wanted: &TreeMeta,
        context: &Context,
    ) -> Result<KeptTree> {
        let job = &context.job;
        let is_wanted = |store: &OpenTree| {
            let found = store.tree().meta();
            store.world_from_scene() == scene.world_from_scene
                && found.made_with().eq(wanted.made_with())
        };
        let left = context.kept.borrow_mut().take_tree();
        let is_ours = |tree: &KeptTree| self.keep_tree.as_ref().is_none_or(|p| *p == tree.path);
        if let Some(tree) = left.filter(|tree| is_ours(tree) && is_wanted(&tree.store)) {
            return Ok(tree);
        }
        let overwrite = self.overwrite(context);
        if let Some(path) = &self.keep_tree {
            let is_same = || Ok(is_wanted(&OpenTree::open(path, job.memory_limit)?));
            if self.resume.is_made(path, is_same, job) {
                return Ok(KeptTree::new(
                    path.clone(),
                    OpenTree::open(path, job.memory_limit)?,
                    None,
                ));
            }
        }
        let folder = job.temporary_folder()?;
        let path = match &self.keep_tree {
            Some(path) => path.clone(),
            None => folder.path().join("scene.lvt"),
        };
        let store = settings.run(scene, folder.path(), &path, overwrite, job)?;
        Ok(KeptTree::new(path, store, Some(folder)))
    }
}

/// Refuses to replace a tree, as a run leaves one that ends while it shades, and says how to go on
/// from it.
fn refuse_tree(path: &Path, overwrite: Overwrite) -> Result<()> {
    let is_tree = || FileKind::of_file(path).is_ok_and(|kind| kind == FileKind::Tree);
    // A pipe would wait for someone to write.
    if overwrite == Overwrite::Replace || !path.is_file() || !is_tree() {
        return Ok(());
    }
    let hint = "--resume takes it if it is of this scene and these settings, --force replaces it";
    Err(Error::input(format!("{}: a tree is already there", path.display())).hint(hint))
}

/// Settings of the stages that make a tree.
struct Stages {
    bake: bake::Settings,
    build: build::Settings,
    /// If light bounces more than once.
    bounce: Option<bounce::Settings>,
}

impl Stages {
    /// What the tree that they make of a scene says of its origin, as far as it is known before.
    fn origin(&self, scene: &Scene) -> Result<TreeMeta> {
        let mut settings = self.build.listed();
        settings.extend(self.bounce.iter().flat_map(bounce::Settings::listed));
        Ok(TreeMeta {
            cloud: bake::origin(scene, &self.bake)?,
            settings,
            ..TreeMeta::default()
        })
    }

    /// Bakes, builds and bounces; what leads to the tree goes into a folder for temporary files.
    fn run(
        &self,
        scene: &Scene,
        folder: &Path,
        tree: &Path,
        overwrite: Overwrite,
        job: &Job,
    ) -> Result<OpenTree> {
        let cloud = folder.join("scene.lvc");
        bake::run(scene, &self.bake, &cloud, Overwrite::Replace, job)?;
        let Some(settings) = &self.bounce else {
            build::run(&cloud, tree, &self.build, overwrite, job)?;
            return OpenTree::open(tree, job.memory_limit);
        };
        let built = folder.join("built.lvt");
        build::run(&cloud, &built, &self.build, Overwrite::Replace, job)?;
        let store = OpenTree::open(&built, job.memory_limit)?;
        let held = bounce::check_memory(scene, store.tree(), settings, job)?;
        let store = store.beside(held)?;
        bounce::run(scene, &store, tree, settings, overwrite, job)?;
        OpenTree::open(tree, job.memory_limit)
    }
}

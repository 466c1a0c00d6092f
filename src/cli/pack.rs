//! `lvox pack`

use super::files::{Files, check_writable};
use super::options::{Context, Resume};
use super::out_of_date::warn_if_out_of_date;
use super::plan::{Plan, Planning};
use super::scene_input::SceneInput;
use crate::formats::FileKind;
use crate::pack;
use crate::scene::load::is_packed;
use crate::tree::OpenTree;
use crate::{Error, Result};
use std::path::{Path, PathBuf};

/// Pack a scene into one file that needs no other: every verb takes it in place of the scene
///
/// Triangles, textures and volumes lie in it ready for use, and nothing is read of the files that
/// the scene was made of. With --tree and --scatter it holds these, too; then `lvox shade` needs no
/// other file, and another machine none but this one.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    scene: SceneInput,

    /// Write the packed scene to this .lvp file
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,

    /// Pack this tree with the scene [default: that of a packed scene]
    #[arg(short, long, value_name = "FILE")]
    tree: Option<PathBuf>,

    /// Pack this light inside media, which was made from the tree [default: that of a packed scene,
    /// without --tree]
    #[arg(long, value_name = "FILE", requires = "tree")]
    scatter: Option<PathBuf>,

    #[command(flatten)]
    planning: Planning,

    #[command(flatten)]
    pub resume: Resume,
}

impl Args {
    /// What it reads and writes.
    pub fn files(&self) -> Files {
        let files = self.scene.files().writes("--output", &self.output);
        let tree = self.tree.iter().map(|path| ("tree", path));
        let light = self.scatter.iter().map(|path| ("--scatter", path));
        let parts = tree.chain(light);
        parts.fold(files, |files, (what, path)| files.reads(what, path))
    }

    pub fn run(self, context: &Context) -> Result<()> {
        check_name(&self.output)?;
        let overwrite = (self.resume).overwrite(&self.output, FileKind::Packed, context);
        check_writable(&self.output, overwrite)?;
        let job = &context.job;
        let files = self.files();
        let scene = self.scene.load(context)?;
        let (tree, light) = match self.tree {
            Some(tree) => (Some(tree), self.scatter),
            None => (
                scene.packed_tree().map(PathBuf::from),
                scene.packed_light().map(PathBuf::from),
            ),
        };
        if let Some(path) = &tree {
            let tree = OpenTree::open(path, job.memory_limit)?;
            let cloud = &tree.tree().meta().cloud;
            warn_if_out_of_date(&scene, (&cloud.scene_hash, &cloud.settings), path, context)?;
        }
        job.heed_warnings()?;
        if self.planning.plan {
            let held = job.process_bytes + scene.bytes();
            return Plan::of(&files, held)
                .with_scene(&scene)
                .taking(pack::expected_cpu_secs(&scene))
                .print(self.planning);
        }
        let files = pack::Files {
            tree: tree.as_deref(),
            light: light.as_deref(),
        };
        let is_same = || pack::has_made(&self.output, &scene, files);
        if self.resume.is_made(&self.output, is_same, job) {
            return Ok(());
        }
        pack::run(&scene, files, &self.output, overwrite, job)
    }
}

/// Refuses a name by which no verb would know the file as a scene: its extension tells.
fn check_name(output: &Path) -> Result<()> {
    if is_packed(output) {
        return Ok(());
    }
    let name = output.display();
    Err(
        Error::input(format!("{name}: a packed scene has to be named .lvp"))
            .hint(format!("name it {name}.lvp")),
    )
}

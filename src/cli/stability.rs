//! `lvox stability`

use super::files::Files;
use super::options::Context;
use super::output;
use super::scene_input::{Reading, SceneInput};
use crate::lab::stability::{self, Effort};
use crate::{Error, Result};
use std::path::PathBuf;

/// Check lvox against closed forms and at extremes
///
/// Print a table in which each case has its result, its expected value and its limit; exit with 1
/// if a case fails. It takes about a minute.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Compare the kernels with double precision on this scene: .toml, .gltf or .glb [default: the
    /// scene that is built in]
    #[arg(value_name = "SCENE")]
    scene: Option<PathBuf>,

    #[command(flatten)]
    reading: Reading,
}

impl Args {
    /// What it reads and writes.
    pub fn files(&self) -> Files {
        let scene = self.scene.iter();
        scene.fold(Files::default(), |files, path| files.reads("scene", path))
    }

    pub fn run(self, context: &Context) -> Result<()> {
        let is_built_in = self.scene.is_none();
        let scene = SceneInput::new(self.scene, is_built_in, self.reading).load(context)?;
        context.job.heed_warnings()?;
        let families = stability::run(&scene, Effort::Full, &context.job)?;
        output::print(&stability::markdown(&families))?;
        let rows = families.iter().flat_map(|f| &f.rows);
        let (total, failed) = (rows.clone().count(), rows.filter(|r| !r.passed()).count());
        if failed > 0 {
            return Err(Error::failed(format!("{failed} of {total} cases failed")));
        }
        Ok(())
    }
}

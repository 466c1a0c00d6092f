//! `lvox import`

use super::files::{Files, check_writable};
use super::options::{Context, Memory};
use super::times;
use crate::Result;
use crate::points::{self, ImportSettings, PointFile};
use std::path::PathBuf;

/// Import surfels that another program baked as a cloud, of which `build` makes a tree
///
/// A cloud has no lights, media or triangles of its own: gather from its tree with the cone kernel.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Import these points, in world space: a PLY file with `x y z`, `nx ny nz`, `radius` or
    /// `area`, and the radiance that leaves the front (W/m2/sr, linear Rec.709) as `r g b` or `red
    /// green blue` in floats; bytes are taken as sRGB. The back sends nothing
    #[arg(value_name = "POINTS")]
    points: PathBuf,

    /// Write the cloud to this .lvc file
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,

    /// Draw disks larger by this factor than the area of their points, or than a `radius` on its
    /// own, so that they leave no gaps. Points with `radius` and `area` are taken as they are
    #[arg(long, value_name = "K", default_value_t = ImportSettings::default().overlap)]
    overlap: f32,

    #[command(flatten)]
    pub memory: Memory,
}

impl Args {
    /// What it reads and writes.
    pub fn files(&self) -> Files {
        Files::default()
            .reads("points", &self.points)
            .writes("--output", &self.output)
    }

    pub fn run(self, context: &Context) -> Result<()> {
        check_writable(&self.output, context.overwrite)?;
        let points = PointFile::open(&self.points)?;
        let settings = ImportSettings {
            overlap: self.overlap,
        };
        let job = &context.job;
        points::import(&points, &self.output, &settings, context.overwrite, job)?;
        times::say(context, "import", &[]);
        Ok(())
    }
}

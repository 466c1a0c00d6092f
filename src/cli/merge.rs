//! `lvox merge`

use super::files::{Files, check_writable};
use super::options::{Context, Memory};
use crate::Result;
use crate::formats::Overwrite;
use crate::image::ImageKind;
use crate::image::merge;
use std::path::PathBuf;

/// Merge tiles into the frame that one process would have written, byte for byte
///
/// Refuse tiles that overlap, that leave pixels uncovered, or that were shaded from different
/// scenes, trees or settings, and name them.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Read these tiles, in any order
    #[arg(value_name = "TILE", required = true)]
    tiles: Vec<PathBuf>,

    /// Write the frame to this OpenEXR file; one that is there is replaced
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,

    #[command(flatten)]
    pub memory: Memory,
}

impl Args {
    /// What it reads and writes.
    pub fn files(&self) -> Files {
        let tiles = self.tiles.iter();
        tiles
            .fold(Files::default(), |files, tile| files.reads("tile", tile))
            .writes("--output", &self.output)
    }

    pub fn run(self, context: &Context) -> Result<()> {
        let job = &context.job;
        check_writable(&self.output, Overwrite::Replace)?;
        ImageKind::Exr.check_name("--output", &self.output)?;
        job.report.stage("merge", |counts| {
            let merged = merge(&self.tiles, &self.output, job)?;
            counts.insert("tiles".into(), merged.tiles as f64);
            counts.insert(
                "pixels".into(),
                f64::from(merged.width) * f64::from(merged.height),
            );
            Ok(())
        })
    }
}

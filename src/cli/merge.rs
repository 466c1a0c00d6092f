//! `lvox merge`

use super::files::{Files, check_writable};
use super::options::{Context, Memory};
use super::{output, parse};
use crate::formats::Overwrite;
use crate::image::{Exposure, ImageKind, Missing, Region, merge, missing};
use crate::{Error, Result};
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

    /// Write the frame to this .exr file, or as an array of float32 to this .npy file, or as a
    /// .png; one that is there is replaced
    #[arg(short, long, value_name = "FILE", required_unless_present = "missing")]
    output: Option<PathBuf>,

    /// Look at a .png with this factor on radiance, or with one that makes one lit pixel in fifty
    /// of the frame brighter than white (auto) [default: the exposure of the scene's film]
    #[arg(long, value_name = "E|auto", value_parser = parse::exposure, conflicts_with = "missing")]
    exposure: Option<Exposure>,

    /// Leave pixels black that no tile has, with a warning
    #[arg(long)]
    allow_missing: bool,

    /// Write no frame: print what to shade again, one line of options for each rectangle that no
    /// tile has, and nothing if all are there
    #[arg(long, conflicts_with_all = ["output", "allow_missing"])]
    missing: bool,

    #[command(flatten)]
    pub memory: Memory,
}

impl Args {
    /// What it reads and writes.
    pub fn files(&self) -> Files {
        let tiles = self.tiles.iter();
        let files = tiles.fold(Files::default(), |files, tile| files.reads("tile", tile));
        match &self.output {
            Some(output) => files.writes("--output", output),
            None => files,
        }
    }

    pub fn run(self, context: &Context) -> Result<()> {
        let job = &context.job;
        let Some(output) = &self.output else {
            let lines = missing(&self.tiles)?.into_iter().map(|gap| {
                let Region { x0, y0, x1, y1 } = gap;
                format!("--region {x0} {y0} {x1} {y1}\n")
            });
            return output::print(&lines.collect::<String>());
        };
        check_writable(output, Overwrite::Replace)?;
        if ImageKind::named(output)? != ImageKind::Png && self.exposure.is_some() {
            return Err(Error::input(format!(
                "--exposure needs a .png image, found --output {}",
                output.display()
            ))
            .hint("name the output .png, or leave the option out"));
        }
        let rest = match self.allow_missing {
            true => Missing::Black,
            false => Missing::Refuse,
        };
        job.stage("merge", |counts| {
            let merged = merge(&self.tiles, output, rest, self.exposure, job)?;
            counts.insert("tiles".into(), merged.tiles as f64);
            counts.insert(
                "pixels".into(),
                f64::from(merged.width) * f64::from(merged.height),
            );
            Ok(())
        })
    }
}

//! `lvox verify`

use super::files::Files;
use super::options::Context;
use super::output;
use crate::image::{ImageKind, exr};
use crate::inspect::verify;
use crate::{Error, Result};
use std::path::PathBuf;

/// Read all of a file and check it: damage, and that a tree conserves count, area, flux and
/// extinction of its cloud
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Read this .lvc, .lvt, .lvs, .lvp, .exr or .exr.sums file
    file: PathBuf,

    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

impl Args {
    /// What it reads and writes.
    pub fn files(&self) -> Files {
        Files::default().reads("file", &self.file)
    }

    pub fn run(self, context: &Context) -> Result<()> {
        if ImageKind::of(&self.file)? == Some(ImageKind::Exr) {
            let frame = exr::read(&self.file)?;
            let samples: usize = frame
                .layers
                .iter()
                .flat_map(|l| &l.channels)
                .map(|c| c.1.len())
                .sum();
            return if self.json {
                output::print_json(&serde_json::json!({
                    "file": self.file.to_string_lossy(), "kind": "image", "passed": true, "samples": samples
                }))
            } else {
                output::print(&format!("{samples} samples were read\n"))
            };
        }
        let found = verify(&self.file, &context.job)?;
        if self.json {
            output::print_json(&found)?;
        } else {
            output::print(&found.to_string())?;
        }
        if found.passed {
            Ok(())
        } else {
            Err(Error::input(format!(
                "{}: it does not conserve what was baked",
                self.file.display()
            ))
            .hint("build it again from its cloud"))
        }
    }
}

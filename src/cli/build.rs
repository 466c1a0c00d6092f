//! `lvox build`

use super::files::{Files, check_writable};
use super::options::{Context, Memory, Temporary};
use crate::Result;
use crate::build::Settings;
use std::path::PathBuf;

/// Build the tree over a cloud, within --memory-limit whatever the cloud's size
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Read this cloud
    #[arg(value_name = "CLOUD")]
    cloud: PathBuf,

    /// Write the tree to this .lvt file
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,

    #[command(flatten)]
    pub memory: Memory,

    #[command(flatten)]
    pub temporary: Temporary,
}

impl Args {
    /// What it reads and writes.
    pub fn files(&self) -> Files {
        Files::default()
            .reads("cloud", &self.cloud)
            .writes("--output", &self.output)
    }

    pub fn run(self, context: &Context) -> Result<()> {
        check_writable(&self.output, context.overwrite)?;
        crate::build::run(
            &self.cloud,
            &self.output,
            &Settings::default(),
            context.overwrite,
            &context.job,
        )?;
        Ok(())
    }
}

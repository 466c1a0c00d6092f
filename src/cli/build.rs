//! `lvox build`

use super::files::{Files, check_writable};
use super::options::{Context, Memory, Resume, Temporary};
use super::output;
use crate::Result;
use crate::build::Settings;
use crate::formats::FileKind;
use std::path::PathBuf;

/// Build the tree over a cloud, within --memory-limit whatever the cloud's size
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Read this cloud, or all parts of a bake
    #[arg(value_name = "CLOUD", required = true)]
    clouds: Vec<PathBuf>,

    /// Write the tree to this .lvt file
    #[arg(short, long, value_name = "FILE", required_unless_present = "plan")]
    output: Option<PathBuf>,

    /// Only say what it would take: bytes of the tree and of temporary files, memory and time on
    /// this machine, from a sample of the cloud
    #[arg(long)]
    plan: bool,

    /// With --plan: print one JSON object
    #[arg(long, requires = "plan")]
    json: bool,

    #[command(flatten)]
    pub resume: Resume,

    #[command(flatten)]
    pub memory: Memory,

    #[command(flatten)]
    pub temporary: Temporary,
}

impl Args {
    /// What it reads and writes.
    pub fn files(&self) -> Files {
        let mut files = Files::default();
        for cloud in &self.clouds {
            files = files.reads("cloud", cloud);
        }
        match &self.output {
            Some(output) if !self.plan => files.writes("--output", output),
            _ => files,
        }
    }

    pub fn run(self, context: &Context) -> Result<()> {
        let Some(output) = self.output.filter(|_| !self.plan) else {
            let plan = crate::build::plan(&self.clouds, &Settings::default(), &context.job)?;
            return if self.json {
                output::print_json(&plan)
            } else {
                output::print(&plan.to_string())
            };
        };
        let overwrite = (self.resume).overwrite(&output, FileKind::Tree, context);
        check_writable(&output, overwrite)?;
        let (clouds, settings, job) = (&self.clouds, Settings::default(), &context.job);
        let is_same = || crate::build::has_made(&output, clouds, &settings);
        if !self.resume.is_made(&output, is_same, job) {
            crate::build::run_parts(clouds, &output, &settings, overwrite, job)?;
        }
        Ok(())
    }
}

//! The command line: one file per verb, each with its arguments and what it does with them.
//!
//! A new verb is a file with `Args`, `files` and `run`, a variant of [`Verb`], and a line in [`Verb::files`] and
//! [`Verb::run`].

mod bake;
mod bake_options;
mod build;
mod compare;
mod inspect;
mod merge;
mod options;
pub mod output;
mod parse;
mod reference;
mod render;
mod scene_input;
mod shade;
mod shade_options;
mod study;
mod verify;

use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};
use lvox::Result;
use options::{Context, Files, Limits, Shared};
use std::process::ExitCode;

/// Render colour bleeding in scenes with smoke, cloud and CT volumes from a point cloud.
#[derive(Debug, Parser)]
#[command(name = "lvox", version, disable_help_subcommand = true)]
#[command(
    after_help = "Exit codes: 0 done; 1 failed, a retry may help; 2 wrong usage or input, do not retry.\n\
                        Data goes to stdout, everything else to stderr."
)]
pub struct Cli {
    #[command(subcommand)]
    verb: Verb,
    #[command(flatten)]
    shared: Shared,
}

#[derive(Debug, Subcommand)]
enum Verb {
    Render(render::Args),
    Bake(bake::Args),
    Build(build::Args),
    Shade(shade::Args),
    Merge(merge::Args),
    Inspect(inspect::Args),
    Verify(verify::Args),
    Compare(compare::Args),
    Reference(reference::Args),
    Study(study::Args),
}

impl Verb {
    /// What it reads and writes.
    fn files(&self) -> Files {
        match self {
            Self::Render(args) => args.files(),
            Self::Bake(args) => args.files(),
            Self::Build(args) => args.files(),
            Self::Shade(args) => args.files(),
            Self::Merge(args) => args.files(),
            Self::Inspect(args) => args.files(),
            Self::Verify(args) => args.files(),
            Self::Compare(args) => args.files(),
            Self::Reference(args) => args.files(),
            Self::Study(args) => args.files(),
        }
    }

    /// What its options allow it to take.
    fn limits(&self) -> Limits {
        let none = Limits::default();
        match self {
            Self::Render(args) => none.memory(args.memory).temporary(&args.temporary),
            Self::Build(args) => none.memory(args.memory).temporary(&args.temporary),
            Self::Study(args) => none.memory(args.memory).temporary(&args.temporary),
            Self::Shade(args) => none.memory(args.memory),
            Self::Merge(args) => none.memory(args.memory),
            Self::Compare(args) => none.memory(args.memory),
            Self::Reference(args) => none.memory(args.memory),
            Self::Bake(_) | Self::Inspect(_) | Self::Verify(_) => none,
        }
    }

    /// Runs, and names itself for the report.
    fn run(self, context: &Context) -> (&'static str, Result<()>) {
        match self {
            Self::Render(args) => ("render", args.run(context)),
            Self::Bake(args) => ("bake", args.run(context)),
            Self::Build(args) => ("build", args.run(context)),
            Self::Shade(args) => ("shade", args.run(context)),
            Self::Merge(args) => ("merge", args.run(context)),
            Self::Inspect(args) => ("inspect", args.run()),
            Self::Verify(args) => ("verify", args.run(context)),
            Self::Compare(args) => ("compare", args.run(context)),
            Self::Reference(args) => ("reference", args.run(context)),
            Self::Study(args) => ("study", args.run(context)),
        }
    }
}

/// Reads the command line; help and usage errors are printed and give the exit code.
pub fn parse() -> Result<Cli, ExitCode> {
    let parsed = command().try_get_matches();
    parsed
        .and_then(|m| Cli::from_arg_matches(&m))
        .map_err(|error| {
            // A closed pipe is no failure of help.
            let _ = error.print();
            ExitCode::from(u8::try_from(error.exit_code()).unwrap_or(2))
        })
}

/// What the command line may be. A number below zero is a value, of which its option says what is wrong with it.
fn command() -> clap::Command {
    let verbs = Cli::command();
    verbs.mut_subcommands(|verb| verb.allow_negative_numbers(true))
}

impl Cli {
    /// Runs the verb and writes the report.
    pub fn run(self) -> Result<()> {
        let mut context = self.shared.resolve(self.verb.limits())?;
        context.take_files(self.verb.files())?;
        let (verb, result) = self.verb.run(&context);
        let Some(path) = context.report_path() else {
            return result;
        };
        let written = context.job.report.write(&path, verb, result.as_ref().err());
        result.and(written)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn definitions_are_consistent() {
        command().debug_assert();
    }
}

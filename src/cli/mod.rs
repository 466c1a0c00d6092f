//! The command line: one file per verb, each with its arguments and what it does with them.
//!
//! What several verbs take stands in `*_options` and `scene_input`; `options` resolves what all of
//! them take into a `Context`, `files` checks what they read and write before the work, `parse`
//! reads values, `frames` and `kept` run a verb for several frames, `out_of_date` tells of files of
//! another scene, `progress`, `output` and `times` talk; `last_words` are said where no error can
//! be returned.
//!
//! A new verb is a file with `Args`, `files` and `run`, a variant of `Verb`, and a line in
//! `Verb::files` and `Verb::run`.

mod bake;
mod bake_options;
mod bounce;
mod build;
mod compare;
mod completions;
mod farm;
mod files;
mod frames;
mod gather;
mod import;
mod inspect;
mod kept;
mod last_words;
mod man;
mod merge;
mod mix;
mod options;
mod out_of_date;
mod output;
mod pack;
mod parse;
mod plan;
mod progress;
mod reference;
mod region_options;
mod render;
mod scatter;
mod scene_input;
mod shade;
mod shade_options;
mod shade_settings;
mod stability;
mod study;
mod tev;
mod tiles;
mod times;
mod tree_input;
mod verify;
mod version;

use crate::formats::{Overwrite, one_line};
use crate::{Error, Kind, Result};
use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};
use files::Files;
pub use last_words::memory::Allocator;
use options::{Context, Limits, Shared};
use std::ffi::OsString;
use std::process::ExitCode;

/// Render colour bleeding in scenes with smoke, cloud and CT volumes from a point cloud.
#[derive(Debug, Parser)]
#[command(name = "lvox", version, long_version = version::LONG.as_str())]
#[command(
    after_help = "`lvox help VERB` describes a verb. `lvox completions SHELL` and `lvox man DIR` \
                        are for packages.\n\
                        Exit codes: 0 done; 1 (or --retry-code) failed, a retry may help; 2 wrong \
                        usage or input, do not retry.\n\
                        Data goes to stdout, everything else to stderr."
)]
struct Cli {
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
    Bounce(bounce::Args),
    Pack(pack::Args),
    Scatter(scatter::Args),
    Tiles(tiles::Args),
    Shade(shade::Args),
    Gather(gather::Args),
    Import(import::Args),
    Merge(merge::Args),
    Mix(mix::Args),
    Farm(farm::Args),
    Inspect(inspect::Args),
    Verify(verify::Args),
    Compare(compare::Args),
    Reference(reference::Args),
    Study(study::Args),
    Stability(stability::Args),
    Completions(completions::Args),
    Man(man::Args),
}

impl Verb {
    /// What it reads and writes.
    fn files(&self) -> Files {
        match self {
            Self::Render(args) => args.files(),
            Self::Bake(args) => args.files(),
            Self::Build(args) => args.files(),
            Self::Bounce(args) => args.files(),
            Self::Pack(args) => args.files(),
            Self::Scatter(args) => args.files(),
            Self::Tiles(args) => args.files(),
            Self::Shade(args) => args.files(),
            Self::Gather(args) => args.files(),
            Self::Import(args) => args.files(),
            Self::Merge(args) => args.files(),
            Self::Mix(args) => args.files(),
            Self::Farm(args) => args.files(),
            Self::Inspect(args) => args.files(),
            Self::Verify(args) => args.files(),
            Self::Compare(args) => args.files(),
            Self::Reference(args) => args.files(),
            Self::Study(args) => args.files(),
            Self::Stability(args) => args.files(),
            Self::Completions(_) | Self::Man(_) => Files::default(),
        }
    }

    /// Whether it leaves what an earlier run made.
    fn resumes(&self) -> bool {
        let resume = match self {
            Self::Render(args) => args.resume,
            Self::Bake(args) => args.resume,
            Self::Build(args) => args.resume,
            Self::Bounce(args) => args.resume,
            Self::Pack(args) => args.resume,
            Self::Scatter(args) => args.resume,
            Self::Shade(args) => args.resume,
            _ => return false,
        };
        resume.is_given()
    }

    /// What its options allow it to take.
    fn limits(&self) -> Limits {
        let none = Limits::default();
        match self {
            Self::Bake(args) => none.memory(args.memory).temporary(&args.temporary),
            Self::Render(args) => none.memory(args.memory).temporary(&args.temporary),
            Self::Build(args) => none.memory(args.memory).temporary(&args.temporary),
            Self::Study(args) => none.memory(args.memory).temporary(&args.temporary),
            Self::Bounce(args) => none.memory(args.memory).temporary(&args.temporary),
            Self::Scatter(args) => none.memory(args.memory).temporary(&args.temporary),
            Self::Tiles(args) => none
                .memory(args.memory)
                .temporary(&args.temporary)
                .radiance_cache(args.radiance_cache.as_ref()),
            Self::Shade(args) => none
                .memory(args.memory)
                .temporary(&args.temporary)
                .radiance_cache(args.radiance_cache.as_ref())
                .gather_cache(args.gather_cache.as_ref()),
            Self::Gather(args) => none.memory(args.memory).temporary(&args.temporary),
            Self::Import(args) => none.memory(args.memory),
            Self::Merge(args) => none.memory(args.memory),
            Self::Mix(args) => none.memory(args.memory),
            Self::Compare(args) => none.memory(args.memory),
            Self::Reference(args) => none.memory(args.memory).temporary(&args.temporary),
            Self::Farm(_)
            | Self::Pack(_)
            | Self::Inspect(_)
            | Self::Verify(_)
            | Self::Stability(_)
            | Self::Completions(_)
            | Self::Man(_) => none,
        }
    }

    /// Runs, and names itself for the report.
    fn run(self, context: &Context) -> (&'static str, Result<()>) {
        match self {
            Self::Render(args) => ("render", args.run(context)),
            Self::Bake(args) => ("bake", args.run(context)),
            Self::Build(args) => ("build", args.run(context)),
            Self::Bounce(args) => ("bounce", args.run(context)),
            Self::Pack(args) => ("pack", args.run(context)),
            Self::Scatter(args) => ("scatter", args.run(context)),
            Self::Tiles(args) => ("tiles", args.run(context)),
            Self::Shade(args) => ("shade", args.run(context)),
            Self::Gather(args) => ("gather", args.run(context)),
            Self::Import(args) => ("import", args.run(context)),
            Self::Merge(args) => ("merge", args.run(context)),
            Self::Mix(args) => ("mix", args.run(context)),
            Self::Farm(args) => ("farm", args.run(context)),
            Self::Inspect(args) => ("inspect", args.run(context)),
            Self::Verify(args) => ("verify", args.run(context)),
            Self::Compare(args) => ("compare", args.run(context)),
            Self::Reference(args) => ("reference", args.run(context)),
            Self::Study(args) => ("study", args.run(context)),
            Self::Stability(args) => ("stability", args.run(context)),
            Self::Completions(args) => ("completions", args.run()),
            Self::Man(args) => ("man", args.run()),
        }
    }
}

/// Runs the verb that the command line names. Of errors one is printed, and they give the exit
/// code.
pub fn main() -> ExitCode {
    last_words::install();
    let result = match parse() {
        Ok(cli) => cli.run(),
        Err(exit) => return exit,
    };
    exit_code(result)
}

/// Prints an error, which gives the exit code.
fn exit_code(result: Result<()>) -> ExitCode {
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            output::print_error(&error);
            match error.kind() {
                Kind::Input => ExitCode::from(2),
                Kind::Failed | Kind::Cancelled => ExitCode::from(last_words::retry_code()),
            }
        }
    }
}

/// Reads the command line; help and usage errors are printed and give the exit code.
fn parse() -> Result<Cli, ExitCode> {
    parse_words(std::env::args_os().collect())
}

/// Reads these words as a command line.
fn parse_words(words: Vec<OsString>) -> Result<Cli, ExitCode> {
    let parsed = command().try_get_matches_from(&words);
    // Words of the command line are told as they can be shown.
    let parsed = parsed.map_err(|error| {
        let shown = words.iter().map(|word| one_line(word.to_string_lossy()));
        let again = command().try_get_matches_from(shown).err();
        again.unwrap_or(error)
    });
    parsed
        .and_then(|m| Cli::from_arg_matches(&m))
        .map_err(|error| {
            // A closed pipe is no failure of help.
            let _ = error.print();
            if let Some(variable) = variable_of(&error, &words) {
                eprintln!("hint: this is the value of {variable} in the environment");
            }
            if let Some(hint) = hint_for_farm(&error, &words) {
                eprintln!("hint: {hint}");
            }
            ExitCode::from(u8::try_from(error.exit_code()).unwrap_or(2))
        })
}

/// The variable of the environment that an error is about: no word names its option.
fn variable_of(error: &clap::Error, words: &[OsString]) -> Option<String> {
    use clap::error::{ContextKind, ContextValue};
    let Some(ContextValue::String(told)) = error.get(ContextKind::InvalidArg) else {
        return None;
    };
    let option = told.split([' ', '=']).next()?;
    let name = option.strip_prefix("--")?;
    let is_typed = |word: &OsString| word.to_string_lossy().starts_with(option);
    let variable = format!("LVOX_{}", name.replace('-', "_").to_uppercase());
    let is_set = std::env::var_os(&variable).is_some();
    (is_set && !words.iter().any(is_typed)).then_some(variable)
}

/// What to write where `lvox farm` was given an option of one of the stages of its job.
fn hint_for_farm(error: &clap::Error, words: &[OsString]) -> Option<String> {
    use clap::error::{ContextKind, ContextValue, ErrorKind};
    let mut words = words.iter().skip(1).map(|word| word.to_string_lossy());
    let verb = words.by_ref().find(|word| !word.starts_with('-'))?;
    if verb != "farm" || error.kind() != ErrorKind::UnknownArgument {
        return None;
    }
    let Some(ContextValue::String(told)) = error.get(ContextKind::InvalidArg) else {
        return None;
    };
    let option = told.split([' ', '=']).next()?;
    let name = option.strip_prefix("--")?;
    let verbs = command();
    let has = |stage: &&str| {
        let stage = verbs.find_subcommand(stage);
        stage.is_some_and(|verb| verb.get_arguments().any(|o| o.get_long() == Some(name)))
    };
    let stage = ["shade", "bake", "bounce", "scatter"]
        .into_iter()
        .find(has)?;
    let typed = words.find(|word| word.starts_with(option))?;
    let value = words.next().filter(|value| !value.starts_with('-'));
    let value = value.filter(|_| typed == option);
    let value = value.map_or(String::new(), |value| format!(" {value}"));
    Some(format!(
        "options of `lvox {stage}` go in quotes: --{stage} \"{typed}{value}\""
    ))
}

/// What the command line may be. A number below zero is a value, of which its option says what is
/// wrong with it.
fn command() -> clap::Command {
    let verbs = Cli::command();
    verbs.mut_subcommands(|verb| verb.allow_negative_numbers(true))
}

/// Refuses words that are no command line, in one line.
fn check_words(words: Vec<String>) -> Result<(), String> {
    let parsed = command().try_get_matches_from(words);
    let parsed = parsed.and_then(|matches| Cli::from_arg_matches(&matches));
    parsed.map(drop).map_err(|error| {
        let text = error.to_string();
        let line = text.lines().next().unwrap_or_default();
        line.trim_start_matches("error: ").to_owned()
    })
}

/// Whether any verb has an option of this long name.
fn has_option(name: &str) -> bool {
    let verbs = command();
    let mut options = verbs
        .get_subcommands()
        .flat_map(clap::Command::get_arguments);
    options.any(|o| o.get_long() == Some(name))
        || verbs.get_arguments().any(|o| o.get_long() == Some(name))
}

impl Cli {
    /// Runs the verb, once or for each frame, and writes reports.
    fn run(self) -> Result<()> {
        let is_farm = matches!(self.verb, Verb::Farm(_));
        let frames = self.shared.frames.clone();
        let Some(frames) = frames.filter(|_| !is_farm) else {
            if !is_farm {
                frames::refuse_tokens(std::env::args_os())?;
            }
            let mut context = self.shared.resolve(self.verb.limits())?;
            return run_verb(self.verb, &mut context);
        };
        frames::check_outputs(&self.verb.files(), &frames)?;
        let numbers = frames.numbers();
        let mut context = None;
        for &frame in numbers {
            let words = frames::words(std::env::args_os(), frame);
            let cli = parse_words(words).map_err(|_| {
                // It was printed.
                Error::input(format!("frame {frame} makes no command line"))
            })?;
            let (verb, report) = (cli.verb, cli.shared.report.clone());
            let limits = verb.limits();
            let context = match &mut context {
                Some(context) => context,
                none => none.insert(cli.shared.resolve(limits.clone())?),
            };
            context.go_to_frame(frame, report, limits);
            if numbers.len() > 1 {
                context.job.progress.say(&format!("frame {frame}"));
            }
            run_verb(verb, context).map_err(|e| e.at(format!("frame {frame}")))?;
        }
        Ok(())
    }
}

/// Runs a verb, and writes the report.
fn run_verb(verb: Verb, context: &mut Context) -> Result<()> {
    if verb.resumes() && context.overwrite == Overwrite::Replace {
        return Err(Error::input(
            "--resume leaves what is made already, and --force makes it again: \
             expected one of them",
        )
        .hint("leave one of them out"));
    }
    context.take_files(verb.files())?;
    let (verb, result) = verb.run(context);
    let result = result.and_then(|()| context.job.heed_warnings());
    let Some(path) = context.report_path() else {
        return result;
    };
    let written = context.job.report.write(&path, verb, result.as_ref().err());
    result.and(written)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bake::BlockSize;
    use crate::bake::{self, SurfelSampling};
    use crate::lab::{reference, study};
    use crate::shade::{self, Kernel, Method, Quality};
    use clap::Arg;

    #[test]
    fn definitions_are_consistent() {
        command().debug_assert();
    }

    fn option(verb: &str, name: &str) -> Arg {
        let verbs = command();
        let verb = verbs.find_subcommand(verb).unwrap();
        let mut options = verb.get_arguments();
        let found = options.find(|o| o.get_long() == Some(name));
        found.unwrap_or_else(|| panic!("--{name}")).clone()
    }

    /// What the help says is the default.
    fn told(verb: &str, name: &str) -> String {
        let option = option(verb, name);
        if let [value] = option.get_default_values() {
            return value.to_str().unwrap().to_owned();
        }
        let help = option.get_help().unwrap().to_string();
        let told = help.split("[default: ").nth(1).unwrap();
        told.strip_suffix(']').unwrap().to_owned()
    }

    fn list<T: ToString>(values: &[T], between: &str) -> String {
        let texts: Vec<String> = values.iter().map(T::to_string).collect();
        texts.join(between)
    }

    #[test]
    fn help_tells_the_defaults_of_baking() {
        let settings = bake::Settings::default();
        assert_eq!(settings.surfels, SurfelSampling::ByLight);
        let BlockSize::OpticalDepth(depth) = settings.blocks else {
            panic!("{settings:?}")
        };
        for verb in ["bake", "render"] {
            assert!(told(verb, "surfels").starts_with("500000, or 125000"));
            assert_eq!(told(verb, "block-depth"), depth.to_string());
            let rays = settings.shadow_rays.to_string();
            assert_eq!(told(verb, "bake-shadow-rays"), rays);
        }
    }

    #[test]
    fn help_tells_the_defaults_of_scattering() {
        let settings = crate::scatter::Settings::default();
        for (name, expected) in [
            ("volume-samples", settings.volume_samples.to_string()),
            ("max-solid-angle", settings.max_solid_angle.to_string()),
            ("shadow-rays", settings.shadow_rays.to_string()),
        ] {
            assert_eq!(told("scatter", name), expected, "--{name}");
        }
    }

    #[test]
    fn help_tells_the_presets_of_shading() {
        type Read = fn(&shade::Settings) -> String;
        fn name_of<T: PartialEq>(table: &[(&str, T)], value: &T) -> String {
            table.iter().find(|row| row.1 == *value).unwrap().0.into()
        }
        let presets = Quality::ALL.map(|(_, quality)| shade::Settings::of(quality));
        let numbers: [(&str, Read); 9] = [
            ("samples", |s| s.samples.to_string()),
            ("max-solid-angle", |s| s.max_solid_angle.to_string()),
            ("patch-surfels", |s| s.patch_surfels.to_string()),
            ("lattice", |s| s.lattice.to_string()),
            ("volume-samples", |s| s.volume_samples.to_string()),
            ("pixel-samples", |s| s.pixel_samples.to_string()),
            ("corner-spacing", |s| s.corner_spacing.to_string()),
            ("edge-samples", |s| s.edge_samples.to_string()),
            ("shadow-rays", |s| s.shadow_rays.to_string()),
        ];
        for (name, number) in numbers {
            let values = presets.each_ref().map(number);
            let expected = if values.iter().all(|v| *v == values[0]) {
                values[0].clone()
            } else {
                list(&values, ", ") + " by quality"
            };
            assert_eq!(told("shade", name), expected, "--{name}");
        }
        let default = shade::Settings::default();
        for (name, expected) in [
            ("quality", name_of(&Quality::ALL, &Quality::default())),
            ("kernel", name_of(&Kernel::ALL, &default.kernel)),
            ("method", name_of(&Method::ALL, &default.method)),
        ] {
            assert_eq!(told("shade", name), expected, "--{name}");
        }
        assert_eq!(default, shade::Settings::of(Quality::default()));
    }

    #[test]
    fn help_tells_the_defaults_of_studies_and_references() {
        let (settings, quick) = (study::Settings::default(), study::Settings::quick());
        for (name, expected) in [
            ("spp", list(&settings.spp, ",")),
            ("surfels", list(&settings.surfels, ",")),
            ("block-depth", list(&settings.block_depth, ",")),
            ("block-voxels", list(&settings.block_voxels, ",")),
            ("samples", list(&settings.samples, ",")),
            ("max-solid-angle", list(&settings.max_solid_angle, ",")),
            (
                "rounds",
                format!("{}, quick: {}", settings.rounds, quick.rounds),
            ),
            (
                "reference-spp",
                format!("{}, quick: {}", settings.reference_spp, quick.reference_spp),
            ),
        ] {
            assert_eq!(told("study", name), expected, "--{name}");
        }
        let spp = reference::Settings::default().spp.unwrap();
        assert_eq!(told("reference", "spp"), format!("{spp}, without --time"));
    }
}

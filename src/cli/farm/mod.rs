//! `lvox farm`: the whole way from a scene to its images as tasks for schedulers that exist.
//!
//! A scene and options of a job enter, a [`plan::Plan`] is made of them, and one of `commands`,
//! `slurm` and `openjd` says it in the words of a scheduler. Nothing is run.

mod commands;
mod openjd;
mod plan;
mod slurm;

use super::files::Files;
use super::options::{Context, Seed};
use super::scene_input::{SceneInput, utf8};
use super::{output, parse, progress};
use crate::bounce::Bounces;
use crate::image::ImageKind;
use crate::run::{Frames, OnWarning, frames};
use crate::scene::Scene;
use crate::{Error, Result};
use clap::Subcommand;
use plan::{CAMERA, Plan, Step, Words};
use std::collections::BTreeSet;
use std::path::PathBuf;

/// Print the whole job of a scene for a farm: bake in parts, build, bounce, scatter and pack, then
/// tiles of frames, and merge
///
/// Nothing is run or written: pipe what is printed to a shell, or to a file for the scheduler.
/// Every task may be run again; what is made already is left as it is. With --frames the job has
/// all of them. Frames whose scene has other files get a cloud and a tree of their own, others
/// share one.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(subcommand)]
    form: Form,
}

/// What is printed.
#[derive(Debug, Subcommand)]
enum Form {
    /// Print one command a line, in an order that leads to the images, for a shell, GNU parallel,
    /// xargs or OpenCue. Those of one step may run in any order, or all at once
    Commands {
        #[command(flatten)]
        job: Box<JobOptions>,

        /// Print the commands of this step alone. What a job has of them, in their order: bake,
        /// tree, cut, tile and merge, or bake, tree and frame
        #[arg(long, value_name = "STEP", value_parser = parse::one_of(&Step::ALL))]
        step: Option<Step>,
    },
    /// Print a shell script that submits the job to Slurm, as job arrays that wait for each other
    Slurm {
        #[command(flatten)]
        job: Box<JobOptions>,

        /// Give these options to every sbatch, as "--partition=main --time=60"
        #[arg(long, value_name = "OPTIONS", value_parser = words, allow_hyphen_values = true)]
        sbatch: Option<Words>,
    },
    /// Print a template of Open Job Description, for `openjd run`, AWS Deadline Cloud and others
    Openjd {
        #[command(flatten)]
        job: Box<JobOptions>,
    },
    /// Print every file that the scene reads in these frames, one a line
    Files {
        #[command(flatten)]
        scene: Box<SceneInput>,
    },
}

/// What the job is.
#[derive(Debug, clap::Args)]
struct JobOptions {
    #[command(flatten)]
    scene: SceneInput,

    /// Write images to this file, whose folder is made; with several frames its name needs ####,
    /// with several cameras {camera}
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,

    /// Look through these cameras [default: the first]
    #[arg(long, value_name = "NAME", value_delimiter = ',')]
    cameras: Vec<String>,

    /// Shade each image in so many tiles of about equal work, and merge them
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=65_536))]
    tiles: u32,

    /// Bake in so many parts
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=65_536))]
    parts: u32,

    /// Shade so many frames in one task, which load once what they share. Only without tiles
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=150))]
    chunk: u32,

    /// Let light bounce and scatter so many times: `all`, or a number, with 1 as in the paper
    #[arg(long, value_name = "N", default_value_t = Bounces::All, value_parser = parse::bounces)]
    bounces: Bounces,

    /// Have every tile light the media it sees, rather than all media once
    #[arg(long)]
    no_scatter: bool,

    /// Give these options to `lvox bake`, as "--surfels 1000000"
    #[arg(long, value_name = "OPTIONS", value_parser = words, allow_hyphen_values = true)]
    bake: Option<Words>,

    /// Give these options to `lvox bounce`
    #[arg(long, value_name = "OPTIONS", value_parser = words, allow_hyphen_values = true)]
    bounce: Option<Words>,

    /// Give these options to `lvox scatter`
    #[arg(long, value_name = "OPTIONS", value_parser = words, allow_hyphen_values = true)]
    scatter: Option<Words>,

    /// Give these options to `lvox shade`, as "--quality best --aov depth,normal"
    #[arg(long, value_name = "OPTIONS", value_parser = words, allow_hyphen_values = true)]
    shade: Option<Words>,

    /// Put what tasks hand to each other into this folder, which all machines share, and which no
    /// other job may have [default: farm/SCENE, or farm/SCENE.GROUP]
    #[arg(long, value_name = "DIR")]
    folder: Option<PathBuf>,

    /// Call the program so; a template of Open Job Description has this as the default of its
    /// parameter Lvox
    #[arg(long, value_name = "PROGRAM", default_value = "lvox")]
    program: String,

    /// Let each task use so many threads [default: all cores of its machine]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    task_threads: Option<u16>,

    /// Let each task hold so much memory, as 4G [default: no limit]
    #[arg(long, value_name = "SIZE", value_parser = parse::size)]
    task_memory: Option<u64>,

    /// Let tasks show their progress so [default: openjd in a template of it, auto elsewhere]
    #[arg(long, value_name = "MODE")]
    task_progress: Option<progress::Mode>,

    #[command(flatten)]
    seed: Seed,
}

/// Options in quotes, as a shell would part them.
fn words(text: &str) -> Result<Words, String> {
    let words = shlex::split(text).ok_or("a quote in it has no end")?;
    Ok(Words(words))
}

impl Args {
    /// What it reads and writes.
    pub fn files(&self) -> Files {
        match &self.form {
            Form::Commands { job, .. } | Form::Slurm { job, .. } | Form::Openjd { job } => {
                job.scene.files()
            }
            Form::Files { scene } => scene.files(),
        }
    }

    pub fn run(self, context: &Context) -> Result<()> {
        let frames = context.frames.as_ref();
        let text = match self.form {
            Form::Commands { job, step } => commands::text(&job.plan(frames, context)?, step)?,
            Form::Slurm { job, sbatch } => {
                slurm::text(&job.plan(frames, context)?, &sbatch.unwrap_or_default())?
            }
            Form::Openjd { mut job } => {
                let mode = job.task_progress.unwrap_or(progress::Mode::Openjd);
                job.task_progress = Some(mode);
                openjd::text(&job.plan(frames, context)?)?
            }
            Form::Files { scene } => list(&scene, frames, context)?,
        };
        output::print(&text)
    }
}

/// Loads the scene of a frame.
fn load(input: &SceneInput, frame: Option<i32>, context: &Context) -> Result<Scene> {
    match frame {
        Some(number) => input.at_frame(number).load_at(frame, context),
        None => {
            input.refuse_tokens()?;
            input.load_at(None, context)
        }
    }
}

/// Every file of the scene, each once. Where none is that of a frame, one look is enough.
fn list(input: &SceneInput, frames: Option<&Frames>, context: &Context) -> Result<String> {
    let numbers = frames.map_or(&[][..], Frames::numbers);
    let scene = load(input, numbers.first().copied(), context)?;
    let mut paths = scene.files;
    if scene.files_of_frame.is_some() || input.has_tokens() {
        for &frame in numbers.iter().skip(1) {
            paths.extend(load(input, Some(frame), context)?.files);
        }
    }
    let mut seen = BTreeSet::new();
    paths.retain(|path| seen.insert(path.clone()));
    let lines = paths.iter().map(|path| format!("{}\n", path.display()));
    Ok(lines.collect())
}

impl JobOptions {
    /// Checks the job as far as a look at the first frame tells, and plans it.
    fn plan(self, frames: Option<&Frames>, context: &Context) -> Result<Plan> {
        let first = frames.map(|frames| frames.numbers()[0]);
        let scene = load(&self.scene, first, context)?;
        for name in &self.cameras {
            scene.camera(Some(name))?;
            // It becomes part of file names and of command lines.
            let is_plain = |c: char| c.is_alphanumeric() || " ._-".contains(c);
            if !name.chars().all(is_plain) {
                return Err(Error::input(format!(
                    "camera `{name}`: expected a name of letters, digits, spaces, dots and dashes"
                ))
                .hint("give the camera another name in the scene"));
            }
        }
        self.check_output(frames, &scene)?;
        let scatters = !self.no_scatter && self.may_scatter(&scene, frames, context)?;
        let plan = Plan {
            name: scene.name.clone(),
            scene: self.scene.words()?,
            frames: frames.cloned(),
            has_own_files: scene.files_of_frame.is_some() || self.scene.has_tokens(),
            cameras: self.cameras.clone(),
            tiles: self.tiles,
            parts: self.parts,
            chunk: self.chunk,
            bounces: self.bounces,
            scatters,
            folder: match &self.folder {
                Some(folder) => utf8("--folder", folder)?,
                None => format!("farm/{}", self.scene.short_name()?),
            },
            output: utf8("--output", &self.output)?,
            program: self.program.clone(),
            seed: self.seed.seed,
            threads: self.task_threads,
            memory: self.task_memory,
            progress: self.task_progress,
            is_strict: context.job.on_warning == OnWarning::Fail,
            bake: self.bake.unwrap_or_default(),
            bounce: self.bounce.unwrap_or_default(),
            scatter: self.scatter.unwrap_or_default(),
            shade: self.shade.unwrap_or_default(),
        };
        plan.check()?;
        Ok(plan)
    }

    /// Whether any frame may have media whose light is the same for all cameras.
    fn may_scatter(
        &self,
        first: &Scene,
        frames: Option<&Frames>,
        context: &Context,
    ) -> Result<bool> {
        let may = |scene: &Scene| {
            // Smoke may rise in a later frame.
            let may_be_empty = scene.has_empty_volumes || scene.packed_path().is_some();
            let may_have_more = scene.files_of_frame.is_some() && may_be_empty;
            may_have_more || scene.volumes.iter().any(|v| v.phase.is_isotropic())
        };
        if may(first) || !self.scene.has_tokens() {
            return Ok(may(first));
        }
        let numbers = frames.map_or(&[][..], Frames::numbers);
        for &frame in numbers.iter().skip(1) {
            if may(&load(&self.scene, Some(frame), context)?) {
                return Ok(true);
            }
        }
        Ok(false)
    }

    fn check_output(&self, frames: Option<&Frames>, scene: &Scene) -> Result<()> {
        let name = self.output.to_string_lossy();
        let wrong = |message: String, hint: &str| {
            Err(Error::input(format!("--output {name}: {message}")).hint(hint))
        };
        let is_exr = ImageKind::named(&self.output)? == ImageKind::Exr;
        if self.tiles > 1 && !is_exr {
            return wrong(
                "tiles are merged to an .exr image".into(),
                "name the output .exr, or leave out --tiles",
            );
        }
        if self.tiles > 1 && self.chunk > 1 {
            return Err(
                Error::input("--chunk is for whole frames, found --tiles too")
                    .hint("leave one of them out"),
            );
        }
        let pixels = u64::from(scene.film.width) * u64::from(scene.film.height);
        if u64::from(self.tiles) > pixels {
            return Err(Error::input(format!(
                "expected at most a tile for each of {pixels} pixels, found --tiles {}",
                self.tiles
            )));
        }
        let token = frames::token_in(&name);
        match (frames, token) {
            (None, Some(token)) => wrong(
                format!("{token} stands for the number of a frame, but there are no frames"),
                "give --frames, as 1-10",
            ),
            (Some(frames), None) if frames.numbers().len() > 1 => wrong(
                "all frames would write the same file".into(),
                "put #### for the number of the frame into its name, as out.####.exr",
            ),
            _ if self.cameras.len() > 1 && !name.contains(CAMERA) => wrong(
                "all cameras would write the same file".into(),
                "put {camera} for its name into the name of the file, as out.{camera}.exr",
            ),
            _ => Ok(()),
        }
    }
}

//! Options that verbs share: as typed, and as resolved.

use super::files::{Files, Named, check_apart, check_writable};
use super::kept::Kept;
use super::{last_words, parse, progress};
use crate::formats::{FileKind, Overwrite, emergency};
use crate::lab::reference::Start;
use crate::run::{Frames, Job, OnWarning, Report, memory};
use crate::{Error, Result};
use std::cell::RefCell;
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

/// Threads beyond this only spin for work that there is not.
const MOST_THREADS: i64 = 1024;

/// Options that every verb has, as typed.
#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Shared options")]
pub struct Shared {
    /// Use this many threads; results do not depend on it [default: all cores]
    #[arg(
        long,
        global = true,
        value_name = "N",
        env = "LVOX_THREADS",
        hide_env_values = true
    )]
    #[arg(value_parser = clap::value_parser!(u16).range(1..=MOST_THREADS))]
    threads: Option<u16>,

    /// Show progress on stderr; auto is a bar on a terminal and plain lines elsewhere
    #[arg(long, global = true, value_name = "MODE", default_value = "auto")]
    #[arg(env = "LVOX_PROGRESS", hide_env_values = true)]
    progress: progress::Mode,

    /// Show warnings and errors alone, as --progress none does
    #[arg(short, long, global = true)]
    quiet: bool,

    /// Replace clouds, trees and exports that exist, and begin references and studies anew; images
    /// and reports are always replaced
    #[arg(long, global = true)]
    force: bool,

    /// Treat every warning as an error with exit code 2, before the work and without output where
    /// possible. What only the work itself can show, such as missing surfels, fails at its end:
    /// shade and render then write no image, reference and study keep what they have
    #[arg(long, global = true)]
    strict: bool,

    /// Refuse a tree or scattered light of another scene, of which there is a warning otherwise,
    /// with exit code 2; tasks of `lvox farm` do
    #[arg(long, global = true)]
    same_scene: bool,

    /// Write times, peak memory and counts to this file as JSON
    #[arg(long, global = true, value_name = "FILE")]
    pub report: Option<PathBuf>,

    /// Run once for each of these frames, as 1-10, 1-10x2 or 1,5,9. The number of the frame takes
    /// the place of ####, %04d or $F4 in options and in names of files in the scene, and cameras
    /// that move are where they are in that frame
    #[arg(long, global = true, value_name = "RANGE", allow_hyphen_values = true, value_parser = parse::frames)]
    pub frames: Option<Frames>,

    /// Exit with this code where a retry may help, for schedulers that take 1 for the end; Grid
    /// Engine repeats a job that exits with 99
    #[arg(long, global = true, value_name = "CODE", default_value_t = 1, value_parser = parse::retry_code)]
    #[arg(env = "LVOX_RETRY_CODE", hide_env_values = true)]
    retry_code: u8,
}

/// For verbs whose memory has a bound.
#[derive(Clone, Copy, Debug, Default, clap::Args)]
#[command(next_help_heading = "Shared options")]
pub struct Memory {
    /// Hold at most this much in memory, with the scene and the program itself; files that are
    /// mapped may come on top by a tenth. Voxels that take more than a quarter of it lie in temporary
    /// files. What needs more is refused before it begins. In bytes, or with K, M, G, T (powers of
    /// 1024), as 64M or 4G [default: no limit]
    #[arg(long, value_name = "SIZE", value_parser = parse::size)]
    #[arg(env = "LVOX_MEMORY_LIMIT", hide_env_values = true)]
    memory_limit: Option<u64>,
}

/// For verbs that may need temporary files.
#[derive(Clone, Debug, Default, clap::Args)]
#[command(next_help_heading = "Shared options")]
pub struct Temporary {
    /// Put temporary files into this folder [default: the system's]
    #[arg(
        long,
        value_name = "DIR",
        env = "LVOX_TEMP_DIR",
        hide_env_values = true
    )]
    temp_dir: Option<PathBuf>,
}

/// For verbs that choose at random.
#[derive(Clone, Copy, Debug, clap::Args)]
#[command(next_help_heading = "Shared options")]
pub struct Seed {
    /// Seed all random choices; the same seed gives the same result
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub seed: u64,
}

/// For verbs whose output may be there from an earlier run.
#[derive(Clone, Copy, Debug, Default, clap::Args)]
pub struct Resume {
    /// Leave an output as it is that an earlier run made of the same scene and settings, and make
    /// it again if it is of others. What counts is what files say of their origin, not when they
    /// were written
    #[arg(long)]
    resume: bool,
}

impl Resume {
    /// Whether a run goes on from what is there.
    pub fn is_given(self) -> bool {
        self.resume
    }

    /// Whether an output may be replaced: one that is of the right kind, but of another origin, or
    /// one that the same command, run beside this one, makes meanwhile.
    pub fn overwrite(self, path: &Path, kind: FileKind, context: &Context) -> Overwrite {
        let is_free = || path.symlink_metadata().is_err();
        let is_of_kind = || FileKind::of_file(path).is_ok_and(|found| found == kind);
        match self.resume && (is_free() || is_of_kind()) {
            true => Overwrite::Replace,
            false => context.overwrite,
        }
    }

    /// Whether an output is there that needs not be made again; says so.
    pub fn is_made(self, path: &Path, is_same: impl FnOnce() -> Result<bool>, job: &Job) -> bool {
        if !self.resume || !path.exists() {
            return false;
        }
        let is_same = is_same().unwrap_or(false);
        let path = path.display();
        job.progress.say(&match is_same {
            true => format!("{path} is there, made of the same scene and settings"),
            false => format!("{path} is not of this scene and these settings: making it again"),
        });
        is_same
    }
}

/// What a verb may take of the machine.
#[derive(Clone, Debug, Default)]
pub struct Limits {
    memory: Option<u64>,
    temp_dir: Option<PathBuf>,
    radiance_cache: Option<PathBuf>,
    gather_cache: Option<PathBuf>,
}

impl Limits {
    /// At most so much memory.
    #[must_use]
    pub fn memory(mut self, memory: Memory) -> Self {
        self.memory = memory.memory_limit;
        self
    }

    /// Temporary files in this folder.
    #[must_use]
    pub fn temporary(mut self, temporary: &Temporary) -> Self {
        self.temp_dir.clone_from(&temporary.temp_dir);
        self
    }

    /// Radiance of surfaces in this file.
    #[must_use]
    pub fn radiance_cache(mut self, file: Option<&PathBuf>) -> Self {
        self.radiance_cache = file.cloned();
        self
    }

    /// Gathers of a frame in this file.
    #[must_use]
    pub fn gather_cache(mut self, file: Option<&PathBuf>) -> Self {
        self.gather_cache = file.cloned();
        self
    }
}

/// Shared options as resolved; what a verb runs with.
#[derive(Debug)]
pub struct Context {
    /// Progress, cancellation, report, limits.
    pub job: Job,
    /// Whether clouds, trees and exports may be replaced, and what was begun is begun anew.
    pub overwrite: Overwrite,
    /// Whether trees and scattered light have to be of the scene at hand.
    pub same_scene: bool,
    /// Where the report goes.
    report_path: RefCell<Option<PathBuf>>,
    /// What the verb writes, by the words for it.
    outputs: Vec<(&'static str, PathBuf)>,
    /// Those frames that were asked for.
    pub frames: Option<Frames>,
    /// The one at hand.
    pub frame: Option<i32>,
    /// What the frame before has left.
    pub kept: RefCell<Kept>,
    /// How many stages of the report are those of frames before.
    pub first_stage: usize,
}

impl Context {
    /// Goes to the next of several frames, of which each may have its own report and caches.
    pub fn go_to_frame(&mut self, frame: i32, report: Option<PathBuf>, limits: Limits) {
        if *self.report_path.get_mut() != report {
            self.report_path = RefCell::new(report);
            self.job.report = Report::default();
        }
        self.job.radiance_cache = limits.radiance_cache;
        self.job.gather_cache = limits.gather_cache;
        self.frame = Some(frame);
        self.first_stage = self.job.report.count();
    }

    /// Refuses a verb whose outputs name its inputs or each other, the report included, and
    /// remembers its outputs.
    pub fn take_files(&mut self, files: Files) -> Result<()> {
        files.check_inputs()?;
        self.outputs = files.outputs;
        // Written, too, but kept from run to run, and shared by frames.
        for (what, cache) in [
            ("--radiance-cache", &self.job.radiance_cache),
            ("--gather-cache", &self.job.gather_cache),
        ] {
            self.outputs.extend(cache.clone().map(|path| (what, path)));
        }
        self.keep_apart(&files.inputs)?;
        self.check_report()
    }

    /// Refuses a report in the place of a file that is none: reports are written without being
    /// asked for --force, of runs that fail, too.
    fn check_report(&self) -> Result<()> {
        let Some(path) = self.report_path() else {
            return Ok(());
        };
        let mut first = [0];
        let is_report = match File::open(&path).and_then(|mut file| file.read(&mut first)) {
            Ok(1) => first == *b"{",
            // Nothing to lose.
            _ => true,
        };
        if is_report {
            return Ok(());
        }
        self.report_path.take();
        Err(Error::input(format!(
            "--report would replace {}, which is not a report",
            path.display()
        ))
        .hint("choose another name, such as report.json"))
    }

    /// Refuses outputs that are among the files that are read. No report is written in their place
    /// either.
    pub fn keep_apart(&self, inputs: &[(&'static str, PathBuf)]) -> Result<()> {
        fn named<'a>(files: &'a [(&'static str, PathBuf)]) -> Vec<Named<'a>> {
            files.iter().map(|(what, p)| (*what, p.as_path())).collect()
        }
        let (inputs, outputs) = (named(inputs), named(&self.outputs));
        let path = self.report_path();
        let report: Vec<Named> = path.iter().map(|p| ("--report", p.as_path())).collect();
        check_apart(&report, &inputs).inspect_err(|_| {
            self.report_path.take();
        })?;
        check_apart(&[outputs, report].concat(), &inputs)
    }

    /// Whether references and studies go on from what is there.
    pub fn start(&self) -> Start {
        match self.overwrite {
            Overwrite::Refuse => Start::Resume,
            Overwrite::Replace => Start::Afresh,
        }
    }

    /// Where the report goes.
    pub fn report_path(&self) -> Option<PathBuf> {
        self.report_path.borrow().clone()
    }
}

impl Shared {
    /// Checks the options, sizes the thread pool, and hooks up the signals.
    pub fn resolve(self, limits: Limits) -> Result<Context> {
        last_words::set_retry_code(self.retry_code);
        if let Some(path) = &self.report {
            check_writable(path, Overwrite::Replace)?;
        }
        if let Some(dir) = limits.temp_dir.as_ref().filter(|d| !d.is_dir()) {
            return Err(
                Error::input(format!("--temp-dir {} is not a folder", dir.display()))
                    .hint("create it, or choose another"),
            );
        }
        if let Some(limit) = limits.memory {
            memory::keep_less_of_freed(limit);
        }
        // Where they are not asked for, too: later they would start where no error can be returned.
        let threads = self.threads.map_or(0, usize::from);
        let refused = |why: &dyn std::fmt::Display| {
            let count = match threads {
                0 => "a thread for each core".into(),
                n => format!("{n} threads"),
            };
            Error::failed(format!("cannot start {count}: {why}")).hint(
                "take fewer `threads`, or raise the limits of processes and memory \
                 (ulimit -u and -v)",
            )
        };
        if !memory::have_stacks(threads) {
            return Err(refused(&"there are no addresses for their stacks"));
        }
        rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build_global()
            .map_err(|e| refused(&e))?;
        let job = Job {
            progress: match self.quiet {
                true => progress::Mode::None.progress(),
                false => self.progress.progress(),
            },
            memory_limit: limits.memory,
            process_bytes: memory::of_process(rayon::current_num_threads()),
            temp_dir: limits.temp_dir,
            radiance_cache: limits.radiance_cache,
            gather_cache: limits.gather_cache,
            on_warning: match self.strict {
                true => OnWarning::Fail,
                false => OnWarning::GoOn,
            },
            ..Job::default()
        };
        let cancel = job.cancel.clone();
        ctrlc::set_handler(move || {
            // The first signal asks for a clean stop, the next one does not wait for it.
            if cancel.request() {
                emergency::remove_temporaries();
                std::process::exit(last_words::retry_code().into());
            }
        })
        .map_err(|e| Error::failed(format!("cannot listen for signals: {e}")))?;
        Ok(Context {
            job,
            overwrite: if self.force {
                Overwrite::Replace
            } else {
                Overwrite::Refuse
            },
            same_scene: self.same_scene,
            report_path: RefCell::new(self.report),
            outputs: Vec::new(),
            frames: self.frames,
            frame: None,
            kept: RefCell::default(),
            first_stage: 0,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_goes_on_may_replace_its_own_kind_alone() {
        let context = Context {
            job: Job::default(),
            overwrite: Overwrite::Refuse,
            same_scene: false,
            report_path: RefCell::default(),
            outputs: Vec::new(),
            frames: None,
            frame: None,
            kept: RefCell::default(),
            first_stage: 0,
        };
        let dir = tempfile::tempdir().unwrap();
        let (free, notes) = (dir.path().join("free"), dir.path().join("notes"));
        std::fs::write(&notes, "mine").unwrap();
        for (resume, path, expected) in [
            (true, &free, Overwrite::Replace),
            (true, &notes, Overwrite::Refuse),
            (false, &free, Overwrite::Refuse),
        ] {
            let found = Resume { resume }.overwrite(path, FileKind::Cloud, &context);
            assert_eq!(found, expected, "{resume} {}", path.display());
        }
    }
}

//! The stages of a small scene, undisturbed, and what is right after a fault.

use crate::support::names;
use crate::support::program::command;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::sync::LazyLock;
use std::time::{Duration, Instant};
use tempfile::TempDir;

const SCENE: &str = r#"
name = "faults"
[film]
width = 48
height = 36
[[camera]]
name = "front"
position = [0, 1, 3.9]
target = [0, 1, 0]
fov_x_deg = 40
[[mesh]]
file = "builtin:quad"
scale = 2
albedo = [0.7, 0.7, 0.7]
[[mesh]]
file = "builtin:cube"
scale = [0.5, 0.8, 0.5]
translate = [0.4, 0.4, -0.3]
albedo = [0.6, 0.1, 0.1]
[[light]]
type = "point"
position = [0, 1.9, 0.5]
intensity = [3, 3, 3]
[[volume]]
file = "fog.raw"
dims = [4, 4, 4]
dtype = "u8"
sigma_t_scale = 0.01
albedo = [0.8, 0.8, 0.8]
unitcube_to_world = [[0.9, 0, 0, -0.9], [0, 0.9, 0, 0.3], [0, 0, 0.9, -0.2], [0, 0, 0, 1]]
"#;

/// A verb that writes a file. In `args`, `OUT` is the folder of the output and `TEMP` that for
/// temporary files.
#[derive(Debug)]
pub struct Stage {
    pub args: &'static str,
    /// What it writes.
    pub output: &'static str,
    /// What it maps.
    pub maps: &'static [&'static str],
}

pub const STAGES: [Stage; 9] = [
    Stage {
        args: "bake scene.toml -o OUT/scene.lvc --surfels 60000",
        output: "scene.lvc",
        maps: &[],
    },
    Stage {
        args: "build scene.lvc -o OUT/scene.lvt --temp-dir TEMP",
        output: "scene.lvt",
        maps: &["scene.lvc"],
    },
    Stage {
        args: "bounce scene.toml -t scene.lvt -o OUT/all.lvt",
        output: "all.lvt",
        maps: &["scene.lvt"],
    },
    Stage {
        args: "scatter scene.toml -t scene.lvt -o OUT/scene.lvs",
        output: "scene.lvs",
        maps: &["scene.lvt"],
    },
    Stage {
        args: "shade scene.toml -t scene.lvt --scatter scene.lvs --tile 0/2 \
               -o OUT/0.exr --quality draft",
        output: "0.exr",
        maps: &["scene.lvt", "scene.lvs"],
    },
    Stage {
        args: "pack scene.toml -t scene.lvt --scatter scene.lvs -o OUT/scene.lvp",
        output: "scene.lvp",
        maps: &["scene.lvt", "scene.lvs"],
    },
    Stage {
        args: "shade scene.lvp -o OUT/packed.exr --quality draft",
        output: "packed.exr",
        maps: &["scene.lvp"],
    },
    Stage {
        args: "merge 0.exr 1.exr -o OUT/frame.exr",
        output: "frame.exr",
        maps: &[],
    },
    Stage {
        args: "render scene.toml -o OUT/frame.exr --temp-dir TEMP --surfels 60000 --quality draft",
        output: "frame.exr",
        maps: &[],
    },
];

/// The stage of a verb.
pub fn stage(verb: &str) -> &'static Stage {
    STAGES.iter().find(|s| s.args.starts_with(verb)).unwrap()
}

/// What all stages read, and what each of them writes undisturbed, and takes.
pub struct Undisturbed {
    folder: TempDir,
    stages: Vec<(Vec<u8>, Duration)>,
}

pub static UNDISTURBED: LazyLock<Undisturbed> = LazyLock::new(|| {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("scene.toml"), SCENE).unwrap();
    fs::write(folder.path().join("fog.raw"), [100; 64]).unwrap();
    let mut stages = Vec::new();
    for stage in &STAGES {
        let bench = Bench::new(stage, folder.path());
        let started = Instant::now();
        let run = bench.run(&mut bench.command());
        assert!(run.status.success(), "{stage:?}: {}", error(&run));
        let took = started.elapsed();
        let bytes = fs::read(bench.output()).unwrap();
        fs::write(folder.path().join(stage.output), &bytes).unwrap();
        stages.push((bytes, took));
        if stage.output == "0.exr" {
            let line = stage.args.replace("0/2", "1/2").replace("OUT/0", "1");
            let args: Vec<&str> = line.split(' ').collect();
            assert!(command(folder.path(), &args).status().unwrap().success());
        }
    }
    Undisturbed { folder, stages }
});

/// A stage with folders of its own.
pub struct Bench<'a> {
    stage: &'a Stage,
    /// Where its inputs are.
    inputs: PathBuf,
    own: TempDir,
}

impl<'a> Bench<'a> {
    fn new(stage: &'a Stage, inputs: &Path) -> Self {
        let own = tempfile::tempdir().unwrap();
        for folder in ["out", "temp"] {
            fs::create_dir(own.path().join(folder)).unwrap();
        }
        Self {
            stage,
            inputs: inputs.to_owned(),
            own,
        }
    }

    /// With the inputs of all.
    pub fn of(stage: &'a Stage) -> Self {
        Self::new(stage, UNDISTURBED.folder.path())
    }

    /// With a copy of the inputs, to be damaged.
    pub fn with_own_inputs(stage: &'a Stage) -> Self {
        let mut bench = Self::of(stage);
        let inputs = bench.own.path().join("in");
        fs::create_dir(&inputs).unwrap();
        for name in names(&bench.inputs) {
            fs::copy(bench.inputs.join(&name), inputs.join(&name)).unwrap();
        }
        bench.inputs = inputs;
        bench
    }

    pub fn input(&self, name: &str) -> PathBuf {
        self.inputs.join(name)
    }

    pub fn out(&self) -> PathBuf {
        self.own.path().join("out")
    }

    pub fn temporary(&self) -> PathBuf {
        self.own.path().join("temp")
    }

    pub fn output(&self) -> PathBuf {
        self.out().join(self.stage.output)
    }

    fn args(&self) -> Vec<String> {
        let folders = [("OUT", self.out()), ("TEMP", self.temporary())];
        let of_run = "--progress none --threads 2";
        let args = self.stage.args.split(' ').chain(of_run.split(' '));
        args.map(|arg| {
            let replace = |arg: String, (word, path): &(&str, PathBuf)| {
                arg.replace(word, path.to_str().unwrap())
            };
            folders.iter().fold(arg.to_owned(), replace)
        })
        .collect()
    }

    /// The program, to be started.
    pub fn command(&self) -> Command {
        let args = self.args();
        let args: Vec<&str> = args.iter().map(String::as_str).collect();
        piped(command(&self.inputs, &args))
    }

    /// A shell that runs `script`, in which `"$@"` is the program.
    pub fn shell(&self, script: &str) -> Command {
        let mut shell = Command::new("sh");
        shell.args(["-c", script, "sh", env!("CARGO_BIN_EXE_lvox")]);
        shell.args(self.args()).current_dir(&self.inputs);
        piped(shell)
    }

    /// Whether the system can load the program after this, which limits what it may take. The
    /// loader's own words are not the program's.
    pub fn is_loaded_after(&self, limit: &str) -> bool {
        let help = self.run(&mut self.shell(&format!("{limit}; exec \"$1\" --help")));
        // The system ends a program by a signal where not even its segments fit.
        help.status.code().is_some_and(|code| code != 127)
    }

    pub fn run(&self, command: &mut Command) -> Output {
        command.output().unwrap()
    }

    /// How long it takes undisturbed.
    pub fn takes(&self) -> Duration {
        self.undisturbed().1
    }

    fn undisturbed(&self) -> &'static (Vec<u8>, Duration) {
        let at = STAGES.iter().position(|s| s.args == self.stage.args);
        &UNDISTURBED.stages[at.unwrap()]
    }

    /// What is under the final name, if anything, is whole.
    #[track_caller]
    pub fn is_whole_or_not_there(&self, told: &str) {
        if self.output().exists() {
            let bytes = fs::read(self.output()).unwrap();
            assert!(bytes == self.undisturbed().0, "{:?}: {told}", self.stage);
        }
    }

    /// After a run that could end by itself: it did its work; or it says why not in one line, with
    /// one of these exit codes, and leaves nothing. Returns whether it did its work.
    #[track_caller]
    pub fn ended_well(&self, run: &Output, codes: &[i32], fault: &str) -> bool {
        let told = format!(
            "{:?}, {fault}: {:?}: {}",
            self.stage,
            run.status,
            error(run)
        );
        self.is_whole_or_not_there(&told);
        let nothing: [&str; 0] = [];
        assert_eq!(names(&self.temporary()), nothing, "{told}");
        let left = self.out().exists().then(|| names(&self.out()));
        if run.status.success() {
            assert_eq!(left.unwrap(), [self.stage.output], "{told}");
            return true;
        }
        assert_eq!(left.unwrap_or_default(), nothing, "{told}");
        is_one_error(run, codes, &told);
        false
    }

    /// The next run does all, and leaves nothing of the one before.
    #[track_caller]
    pub fn next_is_whole(&self, fault: &str) {
        if self.output().exists() {
            fs::remove_file(self.output()).unwrap();
        }
        let next = self.run(&mut self.command());
        let is_done = self.ended_well(&next, &[], fault);
        assert!(is_done);
    }
}

/// One line of error, at most one hint, and one of these exit codes.
#[track_caller]
pub fn is_one_error(run: &Output, codes: &[i32], told: &str) {
    let code = run.status.code().unwrap_or(-1);
    assert!(codes.contains(&code), "{told}");
    assert!(run.stdout.is_empty(), "{told}");
    let text = error(run);
    let lines: Vec<&str> = text
        .lines()
        .filter(|l| !l.starts_with("warning: "))
        .collect();
    assert!(lines[0].starts_with("error: "), "{told}");
    let is_hint = |line: &str| line.starts_with("hint: ");
    assert!(
        lines[1..].len() <= 1 && lines[1..].iter().all(|l| is_hint(l)),
        "{told}"
    );
}

fn error(run: &Output) -> String {
    String::from_utf8_lossy(&run.stderr).into_owned()
}

fn piped(mut command: Command) -> Command {
    command
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped());
    // Whatever the tests run under, the program's own words are judged.
    command.env_remove("RUST_BACKTRACE");
    command
}

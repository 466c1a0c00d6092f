//! The tasks of a job, and what each waits for, whatever scheduler runs them.

use crate::bounce::Bounces;
use crate::cli::progress::Mode;
use crate::run::{Frames, frames};
use crate::{Error, Result};
use clap::ValueEnum;
use std::path::Path;

/// Stands for the name of a camera in the name of an output.
pub const CAMERA: &str = "{camera}";

/// Words of a command line.
#[derive(Clone, Debug, Default)]
pub struct Words(pub Vec<String>);

/// A job: a scene, its frames, cameras and tiles, and the options of its stages.
#[derive(Debug)]
pub struct Plan {
    /// Of the scene, for people.
    pub name: String,
    /// The scene, and how it is read.
    pub scene: Vec<String>,
    pub frames: Option<Frames>,
    /// Whether each frame has files of its own, and so a cloud and a tree.
    pub has_own_files: bool,
    /// Cameras by name; none for the first of the scene.
    pub cameras: Vec<String>,
    /// Tiles of an image.
    pub tiles: u32,
    /// Parts of a bake.
    pub parts: u32,
    /// Frames of a task, where there are no tiles.
    pub chunk: u32,
    pub bounces: Bounces,
    pub scatters: bool,
    /// Where tasks find what others made.
    pub folder: String,
    /// Name of images, with tokens.
    pub output: String,
    pub program: String,
    pub seed: u64,
    pub threads: Option<u16>,
    pub memory: Option<u64>,
    pub progress: Option<Mode>,
    /// Whether warnings of tasks are errors.
    pub is_strict: bool,
    /// More options of stages.
    pub bake: Words,
    pub bounce: Words,
    pub scatter: Words,
    pub shade: Words,
}

/// A step of a job: all tasks of one kind, each of which waits for those of the step before.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    /// A part of a cloud.
    Bake,
    /// From a cloud to the packed scene: build, bounce, scatter, pack.
    Tree,
    /// The tiles of an image.
    Cut,
    Tile,
    Merge,
    /// Images as a whole.
    Frame,
}

/// What the tasks of a step differ in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Axis {
    Frame,
    /// Several frames in one task.
    Chunk,
    Part,
    Camera,
    Tile,
}

/// One of the tasks of a step: what each axis is, as it stands in a command line.
#[derive(Clone, Debug, Default)]
pub struct Task {
    /// A frame, or a range of them.
    pub frames: String,
    pub part: String,
    pub camera: String,
    pub tile: String,
}

impl Step {
    /// By the name that the user gives.
    pub const ALL: [(&str, Self); 6] = [
        ("bake", Self::Bake),
        ("tree", Self::Tree),
        ("cut", Self::Cut),
        ("tile", Self::Tile),
        ("merge", Self::Merge),
        ("frame", Self::Frame),
    ];

    pub fn name(self) -> &'static str {
        let row = Self::ALL.iter().find(|row| row.1 == self);
        row.map_or("", |row| row.0)
    }
}

impl Plan {
    /// The steps of the job, in their order.
    pub fn steps(&self) -> &'static [Step] {
        match self.tiles {
            1 => &[Step::Bake, Step::Tree, Step::Frame],
            _ => &[Step::Bake, Step::Tree, Step::Cut, Step::Tile, Step::Merge],
        }
    }

    /// What the tasks of a step differ in.
    pub fn axes(&self, step: Step) -> Vec<Axis> {
        let has_frames = self.frames.is_some();
        let of_files = has_frames && self.has_own_files;
        let by_chunk = match self.chunk {
            1 => Axis::Frame,
            _ => Axis::Chunk,
        };
        let all = match step {
            Step::Bake => [
                of_files.then_some(Axis::Frame),
                (self.parts > 1).then_some(Axis::Part),
                None,
            ],
            Step::Tree => [of_files.then_some(Axis::Frame), None, None],
            Step::Frame => [
                has_frames.then_some(by_chunk),
                self.has_cameras().then_some(Axis::Camera),
                None,
            ],
            Step::Cut | Step::Merge | Step::Tile => [
                has_frames.then_some(Axis::Frame),
                self.has_cameras().then_some(Axis::Camera),
                (step == Step::Tile).then_some(Axis::Tile),
            ],
        };
        all.into_iter().flatten().collect()
    }

    fn has_cameras(&self) -> bool {
        !self.cameras.is_empty()
    }

    /// What an axis may be.
    pub fn values(&self, axis: Axis) -> Vec<String> {
        let numbers = || self.frames.as_ref().map_or(&[][..], Frames::numbers);
        let count = |n: u32| (0..n).map(|i| i.to_string()).collect();
        match axis {
            Axis::Frame => numbers().iter().map(ToString::to_string).collect(),
            Axis::Chunk => (numbers().chunks(self.chunk as usize))
                .map(Frames::text_of)
                .collect(),
            Axis::Part => count(self.parts),
            Axis::Camera => self.cameras.clone(),
            Axis::Tile => count(self.tiles),
        }
    }

    /// The tasks of a step; of one frame alone, if that is given and has files of its own.
    pub fn tasks(&self, step: Step, frame: Option<&str>) -> Vec<Task> {
        let mut tasks = vec![Task::default()];
        for axis in self.axes(step) {
            let values = match (axis, frame) {
                (Axis::Frame | Axis::Chunk, Some(frame)) => vec![frame.to_owned()],
                _ => self.values(axis),
            };
            let with = |task: Task| {
                values
                    .iter()
                    .map(move |value| task.clone().with(axis, value))
            };
            tasks = tasks.into_iter().flat_map(with).collect();
        }
        tasks
    }

    /// The command lines of a task, one after the other.
    pub fn commands(&self, step: Step, task: &Task) -> Vec<Vec<String>> {
        match step {
            Step::Bake => {
                let mut folders: Vec<String> = ["mkdir", "-p"].map(Into::into).into();
                folders.extend(self.folders());
                vec![folders, self.bake(task)]
            }
            Step::Tree => self.tree(task),
            Step::Cut => vec![self.cut(task)],
            Step::Tile | Step::Frame => vec![self.shade(step, task)],
            Step::Merge => vec![self.merge(task)],
        }
    }

    /// The folders that tasks write to. Those of images may be one a frame; these are not made.
    fn folders(&self) -> Vec<String> {
        let mut folders = vec![self.folder.clone()];
        let cameras = self.cameras.iter().map(String::as_str);
        for camera in cameras.chain(self.cameras.is_empty().then_some("")) {
            let output = self.output.replace(CAMERA, camera);
            let folder = Path::new(&output).parent().and_then(Path::to_str);
            let folder = folder.unwrap_or_default().to_owned();
            let is_one = !folder.is_empty() && frames::token_in(&folder).is_none();
            if is_one && !folders.contains(&folder) {
                folders.push(folder);
            }
        }
        folders
    }

    /// A file in the folder: its name, the frame if it has its own, and the rest.
    fn file(&self, name: &str, has_frame: bool, rest: &str) -> String {
        let frame = if has_frame { ".####" } else { "" };
        format!("{}/{name}{frame}{rest}", self.folder)
    }

    /// A file of the scene, of all frames or of one.
    fn scene_file(&self, name: &str, rest: &str) -> String {
        self.file(name, self.frames.is_some() && self.has_own_files, rest)
    }

    /// A file of an image.
    fn image_file(&self, name: &str, task: &Task, rest: &str) -> String {
        let camera = match self.has_cameras() {
            true => format!(".{}", task.camera),
            false => String::new(),
        };
        self.file(name, self.frames.is_some(), &(camera + rest))
    }

    fn line(&self, verb: &str, task: &Task) -> Line {
        let mut line = Line(vec![self.program.clone(), verb.into()]);
        if !task.frames.is_empty() {
            // One word: the first number may be negative.
            line.0.push(format!("--frames={}", task.frames));
        }
        if self.is_strict {
            line.0.push("--strict".into());
        }
        line
    }

    /// What all tasks but those that print have.
    fn shared(&self, line: Line) -> Line {
        let progress = self.progress.as_ref().and_then(Mode::to_possible_value);
        line.option("--threads", self.threads)
            .option("--memory-limit", self.memory)
            .option("--progress", progress.map(|p| p.get_name().to_owned()))
    }

    fn seeded(&self, line: Line) -> Line {
        line.option("--seed", Some(self.seed).filter(|seed| *seed != 0))
    }

    fn bake(&self, task: &Task) -> Vec<String> {
        let (part, file) = match self.parts {
            1 => (None, self.scene_file("cloud", ".lvc")),
            n => {
                let part = format!("{}/{n}", task.part);
                (
                    Some(part),
                    self.scene_file("cloud", &format!(".{}.lvc", task.part)),
                )
            }
        };
        let line = self.line("bake", task).words(&self.scene);
        let line = line.option("--part", part).words(&["-o".into(), file]);
        self.seeded(self.shared(line)).words(&self.bake.0).resume()
    }

    fn tree(&self, task: &Task) -> Vec<Vec<String>> {
        let file = |name: &str, rest: &str| self.scene_file(name, rest);
        let clouds: Vec<String> = match self.parts {
            1 => vec![file("cloud", ".lvc")],
            n => (0..n)
                .map(|i| file("cloud", &format!(".{i}.lvc")))
                .collect(),
        };
        let bounces = self.bounces != Bounces::Count(1);
        let tree = file("tree", ".lvt");
        let built = match bounces {
            true => file("built", ".lvt"),
            false => tree.clone(),
        };
        let to = |path: &str| ["-o".to_owned(), path.to_owned()];
        let of = |path: &str| ["-t".to_owned(), path.to_owned()];
        let mut lines = Vec::new();
        let build = self.line("build", task).words(&clouds).words(&to(&built));
        lines.push(self.shared(build).resume());
        if bounces {
            let line = self
                .line("bounce", task)
                .words(&self.scene)
                .words(&of(&built));
            let line = line
                .words(&to(&tree))
                .option("--bounces", Some(self.bounces));
            let line = self.seeded(self.shared(line)).same_scene();
            lines.push(line.words(&self.bounce.0).resume());
        }
        let light = file("light", ".lvs");
        if self.scatters {
            let line = self
                .line("scatter", task)
                .words(&self.scene)
                .words(&of(&tree));
            let line = self.seeded(self.shared(line.words(&to(&light))));
            let line = line.same_scene();
            lines.push(line.words(&self.scatter.0).resume());
        }
        let line = self.line("pack", task).words(&self.scene).words(&of(&tree));
        let line = line.option("--scatter", self.scatters.then_some(light));
        let line = line.words(&to(&file("scene", ".lvp"))).same_scene();
        lines.push(line.resume());
        lines
    }

    /// What the images of a scene are made from, and how.
    fn image(&self, verb: &str, task: &Task) -> Line {
        let line = self
            .line(verb, task)
            .words(&[self.scene_file("scene", ".lvp")]);
        let camera = Some(&task.camera).filter(|_| self.has_cameras());
        let line = line.option("--camera", camera);
        self.seeded(line.words(&self.shade.0))
    }

    fn cut(&self, task: &Task) -> Vec<String> {
        let line = self
            .image("tiles", task)
            .option("--count", Some(self.tiles));
        let file = self.image_file("tiles", task, ".txt");
        self.shared(line.words(&["-o".into(), file])).0
    }

    fn shade(&self, step: Step, task: &Task) -> Vec<String> {
        let line = self.image("shade", task);
        let line = match step {
            Step::Tile => line
                .option("--tile", Some(format!("{}/{}", task.tile, self.tiles)))
                .option("--tiles", Some(self.image_file("tiles", task, ".txt")))
                .words(&["-o".into(), self.tile_file(task, &task.tile)]),
            _ => line.words(&["-o".into(), self.output_of(task)]),
        };
        self.shared(line).resume()
    }

    fn tile_file(&self, task: &Task, tile: &str) -> String {
        self.image_file("tile", task, &format!(".{tile}.exr"))
    }

    fn output_of(&self, task: &Task) -> String {
        self.output.replace(CAMERA, &task.camera)
    }

    fn merge(&self, task: &Task) -> Vec<String> {
        let tiles: Vec<String> = (0..self.tiles)
            .map(|i| self.tile_file(task, &i.to_string()))
            .collect();
        let line = self.line("merge", task).words(&tiles);
        self.shared(line.words(&["-o".into(), self.output_of(task)]))
            .0
    }

    /// Refuses options of stages that the job gives itself, or that a stage would refuse, also
    /// where the job does without the stage.
    ///
    /// # Errors
    /// What the stage says, on one line.
    pub fn check(&self) -> Result<()> {
        let parse = |words: Vec<String>| {
            let verb = words[1].clone();
            crate::cli::check_words(words).map_err(|e| Error::input(e).at(format!("lvox {verb}")))
        };
        let stages = [
            ("bake", &self.bake),
            ("bounce", &self.bounce),
            ("scatter", &self.scatter),
            ("shade", &self.shade),
        ];
        for (verb, words) in stages {
            refuse_own_options(verb, words)?;
        }
        for (verb, words) in &stages[1..3] {
            let files = ["-t", "tree.lvt", "-o", "out"].map(Into::into);
            let line = Line(vec![self.program.clone(), (*verb).into()]);
            parse(line.words(&self.scene).words(&files).words(&words.0).0)?;
        }
        for &step in self.steps() {
            let Some(mut task) = self.tasks(step, None).into_iter().next() else {
                continue;
            };
            // Any frame will do.
            task.frames.clear();
            let commands = self.commands(step, &task).into_iter();
            for words in commands.filter(|words| words[0] == self.program) {
                parse(words)?;
            }
        }
        Ok(())
    }
}

/// Options of stages that a job gives itself, and those of `lvox farm` that say the same, if there
/// are any.
const OWN_OPTIONS: [(&str, Option<&str>); 18] = [
    ("--allow-outside", Some("--allow-outside")),
    ("--bounces", Some("--bounces")),
    ("--demo", Some("--demo")),
    ("--force", None),
    ("--frames", Some("--frames")),
    ("--group", Some("--group")),
    ("--output", Some("--output")),
    ("-o", Some("--output")),
    ("--part", Some("--parts")),
    ("--plan", None),
    ("--resume", None),
    ("--scatter", None),
    ("--set", Some("--set")),
    ("--texture-limit", Some("--texture-limit")),
    ("--tile", Some("--tiles")),
    ("--tiles", Some("--tiles")),
    ("--tree", None),
    ("-t", None),
];

/// Refuses options that would part what the tasks of a job have in common.
fn refuse_own_options(verb: &str, words: &Words) -> Result<()> {
    let is = |word: &str, option: &str| match option.starts_with("--") {
        true => word.split('=').next() == Some(option),
        // Its value may follow without a space.
        false => word.starts_with(option),
    };
    let own =
        (words.0.iter()).find_map(|word| OWN_OPTIONS.iter().find(|(option, _)| is(word, option)));
    let Some((option, instead)) = own else {
        return Ok(());
    };
    let error = Error::input(format!(
        "--{verb} \"{option}\": expected options that the job leaves to `lvox {verb}`, found one \
         that it gives itself"
    ));
    Err(error.hint(match instead {
        Some(instead) => format!("give {instead} to `lvox farm`"),
        None => "leave it out".into(),
    }))
}

impl Task {
    fn with(mut self, axis: Axis, value: &str) -> Self {
        let field = match axis {
            Axis::Frame | Axis::Chunk => &mut self.frames,
            Axis::Part => &mut self.part,
            Axis::Camera => &mut self.camera,
            Axis::Tile => &mut self.tile,
        };
        value.clone_into(field);
        self
    }
}

/// A command line in the making.
struct Line(Vec<String>);

impl Line {
    fn words(mut self, words: &[String]) -> Self {
        self.0.extend_from_slice(words);
        self
    }

    /// An option, if it has a value.
    fn option(mut self, name: &str, value: Option<impl ToString>) -> Self {
        if let Some(value) = value {
            self.0.extend([name.to_owned(), value.to_string()]);
        }
        self
    }

    /// For verbs that read what another job may have put into the folder meanwhile.
    fn same_scene(mut self) -> Self {
        self.0.push("--same-scene".into());
        self
    }

    /// The whole line, of a task that goes on from what is there.
    fn resume(mut self) -> Vec<String> {
        self.0.push("--resume".into());
        self.0
    }
}

/// Command lines as a shell reads them on one line, each of which needs the one before. Several are
/// in a subshell: `sh -e` goes on where one of `a && b` fails that is not the last, but not where
/// `(a && b)` does.
///
/// # Errors
/// A word that no shell can be told.
pub fn shell(commands: &[Vec<String>]) -> Result<String> {
    let line = |words: &Vec<String>| {
        shlex::try_join(words.iter().map(String::as_str))
            .map_err(|_| Error::input("a name has a byte of zero"))
    };
    let lines: Vec<String> = commands.iter().map(line).collect::<Result<_>>()?;
    Ok(match &lines[..] {
        [line] => line.clone(),
        _ => format!("({})", lines.join(" && ")),
    })
}

//! `--plan`: what a verb would read, write and take, told in place of the work.

use super::files::Files;
use super::output;
use crate::Result;
use crate::run::size;
use crate::scene::Scene;
use crate::tree::OpenTree;
use serde::Serialize;
use std::fmt;
use std::path::{Path, PathBuf};

/// For verbs that take long.
#[derive(Clone, Copy, Debug, Default, clap::Args)]
pub struct Planning {
    /// Only say what it would read, write and take
    #[arg(long)]
    pub plan: bool,

    /// With --plan: print one JSON object
    #[arg(long, requires = "plan")]
    pub json: bool,
}

/// What a verb would do.
#[derive(Debug, Default, Serialize)]
pub struct Plan {
    /// Files that it would read, those that the scene names, too.
    reads: Vec<PlannedFile>,
    /// Files that it would write, with what is there now.
    writes: Vec<PlannedFile>,
    /// Bytes of memory that it would hold at least: without a memory limit, pages of the tree that
    /// it meets come on top.
    memory_bytes: u64,
    /// What there is to be done, each with the unit that its name says.
    work: Vec<(&'static str, u64)>,
    /// Bytes of what it would write, about, where a pilot tells.
    #[serde(skip_serializing_if = "Option::is_none")]
    written_bytes: Option<u64>,
    /// CPU seconds that the work would take, about, where a pilot or the user tells.
    #[serde(skip_serializing_if = "Option::is_none")]
    cpu_secs: Option<f64>,
}

/// A file, and its bytes if it is there.
#[derive(Debug, PartialEq, Eq, Serialize)]
struct PlannedFile {
    path: PathBuf,
    bytes: Option<u64>,
}

impl PlannedFile {
    fn of(path: &Path) -> Self {
        Self {
            path: path.to_owned(),
            bytes: std::fs::metadata(path).ok().map(|m| m.len()),
        }
    }
}

impl Plan {
    /// A plan for a verb that reads and writes these files, and holds so much.
    pub fn of(files: &Files, memory_bytes: u64) -> Self {
        let of_all = |files: &[(&str, PathBuf)]| {
            let mut found: Vec<PlannedFile> = Vec::with_capacity(files.len());
            for (_, path) in files {
                let file = PlannedFile::of(path);
                if !found.contains(&file) {
                    found.push(file);
                }
            }
            found
        };
        Self {
            reads: of_all(&files.inputs),
            writes: of_all(&files.outputs),
            memory_bytes,
            ..Self::default()
        }
    }

    /// And what a scene brings: the files that it names, its triangles, and about how many voxels
    /// are not empty.
    #[must_use]
    pub fn with_scene(mut self, scene: &Scene) -> Self {
        for path in &scene.files {
            let file = PlannedFile::of(path);
            if !self.reads.contains(&file) {
                self.reads.push(file);
            }
        }
        let bytes = scene.volumes.iter().map(|v| v.sigma_t.bytes() as u64);
        self.with("triangles", scene.mesh.triangle_count() as u64)
            .with("voxels", bytes.sum::<u64>() / size_of::<f32>() as u64)
    }

    /// And what a tree brings.
    #[must_use]
    pub fn with_tree(mut self, tree: &OpenTree) -> Self {
        let sums = &tree.tree().summary().sums;
        self.memory_bytes += tree.least_bytes();
        self.with("surfels", sums.surfels)
            .with("lvoxels", sums.lvoxels())
    }

    /// And so many of these.
    #[must_use]
    pub fn with(mut self, what: &'static str, count: u64) -> Self {
        if count > 0 {
            self.work.push((what, count));
        }
        self
    }

    /// And about so many CPU seconds.
    #[must_use]
    pub fn taking(self, cpu_secs: Option<f64>) -> Self {
        Self { cpu_secs, ..self }
    }

    /// And writing about so many bytes.
    #[must_use]
    pub fn writing(self, bytes: u64) -> Self {
        let written_bytes = Some(bytes);
        Self {
            written_bytes,
            ..self
        }
    }

    /// Prints it.
    pub fn print(&self, how: Planning) -> Result<()> {
        match how.json {
            true => output::print_json(self),
            false => output::print(&self.to_string()),
        }
    }
}

impl fmt::Display for Plan {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut line = |name: &str, text: String| writeln!(f, "{name:<10} {text}");
        for (name, files) in [("reads", &self.reads), ("writes", &self.writes)] {
            for (i, file) in files.iter().enumerate() {
                let name = if i == 0 { name } else { "" };
                let path = file.path.display();
                let text = match (name, file.bytes) {
                    (_, None) => path.to_string(),
                    (_, Some(bytes)) => format!("{path} ({})", size::format(bytes)),
                };
                line(name, text)?;
            }
        }
        for (what, count) in &self.work {
            line(what, count.to_string())?;
        }
        if let Some(bytes) = self.written_bytes {
            line("written", format!("about {}", size::format(bytes)))?;
        }
        line(
            "memory",
            format!("at least {}", size::format(self.memory_bytes)),
        )?;
        let time = match self.cpu_secs {
            Some(secs) => format!("about {secs:.1} CPU s"),
            None => "not told: only the work itself would tell".into(),
        };
        line("time", time)
    }
}

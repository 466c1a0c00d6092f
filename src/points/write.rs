//! Files of what was gathered: one header, then a row for each point.

use super::file::PointFile;
use super::npy;
use super::numbers::{name_of, put};
use super::settings::{Over, Settings};
use crate::formats::{AtomicFile, Overwrite};
use crate::gather::Around;
use crate::{Error, Result};
use std::io::{BufWriter, Write};
use std::path::Path;

/// A kind of file that results are written to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum OutputKind {
    /// The numbers of the point, and the results behind them.
    Ply,
    /// Results alone.
    Npy,
}

/// The results of a file of points, and where they go.
#[derive(Clone, Debug)]
pub(super) struct Results<'a> {
    points: &'a PointFile,
    kind: OutputKind,
    /// Directions that points look along.
    pub over: Over,
    /// By column.
    pub names: Vec<String>,
    occlusion: bool,
    distance: bool,
}

impl<'a> Results<'a> {
    /// What settings ask for of points.
    ///
    /// # Errors
    /// An output of another kind, a hemisphere of points without normals, and points that have a
    /// number of the name of a result.
    pub(super) fn of(points: &'a PointFile, output: &Path, settings: &Settings) -> Result<Self> {
        let extension = output
            .extension()
            .map(|e| e.to_string_lossy().to_lowercase());
        let kind = match extension.as_deref() {
            Some("ply") => OutputKind::Ply,
            Some("npy") => OutputKind::Npy,
            _ => {
                return Err(Error::input(format!(
                    "{}: expected the name of a .ply or .npy file",
                    output.display()
                )));
            }
        };
        let over = settings.over.unwrap_or(match points.has_normals() {
            true => Over::Hemisphere,
            false => Over::Sphere,
        });
        if over == Over::Hemisphere && !points.has_normals() {
            return Err(Error::input(format!(
                "{}: expected points with normals (`nx`, `ny`, `nz`), found none",
                points.path.display()
            ))
            .hint("a point without a normal has a mean over the sphere"));
        }
        let mut names: Vec<String> = ["r", "g", "b"]
            .map(|c| format!("{}_{c}", over.quantity()))
            .into();
        let more = [
            ("occlusion", settings.occlusion),
            ("distance", settings.distance),
        ];
        names.extend(more.iter().filter(|m| m.1).map(|m| m.0.to_owned()));
        if let Some(name) = names.iter().find(|n| points.column(n).is_some())
            && kind == OutputKind::Ply
        {
            return Err(Error::input(format!(
                "{}: the points have `{name}` already",
                points.path.display()
            ))
            .hint("take it out first, or write to a .npy file"));
        }
        Ok(Self {
            points,
            kind,
            over,
            names,
            occlusion: settings.occlusion,
            distance: settings.distance,
        })
    }

    /// The header of the file of all points.
    fn header(&self) -> Vec<u8> {
        let count = self.points.count;
        if self.kind == OutputKind::Npy {
            return npy::Array::header(count, self.names.len());
        }
        let mut text = format!("ply\nformat binary_little_endian 1.0\nelement vertex {count}\n");
        for column in &self.points.columns {
            text += &format!("property {} {}\n", name_of(column.scalar), column.name);
        }
        for name in &self.names {
            text += &format!("property float {name}\n");
        }
        (text + "end_header\n").into_bytes()
    }

    /// The row of a point: its own numbers, and what is around it.
    fn put(&self, row: &mut Vec<u8>, own: &[f64], around: &Around) {
        if self.kind == OutputKind::Ply {
            for (column, value) in self.points.columns.iter().zip(own) {
                put(row, column.scalar, *value);
            }
        }
        let results = around.gathered.light.0.into_iter();
        let occlusion = self.occlusion.then_some(around.covered);
        let distance = (self.distance).then_some(around.gathered.harmonic_distance);
        for value in results.chain(occlusion).chain(distance) {
            row.extend(value.to_le_bytes());
        }
    }
}

/// A file that appears when all its rows are written.
pub(super) struct Writer<'a> {
    results: &'a Results<'a>,
    file: BufWriter<AtomicFile>,
    row: Vec<u8>,
}

impl<'a> Writer<'a> {
    /// Begins a file, with a header if it is the first part.
    pub(super) fn create(
        results: &'a Results<'a>,
        path: &Path,
        is_first: bool,
        overwrite: Overwrite,
    ) -> Result<Self> {
        let mut writer = Self {
            results,
            file: BufWriter::with_capacity(1 << 18, AtomicFile::create(path, overwrite)?),
            row: Vec::new(),
        };
        if is_first {
            writer.row = results.header();
            writer.write()?;
        }
        Ok(writer)
    }

    /// Adds the row of a point.
    pub(super) fn add(&mut self, own: &[f64], around: &Around) -> Result<()> {
        self.row.clear();
        self.results.put(&mut self.row, own, around);
        self.write()
    }

    fn write(&mut self) -> Result<()> {
        let written = self.file.write_all(&self.row);
        written.map_err(|e| self.failed(&e))
    }

    fn failed(&self, error: &std::io::Error) -> Error {
        Error::io("write", self.file.get_ref().path(), error)
    }

    /// Gives the file its name.
    pub(super) fn finish(mut self) -> Result<()> {
        self.file.flush().map_err(|e| self.failed(&e))?;
        // Nothing is left in the buffer.
        Ok(self.file.into_parts().0.commit()?)
    }
}

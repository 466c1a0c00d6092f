//! Files of points: rows of numbers, whatever the format.

use super::npy;
use super::numbers::Encoding;
use crate::scene::load::ply::header::{self, Header, Scalar};
use crate::{Error, Result};
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

/// Bytes at the start of a file that hold its whole header.
const HEAD_BYTES: u64 = 1 << 20;
/// Most numbers of a point.
const MAX_COLUMNS: usize = 1024;

/// A number that each point of a file has.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Column {
    pub name: String,
    pub scalar: Scalar,
}

/// A file of points whose header has been read: PLY, whose first element is `vertex`, or NumPy's
/// `.npy`, whose columns are positions and normals.
#[derive(Clone, Debug)]
pub struct PointFile {
    pub(super) path: PathBuf,
    pub(super) encoding: Encoding,
    /// Where the rows begin.
    pub(super) start: u64,
    pub(super) count: u64,
    pub(super) columns: Vec<Column>,
    /// Elements of a PLY file behind the points.
    others: Vec<String>,
}

impl PointFile {
    /// Opens a file of points by its content, and reads its header.
    ///
    /// # Errors
    /// A file of another kind, one that is damaged or cut, and points without positions.
    pub fn open(path: &Path) -> Result<Self> {
        Self::read(path).map_err(|e| e.at(path.display()))
    }

    fn read(path: &Path) -> Result<Self> {
        let open = File::open(path).and_then(|file| Ok((file.metadata()?.len(), file)));
        let (bytes, file) = open.map_err(|e| Error::input(format!("cannot read it: {e}")))?;
        let mut head = Vec::new();
        (file.take(HEAD_BYTES).read_to_end(&mut head))
            .map_err(|e| Error::failed(format!("cannot read it: {e}")))?;
        let file = if head.starts_with(npy::MAGIC) {
            let array = npy::Array::parse(&head)?;
            Self {
                path: path.to_owned(),
                encoding: array.encoding,
                start: array.start,
                count: array.rows,
                columns: names_of(array.columns)?
                    .iter()
                    .map(|name| Column {
                        name: (*name).into(),
                        scalar: array.scalar,
                    })
                    .collect(),
                others: Vec::new(),
            }
        } else if head.starts_with(b"ply") {
            Self::of_ply(path, &head)?
        } else {
            return Err(Error::input(
                "expected a file of points, PLY or .npy, found another kind of file",
            )
            .hint("PLY files begin with `ply`, NumPy's with \\x93NUMPY"));
        };
        file.check_columns()?;
        file.check_bytes(bytes, head.starts_with(npy::MAGIC))?;
        Ok(file)
    }

    fn of_ply(path: &Path, head: &[u8]) -> Result<Self> {
        let header = Header::parse(head)?;
        let mut elements = header.elements.into_iter();
        let points = elements
            .next()
            .ok_or_else(|| Error::input("expected the element `vertex`, found no elements"))?;
        if points.name != "vertex" {
            return Err(Error::input(format!(
                "expected `vertex` as the first element, found `{}`",
                points.name
            )));
        }
        if let Some(list) = points.properties.iter().find(|p| p.length.is_some()) {
            return Err(Error::input(format!(
                "expected numbers as properties of `vertex`, found the list `{}`",
                list.name
            )));
        }
        Ok(Self {
            path: path.to_owned(),
            encoding: match header.encoding {
                header::Encoding::Ascii => Encoding::Text,
                header::Encoding::LittleEndian => Encoding::LittleEndian,
                header::Encoding::BigEndian => Encoding::BigEndian,
            },
            start: header.length as u64,
            count: points.count as u64,
            columns: (points.properties.into_iter())
                .map(|p| Column {
                    name: p.name,
                    scalar: p.scalar,
                })
                .collect(),
            others: elements.map(|e| e.name).collect(),
        })
    }

    fn check_columns(&self) -> Result<()> {
        if self.columns.len() > MAX_COLUMNS {
            return Err(Error::input(format!(
                "expected at most {MAX_COLUMNS} numbers of each point, found {}",
                self.columns.len()
            )));
        }
        for (i, column) in self.columns.iter().enumerate() {
            if self.columns[..i].iter().any(|c| c.name == column.name) {
                return Err(Error::input(format!(
                    "expected each property of `vertex` once, found `{}` twice",
                    column.name
                )));
            }
        }
        self.triple(["x", "y", "z"])?
            .ok_or_else(|| Error::input("expected points with `x`, `y` and `z`, found none"))?;
        self.triple(["nx", "ny", "nz"])?;
        Ok(())
    }

    /// Refuses a file that has less than its header says, and more where it `has_nothing_else`.
    fn check_bytes(&self, bytes: u64, has_nothing_else: bool) -> Result<()> {
        let row = match self.encoding {
            // A digit and what parts it from the next.
            Encoding::Text => 2 * self.columns.len() as u64,
            _ => self.row_bytes() as u64,
        };
        let all = u128::from(row) * u128::from(self.count) + u128::from(self.start);
        // The last number may end the file.
        let found = u128::from(bytes) + u128::from(self.encoding == Encoding::Text);
        if all > found || (has_nothing_else && all < found) {
            return Err(Error::input(format!(
                "the header promises {} points, the file has room for {}; \
                 it is truncated or damaged",
                self.count,
                bytes.saturating_sub(self.start) / row
            )));
        }
        Ok(())
    }

    /// The columns of three numbers; `None` without any of them.
    ///
    /// # Errors
    /// If some are there and some are not.
    pub(super) fn triple(&self, names: [&str; 3]) -> Result<Option<[usize; 3]>> {
        let found = names.map(|name| self.column(name));
        match found {
            [Some(x), Some(y), Some(z)] => Ok(Some([x, y, z])),
            [None, None, None] => Ok(None),
            _ => {
                let missing = (names.iter().zip(found)).find(|(_, at)| at.is_none());
                Err(Error::input(format!(
                    "expected `{}` with the others of {}, found none",
                    missing.map_or("", |(name, _)| name),
                    names.map(|name| format!("`{name}`")).join(", ")
                )))
            }
        }
    }

    pub(super) fn column(&self, name: &str) -> Option<usize> {
        self.columns.iter().position(|c| c.name == name)
    }

    /// Bytes of a row that is not text.
    pub(super) fn row_bytes(&self) -> usize {
        self.columns.iter().map(|c| c.scalar.size()).sum()
    }

    /// Points in the file.
    #[must_use]
    pub fn count(&self) -> u64 {
        self.count
    }

    /// Whether points have normals.
    #[must_use]
    pub fn has_normals(&self) -> bool {
        self.column("nx").is_some()
    }

    /// Elements of the file that are no points: nothing reads them.
    #[must_use]
    pub fn left_out(&self) -> &[String] {
        &self.others
    }

    /// The same error, of a point of the file.
    pub(super) fn at(&self, point: u64, error: Error) -> Error {
        error.at(format!("{}: vertex {point}", self.path.display()))
    }
}

/// The names of the columns of an array.
fn names_of(columns: u64) -> Result<&'static [&'static str]> {
    const NAMES: [&str; 6] = ["x", "y", "z", "nx", "ny", "nz"];
    match columns {
        3 => Ok(&NAMES[..3]),
        6 => Ok(&NAMES),
        _ => Err(Error::input(format!(
            "expected N x 6 numbers, positions and normals, or N x 3 without normals, \
             found N x {columns}"
        ))),
    }
}

//! What can be wrong with a file.

use crate::{FileKind, one_line};
use std::io;
use std::path::{Path, PathBuf};

/// Result with [`FormatError`].
pub type Result<T, E = FormatError> = std::result::Result<T, E>;

/// Why a file cannot be read or written. The text says what was expected and what was found;
/// [`Self::hint`] says what to do next.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FormatError {
    /// The first bytes are not those of an lvox file.
    #[error("not an lvox file: expected it to start with {expected:02x?}, found {found:02x?}")]
    NotOurs {
        /// The magic bytes.
        expected: [u8; 8],
        /// The first bytes of the file, at most eight.
        found: Vec<u8>,
        /// The kind that the caller wanted, if it was one.
        wanted: Option<FileKind>,
    },
    /// An lvox file of another kind.
    #[error("expected a {expected}, found a {}", one_line(found))]
    WrongKind {
        /// The kind that the caller wanted.
        expected: String,
        /// The kind in the header.
        found: String,
    },
    /// A version that this program does not read.
    #[error("format version {found}, this program reads version {supported}")]
    Version {
        /// The version in the file's header.
        found: u32,
        /// The one that is known.
        supported: u32,
    },
    /// The file is shorter or longer than its header says.
    #[error("expected a file of {expected} bytes, found {found} bytes")]
    Truncated {
        /// Length in the header, or the least possible one.
        expected: u64,
        /// Length of the bytes.
        found: u64,
    },
    /// Bytes were altered after they were written.
    #[error(
        "damaged: checksum of {} is {found:016x}, expected {expected:016x}",
        one_line(what)
    )]
    Checksum {
        /// The part of the file, such as a section or a page by its number.
        what: String,
        /// The stored checksum.
        expected: u64,
        /// The checksum of the bytes.
        found: u64,
    },
    /// A value that the format does not allow, in a file or in what was to be written.
    #[error("{}", one_line(format_args!("{what}: expected {expected}, found {found}")))]
    Invalid {
        /// Which value, and where.
        what: String,
        /// The values that are allowed.
        expected: String,
        /// The value that is there.
        found: String,
    },
    /// The output is there already.
    #[error("the file is already there")]
    Exists,
    /// The output is a folder, a device or a pipe.
    #[error("cannot write it: it is not a regular file")]
    NotAFile,
    /// The folder of the output is not there or not writable.
    #[error("cannot write in folder {}: {error}", one_line(folder.display()))]
    Folder {
        /// The folder, links followed.
        folder: PathBuf,
        /// The error of the operating system.
        error: io::Error,
    },
    /// The operating system failed.
    #[error("{doing}: {error}")]
    Io {
        /// The operation that failed, as a verb phrase.
        doing: &'static str,
        /// The error of the operating system.
        error: io::Error,
    },
    /// Any of these, with the file it happened in.
    #[error("{}: {error}", one_line(path.display()))]
    InFile {
        /// The file.
        path: PathBuf,
        /// The error itself.
        error: Box<FormatError>,
    },
}

impl FormatError {
    /// This error with the file's name; an error that names its file already stays as it is.
    #[must_use]
    pub fn at(self, path: &Path) -> Self {
        match self {
            Self::InFile { .. } => self,
            error => Self::InFile {
                path: path.into(),
                error: Box::new(error),
            },
        }
    }

    /// An invalid value told to be in a part of the file; other errors stay as they are.
    pub(crate) fn within(self, part: &str) -> Self {
        match self {
            Self::Invalid {
                what,
                expected,
                found,
            } => Self::Invalid {
                what: format!("{part}: {what}"),
                expected,
                found,
            },
            other => other,
        }
    }

    /// The error without the file's name.
    #[must_use]
    pub fn cause(&self) -> &Self {
        match self {
            Self::InFile { error, .. } => error.cause(),
            error => error,
        }
    }

    /// The error of the operating system behind this one, if there is one.
    #[must_use]
    pub fn io_error(&self) -> Option<&io::Error> {
        match self.cause() {
            Self::Io { error, .. } | Self::Folder { error, .. } => Some(error),
            _ => None,
        }
    }

    /// Advice on what to do next, where there is any.
    #[must_use]
    pub fn hint(&self) -> Option<&'static str> {
        match self.cause() {
            Self::NotOurs { wanted: None, .. } => {
                Some("give a cloud (.lvc) or a tree (.lvt) written by lvox")
            }
            Self::NotOurs {
                wanted: Some(kind), ..
            } => Some(kind.origin()),
            Self::WrongKind { expected, .. } => {
                let kind = FileKind::ALL.into_iter().find(|k| k.name() == expected);
                kind.map(FileKind::origin)
            }
            Self::Version { found, supported } if found > supported => {
                Some("the file was written by a newer lvox: use that one, or make the file again")
            }
            Self::Version { .. } => Some("make the file again with this version of lvox"),
            Self::Truncated { .. } => {
                Some("the file was cut off or appended to: copy it again, or make it again")
            }
            Self::Checksum { .. } => Some(
                "copy the file again (in binary mode), or make it again; if it recurs, check \
                 the disk",
            ),
            Self::Exists => Some("choose another name, or replace it with `overwrite`"),
            Self::NotAFile => {
                Some("outputs are written beside their name and renamed; give the name of a file")
            }
            Self::Folder { .. } => {
                Some("create the folder, make it writable, or choose another output")
            }
            Self::Invalid { .. } | Self::Io { .. } | Self::InFile { .. } => None,
        }
    }

    pub(crate) fn invalid(
        what: impl Into<String>,
        expected: impl Into<String>,
        found: impl std::fmt::Display,
    ) -> Self {
        Self::Invalid {
            what: what.into(),
            expected: expected.into(),
            found: found.to_string(),
        }
    }

    pub(crate) fn io(doing: &'static str) -> impl FnOnce(io::Error) -> Self {
        move |error| Self::Io { doing, error }
    }
}

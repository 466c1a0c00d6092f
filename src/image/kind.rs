//! Kinds of image files: what a file is, its first bytes say; what one is to be, its name.

use crate::{Error, Result};
use std::fs::File;
use std::io::Read;
use std::path::Path;

/// A format that images are kept in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ImageKind {
    /// OpenEXR: radiance.
    Exr,
    /// PNG: eight bits, after the tone map.
    Png,
    /// NumPy's `.npy`: an array of numbers, of which only their order tells what they are.
    Npy,
}

impl ImageKind {
    /// Tells the kind of a file by its first bytes; `None` if it is none of them.
    ///
    /// # Errors
    /// [`crate::Kind::Input`] if the file cannot be read.
    pub fn of(path: &Path) -> Result<Option<Self>> {
        let mut magic = Vec::new();
        // A pipe would keep the reader waiting.
        if std::fs::metadata(path).is_ok_and(|m| !m.is_file()) {
            return Err(Error::input(format!(
                "{}: not a regular file",
                path.display()
            )));
        }
        File::open(path)
            .and_then(|file| file.take(4).read_to_end(&mut magic))
            .map_err(|e| Error::io("read", path, &e))?;
        Ok(match magic[..] {
            [0x76, 0x2f, 0x31, 0x01] => Some(Self::Exr),
            [0x89, b'P', b'N', b'G'] => Some(Self::Png),
            [0x93, b'N', b'U', b'M'] => Some(Self::Npy),
            _ => None,
        })
    }

    /// Tells the kind of a file that is to be written by how its name ends.
    ///
    /// # Errors
    /// [`crate::Kind::Input`] for other names.
    pub fn named(path: &Path) -> Result<Self> {
        let ends = |end: &str| {
            path.extension()
                .is_some_and(|e| e.eq_ignore_ascii_case(end))
        };
        let kinds = [Self::Exr, Self::Png, Self::Npy];
        kinds.into_iter().find(|k| ends(k.end())).ok_or_else(|| {
            Error::input(format!(
                "{}: an image has to be named .exr, .png or .npy",
                path.display()
            ))
        })
    }

    /// What the names of its files end in, behind the dot.
    fn end(self) -> &'static str {
        match self {
            Self::Exr => "exr",
            Self::Png => "png",
            Self::Npy => "npy",
        }
    }

    /// Checks that a file of this kind has a name that says so; `role` tells what the file is for.
    ///
    /// # Errors
    /// [`crate::Kind::Input`] with the role, and what the name has to end in.
    pub fn check_name(self, role: &str, path: &Path) -> Result<()> {
        if Self::named(path).is_ok_and(|kind| kind == self) {
            return Ok(());
        }
        Err(Error::input(format!(
            "{role} {}: expected a name that ends in .{}",
            path.display(),
            self.end()
        )))
    }
}

//! Reading the files of a scene: each is read once, in the order named, and joins the scene's hash.

use crate::run::Cancel;
use crate::{Error, Result};
use std::fs::{self, File};
use std::io::{self, Read};
use std::path::{Path, PathBuf};

/// Bytes that are read or hashed between two looks at whether to stop.
const PIECE: usize = 16 << 20;

/// The files read so far, as a hash, and what the user should know about them.
#[derive(Default)]
pub(super) struct Files {
    hasher: blake3::Hasher,
    /// Where they are.
    pub(super) paths: Vec<PathBuf>,
    /// What was odd but not wrong.
    pub(super) warnings: Vec<String>,
    /// Loops over what a file holds look at it.
    pub(super) cancel: Cancel,
}

impl Files {
    /// No files yet.
    pub(super) fn until(cancel: &Cancel) -> Self {
        Self {
            cancel: cancel.clone(),
            ..Self::default()
        }
    }

    /// The whole content of a file; `what` it is for ("mesh", "texture", ...) is named when it
    /// cannot be read.
    pub(super) fn read(&mut self, what: &str, path: &Path) -> Result<Vec<u8>> {
        // Devices and pipes may have no end.
        if fs::metadata(path).is_ok_and(|m| !m.is_file()) {
            return Err(Error::input(format!(
                "{what} file {} is not a regular file",
                path.display()
            )));
        }
        let content = self.content(path, |e| match e.kind() {
            io::ErrorKind::NotFound => {
                Error::input(format!("{what} file {} is not there", path.display())).hint(format!(
                    "paths are relative to the file that names them; looked for {}",
                    std::path::absolute(path)
                        .unwrap_or_else(|_| path.to_path_buf())
                        .display()
                ))
            }
            _ => Error::io(&format!("read {what} file"), path, e),
        })?;
        self.add(&content)?;
        self.paths.push(path.to_owned());
        Ok(content)
    }

    fn content(&self, path: &Path, failed: impl Fn(&io::Error) -> Error) -> Result<Vec<u8>> {
        let mut file = File::open(path).map_err(|e| failed(&e))?;
        let length = file.metadata().map_err(|e| failed(&e))?.len();
        let mut content = Vec::new();
        content
            .try_reserve_exact(usize::try_from(length).unwrap_or(usize::MAX))
            .map_err(|_| failed(&io::ErrorKind::OutOfMemory.into()))?;
        loop {
            self.cancel.check()?;
            let mut piece = (&mut file).take(PIECE as u64);
            if piece.read_to_end(&mut content).map_err(|e| failed(&e))? == 0 {
                return Ok(content);
            }
        }
    }

    /// Lets content that is not a file of its own join the hash.
    pub(super) fn add(&mut self, content: &[u8]) -> Result<()> {
        // The length keeps "ab" + "c" apart from "a" + "bc".
        self.hasher.update(&(content.len() as u64).to_le_bytes());
        for piece in content.chunks(PIECE) {
            self.cancel.check()?;
            self.hasher.update(piece);
        }
        Ok(())
    }

    /// blake3 over everything read.
    pub(super) fn hash(&self) -> [u8; 32] {
        self.hasher.finalize().into()
    }

    /// Tells the user something that is odd but not wrong.
    pub(super) fn warn(&mut self, message: impl Into<String>) {
        self.warnings.push(message.into());
    }
}

/// `name` as written in the file `by`, resolved against that file's folder. Both kinds of slash
/// separate folders.
pub(super) fn beside(by: &Path, name: &str) -> PathBuf {
    let name = name.replace('\\', "/");
    by.parent().unwrap_or(Path::new("")).join(name)
}

/// The extension in lower case, or an empty string.
pub(super) fn extension(path: &Path) -> String {
    let extension = path.extension().unwrap_or_default();
    extension.to_string_lossy().to_lowercase()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_missing_file_shows_where_it_was_looked_for() {
        let e = Files::default()
            .read("mesh", &beside(Path::new("a/scene.toml"), "..\\b.ply"))
            .unwrap_err();
        assert_eq!(e.to_string(), "mesh file a/../b.ply is not there");
        let hint = e.hint_text().unwrap();
        assert!(hint.ends_with("b.ply") && hint.contains("looked for /"));
    }

    #[test]
    fn what_is_no_regular_file_is_refused() {
        let dir = tempfile::tempdir().unwrap();
        let e = Files::default().read("mesh", dir.path()).unwrap_err();
        assert!(e.to_string().ends_with("is not a regular file"), "{e}");
    }

    #[test]
    fn the_hash_depends_on_where_one_file_ends() {
        let hash = |parts: &[&str]| {
            let mut files = Files::default();
            parts.iter().for_each(|p| files.add(p.as_bytes()).unwrap());
            files.hash()
        };
        assert_ne!(hash(&["ab", "c"]), hash(&["a", "bc"]));
        assert_eq!(hash(&["ab", "c"]), hash(&["ab", "c"]));
    }
}

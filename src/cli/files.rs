//! The files of a verb: checked before its work, and its outputs kept apart from what it reads.

use crate::formats::{AtomicFile, Overwrite};
use crate::{Error, Result};
use std::fs;
use std::path::{Path, PathBuf};

/// The files of a verb as its options name them, each with the word for it in messages.
#[derive(Debug, Default)]
pub struct Files {
    pub inputs: Vec<(&'static str, PathBuf)>,
    pub outputs: Vec<(&'static str, PathBuf)>,
}

impl Files {
    /// And this one is read.
    #[must_use]
    pub fn reads(mut self, what: &'static str, path: &Path) -> Self {
        self.inputs.push((what, path.to_owned()));
        self
    }

    /// And this one is written.
    #[must_use]
    pub fn writes(mut self, what: &'static str, path: &Path) -> Self {
        self.outputs.push((what, path.to_owned()));
        self
    }

    /// Refuses what can be read but once, and may never have anything to read.
    ///
    /// # Errors
    /// [`crate::Kind::Input`] for a pipe or a device; what is not there is for its reader to tell.
    pub fn check_inputs(&self) -> Result<()> {
        for (what, path) in &self.inputs {
            let is_other = |m: fs::Metadata| !m.is_file() && !m.is_dir();
            if fs::metadata(path).is_ok_and(is_other) {
                return Err(Error::input(format!(
                    "{what} {}: expected a file, found a pipe or a device",
                    path.display()
                ))
                .hint("write it to a file first, and name that"));
            }
        }
        Ok(())
    }
}

/// Finds out in the first second that an output cannot be written.
///
/// Clouds and trees, which cost hours, are replaced only on request; images and reports pass
/// `true`.
///
/// # Errors
/// [`crate::Kind::Input`] if the file is there and may not be replaced; else as
/// [`AtomicFile::create`].
pub fn check_writable(path: &Path, overwrite: Overwrite) -> Result<()> {
    Ok(AtomicFile::create(path, overwrite).map(drop)?)
}

/// A file of a verb, and the word for it in messages.
pub type Named<'a> = (&'a str, &'a Path);

/// Refuses outputs that would take the place of an input or of each other; whether a file may be
/// replaced does not matter.
///
/// # Errors
/// [`crate::Kind::Input`] with both words and the path as it was given.
pub fn check_apart(outputs: &[Named], inputs: &[Named]) -> Result<()> {
    let read: Vec<(&str, PathBuf)> = inputs.iter().map(|(what, p)| (*what, place(p))).collect();
    let mut written: Vec<(&str, PathBuf)> = Vec::with_capacity(outputs.len());
    for (what, path) in outputs {
        let place = place(path);
        if let Some((input, _)) = read.iter().find(|(_, p)| *p == place) {
            return Err(Error::input(format!(
                "{what} {} would replace the {input} that is read",
                path.display()
            ))
            .hint("choose another name for the output; --force does not allow this"));
        }
        if let Some((other, _)) = written.iter().find(|(_, p)| *p == place) {
            return Err(Error::input(format!(
                "{what} {} would replace what {other} writes",
                path.display()
            ))
            .hint("give each output a name of its own"));
        }
        written.push((what, place));
    }
    Ok(())
}

/// Where a path leads, links followed; of a file that is not there yet, its folder counts.
fn place(path: &Path) -> PathBuf {
    fs::canonicalize(path).unwrap_or_else(|_| {
        let folder = fs::canonicalize(folder(path));
        match (folder, path.file_name()) {
            (Ok(folder), Some(name)) => folder.join(name),
            _ => path.to_path_buf(),
        }
    })
}

fn folder(path: &Path) -> &Path {
    match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        fs::read_dir(folder)
            .unwrap()
            .map(|e| e.unwrap().file_name().into_string().unwrap())
            .collect()
    }

    #[test]
    fn existing_file_needs_force() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.lvc");
        check_writable(&path, Overwrite::Refuse).unwrap();
        fs::write(&path, b"old").unwrap();
        let error = check_writable(&path, Overwrite::Refuse).unwrap_err();
        assert!(error.hint_text().unwrap().contains("`overwrite`"));
        check_writable(&path, Overwrite::Replace).unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"old");
        assert_eq!(names(dir.path()), ["a.lvc"]);
    }

    #[test]
    fn missing_folder_and_folders_are_refused() {
        let dir = tempfile::tempdir().unwrap();
        let error =
            check_writable(&dir.path().join("no/such/a.exr"), Overwrite::Replace).unwrap_err();
        assert_eq!(error.kind(), crate::Kind::Input);
        assert!(!error.to_string().contains('\n'));
        // Not the name of the temporary file.
        assert!(!error.to_string().contains(".part"), "{error}");
        assert!(error.hint_text().is_some());
        let error = check_writable(dir.path(), Overwrite::Replace).unwrap_err();
        assert!(error.to_string().contains("not a regular file"));
    }

    #[test]
    fn outputs_keep_apart_from_inputs_and_each_other() {
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        fs::create_dir(at("sub")).unwrap();
        fs::write(at("a"), b"a").unwrap();
        let roundabout = at("sub/../a");
        let (a, b) = (at("a"), at("b"));
        let apart = |outputs: &[&Path], inputs: &[&Path]| {
            let outputs: Vec<Named> = outputs.iter().map(|p| ("output", *p)).collect();
            let inputs: Vec<Named> = inputs.iter().map(|p| ("scene", *p)).collect();
            check_apart(&outputs, &inputs)
        };
        apart(&[&b], &[&a, &a]).unwrap();
        for (outputs, inputs, part) in [
            (&[a.as_path()][..], &[a.as_path()][..], "the scene"),
            (&[&roundabout], &[&a], "the scene"),
            // Neither is there yet.
            (&[&b, &at("sub/../b")], &[&a], "what output writes"),
        ] {
            let error = apart(outputs, inputs).unwrap_err();
            assert!(error.to_string().contains(part), "{error}");
            assert!(error.hint_text().is_some());
        }
        #[cfg(unix)]
        {
            std::os::unix::fs::symlink(&a, at("link")).unwrap();
            apart(&[&at("link")], &[&a]).unwrap_err();
        }
    }
}

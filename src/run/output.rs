//! A file that appears under its name only when it is complete.

use crate::{Error, Result};
use std::fs;
use std::io::{self, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use tempfile::NamedTempFile;

/// A file being written. Dropped without [`Output::commit`], it leaves nothing behind and what was there untouched.
#[derive(Debug)]
pub struct Output {
    path: PathBuf,
    temporary: NamedTempFile,
}

impl Output {
    /// Opens a temporary file beside `path`, so that the final rename stays inside one file system.
    ///
    /// # Errors
    /// If the folder is not there or not writable, or `path` names something that is not a regular file.
    pub fn create(path: &Path) -> Result<Self> {
        // A link keeps pointing where it points; its target is replaced.
        let path = match fs::symlink_metadata(path) {
            Ok(meta) if meta.is_symlink() => {
                fs::canonicalize(path).map_err(|e| Error::io("write", path, &e))?
            }
            _ => path.to_path_buf(),
        };
        check_kind(&path)?;
        let name = path
            .file_name()
            .ok_or_else(|| Error::input(format!("{} names no file", path.display())))?;
        let mut prefix = std::ffi::OsString::from(".");
        prefix.push(name);
        prefix.push(".");
        let mut builder = tempfile::Builder::new();
        builder.prefix(&prefix).suffix(".part");
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt;
            // As any other new file: what the umask leaves.
            builder.permissions(fs::Permissions::from_mode(0o666));
        }
        let folder = folder(&path);
        let temporary = builder.tempfile_in(folder).map_err(|e| {
            // Of a folder that cannot be looked at the system tells why; else only the kind is known.
            let cause = match fs::read_dir(folder) {
                Err(cause) => cause,
                Ok(_) => io::Error::from(e.kind()),
            };
            Error::io("write in folder", folder, &cause)
                .hint("create the folder, make it writable, or choose another output")
                .at(path.display())
        })?;
        Ok(Self { path, temporary })
    }

    /// Makes the bytes durable and gives the file its name.
    ///
    /// # Errors
    /// On a full disk and the like; then nothing is left behind.
    pub fn commit(self) -> Result<()> {
        let failed = |e: &io::Error| Error::io("write", &self.path, e);
        self.temporary
            .as_file()
            .sync_all()
            .map_err(|e| failed(&e))?;
        self.temporary
            .persist(&self.path)
            .map_err(|e| failed(&e.error))?;
        // The rename itself; not every file system can sync a folder, and the file is whole either way.
        #[cfg(unix)]
        let _ = fs::File::open(folder(&self.path)).and_then(|f| f.sync_all());
        Ok(())
    }

    /// Turns an error of writing into one that names the file.
    #[must_use]
    pub fn failed(&self, error: &io::Error) -> Error {
        Error::io("write", &self.path, error)
    }

    /// Writes a whole file at once.
    ///
    /// # Errors
    /// As [`Output::create`] and [`Output::commit`].
    pub fn write_all_to(path: &Path, bytes: &[u8]) -> Result<()> {
        let mut output = Self::create(path)?;
        output.write_all(bytes).map_err(|e| output.failed(&e))?;
        output.commit()
    }

    /// Writes a value as JSON that people can read too.
    ///
    /// # Errors
    /// As [`Output::write_all_to`], and for what JSON cannot hold.
    pub fn write_json_to(path: &Path, value: &impl serde::Serialize) -> Result<()> {
        let mut json = serde_json::to_vec_pretty(value).map_err(|e| {
            Error::failed(format!("cannot encode it as JSON: {e}")).at(path.display())
        })?;
        json.push(b'\n');
        Self::write_all_to(path, &json)
    }
}

impl Write for Output {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.temporary.as_file_mut().write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.temporary.as_file_mut().flush()
    }
}

impl Seek for Output {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.temporary.as_file_mut().seek(to)
    }
}

/// Finds out in the first second that an output cannot be written.
///
/// Clouds and trees, which cost hours, are replaced only with `force`; images and reports pass `true`.
///
/// # Errors
/// [`crate::Kind::Input`] if the file is there and `force` is not given; else as [`Output::create`].
pub fn check_writable(path: &Path, force: bool) -> Result<()> {
    if !force && path.try_exists().unwrap_or(false) {
        check_kind(path)?;
        return Err(Error::input(format!("{} is already there", path.display()))
            .hint("choose another name, or replace it with --force"));
    }
    Output::create(path).map(drop)
}

/// A file of a verb, and the word for it in messages.
pub type Named<'a> = (&'a str, &'a Path);

/// Refuses outputs that would take the place of an input or of each other; whether a file may be replaced does not matter.
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

/// Renaming over a device or a folder would destroy it or fail late.
fn check_kind(path: &Path) -> Result<()> {
    match fs::metadata(path) {
        Ok(meta) if !meta.is_file() => Err(Error::input(format!(
            "cannot write {}: it is not a regular file",
            path.display()
        ))
        .hint("outputs are written beside their name and renamed; give the name of a file")),
        _ => Ok(()),
    }
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
    fn dropped_output_leaves_nothing() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.exr");
        let mut output = Output::create(&path).unwrap();
        output.write_all(b"half").unwrap();
        drop(output);
        assert!(names(dir.path()).is_empty());
        Output::write_all_to(&path, b"whole").unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"whole");
        assert_eq!(names(dir.path()), ["a.exr"]);
    }

    #[test]
    fn existing_file_needs_force() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.lvc");
        check_writable(&path, false).unwrap();
        fs::write(&path, b"old").unwrap();
        let error = check_writable(&path, false).unwrap_err();
        assert!(error.hint_text().unwrap().contains("--force"));
        check_writable(&path, true).unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"old");
        assert_eq!(names(dir.path()), ["a.lvc"]);
    }

    #[test]
    fn missing_folder_and_folders_are_refused() {
        let dir = tempfile::tempdir().unwrap();
        let error = check_writable(&dir.path().join("no/such/a.exr"), true).unwrap_err();
        assert_eq!(error.kind(), crate::Kind::Input);
        assert!(!error.to_string().contains('\n'));
        // Not the name of the temporary file.
        assert!(!error.to_string().contains(".part"), "{error}");
        assert!(error.hint_text().is_some());
        let error = check_writable(dir.path(), true).unwrap_err();
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

    #[cfg(unix)]
    #[test]
    fn devices_survive_and_links_are_followed() {
        assert!(check_writable(Path::new("/dev/null"), true).is_err());
        let dir = tempfile::tempdir().unwrap();
        let (target, link) = (dir.path().join("target"), dir.path().join("link"));
        fs::write(&target, b"old").unwrap();
        std::os::unix::fs::symlink(&target, &link).unwrap();
        Output::write_all_to(&link, b"new").unwrap();
        assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
        assert_eq!(fs::read(&target).unwrap(), b"new");
    }
}

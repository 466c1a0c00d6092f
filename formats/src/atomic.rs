//! A file that appears under its name only when it is complete.

use crate::emergency::Temporary;
use crate::leftover::Naming;
use crate::{FormatError, Result};
use std::fs;
use std::io::{self, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use tempfile::NamedTempFile;

/// The fate of an output that is already there.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Overwrite {
    /// The file stays, and writing fails with [`FormatError::Exists`].
    #[default]
    Refuse,
    /// The complete new file takes its place.
    Replace,
}

/// A file being written, under a temporary name beside its own. Dropped without
/// [`AtomicFile::commit`], it leaves nothing behind, and what was there untouched.
///
/// A process that is killed leaves its temporary file. The next one that writes a file of the same
/// name, as the same user, removes it: a lock that ends with its process says that nobody owns it.
///
/// A link stays a link: the file that it leads to is replaced.
#[derive(Debug)]
pub struct AtomicFile {
    path: PathBuf,
    /// The file that `path` leads to, links followed.
    target: PathBuf,
    temporary: NamedTempFile,
    /// That it is removed also where the process ends at once.
    _removal: Temporary,
    overwrite: Overwrite,
}

impl AtomicFile {
    /// Opens a temporary file in the folder of `path`, so that the final rename stays inside one
    /// file system.
    ///
    /// # Errors
    /// [`FormatError::Exists`] if a file is there that may not be replaced;
    /// [`FormatError::NotAFile`] for a folder, a device or a pipe, which a rename would destroy;
    /// [`FormatError::Folder`] if the folder is not there or not writable.
    pub fn create(path: &Path, overwrite: Overwrite) -> Result<Self> {
        open(path, overwrite).map_err(|e| e.at(path))
    }

    /// The final name, as it was given.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Makes the bytes durable and gives the file its name.
    ///
    /// # Errors
    /// [`FormatError::Io`] on a full disk and the like, and [`FormatError::Exists`] if the name was
    /// taken meanwhile and may not be replaced; then nothing is left behind.
    pub fn commit(self) -> Result<()> {
        let commit = || {
            self.temporary
                .as_file()
                .sync_all()
                .map_err(FormatError::io("cannot write"))?;
            let done = if self.overwrite == Overwrite::Replace {
                self.temporary.persist(&self.target)
            } else {
                self.temporary.persist_noclobber(&self.target)
            };
            done.map_err(|e| match e.error.kind() {
                io::ErrorKind::AlreadyExists if self.overwrite == Overwrite::Refuse => {
                    FormatError::Exists
                }
                _ => FormatError::io("cannot write")(e.error),
            })?;
            // The rename itself; not every file system can sync a folder, and the file is whole
            // either way.
            #[cfg(unix)]
            let _ = fs::File::open(folder(&self.target)).and_then(|f| f.sync_all());
            Ok(())
        };
        commit().map_err(|e: FormatError| e.at(&self.path))
    }
}

fn open(path: &Path, overwrite: Overwrite) -> Result<AtomicFile> {
    let there = fs::symlink_metadata(path);
    let target = match &there {
        Ok(meta) if meta.is_symlink() => {
            fs::canonicalize(path).map_err(FormatError::io("cannot write where this link leads"))?
        }
        _ => path.to_path_buf(),
    };
    if fs::metadata(&target).is_ok_and(|meta| !meta.is_file()) {
        return Err(FormatError::NotAFile);
    }
    if there.is_ok() && overwrite == Overwrite::Refuse {
        return Err(FormatError::Exists);
    }
    let name = target
        .file_name()
        .ok_or_else(|| FormatError::invalid("output path", "the name of a file", path.display()))?;
    let mut prefix = std::ffi::OsString::from(".");
    prefix.push(name);
    prefix.push(".");
    let naming = Naming {
        prefix,
        suffix: ".part",
        lock_inside: None,
    };
    let folder = folder(&target);
    let temporary = naming
        .make_locked(
            |builder| {
                #[cfg(unix)]
                {
                    use std::os::unix::fs::PermissionsExt;
                    // As any other new file: what the umask leaves.
                    builder.permissions(fs::Permissions::from_mode(0o666));
                }
                builder.tempfile_in(folder)
            },
            |made| (made.as_file(), made.path().to_path_buf()),
        )
        .map_err(|e| FormatError::Folder {
            folder: folder.to_path_buf(),
            // Of a folder that cannot be looked at the system tells why; else only the kind is
            // known, as the text names the temporary file.
            error: match fs::read_dir(folder) {
                Err(cause) => cause,
                Ok(_) => io::Error::from(e.kind()),
            },
        })?;
    let removal = Temporary::file(temporary.path());
    naming.sweep(folder, temporary.path());
    Ok(AtomicFile {
        path: path.to_path_buf(),
        target,
        temporary,
        _removal: removal,
        overwrite,
    })
}

fn folder(path: &Path) -> &Path {
    match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    }
}

// Straight to the file: errors of `NamedTempFile` name the temporary one.
impl Write for AtomicFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.temporary.as_file_mut().write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.temporary.as_file_mut().flush()
    }
}

impl Seek for AtomicFile {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.temporary.as_file_mut().seek(to)
    }
}

#[cfg(test)]
mod tests {
    use super::Overwrite::{Refuse, Replace};
    use super::*;
    use crate::leftover::tests::{age, name_of};

    fn write(path: &Path, overwrite: Overwrite, bytes: &[u8]) -> Result<()> {
        let mut file = AtomicFile::create(path, overwrite)?;
        file.write_all(bytes).unwrap();
        file.commit()
    }

    fn names(folder: &Path) -> Vec<String> {
        let mut names: Vec<String> = fs::read_dir(folder)
            .unwrap()
            .map(|e| e.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    }

    #[test]
    fn dropped_file_leaves_nothing_and_what_was_there() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a");
        let half = |overwrite| {
            let mut file = AtomicFile::create(&path, overwrite).unwrap();
            file.write_all(b"half").unwrap();
        };
        half(Refuse);
        assert!(names(dir.path()).is_empty());
        write(&path, Refuse, b"whole").unwrap();
        half(Replace);
        assert_eq!(fs::read(&path).unwrap(), b"whole");
        assert_eq!(names(dir.path()), ["a"]);
    }

    #[test]
    fn only_what_may_be_replaced_is() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a");
        let late = AtomicFile::create(&path, Refuse).unwrap();
        fs::write(&path, b"old").unwrap();
        for error in [
            late.commit().unwrap_err(),
            write(&path, Refuse, b"new").unwrap_err(),
        ] {
            assert!(matches!(error.cause(), FormatError::Exists), "{error}");
        }
        assert_eq!(fs::read(&path).unwrap(), b"old");
        write(&path, Replace, b"new").unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"new");
        assert_eq!(names(dir.path()), ["a"]);
    }

    #[test]
    fn files_without_owner_are_swept() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a");
        let make = |name: String| {
            let path = dir.path().join(name);
            fs::write(&path, b"half").unwrap();
            path
        };
        let living = AtomicFile::create(&path, Refuse).unwrap();
        let foreign = make(name_of(".a.", true, ".part"));
        let others = [
            make(name_of(".b.", false, ".part")),
            make(".a.Ab12Cd.part".into()),
        ];
        #[cfg(target_os = "linux")]
        let left = make(name_of(".a.", false, ".part"));
        let next = AtomicFile::create(&path, Refuse).unwrap();
        #[cfg(target_os = "linux")]
        assert!(!left.exists());
        for kept in [living.temporary.path(), next.temporary.path(), &foreign] {
            assert!(kept.exists(), "{}", kept.display());
        }
        for other in [&foreign, &others[0], &others[1]] {
            age(other);
        }
        write(&path, Refuse, b"whole").unwrap();
        assert!(!foreign.exists() && living.temporary.path().exists());
        drop((living, next));
        assert_eq!(fs::read(&path).unwrap(), b"whole");
        assert!(others.iter().all(|other| other.exists()));
        assert_eq!(names(dir.path()).len(), 3);
    }

    #[test]
    fn a_failed_rename_leaves_nothing() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a");
        let file = AtomicFile::create(&path, Replace).unwrap();
        fs::create_dir(&path).unwrap();
        let error = file.commit().unwrap_err();
        assert!(!error.to_string().contains(".part"), "{error}");
        assert_eq!(names(dir.path()), ["a"]);
    }

    #[test]
    fn missing_folders_and_folders_are_refused() {
        let dir = tempfile::tempdir().unwrap();
        let error = AtomicFile::create(&dir.path().join("no/such/a"), Replace).unwrap_err();
        assert!(matches!(error.cause(), FormatError::Folder { .. }));
        assert_eq!(error.io_error().unwrap().kind(), io::ErrorKind::NotFound);
        assert!(!error.to_string().contains(".part"), "{error}");
        let error = AtomicFile::create(dir.path(), Replace).unwrap_err();
        assert!(matches!(error.cause(), FormatError::NotAFile));
    }

    #[cfg(unix)]
    #[test]
    fn devices_are_refused_and_links_stay() {
        use std::os::unix::fs::symlink;
        let error = AtomicFile::create(Path::new("/dev/null"), Replace).unwrap_err();
        assert!(matches!(error.cause(), FormatError::NotAFile));
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        fs::create_dir(at("store")).unwrap();
        fs::write(at("store/target"), b"old").unwrap();
        symlink("store/target", at("link")).unwrap();
        let error = AtomicFile::create(&at("link"), Refuse).unwrap_err();
        assert!(matches!(error.cause(), FormatError::Exists));
        write(&at("link"), Replace, b"new").unwrap();
        assert!(fs::symlink_metadata(at("link")).unwrap().is_symlink());
        assert_eq!(fs::read(at("store/target")).unwrap(), b"new");
        assert_eq!(names(&at("store")), ["target"]);
        // A link that leads nowhere has no folder to write in.
        symlink("no/such", at("loose")).unwrap();
        let error = AtomicFile::create(&at("loose"), Replace).unwrap_err();
        assert_eq!(error.io_error().unwrap().kind(), io::ErrorKind::NotFound);
        assert_eq!(names(dir.path()), ["link", "loose", "store"]);
    }
}

//! Temporary files and folders that outlived their process (SIGKILL, a power cut), and how the next
//! run knows them.
//!
//! What is in use is locked for as long as its process lives, and its name says which running
//! system made it: `PREFIX MARK-RANDOM SUFFIX`. On one running system every process sees the locks
//! of all others. Between machines a file system may not pass locks on (NFS with `nolock` or
//! `local_lock`), so what another system made counts as in use until a day has passed without a
//! write. Where a file system has no locks at all, nothing is swept.

use std::fs::{self, File, TryLockError};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;
use std::time::Duration;

/// How long what another system made is left alone after it was last written.
const FOREIGN_AGE: Duration = Duration::from_secs(24 * 3600);

/// Hexadecimal digits of a mark.
const MARK_DIGITS: usize = 8;

/// How often a temporary file is made anew when another process took it for a leftover, which it
/// can in the moment between its making and its lock.
const TRIES: usize = 16;

/// What the system is called from its start to its end, where it says so.
static MARK: LazyLock<Option<String>> = LazyLock::new(|| {
    let id = fs::read("/proc/sys/kernel/random/boot_id").ok()?;
    Some(mark_of(&id))
});

fn mark_of(id: &[u8]) -> String {
    format!("{:08x}", xxhash_rust::xxh3::xxh3_64(id) as u32)
}

/// The mark in names of temporary files that this process makes, up to what is random.
fn own_mark() -> String {
    // Without a name for the system its files are nobody's: only their age tells.
    MARK.clone().unwrap_or_else(|| "0".repeat(MARK_DIGITS)) + "-"
}

/// How temporary files or folders of one use are called: what stands before and behind the mark and
/// the random part.
pub struct Naming {
    pub prefix: std::ffi::OsString,
    pub suffix: &'static str,
    /// The file that is locked: the name of one inside a folder; `None` for the file itself.
    pub lock_inside: Option<&'static str>,
}

impl Naming {
    /// Makes one and locks it: `make` gets a builder with such names, and `lock` tells the file to
    /// lock of what it made, and the path of that.
    ///
    /// # Errors
    /// Those of `make`.
    pub fn make_locked<T>(
        &self,
        make: impl Fn(&mut tempfile::Builder) -> io::Result<T>,
        lock: impl Fn(&T) -> (&File, PathBuf),
    ) -> io::Result<T> {
        let mut prefix = self.prefix.clone();
        prefix.push(own_mark());
        let mut failed = io::Error::from(io::ErrorKind::ResourceBusy);
        for _ in 0..TRIES {
            let made = match make(tempfile::Builder::new().prefix(&prefix).suffix(self.suffix)) {
                Ok(made) => made,
                // A folder that was swept before its lock was made; or there is none to make it in.
                Err(e) if e.kind() == io::ErrorKind::NotFound => {
                    failed = e;
                    continue;
                }
                Err(e) => return Err(e),
            };
            let (file, path) = lock(&made);
            // Without locks (an error) nobody sweeps either.
            let is_taken = matches!(file.try_lock(), Err(TryLockError::WouldBlock));
            if !is_taken && path.symlink_metadata().is_ok() {
                return Ok(made);
            }
        }
        Err(failed)
    }

    /// Removes what is so called in a folder and has no living owner. `own` is one of them that
    /// this process holds: what another user made is left alone. Errors leave things where they
    /// are.
    pub fn sweep(&self, folder: &Path, own: &Path) {
        let (Ok(entries), Ok(own_meta)) = (fs::read_dir(folder), own.symlink_metadata()) else {
            return;
        };
        for entry in entries.flatten() {
            let name = entry.file_name();
            let Some(is_foreign) = self.is_foreign(name.as_encoded_bytes()) else {
                continue;
            };
            // Without the folder, which both may be named by another way.
            if Some(&*name) == own.file_name() {
                continue;
            }
            let path = entry.path();
            if is_same_owner(&path, &own_meta) {
                self.sweep_one(&path, is_foreign);
            }
        }
    }

    fn sweep_one(&self, path: &Path, is_foreign: bool) {
        let lock_path = match self.lock_inside {
            Some(name) => &path.join(name),
            None => path,
        };
        let is_file = |meta: fs::Metadata| meta.is_file();
        let lock = if lock_path.symlink_metadata().is_ok_and(is_file) {
            File::options().write(true).open(lock_path)
        } else {
            Err(io::Error::from(io::ErrorKind::NotFound))
        };
        // A lock is held until the file is gone: who made it just now, and has not locked it yet,
        // finds it taken and makes another one.
        let _ = match (&lock, self.lock_inside) {
            (Ok(lock), _) if lock.try_lock().is_err() || (is_foreign && !is_old(path)) => Ok(()),
            (Ok(_), Some(name)) => remove_folder(path, name),
            (Ok(_), None) => fs::remove_file(path),
            // A folder whose process ended before it had made the lock, or after it had removed it:
            // it is empty, and stays if the lock has just been made.
            (Err(_), Some(_)) if !is_foreign => fs::remove_dir(path),
            (Err(_), Some(_)) if is_old(path) => fs::remove_dir_all(path),
            (Err(_), _) => Ok(()),
        };
    }

    /// Whether something of this name was made by another running system; `None` if it is not
    /// so called.
    fn is_foreign(&self, name: &[u8]) -> Option<bool> {
        let rest = name.strip_prefix(self.prefix.as_encoded_bytes())?;
        let rest = rest.strip_suffix(self.suffix.as_bytes())?;
        let (mark, rest) = rest.split_at_checked(MARK_DIGITS)?;
        let random = rest.strip_prefix(b"-")?;
        let is_ours = mark.iter().all(u8::is_ascii_hexdigit)
            && !random.is_empty()
            && random.iter().all(u8::is_ascii_alphanumeric);
        is_ours.then(|| MARK.as_ref().is_none_or(|own| own.as_bytes() != mark))
    }
}

/// Removes a folder, and of what is in it the lock last: what is left of it if that is cut short
/// still tells that nobody owns it.
pub fn remove_folder(path: &Path, lock: &str) -> io::Result<()> {
    for entry in fs::read_dir(path)? {
        let entry = entry?;
        if entry.file_name() == lock {
            continue;
        }
        match entry.file_type()?.is_dir() {
            true => fs::remove_dir_all(entry.path())?,
            false => fs::remove_file(entry.path())?,
        }
    }
    fs::remove_dir_all(path)
}

#[cfg(unix)]
fn is_same_owner(path: &Path, own: &fs::Metadata) -> bool {
    use std::os::unix::fs::MetadataExt;
    path.symlink_metadata()
        .is_ok_and(|meta| meta.uid() == own.uid() && meta.is_dir() == own.is_dir())
}

#[cfg(not(unix))]
fn is_same_owner(path: &Path, own: &fs::Metadata) -> bool {
    path.symlink_metadata()
        .is_ok_and(|meta| meta.is_dir() == own.is_dir())
}

/// Whether nobody wrote it, or in it, for a day. An error, or a clock that is behind, says no.
fn is_old(path: &Path) -> bool {
    let age = |path: &Path| {
        path.symlink_metadata()
            .and_then(|m| m.modified())
            .ok()?
            .elapsed()
            .ok()
    };
    let is_old = |path: &Path| age(path).is_some_and(|age| age > FOREIGN_AGE);
    let inside = fs::read_dir(path).into_iter().flatten().flatten();
    is_old(path) && inside.map(|e| e.path()).all(|p| is_old(&p))
}

#[cfg(test)]
pub mod tests {
    use super::*;

    /// The name of a temporary file that a process of this system, or of another one, would make.
    pub fn name_of(prefix: &str, is_foreign: bool, suffix: &str) -> String {
        let mark = match is_foreign {
            true => mark_of(b"another"),
            false => own_mark().trim_end_matches('-').to_owned(),
        };
        format!("{prefix}{mark}-Ab12Cd{suffix}")
    }

    /// Makes a file as old as what other systems left.
    pub fn age(path: &Path) {
        let then = std::time::SystemTime::now() - FOREIGN_AGE - Duration::from_secs(60);
        File::open(path).unwrap().set_modified(then).unwrap();
    }

    #[test]
    fn names_of_other_files_are_not_ours() {
        let naming = Naming {
            prefix: ".a.".into(),
            suffix: ".part",
            lock_inside: None,
        };
        let is_foreign = |name: &str| naming.is_foreign(name.as_bytes());
        assert_eq!(is_foreign(&name_of(".a.", true, ".part")), Some(true));
        #[cfg(target_os = "linux")]
        assert_eq!(is_foreign(&name_of(".a.", false, ".part")), Some(false));
        for name in [
            "a",
            ".a.part",
            ".a.Ab12Cd.part",
            ".a.00000000-.part",
            ".a.0000000x-Ab12Cd.part",
            ".a.00000000-Ab12Cd.lvc",
            // Of a file "a.b", and of one whose name looks like a mark.
            ".a.b.00000000-Ab12Cd.part",
            ".a.00000000-Ab12Cd.00000000-Ab12Cd.part",
        ] {
            assert_eq!(is_foreign(name), None, "{name}");
        }
    }
}

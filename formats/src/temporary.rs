//! A folder for temporary files.

use crate::emergency::Temporary;
use crate::leftover::{Naming, remove_folder};
use std::fs::File;
use std::io;
use std::path::Path;
use tempfile::TempDir;

/// The file in the folder that is locked while its process lives.
const LOCK: &str = "lock";

/// A folder for temporary files that goes away, with all that is in it, when it is dropped.
///
/// One whose process was killed is swept when the next one is made in the same place, by the same
/// user: a lock on a file in it says whether its process lives. See `docs/farm.md` for folders that
/// several machines share.
#[derive(Debug)]
pub struct TemporaryFolder {
    // Before the lock: nobody else has to remove what is going away.
    folder: TempDir,
    lock: Option<File>,
    /// That it is removed also where the process ends at once.
    _removal: Temporary,
}

impl TemporaryFolder {
    /// Makes a folder `lvox-…` in this one, and removes those there that nobody owns any more.
    ///
    /// # Errors
    /// That of the system, if no folder can be made there.
    pub fn create_in(folder: &Path) -> io::Result<Self> {
        let naming = Naming {
            prefix: "lvox-".into(),
            suffix: "",
            lock_inside: Some(LOCK),
        };
        let (made, lock) = naming.make_locked(
            |builder| {
                let made = builder.tempdir_in(folder)?;
                let lock = File::create_new(made.path().join(LOCK))?;
                Ok((made, lock))
            },
            |(made, lock)| (lock, made.path().join(LOCK)),
        )?;
        let removal = Temporary::folder(made.path());
        naming.sweep(folder, made.path());
        Ok(Self {
            folder: made,
            lock: Some(lock),
            _removal: removal,
        })
    }

    /// Where it is.
    #[must_use]
    pub fn path(&self) -> &Path {
        self.folder.path()
    }
}

impl Drop for TemporaryFolder {
    fn drop(&mut self) {
        // Removing a folder takes a file descriptor. Where none is free there is the one of the
        // lock; then `folder` tries again as it is dropped.
        if remove_folder(self.path(), LOCK).is_err() {
            self.lock = None;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::leftover::tests::{age, name_of};
    use std::fs;

    #[test]
    fn folders_without_owner_are_swept() {
        let dir = tempfile::tempdir().unwrap();
        let make = |name: &str, has_lock: bool| {
            let folder = dir.path().join(name);
            fs::create_dir(&folder).unwrap();
            fs::write(folder.join("scene.lvc"), b"x").unwrap();
            if has_lock {
                fs::write(folder.join(LOCK), b"").unwrap();
            }
            folder
        };
        let living = TemporaryFolder::create_in(dir.path()).unwrap();
        let foreign = make(&name_of("lvox-", true, ""), true);
        let being_made = make("lvox-00000000-a", false);
        let other = make("lvox-mine", true);
        #[cfg(target_os = "linux")]
        let left = make(&name_of("lvox-", false, ""), true);
        // Its process ended before there was a lock, or after.
        #[cfg(target_os = "linux")]
        let empty = dir.path().join(name_of("lvox-", false, "x"));
        #[cfg(target_os = "linux")]
        fs::create_dir(&empty).unwrap();
        let next = TemporaryFolder::create_in(dir.path()).unwrap();
        #[cfg(target_os = "linux")]
        assert!(!left.exists() && !empty.exists());
        for kept in [living.path(), next.path(), &foreign, &being_made, &other] {
            assert!(kept.exists(), "{}", kept.display());
        }
        drop(living);
        for path in [&foreign, &being_made, &other] {
            for entry in fs::read_dir(path).unwrap() {
                age(&entry.unwrap().path());
            }
            age(path);
        }
        // One in which something was written meanwhile has an owner.
        let used = make("lvox-11111111-a", true);
        age(&used);
        drop(next);
        let last = TemporaryFolder::create_in(dir.path()).unwrap();
        for (path, is_kept) in [
            (&foreign, false),
            (&being_made, false),
            (&other, true),
            (&used, true),
        ] {
            assert_eq!(path.exists(), is_kept, "{}", path.display());
        }
        drop(last);
        assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 2);
    }
}

//! A file that appears under its name only when it is complete.

use crate::{FormatError, Result};
use std::fs::File;
use std::io::{BufWriter, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

/// Bytes appended behind room for a header, which is written last. Dropped unfinished, it leaves nothing behind.
pub struct Output {
    file: BufWriter<tempfile::NamedTempFile>,
    path: PathBuf,
    force: bool,
    position: u64,
}

impl Output {
    /// Opens a temporary file beside `path` and leaves room for a header.
    pub fn create(path: &Path, force: bool, header_len: usize) -> Result<Self> {
        let create = || {
            if !force && path.symlink_metadata().is_ok() {
                return Err(FormatError::Exists);
            }
            let name = path.file_name().ok_or_else(|| {
                FormatError::invalid("output path", "the name of a file", path.display())
            })?;
            let mut prefix = std::ffi::OsString::from(".");
            prefix.push(name);
            prefix.push(".");
            let mut builder = tempfile::Builder::new();
            builder.prefix(&prefix).suffix(".part");
            #[cfg(unix)]
            {
                use std::os::unix::fs::PermissionsExt;
                // The umask applies, as for any new file.
                builder.permissions(std::fs::Permissions::from_mode(0o666));
            }
            let file = builder
                .tempfile_in(folder(path))
                .map_err(FormatError::io("cannot create a file in its folder"))?;
            let mut output = Self {
                file: BufWriter::with_capacity(1 << 20, file),
                path: path.into(),
                force,
                position: 0,
            };
            output.append(&vec![0; header_len])?;
            Ok(output)
        };
        create().map_err(|e| e.at(path))
    }

    /// The final name.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Bytes so far, the header's room included: where the next byte goes.
    pub fn position(&self) -> u64 {
        self.position
    }

    /// Writes at the end.
    pub fn append(&mut self, bytes: &[u8]) -> Result<()> {
        self.file
            .write_all(bytes)
            .map_err(|e| FormatError::io("cannot write")(e).at(&self.path))?;
        self.position += bytes.len() as u64;
        Ok(())
    }

    /// Writes the header, syncs, and gives the file its name.
    pub fn finish(self, header: &[u8]) -> Result<()> {
        let path = self.path;
        let (mut file, force) = (self.file, self.force);
        let finish = || {
            file.seek(SeekFrom::Start(0))
                .and_then(|_| file.write_all(header))
                .and_then(|()| file.flush())
                .map_err(FormatError::io("cannot write"))?;
            let file = file
                .into_inner()
                .map_err(|e| FormatError::io("cannot write")(e.into_error()))?;
            file.as_file()
                .sync_all()
                .map_err(FormatError::io("cannot sync"))?;
            let done = if force {
                file.persist(&path)
            } else {
                file.persist_noclobber(&path)
            };
            done.map_err(|e| match e.error.kind() {
                std::io::ErrorKind::AlreadyExists => FormatError::Exists,
                _ => FormatError::io("cannot rename to it")(e.error),
            })?;
            // So that the name survives a crash too. Not every file system can sync a folder.
            if let Ok(folder) = File::open(folder(&path)) {
                let _ = folder.sync_all();
            }
            Ok(())
        };
        finish().map_err(|e: FormatError| e.at(&path))
    }
}

fn folder(path: &Path) -> &Path {
    match path.parent() {
        Some(p) if !p.as_os_str().is_empty() => p,
        _ => Path::new("."),
    }
}

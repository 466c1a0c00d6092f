//! Reading the files of a scene: each is read once, in the order named, and joins the scene's hash.

use super::Settings;
use super::images::Images;
use super::values::GridValues;
use crate::formats::MappedFile;
use crate::run::{Cancel, Lists, frames, memory, one_line};
use crate::scene::Scene;
use crate::{Error, Result};
use std::borrow::Cow;
use std::collections::BTreeMap;
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
    /// What is worth knowing and nothing amiss.
    pub(super) notes: Vec<String>,
    /// Loops over what a file holds look at it.
    pub(super) cancel: Cancel,
    /// Where grids of volumes go.
    pub(super) lists: Lists,
    /// Values of the volumes read so far, if anyone wants to know them.
    pub(super) values: Option<Vec<GridValues>>,
    /// What they may be and take.
    pub(super) settings: Settings,
    /// Whether the scene names files of its frame.
    pub(super) names_frames: bool,
    /// Whether the scene names volumes that have nothing in them.
    pub(super) has_empty_volumes: bool,
    /// Where files may lie that other files name: the folder of the scene, and that of the file
    /// which the scene names.
    folders: Vec<PathBuf>,
    /// Images among them.
    pub(super) images: Images,
    /// By file, the grids that none of its volumes drew so far.
    pub(super) left_grids: BTreeMap<PathBuf, Vec<String>>,
}

impl Files {
    /// No files yet, with default settings.
    #[cfg(test)]
    pub(super) fn until(cancel: &Cancel) -> Self {
        Self::with(Settings::default(), cancel)
    }

    /// No files yet, of a scene that is read so.
    pub(super) fn with(settings: Settings, cancel: &Cancel) -> Self {
        Self {
            settings,
            cancel: cancel.clone(),
            ..Self::default()
        }
    }

    /// A name in the scene file, with the number of the frame in place of tokens for it.
    ///
    /// # Errors
    /// A token without a frame.
    pub(super) fn at_frame<'a>(&mut self, name: &'a str) -> Result<Cow<'a, str>> {
        let Some(token) = frames::token_in(name) else {
            return Ok(name.into());
        };
        let Some(frame) = self.settings.frame else {
            return Err(Error::input(format!(
                "found {token}, which stands for the number of a frame, but no frame"
            ))
            .hint("give `frames`, as 1-10"));
        };
        self.names_frames = true;
        Ok(frames::at_frame(name, frame))
    }

    /// What is read from now on is named by this file: the scene, or one that the scene names.
    pub(super) fn enter(&mut self, path: &Path) {
        self.folders.truncate(1);
        // One that is not there has no files that could be named.
        self.folders.extend(fs::canonicalize(folder(path)));
    }

    /// Refuses what another file than the scene names outside of the folders of both, links
    /// followed: who made a mesh does not choose which files of this machine are read.
    fn check_inside(&self, what: &str, by: &Path, path: &Path) -> Result<()> {
        if self.is_inside(by, path) {
            return Ok(());
        }
        Err(Error::input(format!(
            "{what} file {} lies outside of the folders of the scene and of the file that names \
             it, which `allow_outside` would allow",
            path.display()
        )))
    }

    fn is_inside(&self, by: &Path, path: &Path) -> bool {
        let by_itself = [PathBuf::from(folder(by))];
        let folders = match self.folders.is_empty() {
            true => &by_itself[..],
            false => &self.folders,
        };
        let is_below = |path: &Path| {
            let canonical = folders.iter().filter_map(|f| fs::canonicalize(f).ok());
            canonical.into_iter().any(|f| path.starts_with(f))
        };
        // One that is not there is for its reader to tell.
        self.settings.allow_outside || fs::canonicalize(path).map_or(true, |path| is_below(&path))
    }

    /// The file that `name`, as written in the file `by`, is meant to be, as far as can be told.
    /// Names come with quotes, with a comment behind them, in the wrong letter case, and with
    /// folders of another machine; then the file of that name beside `by` is taken.
    ///
    /// # Errors
    /// If there is none but outside of where it may lie.
    pub(super) fn find(&self, what: &str, by: &Path, name: &str) -> Result<Option<PathBuf>> {
        if let Some(path) = find_where(by, name, &|path| self.is_inside(by, path)) {
            return Ok(Some(path));
        }
        match find_where(by, name, &|_| true) {
            Some(path) => self.check_inside(what, by, &path).map(|()| Some(path)),
            None => Ok(None),
        }
    }

    /// The whole content of the file that `name` is in the file `by`.
    ///
    /// # Errors
    /// As [`Files::read`], and if it lies outside of where it may.
    pub(super) fn read_beside(&mut self, what: &str, by: &Path, name: &str) -> Result<Vec<u8>> {
        let path = beside(by, name);
        self.check_inside(what, by, &path)?;
        self.read(what, &path)
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

    /// The whole content of a file as [`Files::read`] gives it, mapped into memory: for files of
    /// which more is made than fits beside them.
    pub(super) fn map(&mut self, what: &str, path: &Path) -> Result<Content> {
        // What cannot be mapped is told as what cannot be read.
        let Ok(map) = MappedFile::open(path) else {
            return self.read(what, path).map(Content::Owned);
        };
        // All of it is read at once, and once more later.
        self.lists.watch(&map);
        self.add(map.as_ref())?;
        map.release(0..map.as_ref().len());
        self.paths.push(path.to_owned());
        Ok(Content::Mapped(map))
    }

    /// Lets a packed scene join the hash, by its own.
    pub(super) fn add_packed(&mut self, path: &Path, scene: &Scene) -> Result<()> {
        self.paths.push(path.to_owned());
        match scene.packed_hash() {
            Some(hash) => self.add(&hash),
            None => Ok(()),
        }
    }

    fn content(&self, path: &Path, failed: impl Fn(&io::Error) -> Error) -> Result<Vec<u8>> {
        let mut file = File::open(path).map_err(|e| failed(&e))?;
        let length = file.metadata().map_err(|e| failed(&e))?.len();
        let mut content = Vec::new();
        let room = usize::try_from(length).unwrap_or(usize::MAX);
        memory::heard(|| content.try_reserve_exact(room))
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

    /// Lets the changes of the scene file join the hash; none leave it as it is.
    pub(super) fn add_changes(&mut self) -> Result<()> {
        for change in std::mem::take(&mut self.settings.changes) {
            self.add(format!("{}={}", change.key, change.value).as_bytes())?;
            self.settings.changes.push(change);
        }
        if let Some(group) = self.settings.group.clone() {
            self.add(format!("group={group}").as_bytes())?;
        }
        Ok(())
    }

    /// blake3 over everything read.
    pub(super) fn hash(&self) -> [u8; 32] {
        self.hasher.finalize().into()
    }

    /// Tells the user something that is odd but not wrong.
    pub(super) fn warn(&mut self, message: impl Into<String>) {
        self.warnings.push(one_line(message.into()));
    }

    /// Notes the grids that a volume of a file leaves out, which other volumes of it may draw.
    pub(super) fn leave_grids(&mut self, path: &Path, labels: Vec<String>) {
        match self.left_grids.get_mut(path) {
            Some(left) => left.retain(|label| labels.contains(label)),
            None => {
                self.left_grids.insert(path.to_owned(), labels);
            }
        }
    }

    /// Tells the user something that is worth knowing.
    pub(super) fn note(&mut self, message: impl Into<String>) {
        self.notes.push(one_line(message.into()));
    }
}

/// The content of a file.
pub(super) enum Content {
    /// In memory of our own.
    Owned(Vec<u8>),
    /// In memory that comes from the file, and can be given back.
    Mapped(MappedFile),
}

impl Content {
    /// Refuses a mapped file that was cut meanwhile, of which the end may have been read as zeros.
    pub(super) fn check(&self) -> Result<()> {
        match self {
            Self::Owned(_) => Ok(()),
            Self::Mapped(map) => Ok(map.check_length()?),
        }
    }

    /// Gives the memory of what was mapped back to the system; it comes again from the file.
    pub(super) fn release(&self) {
        if let Self::Mapped(map) = self {
            map.release(0..map.as_ref().len());
        }
    }
}

impl AsRef<[u8]> for Content {
    fn as_ref(&self) -> &[u8] {
        match self {
            Self::Owned(bytes) => bytes,
            Self::Mapped(map) => map.as_ref(),
        }
    }
}

impl From<Vec<u8>> for Content {
    fn from(bytes: Vec<u8>) -> Self {
        Self::Owned(bytes)
    }
}

/// `name` as written in the file `by`, resolved against that file's folder. Both kinds of slash
/// separate folders.
pub(super) fn beside(by: &Path, name: &str) -> PathBuf {
    let name = name.replace('\\', "/");
    by.parent().unwrap_or(Path::new("")).join(name)
}

/// The folder that a file is in.
fn folder(path: &Path) -> &Path {
    match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    }
}

/// As [`Files::find`], of the files that may be taken.
fn find_where(by: &Path, name: &str, may_be: &dyn Fn(&Path) -> bool) -> Option<PathBuf> {
    let quotes = ['"', '\''];
    let uncommented = name.find(" #").map_or(name, |at| &name[..at]);
    let names = [name, uncommented].map(|n| n.trim().trim_matches(quotes).trim());
    let is_there = |path: PathBuf| (path.is_file() && may_be(&path)).then_some(path);
    let whole = is_there(beside(by, name.trim()));
    let whole = whole.or_else(|| names.iter().find_map(|n| is_there(beside(by, n))));
    whole.or_else(|| {
        names.iter().find_map(|name| {
            let last = name.rsplit(['/', '\\']).next().unwrap_or(name);
            let paths = [*name, last].map(|n| beside(by, n));
            let last_is_there = is_there(paths[1].clone());
            let any_case = || paths.iter().find_map(|p| is_there(in_any_case(p)?));
            last_is_there.or_else(any_case)
        })
    })
}

/// The path of a file whose name differs at most in letter case.
fn in_any_case(path: &Path) -> Option<PathBuf> {
    let wanted = path.file_name()?.to_str()?.to_lowercase();
    let folder = folder(path);
    let folder = match folder.is_dir() {
        true => folder.to_path_buf(),
        false => folder_in_any_case(folder)?,
    };
    entry(&folder, &wanted)
}

fn folder_in_any_case(folder: &Path) -> Option<PathBuf> {
    let parent = folder.parent()?;
    let parent = match parent.as_os_str().is_empty() || parent.is_dir() {
        true => parent.to_path_buf(),
        false => folder_in_any_case(parent)?,
    };
    entry(&parent, &folder.file_name()?.to_str()?.to_lowercase())
}

/// The first entry of a folder whose name in lower case is this.
fn entry(folder: &Path, wanted: &str) -> Option<PathBuf> {
    let folder = match folder.as_os_str().is_empty() {
        true => Path::new("."),
        false => folder,
    };
    let names = fs::read_dir(folder)
        .ok()?
        .filter_map(|e| Some(e.ok()?.file_name()));
    let is_wanted = |n: &std::ffi::OsString| n.to_str().is_some_and(|n| n.to_lowercase() == wanted);
    // Sorted, so that the choice does not depend on the file system.
    let name = names.filter(is_wanted).min()?;
    Some(folder.join(name))
}

/// The content of a text file without the byte order mark of UTF-8.
///
/// # Errors
/// UTF-16 or UTF-32, with a mark or without.
pub(super) fn text_start(content: &[u8]) -> Result<&[u8]> {
    let name = match content {
        [0xff, 0xfe, 0, 0, ..] | [0, 0, 0xfe, 0xff, ..] => "UTF-32",
        [0xff, 0xfe, ..] | [0xfe, 0xff, ..] => "UTF-16",
        // Two characters of ASCII.
        [0, 1..=0x7f, 0, 1..=0x7f, ..] | [1..=0x7f, 0, 1..=0x7f, 0, ..] => "UTF-16",
        _ => return Ok(content.strip_prefix(b"\xef\xbb\xbf").unwrap_or(content)),
    };
    Err(
        Error::input(format!("expected text in UTF-8, found {name}"))
            .hint("save the file as UTF-8, or as ASCII"),
    )
}

/// The extension in lower case, or an empty string; of `a.nii.gz` what it is unpacked.
pub(super) fn extension(path: &Path) -> String {
    let of = |path: &Path| {
        let extension = path.extension().unwrap_or_default();
        extension.to_string_lossy().to_lowercase()
    };
    let inner = path.file_stem().map(|stem| of(Path::new(stem)));
    match (of(path), inner.as_deref()) {
        (last, Some("nii")) if last == "gz" => "nii".into(),
        (last, _) => last,
    }
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
    fn files_are_found_by_what_is_meant() {
        let dir = tempfile::tempdir().unwrap();
        fs::create_dir(dir.path().join("Maps")).unwrap();
        for name in ["Case.PNG", "q.png", "Maps/a b.png"] {
            fs::write(dir.path().join(name), "").unwrap();
        }
        let by = dir.path().join("a.mtl");
        let find = |name: &str| Files::default().find("texture", &by, name).unwrap();
        for (name, found) in [
            ("q.png", "q.png"),
            ("\"q.png\"", "q.png"),
            ("q.png  # the wall", "q.png"),
            ("case.png", "Case.PNG"),
            ("maps/A B.png", "Maps/a b.png"),
            ("C:\\tex\\q.png", "q.png"),
            ("/home/me/Q.PNG", "q.png"),
        ] {
            let path = find(name);
            assert_eq!(path, Some(dir.path().join(found)), "{name}");
        }
        for name in ["x.png", "Maps", ""] {
            assert_eq!(find(name), None);
        }
    }

    #[test]
    fn text_starts_behind_its_mark() {
        assert_eq!(text_start(b"\xef\xbb\xbfv 0").unwrap(), b"v 0");
        assert_eq!(text_start(b"v").unwrap(), b"v");
        for (content, name) in [
            (&b"\xff\xfev\0 \0"[..], "UTF-16"),
            (b"\xfe\xff\0v", "UTF-16"),
            (b"v\0 \x000\0", "UTF-16"),
            (b"\xff\xfe\0\0v\0\0\0", "UTF-32"),
        ] {
            let message = text_start(content).unwrap_err().to_string();
            assert!(message.ends_with(&format!("found {name}")), "{message}");
        }
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

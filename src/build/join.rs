//! The parts of a bake as one cloud again.

use super::MappedCloud;
use crate::formats::{Cloud, CloudMeta, CloudSummary, CloudWriter, Lvoxel, Overwrite};
use crate::run::Job;
use crate::{Error, Result};
use std::path::{Path, PathBuf};

/// Name of the setting that tells which part of a bake a cloud is.
pub const PART: &str = "part";

/// A part of a bake: its number, that of all parts, and its cloud.
struct Piece<'a> {
    index: u32,
    count: u32,
    path: &'a Path,
    cloud: MappedCloud,
}

/// Joins all parts of a bake, given in any order, to the cloud that one undivided bake writes, to
/// the byte.
///
/// # Errors
/// Wrong input for clouds that are not the parts of one bake, each once; as
/// [`crate::formats::CloudWriter`] and [`Cloud`] for what cannot be written or read.
pub fn join(
    parts: &[PathBuf],
    cloud: &Path,
    overwrite: Overwrite,
    job: &Job,
) -> Result<CloudSummary> {
    let pieces = open(parts)?;
    let Some(first) = pieces.first() else {
        return Err(Error::input("expected a cloud, found none"));
    };
    let meta = whole(first.cloud.meta());
    let volumes = meta.volumes.len() as u16;
    let mut writer = CloudWriter::create(cloud, meta, overwrite)?;
    let points = |p: &Piece<'_>| p.cloud.summary().sums.surfels + p.cloud.summary().sums.lvoxels();
    let task = job
        .progress
        .task("join", pieces.iter().map(points).sum(), "points");
    for piece in &pieces {
        for i in 0..piece.cloud.surfel_chunks() {
            job.cancel.check()?;
            let surfels = piece.cloud.surfel_chunk(i)?;
            piece.cloud.release_surfel_chunks(i..i + 1);
            writer.push_surfels(&surfels)?;
            task.add(surfels.len() as u64);
        }
    }
    // A bake goes from volume to volume, and so does each of its parts.
    let mut rests: Vec<Lvoxels<'_>> = pieces.iter().map(|p| Lvoxels::new(&p.cloud)).collect();
    for volume in 0..volumes {
        for rest in &mut rests {
            while let Some(own) = rest.next_of(volume)? {
                job.cancel.check()?;
                writer.push_lvoxels(own)?;
                task.add(own.len() as u64);
            }
        }
    }
    Ok(writer.finish()?)
}

/// What the cloud of all parts of a bake says of its origin.
///
/// # Errors
/// As [`join`], for clouds that are not the parts of one bake.
pub fn meta_of(parts: &[PathBuf]) -> Result<CloudMeta> {
    match open(parts)?.first() {
        Some(first) => Ok(whole(first.cloud.meta())),
        None => Err(Error::input("expected a cloud, found none")),
    }
}

/// Missing parts that an error names.
const LISTED_PARTS: usize = 8;

/// Opens the parts and puts them in order.
fn open(paths: &[PathBuf]) -> Result<Vec<Piece<'_>>> {
    let mut pieces = paths
        .iter()
        .map(|path| {
            let cloud = Cloud::open_path(path)?;
            let found = part(cloud.meta()).map_err(|e| e.at(path.display()))?;
            match found {
                Some((index, count)) => Ok(Piece {
                    index,
                    count,
                    path,
                    cloud,
                }),
                None => Err(Error::input(format!(
                    "{}: expected one of several parts of a bake, found a whole cloud",
                    path.display()
                ))
                .hint("build each whole cloud by itself, or bake parts with `part`")),
            }
        })
        .collect::<Result<Vec<_>>>()?;
    pieces.sort_by_key(|p| p.index);
    for pair in pieces.windows(2) {
        let [a, b] = pair else { continue };
        let both = || format!("{} and {}", a.path.display(), b.path.display());
        if a.count != b.count || whole(a.cloud.meta()) != whole(b.cloud.meta()) {
            return Err(Error::input(format!(
                "{}: expected parts of one bake, found another scene, \
                 other settings or another count of parts",
                both()
            ))
            .hint("bake all parts of the same scene with the same settings"));
        }
        if a.index == b.index {
            return Err(
                Error::input(format!("{}: both are part {}/{}", both(), a.index, a.count))
                    .hint("give each part once"),
            );
        }
    }
    let count = pieces.first().map_or(0, |p| p.count);
    let missing: Vec<String> = (0..count)
        .filter(|i| pieces.iter().all(|p| p.index != *i))
        .take(LISTED_PARTS)
        .map(|i| i.to_string())
        .collect();
    let more = match (count as usize).saturating_sub(pieces.len() + missing.len()) {
        0 => String::new(),
        more => format!(" and {more} more"),
    };
    match (missing.is_empty(), pieces.first()) {
        (false, Some(first)) => Err(Error::input(format!(
            "expected all {} parts of the bake, found {}; missing: {}{more}",
            first.count,
            pieces.len(),
            missing.join(", ")
        ))
        .hint("bake the missing parts, and give all of them")),
        _ => Ok(pieces),
    }
}

/// Which part of how many a cloud is; `None` if it is whole.
///
/// # Errors
/// A number of a part that is none.
pub fn part(meta: &CloudMeta) -> Result<Option<(u32, u32)>> {
    let Some((_, text)) = meta.settings.iter().find(|(name, _)| name == PART) else {
        return Ok(None);
    };
    let numbers = text.split_once('/');
    match numbers.and_then(|(i, n)| Some((i.parse().ok()?, n.parse().ok()?))) {
        Some((index, count)) if index < count => Ok(Some((index, count))),
        _ => Err(Error::input(format!(
            "setting {PART:?}: expected a part and a count, as 0/8, found {text:?}"
        ))),
    }
}

/// The metadata without the part.
fn whole(meta: &CloudMeta) -> CloudMeta {
    let mut meta = meta.clone();
    meta.settings.retain(|(name, _)| name != PART);
    meta
}

/// The lvoxels of a cloud, one chunk at a time.
struct Lvoxels<'a> {
    cloud: &'a MappedCloud,
    next_chunk: usize,
    chunk: Vec<Lvoxel>,
    /// How many of the chunk were given.
    given: usize,
}

impl<'a> Lvoxels<'a> {
    fn new(cloud: &'a MappedCloud) -> Self {
        Self {
            cloud,
            next_chunk: 0,
            chunk: Vec::new(),
            given: 0,
        }
    }

    /// The next lvoxels, if they are of this volume.
    fn next_of(&mut self, volume: u16) -> Result<Option<&[Lvoxel]>> {
        if self.given == self.chunk.len() && self.next_chunk < self.cloud.lvoxel_chunks() {
            self.chunk = self.cloud.lvoxel_chunk(self.next_chunk)?;
            self.cloud
                .release_lvoxel_chunks(self.next_chunk..self.next_chunk + 1);
            self.next_chunk += 1;
            self.given = 0;
        }
        let rest = &self.chunk[self.given..];
        let own = rest.iter().take_while(|v| v.volume == volume).count();
        self.given += own;
        Ok((own > 0).then(|| &rest[..own]))
    }
}

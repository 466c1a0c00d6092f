//! Which points of a file a view shows: an even choice that depends on the file alone, made page by
//! page.

use super::super::disk::{Disk, SceneFromIndex};
use super::super::text::count as told;
use crate::Result;
use crate::formats::{
    Below, Block, Bounds, Cloud, FormatError, MappedFile, Sums, Surfel, Tree, VolumeInfo,
};
use crate::run::Cancel;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// What a view may take of a file.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    /// Points in all.
    pub points: usize,
    /// Pages, or chunks, of each kind that are read.
    pub pages: usize,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            points: 200_000,
            pages: 8192,
        }
    }
}

/// Points that are drawn together.
#[derive(Clone, Debug, PartialEq)]
pub struct Group {
    pub kind: GroupKind,
    /// How much larger points are drawn, so that they stand for those that are not chosen.
    pub grow: f64,
    pub points: Vec<Point>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GroupKind {
    /// Nodes so many steps below the root.
    Nodes(u32),
    Surfels,
    /// Lvoxels of a volume.
    Lvoxels(u16),
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    pub disk: Disk,
    /// Number of the page, or chunk, among those of its kind.
    pub page: u32,
    /// Whether a node has no nodes below that the view has, too; of an lvoxel its level, not 0.
    pub mark: u8,
}

/// The points of a view, and what was read for it.
#[derive(Debug, Default)]
pub struct Sample {
    pub groups: Vec<Group>,
    /// Steps from the root to the first node, by page of surfels, where they were read.
    pub page_levels: BTreeMap<u32, u32>,
    /// What was read, and how it was chosen: sentences.
    pub read: Vec<String>,
}

impl Sample {
    /// Box of all points; of those that are no nodes, radii included.
    pub fn bounds(&self) -> Option<Bounds> {
        let mut all = Bounds::EMPTY;
        for group in &self.groups {
            let is_node = matches!(group.kind, GroupKind::Nodes(_));
            for Point { disk, .. } in &group.points {
                let radius = if is_node { 0.0 } else { disk.radius };
                all = all.union(Bounds {
                    min: disk.position.map(|v| v - radius),
                    max: disk.position.map(|v| v + radius),
                });
            }
        }
        let is_whole =
            (0..3).all(|k| all.min[k] <= all.max[k] && (all.max[k] - all.min[k]).is_finite());
        is_whole.then_some(all)
    }
}

/// Points for surfaces, with nodes, and for media, by what there is.
fn shares(limits: Limits, surfaces: u64, media: u64) -> (usize, usize) {
    let half = (limits.points / 2) as u64;
    let of_media = media.min(half.max((limits.points as u64).saturating_sub(surfaces)));
    (limits.points - of_media as usize, of_media as usize)
}

/// Each how many-th of `count` is taken so that at most `room` are.
fn stride(count: u64, room: usize) -> u64 {
    count.div_ceil(room.max(1) as u64).max(1)
}

/// Evenly chosen numbers below `count`, at most `most` of them.
fn chosen(count: usize, most: usize) -> impl Iterator<Item = usize> {
    (0..count).step_by(count.div_ceil(most.max(1)).max(1))
}

/// Chooses points of a cloud.
pub fn of_cloud(cloud: &Cloud<MappedFile>, limits: Limits, cancel: &Cancel) -> Result<Sample> {
    let sums = &cloud.summary().sums;
    let (room, media_room) = shares(limits, sums.surfels, sums.lvoxels());
    let mut sample = Sample::default();
    let chunks: Vec<usize> = chosen(cloud.surfel_chunks(), limits.pages).collect();
    surfels(
        &mut sample,
        "chunks",
        cloud.surfel_blocks(),
        &chunks,
        room,
        |i| {
            cancel.check()?;
            let surfels = cloud.surfel_chunk(i)?;
            cloud.release_surfel_chunks(i..i + 1);
            Ok(surfels)
        },
    )?;
    let chunks: Vec<usize> = chosen(cloud.lvoxel_chunks(), limits.pages).collect();
    let volumes = &cloud.meta().volumes;
    let blocks = cloud.lvoxel_blocks();
    lvoxels(
        &mut sample,
        "chunks",
        (blocks, volumes),
        &chunks,
        media_room,
        |i| {
            cancel.check()?;
            let lvoxels = cloud.lvoxel_chunk(i)?;
            cloud.release_lvoxel_chunks(i..i + 1);
            Ok(lvoxels)
        },
    )?;
    Ok(sample)
}

/// Chooses points of a tree: the levels of nodes that fit, from the root on, and surfels if all of
/// their pages may be read.
pub fn of_tree(
    tree: &Tree<MappedFile>,
    path: &Path,
    limits: Limits,
    cancel: &Cancel,
) -> Result<Sample> {
    let summary = tree.summary();
    let sums: &Sums = &summary.sums;
    let surfaces = sums.surfels.saturating_add(summary.nodes);
    let (room, media_room) = shares(limits, surfaces, sums.lvoxels());
    let has_surfels = tree.surfel_pages() <= limits.pages;
    let for_surfels = match has_surfels {
        true => sums.surfels.min((room / 5 * 3) as u64) as usize,
        false => 0,
    };
    let mut sample = Sample::default();
    let nodes = match tree.root_page() {
        Some(root) => {
            let mut walk = Walk::new(tree, path, root, limits.pages, cancel);
            walk.levels_within(room - for_surfels)?;
            walk.end(&mut sample)
        }
        None => 0,
    };
    if has_surfels {
        let pages: Vec<usize> = (0..tree.surfel_pages()).collect();
        let blocks = tree.surfel_blocks();
        surfels(&mut sample, "pages", blocks, &pages, room - nodes, |i| {
            cancel.check()?;
            let surfels = tree.surfel_page(i)?.surfels;
            tree.release_surfel_page(i);
            Ok(surfels)
        })?;
    }
    let pages: Vec<usize> = chosen(tree.lvoxel_pages(), limits.pages).collect();
    let blocks = tree.lvoxel_blocks();
    lvoxels(
        &mut sample,
        "pages",
        (blocks, &tree.meta().cloud.volumes),
        &pages,
        media_room,
        |i| {
            cancel.check()?;
            Ok(tree.lvoxel_page(i)?)
        },
    )?;
    Ok(sample)
}

/// Nodes of a tree, level by level. One page is in memory at a time.
struct Walk<'a> {
    tree: &'a Tree<MappedFile>,
    path: &'a Path,
    most_pages: usize,
    cancel: &'a Cancel,
    /// Pages that are linked to but not read, by the level of their roots.
    open: BTreeSet<(u32, u32)>,
    /// All pages that are linked to.
    linked: BTreeSet<u32>,
    /// Pages that were read, with the level of their roots.
    read: BTreeMap<u32, u32>,
    levels: Vec<Vec<Point>>,
}

impl<'a> Walk<'a> {
    fn new(
        tree: &'a Tree<MappedFile>,
        path: &'a Path,
        root: u32,
        most_pages: usize,
        cancel: &'a Cancel,
    ) -> Self {
        Self {
            tree,
            path,
            most_pages,
            cancel,
            open: [(0, root)].into(),
            linked: [root].into(),
            read: BTreeMap::new(),
            levels: Vec::new(),
        }
    }

    /// Finds all nodes down to the finest level whose nodes, with those of the levels above, are at
    /// most `room`.
    fn levels_within(&mut self, room: usize) -> Result<()> {
        let mut total = 0_u64;
        let fits = |level: &&crate::formats::TreeLevel| {
            total = total.saturating_add(level.nodes);
            level.nodes > 0 && total <= room as u64
        };
        let counts = self.tree.summary().levels.iter();
        let wanted: Vec<u64> = counts.take_while(fits).map(|l| l.nodes).collect();
        // The root is always shown.
        let last = wanted.len().saturating_sub(1) as u32;
        self.levels = vec![Vec::new(); last as usize + 1];
        let mut nodes = Vec::new();
        while let Some((level, id)) = self.open.pop_first() {
            self.cancel.check()?;
            self.tree.surfel_nodes(id as usize, &mut nodes)?;
            self.tree.release_surfel_page(id as usize);
            self.read.insert(id, level);
            // Nodes below the last level are too deep, and so is all below them.
            let mut depths = vec![u32::MAX; nodes.len()];
            if let Some(of_root) = depths.first_mut() {
                *of_root = level;
            }
            for (i, node) in nodes.iter().enumerate() {
                let depth = depths[i];
                if depth > last {
                    continue;
                }
                let mut is_end = true;
                match node.below {
                    Below::Nodes { first, count } => {
                        depths[first as usize..][..usize::from(count)].fill(depth + 1);
                        is_end = false;
                    }
                    Below::Surfels { .. } => {}
                    Below::Page(next) | Below::EvenPage(next) if !self.linked.insert(next) => {
                        return Err(self.linked_twice(next));
                    }
                    // The root of that page is this node; it stands for it if the page is read.
                    Below::Page(next) | Below::EvenPage(next)
                        if depth < last && self.read.len() + self.open.len() < self.most_pages =>
                    {
                        self.open.insert((depth, next));
                        continue;
                    }
                    Below::Page(_) | Below::EvenPage(_) => {}
                }
                let disk = Disk::of_node(node);
                self.levels[depth as usize].push(Point {
                    disk,
                    page: id,
                    mark: u8::from(is_end),
                });
            }
        }
        // What the summary says is checked by `verify` alone.
        let found: usize = self.levels.iter().map(Vec::len).sum();
        if found > room.max(1) {
            return Err(self.invalid(
                "summary",
                &format!("{room} nodes in {} levels", last + 1),
                &found.to_string(),
            ));
        }
        Ok(())
    }

    fn linked_twice(&self, page: u32) -> crate::Error {
        self.invalid(&format!("links to page {page}"), "one", "two")
    }

    fn invalid(&self, what: &str, expected: &str, found: &str) -> crate::Error {
        FormatError::Invalid {
            what: what.into(),
            expected: expected.into(),
            found: found.into(),
        }
        .at(self.path)
        .into()
    }

    /// Gives what was found to the sample; returns how many nodes.
    fn end(self, sample: &mut Sample) -> usize {
        let summary = self.tree.summary();
        let mut count = 0;
        let levels = self.levels.len();
        for (level, mut points) in self.levels.into_iter().enumerate() {
            count += points.len();
            points.sort_by_key(|p| p.page);
            sample.groups.push(Group {
                kind: GroupKind::Nodes(level as u32),
                grow: NODE_GROW,
                points,
            });
        }
        sample.read.push(format!(
            "Nodes: levels 0 to {} of {}, {} nodes, from {} of {} pages.",
            levels.saturating_sub(1),
            summary
                .levels
                .iter()
                .rposition(|l| l.nodes > 0)
                .unwrap_or(0),
            told(count as u64),
            told(self.read.len() as u64),
            told(self.tree.surfel_pages() as u64),
        ));
        sample.page_levels = self.read;
        count
    }
}

/// Disks that have the areas of nodes leave gaps.
const NODE_GROW: f64 = 1.5;

/// Adds every k-th surfel of some blocks, so that they are at most `room`.
fn surfels(
    sample: &mut Sample,
    name: &str,
    blocks: &[Block],
    chosen: &[usize],
    room: usize,
    mut load: impl FnMut(usize) -> Result<Vec<Surfel>>,
) -> Result<()> {
    if blocks.is_empty() {
        return Ok(());
    }
    let count: u64 = chosen.iter().map(|&i| u64::from(blocks[i].records)).sum();
    let stride = stride(count, room);
    let mut points = Vec::new();
    let mut next = 0;
    for &i in chosen {
        for s in load(i)? {
            if next == 0 {
                points.push(Point {
                    disk: Disk::of_surfel(&s),
                    page: i as u32,
                    mark: 0,
                });
                next = stride;
            }
            next -= 1;
        }
    }
    sample.read.push(sentence(
        ("Surfels", name),
        points.len(),
        stride,
        blocks,
        chosen,
    ));
    sample.groups.push(Group {
        kind: GroupKind::Surfels,
        grow: (stride as f64).sqrt(),
        points,
    });
    Ok(())
}

/// Volumes of a view, at most.
const MAX_VOLUMES: usize = 1024;

/// Adds every k-th lvoxel of some blocks, volume by volume.
fn lvoxels(
    sample: &mut Sample,
    name: &str,
    (blocks, volumes): (&[Block], &[VolumeInfo]),
    chosen: &[usize],
    room: usize,
    mut load: impl FnMut(usize) -> Result<Vec<crate::formats::Lvoxel>>,
) -> Result<()> {
    if blocks.is_empty() {
        return Ok(());
    }
    let count: u64 = chosen.iter().map(|&i| u64::from(blocks[i].records)).sum();
    let stride = stride(count, room);
    let maps: Vec<Option<SceneFromIndex>> = volumes.iter().map(SceneFromIndex::of).collect();
    let mut by_volume = BTreeMap::<u16, Vec<Point>>::new();
    let mut left_out = 0_u64;
    let mut next = 0;
    for &i in chosen {
        for v in load(i)? {
            if next == 0 {
                next = stride;
                if by_volume.len() == MAX_VOLUMES && !by_volume.contains_key(&v.volume) {
                    left_out += 1;
                // Readers refuse others, and a flat volume has no place.
                } else if let Some(Some(map)) = maps.get(usize::from(v.volume)) {
                    by_volume.entry(v.volume).or_default().push(Point {
                        disk: Disk::of_lvoxel(&v, map),
                        page: i as u32,
                        mark: v.level,
                    });
                }
            }
            next -= 1;
        }
    }
    let found = by_volume.values().map(Vec::len).sum();
    sample
        .read
        .push(sentence(("Lvoxels", name), found, stride, blocks, chosen));
    if left_out > 0 {
        sample.read.push(format!(
            "{} of them are left out: a view has {MAX_VOLUMES} volumes.",
            told(left_out)
        ));
    }
    for (volume, points) in by_volume {
        sample.groups.push(Group {
            kind: GroupKind::Lvoxels(volume),
            grow: (stride as f64).cbrt(),
            points,
        });
    }
    Ok(())
}

fn sentence(
    (what, name): (&str, &str),
    found: usize,
    stride: u64,
    blocks: &[Block],
    chosen: &[usize],
) -> String {
    let total: u64 = blocks.iter().map(|b| u64::from(b.records)).sum();
    let each = match stride {
        1 => String::new(),
        k => format!(", one in {}", told(k)),
    };
    let of = match chosen.len() == blocks.len() {
        true => format!("all {} {name}", told(blocks.len() as u64)),
        false => format!(
            "{} of {} {name}, evenly chosen",
            told(chosen.len() as u64),
            told(blocks.len() as u64)
        ),
    };
    let (found, total) = (told(found as u64), told(total));
    format!("{what}: {found} of {total}{each}, from {of}.")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_fit_and_choices_are_even() {
        let limits = Limits {
            points: 100,
            pages: 4,
        };
        assert_eq!(shares(limits, 10, 5), (95, 5));
        assert_eq!(shares(limits, 1000, 1000), (50, 50));
        assert_eq!(shares(limits, 10, 1000), (10, 90));
        assert_eq!(shares(limits, 1000, 10), (90, 10));
        for (count, room) in [(0, 7), (7, 7), (8, 7), (100, 7), (5, 0)] {
            let k = stride(count, room);
            assert!(count.div_ceil(k) <= room.max(1) as u64, "{count} {room}");
        }
        assert_eq!(chosen(10, 4).collect::<Vec<_>>(), [0, 3, 6, 9]);
        assert_eq!(chosen(3, 4).count(), 3);
        assert_eq!(chosen(0, 4).count(), 0);
    }
}

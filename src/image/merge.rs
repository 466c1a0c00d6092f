//! Puts tiles together into the frame that one process would have written, byte for byte.

use super::coverage::faults;
use super::exr::{self, Info};
use super::frame::EXPOSURE;
use super::{Exposure, Frame, ImageKind, Layer, Region, write};
use crate::run::{Job, memory, size};
use crate::{Error, Result};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// A frame that was put together from tiles.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
pub struct Merged {
    /// Pixels across of the frame.
    pub width: u32,
    /// Pixels down of the frame.
    pub height: u32,
    /// Files that were put together.
    pub tiles: usize,
}

/// Beginning of the names of attributes that say what the pixels were made from.
const PREFIX: &str = "lvox/";

/// Faults that are listed in an error, at most.
const MAX_LISTED: usize = 4;

/// What becomes of pixels that no tile has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Missing {
    /// There must be none.
    Refuse,
    /// They stay black, with a warning.
    Black,
}

/// Rectangles of a frame that none of its tiles has: few, as those that touch are one.
///
/// # Errors
/// [`crate::Kind::Input`] if the tiles are not of one frame or overlap; else what reading can give.
pub fn missing(inputs: &[PathBuf]) -> Result<Vec<Region>> {
    let infos = infos(inputs)?;
    gaps(inputs, &infos)
}

/// Merges tiles of one frame, to an image of the kind that `output` is named for; one of eight bits
/// has the exposure that is given, or that of the scene's film if the tiles tell it, or 1. All
/// headers are checked before the first pixel is read, and the
/// output is not touched until all tiles are read.
///
/// # Errors
/// [`crate::Kind::Input`] if the tiles were made from different trees, scenes or settings (the
/// message names the files and what differs), if they overlap, or if pixels are missing that must
/// not be; else what reading and writing can give.
pub fn merge(
    inputs: &[PathBuf],
    output: &Path,
    missing: Missing,
    exposure: Option<Exposure>,
    job: &Job,
) -> Result<Merged> {
    ImageKind::named(output)?;
    let infos = infos(inputs)?;
    let gaps = gaps(inputs, &infos)?;
    let first = &infos[0];
    match missing {
        Missing::Refuse => check_complete(inputs.len(), &gaps, first)?,
        Missing::Black if gaps.is_empty() => {}
        Missing::Black => job.progress.warn(&format!(
            "{}: black where there is no tile, {}",
            output.display(),
            listed(&gaps)
        )),
    }
    check_memory(first, job.memory_limit)?;

    let task = job.progress.task("merge", inputs.len() as u64, "tiles");
    let full = Region::full(first.width, first.height);
    let mut frame = Frame::new(first.width, first.height, full);
    frame.attributes = shared_attributes(&infos);
    frame.camera = (first.camera).filter(|_| infos.iter().all(|i| i.camera == first.camera));
    for path in inputs {
        job.cancel.check()?;
        let tile = exr::read(path)?;
        paste(&mut frame, tile);
        task.add(1);
    }
    if let Some(found) = frame.not_finite() {
        job.progress.warn(&format!("{}: {found}", output.display()));
    }
    job.heed_warnings()?;
    write(output, &frame, first.precision(), exposure, job)?;
    Ok(Merged {
        width: frame.width,
        height: frame.height,
        tiles: inputs.len(),
    })
}

fn paste(frame: &mut Frame, tile: Frame) {
    let width = frame.width as usize;
    let pixels = frame.region.pixels();
    for layer in tile.layers {
        for (channel, samples) in layer.channels {
            let target = channel_mut(frame, &layer.name, channel, pixels);
            let rows = samples.chunks_exact(tile.region.width() as usize);
            for (y, row) in (tile.region.y0..tile.region.y1).zip(rows) {
                let start = y as usize * width + tile.region.x0 as usize;
                target[start..start + row.len()].copy_from_slice(row);
            }
        }
    }
}

fn channel_mut<'a>(
    frame: &'a mut Frame,
    layer: &str,
    channel: String,
    pixels: usize,
) -> &'a mut [f32] {
    let at = frame
        .layers
        .iter()
        .position(|l| l.name == layer)
        .unwrap_or_else(|| {
            frame.layers.push(Layer {
                name: layer.into(),
                channels: Vec::new(),
            });
            frame.layers.len() - 1
        });
    let channels = &mut frame.layers[at].channels;
    let at = channels
        .iter()
        .position(|(n, _)| *n == channel)
        .unwrap_or_else(|| {
            channels.push((channel, vec![0.0; pixels]));
            channels.len() - 1
        });
    &mut channels[at].1
}

/// What all tiles say. Only attributes that other programs have added can differ here, and the
/// exposure, which pixels do not depend on: tiles that tell none agree with any.
fn shared_attributes(infos: &[Info]) -> BTreeMap<String, String> {
    let mut shared = infos
        .first()
        .map_or_else(BTreeMap::new, |i| i.attributes.clone());
    shared.retain(|name, value| infos.iter().all(|i| i.attributes.get(name) == Some(value)));
    let exposures: BTreeSet<&String> = infos
        .iter()
        .filter_map(|i| i.attributes.get(EXPOSURE))
        .collect();
    if let (Some(exposure), 1) = (exposures.first(), exposures.len()) {
        shared.insert(EXPOSURE.into(), (*exposure).clone());
    }
    shared
}

/// Everything but the region must be the same as in the first tile.
fn check_agreement(
    (first_path, first): (&Path, &Info),
    (path, info): (&Path, &Info),
) -> Result<()> {
    let differ = |what: &str, here: String, there: String| {
        Err(Error::input(format!(
            "{} does not belong to the frame of {}: {what} is {here}, there {there}",
            path.display(),
            first_path.display()
        ))
        .hint("merge tiles of one frame only, shaded from the same tree with the same settings"))
    };
    if (info.width, info.height) != (first.width, first.height) {
        let size = |i: &Info| format!("{}x{}", i.width, i.height);
        return differ("the frame size", size(info), size(first));
    }
    if info.channels != first.channels {
        let list = |i: &Info| {
            let names = i
                .channels
                .iter()
                .map(|(n, precision)| format!("{n}:{}", precision.bits()));
            names.collect::<Vec<_>>().join(" ")
        };
        let (here, there) = clip(&list(info), &list(first));
        return differ("the list of channels", here, there);
    }
    let names = info.attributes.keys().chain(first.attributes.keys());
    let ours: BTreeSet<&String> = names
        .filter(|n| n.starts_with(PREFIX) && *n != EXPOSURE)
        .collect();
    for name in ours {
        let (here, there) = (info.attributes.get(name), first.attributes.get(name));
        if here != there {
            let shown = |v: Option<&String>| v.map_or("absent", String::as_str).to_owned();
            let (here, there) = clip(&shown(here), &shown(there));
            return differ(name, here, there);
        }
    }
    Ok(())
}

/// Long texts from shortly before the place where they begin to differ.
fn clip(a: &str, b: &str) -> (String, String) {
    const BEFORE: usize = 24;
    const SHOWN: usize = 72;
    let same = a.chars().zip(b.chars()).take_while(|(a, b)| a == b).count();
    let longest = a.chars().count().max(b.chars().count());
    let skip = if longest <= SHOWN {
        0
    } else {
        same.saturating_sub(BEFORE)
    };
    let cut = |text: &str| {
        let rest: String = text.chars().skip(skip).take(SHOWN).collect();
        let more = text.chars().count() > skip + SHOWN;
        format!(
            "{}{rest}{}",
            if skip > 0 { "..." } else { "" },
            if more { "..." } else { "" }
        )
    };
    (cut(a), cut(b))
}

fn infos(inputs: &[PathBuf]) -> Result<Vec<Info>> {
    let infos: Vec<Info> = inputs
        .iter()
        .map(|path| exr::info(path))
        .collect::<Result<_>>()?;
    let Some(first) = infos.first() else {
        return Err(Error::input("there are no tiles to merge"));
    };
    for (path, info) in inputs.iter().zip(&infos) {
        check_agreement((&inputs[0], first), (path, info))?;
    }
    Ok(infos)
}

/// What tiles of a frame leave uncovered; none may overlap.
fn gaps(paths: &[PathBuf], infos: &[Info]) -> Result<Vec<Region>> {
    let regions: Vec<Region> = infos.iter().map(|i| i.region).collect();
    let found = faults(infos[0].width, infos[0].height, &regions);
    if found.overlaps.is_empty() {
        return Ok(found.missing);
    }
    let shown = found.overlaps.iter().take(MAX_LISTED).map(|&(a, b)| {
        let name = |i: usize| format!("{} ({})", paths[i].display(), regions[i]);
        format!("{} and {}", name(a), name(b))
    });
    Err(Error::input(format!(
        "tiles overlap: {}{}",
        shown.collect::<Vec<_>>().join("; "),
        more(found.overlaps.len())
    ))
    .hint("give each part of the frame once"))
}

fn check_complete(tiles: usize, gaps: &[Region], first: &Info) -> Result<()> {
    let Some(gap) = gaps.first() else {
        return Ok(());
    };
    let (width, height) = (first.width, first.height);
    Err(Error::input(format!(
        "{tiles} tiles leave parts of the {width}x{height} frame uncovered: {}",
        listed(gaps)
    ))
    .hint(format!(
        "add the missing tiles, or shade the parts: `region` {gap}"
    )))
}

/// The first of some rectangles.
fn listed(gaps: &[Region]) -> String {
    let shown = gaps.iter().take(MAX_LISTED).map(Region::to_string);
    shown.collect::<Vec<_>>().join("; ") + &more(gaps.len())
}

/// The whole frame is held three times over: as floats, as samples of the file, and encoded.
fn check_memory(info: &Info, limit: Option<u64>) -> Result<()> {
    let samples = u64::from(info.width) * u64::from(info.height) * info.channels.len() as u64;
    let needed = samples.saturating_mul(3 * size_of::<f32>() as u64);
    let (width, height, channels) = (info.width, info.height, info.channels.len());
    let what = format_args!("merging {width}x{height} pixels of {channels} channels");
    size::within(what, needed, limit)?;
    // Samples of the file are halves at least, and compressed they may be next to nothing.
    let least = samples.saturating_mul((size_of::<f32>() + size_of::<u16>()) as u64);
    memory::check(what, least)
}

fn more(count: usize) -> String {
    if count > MAX_LISTED {
        format!("; and {} more", count - MAX_LISTED)
    } else {
        String::new()
    }
}

#[cfg(test)]
mod tests {
    use super::super::CameraMatrices;
    use super::super::exr::Precision;
    use super::*;

    const WIDTH: u32 = 61;
    const HEIGHT: u32 = 47;

    fn shade(region: Region) -> Frame {
        let mut frame = Frame::new(WIDTH, HEIGHT, region);
        let mut pixels = Vec::new();
        for y in region.y0..region.y1 {
            for x in region.x0..region.x1 {
                pixels.push([(x * x) as f32 / 7.0, y as f32 * 1e-3, f32::NAN]);
            }
        }
        frame.layers.push(Layer::rgb("", &pixels));
        frame.layers.push(Layer::rgb("indirect", &pixels));
        frame.layers.push(Layer::single(
            "depth",
            "Z",
            pixels.iter().map(|p| p[0] * 1e4).collect(),
        ));
        frame.attributes.insert("lvox/tree".into(), "00ff".into());
        frame
            .attributes
            .insert("lvox/settings".into(), "samples=64".into());
        frame.camera = Some(CameraMatrices {
            world_to_camera: [0.1; 16],
            world_to_ndc: [0.2; 16],
        });
        frame
    }

    fn tiles(dir: &Path, count: u32, precision: Precision) -> Vec<PathBuf> {
        (0..count)
            .map(|i| {
                let path = dir.join(format!("tile{i}.exr"));
                let region = Region::tile(WIDTH, HEIGHT, i, count).unwrap();
                exr::write(&path, &shade(region), precision).unwrap();
                path
            })
            .collect()
    }

    #[test]
    fn merged_file_is_the_file_of_the_whole_frame() {
        let dir = tempfile::tempdir().unwrap();
        for precision in [Precision::Half, Precision::Float] {
            let whole = exr::encode(&shade(Region::full(WIDTH, HEIGHT)), precision).unwrap();
            for count in [1, 2, 7, 16] {
                let mut inputs = tiles(dir.path(), count, precision);
                inputs.reverse();
                let output = dir.path().join("merged.exr");
                let merged =
                    merge(&inputs, &output, Missing::Refuse, None, &Job::default()).unwrap();
                assert_eq!(
                    merged,
                    Merged {
                        width: WIDTH,
                        height: HEIGHT,
                        tiles: count as usize
                    }
                );
                assert_eq!(std::fs::read(&output).unwrap(), whole, "{count} tiles");
            }
        }
    }

    #[track_caller]
    fn refused(inputs: &[PathBuf], dir: &Path, parts: &[&str]) {
        let output = dir.join("merged.exr");
        let error = merge(inputs, &output, Missing::Refuse, None, &Job::default()).unwrap_err();
        assert_eq!(error.kind(), crate::Kind::Input);
        assert!(!output.exists());
        let text = format!("{error} / {}", error.hint_text().unwrap_or(""));
        for part in parts {
            assert!(text.contains(part), "{part:?} is not in {text:?}");
        }
    }

    #[test]
    fn holes_overlaps_and_strangers_are_named() {
        let dir = tempfile::tempdir().unwrap();
        let inputs = tiles(dir.path(), 4, Precision::Half);
        let gap = Region::tile(WIDTH, HEIGHT, 2, 4).unwrap().to_string();
        let three = [inputs[0].clone(), inputs[1].clone(), inputs[3].clone()];
        refused(&three, dir.path(), &["uncovered", &gap, "`region`"]);
        let mut five = inputs.clone();
        five.push(inputs[1].clone());
        refused(&five, dir.path(), &["overlap", "tile1.exr"]);
        refused(&[], dir.path(), &["no tiles"]);

        let region = Region::tile(WIDTH, HEIGHT, 3, 4).unwrap();
        let write = |change: &dyn Fn(&mut Frame), precision| {
            let mut frame = shade(region);
            change(&mut frame);
            exr::write(&inputs[3], &frame, precision).unwrap();
        };
        write(
            &|f| drop(f.attributes.insert("lvox/tree".into(), "0bad".into())),
            Precision::Half,
        );
        refused(
            &inputs,
            dir.path(),
            &["tile3.exr", "tile0.exr", "lvox/tree", "0bad", "00ff"],
        );
        write(
            &|f| drop(f.attributes.remove("lvox/settings")),
            Precision::Half,
        );
        refused(
            &inputs,
            dir.path(),
            &["tile3.exr", "lvox/settings", "absent"],
        );
        write(&|f| drop(f.layers.pop()), Precision::Half);
        refused(&inputs, dir.path(), &["tile3.exr", "channels"]);
        write(&|_| (), Precision::Float);
        refused(&inputs, dir.path(), &["tile3.exr", "channels", "R:32"]);
        write(&|f| f.width += 1, Precision::Half);
        refused(&inputs, dir.path(), &["tile3.exr", "62x47", "61x47"]);
    }

    #[test]
    fn foreign_attributes_that_differ_are_dropped() {
        let dir = tempfile::tempdir().unwrap();
        let inputs = tiles(dir.path(), 2, Precision::Half);
        for (i, path) in inputs.iter().enumerate() {
            let mut frame = exr::read(path).unwrap();
            frame
                .attributes
                .insert("DateTime".into(), format!("2026:01:0{i}"));
            frame.attributes.insert("Studio".into(), "here".into());
            exr::write(path, &frame, Precision::Half).unwrap();
        }
        let output = dir.path().join("merged.exr");
        merge(&inputs, &output, Missing::Refuse, None, &Job::default()).unwrap();
        let names: Vec<String> = exr::info(&output).unwrap().attributes.into_keys().collect();
        assert_eq!(names, ["Studio", "lvox/settings", "lvox/tree"]);
    }

    #[test]
    fn the_exposure_is_carried_and_never_refused() {
        let dir = tempfile::tempdir().unwrap();
        let inputs = tiles(dir.path(), 3, Precision::Half);
        let output = dir.path().join("merged.exr");
        for (told, expected) in [
            ([Some("2"), Some("2"), Some("2")], Some("2")),
            ([None, Some("2"), None], Some("2")),
            ([Some("1"), Some("2"), None], None),
            ([None; 3], None),
        ] {
            for (path, exposure) in inputs.iter().zip(told) {
                let mut frame = exr::read(path).unwrap();
                frame.attributes.remove(EXPOSURE);
                frame
                    .attributes
                    .extend(exposure.map(|e| (EXPOSURE.to_owned(), e.to_owned())));
                exr::write(path, &frame, Precision::Half).unwrap();
            }
            merge(&inputs, &output, Missing::Refuse, None, &Job::default()).unwrap();
            let attributes = exr::info(&output).unwrap().attributes;
            assert_eq!(attributes.get(EXPOSURE).map(String::as_str), expected);
        }
    }

    #[test]
    fn the_memory_limit_is_kept() {
        let dir = tempfile::tempdir().unwrap();
        let inputs = tiles(dir.path(), 2, Precision::Half);
        let output = dir.path().join("merged.exr");
        // 61 x 47 pixels of 7 channels, 12 bytes each.
        let job = |limit| Job {
            memory_limit: Some(limit),
            ..Job::default()
        };
        let error = merge(&inputs, &output, Missing::Refuse, None, &job(240_000)).unwrap_err();
        assert!(error.to_string().contains("235 KiB"), "{error}");
        merge(&inputs, &output, Missing::Refuse, None, &job(241_000)).unwrap();
    }

    #[test]
    fn long_values_are_cut_where_they_differ() {
        let (a, b) = (
            format!("{}1{}", "x".repeat(200), "y".repeat(200)),
            format!("{}2", "x".repeat(200)),
        );
        let (a, b) = clip(&a, &b);
        assert!(a.starts_with("...x") && a.contains("x1y") && a.ends_with("..."));
        assert!(b.ends_with("x2"));
        assert_eq!(clip("a", "b"), ("a".into(), "b".into()));
    }
}

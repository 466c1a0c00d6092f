//! One page of HTML to look into a file with: tables for all kinds of files, a view of the points
//! of clouds and trees, the layers of images. It needs nothing but itself.
//!
//! In: a description of a file, and the file. Out: the page. The same file gives the same page.
//!
//! - `tables`: descriptions as tables. `data`: what scripts read.
//! - `sample`: points of a cloud or a tree, evenly chosen; `encode`: their bytes; `map`: pages.
//! - `layers`: values of an image.
//! - `page.html`, `page.css`: the frame; `page.js`: what scripts share; `view.js`: points in
//!   WebGL2; `charts.js`: page map and histograms; `picture.js`: layers and the pixel probe.

mod data;
mod encode;
mod layers;
mod map;
mod sample;
mod tables;

use super::File;
use crate::image::exr;
use crate::run::{Job, one_line};
use crate::{Error, Result};
use data::Data;
use sample::{Limits, Sample};
use serde::Serialize;
use serde_json::json;
use std::path::Path;

const FRAME: &str = include_str!("page.html");
const STYLE: &str = include_str!("page.css");
const SHARED: &str = include_str!("page.js");
const VIEW: &str = include_str!("view.js");
const CHARTS: &str = include_str!("charts.js");
const PICTURE: &str = include_str!("picture.js");

/// What a page shows beside tables.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shown {
    /// Nothing.
    Tables,
    /// The points and pages of a cloud or a tree.
    Points,
    /// The layers of an image.
    Layers,
}

/// Makes the page of a file from its description.
///
/// Of clouds and trees as many pages are read as a view of 200,000 points needs, 8192 of each kind
/// at most, one at a time; the page says which.
///
/// # Errors
/// Wrong input for a damaged file, or one of another kind than `shown` says; a stop of the job.
pub fn page(path: &Path, description: &impl Serialize, shown: Shown, job: &Job) -> Result<String> {
    let failed = |e: serde_json::Error| Error::failed(format!("cannot encode the result: {e}"));
    let json = serde_json::to_string(description).map_err(failed)?;
    let told = serde_json::from_str(&json).map_err(failed)?;
    let mut data = Data::default();
    let mut scripts = vec![SHARED];
    let mut notes = Vec::new();
    match shown {
        Shown::Tables => {}
        Shown::Points => {
            notes = points(path, &mut data, job)?;
            scripts.extend([CHARTS, VIEW]);
        }
        Shown::Layers => {
            let info = exr::info(path)?;
            let frame = exr::read(path)?;
            let layers = layers::layers(&frame, &info, &mut data);
            data.set("picture", layers);
            scripts.push(PICTURE);
        }
    }
    let name = path.file_name().unwrap_or(path.as_os_str());
    let name = one_line(name.to_string_lossy());
    data.set("notes", notes);
    Ok(filled(&[
        ("title", &tables::escape(&name)),
        ("style", STYLE),
        ("tables", &tables::tables(&told)),
        ("version", env!("CARGO_PKG_VERSION")),
        ("data", &data.to_html()),
        ("scripts", &scripts.join("\n")),
    ]))
}

/// Adds what a view of points needs; returns what was read.
fn points(path: &Path, data: &mut Data, job: &Job) -> Result<Vec<String>> {
    let limits = Limits::default();
    let file = File::open(path)?;
    let (sample, meta, sums, surfels, lvoxels) = match &file {
        File::Cloud(cloud) => (
            sample::of_cloud(cloud, limits, &job.cancel)?,
            cloud.meta(),
            &cloud.summary().sums,
            cloud.surfel_blocks(),
            cloud.lvoxel_blocks(),
        ),
        File::Tree(tree) => (
            sample::of_tree(tree, path, limits, &job.cancel)?,
            &tree.meta().cloud,
            &tree.summary().sums,
            tree.surfel_blocks(),
            tree.lvoxel_blocks(),
        ),
    };
    let name = match file {
        File::Cloud(_) => "chunk",
        File::Tree(_) => "page",
    };
    let (mut pages, bars) = map::bars(surfels, lvoxels, &sample);
    pages["name"] = name.into();
    pages["data"] = data.add(&bars).into();
    data.set("map", pages);
    if let Some(units) = encode::Units::of(&sample) {
        let (bytes, runs) = encode::points(&sample, &units);
        let view = json!({
            "units": units.to_json(),
            "world_from_scene": meta.world_from_scene,
            "mean": mean(sums.flux, sums.area, &sample),
            "groups": encode::groups(&sample, &meta.volumes),
            "points": data.add(&bytes),
            "runs": data.add(&runs),
        });
        data.set("view", view);
    }
    Ok(sample.read)
}

/// Mean radiance of all surfels of a file, or, where there are none, of its lvoxels in the view.
fn mean(flux: [f64; 3], area: f64, sample: &Sample) -> [f64; 3] {
    let mean = flux.map(|f| f / area / std::f64::consts::PI);
    if mean.iter().all(|m| m.is_finite()) && mean.iter().any(|&m| m > 0.0) {
        return mean;
    }
    let points = || sample.groups.iter().flat_map(|g| &g.points);
    let count = points().count().max(1) as f64;
    std::array::from_fn(|k| points().map(|p| f64::from(p.disk.radiance[k])).sum::<f64>() / count)
}

/// The frame with its parts in place of their marks, which are comments with one word. What is put
/// in is not looked at.
fn filled(parts: &[(&str, &str)]) -> String {
    let mut pieces = FRAME.split("<!--");
    let mut page = pieces.next().unwrap_or_default().to_owned();
    for piece in pieces {
        let (mark, rest) = piece.split_once("-->").unwrap_or((piece, ""));
        let part = parts.iter().find(|(name, _)| *name == mark);
        page += part.map_or("", |(_, text)| text);
        page += rest;
    }
    page
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_mark_of_the_frame_is_filled() {
        let names = ["title", "style", "tables", "version", "data", "scripts"];
        let marks = names.map(|name| (name, "<!--title--> & more"));
        let page = filled(&marks);
        assert_eq!(
            page.matches("& more").count(),
            FRAME.matches("<!--").count()
        );
        for name in names {
            assert!(FRAME.contains(&format!("<!--{name}-->")), "{name}");
        }
    }

    #[test]
    fn scripts_and_style_do_not_end_themselves_or_load_anything() {
        for text in [STYLE, SHARED, VIEW, CHARTS, PICTURE] {
            for part in [
                "</script", "</style", "<!--", "http:", "https:", "fetch(", "import ",
            ] {
                assert!(!text.contains(part), "{part}");
            }
        }
    }
}

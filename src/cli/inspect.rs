//! `lvox inspect`

use super::files::{Files, check_writable};
use super::options::Context;
use super::output;
use crate::image::{ImageKind, exr};
use crate::inspect::{describe, export_ply, points, samples, scattered};
use crate::{Error, Result};
use std::fmt::Write;
use std::path::PathBuf;

/// Print what a cloud, a tree, scattered light, an image or kept samples say of themselves, without
/// reading the payload
///
/// Of clouds and trees: origin and settings, counts, bytes per point, columns present and left out
/// with the bytes that this saves, pages, levels, and the worst errors of quantisation. Kept
/// samples are read and checked as a whole.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Read this .lvc, .lvt, .lvs, .exr or .exr.sums file
    file: PathBuf,

    /// Print one JSON object
    #[arg(long)]
    json: bool,

    /// Print the first K surfels and the first K lvoxels instead
    #[arg(long, value_name = "K")]
    points: Option<usize>,

    /// Write the points to this binary PLY file instead
    #[arg(long, value_name = "FILE", conflicts_with = "points")]
    export: Option<PathBuf>,

    /// Export the nodes of a tree so many steps below its root in place of surfels
    #[arg(long, value_name = "N", requires = "export")]
    level: Option<u32>,
}

impl Args {
    /// What it reads and writes.
    pub fn files(&self) -> Files {
        let files = Files::default().reads("file", &self.file);
        match &self.export {
            Some(out) => files.writes("--export", out),
            None => files,
        }
    }

    pub fn run(self, context: &Context) -> Result<()> {
        if ImageKind::of(&self.file)? == Some(ImageKind::Exr) {
            return self.image();
        }
        if let Some(samples) = samples(&self.file)? {
            self.refuse_points("samples have")?;
            return if self.json {
                output::print_json(&samples)
            } else {
                output::print(&samples.to_string())
            };
        }
        if let Some(scattered) = scattered(&self.file)? {
            self.refuse_points("scattered light has")?;
            return if self.json {
                output::print_json(&scattered)
            } else {
                output::print(&scattered.to_string())
            };
        }
        if let Some(out) = &self.export {
            check_writable(out, context.overwrite)?;
            let exported = export_ply(&self.file, out, self.level, context.overwrite)?;
            return if self.json {
                output::print_json(&exported)
            } else {
                output::print(&format!("{} vertices\n", exported.vertices))
            };
        }
        if let Some(k) = self.points {
            let points = points(&self.file, k)?;
            return if self.json {
                output::print_json(&points.to_json())
            } else {
                output::print(&points.to_string())
            };
        }
        let description = describe(&self.file)?;
        if self.json {
            output::print_json(&description)
        } else {
            output::print(&description.to_string())
        }
    }

    /// Refuses options of files that have points.
    fn refuse_points(&self, what_has: &str) -> Result<()> {
        if self.points.is_some() || self.export.is_some() {
            return Err(Error::input(format!(
                "{}: {what_has} no points",
                self.file.display()
            )));
        }
        Ok(())
    }

    fn image(&self) -> Result<()> {
        self.refuse_points("an image has")?;
        let info = exr::info(&self.file)?;
        let channels: Vec<&str> = info.channels.keys().map(String::as_str).collect();
        if self.json {
            return output::print_json(&serde_json::json!({
                "file": self.file.to_string_lossy(),
                "kind": "image",
                "width": info.width,
                "height": info.height,
                "region": [info.region.x0, info.region.y0, info.region.x1, info.region.y1],
                "channels": channels,
                "attributes": info.attributes,
            }));
        }
        let r = info.region;
        let mut text = String::new();
        let mut row = |name: &str, value: &str| {
            let _ = writeln!(text, "{name:<15} {value}");
        };
        row("frame", &format!("{} x {}", info.width, info.height));
        row("region", &format!("{} {} to {} {}", r.x0, r.y0, r.x1, r.y1));
        row("channels", &channels.join(" "));
        info.attributes
            .iter()
            .for_each(|(name, value)| row(name, value));
        output::print(&text)
    }
}

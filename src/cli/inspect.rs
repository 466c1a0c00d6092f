//! `lvox inspect`

use super::files::{Files, check_writable};
use super::options::Context;
use super::output;
use super::scene_input::Reading;
use crate::formats::AtomicFile;
use crate::formats::{FileKind, one_line};
use crate::image::{ImageKind, exr};
use crate::inspect::{
    Shown, describe, export_ply, packed, page, points, refuse_other_formats, samples, scattered,
    scene,
};
use crate::run::OnWarning;
use crate::{Error, Result};
use serde::Serialize;
use std::fmt::{Display, Write};
use std::fs::File;
use std::io::{Read, Write as _};
use std::path::{Path, PathBuf};

/// Print what is in a scene or in one of its files, or what a cloud, a tree, scattered light, a
/// packed scene, an image or kept samples say of themselves
///
/// A scene, a mesh or a volume is read as for rendering: triangles, area, bounds, materials,
/// textures, lights, cameras, grids with their ranges and depths, memory, and all that is left out.
///
/// The payload of other files is not read. Of clouds and trees: origin and settings, counts, bytes
/// per point, columns present and left out with the bytes that this saves, pages, levels, and the
/// worst errors of quantisation. Kept samples are read and checked as a whole.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Read this file: a scene (.toml .xml .gltf .glb), a mesh (.obj .ply .stl), a volume (.vdb
    /// .nrrd .nhdr .nii .nii.gz .mhd .mha .vol), or .lvc .lvt .lvs .lvp .exr .exr.sums
    file: PathBuf,

    /// Print one JSON object
    #[arg(long)]
    json: bool,

    /// Print the first K surfels and the first K lvoxels instead
    #[arg(long, value_name = "K", conflicts_with = "html")]
    points: Option<usize>,

    /// Write the points to this binary PLY file instead
    #[arg(long, value_name = "FILE", conflicts_with_all = ["points", "html"])]
    export: Option<PathBuf>,

    /// Write a page for a browser instead, which needs no network: all of this as tables; of a
    /// cloud or tree a view to turn, a map of its pages and histograms; of an image its layers
    #[arg(long, value_name = "FILE", conflicts_with = "json")]
    html: Option<PathBuf>,

    /// Export the nodes of a tree so many steps below its root in place of surfels
    #[arg(long, value_name = "N", requires = "export")]
    level: Option<u32>,

    #[command(flatten)]
    reading: Reading,
}

/// What may be inspected, for people.
const KINDS: &str =
    "a scene, a mesh or a volume file, or a .lvc, .lvt, .lvs, .lvp, .exr or .exr.sums file";

/// Whether a file is a cloud, a tree, scattered light or a packed scene by its first bytes,
/// whatever its name.
fn is_ours(path: &Path) -> bool {
    let mut start = Vec::new();
    let read = File::open(path).and_then(|file| file.take(12).read_to_end(&mut start));
    read.is_ok() && FileKind::of(&start).is_ok()
}

impl Args {
    /// What it reads and writes.
    pub fn files(&self) -> Files {
        let files = Files::default().reads("file", &self.file);
        let files = match &self.export {
            Some(out) => files.writes("--export", out),
            None => files,
        };
        match &self.html {
            Some(out) => files.writes("--html", out),
            None => files,
        }
    }

    pub fn run(self, context: &Context) -> Result<()> {
        if ImageKind::of(&self.file)? == Some(ImageKind::Exr) {
            return self.image(context);
        }
        if !is_ours(&self.file)
            && let Some(mut scene) = scene(
                &self.file,
                &self.reading.settings(context.frame),
                &context.job,
            )?
        {
            self.refuse_points("a scene file has")?;
            // They are in what is printed; but strict jobs fail on them.
            if context.job.on_warning == OnWarning::Fail {
                scene
                    .warnings
                    .iter()
                    .for_each(|w| context.job.progress.warn(w));
            }
            if !self.json {
                let warnings = scene.warnings.iter_mut();
                warnings.for_each(|w| *w = output::with_options(w));
            }
            return self.tell(&scene, Shown::Tables, context);
        }
        if let Some(samples) = samples(&self.file)? {
            self.refuse_points("samples have")?;
            return self.tell(&samples, Shown::Tables, context);
        }
        refuse_other_formats(&self.file, KINDS)?;
        if let Some(scattered) = scattered(&self.file)? {
            self.refuse_points("scattered light has")?;
            return self.tell(&scattered, Shown::Tables, context);
        }
        if let Some(packed) = packed(&self.file)? {
            self.refuse_points("a packed scene has")?;
            return self.tell(&packed, Shown::Tables, context);
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
        self.tell(&describe(&self.file)?, Shown::Points, context)
    }

    /// Prints a description, or makes a page of it.
    fn tell(
        &self,
        description: &(impl Serialize + Display),
        shown: Shown,
        context: &Context,
    ) -> Result<()> {
        if self.html.is_some() {
            self.write_page(description, shown, context)
        } else if self.json {
            output::print_json(description)
        } else {
            output::print(&description.to_string())
        }
    }

    fn write_page(
        &self,
        description: &impl Serialize,
        shown: Shown,
        context: &Context,
    ) -> Result<()> {
        let Some(out) = &self.html else {
            return Ok(());
        };
        // A file that stays is refused before another is read.
        check_writable(out, context.overwrite)?;
        let html = page(&self.file, description, shown, &context.job)?;
        let mut file = AtomicFile::create(out, context.overwrite)?;
        let written = file.write_all(html.as_bytes());
        written.map_err(|e| Error::io("write", out, &e))?;
        Ok(file.commit()?)
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

    fn image(&self, context: &Context) -> Result<()> {
        self.refuse_points("an image has")?;
        let info = exr::info(&self.file)?;
        let channels: Vec<&str> = info.channels.keys().map(String::as_str).collect();
        if self.json || self.html.is_some() {
            let json = serde_json::json!({
                "file": self.file.to_string_lossy(),
                "kind": "image",
                "width": info.width,
                "height": info.height,
                "region": [info.region.x0, info.region.y0, info.region.x1, info.region.y1],
                "channels": channels,
                "attributes": info.attributes,
            });
            return match self.json {
                true => output::print_json(&json),
                false => self.write_page(&json, Shown::Layers, context),
            };
        }
        let r = info.region;
        let mut text = String::new();
        let mut row = |name: &str, value: &str| {
            let _ = writeln!(text, "{:<15} {}", one_line(name), one_line(value));
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

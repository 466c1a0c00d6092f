//! `lvox compare`

use super::files::{Files, check_writable};
use super::options::{Context, Memory};
use super::{output, parse};
use crate::formats::Overwrite;
use crate::image::ImageKind;
use crate::image::metrics::blocks::{self, Block};
use crate::image::metrics::{self, Scores};
use crate::image::subject::Subject;
use crate::image::{Picture, Region, heat, load, png};
use crate::lab::reference;
use crate::run::size;
use crate::{Error, Result};
use serde::Serialize;
use std::fmt::Write;
use std::path::{Path, PathBuf};

/// Compare an image with a reference by metrics on radiance and on what a viewer sees
///
/// With x the linear radiance of the image, r that of the reference, and means over pixels and
/// channels: RMSE is sqrt(mean((x - r)^2)), relMSE is mean((x - r)^2 / (r^2 + 0.01)), whole and
/// without the worst 0.1 % of pixels, bias is mean(x) / mean(r) - 1, relMAE is mean(|x - r|) /
/// mean(r), and max is the largest |x - r|. Grain is the standard deviation of the relative error
/// of luminance that changes within a few pixels.
///
/// LDR-FLIP (at 67 pixels a degree, 0 to 1), SSIM (1 for the same image) and Yee's perceptual
/// difference (a fraction of the pixels) are of the image clip(exposure * x, 0, 1)^(1/2.2) in eight
/// bits. The noise of an image with the layer `variance`, as lvox reference writes it, is told in
/// units of relMSE: mean(variance / (x^2 + 0.01)). OpenEXR, PNG and NumPy files can be compared (of
/// an array of rows, columns and channels the first three); PNG pixels are taken through the
/// inverse of that tone map.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Measure this image
    image: PathBuf,

    /// Measure against this image
    reference: PathBuf,

    /// Print one JSON object
    #[arg(long)]
    json: bool,

    /// Multiply radiance by this before the tone map [default: that of the scene in the JSON file
    /// beside the reference; else what lvox noted in the reference, else in the image: the exposure
    /// of the scene's film; else 1]
    #[arg(long, value_name = "E", value_parser = parse::positive)]
    exposure: Option<f32>,

    /// Write the FLIP error of every pixel to this PNG file, black (none) to pale yellow (1)
    #[arg(long, value_name = "FILE")]
    heatmap: Option<PathBuf>,

    /// Compare only these pixels, X1 and Y1 excluded [default: the whole frame]
    #[arg(long, num_args = 4, value_names = ["X0", "Y0", "X1", "Y1"])]
    region: Vec<u32>,

    /// Compare this layer of both images instead of the beauty: direct, environment, indirect,
    /// volume, albedo
    #[arg(
        long,
        value_name = "LAYER",
        default_value = "",
        hide_default_value = true
    )]
    layer: String,

    /// List the N blocks of 16 x 16 pixels with the largest relMSE, and their mean signed
    /// difference
    #[arg(long, value_name = "N", default_value_t = 0, hide_default_value = true)]
    worst: usize,

    #[command(flatten)]
    pub memory: Memory,
}

#[derive(Serialize)]
struct Record<'a> {
    image: &'a str,
    reference: &'a str,
    width: usize,
    height: usize,
    #[serde(flatten)]
    scores: Scores,
    #[serde(skip_serializing_if = "Option::is_none")]
    image_noise: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    reference_noise: Option<f64>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    worst: Vec<Block>,
}

impl Args {
    /// What it reads and writes.
    pub fn files(&self) -> Files {
        let files = Files::default()
            .reads("image", &self.image)
            .reads("reference", &self.reference);
        match &self.heatmap {
            Some(path) => files.writes("--heatmap", path),
            None => files,
        }
    }

    pub fn run(self, context: &Context) -> Result<()> {
        if let Some(path) = &self.heatmap {
            check_writable(path, Overwrite::Replace)?;
            ImageKind::Png.check_name("--heatmap", path)?;
        }
        let exposure = match self.exposure {
            Some(exposure) => exposure,
            None => match load::exposure_of(&self.reference)? {
                Some(exposure) => exposure,
                None => load::noted_exposure(&self.image)?.unwrap_or(1.0),
            },
        };
        let region = parse::region(&self.region);
        let image = load::picture(&self.image, &self.layer, exposure, region)?;
        let reference = load::picture(&self.reference, &self.layer, exposure, region)?;
        let job = &context.job;
        let differences = self.differences()?;
        if !differences.is_empty() {
            job.progress.warn(&format!(
                "{} and {} do not show the same, in that order: {}",
                self.image.display(),
                self.reference.display(),
                differences.join("; ")
            ));
        }
        job.heed_warnings()?;
        job.cancel.check()?;
        check_memory(image.pixels.len(), job.memory_limit)?;
        let found = metrics::compare_until(&image, &reference, exposure, &job.cancel)
            .map_err(|e| self.place(e))?;
        for (path, count) in [
            (&self.image, found.scores.non_finite),
            (&self.reference, found.scores.reference_non_finite),
        ] {
            if count > 0 {
                job.progress.warn(&format!(
                    "{}: {count} pixels are infinite or not a number",
                    path.display()
                ));
            }
        }
        job.heed_warnings()?;
        if let Some(path) = &self.heatmap {
            png::write(path, &heat::map(&found.error_map, image.width))?;
        }
        let image_noise = self.noise(&self.image, &image, region)?;
        let reference_noise = self.noise(&self.reference, &reference, region)?;
        let mut worst = blocks::worst(&image, &reference, self.worst);
        if let Some(region) = region {
            // Blocks are told in pixels of the frame.
            for block in &mut worst {
                let (x, y) = (region.x0 as usize, region.y0 as usize);
                (block.x0, block.x1) = (block.x0 + x, block.x1 + x);
                (block.y0, block.y1) = (block.y0 + y, block.y1 + y);
            }
        }
        if self.json {
            output::print_json(&Record {
                image: &self.image.to_string_lossy(),
                reference: &self.reference.to_string_lossy(),
                width: image.width,
                height: image.height,
                scores: found.scores,
                image_noise,
                reference_noise,
                worst,
            })
        } else {
            let noises = [
                ("image_noise", image_noise),
                ("reference_noise", reference_noise),
            ];
            output::print(&(table(&found.scores) + &noise_table(noises) + &block_table(&worst)))
        }
    }

    /// In what the images differ that they say of themselves and that should be the same.
    fn differences(&self) -> Result<Vec<String>> {
        let subject = |path: &Path| {
            let header = load::header(path)?;
            Ok::<_, Error>(header.map_or_else(Subject::default, |h| Subject::of(&h.attributes)))
        };
        Ok(subject(&self.image)?.differences(&subject(&self.reference)?))
    }

    /// relMSE against the truth that the layer `variance` of an image tells; `None` if it has none,
    /// and of other layers than the beauty.
    fn noise(&self, path: &Path, picture: &Picture, region: Option<Region>) -> Result<Option<f64>> {
        let header = load::header(path)?.filter(|_| self.layer.is_empty());
        if !header.is_some_and(|h| h.channels.contains_key("variance.R")) {
            return Ok(None);
        }
        let variance = load::picture(path, "variance", 1.0, region)?;
        let noise = reference::expected_relmse(&picture.pixels, &variance.pixels);
        Ok(Some(noise).filter(|v| v.is_finite()))
    }

    fn place(&self, error: Error) -> Error {
        let (image, reference) = (self.image.display(), self.reference.display());
        error.at(format!("{image} and {reference}"))
    }
}

fn check_memory(pixels: usize, limit: Option<u64>) -> Result<()> {
    let needed = pixels as u64 * metrics::BYTES_PER_PIXEL;
    size::within(format_args!("comparing {pixels} pixels"), needed, limit)
        .map_err(|e| e.hint("raise --memory-limit, or compare a part: --region X0 Y0 X1 Y1"))
}

fn table(scores: &Scores) -> String {
    let rows = [
        ("rmse", scores.rmse, "radiance"),
        ("relmse", scores.relmse, ""),
        (
            "relmse_trimmed",
            scores.relmse_trimmed,
            "without the worst 0.1 % of pixels",
        ),
        (
            "bias",
            scores.bias,
            "mean over that of the reference, less 1",
        ),
        (
            "relmae",
            scores.relmae,
            "mean absolute difference over the mean of the reference",
        ),
        ("max_abs", scores.max_abs, "radiance"),
        (
            "grain",
            scores.grain,
            "relative error that changes within a few pixels, standard deviation",
        ),
        ("flip", scores.flip, "0 is the same"),
        ("ssim", scores.ssim, "1 is the same"),
        ("pdiff", scores.pdiff, "fraction of pixels"),
        ("exposure", f64::from(scores.exposure), ""),
    ];
    let mut text = String::new();
    for (name, value, note) in rows {
        let value = finite(value, significant);
        let line = format!("{name:<15} {value:<12} {note}");
        let _ = writeln!(text, "{}", line.trim_end());
    }
    text
}

/// Rows of what is known.
fn noise_table(noises: [(&str, Option<f64>); 2]) -> String {
    let known = noises
        .into_iter()
        .filter_map(|(name, noise)| Some((name, noise?)));
    known
        .map(|(name, noise)| {
            let noise = significant(noise);
            format!("{name:<15} {noise:<12} relMSE against the truth, from its samples\n")
        })
        .collect()
}

fn block_table(blocks: &[Block]) -> String {
    let mut text = String::new();
    if !blocks.is_empty() {
        text +=
            "\nworst blocks: X0 Y0 X1 Y1, reference and signed difference in radiance, relmse\n";
    }
    for b in blocks {
        let _ = writeln!(
            text,
            "{:>5} {:>5} {:>5} {:>5} {:>12} {:>12} {:>12}",
            b.x0,
            b.y0,
            b.x1,
            b.y1,
            finite(b.reference, |v| format!("{v:.5}")),
            finite(b.error, |v| format!("{v:+.5}")),
            finite(b.relmse, |v| format!("{v:.3e}"))
        );
    }
    text
}

/// A value, or `-` if there is none: a black reference has no bias, a picture of few pixels no
/// SSIM.
fn finite(value: f64, write: impl Fn(f64) -> String) -> String {
    if value.is_finite() {
        write(value)
    } else {
        "-".into()
    }
}

/// Six digits that mean something, whatever the size.
fn significant(value: f64) -> String {
    if value == 0.0 || (1e-2..1e6).contains(&value.abs()) {
        format!("{value:.6}")
    } else {
        format!("{value:.5e}")
    }
}

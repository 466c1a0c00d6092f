//! `lvox mix`

use super::files::{Files, check_writable};
use super::options::{Context, Memory};
use super::parse;
use crate::formats::Overwrite;
use crate::image::exr::{self, Precision};
use crate::image::mix::{GROUP, GroupScale, Part, mix};
use crate::image::{Exposure, ImageKind, write};
use crate::run::{memory, size};
use crate::scene::load::is_group_name;
use crate::{Error, Result};
use std::path::{Path, PathBuf};
use std::str::FromStr;

/// Add up images of groups of lights, or light a frame anew by factors on what each group sends
///
/// The beauty is the sum of the groups, each of which has a layer light.NAME. Nothing is rendered.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Add these .exr images: of one group each, as `--group` makes them, or with layers light.NAME
    #[arg(value_name = "[NAME=]IMAGE", required = true)]
    images: Vec<Named>,

    /// Write the sum to this .exr, .npy or .png file; one that is there is replaced
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,

    /// Multiply the light of a group, by one factor or by one for each of R, G, B, as key=2 or
    /// key=2,1,1. May be given several times
    #[arg(long, value_name = "NAME=FACTOR", value_parser = parse::group_scale)]
    group_scale: Vec<GroupScale>,

    /// Look at a .png with this factor on radiance, or with one that makes one lit pixel in fifty
    /// of the frame brighter than white (auto) [default: the exposure of the scene's film]
    #[arg(long, value_name = "E|auto", value_parser = parse::exposure)]
    exposure: Option<Exposure>,

    /// Store 32-bit instead of 16-bit floats in an .exr image
    #[arg(long)]
    float: bool,

    #[command(flatten)]
    pub memory: Memory,
}

/// An image, and the group of lights that lit it where that is told.
#[derive(Clone, Debug)]
struct Named {
    group: Option<String>,
    path: PathBuf,
}

impl FromStr for Named {
    type Err = std::convert::Infallible;

    fn from_str(text: &str) -> std::result::Result<Self, Self::Err> {
        let named = text
            .split_once('=')
            .filter(|(group, _)| is_group_name(group));
        Ok(match named {
            Some((group, path)) => Self {
                group: Some(group.into()),
                path: path.into(),
            },
            None => Self {
                group: None,
                path: text.into(),
            },
        })
    }
}

impl Args {
    /// What it reads and writes.
    pub fn files(&self) -> Files {
        let images = self.images.iter();
        let files = images.fold(Files::default(), |files, i| files.reads("image", &i.path));
        files.writes("--output", &self.output)
    }

    pub fn run(self, context: &Context) -> Result<()> {
        let kind = ImageKind::named(&self.output)?;
        for (option, given, needed) in [
            ("--exposure", self.exposure.is_some(), ImageKind::Png),
            ("--float", self.float, ImageKind::Exr),
        ] {
            if given && kind != needed {
                return Err(Error::input(format!(
                    "{option} does not go with --output {}",
                    self.output.display()
                ))
                .hint("leave the option out"));
            }
        }
        check_writable(&self.output, Overwrite::Replace)?;
        let precision = match self.float {
            true => Precision::Float,
            false => Precision::Half,
        };
        let images = self.images.iter().map(|i| (i.group.clone(), &*i.path));
        add_up(
            images,
            &self.group_scale,
            (&self.output, precision, self.exposure),
            context,
        )
    }
}

/// Adds images up and writes the sum.
///
/// # Errors
/// As [`mix`] gives, and what reading and writing can.
pub fn add_up<'a>(
    images: impl Iterator<Item = (Option<String>, &'a Path)> + Clone,
    scales: &[GroupScale],
    (output, precision, exposure): (&Path, Precision, Option<Exposure>),
    context: &Context,
) -> Result<()> {
    let job = &context.job;
    check_memory(images.clone().map(|(_, path)| path), job.memory_limit)?;
    job.stage("mix", |counts| {
        let parts = images.map(|(group, path)| {
            job.cancel.check()?;
            let frame = exr::read(path)?;
            let group = group.or_else(|| frame.attributes.get(GROUP).cloned());
            Ok(Part {
                path: path.into(),
                group,
                frame,
            })
        });
        let parts = parts.collect::<Result<Vec<_>>>()?;
        counts.insert("images".into(), parts.len() as f64);
        let mixed = mix(parts, scales)?;
        let has_layers = ImageKind::named(output)? != ImageKind::Png;
        if has_layers && !mixed.left_out.is_empty() {
            job.progress.warn(&format!(
                "{}: layers that are not of single groups, or not in all images, are left out: {}",
                output.display(),
                mixed.left_out.join(", ")
            ));
        }
        if let Some(found) = mixed.frame.not_finite() {
            job.progress.warn(&format!("{}: {found}", output.display()));
        }
        job.heed_warnings()?;
        write(output, &mixed.frame, precision, exposure, job)
    })
}

/// All images are held as floats, and their sum three times over, as in merging.
fn check_memory<'a>(paths: impl Iterator<Item = &'a Path>, limit: Option<u64>) -> Result<()> {
    let mut needed = 0_u64;
    for path in paths {
        let info = exr::info(path)?;
        let samples = info.region.pixels() as u64 * info.channels.len() as u64;
        needed = needed.saturating_add(samples.saturating_mul(4 * size_of::<f32>() as u64));
    }
    let what = "adding up these images";
    size::within(what, needed, limit)?;
    // In the files they may be next to nothing.
    memory::check(what, needed / 4)
}

//! Options of baking, for the verbs that bake.

use crate::bake::BlockSize;
use crate::bake::{Settings, SurfelSampling};
use clap::Args;

/// How to bake, as typed.
#[derive(Debug, Args)]
#[command(next_help_heading = "Baking")]
pub struct BakeOptions {
    /// Spread about this many surfels over the area of all surfaces. A material that would take
    /// more than nine tenths of them by its size leaves one tenth to the smaller ones
    #[arg(long, value_name = "N", default_value_t = 500_000)]
    surfels: u64,

    /// Take surfels where the rays of a camera meet surfaces instead, as the paper does; what it
    /// does not see does not bleed. Without a name, the first camera
    #[arg(long, value_name = "CAMERA", num_args = 0..=1, default_missing_value = "", conflicts_with = "surfels")]
    surfels_from_camera: Option<String>,

    /// Rays per pixel along each axis of such a camera
    #[arg(
        long,
        value_name = "F",
        default_value_t = 2.0,
        requires = "surfels_from_camera"
    )]
    camera_rate: f32,

    /// Width of such a camera's frustum over the image's
    #[arg(
        long,
        value_name = "F",
        default_value_t = 1.1,
        requires = "surfels_from_camera"
    )]
    overscan: f32,

    /// Radius of disks over that of a disk of the surfel's area
    #[arg(long, value_name = "K", default_value_t = Settings::default().overlap)]
    overlap: f32,

    /// End disks where facets meet at more than this angle
    #[arg(long, value_name = "DEG", default_value_t = Settings::default().crease_deg)]
    crease_deg: f32,

    /// Make lvoxels as large as keeps the optical depth along an edge below this, smaller where
    /// surfaces cut them
    #[arg(long, value_name = "TAU", default_value_t = 0.7)]
    block_depth: f32,

    /// Make lvoxels of this many voxels a side instead, as the paper does
    #[arg(long, value_name = "N", value_parser = block_level, conflicts_with = "block_depth")]
    block_voxels: Option<u8>,

    /// Coefficient samples in each such lvoxel
    #[arg(
        long,
        value_name = "N",
        default_value_t = 16,
        requires = "block_voxels"
    )]
    block_samples: u32,

    /// Shadow rays to each area light from each surfel and side, and each lvoxel, and four times as
    /// many to the environment; gathers average over many points
    #[arg(long, value_name = "N", default_value_t = 1)]
    bake_shadow_rays: u32,
}

/// log2 of the voxels a side.
fn block_level(text: &str) -> Result<u8, String> {
    match text {
        "1" => Ok(0),
        "2" => Ok(1),
        "4" => Ok(2),
        "8" => Ok(3),
        _ => Err("it has to be 1, 2, 4 or 8".into()),
    }
}

impl BakeOptions {
    /// The settings they come to.
    pub fn settings(&self, seed: u64) -> Settings {
        Settings {
            surfels: match &self.surfels_from_camera {
                None => SurfelSampling::Area {
                    count: self.surfels,
                },
                Some(name) => SurfelSampling::Camera {
                    name: (!name.is_empty()).then(|| name.clone()),
                    rate: self.camera_rate,
                    overscan: self.overscan,
                },
            },
            overlap: self.overlap,
            crease_deg: self.crease_deg,
            blocks: match self.block_voxels {
                None => BlockSize::OpticalDepth(self.block_depth),
                Some(level) => BlockSize::Fixed {
                    level,
                    samples: self.block_samples,
                },
            },
            shadow_rays: self.bake_shadow_rays,
            seed,
        }
    }
}

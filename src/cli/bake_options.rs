//! Options of baking, for the verbs that bake.

use crate::bake::BlockSize;
use crate::bake::{Settings, SurfelSampling};
use clap::Args;

/// How to bake, as typed.
#[derive(Debug, Args)]
#[command(next_help_heading = "Baking")]
pub struct BakeOptions {
    /// Place about this many surfels over all surfaces. A material so large that it would take more
    /// than nine tenths of them leaves one tenth to the others [default: 500000, or 125000
    /// where the light of neighbours differs little]
    #[arg(long, value_name = "N")]
    surfels: Option<u64>,

    /// Place surfels where the rays of a camera meet surfaces, as the paper does; surfaces that
    /// this camera does not see send no indirect light. Without a name, use the first camera
    #[arg(long, value_name = "CAMERA", num_args = 0..=1, default_missing_value = "", conflicts_with = "surfels")]
    surfels_from_camera: Option<String>,

    /// Cast this many rays per pixel of that camera along each axis
    #[arg(
        long,
        value_name = "F",
        default_value_t = 2.0,
        requires = "surfels_from_camera"
    )]
    camera_rate: f32,

    /// Widen that camera's view by this factor, for surfaces just outside the image
    #[arg(
        long,
        value_name = "F",
        default_value_t = 1.1,
        requires = "surfels_from_camera"
    )]
    overscan: f32,

    /// Draw the disks of surfels larger by this factor, so that they leave no gaps
    #[arg(long, value_name = "K", default_value_t = Settings::default().overlap)]
    overlap: f32,

    /// Cut disks off where neighbouring triangles meet at more than this angle, in degrees
    #[arg(long, value_name = "DEG", default_value_t = Settings::default().crease_deg)]
    crease_deg: f32,

    /// Make lvoxels (blocks of a medium that hold its light) as large as this optical depth along
    /// an edge allows, and smaller where surfaces cut them
    #[arg(long, value_name = "TAU", default_value_t = 0.7)]
    block_depth: f32,

    /// Make all lvoxels this many voxels wide instead, 1, 2, 4 or 8, as the paper does
    #[arg(long, value_name = "N", value_parser = block_level, conflicts_with = "block_depth")]
    block_voxels: Option<u8>,

    /// Sample the medium this often in each such lvoxel
    #[arg(
        long,
        value_name = "N",
        default_value_t = 16,
        requires = "block_voxels"
    )]
    block_samples: u32,

    /// Cast this many shadow rays to each area light from each side of a surfel and from each
    /// lvoxel, and four times as many to the environment. One is enough, as gathers average over
    /// many points. Where rays to suns and to the environment are kept for all lvoxels of a volume,
    /// this does not count
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
            surfels: match (&self.surfels_from_camera, self.surfels) {
                (None, None) => SurfelSampling::ByLight,
                (None, Some(count)) => SurfelSampling::Area { count },
                (Some(name), _) => SurfelSampling::Camera {
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
            ..Settings::default()
        }
    }
}

//! The voxels of media that the pixels of a camera show.

use super::{View, VisibleMedia, pixel_angle};
use crate::Result;
use crate::math::Aabb;
use crate::scene::grid::{Allowed, BRICK_CELLS};
use crate::scene::{Camera, Film, Volume};

/// Pixels along the longest edge of a voxel, at most, where a volume is nearest to the camera.
const MAX_PIXELS: f32 = 1.0;
/// Optical depth of a voxel, at most: what light changes over must not be in one mean.
const MAX_DEPTH: f32 = 0.5;

/// Error of the optical depth of a ray along an edge of a brick on coarser cells, at most, where
/// pixels tell them.
const MAX_ERROR: f32 = 0.01;

/// The media of a scene on the largest voxels that a camera does not tell from their own, and those
/// of many voxels brick by brick on what it does not tell, or whose error is small; `None` if these
/// are their own for all of them. That depends on nothing but camera, film and volumes.
///
/// # Errors
/// As [`Volume::ready`].
pub fn media_on_pixels(
    volumes: &[Volume],
    camera: &Camera,
    film: Film,
) -> Result<Option<Vec<Volume>>> {
    let levels = volumes.iter().map(|v| level(v, camera, film));
    with_bricks(volumes, levels, Some((camera, film)))
}

/// The same for light that all cameras share: media on their own voxels, but for bricks whose error
/// is small.
///
/// # Errors
/// As [`Volume::ready`].
pub fn media_of_all_cameras(volumes: &[Volume]) -> Result<Option<Vec<Volume>>> {
    with_bricks(volumes, volumes.iter().map(|_| 0), None)
}

/// Bytes of memory that the grids of media take for the picture of a camera, or for those of all,
/// about: those in memory with their coarser copies, and of those in a file what is read for it.
pub fn bytes_of_media(volumes: &[Volume], picture: Option<(&Camera, Film)>) -> u64 {
    let is_alone = volumes.len() == 1;
    let of = |volume: &Volume| {
        let grid = &volume.sigma_t;
        let level = picture.map_or(0, |(camera, film)| level(volume, camera, film));
        let in_file = |level: usize| grid.bytes_in_file(level);
        if grid.is_read() || in_file(level).is_none() {
            // A second grid of coarser bricks may be as large.
            return match volume.has_many_voxels() {
                true => 2 * grid.bytes(),
                false => grid.bytes() + grid.bytes() / 2,
            };
        }
        let adapted = || {
            let volume = volume.at_level(level);
            let allowed = allowed(&volume, picture, is_alone)?;
            volume.sigma_t.adapted_bytes(allowed)
        };
        let (finest, bricks) = match volume.albedo_grid {
            // Coarser albedos are weighed by all extinction.
            Some(_) => (0, None),
            None => (level, adapted()),
        };
        let own = bricks.or(in_file(finest)).unwrap_or(0);
        let coarser = (finest + 1..).map_while(in_file);
        own + coarser.sum::<usize>()
    };
    volumes.iter().map(|v| of(v) as u64).sum()
}

fn with_bricks(
    volumes: &[Volume],
    levels: impl Iterator<Item = usize>,
    picture: Option<(&Camera, Film)>,
) -> Result<Option<Vec<Volume>>> {
    let mut are_any = false;
    // Rays through several media are lit cell by cell, whatever light does in that.
    let is_alone = volumes.len() == 1;
    let of = |(volume, level): (&Volume, usize)| {
        let volume = volume.at_level(level);
        let adapted = adapted(&volume, picture, is_alone)?;
        are_any |= level > 0 || adapted.is_some();
        Ok(adapted.unwrap_or(volume))
    };
    let media = volumes.iter().zip(levels).map(of).collect::<Result<_>>()?;
    Ok(are_any.then_some(media))
}

/// A volume of many voxels with bricks on coarser levels, as far as the picture of a camera allows,
/// or those of all, and where they are smooth if that is asked.
fn adapted(
    volume: &Volume,
    picture: Option<(&Camera, Film)>,
    where_smooth: bool,
) -> Result<Option<Volume>> {
    match allowed(volume, picture, where_smooth) {
        Some(allowed) => volume.adapted(allowed),
        None => Ok(None),
    }
}

/// The levels that bricks of a volume may be on, by their place; `None` if all stay as they are.
fn allowed<'a>(
    volume: &'a Volume,
    picture: Option<(&Camera, Film)>,
    where_smooth: bool,
) -> Option<impl Fn([usize; 3]) -> Allowed + Sync + use<'a>> {
    if !volume.has_many_voxels() || (picture.is_none() && !where_smooth) {
        return None;
    }
    let voxel = volume.longest_voxel_edge();
    let half_diagonal = 0.5 * 3.0_f32.sqrt() * BRICK_CELLS as f32 * voxel;
    let error = match where_smooth {
        true => MAX_ERROR / (BRICK_CELLS as f32 * voxel),
        // Less than any.
        false => -1.0,
    };
    let pixels = picture.map(|(camera, film)| (camera.origin(), pixel_angle(camera, film)));
    Some(move |brick| {
        let unseen = pixels.map_or(0, |(origin, pixel)| {
            let distance = volume.middle_of_brick(brick).distance(origin) - half_diagonal;
            let most = (MAX_PIXELS * pixel * distance / voxel) as usize;
            most.max(1).ilog2() as usize
        });
        Allowed {
            unseen,
            depth: MAX_DEPTH / voxel,
            error,
        }
    })
}

/// Length that a pixel covers where a volume is nearest to the camera.
fn pixel_at(volume: &Volume, camera: &Camera, film: Film) -> f32 {
    let Aabb { min, max } = volume.bounds();
    let origin = camera.origin();
    pixel_angle(camera, film) * origin.clamp(min, max).distance(origin)
}

impl View<'_> {
    /// Voxels' edges in pixels up to which pictures show no single one, which shadows are then not
    /// sharper than.
    const SMALL_VOXEL: f32 = 2.0;

    /// Whether the voxels of a volume are so many, and so small in the picture, that shadows need
    /// not be those of single ones.
    #[must_use]
    pub fn shows_no_voxels(&self, visible: VisibleMedia, volume: &Volume) -> bool {
        Self::is_of_small_voxels(
            volume,
            match visible {
                VisibleMedia::ThroughRegions(_) => Some((self.camera, self.film)),
                VisibleMedia::All => None,
            },
        )
    }

    /// The same for the picture of a camera, or for those of all.
    #[must_use]
    pub fn is_of_small_voxels(volume: &Volume, picture: Option<(&Camera, Film)>) -> bool {
        let are_small = picture.is_none_or(|(camera, film)| {
            let pixel = pixel_at(volume, camera, film);
            volume.longest_voxel_edge() <= Self::SMALL_VOXEL * pixel
        });
        are_small && volume.has_many_voxels()
    }

    /// Whether the picture shows single voxels of such an edge that are so far from the camera,
    /// both in scene units.
    #[inline]
    #[must_use]
    pub fn shows_voxels(&self, edge: f32, distance: f32) -> bool {
        edge > Self::SMALL_VOXEL * self.pixel_angle * distance
    }
}

fn level(volume: &Volume, camera: &Camera, film: Film) -> usize {
    let pixel = pixel_at(volume, camera, film);
    let deepest = MAX_DEPTH / volume.sigma_t.max();
    let most = (MAX_PIXELS * pixel).min(deepest) / volume.longest_voxel_edge();
    let longest = volume.sigma_t.dims().into_iter().max().unwrap_or(1);
    let fits = |&level: &usize| (1 << level) as f32 <= most && longest >> level > 0;
    (1..usize::BITS as usize)
        .take_while(fits)
        .last()
        .unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Grid;
    use glam::{Affine3A, DAffine3, DVec3, Vec3};

    fn voxels(dims: usize, sigma_t: f32, distance: f32) -> Option<[usize; 3]> {
        let place = DAffine3::from_scale(DVec3::splat(1.0 / dims as f64));
        let grid = Grid::from_fn([dims; 3], |_| sigma_t);
        let volume = Volume::new("cube".into(), grid, [0.5; 3], place);
        let camera = Camera {
            name: String::new(),
            scene_from_camera: Affine3A::from_translation(Vec3::new(0.5, 0.5, 1.0 + distance)),
            fov_x_rad: std::f32::consts::FRAC_PI_2,
            keys: Vec::new(),
            lens: None,
            shutter: None,
            path: Vec::new(),
        };
        let film = Film {
            width: 100,
            height: 100,
            exposure: 1.0,
        };
        let media = media_on_pixels(&[volume], &camera, film).unwrap()?;
        let [grid] = [&media[0].sigma_t];
        // Wherever it is seen from, it is as large, and as deep.
        assert_eq!(media[0].bounds().max, Vec3::ONE);
        assert_eq!(grid.max(), sigma_t);
        Some(grid.dims())
    }

    #[test]
    fn voxels_are_those_that_pixels_tell_apart() {
        // A pixel is a fiftieth of the distance.
        assert_eq!(voxels(64, 1.0, 0.0), None);
        assert_eq!(voxels(64, 1.0, 1.5), None);
        assert_eq!(voxels(64, 1.0, 1.6), Some([32; 3]));
        assert_eq!(voxels(64, 1.0, 3.2), Some([16; 3]));
        assert_eq!(voxels(64, 0.5, 1e9), Some([1; 3]));
        // As deep as that, they tell more than pixels do.
        assert_eq!(voxels(64, 9.0, 1e9), Some([32; 3]));
        assert_eq!(voxels(64, 100.0, 1e9), None);
    }
}

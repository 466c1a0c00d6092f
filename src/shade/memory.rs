//! What the buffers of a region take, told before they are made.

use super::lattice::Lattice;
use super::pixels::Part;
use super::settings::Settings;
use crate::image::Region;
use crate::run::size;
use crate::scene::Scene;
use crate::{Error, Result};

/// Bytes of a pixel: the planes asked for, twice while blocks are put together.
fn per_pixel(parts: &[Part]) -> u64 {
    let planes: usize = parts.iter().map(|p| p.planes()).sum();
    2 * (planes * size_of::<f32>()) as u64
}

/// Refuses regions whose pixels and gathers take more than a limit by themselves.
///
/// # Errors
/// Says what they take, and how to shade in parts.
pub fn check(
    scene: &Scene,
    settings: &Settings,
    regions: &[Region],
    parts: &[Part],
    limit: Option<u64>,
) -> Result<()> {
    let film = [scene.film.width, scene.film.height];
    let pixels: u64 = regions.iter().map(|r| r.pixels() as u64).sum();
    let lattices = regions
        .iter()
        .map(|&r| Lattice::bytes(r, settings.lattice, film));
    let needed = pixels
        .saturating_mul(per_pixel(parts))
        .saturating_add(lattices.sum());
    match limit {
        Some(limit) if needed > limit => Err(Error::input(format!(
            "shading {pixels} pixels takes {}, the memory limit is {}",
            size::format(needed),
            size::format(limit)
        ))
        .hint("raise --memory-limit, or shade a part: --region X0 Y0 X1 Y1 or --tile I/N")),
        _ => Ok(()),
    }
}

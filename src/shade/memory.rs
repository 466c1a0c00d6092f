//! What the buffers of a region take, told before they are made.

use super::pixels::Quantity;
use super::settings::Settings;
use super::surfaces::Lattice;
use crate::Result;
use crate::image::Region;
use crate::run::{memory, size};
use crate::scene::Scene;

/// Bytes of a pixel: the planes asked for, twice while blocks are put together.
fn per_pixel(quantities: &[Quantity]) -> u64 {
    let planes: usize = quantities.iter().map(|p| p.planes()).sum();
    2 * (planes * size_of::<f32>()) as u64
}

/// Refuses regions whose pixels and gathers take more than a limit by themselves, or surely more
/// than the machine has.
///
/// # Errors
/// Says what they take, and how to shade in parts.
pub fn check(
    scene: &Scene,
    settings: &Settings,
    regions: &[Region],
    quantities: &[Quantity],
    limit: Option<u64>,
) -> Result<()> {
    let film = [scene.film.width, scene.film.height];
    let pixels: u64 = regions.iter().map(|r| r.pixels() as u64).sum();
    let lattices = regions
        .iter()
        .map(|&r| Lattice::bytes(r, settings.lattice, film));
    let needed = pixels
        .saturating_mul(per_pixel(quantities))
        .saturating_add(lattices.sum());
    size::within(format_args!("shading {pixels} pixels"), needed, limit).map_err(|e| {
        e.hint("raise `memory_limit`, or shade a part: `region` X0 Y0 X1 Y1 or `tile` I/N")
    })?;
    // The pixels of all regions are put together when the lists of gathers are gone.
    let [gathered, smoothed] = regions.iter().fold([0_u64; 2], |sum, &r| {
        let more = Lattice::least_bytes(r, settings.lattice, film);
        [0, 1].map(|i| sum[i].saturating_add(more[i]))
    });
    let planes = pixels.saturating_mul(per_pixel(quantities));
    let least = smoothed.saturating_add(gathered.max(planes));
    memory::check(format_args!("shading {pixels} pixels"), least).map_err(|e| {
        e.hint(
            "shade a part: `region` X0 Y0 X1 Y1 or `tile` I/N; or a smaller film: \
             `resolution` WxH. `memory_limit` holds down what the tree takes beside pixels",
        )
    })
}

//! What shading takes, told before the work.

use super::pixels::{Quantity, most_spread_into};
use super::settings::{Kernel, Settings};
use super::surfaces::Lattice;
use crate::Result;
use crate::gather::PatchRadiance;
use crate::image::Region;
use crate::inscatter;
use crate::run::{Budget, Job, memory};
use crate::scene::{Scene, Volume};
use crate::trace::Tracer;
use crate::tree::TreeNeeds;
use crate::view::{self, View};

/// Bytes of a pixel: the planes asked for, twice while blocks are put together.
fn per_pixel(quantities: &[Quantity]) -> u64 {
    let planes: usize = quantities.iter().map(|p| p.planes()).sum();
    2 * (planes * size_of::<f32>()) as u64
}

/// What shading regions holds, whatever the caches of the tree do.
fn budget(
    scene: &Scene,
    settings: &Settings,
    regions: &[Region],
    quantities: &[Quantity],
    has_scattered_light: bool,
    job: &Job,
) -> Budget {
    let film = [scene.film.width, scene.film.height];
    let pixels: usize = regions.iter().map(|r| r.pixels()).sum();
    // Without a camera there is no frame.
    let camera = scene.camera(settings.camera.as_deref()).ok();
    let has_lens = camera.is_some_and(|camera| !camera.is_pinhole());
    let lattices = regions.iter().map(|&r| {
        if !has_lens {
            return Lattice::bytes(r, settings.lattice, film);
        }
        let (around, bytes) = most_spread_into(r, film);
        let corners = (around.pixels() as u64).saturating_mul(bytes);
        Lattice::bytes(around, settings.lattice, film)
            .saturating_add(corners)
            // Numbers of pixels as a pinhole and as the lens sees them.
            .saturating_add((r.pixels() as u64).saturating_mul(per_pixel(quantities)))
    });
    let patches = match settings.kernel {
        Kernel::Traced => {
            PatchRadiance::bytes_for(scene.mesh.triangles.len(), settings.lattice_rays(pixels))
        }
        _ => 0,
    };
    let picture = camera.map(|camera| (camera, scene.film));
    let shows_no_voxels = |v: &Volume| View::is_of_small_voxels(v, picture);
    let seen_by = picture.filter(|_| !has_scattered_light);
    let media = view::bytes_of_media(&scene.volumes, seen_by)
        + scene.bytes_of_other_grids()
        + inscatter::bytes_for(scene, shows_no_voxels);
    (scene.budget(media, job))
        .with("what rays need of it", Tracer::bytes_for(scene))
        .with("light of surfaces", patches)
        .with(
            "pixels and gathers",
            (pixels as u64)
                .saturating_mul(per_pixel(quantities))
                .saturating_add(lattices.sum()),
        )
}

/// Refuses regions that take more than the job's limit whatever the caches of the tree do, or
/// pixels that surely take more than the machine has. Returns what they hold beside their tree.
///
/// # Errors
/// Says what they take, and how to shade in parts.
pub fn check(
    scene: &Scene,
    settings: &Settings,
    regions: &[Region],
    quantities: &[Quantity],
    tree: TreeNeeds,
    job: &Job,
) -> Result<Budget> {
    let film = [scene.film.width, scene.film.height];
    let pixels: u64 = regions.iter().map(|r| r.pixels() as u64).sum();
    let is_lit = tree.has_scattered_light;
    let budget = budget(scene, settings, regions, quantities, is_lit, job);
    let advice = "raise `memory_limit`, or shade a part: `region` X0 Y0 X1 Y1 or `tile` I/N";
    let with_tree = budget.clone().with("the tree", tree.least_bytes);
    with_tree.within(
        format_args!("shading {pixels} pixels"),
        job.memory_limit,
        advice,
    )?;
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
    })?;
    Ok(budget)
}

//! tree + scene → image: primary visibility and direct light from the scene, indirect light
//! gathered from the tree.
//!
//! A scene, an open tree, [`Settings`] and a region of the film enter; a [`Frame`] with its layers
//! leaves.
//!
//! | folder or file | what it does |
//! | --- | --- |
//! | `frame` | what all pixels share: lights, gathers, light in media |
//! | `surfaces/` | indirect light on surfaces: gathers at few pixels, spread to all |
//! | `pixels/` | camera rays, direct light, media before them, means over pixels, layers |
//! | `cost` | what the parts of a frame will cost, by a pilot |
//! | `origin` | what an image says of its origin, and whether one has the same |
//! | `settings`, `memory` | how to shade; limits on memory, told before the work |
//!
//! Light inside media comes from `inscatter`.
//!
//! Every pixel depends on the scene, the tree, the settings and its own coordinates alone, so any
//! tiling, on any number of machines, gives the same bits. Points and directions are those of scene
//! space unless they are said to be the camera's or the film's, distances are scene units, light is
//! linear Rec.709.

mod cost;
mod frame;
mod memory;
mod origin;
mod pixels;
mod settings;
mod surfaces;

use crate::gather::PatchStats;
use crate::image::{CostMap, Frame, Onlooker, Region};
use crate::math::Rgb;
use crate::run::{Job, Walked};
use crate::scene::Scene;
use crate::tree::{OpenTree, TreeNeeds};
use crate::{Error, Result, inscatter};
use cost::CostPilot;
use frame::{Request, shade_regions, with_frame};
use pixels::{Planes, Quantity};

pub use origin::Image;
pub use pixels::Aov;
pub use settings::{Kernel, Method, Quality, Settings};

/// Refuses a frame that [`run`] would refuse for its memory, before there is a tree, or with one
/// that has such needs ([`OpenTree::needs`]). Returns the bytes that it holds beside the tree, for
/// [`OpenTree::beside`].
///
/// # Errors
/// More pixels than the memory limit allows, or than the machine has memory for.
pub fn check_memory(
    scene: &Scene,
    settings: &Settings,
    region: Region,
    aovs: &[Aov],
    tree: TreeNeeds,
    job: &Job,
) -> Result<u64> {
    let quantities = pixels::quantities(aovs);
    let budget = memory::check(scene, settings, &[region], &quantities, tree, job)?;
    Ok(budget.bytes())
}

/// Shades a region of the frame.
///
/// # Errors
/// A setting out of range, an unknown camera, a tree in another frame than the scene
/// ([`Scene::in_frame`]), more pixels or larger media than the memory limit allows or the machine
/// has memory for, a page that cannot be read, or a stop on request.
pub fn run(
    scene: &Scene,
    tree: &OpenTree,
    settings: &Settings,
    region: Region,
    aovs: &[Aov],
    job: &Job,
) -> Result<Frame> {
    run_before(scene, tree, settings, region, aovs, None, job)
}

/// The same before one who looks on.
///
/// # Errors
/// As [`run`].
pub fn run_before(
    scene: &Scene,
    tree: &OpenTree,
    settings: &Settings,
    region: Region,
    aovs: &[Aov],
    onlooker: Option<&dyn Onlooker>,
    job: &Job,
) -> Result<Frame> {
    check(scene, tree, settings)?;
    region.check(scene.film.width, scene.film.height)?;
    let fit = tree.fitter(job);
    job.watched_stage("shade", fit, |counts| {
        let quantities = pixels::quantities(aovs);
        let before = Walked::so_far();
        let request = Request {
            scene,
            tree,
            settings,
            regions: &[region],
            quantities: &quantities,
            onlooker,
            job,
        };
        let (mut shaded, asked) = shade_regions(&request)?;
        let planes = shaded.swap_remove(0);
        let stats = tree.stats();
        counts.insert("pixels".into(), region.pixels() as f64);
        counts.insert("pages".into(), stats.pages as f64);
        counts.insert("pages_decoded".into(), stats.decoded as f64);
        counts.insert("leaves_decoded".into(), stats.decoded_leaves as f64);
        counts.insert("page_bytes_read".into(), stats.bytes_read as f64);
        counts.insert("page_bytes_decoded".into(), stats.bytes_decoded as f64);
        let walked = Walked::so_far() - before;
        counts.insert("rays".into(), walked.rays as f64);
        counts.insert("cells_walked".into(), walked.cells as f64);
        counts.insert("lvoxels_walked".into(), walked.lvoxels as f64);
        counts.insert("cache_hits".into(), stats.hits as f64);
        counts.insert("cache_misses".into(), stats.misses as f64);
        counts.insert("patches".into(), asked.patches.patches as f64);
        counts.insert(
            "patches_without_surfels".into(),
            asked.patches.unknown as f64,
        );
        counts.insert("bright_patches".into(), asked.patches.bright as f64);
        if !scene.volumes.is_empty() {
            asked.media.list(counts);
        }
        warn_of_unknown(asked.patches, job);
        let mut frame = pixels::to_frame(scene, region, aovs, planes);
        if let Some(found) = frame.not_finite() {
            job.progress.warn(&format!(
                "{found}; light there is more than 32-bit floats hold, or a file is not what it \
                 should be, which `lvox verify` tells"
            ));
        }
        job.heed_warnings()?;
        frame
            .attributes
            .extend(origin::attributes(scene, tree, settings)?);
        frame.camera = Some(origin::camera(scene, settings)?);
        Ok(frame)
    })
}

/// What the parts of a frame will cost, by a pilot: the same for any number of threads and any
/// memory limit.
///
/// # Errors
/// As [`run`].
pub fn costs(scene: &Scene, tree: &OpenTree, settings: &Settings, job: &Job) -> Result<CostMap> {
    check(scene, tree, settings)?;
    let fit = tree.fitter(job);
    job.watched_stage("pilot", fit, |counts| {
        let before = Walked::so_far();
        let request = Request {
            scene,
            tree,
            settings,
            regions: &[Region::full(scene.film.width, scene.film.height)],
            quantities: &[],
            onlooker: None,
            job,
        };
        let (costs, asked) = with_frame(&request, &[Region::full(1, 1)], &CostPilot)?;
        if !scene.volumes.is_empty() {
            asked.media.list(counts);
        }
        let walked = Walked::so_far() - before;
        counts.insert("rays".into(), walked.rays as f64);
        counts.insert("cells_walked".into(), walked.cells as f64);
        Ok(costs)
    })
}

/// A pixel as [`run`] shades it.
#[doc(hidden)]
#[derive(Clone, Copy, Debug)]
pub struct ShadedPixel {
    /// Radiance towards the camera, all layers together.
    pub radiance: Rgb,
    /// Whether the border of an emissive triangle runs through it, which few rays would find.
    pub has_emitter_border: bool,
}

/// Shades the pixels of some regions of the frame, each row by row, to what [`run`] gives there,
/// bit for bit. For the laboratory.
///
/// # Errors
/// As [`run`].
#[doc(hidden)]
pub fn pixels(
    scene: &Scene,
    tree: &OpenTree,
    settings: &Settings,
    regions: &[Region],
    job: &Job,
) -> Result<Vec<Vec<ShadedPixel>>> {
    check(scene, tree, settings)?;
    for region in regions {
        region.check(scene.film.width, scene.film.height)?;
    }
    let quantities = [Quantity::Radiance, Quantity::EmitterBorder];
    let request = Request {
        scene,
        tree,
        settings,
        regions,
        quantities: &quantities,
        onlooker: None,
        job,
    };
    let (shaded, _) = shade_regions(&request)?;
    let told = |planes: &Planes, i: usize| ShadedPixel {
        radiance: Rgb(std::array::from_fn(|c| planes[c][i])),
        has_emitter_border: planes[3][i] > 0.0,
    };
    Ok(regions
        .iter()
        .zip(&shaded)
        .map(|(r, planes)| (0..r.pixels()).map(|i| told(planes, i)).collect())
        .collect())
}

/// Refuses settings that make no sense, and scattered light that does not go with them or with the
/// scene.
fn check(scene: &Scene, tree: &OpenTree, settings: &Settings) -> Result<()> {
    settings.check()?;
    let Some(scatter) = &tree.scatter else {
        return Ok(());
    };
    if settings.method != Method::Extended || settings.max_dist.is_some_and(f32::is_finite) {
        return Err(Error::input(
            "scattered light is that of all surfaces and media, however far: it does not \
             go with `method` traditional and `max_dist`",
        )
        .hint("leave out `scatter`, or those"));
    }
    inscatter::check_volumes(&scatter.meta().volumes, scene)
        .map_err(|e| e.hint("make the scattered light again: lvox scatter"))
}

/// Says so where an appreciable part of what gathers met is black for want of surfels.
fn warn_of_unknown(asked: PatchStats, job: &Job) {
    if asked.misses_surfels {
        job.progress.warn(&format!(
            "the tree has no surfels on {:.0} % of what gather rays met, which is taken for black; \
             bake with more `surfels`, or from the scene as it is",
            100.0 * asked.unknown as f64 / asked.patches as f64
        ));
    }
}

//! tree + scene → image: primary visibility and direct light from the scene, indirect light
//! gathered from the tree. What of that no camera changes can be made beforehand ([`scatter`]).
//!
//! Every pixel depends on the scene, the tree, the settings and its own coordinates alone, so any
//! tiling, on any number of machines, gives the same bits. Points and directions are those of scene
//! space unless they are said to be the camera's or the film's, distances are scene units, light is
//! linear Rec.709.

mod adapters;
mod air;
mod aov;
mod bright;
mod lattice;
mod layers;
mod media;
mod memory;
mod pixels;
pub mod scatter;
mod settings;
mod shot;
mod surface_gatherer;
mod view;

use crate::Result;
use crate::gather::PatchStats;
use crate::image::{Frame, Region};
use crate::math::Rgb;
use crate::run::{Job, hex};
use crate::scene::Scene;
use crate::tree::OpenTree;
use aov::Part;
use pixels::Planes;
use shot::{Request, shade_regions};

pub use aov::Aov;
pub use settings::{Kernel, Method, Quality, Settings};

/// Refuses a frame that [`run`] would refuse for its memory, before there is a tree.
///
/// # Errors
/// More pixels than the memory limit allows, or than the machine has memory for.
pub fn check_memory(
    scene: &Scene,
    settings: &Settings,
    region: Region,
    aovs: &[Aov],
    job: &Job,
) -> Result<()> {
    let parts = layers::parts(aovs);
    memory::check(scene, settings, &[region], &parts, job.memory_limit)
}

/// Shades a region of the frame.
///
/// # Errors
/// A setting out of range, an unknown camera, a tree in another frame than the scene
/// ([`Scene::in_frame`]), more pixels or larger media than the memory limit allows or the machine
/// has memory for, a page that cannot be read, or a stop on request.
pub fn run(
    scene: &Scene,
    store: &OpenTree,
    settings: &Settings,
    region: Region,
    aovs: &[Aov],
    job: &Job,
) -> Result<Frame> {
    check(scene, store, settings)?;
    region.check(scene.film.width, scene.film.height)?;
    // The first camera is the same whether it was named or not.
    let named = Settings {
        camera: Some(scene.camera(settings.camera.as_deref())?.name.clone()),
        ..settings.clone()
    };
    job.report.stage("shade", |counts| {
        let parts = layers::parts(aovs);
        let request = Request {
            settings,
            regions: &[region],
            parts: &parts,
            job,
        };
        let (mut shaded, asked) = shade_regions(scene, store, &request)?;
        let planes = shaded.swap_remove(0);
        let stats = store.stats();
        counts.insert("pixels".into(), region.pixels() as f64);
        counts.insert("pages".into(), stats.pages as f64);
        counts.insert("pages_decoded".into(), stats.decoded as f64);
        counts.insert("leaves_decoded".into(), stats.decoded_leaves as f64);
        counts.insert("page_bytes_read".into(), stats.bytes_read as f64);
        counts.insert("cache_hits".into(), stats.hits as f64);
        counts.insert("cache_misses".into(), stats.misses as f64);
        counts.insert("patches".into(), asked.patches as f64);
        counts.insert("patches_without_surfels".into(), asked.unknown as f64);
        counts.insert("bright_patches".into(), asked.bright as f64);
        warn_of_unknown(asked, job);
        job.heed_warnings()?;
        let mut frame = layers::to_frame(scene, region, aovs, planes);
        let mut note =
            |name: &str, value: String| frame.attributes.insert(format!("lvox/{name}"), value);
        note("version", env!("CARGO_PKG_VERSION").into());
        note("exposure", scene.film.exposure.to_string());
        note("scene", hex(&scene.hash));
        note("tree", hex(&store.tree().content_hash()));
        if let Some(scatter) = &store.scatter {
            note("scatter", hex(&scatter.content_hash()));
        }
        note(
            "settings",
            serde_json::to_string(&named).unwrap_or_default(),
        );
        Ok(frame)
    })
}

/// A pixel as [`run`] shades it.
#[derive(Clone, Copy, Debug)]
pub struct Shaded {
    /// Radiance towards the camera, all layers together.
    pub radiance: Rgb,
    /// Whether the border of an emissive triangle runs through it, which few rays would find.
    pub has_emitter_border: bool,
}

/// The pixels of some regions of the frame, each row by row: what [`run`] gives there, bit for bit.
///
/// # Errors
/// As [`run`].
pub fn pixels(
    scene: &Scene,
    store: &OpenTree,
    settings: &Settings,
    regions: &[Region],
    job: &Job,
) -> Result<Vec<Vec<Shaded>>> {
    check(scene, store, settings)?;
    for region in regions {
        region.check(scene.film.width, scene.film.height)?;
    }
    let parts = [Part::Radiance, Part::EmitterBorder];
    let request = Request {
        settings,
        regions,
        parts: &parts,
        job,
    };
    let (shaded, _) = shade_regions(scene, store, &request)?;
    let told = |planes: &Planes, i: usize| Shaded {
        radiance: Rgb(std::array::from_fn(|c| planes[c][i])),
        has_emitter_border: planes[3][i] > 0.0,
    };
    Ok(regions
        .iter()
        .zip(&shaded)
        .map(|(r, planes)| (0..r.pixels()).map(|i| told(planes, i)).collect())
        .collect())
}

fn check(scene: &Scene, store: &OpenTree, settings: &Settings) -> Result<()> {
    settings.check()?;
    (store.scatter.as_ref()).map_or(Ok(()), |scatter| scatter::check(scatter, scene, settings))
}

/// Says so where an appreciable part of what gathers met is black for want of surfels.
fn warn_of_unknown(asked: PatchStats, job: &Job) {
    const SHARE: f64 = 0.05;
    let share = asked.unknown as f64 / asked.patches.max(1) as f64;
    if share > SHARE {
        job.progress.warn(&format!(
            "the tree has no surfels on {:.0} % of what gather rays met, which is taken for black; bake with more \
             --surfels, or from the scene as it is",
            100.0 * share
        ));
    }
}

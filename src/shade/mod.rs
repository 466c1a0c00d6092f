//! tree + scene → image: primary visibility and direct light from the scene, indirect light gathered from the tree.
//!
//! Every pixel depends on the scene, the tree, the settings and its own coordinates alone, so any tiling, on any number
//! of machines, gives the same bits.

mod corners;
mod far_field;
mod inscatter;
mod lamps;
mod lattice;
mod memory;
mod pixel;
mod settings;
mod sparse;
mod stiff;
mod sweep;
mod vertices;
mod view;

use crate::gather::medium::Source;
use crate::gather::outgoing::Asked;
use crate::gather::{
    self, Gatherer, Geometry, Media, MediaStore, Medium, NoMedia, Outgoing, Pages, SurfelStore,
    TreeStore,
};
use crate::image::{Frame, Layer, Region};
use crate::light::{Lights, OpticalDepth};
use crate::math::Rgb;
use crate::run::{Job, Task};
use crate::scene::Scene;
use crate::trace::{Tracer, unit_normal};
use crate::{Error, Result};
use corners::Corners;
use glam::Vec3;
use inscatter::InScatter;
use lamps::Lamps;
use lattice::Lattice;
use pixel::{Pixel, PixelShader, SampleCounts};
use rayon::prelude::*;
pub use settings::{Kernel, Method, Quality, Settings};
use view::View;

/// Pixels along an edge of the blocks that threads take.
const BLOCK: u32 = 64;

/// Extra layers of the image beside the beauty.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Aov {
    /// Directly lit and emitted light, as it comes through media.
    Direct,
    /// Light from other surfaces and media.
    Indirect,
    /// Light scattered by media towards the camera.
    Volume,
    /// Mean distance along the camera rays, scene units.
    Depth,
    /// Mean shading normal, scene space.
    Normal,
}

impl Aov {
    /// All of them, by the name of their layer.
    pub const ALL: [(&'static str, Self); 5] = [
        ("direct", Self::Direct),
        ("indirect", Self::Indirect),
        ("volume", Self::Volume),
        ("depth", Self::Depth),
        ("normal", Self::Normal),
    ];
}

/// Shades a region of the frame.
///
/// # Errors
/// A setting out of range, an unknown camera, a tree in another frame than the scene ([`Scene::in_frame`]), more
/// pixels than the memory limit allows, a page that cannot be read, or a stop on request.
pub fn run(
    scene: &Scene,
    store: &TreeStore,
    settings: &Settings,
    region: Region,
    aovs: &[Aov],
    job: &Job,
) -> Result<Frame> {
    settings.check()?;
    region.check(scene.film.width, scene.film.height)?;
    job.report.stage("shade", |counts| {
        let (pixels, asked) = shade_regions(scene, store, settings, &[region], job)?;
        let pixels = pixels.concat();
        let stats = store.stats();
        counts.insert("pixels".into(), region.pixels() as f64);
        counts.insert("pages".into(), stats.pages as f64);
        counts.insert("pages_decoded".into(), stats.decoded as f64);
        counts.insert("page_bytes_read".into(), stats.bytes_read as f64);
        counts.insert("cache_hits".into(), stats.hits as f64);
        counts.insert("cache_misses".into(), stats.misses as f64);
        counts.insert("patches".into(), asked.patches as f64);
        counts.insert("patches_without_surfels".into(), asked.unknown as f64);
        warn_of_unknown(asked, job);
        let mut frame = to_frame(scene, region, &pixels, aovs);
        let hex = |bytes: &[u8]| bytes.iter().map(|b| format!("{b:02x}")).collect::<String>();
        let mut note =
            |name: &str, value: String| frame.attributes.insert(format!("lvox/{name}"), value);
        note("version", env!("CARGO_PKG_VERSION").into());
        note("scene", hex(&scene.hash));
        note("tree", hex(&store.tree().content_hash()));
        note(
            "settings",
            serde_json::to_string(settings).unwrap_or_default(),
        );
        Ok(frame)
    })
}

/// A pixel as [`run`] shades it.
#[derive(Clone, Copy, Debug)]
pub struct Shaded {
    /// Its radiance.
    pub radiance: Rgb,
    /// Whether the border of a lamp runs through it, which few rays would find.
    pub has_lamp_border: bool,
}

/// The pixels of some regions of the frame, each row by row: what [`run`] gives there, bit for bit.
///
/// # Errors
/// As [`run`].
pub fn pixels(
    scene: &Scene,
    store: &TreeStore,
    settings: &Settings,
    regions: &[Region],
    job: &Job,
) -> Result<Vec<Vec<Shaded>>> {
    settings.check()?;
    for region in regions {
        region.check(scene.film.width, scene.film.height)?;
    }
    let (shaded, _) = shade_regions(scene, store, settings, regions, job)?;
    let told = |p: &Pixel| Shaded {
        radiance: p.radiance(),
        has_lamp_border: p.has_lamp_border,
    };
    Ok(shaded
        .iter()
        .map(|r| r.iter().map(told).collect())
        .collect())
}

/// Says so where an appreciable part of what gathers met is black for want of surfels.
fn warn_of_unknown(asked: Asked, job: &Job) {
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

/// Regions by rows of pixels, and what that asked of the tree.
type Regions = (Vec<Vec<Pixel>>, Asked);

fn shade_regions(
    scene: &Scene,
    store: &TreeStore,
    settings: &Settings,
    regions: &[Region],
    job: &Job,
) -> Result<Regions> {
    check_frame(scene, store)?;
    memory::check(scene, settings, regions, job.memory_limit)?;
    match &store.surfels {
        SurfelStore::Kept(p) => shade_with(scene, store, p, settings, regions, job),
        SurfelStore::Cached(p) => shade_with(scene, store, p, settings, regions, job),
    }
}

/// Places in the tree are in the frame of the scene that it was baked of.
fn check_frame(scene: &Scene, store: &TreeStore) -> Result<()> {
    let of_tree = store.tree().meta().cloud.world_from_scene;
    if of_tree == scene.world_from_scene.to_array() {
        return Ok(());
    }
    Err(Error::input(format!(
        "the scene's frame is at {:?} in the world, that of the tree at {of_tree:?}",
        scene.world_from_scene.to_array()
    ))
    .hint("bring the scene into the tree's frame, `Scene::in_frame`"))
}

/// What a frame takes from a tree. Where it has no media, `M` is a type without any, and its kernels have no work for them.
struct FrameTree<'a, P, M> {
    pages: &'a P,
    /// Passed by gathers.
    media: M,
    /// Passed by shadow rays to emissive triangles instead of the scene's own.
    shadows: Option<&'a dyn OpticalDepth>,
    /// Mean area that a surfel stands for.
    area_per_surfel: f32,
    /// Whether surfels of one piece of the scene have one size.
    is_even: bool,
}

/// Chooses the frame's kernels by the media in the tree.
fn shade_with<P: Pages>(
    scene: &Scene,
    store: &TreeStore,
    pages: &P,
    settings: &Settings,
    regions: &[Region],
    job: &Job,
) -> Result<Regions> {
    let tree = FrameTree {
        pages,
        media: NoMedia,
        shadows: None,
        area_per_surfel: store.area_per_surfel(),
        is_even: store.tree().meta().cloud.disk_overlap > 0.0,
    };
    match &store.media {
        // A tree without lvoxels says nothing of the scene's media.
        MediaStore::Absent => shade(scene, &tree, settings, regions, job),
        MediaStore::Grey(media) => shade_through(scene, tree, media, settings, regions, job),
        MediaStore::Rgb(media) => shade_through(scene, tree, media, settings, regions, job),
    }
}

fn shade_through<P: Pages, S: Source>(
    scene: &Scene,
    tree: FrameTree<P, NoMedia>,
    media: &Media<S>,
    settings: &Settings,
    regions: &[Region],
    job: &Job,
) -> Result<Regions> {
    let blocks = Blocks(media);
    let tree = FrameTree {
        shadows: Some(&blocks),
        ..tree
    };
    match settings.method {
        Method::Extended => {
            let tree = FrameTree {
                pages: tree.pages,
                media,
                shadows: tree.shadows,
                area_per_surfel: tree.area_per_surfel,
                is_even: tree.is_even,
            };
            shade(scene, &tree, settings, regions, job)
        }
        Method::Traditional => shade(scene, &tree, settings, regions, job),
    }
}

fn shade<P: Pages, M: Medium>(
    scene: &Scene,
    tree: &FrameTree<P, M>,
    settings: &Settings,
    regions: &[Region],
    job: &Job,
) -> Result<Regions> {
    let camera = scene.camera(settings.camera.as_deref())?;
    let tracer = Tracer::new(scene);
    let mut lights = Lights::new(&tracer);
    if let Some(shadows) = tree.shadows {
        lights = lights.with_soft_shadows_through(shadows);
    }
    let outgoing = (settings.kernel == Kernel::Traced).then(|| {
        let outgoing = Outgoing::new(&tracer, tree.area_per_surfel);
        if tree.is_even {
            outgoing
        } else {
            outgoing.of_uneven_surfels()
        }
    });
    let kernel = match (&outgoing, settings.kernel) {
        (Some(outgoing), _) => gather::Kernel::Traced(outgoing),
        (None, Kernel::Plain) => gather::Kernel::Plain,
        (None, _) => gather::Kernel::Cone,
    };
    let surface_gatherer = Gatherer {
        pages: tree.pages,
        media: tree.media,
        settings: gather::Settings {
            samples: settings.samples,
            max_solid_angle: settings.max_solid_angle,
            max_dist: settings.max_dist.unwrap_or(f32::INFINITY),
            kernel,
            environment: lights.environment(),
        },
    };
    let volume_gatherer = Gatherer {
        // A ray over the sphere stands for four times the solid angle that one of a hemisphere does, at half as many.
        settings: gather::Settings {
            samples: settings.volume_samples,
            max_solid_angle: 4.0 * settings.max_solid_angle,
            ..surface_gatherer.settings
        },
        ..surface_gatherer
    };
    let view = View::new(&tracer, camera, scene.film, settings.seed);
    let in_scatter = InScatter::new(
        &view,
        regions,
        &lights,
        (settings.method == Method::Extended).then_some(&volume_gatherer),
        &job.cancel,
    )?;
    let all: u64 = regions.iter().map(|r| r.pixels() as u64).sum();
    let step = u64::from(settings.lattice);
    let gather = job
        .progress
        .task("gather", all / (step * step), "receivers");
    let lattices = regions
        .par_iter()
        .map(|&region| {
            Lattice::new(
                &view,
                &surface_gatherer,
                region,
                settings.lattice,
                &job.cancel,
                &gather,
            )
        })
        .collect::<Result<Vec<_>>>()?;
    drop(gather);
    tree.pages.check()?;
    let task = job.progress.task("shade", all, "pixels");
    let shaded = regions
        .par_iter()
        .zip(&lattices)
        .map(|(&region, lattice)| {
            let lamps = Lamps::new(&view, region, settings.edge_samples);
            let shader = PixelShader {
                view,
                lamps: &lamps,
                lights: &lights,
                lattice,
                gatherer: &surface_gatherer,
                in_scatter: &in_scatter,
                counts: SampleCounts {
                    pixel: settings.pixel_samples,
                    edge: settings.edge_samples,
                    shadow: settings.shadow_rays,
                },
            };
            shade_region(&shader, region, job, &task)
        })
        .collect::<Result<Vec<_>>>()?;
    tree.pages.check()?;
    Ok((shaded, outgoing.map(|o| o.asked()).unwrap_or_default()))
}

fn shade_region<P: Pages, M: Medium>(
    shader: &PixelShader<P, M>,
    region: Region,
    job: &Job,
    task: &Task,
) -> Result<Vec<Pixel>> {
    if shader.counts.pixel == 1 {
        return shade_blocks(shader, region, job, task);
    }
    (region.y0..region.y1)
        .into_par_iter()
        .map(|y| {
            job.cancel.check()?;
            let row: Vec<Pixel> = (region.x0..region.x1).map(|x| shader.shade(x, y)).collect();
            task.add(u64::from(region.width()));
            Ok(row)
        })
        .collect::<Result<Vec<_>>>()
        .map(|rows| rows.concat())
}

impl Geometry for Tracer<'_> {
    fn closest(&self, origin: Vec3, direction: Vec3, t_max: f32) -> Option<gather::outgoing::Hit> {
        let hit = self.closest(origin, direction, t_max)?;
        Some(gather::outgoing::Hit {
            t: hit.t,
            triangle: hit.triangle,
            uv: hit.uv,
        })
    }

    fn corners(&self, triangle: u32) -> [Vec3; 3] {
        self.scene.mesh.corners(triangle as usize)
    }

    fn normal(&self, triangle: u32) -> Vec3 {
        unit_normal(Geometry::corners(self, triangle))
    }

    fn surfel_area_over_mean(&self, triangle: u32) -> Option<f32> {
        let material = self.scene.mesh.material[triangle as usize];
        self.pieces.area_over_mean(material)
    }
}

/// The tree's lvoxels as shadow rays see them.
#[derive(Debug)]
struct Blocks<'a, S>(&'a Media<S>);

impl<S: Source> OpticalDepth for Blocks<'_, S> {
    fn optical_depth(&self, origin: Vec3, direction: Vec3, t_max: f32) -> f32 {
        self.0.optical_depth(origin, direction, t_max)
    }
}

/// Shades a region from the corners of its pixels, block by block.
fn shade_blocks<P: Pages, M: Medium>(
    shader: &PixelShader<P, M>,
    region: Region,
    job: &Job,
    task: &Task,
) -> Result<Vec<Pixel>> {
    let blocks = region.blocks(BLOCK);
    let shaded: Vec<Vec<Pixel>> = blocks
        .par_iter()
        .map(|&block| {
            job.cancel.check()?;
            let corners = Corners::new(shader, block);
            let pixels = (block.y0..block.y1)
                .flat_map(|y| (block.x0..block.x1).map(move |x| (x, y)))
                .map(|(x, y)| corners.shade(x, y))
                .collect();
            task.add(block.pixels() as u64);
            Ok(pixels)
        })
        .collect::<Result<_>>()?;
    let mut pixels = vec![Pixel::default(); region.pixels()];
    for (block, shaded) in blocks.iter().zip(&shaded) {
        let width = block.width() as usize;
        for (row, y) in shaded.chunks_exact(width).zip(block.y0..) {
            let first = (y - region.y0) as usize * region.width() as usize
                + (block.x0 - region.x0) as usize;
            pixels[first..first + width].copy_from_slice(row);
        }
    }
    Ok(pixels)
}

fn to_frame(scene: &Scene, region: Region, pixels: &[Pixel], aovs: &[Aov]) -> Frame {
    let mut frame = Frame::new(scene.film.width, scene.film.height, region);
    let rgb = |name: &str, f: &dyn Fn(&Pixel) -> Rgb| {
        Layer::rgb(name, &pixels.iter().map(|p| f(p).0).collect::<Vec<_>>())
    };
    frame.layers.push(rgb("", &Pixel::radiance));
    for (name, aov) in Aov::ALL {
        if aovs.contains(&aov) {
            frame.layers.push(match aov {
                Aov::Direct => rgb(name, &|p| p.direct),
                Aov::Indirect => rgb(name, &|p| p.indirect),
                Aov::Volume => rgb(name, &|p| p.volume),
                Aov::Depth => Layer::single(name, "Z", pixels.iter().map(|p| p.depth).collect()),
                Aov::Normal => Layer::xyz(
                    name,
                    &pixels
                        .iter()
                        .map(|p| p.normal.to_array())
                        .collect::<Vec<_>>(),
                ),
            });
        }
    }
    frame
}

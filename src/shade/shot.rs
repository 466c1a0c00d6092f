//! Regions of a frame, shaded by code made for what the scene and its tree have: media or none, of
//! one channel or three, pages in memory or in a cache. A frame chooses once.

use super::air::Air;
use super::aov::Part;
use super::bright::BrightLamps;
use super::lattice::Lattice;
use super::media::{self, InScatter};
use super::memory;
use super::pixels::{EmitterBorders, PixelShader, Planes, SampleCounts, shade_region};
use super::settings::{Kernel, Method, Settings};
use super::surface_gatherer::SurfaceGatherer;
use super::view::{Seen, View};
use crate::gather::PatchStats;
use crate::gather::{self, Gatherer, Medium, NoMedia, PatchRadiance};
use crate::image::Region;
use crate::light::{Lights, SoftShadowMedia, Vacuum};
use crate::run::Job;
use crate::scene::Scene;
use crate::trace::Tracer;
use crate::tree::{Media, OpenTree, Pages, SurfelStore};
use crate::{Error, Result};
use lvox_formats::{MappedFile, Scatter};
use rayon::prelude::*;

/// Solid angle below which nodes are taken whole by rays of media, over that of rays of surfaces:
/// few rays look along the whole sphere, so that each stands for far more of it, and their light is
/// a mean of all directions.
const VOLUME_SOLID_ANGLE: f32 = 4.0;

/// What was asked for of the pixels of each region, and what that asked of the tree.
pub type Regions = (Vec<Planes>, PatchStats);

/// What is wanted of a frame.
#[derive(Clone, Copy, Debug)]
pub struct Request<'a> {
    /// How to shade.
    pub settings: &'a Settings,
    /// Parts of the frame to shade.
    pub regions: &'a [Region],
    /// What is kept of pixels.
    pub parts: &'a [Part],
    /// Threads, limits, progress.
    pub job: &'a Job,
}

/// What is made from a tree, by code made for what that has.
pub trait Work {
    /// What is made.
    type Made;

    /// Makes it of a scene without media.
    fn in_vacuum<P: Pages>(&self, shot: &Shot<P, NoMedia>) -> Result<Self::Made>;

    /// Makes it of a scene with media.
    fn in_media<P: Pages, M: Medium>(&self, shot: &Shot<P, M>) -> Result<Self::Made>;
}

/// Shades regions of the frame.
///
/// # Errors
/// As [`super::run`].
pub fn shade_regions(scene: &Scene, store: &OpenTree, request: &Request) -> Result<Regions> {
    let &Request {
        settings,
        regions,
        parts,
        job,
    } = request;
    memory::check(scene, settings, regions, parts, job.memory_limit)?;
    work(scene, store, request, &Pixels)
}

/// Does work on a tree.
///
/// # Errors
/// A tree in another frame than the scene, and those of the work.
pub fn work<W: Work>(
    scene: &Scene,
    store: &OpenTree,
    request: &Request,
    work: &W,
) -> Result<(W::Made, PatchStats)> {
    check_frame(scene, store)?;
    match &store.surfels {
        SurfelStore::Resident(p) => work_with(scene, store, p, request, work),
        SurfelStore::Cached(p) => work_with(scene, store, p, request, work),
    }
}

/// Places in the tree are in the frame of the scene that it was baked of.
fn check_frame(scene: &Scene, store: &OpenTree) -> Result<()> {
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

/// What a frame takes from a tree. Where it has no media, `M` is a type without any, and its
/// kernels have no work for them.
struct FrameTree<'a, P, M> {
    pages: &'a P,
    /// Passed by gathers.
    media: M,
    /// Mean area that a surfel stands for.
    area_per_surfel: f32,
    /// Whether surfels of one piece of the scene have one size.
    is_even: bool,
    /// Light of media that was made beforehand.
    scatter: Option<&'a Scatter<MappedFile>>,
}

/// Chooses the frame's kernels by the media in the tree and in the scene.
fn work_with<P: Pages, W: Work>(
    scene: &Scene,
    store: &OpenTree,
    pages: &P,
    request: &Request,
    work: &W,
) -> Result<(W::Made, PatchStats)> {
    let tree = FrameTree {
        pages,
        media: NoMedia,
        area_per_surfel: store.area_per_surfel(),
        is_even: store.tree().meta().cloud.disk_overlap > 0.0,
        scatter: store.scatter.as_ref(),
    };
    if !store.media.is_empty() {
        work_through(scene, tree, &store.media, request, work)
    } else if scene.volumes.is_empty() {
        with_shot(scene, &tree, request, |shot| work.in_vacuum(shot))
    } else {
        // A tree without lvoxels says nothing of the scene's media.
        with_shot(scene, &tree, request, |shot| work.in_media(shot))
    }
}

fn work_through<P: Pages, W: Work>(
    scene: &Scene,
    tree: FrameTree<P, NoMedia>,
    media: &Media,
    request: &Request,
    work: &W,
) -> Result<(W::Made, PatchStats)> {
    match request.settings.method {
        Method::Extended => {
            let tree = FrameTree {
                pages: tree.pages,
                media,
                area_per_surfel: tree.area_per_surfel,
                is_even: tree.is_even,
                scatter: tree.scatter,
            };
            with_shot(scene, &tree, request, |shot| work.in_media(shot))
        }
        Method::Traditional => with_shot(scene, &tree, request, |shot| work.in_media(shot)),
    }
}

/// What regions of a frame are shaded from.
pub struct Shot<'a, P, M> {
    pub view: View<'a>,
    pub lights: &'a Lights<'a>,
    pub gatherer: Gatherer<'a, P, M>,
    lamps: Option<&'a BrightLamps<'a>>,
    scatter: Option<&'a Scatter<MappedFile>>,
    pub request: &'a Request<'a>,
}

fn with_shot<P: Pages, M: Medium, T>(
    scene: &Scene,
    tree: &FrameTree<P, M>,
    request: &Request,
    finish: impl FnOnce(&Shot<P, M>) -> Result<T>,
) -> Result<(T, PatchStats)> {
    let settings = request.settings;
    let camera = scene.camera(settings.camera.as_deref())?;
    let tracer = Tracer::new_until(scene, &request.job.cancel)?;
    let shadows = SoftShadowMedia::new(scene);
    let lights = Lights::new(&tracer).with_soft_shadows(shadows.as_ref());
    let mut outgoing = (settings.kernel == Kernel::Traced).then(|| {
        let pixels = scene.film.width as usize * scene.film.height as usize;
        let rays = settings.lattice_rays(request.regions.iter().map(Region::pixels).sum());
        let outgoing = PatchRadiance::new(&tracer, tree.area_per_surfel, rays)
            .in_patches_of(settings.surfels_per_patch(pixels));
        if tree.is_even {
            outgoing
        } else {
            outgoing.of_uneven_surfels()
        }
    });
    let view = View::new(&tracer, camera, scene.film, settings.seed);
    // In media their light is that of many directions, of which rays meet enough.
    let lamps = (outgoing.as_mut())
        .filter(|_| M::IS_NOTHING)
        .and_then(|outgoing| BrightLamps::find(&view, &lights, outgoing, tree.pages, settings));
    let kernel = match (&outgoing, settings.kernel) {
        (Some(outgoing), _) => gather::Kernel::Traced(outgoing),
        (None, Kernel::Plain) => gather::Kernel::Plain,
        (None, _) => gather::Kernel::Cone,
    };
    let made = finish(&Shot {
        view,
        lights: &lights,
        gatherer: Gatherer {
            pages: tree.pages,
            media: tree.media,
            settings: gather::Settings {
                samples: settings.samples,
                max_solid_angle: settings.max_solid_angle,
                max_dist: settings.max_dist.unwrap_or(f32::INFINITY),
                kernel,
                environment: lights.environment(),
                leave_out_bright: lamps.is_some(),
            },
        },
        lamps: lamps.as_ref(),
        scatter: tree.scatter,
        request,
    })?;
    Ok((made, outgoing.map(|o| o.stats()).unwrap_or_default()))
}

/// Shading of the regions of a request.
struct Pixels;

impl Work for Pixels {
    type Made = Vec<Planes>;

    fn in_vacuum<P: Pages>(&self, shot: &Shot<P, NoMedia>) -> Result<Vec<Planes>> {
        shot.shade(&Vacuum, &shot.lights.in_vacuum())
    }

    fn in_media<P: Pages, M: Medium>(&self, shot: &Shot<P, M>) -> Result<Vec<Planes>> {
        let gatherer = shot.volume_gatherer();
        let is_gathered = shot.request.settings.method == Method::Extended;
        let light = media::Light {
            lights: shot.lights,
            gatherer: is_gathered.then_some(&gatherer),
            beforehand: shot.scatter,
        };
        let seen = Seen::Through(shot.request.regions);
        let in_scatter = InScatter::new(&shot.view, seen, &light, shot.request.job)?;
        let shaded = shot.shade(&in_scatter, shot.lights)?;
        in_scatter.check()?;
        Ok(shaded)
    }
}

impl<P: Pages, M: Medium> Shot<'_, P, M> {
    /// What gathers inside media.
    pub fn volume_gatherer(&self) -> Gatherer<'_, P, M> {
        let settings = self.request.settings;
        Gatherer {
            settings: gather::Settings {
                samples: settings.volume_samples,
                max_solid_angle: VOLUME_SOLID_ANGLE * settings.max_solid_angle,
                ..self.gatherer.settings
            },
            ..self.gatherer
        }
    }

    fn shade<A: Air>(&self, air: &A, lights: &Lights<A::Shadows>) -> Result<Vec<Planes>> {
        let view = self.view;
        let &Request {
            settings,
            regions,
            parts,
            job,
        } = self.request;
        let pages = self.gatherer.pages;
        let with_samples = |samples| SurfaceGatherer {
            view: &self.view,
            gatherer: Gatherer {
                settings: gather::Settings {
                    samples: match self.lamps {
                        Some(_) => BrightLamps::other_rays(samples),
                        None => samples,
                    },
                    ..self.gatherer.settings
                },
                ..self.gatherer
            },
            lamps: self.lamps,
        };
        let all: u64 = regions.iter().map(|r| r.pixels() as u64).sum();
        let step = u64::from(settings.lattice);
        let gather = job
            .progress
            .task("gather", all / (step * step), "receivers");
        let gatherer = with_samples(settings.samples);
        let lattices = regions
            .par_iter()
            .map(|&region| Lattice::new(&gatherer, region, settings.lattice, &job.cancel, &gather))
            .collect::<Result<Vec<_>>>()?;
        drop(gather);
        pages.check()?;
        let task = job.progress.task("shade", all, "pixels");
        let gatherer = with_samples(settings.own_samples());
        let shaded = regions
            .par_iter()
            .zip(&lattices)
            .map(|(&region, lattice)| {
                let borders =
                    EmitterBorders::new(&view, region, settings.edge_samples, &job.cancel)?;
                let shader = PixelShader {
                    view,
                    borders: &borders,
                    lights,
                    lattice,
                    gatherer: &gatherer,
                    air,
                    counts: SampleCounts {
                        pixel: settings.pixel_samples,
                        corner_spacing: settings.corner_spacing,
                        edge: settings.edge_samples,
                        shadow: settings.shadow_rays,
                        volume: settings.volume_samples,
                    },
                };
                shade_region(&shader, region, parts, job, &task)
            })
            .collect::<Result<Vec<_>>>()?;
        pages.check()?;
        Ok(shaded)
    }
}

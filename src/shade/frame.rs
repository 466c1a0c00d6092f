//! Regions of a frame: what all their pixels share is made once, then gathers, then pixels.

use super::memory;
use super::pixels::{
    CameraMedia, Confusion, EmissiveMedia, EmitterBorders, EndsOfView, March, PixelShader, Planes,
    Quantity, SampleCounts, ScatteringMedia, shade_region, shade_region_by_lens, spread_into,
};
use super::settings::{Kernel, Method, Settings};
use super::surfaces::{BrightPatchLights, GatherAtSurfaces, KeptGathers, Lattice, SurfaceGatherer};
use crate::Result;
use crate::gather::{self, Gatherer, Medium, PatchRadiance, PatchStats, TreeTask};
use crate::image::{Onlooker, Region};
use crate::inscatter::{self, InScatter, MediaCounts, MediaLights};
use crate::light::{Lights, SceneMedia, SoftShadowMedia, Vacuum};
use crate::math::{Environment, Rgb};
use crate::run::Job;
use crate::scene::{Scene, Volume};
use crate::trace::Tracer;
use crate::tree::{OpenTree, SurfelStore};
use crate::view::{self, View, VisibleMedia};
use rayon::prelude::*;

/// What is wanted of a frame.
#[derive(Clone, Copy, Debug)]
pub struct Request<'a> {
    /// What the camera sees.
    pub scene: &'a Scene,
    /// What lights it indirectly.
    pub tree: &'a OpenTree,
    /// How to shade.
    pub settings: &'a Settings,
    /// Parts of the frame to shade.
    pub regions: &'a [Region],
    /// What is kept of pixels.
    pub quantities: &'a [Quantity],
    /// One who looks on.
    pub onlooker: Option<&'a dyn Onlooker>,
    /// Threads, limits, progress.
    pub job: &'a Job,
}

/// The quantities of the pixels of each region, and what they asked for.
pub type ShadedRegions = (Vec<Planes>, FrameCounts);

/// What the regions of a frame asked for.
#[derive(Clone, Copy, Debug, Default)]
pub struct FrameCounts {
    /// Of the tree's surfels.
    pub patches: PatchStats,
    /// Of light in media.
    pub media: MediaCounts,
}

/// What is done once all that the pixels of a frame share is there.
pub trait FrameWork: Sync {
    /// What comes of it.
    type Output;

    /// About how many rays its gathers on surfaces will cast.
    fn gather_rays(&self, request: &Request) -> usize;

    /// Does it behind media, by lights whose shadow rays pass those.
    ///
    /// # Errors
    /// As [`super::run`].
    fn run<A: CameraMedia>(
        &self,
        frame: &FrameShader,
        media: &A,
        lights: &Lights<A::Shadows>,
    ) -> Result<Self::Output>;
}

/// Shades regions of the frame.
///
/// # Errors
/// As [`super::run`].
pub fn shade_regions(request: &Request) -> Result<ShadedRegions> {
    with_frame(request, request.regions, &ShadeRegions)
}

/// Does a work with the frame of a request. Of the pixels of some regions all is held at once.
///
/// # Errors
/// As [`super::run`].
pub fn with_frame<W: FrameWork>(
    request: &Request,
    held: &[Region],
    work: &W,
) -> Result<(W::Output, FrameCounts)> {
    let &Request {
        scene,
        tree,
        settings,
        quantities,
        job,
        ..
    } = request;
    let needs = tree.needs_within_limit();
    let budget = memory::check(scene, settings, held, quantities, needs, job)?;
    job.hold(&budget.with("the tree", needs.least_bytes));
    view::check_frame(scene, tree.tree().meta().cloud.world_from_scene)?;
    inscatter::check_colors(&tree.tree().meta().cloud.volumes, scene)?;
    let task = FrameTask { request, work };
    let done = match settings.method {
        Method::Extended => gather::with_tree(tree, task),
        Method::Traditional => gather::with_surfels(tree, task),
    };
    scene.check_file()?;
    done
}

/// Work for a request, compiled for each kind of media.
struct FrameTask<'a, W> {
    request: &'a Request<'a>,
    work: &'a W,
}

impl<W: FrameWork> TreeTask for FrameTask<'_, W> {
    type Output = Result<(W::Output, FrameCounts)>;

    fn run<M: Medium>(self, pages: &SurfelStore, media: M) -> Self::Output {
        let Self { request, work } = self;
        let &Request {
            scene,
            tree,
            settings,
            job,
            ..
        } = request;
        let camera = scene.camera(settings.camera.as_deref())?;
        let amid_shutter = (!camera.path.is_empty()).then(|| camera.amid_shutter());
        let camera = amid_shutter.as_ref().unwrap_or(camera);
        // Vertices that were lit beforehand stand on the grids that all cameras share.
        let adapted = match &tree.scatter {
            Some(_) => view::media_of_all_cameras(&scene.volumes)?,
            None => view::media_on_pixels(&scene.volumes, camera, scene.film)?,
        };
        let volumes = adapted.as_deref().unwrap_or(&scene.volumes);
        let tracer = Tracer::with_volumes(scene, volumes, &job.cancel)?;
        let shadows = SoftShadowMedia::new(scene, volumes)?;
        let lights = Lights::<SceneMedia<M::Share>>::new(&tracer);
        let lights = lights.with_soft_shadows(shadows.as_ref());
        let view = View::new(&tracer, camera, scene.film, settings.seed);
        let mut patches = (settings.kernel == Kernel::Traced)
            .then(|| patch_radiance(request, &tracer, work.gather_rays(request)))
            .transpose()?;
        // In media their light is that of many directions, of which rays meet enough.
        let bright_patches = (patches.as_mut())
            .filter(|_| M::IS_NOTHING)
            .and_then(|patches| BrightPatchLights::find(&view, &lights, patches, pages, settings));
        let gathers = gather::RaySettings {
            environment: lights.environment(),
            leave_out_bright: bright_patches.is_some(),
            ..ray_settings(settings, patches.as_ref())
        };
        let with_settings = |settings| Gatherer {
            pages,
            media,
            settings,
        };
        let on_surfaces = |samples| SurfaceGatherer {
            view: &view,
            gatherer: with_settings(gather::RaySettings {
                samples: (bright_patches.as_ref())
                    .map_or(samples, |_| BrightPatchLights::other_rays(samples)),
                ..gathers
            }),
            bright_patches: bright_patches.as_ref(),
        };
        let shader = FrameShader {
            request,
            view,
            lattice_gatherer: &on_surfaces(settings.samples),
            own_gatherer: &on_surfaces(settings.own_samples()),
        };
        let is_vacuum = scene.volumes.is_empty() && tree.media.is_empty();
        let (done, media) = if is_vacuum && scene.emissive.is_empty() {
            (
                work.run(&shader, &Vacuum, &lights.in_vacuum())?,
                MediaCounts::default(),
            )
        } else {
            behind_media(work, &shader, &lights, volumes, &with_settings(gathers))?
        };
        let patches = patches.map(|p| p.stats()).unwrap_or_default();
        Ok((done, FrameCounts { patches, media }))
    }
}

/// Does a work with a frame amid media that scatter or shine, given the gathers on surfaces.
fn behind_media<W: FrameWork, M: Medium>(
    work: &W,
    frame: &FrameShader,
    lights: &Lights<SceneMedia<M::Share>>,
    volumes: &[Volume],
    gatherer: &Gatherer<M>,
) -> Result<(W::Output, MediaCounts)> {
    let &Request {
        scene,
        tree,
        settings,
        regions,
        job,
        ..
    } = frame.request;
    let gathers = gatherer.settings;
    let (media, incident) = inscatter::known_incident(&gatherer.media, volumes, gathers.max_dist);
    let gatherer = Gatherer {
        media,
        settings: inscatter::gather_settings(gathers, settings.volume_samples),
        ..*gatherer
    };
    let light = MediaLights {
        lights,
        gatherer: (settings.method == Method::Extended).then_some(&gatherer),
        scattered: tree.scatter.as_ref(),
        incident,
    };
    let visible = VisibleMedia::ThroughRegions(regions);
    let in_scatter = InScatter::new(&frame.view, visible, &light, job)?;
    let before_emission: &dyn March<M::Share> = &in_scatter;
    let emissive = EmissiveMedia(before_emission);
    let media: &dyn March<M::Share> = match scene.emissive.is_empty() {
        true => before_emission,
        false => &emissive,
    };
    let on_surfaces = lights.with_media_before_suns(in_scatter.before_suns());
    let done = work.run(frame, &ScatteringMedia(media), &on_surfaces)?;
    in_scatter.check()?;
    Ok((done, in_scatter.counts()))
}

/// What settings ask of the rays of gathers, in a scene without an environment.
fn ray_settings<'a>(
    settings: &Settings,
    patches: Option<&'a PatchRadiance<'a>>,
) -> gather::RaySettings<'a> {
    gather::RaySettings {
        samples: settings.samples,
        max_solid_angle: settings.max_solid_angle,
        max_dist: settings.max_dist.unwrap_or(f32::INFINITY),
        kernel: match (patches, settings.kernel) {
            (Some(patches), _) => gather::RayKernel::Traced(patches),
            (None, Kernel::Plain) => gather::RayKernel::Plain,
            (None, _) => gather::RayKernel::Cone,
        },
        environment: Environment::even(Rgb::BLACK),
        leave_out_bright: false,
    }
}

/// The radiance of the scene's surfaces, of which nothing is known yet but what is in a file.
fn patch_radiance<'a>(
    request: &Request,
    tracer: &'a Tracer,
    rays: usize,
) -> Result<PatchRadiance<'a>> {
    let &Request {
        scene,
        tree,
        settings,
        ..
    } = request;
    let pixels = scene.film.width as usize * scene.film.height as usize;
    let patches = PatchRadiance::of_tree(tracer, tree, rays)?
        .in_patches_of(settings.surfels_per_patch(pixels));
    match &request.job.radiance_cache {
        Some(file) => patches.cached_in(file, &scene.surface_digest(), tree),
        None => Ok(patches),
    }
}

/// The gathers of a frame that its tiles keep for each other, if they do.
fn kept_gathers(request: &Request) -> Result<Option<KeptGathers>> {
    let &Request {
        scene,
        tree,
        settings,
        job,
        ..
    } = request;
    let Some(file) = &job.gather_cache else {
        return Ok(None);
    };
    let film = [scene.film.width, scene.film.height];
    let camera = scene.camera(settings.camera.as_deref())?.amid_shutter();
    let settings = serde_json::to_string(&Settings {
        camera: Some(camera.name.clone()),
        ..settings.clone()
    });
    let mut identity = blake3::Hasher::new();
    identity.update(b"gathers");
    identity.update(env!("CARGO_PKG_VERSION").as_bytes());
    identity.update(&scene.hash);
    identity.update(&tree.tree().content_hash());
    if let Some(light) = &tree.scatter {
        identity.update(&light.content_hash());
    }
    for n in film {
        identity.update(&n.to_le_bytes());
    }
    // One that moves has the same name in all frames.
    let place = camera.scene_from_camera.to_cols_array();
    for number in place.into_iter().chain([camera.fov_x_rad]) {
        identity.update(&number.to_le_bytes());
    }
    identity.update(settings.unwrap_or_default().as_bytes());
    let identity = identity.finalize().into();
    KeptGathers::in_file(file, identity, film, request.settings.lattice).map(Some)
}

/// What the pixels of a frame are shaded by.
pub struct FrameShader<'a> {
    /// What is wanted.
    pub request: &'a Request<'a>,
    /// Camera and scene.
    pub view: View<'a>,
    /// Gathers of the lattice.
    pub lattice_gatherer: &'a dyn GatherAtSurfaces,
    /// Gathers of surfaces that the lattice missed.
    pub own_gatherer: &'a dyn GatherAtSurfaces,
}

/// Shading of all pixels of regions.
struct ShadeRegions;

impl FrameWork for ShadeRegions {
    type Output = Vec<Planes>;

    fn gather_rays(&self, request: &Request) -> usize {
        let pixels = request.regions.iter().map(Region::pixels).sum();
        request.settings.lattice_rays(pixels)
    }

    fn run<A: CameraMedia>(
        &self,
        frame: &FrameShader,
        media: &A,
        lights: &Lights<A::Shadows>,
    ) -> Result<Vec<Planes>> {
        let view = frame.view;
        let &Request {
            settings,
            regions,
            quantities,
            onlooker,
            job,
            ..
        } = frame.request;
        let all: u64 = regions.iter().map(|r| r.pixels() as u64).sum();
        let step = u64::from(settings.lattice);
        let task = (job.progress).task("gather", all / (step * step), "receivers");
        let gatherer = frame.lattice_gatherer;
        let kept = kept_gathers(frame.request)?;
        let is_pinhole = view.camera.is_pinhole();
        let confusion = (!is_pinhole).then(|| Confusion::of(&view));
        let lattice = |&region| {
            let region = match &confusion {
                Some(confusion) => spread_into(confusion, region),
                None => region,
            };
            let kept = kept.as_ref();
            Lattice::new(gatherer, region, settings.lattice, kept, &job.cancel, &task)
        };
        let lattices = regions
            .par_iter()
            .map(lattice)
            .collect::<Result<Vec<_>>>()?;
        drop(task);
        gatherer.check()?;
        let task = job.progress.task("shade", all, "pixels");
        let shaded = regions
            .par_iter()
            .zip(&lattices)
            .map(|(&region, lattice)| {
                let seen = match &confusion {
                    Some(confusion) => spread_into(confusion, region),
                    None => region,
                };
                let borders = EmitterBorders::new(&view, seen, settings.edge_samples, &job.cancel)?;
                let shader = PixelShader {
                    view,
                    borders: &borders,
                    lights,
                    lattice,
                    gatherer: frame.own_gatherer,
                    media,
                    counts: SampleCounts::of(settings),
                    shows_background: settings.background,
                    media_have_colors: view.tracer.scene.has_albedo_grids(),
                    ends: (quantities.iter().any(|q| q.is_of_ends()))
                        .then(|| EndsOfView::of(&view)),
                    cancel: &job.cancel,
                };
                match &confusion {
                    None => shade_region(&shader, region, quantities, onlooker, job, &task),
                    Some(confusion) => shade_region_by_lens(
                        &shader, confusion, region, quantities, onlooker, job, &task,
                    ),
                }
            })
            .collect::<Result<Vec<_>>>()?;
        frame.own_gatherer.check()?;
        Ok(shaded)
    }
}

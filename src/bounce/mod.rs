//! tree + scene → the same tree with the light of every bounce, once for all frames.
//!
//! A frame gathers what the surfels of a tree send: of a baked cloud, the light that comes straight
//! from lights, so that a picture has one bounce. Here light is gathered at few receivers, the rays
//! of which are kept as links from one receiver to the next, over which further bounces go without
//! another ray. What arrives after all of them is reflected by the surfels of a new tree. Media
//! scatter every order of light, too, as means over their lvoxels. Volumes on one grid are one
//! medium. Others light each other by way of surfaces alone, and what surfaces send to one passes
//! no other.
//!
//! | file | what it does |
//! | --- | --- |
//! | `settings` | how light is bounced |
//! | `runs` | the surfels below a node that face one way |
//! | `receivers` | the place in a run at which light is gathered, and its rays |
//! | `surface_below` | the surface that a surfel stands on |
//! | `places` | what is nearest and faces as a point does |
//! | `links` | receivers by place, and the shares of light that go between them |
//! | `blocks` | the lvoxels of a volume, and the way of a ray through them |
//! | `shared_grid` | volumes on one grid as one medium |
//! | `light` | light, by channel |
//! | `lattice` | parallel rays through a volume; `walls`: the surfaces on them |
//! | `crossings` | the lvoxels that rays cross, laid down |
//! | `sweeps` | light along all rays of a volume, as means over lvoxels |
//! | `media` | the sources of lvoxels, every order of scattering; `krylov`: the linear system |
//! | `lobes` | the same where media scatter by phase functions |
//! | `diffusion` | about where light ends that scatters often, from block to block |
//! | `incident` | what lvoxels send each other in the end, for frames to look up |
//! | `solve` | one bounce after another, until they fade; surfaces and media in turn |
//! | `rewrite` | the pages of the tree with more light |

mod blocks;
mod crossings;
mod diffusion;
mod incident;
mod krylov;
mod lattice;
mod light;
mod links;
mod lobes;
mod media;
mod places;
mod receivers;
mod rewrite;
mod runs;
mod settings;
mod shared_grid;
mod solve;
mod surface_below;
mod sweeps;
mod walls;

use crate::formats::{Overwrite, TreeMeta, TreeSummary, TreeWriter};
use crate::gather::{ColoredMedia, Medium, NoMedia};
use crate::light::{Lights, SceneMedia};
use crate::math::{Aabb, Rgb};
use crate::run::{Budget, Job, hex};
use crate::scene::{Scene, Volume};
use crate::trace::Tracer;
use crate::tree::OpenTree;
use crate::tree::media::{TwoLobes, mean_direction};
use crate::view;
use crate::{Error, Result};
use blocks::Blocks;
use crossings::Room;
use glam::Vec3;
use light::{Light, Share};
use links::{Links, Sites};
use lobes::Lobes;
use lvox_formats::record::VolumeInfo;
use lvox_formats::{MappedFile, Tree};
use media::ScatteringVolume;
use places::Places;
use rayon::prelude::*;
use receivers::{LitRun, Met, MetByReceiver, PageReceivers, Receiver, ReceiverMaker};
use rewrite::{Neighbours, NewLight};
pub use settings::{Bounces, Settings};
use shared_grid::{Member, SharedGrid};
use solve::{Exchange, Solution};
use std::path::Path;
use sweeps::Sweeps;
use walls::Walls;

/// Share of a tree's surfels whose surface is not found, from which on that is told: where surfaces
/// meet, rounding hides some of them.
const MOST_LOST: f64 = 1e-3;

/// Share of the light that surfaces keep from one bounce to the next, from which on that is told:
/// what is off by a hundredth each time is off by a fifth in all.
const MOST_KEPT: f64 = 0.95;

/// Writes a tree that sends the light of all bounces, or of so many.
///
/// # Errors
/// A setting out of range, a tree whose light has bounced already or that is in another frame than
/// the scene ([`Scene::in_frame`]), light that does not fade, receivers that the memory limit does
/// not allow, a page that cannot be read, a file that cannot be written, or a stop on request.
pub fn run(
    scene: &Scene,
    tree: &OpenTree,
    output: &Path,
    settings: &Settings,
    overwrite: Overwrite,
    job: &Job,
) -> Result<TreeSummary> {
    settings.check()?;
    let source = tree.tree();
    check_tree(source)?;
    view::check_frame(scene, source.meta().cloud.world_from_scene)?;
    check_memory(scene, source, settings, job)?;
    job.watched_stage("bounce", tree.fitter(job), |counts| {
        let meta = meta(source, settings);
        let mut writer = TreeWriter::create(output, meta, overwrite)?;
        writer.relight(source.summary());
        let tracer = Tracer::new_until(scene, &job.cancel)?;
        let gathering = Gathering {
            tracer: &tracer,
            tree,
            settings,
            job,
        };
        let mut lit = match settings.bounces {
            Bounces::Count(1) => Lit::nothing(source.surfel_pages()),
            _ if tree.media.is_empty() => gathering.run(NoMedia)?,
            _ if tree.media.are_colored() => gathering.run(ColoredMedia(&tree.media))?,
            _ => gathering.run(&tree.media)?,
        };
        let light = NewLight {
            sites: &match lit.places.take() {
                Some(places) => Sites::at_places(&lit.receivers, &tracer, places),
                None => Sites::new(&lit.receivers, &tracer),
            },
            neighbours: &lit.neighbours,
            light: &lit.solution.light,
            runs: &lit.runs,
            sources: &lit.sources,
            lobes: &lit.lobes,
            incident: &lit.incident,
        };
        let lost = rewrite::write(source, &light, &mut writer, job)?;
        scene.check_file()?;
        let surfels = source.summary().sums.surfels;
        if lost as f64 > MOST_LOST * surfels as f64 {
            job.progress.warn(&format!(
                "{lost} of {surfels} surfels stand on no surface of the scene and reflect one bounce \
                 alone: the tree is of another version of the scene"
            ));
        }
        if lit.solution.kept > MOST_KEPT {
            job.progress.warn(&format!(
                "surfaces keep {:.1} % of their light from one bounce to the next, and what each bounce is off by adds \
                 up: the picture may be too bright or too dark by a tenth and more; lower albedos near 1",
                100.0 * lit.solution.kept
            ));
        }
        if let Some([a, b]) = side_by_side(&scene.volumes)
            && settings.bounces != Bounces::Count(1)
        {
            job.progress.warn(&format!(
                "the volumes {:?} and {:?} lie side by side: light that is scattered again in one does not reach \
                 the other, and where they are dense the picture may be too dark by a tenth; join them in one grid",
                a.name, b.name
            ));
        }
        job.heed_warnings()?;
        let old = source.summary();
        let summary = writer.finish(old.root_page, old.cloud_sums.clone(), old.levels.clone())?;
        let receivers = &lit.receivers;
        let rays: u64 = receivers.iter().map(|r| u64::from(r.count)).sum();
        for (name, count) in [
            ("surfels without a surface", lost as f64),
            ("receivers", receivers.len() as f64),
            ("rays", rays as f64),
            ("links", lit.links as f64),
            ("lost links", lit.lost_links as f64),
            ("passes", f64::from(lit.solution.passes)),
            ("sweeps", f64::from(lit.sweeps)),
            ("residual", lit.solution.residual),
            ("residual in media", lit.media_residual),
        ] {
            counts.insert(name.into(), count);
        }
        Ok(summary)
    })
}

/// Refuses a tree whose light has bounced already.
///
/// # Errors
/// Such a tree, which is not named.
pub fn check_tree(tree: &Tree<MappedFile>) -> Result<()> {
    match tree.meta().bounces() {
        None => Ok(()),
        Some(bounces) => Err(Error::input(format!(
            "expected a tree as `build` made it, found one whose light has bounced (`bounces` {bounces})"
        ))
        .hint("bounce the tree that this one was made from")),
    }
}

/// Two volumes that share a face, as parts of one cloud do: each is solved by itself.
fn side_by_side(volumes: &[Volume]) -> Option<[&Volume; 2]> {
    /// Part of the smaller one's box that both may have.
    const MOST_SHARED: f32 = 0.2;
    let touch = |a: &Volume, b: &Volume| {
        let voxel = a.longest_voxel_edge().max(b.longest_voxel_edge());
        let (a, b) = (a.bounds(), b.bounds());
        let along = a.max.min(b.max) - a.min.max(b.min);
        let wide = along.to_array().iter().filter(|n| **n > voxel).count();
        let size = |of: &Aabb| (of.max - of.min).element_product();
        let shared = along.max(Vec3::ZERO).element_product();
        along.min_element() >= -voxel && wide >= 2 && shared < MOST_SHARED * size(&a).min(size(&b))
    };
    volumes.iter().enumerate().find_map(|(i, b)| {
        let a = volumes[..i].iter().find(|a| touch(a, b))?;
        Some([a, b])
    })
}

/// Surfels of a run: so many that there are some thousand runs of a small cloud, and a million at
/// most.
fn run_surfels(tree: &Tree<MappedFile>) -> u32 {
    const FEWEST_RUNS: u64 = 4096;
    const MOST_RUNS: u64 = 1 << 20;
    const SURFELS: (u64, u64) = (8, 128);
    let surfels = tree.summary().sums.surfels;
    let of_few = (surfels / FEWEST_RUNS).clamp(SURFELS.0, SURFELS.1);
    of_few.max(surfels / MOST_RUNS).min(u64::from(u32::MAX)) as u32
}

/// Refuses to bounce light within a limit that does not hold what that takes; returns the bytes
/// that are held beside the tree.
///
/// # Errors
/// A limit that is too low, with the largest holders.
pub fn check_memory(
    scene: &Scene,
    tree: &Tree<MappedFile>,
    settings: &Settings,
    job: &Job,
) -> Result<u64> {
    match tree.meta().cloud.volumes.iter().all(VolumeInfo::is_grey) {
        true => check_memory_of::<f32>(scene, tree, settings, job),
        false => check_memory_of::<Rgb>(scene, tree, settings, job),
    }
}

/// The same for media that are grey or have colour.
fn check_memory_of<K: Share>(
    scene: &Scene,
    tree: &Tree<MappedFile>,
    settings: &Settings,
    job: &Job,
) -> Result<u64> {
    let least = least_memory::<K>(scene, tree, settings, job);
    let what = "bouncing light in this scene";
    least.within(what, job.memory_limit, "raise `memory_limit`")?;
    let laid_down = match job.memory_limit {
        Some(_) => bytes_laid_down::<K>(&least, tree, job),
        None => 0,
    };
    let budget = least.with("what rays cross in media", laid_down);
    job.hold(&budget);
    Ok(budget.bytes())
}

/// Sets of rays that are held together: those of the solution, and those of what frames look up.
const SETS_AT_A_TIME: u64 = 2;

/// What is held beside the tree whatever the limit.
fn least_memory<K: Share>(
    scene: &Scene,
    tree: &Tree<MappedFile>,
    settings: &Settings,
    job: &Job,
) -> Budget {
    /// Runs of each that is as large as may be: some face other ways, some are divided.
    const DIVIDED: u64 = 8;
    let sums = &tree.summary().sums;
    let runs = sums.surfels / u64::from(run_surfels(tree)) + 1;
    let met = size_of::<Met<K>>() + Links::BYTES;
    let receiver = size_of::<Receiver>()
        + size_of::<Vec<Met<K>>>()
        + Sites::BYTES
        + settings.samples as usize * met;
    let volumes = tree.meta().cloud.volumes.iter();
    let has_surfaces = scene.mesh.triangle_count() > 0;
    let of_rays = |volume| Sweeps::<K>::bytes_for(volume, has_surfaces);
    let has_lobes = scene.volumes.iter().any(|v| v.phase.moment(1) != 0.0);
    let varies = scene.has_albedo_grids();
    let of_lvoxel = ScatteringVolume::<K>::BYTES_A_BLOCK
        + if has_lobes { Lobes::BYTES_A_BLOCK } else { 0 }
        + if varies { Blocks::BYTES_OF_ALBEDO } else { 0 };
    let of_shared = match shared_grid::any_shared(&tree.meta().cloud.volumes) {
        true => SharedGrid::MOST_BLOCKS * (of_lvoxel + ScatteringVolume::<K>::BYTES_KEPT),
        false => 0,
    };
    (scene.budget(scene.bytes_of_grids(), job))
        .with("what rays need of it", Tracer::bytes_for(scene))
        .with(
            "receivers and their links",
            DIVIDED * runs * 2 * receiver as u64,
        )
        .with(
            "lvoxels",
            sums.lvoxels().saturating_mul(of_lvoxel + of_shared),
        )
        .with(
            "rays through media",
            SETS_AT_A_TIME * volumes.map(of_rays).sum::<u64>(),
        )
}

/// Bytes for what rays cross in media: a half of what a limit leaves, and the other for pages.
fn bytes_laid_down<K: Share>(least: &Budget, tree: &Tree<MappedFile>, job: &Job) -> u64 {
    let all = Sweeps::<K>::bytes_laid_down(tree.summary().sums.lvoxels());
    let left = |limit: u64| limit.saturating_sub(least.bytes()) / 2;
    job.memory_limit
        .map_or(u64::MAX, |limit| all.min(left(limit)))
}

/// The light of all bounces.
#[derive(Default)]
struct Lit {
    /// By page.
    runs: Vec<Vec<LitRun>>,
    receivers: Vec<Receiver>,
    /// Their order by place.
    places: Option<Places>,
    /// By receiver: those whose light is interpolated around it.
    neighbours: Vec<Neighbours>,
    links: usize,
    lost_links: usize,
    solution: Solution,
    /// By volume and lvoxel.
    sources: Vec<Vec<Light>>,
    /// The same for the lobes in which their light leaves.
    lobes: Vec<Vec<TwoLobes>>,
    /// By lvoxel of the only volume: what the others send to it. Empty if there are more.
    incident: Vec<Light>,
    sweeps: u32,
    /// Of the volume that is known least well.
    media_residual: f64,
}

impl Lit {
    fn nothing(pages: usize) -> Self {
        Self {
            runs: vec![Vec::new(); pages],
            ..Self::default()
        }
    }

    /// The receivers of all pages of a tree, and by receiver the surfaces that its rays met.
    fn at_receivers<M: Medium<Share: Share>>(
        maker: &ReceiverMaker<M>,
        source: &Tree<MappedFile>,
        job: &Job,
    ) -> Result<(Self, MetByReceiver<M::Share>)> {
        let count = source.surfel_pages();
        let task = job.progress.task("receivers", count as u64, "pages");
        let made = (0..count).into_par_iter().map(|id| {
            job.cancel.check()?;
            let made = maker.make(&source.surfel_page(id)?, id as u32);
            task.add(1);
            Ok(made)
        });
        let made = made.collect::<Result<Vec<_>>>()?;
        drop(task);
        let (mut lit, mut all_met) = (Self::nothing(0), Vec::new());
        for of_page in made {
            let PageReceivers {
                mut runs,
                receivers,
                met,
            } = of_page;
            let first = lit.receivers.len() as u32;
            let numbers = runs.iter_mut().flat_map(|r| &mut r.receivers);
            numbers.for_each(|r| *r += first);
            lit.runs.push(runs);
            lit.receivers.extend(receivers);
            all_met.extend(met);
        }
        Ok((lit, all_met))
    }
}

/// Gathers at all receivers of a tree.
struct Gathering<'a> {
    tracer: &'a Tracer<'a>,
    tree: &'a OpenTree,
    settings: &'a Settings,
    job: &'a Job,
}

impl Gathering<'_> {
    /// Finds the light of all bounces in such media.
    fn run<M: Medium<Share: Share>>(self, media: M) -> Result<Lit> {
        let Self {
            tracer,
            tree,
            settings,
            job,
        } = self;
        let source = tree.tree();
        let run_surfels = run_surfels(source);
        let maker = ReceiverMaker {
            tracer,
            media,
            samples: settings.samples,
            run_surfels,
            seed: settings.seed,
        };
        let (mut lit, met) = Lit::at_receivers(&maker, source, job)?;
        let (scene, receivers, cancel) = (tracer.scene, &lit.receivers, &job.cancel);
        let sites = Sites::new(receivers, tracer);
        let links = Links::new(scene, &sites, &met, cancel)?;
        (lit.links, lit.lost_links) = (links.len(), links.lost());
        let walls = Walls {
            tracer,
            sites: &sites,
        };
        let mean_cosines: Vec<f32> = scene.volumes.iter().map(|v| v.phase.moment(1)).collect();
        let infos = &source.meta().cloud.volumes;
        let grids = SharedGrid::of_all(infos, lvoxels(source, &scene.volumes, &mean_cosines)?);
        let least = least_memory::<M::Share>(scene, source, settings, job);
        let room = Room::new(bytes_laid_down::<M::Share>(&least, source, job));
        let volumes = grids.iter().map(|grid| {
            let blocks = grid.blocks();
            let sweeps = Sweeps::new(blocks, &walls, &room, cancel)?;
            let volume = ScatteringVolume::new(blocks, sweeps, grid.direct());
            match grid.only() {
                Some(only) if only.mean_cosine != 0.0 => {
                    volume.in_lobes(Lobes::new(&only.lobes, only.mean_cosine), cancel)
                }
                Some(_) => Ok(volume),
                None => Ok(volume.that_keeps_arriving()),
            }
        });
        let mut exchange = Exchange {
            receivers,
            met: &met,
            links: &links,
            volumes: volumes.collect::<Result<_>>()?,
            cancel,
        };
        lit.solution = exchange.solve(settings.bounces)?;
        lit.neighbours = rewrite::neighbours(&sites, &lit.solution.light);
        lit.sweeps = exchange.volumes.iter().map(|v| v.swept).sum();
        let residuals = exchange.volumes.iter().map(|v| v.residual);
        lit.media_residual = residuals.fold(0.0, f64::max);
        (lit.sources, lit.lobes) = (vec![Vec::new(); infos.len()], vec![Vec::new(); infos.len()]);
        for (grid, volume) in grids.iter().zip(&exchange.volumes) {
            match grid.only() {
                Some(only) => {
                    (lit.sources[only.volume], lit.lobes[only.volume]) = volume.sent();
                }
                None => {
                    let sent = grid.sources(volume.arrived());
                    sent.for_each(|(i, sources)| lit.sources[i] = sources);
                }
            }
        }
        if let ([grid], [volume], [medium]) =
            (&grids[..], &exchange.volumes[..], &scene.volumes[..])
            && medium.phase.is_isotropic()
        {
            let blocks = grid.blocks();
            let lights = Lights::<SceneMedia>::new(tracer);
            let environment = lights.environment();
            lit.incident = incident::of_lvoxels(volume, blocks, tracer, environment, cancel)?;
            drop(exchange);
            incident::keep_means(source, &mut lit.incident)?;
        }
        lit.places = Some(sites.into_places());
        Ok(lit)
    }
}

/// The lvoxels of a tree, of the volumes of a scene, whose phase functions have these mean cosines.
fn lvoxels(tree: &Tree<MappedFile>, media: &[Volume], mean_cosines: &[f32]) -> Result<Vec<Member>> {
    let volumes = tree.meta().cloud.volumes.iter().enumerate();
    let volumes = volumes.map(|(volume, info)| {
        let mean_cosine = mean_cosines.get(volume).copied().unwrap_or(0.0);
        Member {
            volume,
            blocks: match mean_cosine {
                0.0 => Blocks::new(info),
                g => Blocks::new(info).spreading(g),
            },
            direct: Vec::new(),
            lobes: Vec::new(),
            mean_cosine,
        }
    });
    let mut members: Vec<Member> = volumes.collect();
    for i in 0..tree.lvoxel_pages() {
        for lvoxel in tree.lvoxel_page(i)? {
            let own = &mut members[usize::from(lvoxel.volume)];
            own.blocks.push(&lvoxel);
            own.direct
                .push(Light::from(lvoxel.source) / own.blocks.scale);
            if own.mean_cosine != 0.0 {
                own.lobes.push(mean_direction(lvoxel.lobe));
            }
        }
    }
    for (member, volume) in members.iter_mut().zip(media) {
        if volume.albedo_grid.is_some() {
            member.blocks.take_albedos(volume);
        }
    }
    Ok(members)
}

/// What a tree of all bounces says of its origin.
fn meta(source: &Tree<MappedFile>, settings: &Settings) -> TreeMeta {
    let mut meta = source.meta().clone();
    meta.settings.extend(settings.listed());
    meta.settings
        .push((TreeMeta::BOUNCED_FROM.into(), hex(&source.content_hash())));
    meta
}

/// Whether a tree has the light of this one, bounced with these settings.
///
/// # Errors
/// A file that is no whole tree.
pub fn has_made(output: &Path, tree: &OpenTree, settings: &Settings) -> Result<bool> {
    let found = Tree::open_path(output)?;
    Ok(*found.meta() == meta(tree.tree(), settings))
}

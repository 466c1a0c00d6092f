//! What a ray costs: triangles, cells of a volume, disks and nodes, blocks of medium, light; and
//! what a sweep of a medium and a path cost.

#[allow(dead_code)]
mod common;

use common::{DEMO, gather_rays, rays};
use divan::counter::ItemsCount;
use divan::{Bencher, black_box};
use lvox::image::Region;
use lvox::internals::gather::{Gatherer, Medium, NoMedia, PatchRadiance, RayKernel, RaySettings};
use lvox::internals::tree;
use lvox::internals::{
    Composite, Environment, Lights, SceneMedia, Scratch, ShadowRays, Surface, Tracer, plain,
    reference,
};
use lvox::run::Job;
use lvox::scene::Scene;
use lvox::shade;
use lvox::tree::OpenTree;
use lvox::{Ray, Rgb};
use std::path::Path;
use std::sync::LazyLock;

const RAYS: u64 = 4096;

static TRACER: LazyLock<Tracer<'static>> = LazyLock::new(|| Tracer::new(&DEMO.scene));
static STORE: LazyLock<OpenTree> = LazyLock::new(|| OpenTree::open(&DEMO.tree, None).unwrap());

fn main() {
    divan::main();
}

/// Nearest triangle.
#[divan::bench]
fn triangles(bencher: Bencher) {
    let (tracer, rays) = (&*TRACER, rays(RAYS));
    bencher.counter(ItemsCount::new(RAYS)).bench(|| {
        for &(origin, direction) in &rays {
            black_box(tracer.closest(&Ray::endless(origin, direction)));
        }
    });
}

/// Optical depth of the volume, cell by cell.
#[divan::bench]
fn cells(bencher: Bencher) {
    let (tracer, rays) = (&*TRACER, rays(RAYS));
    bencher.counter(ItemsCount::new(RAYS)).bench(|| {
        for &(origin, direction) in &rays {
            black_box(tracer.optical_depth::<f32>(&Ray::endless(origin, direction)));
        }
    });
}

/// Surfels seen by a gather ray, media left out.
#[divan::bench(args = ["traced 0.01 sr", "cone 0.01 sr", "cone 0 sr", "plain"])]
fn surfels(bencher: Bencher, kernel: &str) {
    let outgoing = PatchRadiance::new(&*TRACER, STORE.area_per_surfel(), RAYS as usize).unwrap();
    let (kernel, max_solid_angle) = match kernel {
        "traced 0.01 sr" => (RayKernel::Traced(&outgoing), 0.01),
        "plain" => (RayKernel::Plain, 0.0),
        "cone 0 sr" => (RayKernel::Cone, 0.0),
        _ => (RayKernel::Cone, 0.01),
    };
    let pages = tree::surfels(&STORE);
    let gatherer = Gatherer {
        pages,
        media: NoMedia,
        settings: RaySettings {
            samples: 1,
            max_solid_angle,
            max_dist: f32::INFINITY,
            kernel,
            environment: Environment::even(Rgb::BLACK),
            leave_out_bright: false,
        },
    };
    let rays = rays(RAYS);
    let mut scratch = Scratch::default();
    bencher.counter(ItemsCount::new(RAYS)).bench_local(|| {
        for &(origin, direction) in &rays {
            black_box(gatherer.incident(&Ray::endless(origin, direction), &mut scratch));
        }
    });
}

/// What front-to-back order is worth to the plain kernel: disks seen by the rays of gathers at
/// surfels, media left out. On the demo, or on the tree that the variable `LVOX_BENCH_TREE` names.
#[divan::bench(args = ["front to back", "as stored"])]
fn order(bencher: Bencher, order: &str) {
    let other = std::env::var_os("LVOX_BENCH_TREE")
        .map(|path| OpenTree::open(Path::new(&path), None).expect("LVOX_BENCH_TREE"));
    let store = other.as_ref().unwrap_or(&STORE);
    let pages = tree::surfels(store);
    let rays = gather_rays(store, RAYS);
    let mut scratch = Scratch::default();
    let bencher = bencher.counter(ItemsCount::new(RAYS));
    if order == "as stored" {
        bencher.bench_local(|| {
            for &(o, d) in &rays {
                black_box(plain::cast_in_order::<false>(
                    pages,
                    &Ray::endless(o, d),
                    &mut scratch,
                ));
            }
        });
    } else {
        bencher.bench_local(|| {
            for &(o, d) in &rays {
                black_box(plain::cast(pages, &Ray::endless(o, d), &mut scratch));
            }
        });
    }
}

/// Lvoxels passed by a gather ray.
#[divan::bench]
fn lvoxels(bencher: Bencher) {
    let media = tree::media(&STORE);
    let rays = rays(RAYS);
    bencher.counter(ItemsCount::new(RAYS)).bench(|| {
        for &(origin, direction) in &rays {
            let mut light = Composite::default();
            media.pass(&Ray::new(origin, direction, 2.0), 0.0, &[], &mut light);
            black_box(light);
        }
    });
}

/// Where rays in the room end, with the normals there on the side that they come from.
fn receivers(tracer: &Tracer) -> Vec<Surface> {
    rays(RAYS)
        .into_iter()
        .filter_map(|(origin, direction)| {
            let hit = tracer.closest(&Ray::endless(origin, direction))?;
            Some(Surface::new(tracer.scene, hit.triangle, hit.uv).facing(-direction))
        })
        .collect()
}

/// Direct light of surface points, one shadow ray each.
fn light(bencher: Bencher, tracer: &Tracer) {
    let lights = Lights::<SceneMedia>::new(tracer);
    let receivers = receivers(tracer);
    let count = ItemsCount::new(receivers.len());
    bencher.counter(count).bench(|| {
        for (seed, r) in (0..).zip(&receivers) {
            let rays = ShadowRays::Sequence {
                per_light: 1,
                first: 0,
                seed,
            };
            black_box(lights.irradiance(r.position, r.normal, r.face_normal, rays));
        }
    });
}

/// Shadow rays through triangles and smoke to the emitter.
#[divan::bench]
fn shadow_rays(bencher: Bencher) {
    light(bencher, &TRACER);
}

/// The tree over many lights: the ring glows, with as many emitters as it has triangles.
#[divan::bench]
fn light_tree(bencher: Bencher) {
    let mut scene = Scene::demo().unwrap();
    let ring = scene.materials.iter_mut().find(|m| m.name == "ring");
    ring.expect("the demo has a ring").emission = [2.0, 1.5, 1.0];
    light(bencher, &Tracer::new(&scene));
}

/// Pixels by their left column, top row and number along a side.
fn square(x0: u32, y0: u32, side: u32) -> Region {
    Region {
        x0,
        y0,
        x1: x0 + side,
        y1: y0 + side,
    }
}

/// The four pixels in the midst of the smoke, for which all of it is swept, on all threads; a
/// finite reach has no sweeps.
#[divan::bench(sample_count = 5, args = ["with sweeps", "without"])]
fn media(bencher: Bencher, sweeps: &str) {
    let settings = shade::Settings {
        max_dist: (sweeps == "without").then_some(1e9),
        ..shade::Settings::default()
    };
    let region = square(240, 200, 2);
    bencher.bench(|| {
        shade::run(&DEMO.scene, &STORE, &settings, region, &[], &Job::default()).unwrap()
    });
}

/// Paths of the Monte Carlo renderer of at most three segments, around the smoke, on all threads.
#[divan::bench(sample_count = 5)]
fn paths(bencher: Bencher) {
    let settings = reference::Settings {
        max_depth: 3,
        spp: Some(4),
        ..reference::Settings::default()
    };
    let region = square(196, 136, 64);
    let job = Job::default();
    bencher
        .counter(ItemsCount::new(4 * region.pixels()))
        .bench(|| {
            let mut sums = reference::begin(&DEMO.scene, &settings, region, &job).unwrap();
            let mut keep = |_: &reference::Sums| Ok(());
            reference::accumulate(&DEMO.scene, &settings, &mut sums, &job, &mut keep).unwrap();
            sums
        });
}

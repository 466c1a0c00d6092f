//! What a ray costs: triangles, cells of a volume, disks and nodes, blocks of medium.

#[allow(dead_code)]
mod common;

use common::{DEMO, gather_rays, rays};
use divan::counter::ItemsCount;
use divan::{Bencher, black_box};
use lvox::gather::cone::Scratch;
use lvox::gather::plain;
use lvox::gather::{
    Gatherer, Kernel, MediaStore, Medium, NoMedia, Settings, SurfelStore, TreeStore,
};
use lvox::math::Rgb;
use lvox::math::segment::Composite;
use lvox::trace::Tracer;
use std::path::Path;
use std::sync::LazyLock;

const RAYS: u64 = 4096;

static TRACER: LazyLock<Tracer<'static>> = LazyLock::new(|| Tracer::new(&DEMO.scene));
static STORE: LazyLock<TreeStore> = LazyLock::new(|| TreeStore::open(&DEMO.tree, None).unwrap());

fn main() {
    divan::main();
}

/// Nearest triangle.
#[divan::bench]
fn triangles(bencher: Bencher) {
    let (tracer, rays) = (&*TRACER, rays(RAYS));
    bencher.counter(ItemsCount::new(RAYS)).bench(|| {
        for &(origin, direction) in &rays {
            black_box(tracer.closest(origin, direction, f32::INFINITY));
        }
    });
}

/// Optical depth of the volume, cell by cell.
#[divan::bench]
fn cells(bencher: Bencher) {
    let (tracer, rays) = (&*TRACER, rays(RAYS));
    bencher.counter(ItemsCount::new(RAYS)).bench(|| {
        for &(origin, direction) in &rays {
            black_box(tracer.optical_depth(origin, direction, f32::INFINITY));
        }
    });
}

/// Surfels seen by a gather ray, media left out.
#[divan::bench(args = ["cone 0.01 sr", "cone 0 sr", "plain"])]
fn surfels(bencher: Bencher, kernel: &str) {
    let (kernel, max_solid_angle) = match kernel {
        "plain" => (Kernel::Plain, 0.0),
        "cone 0 sr" => (Kernel::Cone, 0.0),
        _ => (Kernel::Cone, 0.01),
    };
    let SurfelStore::Kept(pages) = &STORE.surfels else {
        unreachable!("no limit was given")
    };
    let gatherer = Gatherer {
        pages,
        media: NoMedia,
        settings: Settings {
            samples: 1,
            max_solid_angle,
            max_dist: f32::INFINITY,
            kernel,
            environment: Rgb::BLACK,
        },
    };
    let rays = rays(RAYS);
    let mut scratch = Scratch::default();
    bencher.counter(ItemsCount::new(RAYS)).bench_local(|| {
        for &(origin, direction) in &rays {
            black_box(gatherer.look(origin, direction, &mut scratch));
        }
    });
}

/// What front-to-back order is worth to the plain kernel: disks seen by the rays of gathers at surfels, media left out.
/// On the demo, or on the tree that the variable `LVOX_BENCH_TREE` names.
#[divan::bench(args = ["front to back", "as stored"])]
fn order(bencher: Bencher, order: &str) {
    let other = std::env::var_os("LVOX_BENCH_TREE")
        .map(|path| TreeStore::open(Path::new(&path), None).expect("LVOX_BENCH_TREE"));
    let store = other.as_ref().unwrap_or(&STORE);
    let SurfelStore::Kept(pages) = &store.surfels else {
        unreachable!("no limit was given")
    };
    let rays = gather_rays(store, RAYS);
    let mut scratch = Scratch::default();
    let bencher = bencher.counter(ItemsCount::new(RAYS));
    if order == "as stored" {
        bencher.bench_local(|| {
            for &(o, d) in &rays {
                black_box(plain::cast_in_order::<_, false>(
                    pages,
                    o,
                    d,
                    f32::INFINITY,
                    &mut scratch,
                ));
            }
        });
    } else {
        bencher.bench_local(|| {
            for &(o, d) in &rays {
                black_box(plain::cast(pages, o, d, f32::INFINITY, &mut scratch));
            }
        });
    }
}

/// Lvoxels passed by a gather ray.
#[divan::bench]
fn lvoxels(bencher: Bencher) {
    let MediaStore::Rgb(media) = &STORE.media else {
        unreachable!("the demo's lamp is not white")
    };
    let rays = rays(RAYS);
    bencher.counter(ItemsCount::new(RAYS)).bench(|| {
        for &(origin, direction) in &rays {
            let mut light = Composite::default();
            media.pass(origin, direction, 2.0, &[], &mut light);
            black_box(light);
        }
    });
}

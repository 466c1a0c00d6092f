//! Points and pixels a second of whole stages, on all threads.

#[allow(dead_code)]
mod common;

use common::{DEMO, SURFELS};
use divan::Bencher;
use divan::counter::ItemsCount;
use lvox::bake::{self, SurfelSampling};
use lvox::build;
use lvox::formats::Overwrite;
use lvox::image::Region;
use lvox::run::Job;
use lvox::shade;
use lvox::tree::OpenTree;

fn main() {
    divan::main();
}

/// Surfels with their direct light; the demo's lvoxels come on top.
#[divan::bench(sample_count = 10)]
fn bake_surfels(bencher: Bencher) {
    let out = DEMO.dir.join("bench.lvc");
    let settings = bake::Settings {
        surfels: SurfelSampling::Area { count: SURFELS },
        ..bake::Settings::default()
    };
    bencher.counter(ItemsCount::new(SURFELS)).bench(|| {
        bake::run(
            &DEMO.scene,
            &settings,
            &out,
            Overwrite::Replace,
            &Job::default(),
        )
        .unwrap();
    });
}

/// Tree over the demo's cloud.
#[divan::bench(sample_count = 10)]
fn build_surfels(bencher: Bencher) {
    let out = DEMO.dir.join("bench.lvt");
    let settings = build::Settings::default();
    bencher.counter(ItemsCount::new(SURFELS)).bench(|| {
        build::run(
            &DEMO.cloud,
            &out,
            &settings,
            Overwrite::Replace,
            &Job::default(),
        )
        .unwrap();
    });
}

/// Pixels around the smoke.
#[divan::bench(sample_count = 5)]
fn shade_pixels(bencher: Bencher) {
    let region = Region {
        x0: 180,
        y0: 120,
        x1: 276,
        y1: 216,
    };
    let settings = shade::Settings::default();
    let store = OpenTree::open(&DEMO.tree, None).unwrap();
    bencher.counter(ItemsCount::new(region.pixels())).bench(|| {
        shade::run(&DEMO.scene, &store, &settings, region, &[], &Job::default()).unwrap();
    });
}

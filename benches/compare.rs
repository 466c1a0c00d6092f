//! What a pixel costs each metric.

use divan::Bencher;
use divan::counter::ItemsCount;
use lvox::image::metrics::compare;
use lvox::image::{Picture, tone};
use lvox::internals::metric;

const SIDE: usize = 256;

fn main() {
    divan::main();
}

/// Waves, and the same with a little noise.
fn pictures() -> [Picture; 2] {
    [0.0, 0.02].map(|noise| Picture {
        width: SIDE,
        height: SIDE,
        pixels: (0..SIDE * SIDE)
            .map(|i| {
                let (x, y) = ((i % SIDE) as f32 / 20.0, (i / SIDE) as f32 / 30.0);
                let grain = noise * ((i * 7919 % 101) as f32 / 101.0);
                [
                    0.5 + 0.4 * x.sin() + grain,
                    0.5 + 0.4 * y.cos() + grain,
                    0.3 + grain,
                ]
            })
            .collect(),
    })
}

#[divan::bench]
fn relmse(bencher: Bencher) {
    let [a, b] = pictures();
    let pixels = ItemsCount::new(SIDE * SIDE);
    bencher.counter(pixels).bench(|| metric::linear(&a, &b));
}

#[divan::bench(sample_count = 20)]
fn flip_map(bencher: Bencher) {
    let [a, b] = pictures().map(|p| tone::map(&p, 1.0));
    let pixels = ItemsCount::new(SIDE * SIDE);
    bencher.counter(pixels).bench(|| metric::flip_map(&a, &b));
}

#[divan::bench(sample_count = 20)]
fn ssim_mean(bencher: Bencher) {
    let [a, b] = pictures().map(|p| tone::map(&p, 1.0));
    let pixels = ItemsCount::new(SIDE * SIDE);
    bencher.counter(pixels).bench(|| metric::ssim(&a, &b));
}

#[divan::bench(sample_count = 20)]
fn pdiff_fraction(bencher: Bencher) {
    let [a, b] = pictures().map(|p| tone::map(&p, 1.0));
    let pixels = ItemsCount::new(SIDE * SIDE);
    bencher.counter(pixels).bench(|| metric::pdiff(&a, &b));
}

#[divan::bench(sample_count = 20)]
fn all(bencher: Bencher) {
    let [a, b] = pictures();
    let pixels = ItemsCount::new(SIDE * SIDE);
    bencher.counter(pixels).bench(|| compare(&a, &b, 1.0));
}

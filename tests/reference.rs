//! The Monte Carlo reference against images of an independent renderer: they may differ by noise
//! alone.
//!
//! Only in release builds: unoptimised, the renders take half an hour.

mod support;

use lvox::image::{Region, exr};
use lvox::internals::reference::{self, Settings, Sums};
use lvox::run::Job;
use lvox::scene::Scene;
use std::path::Path;

/// Pixels along an edge of the blocks that are compared.
const BLOCK: usize = 16;

/// Standard deviation of what rounding to half floats does to a value, relative to it. On the
/// emitter, where all pixels are alike, they are all off by the same: it does not average out.
const HALF: f64 = 2.0e-4;

/// How two images of the same scene differ.
#[derive(Debug)]
struct Agreement {
    /// Mean over blocks and channels of the difference of means over its standard error.
    mean_z: f64,
    /// Root mean square of that; 1 if the images differ by noise alone.
    rms_z: f64,
    /// Largest size of that, and the corner of its block.
    worst: (f64, usize, usize),
    /// Energy of the image over that of the reference, less 1, by channel.
    energy: [f64; 3],
    /// Standard error of that.
    energy_sigma: f64,
    /// relMSE between the images over what the noise that each states of itself adds up to.
    noise: f64,
}

/// Compares an image with a reference that states its relMSE against the truth. How that noise is
/// spread over the image is not known (the number of samples differs between its parts), so the
/// standard error of a block's mean difference is that of the differences in it: if both images are
/// right, those are independent and of mean zero.
fn agreement(sums: &Sums, reference: &[[f32; 3]], reference_relmse: f64) -> Agreement {
    let (means, variances) = sums.estimates();
    let width = sums.region.width() as usize;
    let height = sums.region.height() as usize;
    let (mut sum, mut squares, mut n) = (0.0, 0.0, 0.0);
    let mut worst = (0.0_f64, 0, 0);
    let mut noise = 0.0;
    for y0 in (0..height).step_by(BLOCK) {
        for x0 in (0..width).step_by(BLOCK) {
            for c in 0..3 {
                let pairs: Vec<(f64, f64)> = (y0..(y0 + BLOCK).min(height))
                    .flat_map(|y| (x0..(x0 + BLOCK).min(width)).map(move |x| y * width + x))
                    .map(|i| (f64::from(means[i][c]), f64::from(reference[i][c])))
                    .collect();
                let count = pairs.len() as f64;
                let mean = pairs.iter().map(|(x, r)| x - r).sum::<f64>() / count;
                let spread: f64 = pairs.iter().map(|(x, r)| (x - r - mean).powi(2)).sum();
                let rounding = pairs.iter().map(|(_, r)| r * HALF).sum::<f64>() / count;
                let variance = spread / (count * (count - 1.0));
                noise += count * count * variance;
                // Where hardly a sample found light, differences are as lopsided as the light is
                // rare.
                let black = pairs.iter().filter(|(x, _)| *x == 0.0).count();
                if variance > 0.0 && 2 * black < pairs.len() {
                    let z = mean / (variance + rounding * rounding).sqrt();
                    sum += z;
                    squares += z * z;
                    n += 1.0;
                    if z.abs() > worst.0 {
                        worst = (z.abs(), x0, y0);
                    }
                }
            }
        }
    }
    let total = |image: &[[f32; 3]], c: usize| image.iter().map(|p| f64::from(p[c])).sum::<f64>();
    let energy: f64 = (0..3).map(|c| total(reference, c)).sum();
    let (mut between, mut own) = (0.0, 0.0);
    for (i, r) in reference.as_flattened().iter().enumerate() {
        let r = f64::from(*r);
        let weight = 1.0 / (r * r + 0.01) / (3 * means.len()) as f64;
        between += (f64::from(means.as_flattened()[i]) - r).powi(2) * weight;
        own += f64::from(variances.as_flattened()[i]) * weight;
    }
    Agreement {
        mean_z: sum / n,
        rms_z: (squares / n).sqrt(),
        worst,
        energy: [0, 1, 2].map(|c| total(&means, c) / total(reference, c) - 1.0),
        energy_sigma: noise.sqrt() / energy * 3.0_f64.sqrt(),
        noise: between / (reference_relmse + own),
    }
}

/// Renders a scene of `tests/acceptance` and compares it with `refs/IMAGE`; `None` without those.
fn compare(scene: &str, image: &str, max_depth: u32, spp: u32) -> Option<Agreement> {
    let refs = support::skip::shared("refs")?;
    let scenes = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/acceptance/scenes");
    let scene = Scene::load(&scenes.join(format!("{scene}.toml"))).unwrap();
    let text = std::fs::read_to_string(refs.join(format!("{image}.json"))).unwrap();
    let side_car: serde_json::Value = serde_json::from_str(&text).unwrap();
    let frame = exr::read(&refs.join(format!("{image}.exr"))).unwrap();
    let region = Region::full(frame.width, frame.height);
    let reference = frame.picture("", &region).unwrap().pixels;
    let job = Job::default();
    let spp = std::env::var("LVOX_SPP").map_or(spp, |n| n.parse().unwrap());
    let settings = Settings {
        max_depth,
        spp: Some(spp),
        ..Settings::default()
    };
    let started = std::time::Instant::now();
    let mut sums = reference::begin(&scene, &settings, region, &job).unwrap();
    reference::accumulate(&scene, &settings, &mut sums, &job, &mut |_| Ok(())).unwrap();
    let secs = started.elapsed().as_secs_f64();
    let known = side_car["est_relMSE_of_ref"].as_f64().unwrap();
    let found = agreement(&sums, &reference, known);
    let (worst, x, y) = found.worst;
    eprintln!(
        "{image}: {spp} spp, {secs:.1} s, {:.2} M samples/s, relMSE {:.2e} (theirs {known:.2e}), \
         z mean {:.4} rms {:.4} worst {worst:.2} at {x} {y}, energy {:.4?} +- {:.4}, \
         noise over the sum of both {:.4}",
        sums.samples() as f64 / secs * 1e-6,
        reference::relmse(&sums),
        found.mean_z,
        found.rms_z,
        found.energy,
        found.energy_sigma,
        found.noise,
    );
    Some(found)
}

macro_rules! agrees {
    ($name:ident, $scene:literal, $image:literal, $max_depth:literal, $spp:literal) => {
        #[test]
        #[cfg_attr(debug_assertions, ignore = "slow without optimisation")]
        fn $name() {
            let Some(found) = compare($scene, $image, $max_depth, $spp) else {
                return;
            };
            assert!(found.mean_z.abs() < 0.15, "{found:?}");
            assert!((0.85..1.15).contains(&found.rms_z), "{found:?}");
            assert!((0.95..1.05).contains(&found.noise), "{found:?}");
            assert!(found.energy.iter().all(|e| e.abs() < 3e-3), "{found:?}");
        }
    };
}

agrees!(a_d3, "A", "A_d3", 3, 16);
agrees!(a_full, "A", "A_full", 0, 8);
// Few paths find the spot of the ceiling above the emitter: it takes more of them until their mean
// is normal.
agrees!(a_pt_d3, "A_pt", "A_pt_d3", 3, 64);
agrees!(b_d3, "B", "B_d3", 3, 32);
agrees!(b_full, "B", "B_full", 0, 16);
agrees!(c_d3, "C", "C_d3", 3, 24);
agrees!(c_full, "C", "C_full", 0, 8);
agrees!(c_novol_d3, "C_novol", "C_novol_d3", 3, 32);
agrees!(a_hg_d3, "A_hg", "A_hg_d3", 3, 32);
agrees!(a_hg_full, "A_hg", "A_hg_full", 0, 16);
agrees!(k_d3, "K", "K_d3", 3, 64);

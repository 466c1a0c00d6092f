//! The error falls at known rates as lvoxels, surfels and solid angles shrink and samples rise, on
//! a scene of our own: a room with coloured walls, a point light in a corner and a lump of smoke,
//! small enough for seconds.

mod support;

use lvox::image::{Picture, Region, exr};
use lvox::internals::metric;
use lvox::internals::reference::Start;
use lvox::internals::study::{self, Method, Settings, Slope, Study, Sweep};
use lvox::run::Job;
use lvox::scene::Scene;
use lvox::shade::{self, Kernel};
use lvox::tree::OpenTree;
use std::fs;
use std::ops::Range;
use std::path::Path;
use support::trees;

const ROOM: &str = r#"
name = "convergence"
[film]
width = 24
height = 18
[[camera]]
position = [0.1, 1, 0.95]
target = [0.1, 0.95, 0]
fov_x_deg = 85
[[mesh]]
file = "builtin:cube"
scale = [2, 2, 2]
translate = [0, 1, 0]
albedo = [0.7, 0.7, 0.7]
[[mesh]]
file = "builtin:quad"
scale = 1.9
rotate_deg = [0, 0, -90]
translate = [-0.97, 1, 0]
albedo = [0.7, 0.05, 0.05]
[[mesh]]
file = "builtin:sphere"
scale = 0.5
translate = [-0.5, 0.3, 0.3]
albedo = [0.6, 0.6, 0.6]
[[light]]
type = "point"
position = [0.65, 1.6, -0.6]
intensity = [2, 2, 2]
[[volume]]
file = "smoke.raw"
dims = [32, 32, 32]
dtype = "f32"
endian = "little"
sigma_t_scale = 40
albedo = [0.95, 0.9, 0.8]
unitcube_to_world = [[0.9, 0, 0, -0.2], [0, 0.9, 0, 0.5], [0, 0, 0.9, -0.5], [0, 0, 0, 1]]
"#;

/// Puffs of several sizes, down to that of a few voxels.
fn smoke() -> Vec<u8> {
    let density = |p: [f32; 3]| {
        let r = p.map(|v| (v - 0.5) * (v - 0.5)).iter().sum::<f32>().sqrt();
        let waves = |k: f32| p.map(|v| (k * v + 0.4).sin()).iter().product::<f32>();
        ((1.0 - r / 0.48) * (1.0 + waves(9.0) + waves(25.0) + waves(60.0))).max(0.0)
    };
    let at = |i: usize| (i as f32 + 0.5) / 32.0;
    (0..32 * 32 * 32)
        .flat_map(|i| density([at(i % 32), at(i / 32 % 32), at(i / 1024)]).to_le_bytes())
        .collect()
}

/// All that a sweep does not vary is so fine that what it varies rules.
fn fine(kernel: Kernel) -> shade::Settings {
    shade::Settings {
        kernel,
        samples: 1024,
        max_solid_angle: 0.0025,
        volume_samples: 64,
        lattice: 1,
        pixel_samples: 64,
        edge_samples: 64,
        shadow_rays: 8,
        ..shade::Settings::default()
    }
}

fn settings(kernel: Kernel) -> Settings {
    Settings {
        spp: vec![1],
        surfels: vec![80_000],
        block_depth: vec![0.1],
        block_voxels: Vec::new(),
        samples: Vec::new(),
        max_solid_angle: Vec::new(),
        shade: fine(kernel),
        rounds: 1,
        reference_spp: 4096,
        ..Settings::default()
    }
}

/// Sweeps of what presets use, and of what only rays that end at surfels and nodes depend on: those
/// that end at triangles leave so little to surfels that there is no slope to hold.
fn measured(scene: &Scene, dir: &Path) -> [Study; 2] {
    let study = |name: &str, settings: Settings| {
        study::run(
            scene,
            &settings,
            &dir.join(name),
            Start::Resume,
            &Job::default(),
        )
        .unwrap()
    };
    let traced = Settings {
        spp: vec![1, 4, 16, 64],
        block_depth: vec![0.1, 6.4],
        block_voxels: vec![8, 4, 2, 1],
        ..settings(Kernel::Traced)
    };
    let cone = Settings {
        surfels: vec![600, 2400, 9600, 80_000],
        max_solid_angle: vec![0.015625, 0.0625, 0.25, 1.0],
        reference: Some(dir.join("traced/reference.exr")),
        ..settings(Kernel::Cone)
    };
    [study("traced", traced), study("cone", cone)]
}

/// Frames of a tree beside a study's reference.
struct Frames<'a> {
    scene: &'a Scene,
    store: OpenTree,
    reference: Picture,
}

impl<'a> Frames<'a> {
    fn new(scene: &'a Scene, dir: &Path) -> Self {
        let tree = trees::baked(scene, &trees::of_surfels(80_000), dir, "own");
        let reference = exr::read(&dir.join("traced/reference.exr")).unwrap();
        Self {
            scene,
            store: OpenTree::open(&tree, None).unwrap(),
            reference: reference.picture("", &Self::region(scene)).unwrap(),
        }
    }

    fn region(scene: &Scene) -> Region {
        Region::full(scene.film.width, scene.film.height)
    }

    fn relmse(&self, settings: &shade::Settings) -> f64 {
        let (scene, region) = (self.scene, Self::region(self.scene));
        let frame = shade::run(scene, &self.store, settings, region, &[], &Job::default()).unwrap();
        metric::linear(&frame.picture("", &region).unwrap(), &self.reference).relmse
    }

    /// Samples of a pixel of its own, and relMSE. Edges take no more of them than the rest.
    fn by_pixel_samples(&self) -> Vec<(f64, f64)> {
        let relmse = |pixel_samples| {
            let relmse = self.relmse(&shade::Settings {
                pixel_samples,
                edge_samples: 1,
                shadow_rays: 1,
                ..fine(Kernel::Traced)
            });
            (f64::from(pixel_samples), relmse)
        };
        [2, 4, 8, 16].map(relmse).into()
    }

    /// Rays of a gather, and relMSE: the mean over seeds, of which one has twice the error of
    /// another.
    fn by_samples(&self) -> Vec<(f64, f64)> {
        const SEEDS: u64 = 8;
        let of_seed = |samples, seed| {
            self.relmse(&shade::Settings {
                samples,
                seed,
                ..fine(Kernel::Traced)
            })
        };
        let mean = |samples| {
            let sum: f64 = (0..SEEDS).map(|seed| of_seed(samples, seed)).sum();
            (f64::from(samples), sum / SEEDS as f64)
        };
        [1, 4, 16, 64].map(mean).into()
    }
}

/// Exponent of errors over settings, by least squares on logarithms.
fn power(points: &[(f64, f64)]) -> f64 {
    let logs: Vec<(f64, f64)> = points.iter().map(|(x, y)| (x.ln(), y.ln())).collect();
    let n = logs.len() as f64;
    let x = logs.iter().map(|p| p.0).sum::<f64>() / n;
    let y = logs.iter().map(|p| p.1).sum::<f64>() / n;
    let above: f64 = logs.iter().map(|p| (p.0 - x) * (p.1 - y)).sum();
    above / logs.iter().map(|p| (p.0 - x).powi(2)).sum::<f64>()
}

#[test]
fn errors_fall_at_their_rates() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    fs::write(dir.join("room.toml"), ROOM).unwrap();
    fs::write(dir.join("smoke.raw"), smoke()).unwrap();
    let scene = Scene::load(&dir.join("room.toml")).unwrap();
    let studies = measured(&scene, dir);
    let noise = studies[0].reference.relmse.unwrap();
    eprintln!("noise of the reference: relMSE {noise:.2e}");
    let slopes = || studies.iter().flat_map(|s| &s.findings.slopes);
    for s in slopes() {
        eprintln!(
            "{:12} {:16} power {:6.2}, of the coarsest two {:6.2}; relMSE {:.2e} at {} to {:.2e} \
             at {}, least {:.2e}",
            s.method,
            s.setting,
            s.exponent,
            s.coarse_exponent,
            s.coarsest[1],
            s.coarsest[0],
            s.finest[1],
            s.finest[0],
            s.floor
        );
    }
    let slope = |method: Method, setting: Sweep| -> &Slope {
        let is = |s: &&Slope| s.method == method && s.setting == setting;
        slopes().find(is).unwrap()
    };
    let within = |value: f64, range: Range<f64>, what: &str| {
        assert!(
            range.contains(&value),
            "{what}: {value} is not in {range:?}"
        );
    };
    // Variance goes as one over the samples, with Sobol points a little faster.
    within(
        slope(Method::MonteCarlo, Sweep::Spp).exponent,
        -1.24..-0.94,
        "spp",
    );
    // Powers of the whole sweeps, which end on a common floor, and of the coarsest two values, 0.15
    // around what is measured. What surfels and nodes get wrong lies along edges of light, so the
    // squared error falls as the width of those edges and not as its square.
    for (setting, whole, coarse) in [
        (Sweep::SurfelRadius, 0.8..1.1, 1.01..1.31),
        (Sweep::MaxSolidAngle, 0.04..0.27, 0.29..0.59),
        // Optical depths of blocks rule nothing here: no error falls with them.
        (Sweep::BlockDepth, -0.22..0.08, -0.22..0.08),
        (Sweep::BlockVoxels, 0.41..0.71, 1.38..1.68),
    ] {
        let slope = slope(Method::Extended, setting);
        within(slope.exponent, whole, &setting.to_string());
        within(slope.coarse_exponent, coarse, &setting.to_string());
        // All sweeps end at the same small error, which is more than what the reference has itself.
        within(slope.finest[1], noise..7e-4, &setting.to_string());
        assert!(slope.floor < 7e-4, "{setting}: {}", slope.floor);
    }
    let frames = Frames::new(&scene, dir);
    let own = frames.by_pixel_samples();
    eprintln!("pixel-samples {own:?}");
    within(power(&own), -1.17..-0.87, "pixel-samples");
    let samples = frames.by_samples();
    eprintln!("samples {samples:?}");
    within(power(&samples), -1.2..-0.9, "samples");
    within(power(&samples[..2]), -1.12..-0.82, "samples");
    // Surfels alone do not get there, however fine.
    for slope in slopes().filter(|s| s.method == Method::Traditional) {
        assert!(slope.floor > 1e-2, "{slope:?}");
    }
}

//! The demo scene, baked small once and shared by all benchmarks of a process.

use glam::Vec3;
use lvox::bake::{self, SurfelSampling};
use lvox::build;
use lvox::math::sampling::{hash, sphere, unit2};
use lvox::run::Job;
use lvox::scene::Scene;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

/// Surfels of the baked demo.
pub const SURFELS: u64 = 100_000;

/// The demo scene with its cloud and tree.
pub struct Demo {
    /// The scene.
    pub scene: Scene,
    /// Its cloud.
    pub cloud: PathBuf,
    /// Its tree.
    pub tree: PathBuf,
    /// The folder of both, below `target`: nothing is left elsewhere.
    pub dir: PathBuf,
}

/// Baked when first asked for.
pub static DEMO: LazyLock<Demo> = LazyLock::new(|| {
    let scene = Scene::demo().unwrap();
    let dir = Path::new(env!("CARGO_TARGET_TMPDIR")).join(env!("CARGO_CRATE_NAME"));
    std::fs::create_dir_all(&dir).unwrap();
    let (cloud, tree) = (dir.join("demo.lvc"), dir.join("demo.lvt"));
    let settings = bake::Settings {
        surfels: SurfelSampling::Area { count: SURFELS },
        ..bake::Settings::default()
    };
    let job = Job::default();
    bake::run(&scene, &settings, &cloud, true, &job).unwrap();
    build::run(&cloud, &tree, &build::Settings::default(), true, &job).unwrap();
    Demo {
        scene,
        cloud,
        tree,
        dir,
    }
});

/// Points of the demo's room and unit directions, the same every time.
pub fn rays(count: u64) -> Vec<(Vec3, Vec3)> {
    (0..count)
        .map(|i| {
            let [a, b] = unit2(hash(&[i, 0]));
            let [c, d] = unit2(hash(&[i, 1]));
            let [e, f] = unit2(hash(&[i, 2]));
            let point = Vec3::new(2.5 * a - 1.25, 0.05 + 1.9 * b, 1.9 * c - 0.95);
            (point, sphere([(d + f).fract(), e]))
        })
        .collect()
}

//! The whole way from a scene to an image, on scenes that the tests make themselves.

mod albedos;
mod animation;
mod before_work;
mod bounce;
mod bright;
mod bytes;
mod clouds;
mod colored_media;
mod contact;
mod counts;
mod damage;
mod described;
#[cfg(unix)]
mod farm;
mod fire;
mod fog;
mod frames;
mod gather;
mod grain;
mod groups;
mod hostile_trees;
mod instances;
mod leaks;
mod left_out;
mod lens;
mod limits;
mod masks;
#[cfg(target_os = "linux")]
mod memory;
mod messages;
mod outputs;
mod packed;
mod physics;
mod pictures;
mod plans;
mod points;
mod scatter;
mod screens;
mod settings;
mod shadows;
mod sky;
#[path = "../support/mod.rs"]
mod support;
mod textures;
mod tiles;
mod unseen;
mod views;

use lvox::image::{Frame, Region};
use lvox::internals::reference;
use lvox::run::Job;
use lvox::scene::Scene;
use lvox::shade::{self, Aov, Settings};
use lvox::tree::OpenTree;
use std::fs;
use std::path::{Path, PathBuf};
use support::trees;
use tempfile::TempDir;

/// A room with a red wall, a block, an emitter and a cube of uneven smoke; needs `smoke.raw`.
const ROOM: &str = r#"
name = "room"

[film]
width = 64
height = 48

[[camera]]
name = "front"
position = [0, 1, 3.9]
target = [0, 1, 0]
fov_x_deg = 40

[[camera]]
name = "corner"
position = [0.8, 1.6, 0.8]
target = [-0.4, 0.6, -0.6]
fov_x_deg = 60

[[camera]]
name = "below"
position = [-0.8, 0.2, 0.7]
target = [0.3, 1.2, -0.5]
fov_x_deg = 55

[[camera]]
name = "away"
position = [0, 1, 3.9]
target = [0, 1, 9]

[[mesh]]
file = "builtin:quad"
scale = 2
albedo = [0.7, 0.7, 0.7]

[[mesh]]
file = "builtin:quad"
scale = 2
rotate_deg = [180, 0, 0]
translate = [0, 2, 0]
albedo = [0.7, 0.7, 0.7]

[[mesh]]
file = "builtin:quad"
scale = 2
rotate_deg = [90, 0, 0]
translate = [0, 1, -1]
albedo = [0.7, 0.7, 0.7]

[[mesh]]
file = "builtin:quad"
scale = 2
rotate_deg = [0, 0, -90]
translate = [-1, 1, 0]
albedo = [0.6, 0.05, 0.05]

[[mesh]]
file = "builtin:cube"
scale = [0.5, 0.8, 0.5]
rotate_deg = [0, 20, 0]
translate = [0.4, 0.4, -0.3]
albedo = [0.6, 0.6, 0.6]

[[mesh]]
file = "builtin:quad"
scale = 0.5
rotate_deg = [180, 0, 0]
translate = [0, 1.98, 0]
albedo = [0, 0, 0]
emission = [10, 9, 7]

[[volume]]
file = "smoke.raw"
dims = [16, 16, 16]
dtype = "u8"
sigma_t_scale = 6
value_scale = 0.00392156862745098
albedo = [0.8, 0.8, 0.8]
unitcube_to_world = [[0.9, 0, 0, -0.9], [0, 0.9, 0, 0.3], [0, 0, 0.9, -0.2], [0, 0, 0, 1]]
"#;

/// Voxels of `smoke.raw`: a ball, denser in the middle.
fn smoke() -> Vec<u8> {
    let mut voxels = Vec::with_capacity(16 * 16 * 16);
    for i in 0..16 * 16 * 16 {
        let at = [i % 16, i / 16 % 16, i / 256].map(|c| (c as f32 - 7.5) / 8.0);
        let r2: f32 = at.iter().map(|c| c * c).sum();
        voxels.push((255.0 * (1.0 - r2).max(0.0)) as u8);
    }
    voxels
}

/// A folder with a scene file that goes away with the test.
struct Work(TempDir);

impl Work {
    fn new(scene: &str) -> Self {
        let dir = tempfile::tempdir().unwrap();
        fs::write(dir.path().join("scene.toml"), scene).unwrap();
        fs::write(dir.path().join("smoke.raw"), smoke()).unwrap();
        Self(dir)
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn scene(&self) -> Scene {
        Scene::load(&self.path("scene.toml")).unwrap()
    }

    /// Bakes and builds `scene.lvt` with so many surfels.
    fn bake(&self, scene: &Scene, surfels: u64) -> PathBuf {
        trees::baked(scene, &trees::of_surfels(surfels), self.0.path(), "scene")
    }

    /// Names in the folder, sorted.
    fn names(&self) -> Vec<String> {
        support::names(self.0.path())
    }
}

/// The scene that the program carries, with its tree of so many surfels, which goes away with the
/// folder.
fn demo(surfels: u64) -> (TempDir, Scene, OpenTree) {
    let dir = tempfile::tempdir().unwrap();
    let scene = Scene::demo().unwrap();
    let tree = trees::baked(&scene, &trees::of_surfels(surfels), dir.path(), "demo");
    let store = OpenTree::open(&tree, None).unwrap();
    (dir, scene, store)
}

/// The frame of a tree on disk.
fn shade(scene: &Scene, tree: &Path, settings: &Settings) -> Frame {
    let store = OpenTree::open(tree, None).unwrap();
    let region = Region::full(scene.film.width, scene.film.height);
    let aovs = Aov::ALL.map(|(_, aov)| aov);
    shade::run(scene, &store, settings, region, &aovs, &Job::default()).unwrap()
}

/// From the text of a scene to its frame.
fn render(text: &str, surfels: u64, settings: &Settings) -> Frame {
    let work = Work::new(text);
    let scene = work.scene();
    let tree = work.bake(&scene, surfels);
    shade(&scene, &tree, settings)
}

/// A layer's pixels.
fn layer(frame: &Frame, name: &str) -> Vec<[f32; 3]> {
    frame.picture(name, &frame.region).unwrap().pixels
}

/// The picture.
fn beauty(frame: &Frame) -> Vec<[f32; 3]> {
    layer(frame, "")
}

/// What the path tracer makes of a scene with paths of so many segments at most, 0 for any.
fn traced(scene: &Scene, max_depth: u32, spp: u32) -> Vec<[f32; 3]> {
    let settings = reference::Settings {
        max_depth,
        spp: Some(spp),
        ..reference::Settings::default()
    };
    let region = Region::full(scene.film.width, scene.film.height);
    let job = Job::default();
    let mut sums = reference::begin(scene, &settings, region, &job).unwrap();
    reference::accumulate(scene, &settings, &mut sums, &job, &mut |_| Ok(())).unwrap();
    beauty(&reference::frame(scene, &sums))
}

/// Mean over all pixels and channels.
fn mean(pixels: &[[f32; 3]]) -> f64 {
    let sum: f64 = pixels.iter().flatten().map(|&v| f64::from(v)).sum();
    sum / (3 * pixels.len()) as f64
}

/// Root of the mean squared difference over the mean of the second.
fn relative_rms(a: &[[f32; 3]], b: &[[f32; 3]]) -> f64 {
    assert_eq!(a.len(), b.len());
    let pairs = a.iter().flatten().zip(b.iter().flatten());
    let sum: f64 = pairs.map(|(a, b)| f64::from(a - b).powi(2)).sum();
    (sum / (3 * a.len()) as f64).sqrt() / mean(b)
}

/// Runs with so many threads.
fn with_threads<T: Send>(threads: usize, run: impl FnOnce() -> T + Send) -> T {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
    pool.build().unwrap().install(run)
}

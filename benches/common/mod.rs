//! The demo scene, baked small once and shared by all benchmarks of a process.

use glam::Vec3;
use lvox::internals::{cosine_hemisphere, hash, sphere, tangents, unit2};
use lvox::scene::Scene;
use lvox::tree::OpenTree;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

// Trees of tests and benchmarks are made alike.
#[path = "../../tests/support/trees.rs"]
pub mod trees;

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
    let tree = trees::baked(&scene, &trees::of_surfels(SURFELS), &dir, "demo");
    Demo {
        scene,
        cloud: tree.with_extension("lvc"),
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

/// Rays of gathers at surfels all over a tree: cosine-distributed about the normals, the same every
/// time.
pub fn gather_rays(store: &OpenTree, count: u64) -> Vec<(Vec3, Vec3)> {
    let tree = store.tree();
    let pages = tree.surfel_pages() as u64;
    (0..count)
        .filter_map(|i| {
            let page = tree.surfel_page((hash(&[i, 3]) % pages) as usize).unwrap();
            let n = page.surfels.len() as u64;
            let surfel = page.surfels.get((hash(&[i, 4]) % n.max(1)) as usize)?;
            let (position, normal) = (Vec3::from(surfel.position), Vec3::from(surfel.normal));
            let (x, y) = tangents(normal);
            let d = cosine_hemisphere(unit2(hash(&[i, 5])));
            let direction = (x * d.x + y * d.y + normal * d.z).normalize();
            Some((position + 1e-3 * surfel.radius * normal, direction))
        })
        .collect()
}

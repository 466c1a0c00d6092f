//! Gathers light at the surfels of a tree that say where surfaces are, from the tree alone, as a
//! light map or another renderer would: `cargo run --release --example gather_at_points TREE`.

#![allow(clippy::print_stdout)] // What it prints is the point.

use glam::Vec3;
use lvox::gather::{PointGatherer, Settings};
use lvox::tree::OpenTree;
use std::path::PathBuf;

/// Points at which light is gathered.
const POINTS: usize = 8;

fn main() -> lvox::Result<()> {
    let path = std::env::args().nth(1).map(PathBuf::from);
    let path = path.ok_or_else(|| lvox::Error::input("name a tree (.lvt)"))?;
    // Pages are decoded when a ray first needs them, and kept within this many bytes.
    let tree = OpenTree::open(&path, Some(1 << 30))?;
    let settings = Settings {
        samples: 256,
        max_solid_angle: 0.02,
        ..Settings::default()
    };
    let gatherer = PointGatherer::new(&tree, settings);
    println!("{:>30} {:>30}", "world position", "irradiance");
    let pages = tree.tree().surfel_pages();
    for page in (0..pages).step_by(pages.div_ceil(POINTS).max(1)) {
        let surfels = tree.tree().surfel_page(page)?.surfels;
        let Some(surfel) = surfels.first() else {
            continue;
        };
        let (position, normal) = (Vec3::from(surfel.position), Vec3::from(surfel.normal));
        // A little off the surface, which would hide everything else from its own points.
        let point = position + 1e-3 * surfel.radius * normal;
        let gathered = gatherer.irradiance(point, normal, 0)?;
        let [r, g, b] = gathered.light.0;
        let world = point.as_dvec3() + tree.world_from_scene();
        println!(
            "{:>9.3} {:>9.3} {:>9.3}   {r:>8.4} {g:>8.4} {b:>8.4}",
            world.x, world.y, world.z
        );
    }
    let stats = tree.stats();
    println!("{} pages were decoded of {pages}", stats.decoded);
    Ok(())
}

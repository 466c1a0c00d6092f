//! Gather rays per second and core into trees of Sponza, beside closest hits of the same rays on
//! its triangles, by the traversal of lvox and by those of `obvhs`. Skipped where `../shared` is
//! not there.
//!
//! Receivers are surface points that the camera sees, on a lattice of the frame; rays are those of
//! a gather, in its order, and, "in squares", those of 4 x 4 neighbours in the order of their
//! directions, as frames take them. One thread; CPU seconds, so that other work on the machine
//! counts as little as it can. The best of the passes.

#![allow(clippy::print_stdout)] // The table is the product.

#[path = "../tests/support/trees.rs"]
mod trees;

use glam::{Vec3, Vec3A};
use lvox::internals::gather::{
    Gatherer, NoMedia, PatchRadiance, RayKernel, RaySettings, SurfacePoint,
};
use lvox::internals::tree::{self, SurfelStore};
use lvox::internals::{
    Environment, Scratch, Surface, Tracer, cosine_hemisphere, hash, mix, offset, sobol2, tangents,
    usage,
};
use lvox::scene::Scene;
use lvox::shade::{self, Quality};
use lvox::tree::OpenTree;
use lvox::{Ray, Rgb};
use obvhs::BvhBuildParams;
use obvhs::bvh2::builder::build_bvh2_from_tris;
use obvhs::cwbvh::builder::build_cwbvh_from_tris;
use obvhs::ray::RayHit;
use obvhs::triangle::Triangle;
use std::collections::BTreeMap;
use std::hint::black_box;
use std::path::Path;

/// Rays of each gather.
const SAMPLES: u32 = 64;

/// How much to measure.
struct Size {
    surfels: &'static [u64],
    /// Pixels between receivers.
    step: u32,
    passes: u32,
}

const WHOLE: Size = Size {
    surfels: &[200_000, 1_000_000, 2_500_000],
    step: 8,
    passes: 5,
};

/// With `--test`: enough to see that it runs.
const TRIAL: Size = Size {
    surfels: &[20_000],
    step: 64,
    passes: 1,
};

struct Receiver {
    /// Column and row of the lattice.
    at: [u32; 2],
    origin: Vec3,
    normal: Vec3,
    face_normal: Vec3,
    seed: u64,
}

/// Receivers along an edge of a square that gathers together.
const SIDE: u32 = 4;

// Long because it is the table: one row after another.
fn main() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    if !root.join("../shared/refs").exists() {
        println!("SKIPPED: benches/rays.rs: needs ../shared/refs");
        return;
    }
    let path = root.join("tests/acceptance/scenes/C_novol.toml");
    let scene = Scene::load(&path).unwrap_or_else(|e| panic!("{e}"));
    let size = match std::env::args().any(|a| a == "--test") {
        true => TRIAL,
        false => WHOLE,
    };
    let tracer = Tracer::new(&scene);
    let receivers = receivers(&scene, &tracer, size.step);
    let rays: Vec<(Vec3, Vec3)> = receivers
        .iter()
        .flat_map(|r| {
            let (x, y) = tangents(r.normal);
            let seed = mix(r.seed) as u32;
            (0..SAMPLES).map(move |i| {
                let d = cosine_hemisphere(sobol2(i, 0, seed));
                (r.origin, (x * d.x + y * d.y + r.normal * d.z).normalize())
            })
        })
        .collect();
    let squares = squares(&receivers);
    println!(
        "{} receivers x {SAMPLES} rays, one thread\n{:<40} {:>9} {:>12} {:>10}",
        receivers.len(),
        "",
        "surfels",
        "M rays/CPU s",
        "us/gather"
    );
    let triangles = best(size.passes, || {
        for &(origin, direction) in &rays {
            black_box(tracer.closest(&Ray::endless(origin, direction)));
        }
    });
    let print = |name: &str, surfels: &str, secs: f64| {
        println!(
            "{name:<40} {surfels:>9} {:>12.3} {:>10.2}",
            rays.len() as f64 / secs * 1e-6,
            secs / receivers.len() as f64 * 1e6
        );
    };
    print("closest hit, triangles", "", triangles);
    let [two, eight] = obvhs(&scene, &rays, size.passes);
    print("closest hit, obvhs, 2 wide", "", two);
    print("closest hit, obvhs, 8 wide", "", eight);
    let folder = tempfile::tempdir().unwrap();
    for &surfels in size.surfels {
        let store = store(&scene, surfels, folder.path());
        let pages = tree::surfels(&store);
        // As in a frame, whose gathers stand half as far apart. Each row has a table of its own, as
        // the rays of a frame have.
        for (name, quality) in Quality::ALL {
            let settings = shade::Settings::of(quality);
            let max_solid_angle = settings.max_solid_angle;
            let name = format!("traced, {max_solid_angle} sr ({name})");
            let outgoing = || {
                PatchRadiance::new(&tracer, store.area_per_surfel(), 4 * rays.len())
                    .unwrap()
                    .in_patches_of(settings.patch_surfels as f32)
            };
            let known = outgoing();
            let alone = gatherer(pages, RayKernel::Traced(&known), max_solid_angle);
            let secs = one_by_one(&alone, &rays, size.passes);
            print(&name, &surfels.to_string(), secs);
            let known = outgoing();
            let gatherer = gatherer(pages, RayKernel::Traced(&known), max_solid_angle);
            let order = gatherer.order(SIDE * SIDE);
            let secs = best(size.passes, || {
                for (key, square) in squares.iter().enumerate() {
                    black_box(gatherer.irradiance_at_neighbours(square, key as u64, &order));
                }
            });
            print(&format!("{name}, in squares"), &surfels.to_string(), secs);
        }
        for (name, kernel, max_solid_angle) in [
            ("cone, 0.02 sr", RayKernel::Cone, 0.02),
            ("cone, 0.01 sr", RayKernel::Cone, 0.01),
            ("cone, surfels only", RayKernel::Cone, 0.0),
            ("plain", RayKernel::Plain, 0.0),
        ] {
            let gatherer = gatherer(pages, kernel, max_solid_angle);
            let secs = one_by_one(&gatherer, &rays, size.passes);
            print(name, &surfels.to_string(), secs);
        }
    }
}

/// CPU seconds of rays that are cast one after the other.
fn one_by_one(gatherer: &Gatherer<NoMedia>, rays: &[(Vec3, Vec3)], passes: u32) -> f64 {
    let mut scratch = Scratch::default();
    best(passes, || {
        for &(origin, direction) in rays {
            black_box(gatherer.incident(&Ray::endless(origin, direction), &mut scratch));
        }
    })
}

/// CPU seconds of closest hits by the traversals of `obvhs`: over its hierarchy of two children a
/// node, and over that of eight (CWBVH), both with the triangles in the order of their leaves.
fn obvhs(scene: &Scene, rays: &[(Vec3, Vec3)], passes: u32) -> [f64; 2] {
    let triangles: Vec<Triangle> = (0..scene.mesh.triangles.len())
        .map(|i| {
            let [v0, v1, v2] = scene.mesh.corners(i).map(Vec3A::from);
            Triangle { v0, v1, v2 }
        })
        .collect();
    let ordered = |indices: &[u32]| -> Vec<Triangle> {
        indices.iter().map(|&i| triangles[i as usize]).collect()
    };
    let rays: Vec<obvhs::ray::Ray> = rays
        .iter()
        // They miss boxes along directions with a negative zero.
        .map(|&(origin, direction)| {
            obvhs::ray::Ray::new_inf(origin.into(), (direction + Vec3::ZERO).into())
        })
        .collect();
    let build = BvhBuildParams::medium_build;
    let two = build_bvh2_from_tris(&triangles, build(), &mut Default::default());
    let eight = build_cwbvh_from_tris(&triangles, build(), &mut Default::default());
    let (of_two, of_eight) = (
        ordered(&two.primitive_indices),
        ordered(&eight.primitive_indices),
    );
    [
        best(passes, || {
            for &ray in &rays {
                let mut hit = RayHit::none();
                two.ray_traverse(ray, &mut hit, |ray, i| of_two[i].intersect(ray));
                black_box(hit);
            }
        }),
        best(passes, || {
            for &ray in &rays {
                let mut hit = RayHit::none();
                eight.ray_traverse(ray, &mut hit, |ray, i| of_eight[i].intersect(ray));
                black_box(hit);
            }
        }),
    ]
}

/// Least CPU seconds of several runs.
fn best(passes: u32, mut run: impl FnMut()) -> f64 {
    (0..passes)
        .map(|_| {
            let before = usage::cpu_secs();
            run();
            usage::cpu_secs() - before
        })
        .fold(f64::INFINITY, f64::min)
}

/// What the scene's first camera sees at every `step`-th pixel.
fn receivers(scene: &Scene, tracer: &Tracer, step: u32) -> Vec<Receiver> {
    let camera = scene.camera(None).unwrap();
    let pixels = (0..scene.film.height).step_by(step as usize).flat_map(|y| {
        (0..scene.film.width)
            .step_by(step as usize)
            .map(move |x| (x, y))
    });
    pixels
        .filter_map(|(x, y)| {
            let direction = camera.direction(&scene.film, x as f32 + 0.5, y as f32 + 0.5);
            let hit = tracer.closest(&Ray::endless(camera.origin(), direction))?;
            let surface = Surface::new(scene, hit.triangle, hit.uv).facing(-direction);
            Some(Receiver {
                at: [x / step, y / step],
                origin: surface.position + surface.face_normal * offset(surface.position),
                normal: surface.normal,
                face_normal: surface.face_normal,
                seed: hash(&[0, u64::from(x), u64::from(y)]),
            })
        })
        .collect()
}

/// Receivers by the squares of the lattice that they are in.
fn squares(receivers: &[Receiver]) -> Vec<Vec<SurfacePoint>> {
    let mut squares = BTreeMap::<[u32; 2], Vec<SurfacePoint>>::new();
    for r in receivers {
        let [x, y] = r.at.map(|c| c % SIDE);
        let square = r.at.map(|c| c / SIDE);
        squares.entry(square).or_default().push(SurfacePoint {
            position: r.origin,
            normal: r.normal,
            face_normal: r.face_normal,
            range: y * SIDE + x,
        });
    }
    squares.into_values().collect()
}

/// A tree of so many surfels.
fn store(scene: &Scene, surfels: u64, folder: &Path) -> OpenTree {
    let tree = trees::baked(scene, &trees::of_surfels(surfels), folder, "c");
    OpenTree::open(&tree, None).unwrap()
}

fn gatherer<'a>(
    pages: &'a SurfelStore,
    kernel: RayKernel<'a>,
    max_solid_angle: f32,
) -> Gatherer<'a, NoMedia> {
    Gatherer {
        pages,
        media: NoMedia,
        settings: RaySettings {
            samples: SAMPLES,
            max_solid_angle,
            max_dist: f32::INFINITY,
            kernel,
            environment: Environment::even(Rgb::BLACK),
            leave_out_bright: false,
        },
    }
}

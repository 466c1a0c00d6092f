//! Light at points of other programs: closed forms, the pixels of a frame, and the same bytes
//! however the work is cut up.

mod refused;
mod surfels;

use crate::support::program::lvox;
use crate::support::random::Random;
use crate::{ROOM, Work, mean};
use glam::{DVec3, Vec3};
use lvox::build;
use lvox::formats::{CloudMeta, CloudWriter, Overwrite, Surfel};
use lvox::internals::{Surface, Tracer};
use lvox::pack::{self, Files};
use lvox::points::{self, Over, PointFile, Settings};
use lvox::run::Job;
use lvox::scene::Scene;
use lvox::shade;
use lvox::tree::OpenTree;
use lvox::{Ray, Rgb};
use std::f32::consts::PI;
use std::fs;
use std::path::Path;

/// Points as `.npy`: position, and normal unless it is `None`.
fn npy(points: &[(DVec3, Option<Vec3>)]) -> Vec<u8> {
    let columns = match points {
        [(_, None), ..] => 3,
        _ => 6,
    };
    let mut text = format!(
        "{{'descr': '<f8', 'fortran_order': False, 'shape': ({}, {columns}), }}",
        points.len()
    );
    text += &" ".repeat(117 - text.len());
    text += "\n";
    let mut file = b"\x93NUMPY\x01\x00".to_vec();
    file.extend((text.len() as u16).to_le_bytes());
    file.extend(text.bytes());
    for (position, normal) in points {
        let normal = normal.map(|n| n.as_dvec3().to_array());
        let numbers = position.to_array().into_iter();
        file.extend(
            numbers
                .chain(normal.into_iter().flatten())
                .flat_map(f64::to_le_bytes),
        );
    }
    file
}

/// The rows of an array of 32-bit floats.
fn rows(path: &Path, columns: usize) -> Vec<Vec<f32>> {
    let file = fs::read(path).unwrap();
    let start = 10 + usize::from(u16::from_le_bytes([file[8], file[9]]));
    let numbers = file[start..].chunks_exact(4);
    let numbers: Vec<f32> = numbers
        .map(|b| f32::from_le_bytes(b.try_into().unwrap()))
        .collect();
    numbers.chunks_exact(columns).map(<[f32]>::to_vec).collect()
}

/// Gathers by these settings at points, and reads the results.
fn gathered(
    tree: &OpenTree,
    scene: Option<&Scene>,
    at: &[(DVec3, Option<Vec3>)],
    settings: &Settings,
) -> Vec<Vec<f32>> {
    let dir = tempfile::tempdir().unwrap();
    let (input, output) = (dir.path().join("a.npy"), dir.path().join("b.npy"));
    fs::write(&input, npy(at)).unwrap();
    let file = PointFile::open(&input).unwrap();
    let job = Job::default();
    let run = points::run(
        tree,
        scene,
        &file,
        &output,
        settings,
        Overwrite::Refuse,
        &job,
    );
    let summary = run.unwrap();
    assert_eq!(summary.points, at.len() as u64);
    rows(&output, summary.columns.len())
}

/// All that can be told of a point.
const ALL: Settings = Settings {
    samples: 1024,
    max_solid_angle: 0.01,
    over: None,
    occlusion: true,
    distance: true,
    bias: 0.0,
    seed: 0,
    part: lvox::run::Part::WHOLE,
};

#[track_caller]
fn is_near(found: f32, expected: f32, share: f32, what: &str) {
    assert!(
        (found - expected).abs() <= share * expected.abs(),
        "{what}: {found}, not {expected}"
    );
}

/// A ball of surfels that send the same to both sides, around a place of the world.
fn ball(dir: &Path, centre: [f64; 3], radius: f32) -> OpenTree {
    const COUNT: usize = 40_000;
    let mut random = Random(3);
    let area = 4.0 * PI * radius * radius / COUNT as f32;
    let surfels: Vec<Surfel> = (0..COUNT)
        .map(|_| {
            let normal = random.direction();
            Surfel {
                position: normal.map(|n| n * radius),
                normal,
                radius: 1.8 * (area / PI).sqrt(),
                area,
                front: [1.0, 0.5, 0.25],
                back: [1.0, 0.5, 0.25],
                ..Surfel::default()
            }
        })
        .collect();
    let meta = CloudMeta {
        world_from_scene: centre,
        disk_overlap: 1.8,
        ..CloudMeta::default()
    };
    let (cloud, tree) = (dir.join("ball.lvc"), dir.join("ball.lvt"));
    let mut writer = CloudWriter::create(&cloud, meta, Overwrite::Refuse).unwrap();
    writer.push_surfels(&surfels).unwrap();
    writer.finish().unwrap();
    let settings = build::Settings::default();
    build::run(&cloud, &tree, &settings, Overwrite::Refuse, &Job::default()).unwrap();
    OpenTree::open(&tree, None).unwrap()
}

#[test]
fn a_ball_sends_by_its_solid_angle() {
    let dir = tempfile::tempdir().unwrap();
    let centre = DVec3::new(1000.0, -20.0, 3.0);
    let tree = ball(dir.path(), centre.to_array(), 2.0);
    // Disks alone: the boxes of nodes stand out at its limb.
    let all = Settings {
        max_solid_angle: 0.0,
        ..ALL
    };
    let mut random = Random(5);
    for distance in [2.5_f32, 4.0, 8.0] {
        let towards: Vec<Vec3> = (0..64).map(|_| random.direction().into()).collect();
        let place = |d: &Vec3| centre + d.as_dvec3() * f64::from(distance);
        let facing: Vec<_> = towards.iter().map(|d| (place(d), Some(-*d))).collect();
        let sine2 = (2.0 / distance).powi(2);
        let found = gathered(&tree, None, &facing, &all);
        let mean = |column: usize| found.iter().map(|r| r[column]).sum::<f32>() / 64.0;
        let what = |name: &str| format!("{name} at {distance}");
        is_near(mean(0), PI * sine2, 0.03, &what("irradiance"));
        is_near(mean(2), 0.25 * PI * sine2, 0.03, &what("blue"));
        is_near(mean(3), sine2, 0.03, &what("occlusion"));
        // Without normals, and where these are not asked.
        let alone: Vec<_> = towards.iter().map(|d| (place(d), None)).collect();
        let over = Some(Over::Sphere);
        let of_all = gathered(&tree, None, &facing, &Settings { over, ..all });
        let found = gathered(&tree, None, &alone, &all);
        let mean = |column: usize| found.iter().map(|r| r[column]).sum::<f32>() / 64.0;
        let share = 0.5 * (1.0 - (1.0 - sine2).sqrt());
        is_near(mean(0), share, 0.03, &what("mean radiance"));
        is_near(mean(3), share, 0.03, &what("share of the sphere"));
        let light = |all: &[Vec<f32>]| all.iter().map(|r| r[0]).sum::<f32>();
        is_near(light(&of_all), light(&found), 0.03, &what("either way"));
        // From behind there is nothing.
        let away: Vec<_> = towards.iter().map(|d| (place(d), Some(*d))).collect();
        let found = gathered(&tree, None, &away, &all);
        assert!(
            found
                .iter()
                .all(|r| r[..4] == [0.0; 4] && r[4].is_infinite())
        );
    }
    // In its middle all sends the same, but where disks leave holes.
    let at = [(centre, Some(Vec3::Y)), (centre, Some(Vec3::X))];
    for row in gathered(&tree, None, &at, &ALL) {
        is_near(row[1], 0.5 * PI * row[3], 1e-4, "irradiance inside");
        is_near(row[3], 1.0, 0.03, "occlusion inside");
        is_near(row[4], 2.0, 0.06, "distance");
    }
}

/// A closed room whose walls have an albedo of one half and emit 1, packed with its tree.
fn closed_room() -> (Work, Scene, OpenTree) {
    let work = Work::new(&crate::bounce::closed_room(0.5));
    let scene = work.scene();
    let tree = work.bake(&scene, 20_000);
    let packed = work.path("scene.lvp");
    let files = Files {
        tree: Some(&tree),
        light: None,
    };
    pack::run(&scene, files, &packed, Overwrite::Refuse, &Job::default()).unwrap();
    let scene = Scene::load(&packed).unwrap();
    let tree = OpenTree::open(&packed, None).unwrap();
    (work, scene, tree)
}

#[test]
fn a_closed_room_sends_pi_times_its_radiance_everywhere() {
    let (_work, scene, tree) = closed_room();
    let mut random = Random(9);
    let at: Vec<(DVec3, Option<Vec3>)> = (0..500)
        .map(|i| {
            let mut p: [f64; 3] = std::array::from_fn(|_| 0.49 * f64::from(random.signed()));
            let mut normal = Vec3::from(random.direction());
            if i % 2 == 0 {
                // On a wall.
                p[i % 3] = 0.5;
                normal = Vec3::ZERO;
                normal[i % 3] = -3.0;
            }
            (p.into(), Some(normal))
        })
        .collect();
    for scene in [None, Some(&scene)] {
        let found = gathered(&tree, scene, &at, &ALL);
        let mean = found.iter().map(|r| r[0]).sum::<f32>() / found.len() as f32;
        // What walls reflect of what walls emit; what they emit is direct light.
        is_near(mean, 0.5 * PI, 0.01, "irradiance");
        for row in found {
            is_near(row[0], 0.5 * PI, 0.06, "irradiance of a point");
            is_near(row[3], 1.0, 0.01, "occlusion");
        }
    }
}

#[test]
fn points_on_pixels_get_what_the_indirect_layer_has() {
    let (clear, _) = ROOM.split_once("[[volume]]").unwrap();
    let work = Work::new(clear);
    let scene = work.scene();
    let path = work.bake(&scene, 60_000);
    let tree = OpenTree::open(&path, None).unwrap();
    let tracer = Tracer::new(&scene);
    let (camera, film) = (scene.camera(None).unwrap(), scene.film);
    let surface = |x: f32, y: f32| {
        let ray = Ray::endless(camera.origin(), camera.direction(&film, x, y));
        let hit = tracer.closest(&ray)?;
        let surface = Surface::new(&scene, hit.triangle, hit.uv);
        Some(surface.facing(-ray.direction))
    };
    for (kernel, traced) in [
        (shade::Kernel::Traced, Some(&scene)),
        (shade::Kernel::Cone, None),
    ] {
        let settings = shade::Settings {
            kernel,
            samples: 512,
            lattice: 1,
            ..shade::Settings::default()
        };
        let frame = crate::shade(&scene, &path, &settings);
        let layer = crate::layer(&frame, "indirect");
        let (mut at, mut albedos, mut pixels) = (Vec::new(), Vec::new(), Vec::new());
        for y in 0..film.height {
            for x in 0..film.width {
                let (fx, fy) = (x as f32, y as f32);
                let corners = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]];
                let normals = corners.map(|[a, b]| surface(fx + a, fy + b).map(|s| s.normal));
                let Some(s) = surface(fx + 0.5, fy + 0.5) else {
                    continue;
                };
                // Pixels that see one plane, and one colour.
                if normals == [Some(s.normal); 4] {
                    let place = s.position.as_dvec3() + scene.world_from_scene;
                    at.push((place, Some(s.normal)));
                    albedos.push(s.albedo);
                    pixels.push(layer[(y * film.width + x) as usize]);
                }
            }
        }
        assert!(at.len() > 1500, "{}", at.len());
        let found = gathered(&tree, traced, &at, &ALL);
        let shaded: Vec<[f32; 3]> = found
            .iter()
            .zip(&albedos)
            .map(|(row, albedo)| (*albedo * Rgb([row[0], row[1], row[2]]) * (1.0 / PI)).0)
            .collect();
        let (ours, theirs) = (mean(&shaded), mean(&pixels));
        assert!(
            (ours / theirs - 1.0).abs() < 0.01,
            "{kernel:?}: {ours}, not {theirs}"
        );
        // Where light changes within a pixel both say something else.
        let pairs = shaded.iter().zip(&pixels);
        let mut apart: Vec<f32> = pairs
            .map(|(a, b)| (Rgb(*a).luminance() / Rgb(*b).luminance() - 1.0).abs())
            .collect();
        apart.sort_by(f32::total_cmp);
        let [half, most] = [apart[apart.len() / 2], apart[apart.len() * 9 / 10]];
        assert!(half < 0.03 && most < 0.1, "{kernel:?}: {half}, {most}");
    }
}

/// Points on the floor of the room, as ASCII with a colour and faces behind.
fn ascii(count: usize) -> String {
    let mut random = Random(1);
    let mut text = format!(
        "ply\nformat ascii 1.0\ncomment by hand\nelement vertex {count}\nproperty double x\n\
         property float y\nproperty float z\nproperty uchar red\nproperty float nx\n\
         property float ny\nproperty float nz\nelement face 1\n\
         property list uchar int vertex_indices\nend_header\n"
    );
    for i in 0..count {
        let [x, z] = [random.signed(), random.signed()].map(|v| 0.9 * v);
        text += &format!("{x} 0 {z} {} 0 2 0\n", i % 256);
    }
    text + "3 0 1 2\n"
}

#[test]
fn threads_limits_parts_and_formats_change_no_bit() {
    let work = Work::new(ROOM);
    let scene = work.scene();
    let tree = work.bake(&scene, 20_000);
    let files = Files {
        tree: Some(&tree),
        light: None,
    };
    let packed = work.path("scene.lvp");
    pack::run(&scene, files, &packed, Overwrite::Refuse, &Job::default()).unwrap();
    let dir = work.0.path();
    fs::write(work.path("a.ply"), ascii(700)).unwrap();
    let all = ["--occlusion", "--distance", "--samples", "40"];
    let run = |args: &[&str]| lvox(dir, &[&["gather"], args, &all].concat()).done();
    let bytes = |name: &str| fs::read(work.path(name)).unwrap();
    for tree in ["scene.lvt", "scene.lvp"] {
        run(&[tree, "a.ply", "-o", "whole.ply", "--force"]);
        let whole = bytes("whole.ply");
        let limit = ["--memory-limit", "64M", "--threads", "2"];
        for more in [&["--threads", "1"], &limit[..]] {
            run(&[&[tree, "a.ply", "-o", "b.ply", "--force"], more].concat());
            assert!(bytes("b.ply") == whole, "{tree} {more:?}");
        }
        for kind in ["ply", "npy"] {
            let mut joined = Vec::new();
            for part in 0..3 {
                let (part, name) = (format!("{part}/3"), format!("part.{kind}"));
                run(&[tree, "a.ply", "-o", &name, "--force", "--part", &part]);
                joined.extend(bytes(&name));
            }
            let name = format!("whole.{kind}");
            run(&[tree, "a.ply", "-o", &name, "--force"]);
            assert!(bytes(&name) == joined, "{tree} {kind}");
        }
        // The numbers of the points go through, and light does not depend on their order.
        let array = rows(&work.path("whole.npy"), 5);
        let header = whole
            .windows(11)
            .position(|w| w == b"end_header\n")
            .unwrap()
            + 11;
        let text = String::from_utf8_lossy(&whole[..header]).into_owned();
        assert!(
            text.contains("property double x\nproperty float y"),
            "{text}"
        );
        assert!(
            text.ends_with("property float distance\nend_header\n"),
            "{text}"
        );
        let own = 8 + 5 * 4 + 1;
        let vertices: Vec<&[u8]> = whole[header..].chunks_exact(own + 20).collect();
        assert_eq!(vertices.len(), 700);
        for (i, (vertex, row)) in vertices.iter().zip(&array).enumerate() {
            assert_eq!(usize::from(vertex[16]), i % 256);
            let light: Vec<u8> = row.iter().flat_map(|v| v.to_le_bytes()).collect();
            assert!(vertex[own..] == light, "{i}");
        }
        let numbers = |v: &[u8]| -> (DVec3, Option<Vec3>) {
            let x = f64::from_le_bytes(v[..8].try_into().unwrap());
            let f = |at: usize| f32::from_le_bytes(v[at..at + 4].try_into().unwrap());
            let place = DVec3::new(x, f(8).into(), f(12).into());
            (place, Some(Vec3::new(f(17), f(21), f(25))))
        };
        let turned: Vec<_> = vertices.iter().rev().map(|v| numbers(v)).collect();
        fs::write(work.path("turned.npy"), npy(&turned)).unwrap();
        run(&[tree, "turned.npy", "-o", "turned.out.npy", "--force"]);
        let mut turned = rows(&work.path("turned.out.npy"), 5);
        turned.reverse();
        assert!(turned == array, "{tree}");
    }
    run(&["scene.lvp", "a.ply", "-o", "cone.npy", "--kernel", "cone"]);
    run(&["scene.lvt", "a.ply", "-o", "tree.npy"]);
    assert!(bytes("cone.npy") == bytes("tree.npy") && bytes("cone.npy") != bytes("whole.npy"));
}

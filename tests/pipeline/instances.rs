//! Meshes that a glTF file places many times: kept once, they give the pictures that they give
//! flat.

use crate::support::program::lvox;
use crate::{Work, beauty, mean, relative_rms, shade, traced, with_threads};
use lvox::formats::{Packed, PackedColumn};
use lvox::image::Region;
use lvox::run::Job;
use lvox::scene::Scene;
use lvox::shade::Settings;
use lvox::tree::OpenTree;
use std::fs;

/// A floor, a sun, and a grove whose trees are kept once, unless more is said of it.
fn scene(more: &str) -> String {
    format!(
        r#"
[film]
width = 64
height = 48
[[camera]]
position = [2, 7, 21]
target = [0, 0, 0]
fov_x_deg = 55
[[mesh]]
file = "builtin:quad"
scale = 60
albedo = [0.5, 0.4, 0.3]
[[mesh]]
file = "grove.gltf"
translate = [0.5, 0, 0]
{more}
[[light]]
type = "directional"
direction = [0.3, -1, -0.4]
irradiance = [3, 3, 3]
angular_radius_deg = 0.5
[[light]]
type = "environment"
radiance = [0.2, 0.25, 0.3]
"#
    )
}

/// Trees in the grove; those of a mesh of 1,056 triangles save more than a million when it is kept
/// once.
const TREES: usize = 1024;

/// A wavy cone of 33 rings of 16 segments, and its triangles.
fn tree() -> (Vec<[f32; 3]>, Vec<u32>) {
    let (mut positions, mut corners) = (Vec::new(), Vec::new());
    for ring in 0..34_u32 {
        let height = ring as f32 / 33.0;
        let radius = 0.3 * (1.02 - height) * (1.0 + 0.3 * (9.0 * height).sin());
        for k in 0..16 {
            let turn = std::f32::consts::TAU * k as f32 / 16.0;
            let lean = 0.1 * height * height;
            positions.push([radius * turn.cos() + lean, height, radius * turn.sin()]);
        }
    }
    for ring in 0..33 {
        for k in 0..16 {
            let at = |r: u32, k: u32| (ring + r) * 16 + k % 16;
            let (a, b, c, d) = (at(0, k), at(0, k + 1), at(1, k), at(1, k + 1));
            corners.extend([a, c, d, a, d, b]);
        }
    }
    (positions, corners)
}

/// Writes a grove: half of the trees are listed in one node that stands in a mirrored and sheared
/// one, the others are nodes.
fn write_grove(work: &Work) {
    let (positions, corners) = tree();
    let listed = TREES / 2;
    let mut content: Vec<u8> = positions
        .iter()
        .flatten()
        .flat_map(|v| v.to_le_bytes())
        .collect();
    let indices = content.len();
    content.extend(corners.iter().flat_map(|v| v.to_le_bytes()));
    let places = content.len();
    let place = |i: usize| [(i % 32) as f32 - 16.0, 0.0, (i / 32) as f32 - 16.0];
    for i in 0..listed {
        content.extend(place(i).iter().flat_map(|v| v.to_le_bytes()));
    }
    let turns = content.len();
    for i in 0..listed {
        let (sin, cos) = (0.1 * i as f32).sin_cos();
        content.extend([0.0, sin, 0.0, cos].iter().flat_map(|v| v.to_le_bytes()));
    }
    let nodes: Vec<String> = (listed..TREES)
        .map(|i| {
            let ([x, y, z], size) = (place(i), 0.7 + 0.01 * (i % 60) as f32);
            format!(r#"{{"mesh":0,"translation":[{x},{y},{z}],"scale":[{size},1.5,{size}]}}"#)
        })
        .collect();
    let children: Vec<String> = (2..2 + nodes.len()).map(|i| i.to_string()).collect();
    let json = format!(
        r#"{{"asset":{{"version":"2.0"}},"extensionsUsed":["EXT_mesh_gpu_instancing"],
"extensionsRequired":["EXT_mesh_gpu_instancing"],"scenes":[{{"nodes":[0,{}]}}],
"nodes":[{{"matrix":[-1,0,0,0, 0.1,1,0,0, 0,0,1,0, 0,0,0,1],"children":[1]}},
{{"mesh":0,"extensions":{{"EXT_mesh_gpu_instancing":{{"attributes":{{"TRANSLATION":2,"ROTATION":3}}}}}}}},{}],
"materials":[{{"pbrMetallicRoughness":{{"baseColorFactor":[0.2,0.5,0.1,1],"metallicFactor":0}}}}],
"meshes":[{{"primitives":[{{"material":0,"indices":1,"attributes":{{"POSITION":0}}}}]}}],
"accessors":[{{"bufferView":0,"componentType":5126,"count":{},"type":"VEC3","min":[-1,0,-1],"max":[1,1,1]}},
{{"bufferView":1,"componentType":5125,"count":{},"type":"SCALAR"}},
{{"bufferView":2,"componentType":5126,"count":{listed},"type":"VEC3"}},
{{"bufferView":3,"componentType":5126,"count":{listed},"type":"VEC4"}}],
"bufferViews":[{{"buffer":0,"byteLength":{indices}}},
{{"buffer":0,"byteOffset":{indices},"byteLength":{}}},
{{"buffer":0,"byteOffset":{places},"byteLength":{}}},
{{"buffer":0,"byteOffset":{turns},"byteLength":{}}}],
"buffers":[{{"uri":"grove.bin","byteLength":{}}}]}}"#,
        children.join(","),
        nodes.join(","),
        positions.len(),
        corners.len(),
        places - indices,
        turns - places,
        content.len() - turns,
        content.len(),
    );
    fs::write(work.path("grove.gltf"), json).unwrap();
    fs::write(work.path("grove.bin"), content).unwrap();
}

fn work(more: &str) -> Work {
    let work = Work::new(&scene(more));
    write_grove(&work);
    work
}

/// The same with a key after which no mesh is kept once, and which says what holds without it.
const FLAT: &str = "opacity = 1.0";

#[test]
fn a_grove_that_is_kept_once_looks_as_if_it_were_flat() {
    let [instanced, flat] = ["", FLAT].map(work);
    let scenes = [instanced.scene(), flat.scene()];
    let [a, b] = scenes.each_ref().map(|s| &s.mesh);
    assert_eq!(a.triangle_count(), 2 + 1056 * TREES);
    assert_eq!(a.triangle_count(), b.triangle_count());
    assert_eq!((a.triangles.len(), a.instances.list().len()), (1058, TREES));
    assert!(b.instances.is_empty() && b.triangles.len() == b.triangle_count());
    assert!(a.bytes() * 100 < b.bytes());
    for t in (0..a.triangle_count()).step_by(997) {
        for (p, q) in a.corners(t).into_iter().zip(b.corners(t)) {
            assert!(p.distance(q) < 1e-5, "{t}: {p} {q}");
        }
    }
    let direct = scenes.each_ref().map(|s| traced(s, 2, 16));
    let apart = relative_rms(&direct[0], &direct[1]);
    assert!(apart < 0.02, "{apart}");
    let trees = [
        instanced.bake(&scenes[0], 30_000),
        flat.bake(&scenes[1], 30_000),
    ];
    let settings = Settings::default();
    let pictures = [0, 1].map(|i| beauty(&shade(&scenes[i], &trees[i], &settings)));
    let apart = relative_rms(&pictures[0], &pictures[1]);
    let means = pictures.each_ref().map(|p| mean(p));
    assert!(apart < 0.05, "{apart}");
    assert!((means[0] / means[1] - 1.0).abs() < 0.005, "{means:?}");
}

#[test]
fn tiles_and_threads_change_no_bit_of_a_grove() {
    let work = work("");
    let scene = work.scene();
    let tree = work.bake(&scene, 10_000);
    let store = OpenTree::open(&tree, None).unwrap();
    let full = Region::full(scene.film.width, scene.film.height);
    let run = |region| {
        let settings = Settings::default();
        shade::run(&scene, &store, &settings, region, &[], &Job::default()).unwrap()
    };
    let [one, two] = [1, 2].map(|threads| with_threads(threads, || beauty(&run(full))));
    assert!(one == two);
    let tile = Region {
        x0: 16,
        y0: 24,
        x1: 48,
        y1: 48,
    };
    let part = beauty(&run(tile));
    let rows = (tile.y0..tile.y1).map(|y| (y * full.x1 + tile.x0) as usize);
    let expected: Vec<[f32; 3]> = rows
        .flat_map(|at| one[at..at + 32].iter().copied())
        .collect();
    assert!(part == expected);
}

#[test]
fn packed_instances_are_those_of_the_files() {
    let work = work("");
    let here = work.0.path();
    let run = |args: &[&str]| lvox(here, args).done();
    run(&["pack", "scene.toml", "-o", "scene.lvp"]);
    let (scene, packed) = (work.scene(), Scene::load(&work.path("scene.lvp")).unwrap());
    assert_eq!(scene.parts(None), packed.parts(None));
    assert_eq!(scene.mesh.instances, packed.mesh.instances);
    assert!(fs::metadata(work.path("scene.lvp")).unwrap().len() < 2 << 20);
    for (name, scene) in [("a", "scene.toml"), ("b", "scene.lvp")] {
        let [lvc, lvt, exr, path] = ["lvc", "lvt", "exr", "exr"].map(|e| format!("{name}.{e}"));
        let path = format!("path-{path}");
        run(&["bake", scene, "-o", &lvc, "--surfels", "10000"]);
        run(&["build", &lvc, "-o", &lvt]);
        run(&["shade", scene, "-t", &lvt, "-o", &exr, "--quality", "draft"]);
        run(&["reference", scene, "-o", &path, "--spp", "2"]);
    }
    let bytes = |name: &str| fs::read(work.path(name)).unwrap();
    for (a, b) in [
        ("a.lvc", "b.lvc"),
        ("a.lvt", "b.lvt"),
        ("a.exr", "b.exr"),
        ("path-a.exr", "path-b.exr"),
    ] {
        assert!(bytes(a) == bytes(b), "{a}");
    }
    run(&["pack", "scene.lvp", "-o", "again.lvp"]);
    assert!(bytes("again.lvp") == bytes("scene.lvp"));
    assert_eq!(lvox(here, &["verify", "scene.lvp"]).code, 0);
    let told = lvox(here, &["inspect", "scene.toml"]).stdout;
    assert!(
        told.contains("1,058 triangles are stored and placed 1,024 times"),
        "{told}"
    );
    // A byte of a place, and places that are cut off.
    let whole = bytes("scene.lvp");
    let at = {
        let file = Packed::open(&whole[..]).unwrap();
        file.range(PackedColumn::Instances, 0).start
    };
    let mut bad = whole.clone();
    bad[at + 700] ^= 1;
    fs::write(work.path("bad.lvp"), bad).unwrap();
    fs::write(work.path("cut.lvp"), &whole[..at + 700]).unwrap();
    lvox(here, &["shade", "bad.lvp", "-t", "a.lvt", "-o", "c.exr"])
        .refused(2, &["bad.lvp", "checksum of block"]);
    lvox(here, &["shade", "cut.lvp", "-t", "a.lvt", "-o", "c.exr"]).refused(2, &["cut.lvp"]);
}

#[test]
fn what_few_trees_save_is_not_worth_it() {
    let work = work("");
    let json = fs::read_to_string(work.path("grove.gltf")).unwrap();
    // Without the nodes beside the list half of the triangles are left.
    let first = json.find("\"nodes\":[0,").unwrap();
    let end = first + json[first..].find(']').unwrap();
    let fewer = format!("{}\"nodes\":[0{}", &json[..first], &json[end..]);
    fs::write(work.path("grove.gltf"), fewer).unwrap();
    let mesh = work.scene().mesh;
    assert!(mesh.instances.is_empty());
    assert_eq!(mesh.triangles.len(), 2 + 1056 * TREES / 2);
}

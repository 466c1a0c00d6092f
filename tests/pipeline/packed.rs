//! Packed scenes: every stage makes the same of them as of the files that they were made of.

use crate::support::program::lvox;
use crate::{ROOM, Work};
use lvox::formats::Packed;

use lvox::scene::{Grid, Scene};
use std::fs;
use std::path::Path;

/// The room with a textured picture on its wall, a flame, more lights, and cameras that are no
/// pinholes.
pub fn scene() -> String {
    format!(
        r#"{ROOM}
[[camera]]
name = "lens"
position = [0, 1, 3.9]
target = [0, 1, 0]
aperture = 0.05
focus_distance = 3.5

[[camera]]
name = "flight"
aperture = 0.03
focus_distance = 3
shutter = [-0.25, 0.5]

[[camera.key]]
frame = 1
position = [0, 1, 3.9]
target = [0, 1, 0]

[[camera.key]]
frame = 3
position = [0.2, 1, 3.5]
target = [0, 1, 0]
focus_distance = 2.5

[[mesh]]
file = "picture.obj"
texture = "picture.png"
translate = [0.2, 1, -0.99]

[[light]]
type = "spot"
position = [-0.5, 1.8, 0.5]
direction = [0.3, -1, -0.2]
intensity = [3, 2, 1]
inner_deg = 10
outer_deg = 30

[[light]]
type = "directional"
direction = [0.2, -0.4, -1]
irradiance = [0.5, 0.6, 0.7]
angular_radius_deg = 2

[[volume]]
file = "builtin:flame"
scale = 0.5
sigma_t_scale = 1
albedo = [0.1, 0.1, 0.1]
unitcube_to_world = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
emission = {{ kelvin = 1800, scale = 20 }}
"#
    )
}

const PICTURE: &str = "v -0.4 -0.3 0\nv 0.4 -0.3 0\nv 0.4 0.3 0\nv -0.4 0.3 0\nvt 0 0\nvt 1 0\n\
                       vt 1 1\nvt 0 1\nvn 0 0 1\nf 1/1/1 2/2/1 3/3/1\nf 1/1/1 3/3/1 4/4/1\n";

pub fn work() -> Work {
    let work = Work::new(&scene());
    fs::write(work.path("picture.obj"), PICTURE).unwrap();
    let picture =
        image::RgbImage::from_fn(16, 8, |x, y| image::Rgb([x as u8 * 16, 90, y as u8 * 30]));
    picture.save(work.path("picture.png")).unwrap();
    work
}

pub fn bytes(folder: &Path, name: &str) -> Vec<u8> {
    fs::read(folder.join(name)).unwrap()
}

const BAKE: [&str; 2] = ["--surfels", "20000"];
const QUICK: [&str; 2] = ["--quality", "draft"];

fn run(folder: &Path, args: &[&[&str]]) {
    lvox(folder, &args.concat()).done();
}

/// All stages of a scene: cloud, tree and light `a`, and images from `a.exr` to `d.exr`.
fn stages(folder: &Path, scene: &str) {
    run(folder, &[&["bake", scene, "-o", "a.lvc"], &BAKE]);
    run(folder, &[&["build", "a.lvc", "-o", "a.lvt"]]);
    run(folder, &[&["scatter", scene, "-t", "a.lvt", "-o", "a.lvs"]]);
    run(
        folder,
        &[&["shade", scene, "-t", "a.lvt", "-o", "a.exr"], &QUICK],
    );
    let light = ["--scatter", "a.lvs", "-o", "b.exr", "--camera", "corner"];
    run(folder, &[&["shade", scene, "-t", "a.lvt"], &light, &QUICK]);
    run(
        folder,
        &[&["reference", scene, "-o", "c.exr", "--spp", "2"]],
    );
    let flight = ["--camera", "flight", "--frames", "2"];
    run(
        folder,
        &[
            &["shade", scene, "-t", "a.lvt", "-o", "d.exr"],
            &QUICK,
            &flight,
        ],
    );
}

#[test]
fn all_stages_make_the_same_of_a_packed_scene_without_its_assets() {
    let work = work();
    let here = work.0.path();
    let elsewhere = tempfile::tempdir().unwrap();
    let there = elsewhere.path();
    run(here, &[&["pack", "scene.toml", "-o", "scene.lvp"]]);
    fs::copy(here.join("scene.lvp"), there.join("moved.lvp")).unwrap();
    stages(here, "scene.toml");
    stages(there, "moved.lvp");
    for name in [
        "a.lvc", "a.lvt", "a.lvs", "a.exr", "b.exr", "c.exr", "d.exr",
    ] {
        assert!(bytes(here, name) == bytes(there, name), "{name}");
    }
    run(there, &[&["pack", "moved.lvp", "-o", "again.lvp"]]);
    assert!(bytes(there, "again.lvp") == bytes(here, "scene.lvp"));
}

#[test]
fn a_scene_that_is_packed_with_tree_and_light_is_one_file_that_needs_no_other() {
    let work = work();
    let here = work.0.path();
    stages(here, "scene.toml");
    let pack = [
        "pack",
        "scene.toml",
        "-t",
        "a.lvt",
        "--scatter",
        "a.lvs",
        "-o",
        "all.lvp",
    ];
    run(here, &[&pack]);
    let elsewhere = tempfile::tempdir().unwrap();
    let there = elsewhere.path();
    fs::copy(here.join("all.lvp"), there.join("all.lvp")).unwrap();
    run(
        there,
        &[
            &["shade", "all.lvp", "-o", "b.exr", "--camera", "corner"],
            &QUICK,
        ],
    );
    assert!(bytes(there, "b.exr") == bytes(here, "b.exr"));
    run(there, &[&["pack", "all.lvp", "-o", "again.lvp"]]);
    assert!(bytes(there, "again.lvp") == bytes(here, "all.lvp"));
    // A tree that is named counts, and light of another is not mixed in.
    run(there, &[&["bake", "all.lvp", "-o", "a.lvc"], &BAKE]);
    run(there, &[&["build", "a.lvc", "-o", "a.lvt"]]);
    let named = ["shade", "all.lvp", "-t", "a.lvt", "-o", "a.exr"];
    run(there, &[&named, &QUICK]);
    assert!(bytes(there, "a.exr") == bytes(here, "a.exr"));
    let whole = lvox(there, &["verify", "all.lvp"]);
    assert_eq!(
        (whole.code, whole.stdout.as_str()),
        (0, "all.lvp: packed undamaged\n")
    );
    // What a file is, its content says.
    fs::copy(there.join("all.lvp"), there.join("all.bin")).unwrap();
    let renamed = lvox(there, &["verify", "all.bin"]);
    assert_eq!(
        (renamed.code, renamed.stdout.as_str()),
        (0, "all.bin: packed undamaged\n")
    );
    let told = lvox(there, &["inspect", "all.lvp"]).stdout;
    for part in [
        "packed scene",
        "\"room\"",
        "triangles",
        "tree",
        "light",
        "a voxel",
    ] {
        assert!(told.contains(part), "{part}: {told}");
    }
}

#[test]
fn a_packed_scene_is_the_scene() {
    let work = work();
    lvox(work.0.path(), &["pack", "scene.toml", "-o", "scene.lvp"]).done();
    let (scene, packed) = (work.scene(), Scene::load(&work.path("scene.lvp")).unwrap());
    assert_eq!(scene.parts(None), packed.parts(None));
    assert!(
        scene
            .parts(None)
            .iter()
            .any(|(part, _)| part == "scene/emission")
    );
    assert_eq!((scene.hash, &scene.name), (packed.hash, &packed.name));
    let described = |s: &Scene| {
        let whole = (&s.cameras, &s.film, &s.lights, &s.materials, &s.warnings);
        format!("{whole:?} {:?} {:?}", s.world_from_scene, s.mesh)
    };
    assert_eq!(described(&scene), described(&packed));
    let flight = packed.camera(Some("flight")).unwrap();
    assert!(flight.path.len() > 1 && flight.lens.is_some());
    assert_eq!(flight.keys[1].lens.unwrap().focus_distance, 2.5);
    assert!(packed.mesh.positions.is_mapped() && !scene.mesh.positions.is_mapped());
    assert_eq!(packed.files, [work.path("scene.lvp")]);
}

/// Every file that a stage writes says which channels media stop most.
#[test]
fn extinction_colors_go_through_all_files() {
    const COLOR: [f32; 3] = [1.0, 0.5, 0.25];
    let scene = ROOM.replace("sigma_t_scale = 6", "sigma_t_scale = [6, 3, 1.5]");
    let work = Work::new(&scene);
    let here = work.0.path();
    let run = |args: &[&str]| lvox(here, args).done();
    run(&["pack", "scene.toml", "-o", "scene.lvp"]);
    let (scene, packed) = (work.scene(), Scene::load(&work.path("scene.lvp")).unwrap());
    assert_eq!(scene.volumes[0].extinction_color, COLOR);
    assert_eq!(packed.volumes[0].extinction_color, COLOR);
    assert_eq!(scene.parts(None), packed.parts(None));
    run(&["bake", "scene.lvp", "-o", "a.lvc", "--surfels", "2000"]);
    run(&["build", "a.lvc", "-o", "a.lvt"]);
    run(&["scatter", "scene.toml", "-t", "a.lvt", "-o", "a.lvs"]);
    for file in ["a.lvc", "a.lvt", "a.lvs", "scene.lvp"] {
        let told = lvox(here, &["inspect", file]).stdout;
        let mut lines = told
            .lines()
            .skip_while(|l| !l.contains("extinction colour"));
        let row = lines.nth(1).unwrap_or_default();
        let row: Vec<&str> = row.split_whitespace().skip(1).collect();
        assert_eq!(row, ["1", "0.5", "0.25"], "{file}: {told}");
        assert_eq!(lvox(here, &["verify", file]).code, 0, "{file}");
    }
    let told = lvox(here, &["inspect", "scene.toml"]).stdout;
    assert!(told.contains(", extinction colour 1 0.5 0.25\n"), "{told}");
}

#[test]
fn outputs_of_pack_keep_the_rules_of_all_outputs() {
    let work = work();
    let here = work.0.path();
    let pack = ["pack", "scene.toml", "-o", "scene.lvp"];
    lvox(here, &pack).done();
    lvox(here, &pack).refused(2, &["scene.lvp", "already there", "--force"]);
    lvox(here, &[&pack[..], &["--force"]].concat()).done();
    lvox(here, &["pack", "scene.lvp", "-o", "scene.lvp", "--force"]).refused(2, &["would replace"]);
    fs::write(here.join("described.toml"), "packed = \"scene.lvp\"\n").unwrap();
    lvox(
        here,
        &["pack", "described.toml", "-o", "scene.lvp", "--force"],
    )
    .refused(2, &["would replace the file of the scene"]);
    // No verb would know them as scenes.
    for name in ["scene", "smoke.raw"] {
        let hint = format!("name it {name}.lvp");
        lvox(here, &["pack", "scene.toml", "-o", name, "--force"])
            .refused(2, &[name, "has to be named .lvp", &hint]);
    }
    lvox(here, &["shade", "scene.lvp", "-o", "a.exr"]).refused(2, &["scene.lvp", "tree"]);
    lvox(here, &["shade", "scene.toml", "-o", "a.exr"])
        .refused(2, &["no tree was given", "--tree"]);
    fs::write(here.join("wrong.lvp"), "no scene").unwrap();
    lvox(here, &["bake", "wrong.lvp", "-o", "a.lvc"])
        .refused(2, &["wrong.lvp", "not an lvox file", "`lvox pack`"]);
    // Of which the tree is wanted first.
    lvox(here, &["shade", "wrong.lvp", "-o", "a.exr"])
        .refused(2, &["wrong.lvp", "not an lvox file", "`lvox pack`"]);
    let made = |n: &String| ["a.exr", "a.lvc", "scene"].contains(&n.as_str());
    assert!(!work.names().iter().any(made));
}

/// What the file says behind right checksums, and what it is cut to, is an error of its name.
#[test]
fn damage_is_an_error_before_the_work() {
    let work = work();
    let here = work.0.path();
    lvox(here, &["pack", "scene.toml", "-o", "scene.lvp"]).done();
    let whole = bytes(here, "scene.lvp");
    // In the first column.
    let mut bad = whole.clone();
    bad[4096 + 20] ^= 0x40;
    fs::write(here.join("bad.lvp"), bad).unwrap();
    lvox(here, &["bake", "bad.lvp", "-o", "a.lvc"]).refused(2, &["bad.lvp", "checksum of block 1"]);
    // In the last page of the finest level of the smoke.
    let page = {
        let packed = Packed::open(&whole[..]).unwrap();
        let block = packed.level_blocks(0, 0).unwrap().end - 1;
        packed.blocks()[block].offset as usize
    };
    let mut bad = whole.clone();
    bad[page] ^= 1;
    fs::write(here.join("page.lvp"), bad).unwrap();
    for stage in [
        &["bake", "page.lvp", "-o", "a.lvc"][..],
        &["reference", "page.lvp", "-o", "a.exr", "--spp", "1"],
        &["pack", "page.lvp", "-o", "a.lvp"],
        &["verify", "page.lvp", "--progress", "none"],
    ] {
        lvox(here, stage).refused(2, &["page.lvp", "checksum of block"]);
    }
    fs::write(here.join("cut.lvp"), &whole[..whole.len() - 5]).unwrap();
    lvox(here, &["bake", "cut.lvp", "-o", "a.lvc"]).refused(2, &["cut.lvp", "bytes"]);
    let made = |n: &String| ["a.lvc", "a.exr", "a.lvp"].contains(&n.as_str());
    assert!(!work.names().iter().any(made));
}

/// Of media a stage reads the levels that it needs, and no other.
#[test]
fn levels_of_media_are_read_when_they_are_asked_for() {
    let work = work();
    let here = work.0.path();
    lvox(here, &["pack", "scene.toml", "-o", "scene.lvp"]).done();
    let whole = bytes(here, "scene.lvp");
    let (top, pages) = {
        let packed = Packed::open(&whole[..]).unwrap();
        let levels = packed.meta().volumes[0].levels.len();
        let page = |level| packed.level_blocks(0, level).unwrap().end - 1;
        let at = |level| packed.blocks()[page(level)].offset as usize;
        assert_eq!(packed.level(0, levels - 1).unwrap().dims, [1; 3]);
        (levels - 1, (0..levels).map(at).collect::<Vec<_>>())
    };
    let mut bad = whole;
    pages[1..].iter().for_each(|page| bad[*page] ^= 1);
    fs::write(here.join("bad.lvp"), bad).unwrap();
    let volume = &Scene::load(&work.path("bad.lvp")).unwrap().volumes[0];
    let loaded = &work.scene().volumes[0];
    assert!((0..=top).all(|level| !volume.level(level).is_read()));
    volume.ready().unwrap();
    for level in 1..=top {
        let (stored, made) = (volume.level(level), loaded.level(level));
        assert_eq!((stored.dims(), stored.size()), (made.dims(), made.size()));
        assert_eq!(stored.max(), made.max());
        let error = stored.ready().unwrap_err().to_string();
        assert!(
            error.contains("bad.lvp") && error.contains("checksum"),
            "{error}"
        );
    }
    lvox(
        here,
        &["bake", "bad.lvp", "-o", "a.lvc", "--surfels", "1000"],
    )
    .done();
    lvox(here, &["pack", "bad.lvp", "-o", "again.lvp"])
        .refused(2, &["bad.lvp", "checksum of block"]);
    lvox(here, &["verify", "bad.lvp", "--progress", "none"])
        .refused(2, &["bad.lvp", "checksum of block"]);
    let volume = &Scene::load(&work.path("scene.lvp")).unwrap().volumes[0];
    for level in 0..=top {
        let (stored, made) = (volume.level(level), loaded.level(level));
        for b in made.bricks() {
            let samples = |grid: &Grid| grid.brick(b).map(|b| (b.samples().to_vec(), b.max));
            assert_eq!(samples(stored), samples(made), "level {level}, brick {b:?}");
        }
    }
}

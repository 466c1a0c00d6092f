//! What `lvox inspect` says of scenes, meshes and volumes: as the loader of rendering has read
//! them.

use crate::Folder;
use crate::support::program::{Run, lvox};
use serde_json::Value;

const SCENE: &str = r#"
name = "two squares and fog"
[film]
width = 64
height = 48
[[camera]]
name = "front"
position = [0, 0, 1e6]
target = [0, 0, 0]
fov_x_deg = 30
[[mesh]]
file = "a.obj"
[[mesh]]
file = "a.obj"
translate = [3, 0, 0]
emission = [1, 2, 3]
[[light]]
type = "point"
position = [0, 5, 0]
intensity = [7, 8, 9]
[[volume]]
file = "a.raw"
name = "fog"
dims = [2, 1, 4]
dtype = "i16"
window = [-1000, 1000]
sigma_t_scale = 4
albedo = [0.5, 0.5, 0.5]
unitcube_to_world = [[1,0,0,10],[0,2,0,20],[0,0,8,30],[0,0,0,1]]
"#;

/// A square with a texture, beside a triangle without area.
const OBJ: &[u8] = b"mtllib a.mtl\nv 0 0 0\nv 2 0 0\nv 2 2 0\nv 0 2 0\nvt 0 0\nvt 1 0\nvt 1 1\n\
usemtl tiles\nf 1/1 2/2 3/3 4/1\nf 1/1 2/2 2/2\n";
const MTL: &[u8] = b"newmtl tiles\nKd 1 1 1\nmap_Kd a.png\nmap_Bump b.png\n";

fn folder() -> Folder {
    let mut png = std::io::Cursor::new(Vec::new());
    let image = image::RgbImage::from_pixel(3, 5, image::Rgb([9, 99, 199]));
    image.write_to(&mut png, image::ImageFormat::Png).unwrap();
    let raw = [-1000_i16, 0, 0, 0, 500, 500, 1000, 0].map(i16::to_le_bytes);
    Folder::new(&[
        ("scene.toml", SCENE.as_bytes()),
        ("a.obj", OBJ),
        ("a.mtl", MTL),
        ("a.png", png.get_ref()),
        ("a.raw", raw.as_flattened()),
    ])
}

fn inspect(folder: &Folder, args: &[&str]) -> Run {
    let run = lvox(folder.0.path(), &[&["inspect"], args].concat());
    assert_eq!(run.code, 0, "{}", run.stderr);
    run
}

fn json(folder: &Folder, name: &str) -> Value {
    serde_json::from_str(&inspect(folder, &[name, "--json"]).stdout).unwrap()
}

#[test]
fn a_scene_is_listed_as_it_would_be_rendered() {
    let folder = folder();
    let found = json(&folder, "scene.toml");
    let expected = serde_json::json!({
        "kind": "scene", "name": "two squares and fog", "film": [64, 48],
        "/mesh/triangles": 4, "/mesh/degenerate_triangles": 2, "/mesh/area": 8.0,
        "/mesh/bounds": { "min": [0.0, 0.0, 0.0], "max": [5.0, 2.0, 0.0] },
        "/mesh/has_uvs": true, "/mesh/has_colors": false,
        "/cameras/0/name": "front", "/cameras/0/position": [0.0, 0.0, 1e6],
        "/lights/0/type": "point", "/lights/0/position": [0.0, 5.0, 0.0],
        "/lights/0/color": [7.0, 8.0, 9.0],
        "/volumes/0/name": "fog", "/volumes/0/dims": [2, 1, 4], "/volumes/0/voxels": 8,
        "/volumes/0/active_voxels": 4, "/volumes/0/negative_voxels": 1,
        "/volumes/0/min": -1000.0, "/volumes/0/max": 1000.0, "/volumes/0/active_mean": 250.0,
        "/volumes/0/voxel_edges": [0.5, 2.0, 2.0],
        "/volumes/0/bounds": { "min": [10.0, 20.0, 30.0], "max": [11.0, 22.0, 38.0] },
        "/volumes/0/sigma_t_max": 4.0, "/volumes/0/sigma_t_mean": 2.25,
        "/volumes/0/voxel_depth_max": 8.0, "/volumes/0/voxel_depth_mean": 9.0,
        "/volumes/0/histogram/from": -1000.0, "/volumes/0/histogram/to": 1000.0,
        "/volumes/0/histogram/counts": [1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 2, 0, 0, 1],
        "/textures/0/width": 3, "/textures/0/height": 5, "/textures/0/bits": 8,
        "/textures/0/memory_bytes": 3 * 5 * 3 + 4 * 256, "/textures/0/shared_with": null,
        // Of the same file.
        "/textures/1/memory_bytes": 0, "/textures/1/shared_with": 0,
    });
    for (key, value) in expected.as_object().unwrap() {
        let pointer = if key.starts_with('/') {
            key.clone()
        } else {
            format!("/{key}")
        };
        assert_eq!(found.pointer(&pointer), Some(value), "{key}");
    }
    let files: Vec<_> = found["files"].as_array().unwrap().iter().collect();
    for name in ["scene.toml", "a.obj", "a.mtl", "a.png", "a.raw"] {
        assert!(files.iter().any(|f| f["path"] == name), "{name}");
    }
    let materials = found["materials"].as_array().unwrap();
    let emitters: Vec<_> = materials
        .iter()
        .filter(|m| m["emission"][2] == 3.0)
        .collect();
    assert_eq!(emitters.len(), 1);
    assert_eq!(
        (&emitters[0]["triangles"], &emitters[0]["area"]),
        (&2.into(), &4.0.into())
    );
    assert!(
        found["warnings"]
            .to_string()
            .contains("bumps and normal maps")
    );
    let memory = |of: &Value| of["memory_bytes"].as_u64().unwrap();
    let all = memory(&found["mesh"])
        + memory(&found["volumes"][0])
        + found["textures"]
            .as_array()
            .unwrap()
            .iter()
            .map(memory)
            .sum::<u64>();
    assert_eq!(memory(&found), all);
}

#[test]
fn textures_beyond_the_limit_are_refused() {
    let folder = folder();
    let limited = |limit: &str| {
        let args = ["inspect", "scene.toml", "--texture-limit", limit];
        lvox(folder.0.path(), &args)
    };
    let told = [
        "a.png: a texture of 3 x 5 takes 45 B",
        "raise --texture-limit",
    ];
    limited("44").refused(2, &told);
    assert_eq!(limited("45").code, 0);
}

#[test]
fn text_says_the_same_and_strict_jobs_fail() {
    let folder = folder();
    let run = inspect(&folder, &["scene.toml"]);
    assert_eq!(run.stderr, "");
    for part in [
        "4 triangles",
        "2 triangles without area are left out",
        "area 8, bounds 0 0 0 to 5 2 0",
        "film 64 x 48",
        "3 x 5",
        "volume 'fog' of a.raw",
        "2 x 1 x 4 from 0 0 0, 4 active (50.0 %)",
        "-1000 to 1000, mean of the active 250, 1 below 0",
        "sigma_t     at most 4, mean of the box 2.25",
        "warning: a.mtl: ",
    ] {
        assert!(
            run.stdout.contains(part),
            "{part:?} is not in {}",
            run.stdout
        );
    }
    let strict = lvox(folder.0.path(), &["inspect", "scene.toml", "--strict"]);
    assert_eq!(strict.code, 2, "{}", strict.stderr);
    assert!(strict.stderr.contains("bumps"), "{}", strict.stderr);
}

#[test]
fn meshes_and_volumes_need_no_scene() {
    let folder = folder();
    let mesh = json(&folder, "a.obj");
    assert_eq!(mesh["kind"], "mesh");
    assert_eq!(
        (&mesh["mesh"]["triangles"], &mesh["mesh"]["area"]),
        (&2.into(), &4.0.into())
    );
    assert_eq!(
        (&mesh["cameras"], &mesh["film"]),
        (&serde_json::json!([]), &Value::Null)
    );
    assert!(!mesh["warnings"].to_string().contains("camera"));

    let header =
        "NRRD0004\ntype: int16\ndimension: 3\nsizes: 2 1 2\nendian: little\nencoding: raw\n";
    let values = [-1000_i16, 3000, 0, 1000].map(i16::to_le_bytes);
    let ct = [format!("{header}\n").as_bytes(), values.as_flattened()].concat();
    std::fs::write(folder.path("ct.nrrd"), ct).unwrap();
    let ct = json(&folder, "ct.nrrd");
    let volume = &ct["volumes"][0];
    assert_eq!(ct["kind"], "volume");
    assert_eq!(
        (&volume["min"], &volume["max"]),
        (&(-1000.0).into(), &3000.0.into())
    );
    assert_eq!(
        volume["bounds"],
        serde_json::json!({ "min": [-0.5, -0.5, -0.5], "max": [1.5, 0.5, 1.5] })
    );
    for part in ["does not say where the volume is", "need a `window`"] {
        assert!(ct["warnings"].to_string().contains(part), "{part}");
    }
}

#[test]
fn a_volume_file_says_what_to_try() {
    // Air around a ball of tissue; voxels of 2 units.
    let header = "NRRD0004\ntype: int16\ndimension: 3\nsizes: 32 32 32\nspace: RAS\n\
                  space directions: (2,0,0) (0,2,0) (0,0,2)\nspace origin: (0,0,0)\n\
                  endian: little\nencoding: raw\n";
    let value = |i: usize| {
        let r2: usize = [i % 32, i / 32 % 32, i / 1024]
            .iter()
            .map(|x| x.abs_diff(16).pow(2))
            .sum();
        (if r2 < 144 { 1100 } else { 60 }) + (i % 37) as i16
    };
    let values: Vec<u8> = (0..32 * 32 * 32)
        .flat_map(|i| value(i).to_le_bytes())
        .collect();
    let file = [format!("{header}\n").as_bytes(), &values].concat();
    let folder = Folder::new(&[("ct.nrrd", &file)]);
    let found = json(&folder, "ct.nrrd");
    let suggested = &found["volumes"][0]["suggested"];
    let number = |v: &Value| v.as_f64().unwrap();
    let [low, high] = [0, 1].map(|i| number(&suggested["window"][i]));
    assert!(
        low > 90.0 && low < 1100.0 && high > 1100.0 && high < 1140.0,
        "{suggested}"
    );
    let text = inspect(&folder, &["ct.nrrd"]).stdout;
    let scale = number(&suggested["sigma_t_scale"]);
    for part in [
        format!("try         window = [{low}, {high}], sigma_t_scale = {scale}\n"),
        "patient     RAS in the file".into(),
    ] {
        assert!(text.contains(&part), "{part} is not in {text}");
    }
    // The first try of most, and what it is told.
    let warned = |more: &str| {
        let text = format!("[[volume]]\nfile = \"ct.nrrd\"\nalbedo = [1, 1, 1]\n{more}\n");
        let warnings = folder.load(&text).unwrap().warnings;
        let about = warnings.into_iter().filter(|w| w.contains("ct.nrrd"));
        about.collect::<Vec<_>>()
    };
    let solid = warned("sigma_t_scale = 1");
    assert_eq!(solid.len(), 1, "{solid:?}");
    for part in [
        "100 % of the box is medium",
        &format!("try `window = [{low}, {high}]` and `sigma_t_scale = {scale}`"),
    ] {
        assert!(solid[0].contains(part), "{part} is not in {solid:?}");
    }
    let window = format!("window = [{low}, {high}]\nsigma_t_scale = ");
    let black = warned(&format!("{window}1000"));
    assert!(
        black[0].contains("in each voxel: no light gets in; try `sigma_t_scale = "),
        "{black:?}"
    );
    for right in [format!("{window}{scale}"), "sigma_t_scale = 1e-5".into()] {
        let told = warned(&right);
        assert!(told.is_empty(), "{right}: {told:?}");
    }
}

#[test]
fn what_cannot_be_read_is_one_line() {
    let folder = folder();
    for (name, content, part) in [
        ("bad.obj", "v 0 0\n", "bad.obj"),
        ("bad.ply", "ply\nno\n", "bad.ply"),
        ("bad.vdb", "nothing", "not an OpenVDB file"),
        ("bad.nrrd", "NRRD0004\n", "bad.nrrd"),
        ("bad.gltf", "{", "bad.gltf"),
        ("bad.toml", "[[volume]]\nfile = 'a.raw'\n", "bad.toml"),
        ("empty.obj", "v 0 0 0\n", "nothing to render"),
    ] {
        std::fs::write(folder.path(name), content).unwrap();
        lvox(folder.0.path(), &["inspect", name]).refused(2, &[part]);
    }
    lvox(folder.0.path(), &["inspect", "none.vdb"]).refused(2, &["none.vdb"]);
    lvox(folder.0.path(), &["inspect", "a.raw"]).refused(2, &["a.raw"]);
    lvox(folder.0.path(), &["inspect", "a.obj", "--points", "1"]).refused(2, &["no points"]);
}

/// A medium of which no file has voxels is drawn as others are, and listed as they are.
#[test]
fn homogeneous_media_are_listed() {
    let room = concat!(env!("CARGO_MANIFEST_DIR"), "/examples/room.xml");
    let found = json(&folder(), room);
    let volumes = found["volumes"].as_array().unwrap();
    assert_eq!(volumes.len(), 1, "{found}");
    assert!(volumes[0]["active_voxels"].as_u64().unwrap() > 0, "{found}");
}

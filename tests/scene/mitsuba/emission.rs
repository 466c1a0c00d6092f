//! What sends light in Mitsuba scenes: on which side, and of what colour.

use super::*;

/// The area of a shape that emits on the side of +z less that on the other, by its corners.
fn area_up(shape: &str, files: &[(&str, &[u8])]) -> f32 {
    let scene =
        format!("<scene version=\"3.0.0\"><shape {shape}<emitter type=\"area\"/></shape></scene>");
    let mut all = vec![("a.xml", scene.as_bytes())];
    all.extend(files);
    let scene = Scene::load(&Folder::new(&all).path("a.xml")).unwrap();
    let triangles = 0..scene.mesh.triangles.len();
    triangles.map(|t| scene.mesh.area_vector(t).z).sum()
}

/// Faces +z by its corners.
fn obj(normals: &str) -> Vec<u8> {
    let corners = "v 0 0 0\nv 2 0 0\nv 0 1 0\n";
    let face = match normals {
        "" => "f 1 2 3\n",
        _ => "f 1//1 2//2 3//3\n",
    };
    format!("{corners}{normals}{face}").into_bytes()
}

fn ply(normals: bool) -> Vec<u8> {
    let (keys, normal) = match normals {
        true => (
            "property float nx\nproperty float ny\nproperty float nz\n",
            "0 0 -1",
        ),
        false => ("", ""),
    };
    format!(
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n\
         property float z\n{keys}element face 1\nproperty list uchar int vertex_indices\n\
         end_header\n0 0 0 {normal}\n2 0 0 {normal}\n0 1 0 {normal}\n3 0 1 2\n"
    )
    .into_bytes()
}

/// Signs as Mitsuba 3.9 has them.
#[test]
fn light_leaves_on_the_side_of_the_normals() {
    let file =
        |kind: &str| format!("type=\"{kind}\"><string name=\"filename\" value=\"a.{kind}\"/>");
    let flag = |name: &str| format!("<boolean name=\"{name}\" value=\"true\"/>");
    let (faces, flip) = (flag("face_normals"), flag("flip_normals"));
    let mirror = "<transform name=\"to_world\"><scale x=\"-1\" y=\"1\" z=\"1\"/></transform>";
    let down = "vn 0 0 -1\n".repeat(3);
    let up = "vn 0 0 1\n".repeat(3);
    let mostly_down = "vn 0 0 1\nvn 0 0 -1\nvn 0 0 -1\n";
    // Their lengths do not count.
    let long_up = "vn 0 0 9\nvn 0 0 -1\nvn 0 0 -1\n";
    for (normals, keys, expected) in [
        ("", "", 1.0),
        ("", &*flip, -1.0),
        ("", mirror, -1.0),
        ("", &format!("{mirror}{faces}"), -1.0),
        ("", &format!("{mirror}{flip}"), 1.0),
        (&*up, "", 1.0),
        (&up, mirror, 1.0),
        (&up, &format!("{mirror}{faces}"), -1.0),
        (&down, "", -1.0),
        (&down, &faces, 1.0),
        (&down, &flip, 1.0),
        (&down, &format!("{faces}{flip}"), -1.0),
        (&down, mirror, -1.0),
        (mostly_down, "", -1.0),
        (mostly_down, &flip, 1.0),
        (long_up, "", -1.0),
    ] {
        let found = area_up(
            &format!("{}{keys}", file("obj")),
            &[("a.obj", &obj(normals))],
        );
        assert_eq!(found, expected, "{normals}{keys}");
    }
    for (has_normals, keys, expected) in [
        (true, "", -1.0),
        (true, &*faces, 1.0),
        (true, &flip, 1.0),
        (false, "", 1.0),
        (false, mirror, -1.0),
    ] {
        let ply = ply(has_normals);
        let found = area_up(&format!("{}{keys}", file("ply")), &[("a.ply", &ply)]);
        assert_eq!(found, expected, "{has_normals} {keys}");
    }
}

/// Of Mitsuba's own shapes, mirrored spheres alone emit inwards.
#[test]
fn mirrored_shapes_emit_as_in_mitsuba() {
    let mirror = |x: i32, z: i32| {
        format!("<transform name=\"to_world\"><scale x=\"{x}\" y=\"1\" z=\"{z}\"/></transform>")
    };
    let outwards = |shape: &str| {
        let scene = format!(
            "<scene version=\"3.0.0\"><shape {shape}<emitter type=\"area\"/></shape></scene>"
        );
        let scene = load(&scene).unwrap();
        let mesh = &scene.mesh;
        let triangles = 0..mesh.triangles.len();
        let flux = triangles.map(|t| mesh.area_vector(t).dot(mesh.corners(t)[0]));
        flux.sum::<f32>() > 0.0
    };
    for (kind, expected) in [("sphere", false), ("cube", true), ("cylinder", true)] {
        assert!(outwards(&format!("type=\"{kind}\">")), "{kind}");
        let mirrored = format!("type=\"{kind}\">{}", mirror(-1, 1));
        assert_eq!(outwards(&mirrored), expected, "{kind}");
    }
    for kind in ["rectangle", "disk"] {
        let up = |x, z| area_up(&format!("type=\"{kind}\">{}", mirror(x, z)), &[]) > 0.0;
        assert!(up(-1, 1) && !up(1, -1), "{kind}");
    }
}

/// Equal-energy white, linear Rec.709.
const WHITE: [f32; 3] = [1.204_794, 0.948_291, 0.908_916];

/// A light of a type; that on a shape is on `s`.
fn light(kind: &str, key: &str) -> String {
    match kind {
        "area" => format!(
            "<shape type=\"rectangle\" id=\"s\"><emitter type=\"area\">{key}</emitter></shape>"
        ),
        _ => format!("<emitter type=\"{kind}\">{key}</emitter>"),
    }
}

/// What the only light of a scene has, or else the albedo of `s`.
fn color(version: &str, content: &str) -> [f32; 3] {
    let floor = "<shape type=\"rectangle\" id=\"floor\"/>";
    let scene = format!("<scene version=\"{version}\">{floor}{content}</scene>");
    let scene = load(&scene).unwrap();
    if let Some(m) = scene.materials.iter().find(|m| m.name == "s") {
        return match m.emission {
            [0.0, 0.0, 0.0] => m.albedo,
            emission => emission,
        };
    }
    match scene.lights[..] {
        [Light::Point { intensity, .. } | Light::Spot { intensity, .. }] => intensity,
        [Light::Directional { irradiance, .. }] => irradiance,
        [Light::Environment { radiance }] => radiance,
        _ => panic!("{:?}", scene.lights),
    }
}

#[track_caller]
fn near(found: [f32; 3], expected: [f32; 3], what: &str) {
    let off = [0, 1, 2].map(|i| (found[i] - expected[i]).abs());
    assert!(
        off.iter().all(|off| *off < 0.005),
        "{what}: {found:?} {expected:?}"
    );
}

#[test]
fn even_spectra_are_white_as_light() {
    for (kind, name) in [
        ("area", "radiance"),
        ("constant", "radiance"),
        ("point", "intensity"),
        ("spot", "intensity"),
        ("directional", "irradiance"),
    ] {
        let of = |version: &str, value: &str| {
            let key = format!("<spectrum name=\"{name}\" {value}</spectrum>");
            color(version, &light(kind, &key))
        };
        near(of("3.0.0", "value=\"2\">"), WHITE.map(|c| 2.0 * c), kind);
        assert_eq!(of("0.6.0", "value=\"2\">"), [2.0; 3], "{kind}");
        let uniform = "type=\"uniform\"><float name=\"value\" value=\"2\"/>";
        assert_eq!(of("3.0.0", uniform), [2.0; 3], "{kind}");
    }
}

/// Numbers of Mitsuba 3.9 in `scalar_rgb`.
#[test]
fn spectra_have_the_colors_of_mitsuba() {
    for (value, sent, reflected) in [
        ("0.5", WHITE.map(|c| 0.5 * c), [0.5; 3]),
        (
            "400:1, 700:1",
            [1.1997, 0.9495, 0.9034],
            [0.9953, 0.9998, 0.9949],
        ),
        (
            "400:0.2, 500:0.2, 600:0.5, 700:0.5",
            [0.6608, 0.3083, 0.1593],
            [0.5698, 0.3220, 0.1782],
        ),
        (
            "400:0, 500:1, 510:1, 520:0",
            [0.0, 0.1675, 0.5291],
            [0.0, 0.1851, 0.5928],
        ),
        (
            "440:0.2,480:0.9,520:0.4,600:0.1",
            [0.0, 0.3686, 0.3608],
            [0.0, 0.3906, 0.4214],
        ),
        (
            "600:0, 620:1, 640:0",
            [0.3949, 0.0, 0.0],
            [0.3484, 0.0, 0.0],
        ),
    ] {
        let spectrum = |name: &str| format!("<spectrum name=\"{name}\" value=\"{value}\"/>");
        let radiance = spectrum("radiance");
        near(color("3.0.0", &light("area", &radiance)), sent, value);
        let surface = format!(
            "<shape type=\"rectangle\" id=\"s\"><bsdf type=\"diffuse\">{}</bsdf></shape>",
            spectrum("reflectance")
        );
        near(color("3.0.0", &surface), reflected, value);
    }
    for value in ["500:1", "700:1, 400:1"] {
        let key = format!("<spectrum name=\"radiance\" value=\"{value}\"/>");
        let error = with(&light("constant", &key)).unwrap_err().to_string();
        assert!(
            error.contains("line 3: expected two wavelengths"),
            "{error}"
        );
    }
}

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
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n\
         {keys}element face 1\nproperty list uchar int vertex_indices\nend_header\n\
         0 0 0 {normal}\n2 0 0 {normal}\n0 1 0 {normal}\n3 0 1 2\n"
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

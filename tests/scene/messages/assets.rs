//! Messages about volumes and meshes.

use super::*;

#[test]
fn volumes() {
    let raw = |values: &[f32]| -> Vec<u8> { values.iter().flat_map(|v| v.to_le_bytes()).collect() };
    let message = |values: &[f32]| refused(RAW, &[("a.raw", &raw(values))]);
    let (text, hint) = message(&[1.0]);
    assert!(
        text.contains("expected 8 bytes for 2 x 1 x 1 numbers of 4 bytes, found 4"),
        "{text}"
    );
    assert!(hint.contains("dtype"));
    assert!(
        message(&[0.0, f32::NAN])
            .0
            .contains("a.raw: voxel [1, 0, 0]: the value is not finite")
    );
    let (text, hint) = message(&[0.0, -1.0]);
    assert!(text.contains("the density is negative: -1"));
    assert!(hint.contains("window"));

    let nrrd = |header: &str| {
        let text = "[[volume]]\nfile = \"a.nrrd\"\nalbedo = [1, 1, 1]\nsigma_t_scale = 1\n";
        refused(text, &[("a.nrrd", header.as_bytes())]).0
    };
    let head = "NRRD0005\ntype: uint8\ndimension: 3\nsizes: 2 1 1\nencoding: raw\n";
    assert!(nrrd("NRRX").contains("expected NRRD0001 to NRRD0005"));
    assert!(nrrd("NRRD0009\n").contains("found \"NRRD0009\""));
    assert!(nrrd("NRRD0005\nxyz\n\n").contains("line 2: expected `field: value`, found \"xyz\""));
    assert!(nrrd(&head.replace("dimension: 3", "dimension: 4")).contains("found 4"));
    assert!(nrrd(&head.replace("2 1 1", "2 0 1")).contains("sizes: 2 0 1"));
    assert!(nrrd(&head.replace("uint8", "block")).contains("`type: block` is not supported"));
    assert!(nrrd(&head.replace("raw", "jpeg")).contains("`encoding: jpeg` is not supported"));
    assert!(nrrd(&head.replace("uint8", "float")).contains("no `endian`"));
    assert!(nrrd(&format!("{head}\nx")).contains("expected 2 bytes of samples, found 1"));
    assert!(
        nrrd(&head.replace("2 1 1", "99999999 99999999 99999999")).contains("machine can hold")
    );
    assert!(nrrd(&head.replace("2 1 1", "9999 9999 9999")).contains("bytes of samples, found 0"));
    let huge = head
        .replace("2 1 1", "9999 9999 9999")
        .replace("raw", "gzip");
    assert!(nrrd(&format!("{huge}\nxxx")).contains("more than 3 compressed bytes can hold"));
    assert!(nrrd(&format!("{head}data file: no.raw\n")).contains("no.raw is not there"));
    assert!(nrrd(&format!("{head}data file: LIST\n")).contains("expected names of files"));
    assert!(nrrd(&format!("{head}\nxx")).contains("does not say where"));
    let flat = "space directions: (1,0,0) (1,0,0) (0,0,1)\n\nxx";
    assert!(nrrd(&format!("{head}{flat}")).contains("singular"));
}

#[test]
fn meshes() {
    let ply = |header: &str, body: &str| {
        let file = format!("ply\nformat ascii 1.0\n{header}end_header\n{body}");
        refused(
            "[[mesh]]\nfile = \"a.ply\"\n",
            &[("a.ply", file.as_bytes())],
        )
        .0
    };
    let xyz = "element vertex 3\nproperty float x\nproperty float y\nproperty float z\n";
    let faces = "element face 1\nproperty list uchar int vertex_indices\n";
    let both = format!("{xyz}{faces}");
    let body = "0 0 0\n1 0 0\n0 1 0\n";
    assert!(ply(xyz, body).contains("elements `vertex` and `face`"));
    assert!(
        ply(&both, &format!("{body}3 0 1 3\n"))
            .contains("triangle 0 refers to the vertices [0, 1, 3]")
    );
    assert!(
        ply(&both, &format!("{body}3 0 1 -1\n")).contains("face 0 of 1: -1 is not a vertex index")
    );
    assert!(ply(&both, &format!("{body}3 0 1\n")).contains("ends too early"));
    assert!(
        ply(&both, "0 0 nan\n1 0 0\n0 1 0\n3 0 1 2\n")
            .contains("vertex 0: the position is not finite")
    );
    assert!(
        ply(&both, "0 0 z\n0 0 0\n0 0 0\n")
            .contains("vertex 0 of 3: expected a number, found \"z\"")
    );
    assert!(ply(&both, "0 0 0\n0 0 0\n0 0 0\n3 0 1 2\n").contains("zero area"));
    let many = both.replace("vertex 3", "vertex 999999999999");
    assert!(ply(&many, body).contains("promises 999999999999 elements `vertex`"));
    assert!(
        refused("[[mesh]]\nfile = \"a.ply\"\n", &[("a.ply", b"x")])
            .0
            .contains("not a PLY file")
    );

    let obj = |text: &str| {
        refused(
            "[[mesh]]\nfile = \"a.obj\"\n",
            &[("a.obj", text.as_bytes())],
        )
        .0
    };
    assert!(
        obj("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4\n")
            .contains("a.obj: line 4: the corner 4 refers to")
    );
    assert!(
        obj("v 0 0 0\nv 1 0 0\nv 0 inf 0\nf 1 2 3\n")
            .contains("vertex 2: the position is not finite")
    );

    let bright = "newmtl x\nKd 1.5 0 0\n";
    let text = "mtllib m.mtl\nusemtl x\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n";
    let files: [(&str, &[u8]); 2] = [("a.obj", text.as_bytes()), ("m.mtl", bright.as_bytes())];
    let scene = load("[[mesh]]\nfile = \"a.obj\"\n", &files).unwrap();
    assert_eq!(scene.materials[0].albedo, [1.0, 0.0, 0.0]);
    assert!(
        scene.warnings[0].contains("m.mtl: `Kd` outside of [0,1]"),
        "{:?}",
        scene.warnings
    );
}

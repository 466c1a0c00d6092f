//! Surfels of other programs, of which `import` makes clouds.

use super::*;

/// Surfels of a ball that sends 1, 2 and 3, as binary PLY with other numbers between.
fn surfels(count: usize, size: &str, colors: [&str; 3]) -> Vec<u8> {
    let mut random = Random(17);
    let area = 4.0 * PI / count as f32;
    let mut text = format!("ply\nformat binary_big_endian 1.0\nelement vertex {count}\n");
    for name in ["x", "y", "z", "id", "nx", "ny", "nz", size] {
        text += &format!("property float {name}\n");
    }
    for name in colors {
        text += &format!("property double {name}\n");
    }
    let mut file = (text + "end_header\n").into_bytes();
    for i in 0..count {
        let [x, y, z] = random.direction();
        let size = match size {
            "area" => area,
            _ => (area / PI).sqrt(),
        };
        let floats = [x + 50.0, y, z, i as f32, 3.0 * x, 3.0 * y, 3.0 * z, size];
        file.extend(floats.iter().flat_map(|v| v.to_be_bytes()));
        file.extend([1.0_f64, 2.0, 3.0].iter().flat_map(|v| v.to_be_bytes()));
    }
    file
}

#[test]
fn surfels_of_other_programs_become_a_tree() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name);
    let at = DVec3::new(54.0, 0.0, 0.0);
    fs::write(path("at.npy"), npy(&[(at, Some(Vec3::NEG_X))])).unwrap();
    let mut before: Option<Vec<f32>> = None;
    for (size, colors) in [
        ("area", ["r", "g", "b"]),
        ("radius", ["red", "green", "blue"]),
        ("area", ["radiance_r", "radiance_g", "radiance_b"]),
    ] {
        fs::write(path("a.ply"), surfels(20_000, size, colors)).unwrap();
        for args in [
            &["import", "a.ply", "-o", "a.lvc", "--force"][..],
            &["verify", "a.lvc"],
            &["build", "a.lvc", "-o", "a.lvt", "--force"],
            &[
                "gather",
                "a.lvt",
                "at.npy",
                "-o",
                "b.npy",
                "--force",
                "--samples",
                "4096",
            ],
        ] {
            let run = lvox(dir.path(), args);
            assert_eq!(run.code, 0, "{args:?}: {}", run.stderr);
        }
        let told = lvox(dir.path(), &["inspect", "a.lvc"]);
        assert!(told.stdout.contains("imported"), "{}", told.stdout);
        let found = rows(&path("b.npy"), 3).remove(0);
        for (c, light) in found.iter().enumerate() {
            let expected = (c + 1) as f32 * PI / 16.0;
            is_near(*light, expected, 0.06, &format!("{size} {c}"));
        }
        // A disk is that of its area, either way.
        if let Some(before) = &before {
            for (a, b) in before.iter().zip(&found) {
                is_near(*a, *b, 1e-3, size);
            }
        }
        before = Some(found);
    }
}

#[test]
fn points_that_are_no_surfels_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let full = [
        "float x", "float y", "float z", "float nx", "float ny", "float nz",
    ];
    let rgb = ["float r", "float g", "float b"];
    let bytes = ["uchar red", "uchar green", "uchar blue"];
    let text = |names: &[&str], row: &str| {
        let mut text = "ply\nformat ascii 1.0\nelement vertex 2\n".to_owned();
        for name in names {
            text += &format!("property {name}\n");
        }
        text + "end_header\n0 0 0 0 1 0 1 1 1 1\n" + row + "\n"
    };
    let all = [&full[..], &["float area"], &rgb].concat();
    let import = |content: &str, more: &[&str]| {
        fs::write(dir.path().join("a.ply"), content).unwrap();
        let args = [&["import", "a.ply", "-o", "a.lvc"], more].concat();
        lvox(dir.path(), &args)
    };
    let size = text(&[&full[..], &rgb].concat(), "0 0 0 0 1 0 1 1 1 1");
    import(&size, &[]).refused(2, &["a.ply", "`radius` or `area`"]);
    let light = text(
        &[&full[..], &["float area"]].concat(),
        "0 0 0 0 1 0 1 1 1 1",
    );
    import(&light, &[]).refused(2, &["a.ply", "radiance"]);
    let normals = text(
        &[&full[..3], &["float area"], &rgb].concat(),
        "0 0 0 0 1 0 1 1 1 1",
    );
    import(&normals, &[]).refused(2, &["a.ply", "normals"]);
    let shorts = text(
        &[&full[..], &["float area", "short r", "short g", "short b"]].concat(),
        "0 0 0 0 1 0 1 1 1 1",
    );
    import(&shorts, &[]).refused(2, &["floats or bytes"]);
    for (row, says) in [
        ("0 0 0 0 0 0 1 1 1 1", "normal of a length"),
        ("0 inf 0 0 1 0 1 1 1 1", "position"),
        ("0 0 0 0 1 0 0 1 1 1", "`area` above 0"),
        ("0 0 0 0 1 0 1e-44 1 1 1", "`area` above 0"),
        ("0 0 0 0 1 0 1 -1 1 1", "radiance of 0 or more"),
        ("0 0 0 0 1 0 1 1 1e39 1", "radiance of 0 or more"),
        ("0 0 0 0 1 0 1 1          ", "truncated"),
    ] {
        import(&text(&all, row), &[]).refused(2, &["a.ply: vertex 1", says]);
    }
    assert_eq!(crate::support::names(dir.path()), ["a.ply"]);
    // Bytes are told of.
    let colored = text(
        &[&full[..], &["float area"], &bytes].concat(),
        "1 0 0 0 1 0 1 9 9 9",
    );
    import(&colored, &["--strict"]).refused(2, &["are bytes", "sRGB"]);
    let run = import(&colored, &[]);
    assert!(
        run.code == 0 && run.stderr.contains("warning: "),
        "{}",
        run.stderr
    );
}

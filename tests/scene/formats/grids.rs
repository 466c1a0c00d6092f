//! Volumes of NRRD and raw files.

use super::*;

#[test]
fn nrrd_in_every_type_order_and_encoding_is_the_same() {
    let volume = "[[volume]]\nfile = \"a.nrrd\"\nsigma_t_scale = 0.5\nalbedo = [0.5, 0.5, 0.5]\n";
    type Encode = fn(u8) -> Vec<u8>;
    let types: [(&str, &str, Encode); 10] = [
        ("uint8", "little", |v| vec![v]),
        ("signed char", "little", |v| vec![v]),
        ("uint16", "little", |v| u16::from(v).to_le_bytes().to_vec()),
        ("ushort", "big", |v| u16::from(v).to_be_bytes().to_vec()),
        ("short", "big", |v| i16::from(v).to_be_bytes().to_vec()),
        ("uint32", "little", |v| u32::from(v).to_le_bytes().to_vec()),
        ("int", "big", |v| i32::from(v).to_be_bytes().to_vec()),
        ("float", "little", |v| f32::from(v).to_le_bytes().to_vec()),
        ("float", "big", |v| f32::from(v).to_be_bytes().to_vec()),
        ("double", "big", |v| f64::from(v).to_be_bytes().to_vec()),
    ];
    for (name, endian, encode) in types {
        for encoding in ["raw", "gzip"] {
            for detached in [false, true] {
                let mut data: Vec<u8> = values().flat_map(encode).collect();
                if encoding == "gzip" {
                    let mut gzip = GzEncoder::new(Vec::new(), Compression::default());
                    gzip.write_all(&data).unwrap();
                    data = gzip.finish().unwrap();
                }
                let place = if detached { "data file: a.dat\n" } else { "" };
                let mut file = format!(
                    "NRRD0004\r\n# comment\ntype: {name}\ndimension: 3\nsizes: 4 3 2\nkey:=value\n\
                     space directions: (0,2,0) (-2,0,0) (0,0,2)\nspace origin: (10,0,0)\n\
                     endian: {endian}\nencoding: {encoding}\n{place}\n"
                )
                .into_bytes();
                if !detached {
                    file.extend(&data);
                }
                let files: [(&str, &[u8]); 2] = [("a.nrrd", &file), ("a.dat", &data)];
                let scene = load(volume, &files).unwrap();
                assert_eq!(scene.volumes[0].sigma_t.dims(), [4, 3, 2]);
                for (i, value) in values().enumerate() {
                    let [x, y, z] = [i % 4, i / 4 % 3, i / 12].map(|n| n as f64);
                    let world = DVec3::new(10.0 - 2.0 * y, 2.0 * x, 2.0 * z);
                    let found = sample(&scene, world);
                    let expected = 0.5 * f32::from(value);
                    assert!((found - expected).abs() < 1e-4, "{name} {encoding} {world}");
                }
            }
        }
    }
}

#[test]
fn nrrd_without_directions_is_placed_by_what_it_has() {
    let volume = "[[volume]]\nfile = \"a.nrrd\"\nsigma_t_scale = 1\nalbedo = [0.5, 0.5, 0.5]\n";
    let load_with = |place: &str| {
        let head = "NRRD0004\ntype: uint8\ndimension: 3\nsizes: 4 3 2\nencoding: raw\n";
        let mut file = format!("{head}{place}\n\n").into_bytes();
        file.extend(values());
        load(volume, &[("a.nrrd", &file)])
    };
    // Where the centres of the first voxel and of its neighbours are.
    for (place, first, step) in [
        ("spacings: 1 2 4", [0.0; 3], [1.0, 2.0, 4.0]),
        (
            "spacings: 1 2 4\nspace dimension: 3\nspace origin: (10,20,-30)",
            [10.0, 20.0, -30.0],
            [1.0, 2.0, 4.0],
        ),
        (
            "spacings: 1 2 4\naxis mins: 10 20 -30",
            [10.5, 21.0, -28.0],
            [1.0, 2.0, 4.0],
        ),
        (
            "spacings: 1 2 4\naxis mins: 10 20 -30\ncenters: node node cell",
            [10.0, 20.0, -28.0],
            [1.0, 2.0, 4.0],
        ),
        (
            "spacings: 1 2 4\naxis maxs: 14 26 -22\naxis mins: nan nan nan",
            [10.5, 21.0, -28.0],
            [1.0, 2.0, 4.0],
        ),
        (
            "axis mins: 10 20 -30\naxis maxs: 14 26 -22",
            [10.5, 21.0, -28.0],
            [1.0, 2.0, 4.0],
        ),
        (
            "axis mins: 10 20 -30\naxis maxs: 13 24 -26\ncenterings: node node node",
            [10.0, 20.0, -30.0],
            [1.0, 2.0, 4.0],
        ),
    ] {
        let scene = load_with(place).unwrap();
        for (i, value) in values().enumerate() {
            let at = DVec3::new((i % 4) as f64, (i / 4 % 3) as f64, (i / 12) as f64);
            let world = DVec3::from(first) + at * DVec3::from(step);
            let found = sample(&scene, world);
            assert!(
                (found - f32::from(value)).abs() < 1e-3,
                "{place}: {world} {found}"
            );
        }
    }
    for (place, part) in [
        ("axis mins: 1 2 3", "does not say where"),
        ("space origin: (1,2,3)", "does not say where"),
        ("axis mins: 1 2\nspacings: 1 1 1", "`axis mins: 1 2`"),
        ("axis mins: 1 2 3\naxis maxs: 1 3 4", "other than 0"),
        (
            "spacings: 1 1 1\ncenters: cell edge cell",
            "`cell` or `node`",
        ),
    ] {
        let message = load_with(place).unwrap_err().to_string();
        assert!(message.contains(part), "{place}: {message}");
    }
}

#[test]
fn raw_volumes_take_every_placement() {
    let raw: Vec<u8> = values().collect();
    let head =
        "[[volume]]\nfile = \"a.raw\"\ndims = [4, 3, 2]\ndtype = \"u8\"\nalbedo = [1, 0.5, 0]\n";
    let volume = |more: &str| load(&format!("{head}{more}"), &[("a.raw", &raw)]).unwrap();

    let unit = "unitcube_to_world = [[4, 0, 0, 0], [0, 3, 0, 0], [0, 0, 2, 0], [0, 0, 0, 1]]";
    let scene = volume(&format!("sigma_t_scale = 1\nvalue_scale = 2\n{unit}"));
    assert_eq!(sample(&scene, DVec3::new(1.5, 2.5, 1.5)), 2.0 * 21.0);
    assert_eq!(scene.volumes[0].albedo, [1.0, 0.5, 0.0]);

    let index = "world_from_index = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]";
    let scene = volume(&format!("sigma_t_scale = 10\nwindow = [10, 20]\n{index}"));
    assert_eq!(
        sample(&scene, DVec3::new(1.0, 2.0, 1.0)),
        10.0,
        "21 is above the window"
    );
    assert_eq!(
        sample(&scene, DVec3::new(3.0, 2.0, 0.0)),
        1.0,
        "11 is a tenth into it"
    );
    assert_eq!(sample(&scene, DVec3::new(1.0, 0.0, 0.0)), 0.0);
    assert_eq!(
        sample(&scene, DVec3::new(3.51, 2.0, 0.0)),
        0.0,
        "outside the box"
    );

    let scene = volume(&format!(
        "sigma_t_scale = 1\ntranslate = [100, 0, 0]\nscale = 2\n{index}"
    ));
    assert!((sample(&scene, DVec3::new(102.0, 4.0, 2.0)) - 21.0).abs() < 1e-3);
    assert!(scene.world_from_scene.x > 90.0, "far away for its size");
}

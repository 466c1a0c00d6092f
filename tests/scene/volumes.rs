//! One volume in files of several kinds, and what a scene file makes of it.

use crate::{Folder, load};
use flate2::{Compression, read::GzDecoder, write::GzEncoder};
use glam::{DMat3, DVec3};
use lvox::scene::{Scene, Volume};
use std::fs;
use std::io::{Read, Write};
use std::path::Path;

use crate::support::skip::shared;

/// Where a file says that voxels are: directions of the axes and the centre of the first voxel, in
/// left, posterior, superior of a patient.
#[derive(Clone, Copy)]
pub struct Place {
    axes: DMat3,
    first: DVec3,
}

impl Place {
    /// As a scanner may have it: a turned head in slices of twice the height.
    pub fn turned() -> Self {
        let axes = DMat3::from_cols(
            DVec3::new(0.8, 0.6, 0.0),
            DVec3::new(-0.6, 0.8, 0.0),
            DVec3::new(0.25, 0.0, 2.0),
        );
        let first = DVec3::new(-1.0, 5.0, 70.0);
        Self { axes, first }
    }

    fn text(self, separator: &str) -> [String; 4] {
        let words = |v: DVec3| v.to_array().map(|x| x.to_string()).join(separator);
        [
            self.axes.x_axis,
            self.axes.y_axis,
            self.axes.z_axis,
            self.first,
        ]
        .map(words)
    }
}

/// A NIfTI file of floats, with `sform`.
pub fn nifti(dims: [usize; 3], values: &[f32], place: Place) -> Vec<u8> {
    let mut file = vec![0; 352];
    let mut put = |at: usize, bytes: &[u8]| file[at..at + bytes.len()].copy_from_slice(bytes);
    put(0, &348_i32.to_le_bytes());
    put(40, &3_i16.to_le_bytes());
    for (i, n) in dims.iter().enumerate() {
        put(42 + 2 * i, &(*n as i16).to_le_bytes());
    }
    put(70, &16_i16.to_le_bytes());
    put(72, &32_i16.to_le_bytes());
    put(108, &352_f32.to_le_bytes());
    put(254, &1_i16.to_le_bytes());
    let Place { axes, first } = place;
    for row in 0..3 {
        // From left and posterior to right and anterior.
        let sign = if row < 2 { -1.0 } else { 1.0 };
        for (i, column) in [axes.x_axis, axes.y_axis, axes.z_axis, first]
            .into_iter()
            .enumerate()
        {
            let value = (sign * column[row]) as f32;
            put(280 + 16 * row + 4 * i, &value.to_le_bytes());
        }
    }
    put(344, b"n+1\0");
    file.extend(values.iter().flat_map(|v| v.to_le_bytes()));
    file
}

/// The head of a MetaImage file of floats, up to the name of the data.
fn metaimage(dims: [usize; 3], place: Place) -> String {
    let lengths = [
        place.axes.x_axis.length(),
        place.axes.y_axis.length(),
        place.axes.z_axis.length(),
    ];
    let directions = Place {
        axes: place.axes * DMat3::from_diagonal(DVec3::from(lengths).recip()),
        ..place
    };
    let [x, y, z, first] = directions.text(" ");
    format!(
        "ObjectType = Image\nNDims = 3\nBinaryData = True\nBinaryDataByteOrderMSB = False\n\
         CompressedData = False\nTransformMatrix = {x} {y} {z}\nOffset = {first}\n\
         CenterOfRotation = 0 0 0\nAnatomicalOrientation = RAI\nElementSpacing = {}\nDimSize = {}\n\
         ElementType = MET_FLOAT\nElementDataFile = ",
        lengths.map(|v| v.to_string()).join(" "),
        dims.map(|n| n.to_string()).join(" "),
    )
}

/// The head of a NRRD file of floats in left, posterior, superior.
fn nrrd(dims: [usize; 3], place: Place) -> String {
    let [x, y, z, first] = place.text(",");
    format!(
        "NRRD0004\ntype: float\ndimension: 3\nspace: left-posterior-superior\nsizes: {}\n\
         space directions: ({x}) ({y}) ({z})\nspace origin: ({first})\nendian: little\n\
         encoding: raw\n",
        dims.map(|n| n.to_string()).join(" "),
    )
}

fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut packed = GzEncoder::new(Vec::new(), Compression::fast());
    packed.write_all(bytes).unwrap();
    packed.finish().unwrap()
}

/// One volume as files of every kind.
fn files(dims: [usize; 3], values: &[f32], place: Place) -> Vec<(&'static str, Vec<u8>)> {
    let data: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
    let attached = |head: String| [head.as_bytes(), &data].concat();
    let nifti = nifti(dims, values, place);
    vec![
        ("a.nrrd", attached(nrrd(dims, place) + "\n")),
        (
            "a.nhdr",
            format!("{}data file: a.raw\n", nrrd(dims, place)).into(),
        ),
        ("a.mha", attached(metaimage(dims, place) + "LOCAL\n")),
        ("a.mhd", (metaimage(dims, place) + "a.raw\n").into()),
        ("a.nii.gz", gzip(&nifti)),
        ("a.nii", nifti),
        ("a.raw", data),
    ]
}

/// The scene of a volume file.
fn scene(folder: &Folder, file: &str, more: &str) -> Scene {
    let text = format!(
        "[[volume]]\nfile = \"{file}\"\nsigma_t_scale = 1\nalbedo = [0.5, 0.5, 0.5]\n{more}\n"
    );
    folder.load(&text).unwrap()
}

/// How far two volumes lie apart at the corners of their box.
fn apart(a: &Volume, b: &Volume) -> f32 {
    let corners = a.corners().into_iter().zip(b.corners());
    corners.map(|(a, b)| a.distance(b)).fold(0.0, f32::max)
}

#[test]
fn a_volume_is_the_same_from_every_kind_of_file() {
    let dims = [4, 3, 2];
    let values: Vec<f32> = (0..24).map(|i| i as f32).collect();
    let files = files(dims, &values, Place::turned());
    let all: Vec<(&str, &[u8])> = files.iter().map(|(n, c)| (*n, &c[..])).collect();
    let folder = Folder::new(&all);
    let first = scene(&folder, "a.nrrd", "");
    for name in ["a.nhdr", "a.mha", "a.mhd", "a.nii.gz", "a.nii"] {
        for more in ["", "up = \"y\"", "up = \"z\"", "scale = 2"] {
            let first = scene(&folder, "a.nrrd", more);
            let other = scene(&folder, name, more);
            let (a, b) = (&first.volumes[0], &other.volumes[0]);
            assert_eq!(*a.sigma_t, *b.sigma_t, "{name}");
            let apart = apart(a, b);
            assert!(apart < 1e-4, "{name} {more}: {apart}");
        }
    }
    // The last slice is the highest, and the patient's left is at x.
    let world = |voxel: [f64; 3]| {
        let p = DVec3::from(voxel) + 0.5;
        first.volumes[0].scene_from_index.transform_point3(p) + first.world_from_scene
    };
    let near = |p: DVec3, q: [f64; 3]| (p - DVec3::from(q)).length() < 1e-6;
    assert!(near(world([0.0; 3]), [-1.0, 70.0, -5.0]));
    assert!(near(world([0.0, 0.0, 1.0]), [-0.75, 72.0, -5.0]));
    assert!(near(world([1.0, 0.0, 0.0]), [-0.2, 70.0, -5.6]));
    // As the file has it, and with its z up.
    let plain = scene(&folder, "a.nrrd", "up = \"y\"");
    let p = plain.volumes[0]
        .scene_from_index
        .transform_point3(DVec3::splat(0.5));
    assert!(near(p + plain.world_from_scene, [-1.0, 5.0, 70.0]));
    let upright = scene(&folder, "a.nrrd", "up = \"z\"");
    assert_eq!(apart(&first.volumes[0], &upright.volumes[0]), 0.0);
}

#[test]
fn what_has_z_up_is_turned_on_request_alone() {
    let dims = [4, 3, 2];
    let head = nrrd(dims, Place::turned()).replace("space: left-posterior-superior\n", "");
    let data = [1; 4 * 24];
    let file = [(head + "\n").as_bytes(), &data].concat();
    let folder = Folder::new(&[("a.nrrd", &file)]);
    let corner = |more: &str| {
        let scene = scene(&folder, "a.nrrd", more);
        let p = scene.volumes[0]
            .scene_from_index
            .transform_point3(DVec3::splat(0.5));
        (p + scene.world_from_scene).round().to_array()
    };
    assert_eq!(corner(""), [-1.0, 5.0, 70.0]);
    assert_eq!(corner("up = \"y\""), [-1.0, 5.0, 70.0]);
    assert_eq!(corner("up = \"z\""), [-1.0, 70.0, -5.0]);
    let text = "[[volume]]\nfile = \"a.nrrd\"\nsigma_t_scale = 1\nalbedo = [1, 1, 1]\n";
    for (more, says) in [
        ("up = \"x\"", "expected one of y, z, found \"x\""),
        (
            "up = \"z\"\nworld_from_index = [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]",
            "`world_from_index` and `up` exclude each other",
        ),
    ] {
        let error = load(&format!("{text}{more}\n"), &[("a.nrrd", &file)]).unwrap_err();
        assert!(error.to_string().contains(says), "{error}");
    }
}

/// The samples of an attached NRRD of 64^3 gzip 16-bit numbers.
fn samples(path: &Path) -> Vec<f32> {
    let content = fs::read(path).unwrap();
    let end = content.windows(2).position(|w| w == b"\n\n").unwrap() + 2;
    let mut data = Vec::new();
    GzDecoder::new(&content[end..])
        .read_to_end(&mut data)
        .unwrap();
    let numbers = data
        .chunks_exact(2)
        .map(|b| u16::from_le_bytes([b[0], b[1]]));
    numbers.map(f32::from).collect()
}

#[test]
fn a_head_is_the_same_from_every_kind_of_file() {
    let Some(data) = shared("data/head_ct_64.nrrd") else {
        return;
    };
    let values = samples(&data);
    // That file has the crown along y and the nose along z.
    let place = Place {
        axes: DMat3::from_cols(
            DVec3::new(4.0, 0.0, 0.0),
            DVec3::new(0.0, 0.0, 3.53125),
            DVec3::new(0.0, -4.0, 0.0),
        ),
        first: DVec3::new(-126.0, 126.0, -111.234375),
    };
    let files = files([64; 3], &values, place);
    let all: Vec<(&str, &[u8])> = files.iter().map(|(n, c)| (*n, &c[..])).collect();
    let folder = Folder::new(&all);
    fs::copy(&data, folder.path("head.nrrd")).unwrap();
    let window = "window = [600, 2000]";
    let first = scene(&folder, "head.nrrd", window);
    for name in ["a.nrrd", "a.mha", "a.mhd", "a.nii.gz", "a.nii"] {
        let other = scene(&folder, name, window);
        let (a, b) = (&first.volumes[0], &other.volumes[0]);
        assert_eq!(*a.sigma_t, *b.sigma_t, "{name}");
        assert!(apart(a, b) < 1e-3, "{name}");
    }
}

/// A NRRD file of bytes that is 1 unit of voxels wide.
fn bytes(dims: [usize; 3], values: &[u8]) -> Vec<u8> {
    let head = format!(
        "NRRD0004\ntype: uint8\ndimension: 3\nsizes: {}\nspacings: 1 1 1\nencoding: raw\n\n",
        dims.map(|n| n.to_string()).join(" "),
    );
    [head.as_bytes(), values].concat()
}

const TISSUE: &str = "[[volume]]\nfile = \"a.nrrd\"\nsigma_t_scale = 2\nalbedo = [1, 1, 1]\n";

#[test]
fn a_curve_maps_each_voxel() {
    let values: Vec<u8> = (0..8 * 9 * 10).map(|i| (i % 251) as u8).collect();
    let file = bytes([8, 9, 10], &values);
    let load = |more: &str| load(&format!("{TISSUE}{more}\n"), &[("a.nrrd", &file)]);
    let window = load("window = [50, 150]").unwrap();
    let curve = load("curve = [[50, 0], [150, 1]]").unwrap();
    assert_eq!(*window.volumes[0].sigma_t, *curve.volumes[0].sigma_t);
    // Only what lies between two values is there.
    let tent = load("curve = [[100, 0], [110, 0.5], [120, 0]]").unwrap();
    let at = |i: usize| {
        let p = glam::Vec3::new((i % 8) as f32, (i / 8 % 9) as f32, (i / 72) as f32);
        tent.volumes[0].sigma_t.sample(p + 0.5)
    };
    for (i, &value) in values.iter().enumerate() {
        let expected = (1.0 - (f32::from(value) - 110.0).abs() / 10.0).max(0.0);
        assert!((at(i) - expected).abs() < 1e-6, "{value}: {}", at(i));
    }
    for (more, says) in [
        (
            "curve = [[0, 0]]",
            "expected two points of value and density or more, found 1",
        ),
        (
            "curve = [[0, 0], [9, 1], [8, 2]]",
            "expected values that rise, found 8 after 9",
        ),
        (
            "curve = [[0, 0], [9, -1]]",
            "expected densities from 0 to 1e30, found -1",
        ),
        ("curve = [[0, 0], [9, nan]]", "expected a finite number"),
        (
            "curve = [[0, 0], [9]]",
            "expected 2 numbers in brackets, found 1",
        ),
        (
            "curve = 4",
            "expected points, as [[value, density], [value, density]]",
        ),
        (
            "curve = [[0, 0], [9, 1]]\nwindow = [0, 1]",
            "`window` and `curve` exclude each other",
        ),
        (
            "value_scale = 2\ncurve = [[0, 0], [9, 1]]",
            "exclude each other",
        ),
    ] {
        let error = load(more).unwrap_err();
        assert!(error.to_string().contains(says), "{error}");
        assert_eq!(error.kind(), lvox::Kind::Input);
    }
}

#[test]
fn tissues_of_one_file_read_it_once() {
    let file = bytes([2, 2, 2], &[0, 10, 20, 30, 40, 50, 60, 70]);
    let tissue = |curve: &str, albedo: f32| {
        format!(
            "[[volume]]\nfile = \"a.nrrd\"\nsigma_t_scale = 1\nalbedo = [{albedo}, 0.5, 0.5]\n\
             curve = {curve}\n"
        )
    };
    let (skin, bone) = ("[[0, 0], [20, 1], [40, 0]]", "[[20, 0], [40, 3]]");
    let both = tissue(skin, 0.9) + &tissue(bone, 0.1);
    let scene = load(&both, &[("a.nrrd", &file)]).unwrap();
    assert_eq!(scene.files.len(), 2, "{:?}", scene.files);
    for (i, (curve, albedo)) in [(skin, 0.9), (bone, 0.1)].into_iter().enumerate() {
        let alone = load(&tissue(curve, albedo), &[("a.nrrd", &file)]).unwrap();
        assert_eq!(*scene.volumes[i].sigma_t, *alone.volumes[0].sigma_t);
        assert_eq!(scene.volumes[i].albedo, [albedo, 0.5, 0.5]);
    }
    // Of a crop and the whole, too.
    let cropped = tissue(skin, 0.9) + "crop = { min = [0.5, 0, 0] }\n" + &tissue(bone, 0.1);
    let scene = load(&cropped, &[("a.nrrd", &file)]).unwrap();
    assert_eq!(scene.files.len(), 2);
    assert_eq!(scene.volumes[0].sigma_t.dims(), [1, 2, 2]);
    assert_eq!(scene.volumes[1].sigma_t.dims(), [2, 2, 2]);
}

#[test]
fn a_crop_leaves_voxels_where_they_are() {
    let values: Vec<u8> = (0..6 * 4 * 4).map(|i| i as u8 + 1).collect();
    let file = bytes([6, 4, 4], &values);
    let place = "unitcube_to_world = [[6,0,0,0],[0,4,0,0],[0,0,4,0],[0,0,0,1]]";
    for place in [
        "",
        place,
        "world_from_index = [[1,0,0,0.5],[0,1,0,0.5],[0,0,1,0.5],[0,0,0,1]]",
    ] {
        let load = |more: &str| load(&format!("{TISSUE}{place}\n{more}\n"), &[("a.nrrd", &file)]);
        let (whole, part) = (
            load("").unwrap(),
            load("crop = { min = [0.5, 0, 0.25], max = [1, 0.75, 1] }").unwrap(),
        );
        let (whole, part) = (&whole.volumes[0], &part.volumes[0]);
        assert_eq!(part.sigma_t.dims(), [3, 3, 3]);
        for voxel in [[3.5, 0.5, 1.5], [5.5, 2.5, 3.5]] {
            let world = whole.scene_from_index.transform_point3(DVec3::from(voxel));
            let sample = |v: &Volume| {
                v.sigma_t
                    .sample(v.index_from_scene.transform_point3(world.as_vec3()))
            };
            assert!(
                (sample(whole) - sample(part)).abs() < 1e-3,
                "{place} {voxel:?}"
            );
        }
    }
    for (more, says) in [
        (
            "crop = { min = [0, 0, 1], max = [1, 1, 0.5] }",
            "with 0 <= min < max <= 1 along each axis, found 1 and 0.5",
        ),
        ("crop = { max = [1, 1, 64] }", "found 0 and 64"),
        (
            "crop = { from = [0, 0, 0] }",
            "unknown key `from` in `crop`",
        ),
        (
            "crop = { min = [0.26, 0, 0], max = [0.3, 1, 1] }",
            "no centre of a voxel is in the box",
        ),
    ] {
        let error = load(&format!("{TISSUE}{more}\n"), &[("a.nrrd", &file)]).unwrap_err();
        assert!(error.to_string().contains(says), "{error}");
    }
}

#[test]
fn names_of_presets_have_the_number_of_the_frame() {
    let preset = include_bytes!("../../examples/ct/tissue.vp.json");
    let values: Vec<u8> = (0..64).map(|i| 4 * i).collect();
    let file = bytes([4, 4, 4], &values);
    let folder = crate::Folder::new(&[("a.nrrd", &file), ("t.0007.vp.json", preset)]);
    let path = folder.path("scene.toml");
    let text = "[[volume]]\nfile = \"a.nrrd\"\ntransfer = \"t.####.vp.json\"\n";
    std::fs::write(&path, text).unwrap();
    let load = |frame| {
        let settings = lvox::scene::load::Settings {
            frame,
            ..Default::default()
        };
        Scene::load_with(&path, &settings, &lvox::run::Job::default())
    };
    let scene = load(Some(7)).unwrap();
    assert!(scene.volumes.len() > 1 && scene.files_of_frame == Some(7));
    let error = load(Some(8)).unwrap_err().to_string();
    assert!(error.contains("t.0008.vp.json"), "{error}");
    let error = load(None).unwrap_err().to_string();
    assert!(
        error.contains("####") && error.contains("no frame"),
        "{error}"
    );
}

#[test]
fn a_preset_makes_media_of_one_file() {
    let preset = include_bytes!("../../examples/ct/tissue.vp.json");
    let values: Vec<u8> = (0..64).map(|i| 4 * i).collect();
    let file = bytes([4, 4, 4], &values);
    let files: [(&str, &[u8]); 2] = [("a.nrrd", &file), ("t.vp.json", preset)];
    let load = |more: &str| {
        let text = format!("[[volume]]\nfile = \"a.nrrd\"\ntransfer = \"t.vp.json\"\n{more}\n");
        load(&text, &files)
    };
    let scene = load("").unwrap();
    assert!(scene.volumes.len() > 1 && scene.volumes.len() <= 5);
    assert_eq!(scene.files.len(), 3);
    let told = scene
        .notes
        .iter()
        .any(|n| n.contains("albedos are off by at most"));
    assert!(told, "{:?}", scene.notes);
    // A picture of it at another size is the same picture.
    let depth = |scene: &Scene| {
        let volume = &scene.volumes[1];
        volume.sigma_t.max() * volume.longest_voxel_edge()
    };
    let plain = depth(&scene);
    for (more, factor) in [("scale = 0.01", 1.0), ("sigma_t_scale = 3", 3.0)] {
        let found = depth(&load(more).unwrap());
        assert!(
            (found / plain - factor).abs() < 1e-4,
            "{more}: {found} {plain}"
        );
    }
    for (more, says) in [
        (
            "albedo = [1, 1, 1]",
            "`albedo` and `transfer` exclude each other",
        ),
        (
            "window = [0, 1]",
            "`window` and `transfer` exclude each other",
        ),
        ("curve = [[0, 0], [1, 1]]", "exclude each other"),
    ] {
        let error = load(more).unwrap_err();
        assert!(error.to_string().contains(says), "{error}");
    }
}

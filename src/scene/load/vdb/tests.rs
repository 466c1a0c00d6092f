//! Files written here, byte by byte, in all the ways that are read.

mod colors;
mod real;
#[path = "../../../../tests/support/skip.rs"]
mod skip;
mod spec;

use super::super::left_out::tell_left_grids;
use super::super::scale::{Density, Scale};
use super::blosc::tests::pack;
use super::*;
use crate::run::Cancel;
use crate::scene::grid::{Grid, VoxelBox};
use flate2::{Compression, write::ZlibEncoder};
use spec::{
    Spec, VECTOR, doubles, file, file_with_instances, is_active, text, uniform_scale, value,
};
use std::io::Write;

const SCALE: Scale = Scale {
    sigma_t: 1.0,
    density: Density::Value,
};

fn load(content: &[u8]) -> Result<Field> {
    let mut fields = read(
        content.to_vec(),
        Path::new("x.vdb"),
        Wanted::Density,
        None,
        &mut Files::default(),
    )?;
    fields.pop().ok_or_else(|| Error::input("nothing in it"))
}

/// The same with warnings.
fn load_all(content: &[u8], wanted: Option<&str>) -> (Vec<Field>, Vec<String>) {
    let mut files = Files::default();
    let fields = read(
        content.to_vec(),
        Path::new("x.vdb"),
        wanted.into(),
        None,
        &mut files,
    )
    .unwrap();
    tell_left_grids(&mut files);
    (fields, files.warnings)
}

fn message(content: &[u8]) -> String {
    match load(content) {
        Ok(_) => "no error".into(),
        Err(e) => e.to_string(),
    }
}

#[test]
fn every_encoding_gives_the_same_voxels() {
    for version in [220, 222, 223, 224, 225, 226] {
        for compression in [0, 1, 2, 3, 4, 6] {
            if version < 222 && compression > 1 {
                continue;
            }
            let kinds = [
                (false, "Tree_float_5_4_3"),
                (true, "Tree_float_5_4_3"),
                (true, "Tree_half_5_4_3"),
            ];
            for (half, kind) in kinds {
                let spec = Spec {
                    version,
                    compression,
                    half,
                    kind: kind.into(),
                    ..Spec::default()
                };
                let field = load(&spec.file()).unwrap();
                assert_eq!(field.padding, 1);
                assert_eq!(field.first, [-1; 3]);
                assert_eq!(field.dims, [130; 3]);
                for &slot in &spec.leaves {
                    let corner = [slot >> 8, slot >> 4 & 15, slot & 15].map(|i| i * 8);
                    for offset in 0..512 {
                        let inside = [offset >> 6, offset >> 3 & 7, offset & 7];
                        let voxel = std::array::from_fn(|a| corner[a] + inside[a] + 1);
                        let expected = if is_active(offset) {
                            value(slot, offset)
                        } else {
                            0.0
                        };
                        assert_eq!(field.value(voxel), expected, "{version} {compression}");
                    }
                }
                let p = (field.world_from_file.unwrap()).transform_point3(DVec3::ONE);
                assert_eq!(p, DVec3::splat(0.5));
            }
        }
    }
}

#[test]
fn the_field_is_zero_around_and_placed_by_voxel_centres() {
    let field = load(&Spec::default().file()).unwrap();
    let world_from_grid = field.world_from_file.unwrap() * field.file_from_grid();
    let grid_from_world = world_from_grid.inverse();
    let expected = value(0, 0);
    let grid = field
        .grid(&SCALE, Path::new("x"), &mut Files::default())
        .unwrap();
    let at = |p: DVec3| grid.sample(grid_from_world.transform_point3(p).as_vec3());
    assert_eq!(at(DVec3::ZERO), expected, "voxel (0,0,0) is at the origin");
    let edge = at(DVec3::new(-0.25, 0.0, 0.0));
    assert_eq!(edge, 0.5 * expected, "half way to the padding");
    assert_eq!(at(DVec3::new(-0.5, 0.0, 0.0)), 0.0);
}

#[test]
fn regions_unpack_what_single_voxels_are() {
    // Leaves and tiles that bricks and regions cut at any place.
    let spec = Spec {
        origin: [-4096, 8192, 0],
        leaves: vec![0, 1, 16, 17, 256, 2184, 2185, 4095],
        tile_8: Some((273, 0.75)),
        tile_128: Some((1, 2.0)),
        compression: 6,
        ..Spec::default()
    };
    let content = spec.file();
    for window in [None, Some([0.4, 1.2]), Some([-1.0, 3.0])] {
        let scale = Scale {
            sigma_t: 2.0,
            density: window.map_or(Density::Value, Density::Window),
        };
        let field = load(&content).unwrap();
        let whole = VoxelBox {
            first: [0; 3],
            dims: field.dims,
        };
        let extinction = |value: f32| match window {
            None => 2.0 * value,
            Some([low, high]) => {
                let t = (f64::from(value) - low) / (high - low);
                (2.0 * t.clamp(0.0, 1.0)) as f32
            }
        };
        let voxels = whole.voxels().map(|v| (v, extinction(field.value(v))));
        let plain = Grid::sparse(field.dims, voxels.filter(|(_, s)| *s != 0.0)).unwrap();
        let grid = field.grid(&scale, Path::new("x"), &mut Files::default());
        let grid = grid.unwrap();
        for b in plain.bricks() {
            let brick = |g: &Grid| g.brick(b).map(|b| (b.samples().to_vec(), b.max));
            assert_eq!(brick(&grid), brick(&plain), "{window:?} {b:?}");
        }
    }
}

#[test]
fn tiles_are_filled_and_negative_indices_work() {
    let spec = Spec {
        origin: [-4096, 0, -4096],
        leaves: vec![0],
        tile_8: Some((1, 0.75)),
        tile_128: Some((1, 2.0)),
        compression: 2,
        ..Spec::default()
    };
    let field = load(&spec.file()).unwrap();
    assert_eq!(field.first, [-4097, -1, -4097]);
    assert_eq!(field.dims, [130, 130, 258]);
    assert_eq!(
        field.value([1, 1, 1 + 8]),
        0.75,
        "slot 1 is the next leaf along z"
    );
    assert_eq!(field.value([8, 8, 1 + 15]), 0.75);
    assert_eq!(field.value([9, 8, 1 + 15]), 0.0);
    assert_eq!(field.value([1, 1, 1 + 128]), 2.0);
    assert_eq!(field.value([128, 128, 256]), 2.0);
    assert_eq!(field.value([129, 128, 256]), 0.0);
}

#[test]
fn all_affine_maps_are_read() {
    let maps: [(Vec<u8>, [f64; 3]); 4] = [
        (
            [text("TranslationMap"), doubles(&[1.0, 2.0, 3.0])].concat(),
            [2.0, 4.0, 6.0],
        ),
        (
            [
                text("ScaleMap"),
                doubles(&[2.0, 3.0, 4.0]),
                doubles(&[0.0; 12]),
            ]
            .concat(),
            [2.0, 6.0, 12.0],
        ),
        (
            [
                text("ScaleTranslateMap"),
                doubles(&[1.0, 0.0, 0.0, 2.0, 3.0, 4.0]),
                doubles(&[0.0; 12]),
            ]
            .concat(),
            [3.0, 6.0, 12.0],
        ),
        (
            // A quarter turn about z, for row vectors.
            [
                text("AffineMap"),
                doubles(&[0.0, 1.0, 0.0, 0.0]),
                doubles(&[-1.0, 0.0, 0.0, 0.0]),
                doubles(&[0.0, 0.0, 1.0, 0.0]),
                doubles(&[5.0, 0.0, 0.0, 1.0]),
            ]
            .concat(),
            [3.0, 1.0, 3.0],
        ),
    ];
    for (map, expected) in maps {
        let spec = Spec {
            map,
            ..Spec::default()
        };
        let field = load(&spec.file()).unwrap();
        let p = (field.world_from_file.unwrap()).transform_point3(DVec3::new(1.0, 2.0, 3.0));
        assert_eq!(p.to_array(), expected);
    }
}

#[test]
fn grids_are_chosen_by_name() {
    let spec = Spec::default();
    let other = Spec {
        leaves: vec![3],
        ..Spec::default()
    };
    let content = file(&[
        ("heat\x1e0", &spec),
        ("heat\x1e1", &other),
        ("flame", &other),
    ]);
    let sizes = |name| -> Vec<usize> {
        let (fields, _) = load_all(&content, Some(name));
        fields.iter().map(|f| f.dims[2]).collect()
    };
    assert_eq!(sizes("flame"), [10]);
    assert_eq!(sizes("heat"), [130, 10]);
    assert_eq!(sizes("heat[1]"), [10]);
    assert_eq!(sizes("heat[0]"), [130]);
    let (_, warnings) = load_all(&content, Some("heat[1]"));
    assert_eq!(warnings, ["x.vdb: grids are left out: `heat[0]`, `flame`"]);
    let pick = |name| {
        read(
            content.clone(),
            Path::new("x"),
            Wanted::from(name),
            None,
            &mut Files::default(),
        )
    };
    // What one volume leaves out another may draw.
    let mut files = Files::default();
    for name in ["heat[1]", "flame"] {
        let (path, wanted) = (Path::new("x.vdb"), Wanted::Named(name));
        read(content.clone(), path, wanted, None, &mut files).unwrap();
    }
    tell_left_grids(&mut files);
    assert_eq!(files.warnings, ["x.vdb: grids are left out: `heat[0]`"]);
    let e = pick(None).err().unwrap();
    assert!(
        e.to_string()
            .ends_with("several grids: `heat[0]`, `heat[1]`, `flame`")
    );
    let e = pick(Some("x")).err().unwrap();
    assert!(e.to_string().contains("no grid `x`"));
}

#[test]
fn all_grids_of_a_name_are_read_and_instances_have_places_of_their_own() {
    let spec = Spec::default();
    let moved = Spec {
        map: [text("TranslationMap"), doubles(&[9.0, 0.0, 0.0])].concat(),
        ..Spec::default()
    };
    let color = Spec {
        kind: "Tree_vec3s_5_4_3".into(),
        ..Spec::default()
    };
    let content = file_with_instances(&[
        ("density", "", &spec),
        ("density\x1e1", "density", &moved),
        ("Cd", "", &color),
    ]);
    let (fields, warnings) = load_all(&content, None);
    assert_eq!(warnings, ["x.vdb: grids are left out: `Cd`"]);
    let origins = fields
        .iter()
        .map(|f| f.world_from_file.unwrap().translation.x);
    assert_eq!(origins.collect::<Vec<_>>(), [0.0, 9.0]);
    assert_eq!(fields[0].value([1; 3]), fields[1].value([1; 3]));
    let (one, _) = load_all(&content, Some("density[1]"));
    assert_eq!(one.len(), 1);
    assert_eq!(one[0].world_from_file.unwrap().translation.x, 9.0);
    let orphan = file_with_instances(&[("density", "smoke", &moved)]);
    assert!(message(&orphan).contains("a grid that is not there"));
}

#[test]
fn newer_files_and_empty_grids_are_told() {
    let newer = Spec {
        version: 226,
        leaves: vec![],
        ..Spec::default()
    };
    let (fields, warnings) = load_all(&newer.file(), None);
    assert!(fields.is_empty());
    assert_eq!(
        warnings,
        [
            "x.vdb: the file is of a version that may have more than is read: 226, after 225",
            "x.vdb: grids without active voxels are left out: `density`"
        ]
    );
}

#[test]
fn what_is_not_supported_says_so() {
    let with = |change: fn(&mut Spec)| {
        let mut spec = Spec::default();
        change(&mut spec);
        message(&spec.file())
    };
    assert!(with(|s| s.class = "level set").contains("`density`: it is a level set"));
    assert!(with(|s| s.kind = "Tree_double_5_4_3".into()).contains("Tree_double_5_4_3"));
    assert!(with(|s| s.kind = "Tree_vec3s_5_4_3".into()).contains("Tree_vec3s_5_4_3"));
    assert!(with(|s| s.version = 219).contains("version 220 to 225, found 219"));
    assert!(with(|s| s.map = text("NonlinearFrustumMap")).contains("NonlinearFrustumMap"));
    assert!(with(|s| s.map = uniform_scale(0.0)).contains("singular"));
    assert!(with(|s| s.count = Some(7)).contains("expected 7 active voxels"));
    let far = with(|s| s.root_tile = Some(([4096, 0, 0], 1.0)));
    assert!(far.contains("[0, 0, 0] to [8191, 4095, 4095]"), "{far}");
    assert!(message(b"not a vdb").contains("magic"));
}

#[test]
fn damage_is_an_error_or_harmless_but_never_a_panic() {
    for compression in [0, 3, 6] {
        let spec = Spec {
            compression,
            leaves: vec![0, 17],
            tile_8: Some((1, 0.75)),
            ..Spec::default()
        };
        let content = spec.file();
        for cut in (0..content.len()).step_by(37) {
            let error = load(&content[..cut]).map(drop).unwrap_err();
            let is_told = error
                .hint_text()
                .is_some_and(|hint| hint.contains("copy it again"));
            // Of less than the magic number it is not known what it is.
            assert!(is_told || cut < 8, "cut at {cut}: {error}");
        }
        // The masks of the large nodes are thousands of zeros; every byte elsewhere is flipped.
        let step = |at: usize| if content[at] == 0 && at > 1024 { 13 } else { 1 };
        let mut at = 0;
        while at < content.len() {
            for flip in [1, 0x80, 0xff] {
                let mut damaged = content.clone();
                damaged[at] ^= flip;
                if let Ok(field) = load(&damaged) {
                    let part = VoxelBox {
                        first: [0; 3],
                        dims: field.dims.map(|n| n.min(32)),
                    };
                    let _ = field.read(&part, &mut vec![0.0; part.count()]);
                }
            }
            at += step(at);
        }
    }
}

#[test]
fn a_stop_is_heard_and_is_of_no_place() {
    let stopped = Cancel::default();
    stopped.request();
    let content = Spec::default().file();
    let read = read(
        content,
        Path::new("x"),
        Wanted::Density,
        None,
        &mut Files::until(&stopped),
    );
    let Err(error) = read.map(drop) else {
        panic!("it was read to its end")
    };
    assert_eq!(error.to_string(), "stopped on request");
}

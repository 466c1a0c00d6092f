//! Grids of colours beside a density.

use super::*;

#[test]
fn channels_of_colors_are_those_of_single_numbers() {
    for version in [220, 224] {
        for compression in [0, 1, 2, 3, 4, 6] {
            for half in [false, true] {
                if version < 222 && compression > 1 {
                    continue;
                }
                let plain = Spec {
                    version,
                    compression,
                    tile_8: Some((33, 0.75)),
                    tile_128: Some((5, 1.5)),
                    ..Spec::default()
                };
                let single = load(&plain.file()).unwrap();
                let vectors = Spec {
                    half,
                    kind: "Tree_vec3s_5_4_3".into(),
                    ..plain.clone()
                };
                let content = file(&[("density", &plain), ("Cd", &vectors)]);
                let (fields, warnings) = load_all(&content, None);
                assert_eq!(
                    (fields.len(), &warnings[..]),
                    (1, &["x.vdb: grids are left out: `Cd`".to_owned()][..])
                );
                let colors = read_colors(content, "Cd", &Files::default()).unwrap();
                assert_eq!(colors.background, [0.0; 3]);
                for (channel, factor) in colors.channels.iter().zip(VECTOR) {
                    assert_eq!((channel.dims, channel.first), (single.dims, single.first));
                    for voxel in [[0; 3], [1, 1, 1], [3, 2, 7], [9, 5, 4], [40, 3, 2]] {
                        let expected = factor * single.value(voxel);
                        assert_eq!(
                            channel.value(voxel),
                            expected,
                            "{version} {compression} {half} {voxel:?}"
                        );
                    }
                }
            }
        }
    }
    let scalar = Spec::default().file();
    let error = read_colors(scalar, "density", &Files::default())
        .err()
        .unwrap();
    assert!(error.to_string().contains("Tree_vec3s_5_4_3"), "{error}");
}

/// A density, and colours of it in a file, as they are placed by maps.
fn colored(density: &Spec, map: Vec<u8>) -> (Field, ColorFields) {
    let vectors = Spec {
        kind: "Tree_vec3s_5_4_3".into(),
        map,
        ..density.clone()
    };
    let content = file(&[("density", density), ("Cd", &vectors)]);
    let field = load(&content).unwrap();
    (
        field,
        read_colors(content, "Cd", &Files::default()).unwrap(),
    )
}

#[test]
fn colors_become_albedos_on_the_voxels_of_the_density() {
    let density = Spec::default();
    let albedo = [0.25, 1.0, 1.0];
    let (field, colors) = colored(&density, density.map.clone());
    let mut files = Files::default();
    let path = Path::new("x.vdb");
    let sigma_t = field.grid(&SCALE, path, &mut files).unwrap();
    let of = (&field, &sigma_t);
    let grids = colors.albedos(of, albedo, path, &mut files).unwrap();
    for voxel in [[1, 1, 1], [3, 2, 7], [8, 8, 8], [2, 5, 4], [1, 2, 3]] {
        let centre = glam::Vec3::from(voxel.map(|i| i as f32)) + 0.5;
        for c in 0..3 {
            let given = VECTOR[c] * field.value(voxel) * albedo[c];
            assert_eq!(grids[c].sample(centre), given.min(1.0), "{voxel:?} {c}");
        }
    }
    let [warning] = &files.warnings[..] else {
        panic!("{:?}", files.warnings)
    };
    assert!(
        warning.contains("of the grid `Cd` are clamped to 0 and 1"),
        "{warning}"
    );
    // Colours on voxels of twice the edge: a voxel of the density lies between eight, or on one.
    let (field, colors) = colored(&density, uniform_scale(1.0));
    let of = (&field, &sigma_t);
    let grids = colors.albedos(of, [0.25; 3], path, &mut files).unwrap();
    let first = field.first[0];
    for voxel in [3_usize, 5, 7] {
        let even = [0, 1, 2].map(|_| voxel);
        let index = (first + voxel as i64).div_euclid(2);
        let own = (index - colors.channels[0].first[0]) as usize;
        let centre = glam::Vec3::splat(voxel as f32 + 0.5);
        if (first + voxel as i64) % 2 == 0 && sigma_t.sample(centre) > 0.0 {
            let given = 0.25 * colors.channels[0].value([own; 3]);
            assert_eq!(grids[0].sample(centre), given.min(1.0), "{even:?}");
        }
    }
}

#[test]
fn a_scene_file_names_the_colors_or_is_told_of_them() {
    let density = Spec::default();
    let vectors = Spec {
        kind: "Tree_vec3s_5_4_3".into(),
        ..density.clone()
    };
    let folder = tempfile::tempdir().unwrap();
    let content = file(&[("density", &density), ("Cd", &vectors)]);
    std::fs::write(folder.path().join("smoke.vdb"), content).unwrap();
    let load = |more: &str| {
        let text = format!(
            "[[camera]]\nposition = [0, 0, 9]\ntarget = [0, 0, 0]\n\
             [[volume]]\nfile = \"smoke.vdb\"\nsigma_t_scale = 1\nalbedo = [0.2, 0.4, 0.1]\n\
             {more}\n"
        );
        let path = folder.path().join("scene.toml");
        std::fs::write(&path, text).unwrap();
        crate::scene::Scene::load(&path)
    };
    let told = |scene: &crate::scene::Scene, what: &str| {
        let mut warnings = scene.warnings.iter();
        warnings.any(|w| w.contains(what))
    };
    let plain = load("").unwrap();
    assert!(plain.volumes[0].albedo_grid.is_none());
    assert!(told(&plain, "grids are left out: `Cd`"));
    let colored = load("albedo_grid = \"Cd\"").unwrap();
    assert!(!told(&colored, "left out"), "{:?}", colored.warnings);
    let volume = &colored.volumes[0];
    let grid = volume.albedo_grid.as_ref().unwrap();
    // Where a voxel has the density v, its colours are v times those of vectors.
    let centre = glam::Vec3::new(1.5, 1.5, 1.5);
    let v = volume.sigma_t.sample(centre);
    let expected: [f32; 3] = std::array::from_fn(|c| v * VECTOR[c] * [0.2, 0.4, 0.1][c]);
    let found = grid.at(centre).0;
    assert!(
        v > 0.0 && (0..3).all(|c| (found[c] - expected[c]).abs() < 1e-6),
        "{found:?}"
    );
    assert!(colored.parts(None) != plain.parts(None));
    for (more, says) in [
        (
            "albedo_grid = \"density\"",
            "colours are read of Tree_vec3s_5_4_3 alone",
        ),
        ("albedo_grid = \"none\"", "there is no grid `none`"),
    ] {
        let error = load(more).unwrap_err().to_string();
        assert!(error.contains(says), "{error}");
    }
}

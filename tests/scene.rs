//! Scenes from files: every format and every message, on files that the tests write themselves.

use glam::{DVec3, Vec3};
use lvox::scene::{Light, Scene};
use std::fs;
use std::path::{Path, PathBuf};

fn acceptance(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/acceptance/scenes")
        .join(name)
}

/// The shared reference data, or `None` with a word on it.
fn shared(path: &str) -> Option<PathBuf> {
    let path = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../shared")).join(path);
    if !path.exists() {
        eprintln!("skipped: {} is not there", path.display());
        return None;
    }
    Some(path)
}

/// An acceptance scene, if the shared data that it names is there.
fn load_acceptance(name: &str) -> Option<Scene> {
    shared("refs/geom")?;
    Some(Scene::load(&acceptance(name)).unwrap())
}

#[test]
fn the_demo_loads_and_is_the_same_twice() {
    let scene = Scene::demo().unwrap();
    assert_eq!((scene.film.width, scene.film.height), (640, 480));
    assert!(scene.warnings.is_empty(), "{:?}", scene.warnings);
    assert_eq!(scene.volumes.len(), 1);
    let peak = scene.volumes[0].sigma_t.max();
    assert!((15.0..25.0).contains(&peak), "{peak}");
    assert_eq!(scene.mesh.degenerate, 0);
    assert_eq!(scene.hash, Scene::demo().unwrap().hash);
}

#[test]
fn the_cornell_box_with_smoke_is_that_of_the_reference() {
    let Some(scene) = load_acceptance("A.toml") else {
        return;
    };
    assert_eq!(scene.mesh.triangles.len(), 18 + 2 + 2 + 2);
    assert!(scene.mesh.normals.is_empty() && scene.mesh.colors.is_empty());
    assert!(scene.warnings.is_empty(), "{:?}", scene.warnings);
    assert_eq!(scene.world_from_scene, DVec3::ZERO);
    assert_eq!(scene.cameras[0].origin(), Vec3::new(0.0, 0.0, 3.9));
    let ahead = scene.cameras[0].direction(&scene.film, 256.0, 256.0);
    assert!((ahead - Vec3::NEG_Z).length() < 1e-6);
    let light = scene
        .materials
        .iter()
        .position(|m| m.emission != [0.0; 3])
        .unwrap();
    for t in 0..scene.mesh.triangles.len() {
        if scene.mesh.material[t] as usize == light {
            assert!(scene.mesh.area_vector(t).y < 0.0, "the lamp shines down");
        }
    }
    let volume = &scene.volumes[0];
    let bytes = fs::read(shared("refs/geom/smoke64.raw").unwrap()).unwrap();
    for voxel in [[0, 0, 0], [31, 20, 33], [30, 40, 32], [63, 63, 63]] {
        let [i, j, k] = voxel;
        let at = ((k * 64 + j) * 64 + i) * 4;
        let value = f32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
        let unit = DVec3::new(i as f64 + 0.5, j as f64 + 0.5, k as f64 + 0.5) / 64.0;
        let world = unit * 0.9 + DVec3::new(-0.87, -0.6, -0.87);
        let index = volume.index_from_scene.transform_point3(world.as_vec3());
        assert!((volume.sigma_t.sample(index) - 25.0 * value).abs() < 1e-3);
    }
}

#[test]
fn sponza_is_that_of_the_reference() {
    let Some(scene) = load_acceptance("C.toml") else {
        return;
    };
    assert_eq!(scene.mesh.triangles.len(), 66453 + 6);
    assert_eq!(scene.mesh.degenerate, 0);
    let json = fs::read_to_string(shared("refs/C.json").unwrap()).unwrap();
    let json: serde_json::Value = serde_json::from_str(&json).unwrap();
    let matrix = &json["camera"]["camera_to_world"];
    let map = scene.cameras[0].scene_from_camera;
    for row in 0..3 {
        for column in 0..3 {
            let expected = matrix[row][column].as_f64().unwrap() as f32;
            assert!((map.matrix3.col(column)[row] - expected).abs() < 1e-6);
        }
    }
    let [Light::Directional { irradiance, .. }] = scene.lights[..] else {
        panic!("{:?}", scene.lights)
    };
    assert_eq!(irradiance, [6.0, 5.6, 4.8]);
    assert!(scene.volumes[0].sigma_t.max() <= 24.0);
}

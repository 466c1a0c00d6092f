//! Scenes from files: every format and every message, on files that the tests write themselves.

mod changes;
mod damage;
mod formats;
mod inspect;
mod made;
mod messages;
mod mitsuba;
mod mitsuba_media;
mod outside;
#[path = "../support/mod.rs"]
mod support;
mod volumes;

use glam::{DVec3, Vec3};
use lvox::scene::{Light, Scene};
use std::fs;
use std::path::{Path, PathBuf};
use support::skip::shared;
use tempfile::TempDir;

/// A folder of files that goes away with the test.
struct Folder(TempDir);

impl Folder {
    fn new(files: &[(&str, &[u8])]) -> Self {
        let folder = tempfile::tempdir().unwrap();
        for (name, content) in files {
            fs::write(folder.path().join(name), content).unwrap();
        }
        Self(folder)
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// Loads a scene of this text from the folder.
    fn load(&self, text: &str) -> lvox::Result<Scene> {
        let path = self.path("scene.toml");
        fs::write(&path, text).unwrap();
        Scene::load(&path)
    }
}

/// A scene of this text and these files.
fn load(text: &str, files: &[(&str, &[u8])]) -> lvox::Result<Scene> {
    Folder::new(files).load(text)
}

fn acceptance(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/acceptance/scenes")
        .join(name)
}

/// An acceptance scene, if the shared data that it names is there.
fn load_acceptance(name: &str) -> Option<Scene> {
    shared("refs/geom")?;
    Some(Scene::load(&acceptance(name)).unwrap())
}

#[test]
fn frames_beyond_f32_are_refused() {
    for far in [1e6, 1e30, 1e300] {
        let error = Scene::demo().unwrap().in_frame(DVec3::splat(far));
        assert!(error.unwrap_err().to_string().contains("units from where"));
    }
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
            assert!(scene.mesh.area_vector(t).y < 0.0, "the emitter shines down");
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

#[test]
fn all_acceptance_scenes_load_without_a_warning() {
    let names = ["A", "A_pt", "B", "C", "C_novol", "smoke", "head"];
    for name in names {
        let Some(scene) = load_acceptance(&format!("{name}.toml")) else {
            return;
        };
        assert!(scene.warnings.is_empty(), "{name}: {:?}", scene.warnings);
        assert_eq!(scene.name, name);
    }
}

#[test]
fn real_smoke_arrives_where_its_file_puts_it() {
    let Some(file) = shared("data/smoke.vdb") else {
        return;
    };
    let text = format!(
        "[[volume]]\nfile = {:?}\nsigma_t_scale = 2\nalbedo = [0.5, 0.5, 0.5]\n",
        file.to_str().unwrap()
    );
    let scene = load(&text, &[]).unwrap();
    let volume = &scene.volumes[0];
    assert_eq!(volume.name, "smoke");
    assert_eq!(volume.sigma_t.dims(), [113, 224, 114]);
    assert!((volume.sigma_t.max() - 2.0 * 5.7148).abs() < 1e-3);
    // The voxel with index (1,2,1) is the first in the box, after one voxel of padding.
    let p = volume.scene_from_index.transform_point3(DVec3::splat(1.5));
    let expected = DVec3::new(-34.0476, -13.0952, -26.4286) + 0.476190 * DVec3::new(1.0, 2.0, 1.0);
    assert!((p - expected).length() < 1e-3, "{p}");
}

#[test]
fn real_meshes_load_in_every_format() {
    let Some(folder) = shared("data") else {
        return;
    };
    for (name, vertices) in [
        ("sponza.ply", 40126),
        ("sponza_crease40.ply", 58009),
        ("sponza.obj", 0),
    ] {
        let path = folder.join(name);
        let text = format!("[[mesh]]\nfile = {:?}\n", path.to_str().unwrap());
        let scene = load(&text, &[]).unwrap();
        let mesh = &scene.mesh;
        assert_eq!(
            mesh.triangles.len() as u64 + mesh.degenerate,
            66454,
            "{name}"
        );
        assert_eq!(mesh.degenerate, 1, "{name}");
        assert_eq!(mesh.normals.len(), mesh.positions.len(), "{name}");
        if vertices > 0 {
            assert_eq!(mesh.positions.len(), vertices);
            assert_eq!(mesh.colors.len(), vertices);
        } else {
            assert_eq!(scene.materials.len(), 20);
        }
        let area: f64 = (0..mesh.triangles.len())
            .map(|t| f64::from(mesh.area_vector(t).length()))
            .sum();
        assert!((area - 7502.9).abs() < 0.1, "{name}: {area}");
    }
    let text = format!(
        "[[mesh]]\nfile = {:?}\nnormals = {{ crease_deg = 40 }}\n",
        folder.join("sponza.ply").to_str().unwrap()
    );
    let scene = load(&text, &[]).unwrap();
    // Made by another program; ours also splits at the vertices that the PLY splits by material.
    let found = scene.mesh.positions.len();
    assert!((57_500..58_500).contains(&found), "{found}");
}

#[test]
fn real_gltf_files_load_by_themselves() {
    let Some(folder) = shared("data") else {
        return;
    };
    for (name, triangles, lights, cameras) in [
        ("DepthOfFieldExample.glb", 10610, 1, 0),
        ("VolumetricFogExample.glb", 360, 1, 0),
        // One box of 12 triangles is there twice.
        ("cornellBox.gltf", 16720 + 12, 0, 1),
    ] {
        let scene = Scene::load(&folder.join(name)).unwrap();
        let found = scene.mesh.triangles.len() as u64 + scene.mesh.degenerate;
        assert_eq!(found, triangles, "{name}");
        assert_eq!(scene.lights.len(), lights, "{name}");
        assert_eq!(scene.cameras.len(), 1, "{name}");
        let has_default = scene.warnings.iter().any(|w| w.contains("no camera"));
        assert_eq!(has_default, cameras == 0, "{name}");
    }
}

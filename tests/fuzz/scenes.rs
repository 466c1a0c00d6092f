//! Meshes, volumes, textures, scene files and tiles.

use crate::corpus;
use crate::harness::{Target, change, folder};
use lvox::Kind;
use lvox::image::{exr, merge};
use lvox::run::Job;
use lvox::scene::Scene;
use std::fs;
use std::path::Path;

/// What is wrong with the outcome of a reader, if anything is.
fn judge<T>(outcome: lvox::Result<T>) -> Result<Option<T>, String> {
    match outcome {
        Ok(read) => Ok(Some(read)),
        Err(e) if e.kind() == Kind::Input => Ok(None),
        Err(e) => Err(format!("an error that is not of the input: {e}")),
    }
}

/// Loads a scene, which must hold finite numbers.
fn load(path: &Path) -> Result<bool, String> {
    let Some(scene) = judge(Scene::load(path))? else {
        return Ok(false);
    };
    let mesh = &scene.mesh;
    let vertices = mesh.positions.iter().chain(&mesh.normals);
    let is_finite = vertices.into_iter().all(|p| p.is_finite());
    let count = mesh.positions.len();
    let is_inside = mesh
        .triangles
        .iter()
        .flatten()
        .all(|i| (*i as usize) < count);
    let has_density = (scene.volumes.iter()).all(|v| v.sigma_t.max().is_finite());
    if is_finite && is_inside && has_density {
        Ok(true)
    } else {
        Err(format!("{is_finite} {is_inside} {has_density}"))
    }
}

/// Loads a scene that names a file, with changed files in its place; beside it are files that do
/// not change.
fn through_scene(
    name: &str,
    (cases, memory): (u64, usize),
    scene: &str,
    beside: &[(&str, Vec<u8>)],
    file: &str,
    corpus: Vec<Vec<u8>>,
) {
    let folder = folder(name);
    let path = folder.join("scene.toml");
    fs::write(&path, scene).unwrap();
    for (name, content) in beside {
        fs::write(folder.join(name), content).unwrap();
    }
    let target = Target {
        name,
        cases,
        memory,
        corpus,
    };
    let is_texture = file == "a.png";
    target.run(
        |random, whole, corpus| {
            let mut file = change(random, whole, corpus);
            if is_texture && random.below(2) == 0 {
                corpus::repair_png(&mut file);
            }
            file
        },
        |content| {
            fs::write(folder.join(file), content).unwrap();
            load(&path)
        },
    );
}

const MIB: usize = 1 << 20;
const MESH: &str = "[[mesh]]\nfile = \"FILE\"\n";
const VOLUME: &str = "[[volume]]\nfile = \"FILE\"\nsigma_t_scale = 1\nalbedo = [1, 1, 1]\n";

fn picture() -> Vec<u8> {
    corpus::textures().swap_remove(0)
}

#[test]
fn obj() {
    let beside = [("a.mtl", corpus::MTL.into()), ("a.png", picture())];
    let scene = MESH.replace("FILE", "a.obj");
    through_scene(
        "obj",
        (1500, 64 * MIB),
        &scene,
        &beside,
        "a.obj",
        vec![corpus::OBJ.into()],
    );
}

#[test]
fn mtl() {
    let beside = [("a.obj", corpus::OBJ.into()), ("a.png", picture())];
    let scene = MESH.replace("FILE", "a.obj");
    through_scene(
        "mtl",
        (1500, 64 * MIB),
        &scene,
        &beside,
        "a.mtl",
        vec![corpus::MTL.into()],
    );
}

#[test]
fn ply() {
    let scene = MESH.replace("FILE", "a.ply");
    through_scene("ply", (1500, 64 * MIB), &scene, &[], "a.ply", corpus::ply());
}

#[test]
fn gltf() {
    let scene = MESH.replace("FILE", "a.glb");
    let mut corpus = corpus::gltf();
    let binary = corpus.split_off(1);
    through_scene("glb", (1500, 64 * MIB), &scene, &[], "a.glb", binary);
    let scene = MESH.replace("FILE", "a.gltf");
    through_scene("gltf", (1500, 64 * MIB), &scene, &[], "a.gltf", corpus);
}

#[test]
fn vdb() {
    let scene = VOLUME.replace("FILE", "a.vdb");
    through_scene(
        "vdb",
        (300, 1024 * MIB),
        &scene,
        &[],
        "a.vdb",
        corpus::vdb(),
    );
}

#[test]
fn nrrd() {
    let scene = VOLUME.replace("FILE", "a.nrrd");
    through_scene(
        "nrrd",
        (1500, 512 * MIB),
        &scene,
        &[],
        "a.nrrd",
        corpus::nrrd(),
    );
}

#[test]
fn textures() {
    let scene = MESH.replace("FILE", "a.obj");
    let beside = [("a.obj", corpus::OBJ.into()), ("a.mtl", corpus::MTL.into())];
    through_scene(
        "texture",
        (1500, 512 * MIB),
        &scene,
        &beside,
        "a.png",
        corpus::textures(),
    );
}

#[test]
fn scene_files() {
    let beside = [
        ("a.obj", corpus::OBJ.into()),
        ("a.mtl", corpus::MTL.into()),
        ("a.png", picture()),
        ("smoke.raw", vec![9; 64]),
    ];
    let corpus = vec![corpus::SCENE.into()];
    through_scene(
        "scene",
        (1500, 256 * MIB),
        "",
        &beside,
        "scene.toml",
        corpus,
    );
}

#[test]
fn tiles() {
    let target = Target {
        name: "tile",
        cases: 1500,
        memory: 512 * MIB,
        corpus: corpus::tiles(),
    };
    let folder = folder("tile");
    let (tile, out) = (folder.join("a.exr"), folder.join("out.exr"));
    target.run(change, |content| {
        fs::write(&tile, content).unwrap();
        judge(merge(std::slice::from_ref(&tile), &out, &Job::default()))?;
        Ok(judge(exr::read(&tile))?.is_some())
    });
}

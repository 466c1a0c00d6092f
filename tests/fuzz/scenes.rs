//! Meshes, volumes, textures, scene files, tiles and points.

use crate::corpus;
use crate::harness::{Target, change, folder};
use crate::support::trees;
use lvox::Kind;
use lvox::formats::Overwrite;
use lvox::image::{Missing, exr, merge};
use lvox::points::{self, PointFile};
use lvox::run::Job;
use lvox::scene::{LightInput, MeshInput, Scene, SceneBuilder};
use lvox::tree::OpenTree;
use std::fs;
use std::path::Path;

/// Files of points: without faces and with them, as text, and arrays.
#[test]
fn points() {
    let folder = folder("points");
    let (input, output) = (folder.join("a.points"), folder.join("a.ply"));
    let tree = trees::baked(&floor(), &trees::of_surfels(50), &folder, "floor");
    let tree = OpenTree::open(&tree, None).unwrap();
    let settings = points::Settings {
        samples: 1,
        ..points::Settings::default()
    };
    let mut corpus = corpus::ply();
    corpus.extend(corpus::npy());
    let target = Target {
        name: "points",
        cases: 1500,
        memory: 64 << 20,
        corpus,
    };
    target.run(change, |content| {
        fs::write(&input, content).unwrap();
        let read = PointFile::open(&input).and_then(|file| {
            // What is left of a small file is small.
            assert!(file.count() <= 1 + content.len() as u64);
            let job = Job::default();
            let overwrite = Overwrite::Replace;
            points::run(&tree, None, &file, &output, &settings, overwrite, &job)
        });
        Ok(judge(read)?.is_some())
    });
    let (cloud, settings) = (folder.join("a.lvc"), points::ImportSettings::default());
    let target = Target {
        name: "surfels",
        cases: 1500,
        memory: 64 << 20,
        corpus: corpus::surfels(),
    };
    target.run(change, |content| {
        fs::write(&input, content).unwrap();
        let job = Job::default();
        let read = PointFile::open(&input)
            .and_then(|file| points::import(&file, &cloud, &settings, Overwrite::Replace, &job));
        Ok(judge(read)?.is_some())
    });
}

/// A floor under a light.
fn floor() -> Scene {
    let corners = [[-1.0, 0.0, -1.0], [-1.0, 0.0, 1.0], [1.0, 0.0, 1.0]];
    SceneBuilder::new("floor")
        .mesh(MeshInput::new("floor", corners, vec![[0, 1, 2]]).albedo([0.5; 3]))
        .light(LightInput::point([0.0, 3.0, 0.0], [8.0; 3]))
        .build()
        .unwrap()
}

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
    let path = folder.join(if file == "a.xml" { file } else { "scene.toml" });
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
fn mitsuba() {
    let scene = VOLUME.replace("FILE", "a.vol");
    let memory = 512 * MIB;
    through_scene("vol", (1500, memory), &scene, &[], "a.vol", corpus::vol());
    let beside = [
        ("a.obj", corpus::OBJ.into()),
        ("a.png", picture()),
        ("a.vol", corpus::vol().swap_remove(0)),
    ];
    let corpus = vec![corpus::MITSUBA.into()];
    through_scene("xml", (1500, memory), "", &beside, "a.xml", corpus);
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
fn nifti() {
    let scene = VOLUME.replace("FILE", "a.nii");
    through_scene(
        "nifti",
        (1500, 512 * MIB),
        &scene,
        &[],
        "a.nii",
        corpus::nifti(),
    );
}

#[test]
fn metaimage() {
    let scene = VOLUME.replace("FILE", "a.mha");
    through_scene(
        "metaimage",
        (1500, 512 * MIB),
        &scene,
        &[],
        "a.mha",
        corpus::metaimage(),
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
        judge(merge(
            std::slice::from_ref(&tile),
            &out,
            Missing::Refuse,
            None,
            &Job::default(),
        ))?;
        Ok(judge(exr::read(&tile))?.is_some())
    });
}

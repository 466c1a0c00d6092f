//! Clouds, trees, scattered light and kept samples.

use crate::harness::{Target, change, folder};
use crate::support::parts::{Parts, repair};
use crate::support::random::Random;
use crate::support::trees;
use glam::{DAffine3, DVec3};
use lvox::formats::record::MAX_VOXELS_ALONG;
use lvox::formats::{Overwrite, Tree, TreeWriter};
use lvox::image::Region;
use lvox::run::Job;
use lvox::scene::{
    CameraInput, Film, Grid, LightInput, MeshInput, PhaseFunction, Scene, SceneBuilder, VolumeInput,
};
use lvox::tree::OpenTree;
use lvox::{Kind, bounce, build, inspect, pack, scatter, shade};
use std::fs;
use std::path::{Path, PathBuf};

/// A floor in reddish fog under a light, and a board at three places.
fn scene(phase: PhaseFunction) -> Scene {
    let corners = [
        [-1.0, 0.0, -1.0],
        [-1.0, 0.0, 1.0],
        [1.0, 0.0, 1.0],
        [1.0, 0.0, -1.0],
    ];
    let floor = MeshInput::new("floor", corners, vec![[0, 1, 2], [0, 2, 3]]);
    let board = MeshInput::new("board", corners, vec![[0, 2, 1], [0, 3, 2]]);
    let places = [-0.5, 0.1, 0.6].map(|x| {
        let size = DVec3::new(0.2, 0.3, 0.2) * if x < 0.0 { -1.0 } else { 1.0 };
        DAffine3::from_translation(DVec3::new(x, 1.0, 0.0)) * DAffine3::from_scale(size)
    });
    let fog = Grid::from_fn([9; 3], |[x, ..]| 0.5 + x as f32);
    let world_from_fog = DAffine3::from_translation(DVec3::new(-0.5, 0.2, -0.5))
        * DAffine3::from_scale(DVec3::splat(0.1));
    let fog = VolumeInput::new("fog", fog, [0.9; 3], world_from_fog);
    let film = Film {
        width: 8,
        height: 6,
        exposure: 1.0,
    };
    let camera = CameraInput::look_at("a", [0.0, 1.0, 4.0], [0.0, 0.5, 0.0], [0.0, 1.0, 0.0], 0.7);
    SceneBuilder::new("floor and fog")
        .film(film)
        .camera(camera.unwrap())
        .mesh(floor.albedo([0.8, 0.1, 0.1]))
        .instances(board, places)
        .light(LightInput::point([0.0, 3.0, 0.0], [8.0; 3]))
        .volume(fog.extinction_color([1.0, 0.5, 0.25]).phase(phase))
        .build()
        .unwrap()
}

/// A scene and its files.
struct Work {
    folder: PathBuf,
    scene: Scene,
    cloud: PathBuf,
    tree: PathBuf,
    light: PathBuf,
}

impl Work {
    fn new(name: &str) -> Self {
        let folder = folder(name);
        let scene = scene(PhaseFunction::default());
        let tree = trees::baked(&scene, &trees::of_surfels(300), &folder, "scene");
        let light = folder.join("scene.lvs");
        let store = OpenTree::open(&tree, None).unwrap();
        let settings = scatter::Settings {
            volume_samples: 2,
            shadow_rays: 1,
            ..scatter::Settings::default()
        };
        let job = Job::default();
        scatter::run(&scene, &store, &light, &settings, Overwrite::Replace, &job).unwrap();
        Self {
            cloud: tree.with_extension("lvc"),
            tree,
            light,
            scene,
            folder,
        }
    }

    /// Shades a frame from a tree; light that is not finite is told.
    fn shade(&self, store: &OpenTree) -> lvox::Result<()> {
        let settings = shade::Settings {
            samples: 4,
            volume_samples: 2,
            ..shade::Settings::default()
        };
        let job = Job::default();
        let region = Region::full(self.scene.film.width, self.scene.film.height);
        let frame = shade::run(&self.scene, store, &settings, region, &[], &job)?;
        assert!(
            frame.not_finite().is_none() || !job.progress.warnings().is_empty(),
            "pixels that are not finite, without a warning"
        );
        Ok(())
    }
}

/// Changes a file in one of three ways: its bytes; its bytes, with right checksums again; what is
/// in its parts, decompressed.
fn damaged(random: &mut Random, whole: &[u8], corpus: &[Vec<u8>]) -> Vec<u8> {
    match random.below(4) {
        0 => change(random, whole, corpus),
        1 => {
            let mut file = change(random, whole, corpus);
            if file.len() > 104 {
                repair(&mut file);
            }
            file
        }
        _ => {
            let mut parts = Parts::of(whole);
            for _ in 0..=random.below(3) {
                let at = random.below(parts.blocks.len() as u64) as usize;
                let block = &mut parts.blocks[at];
                let column = random.below(block.data.len() as u64) as usize;
                let target = match random.below(8) {
                    0 => &mut parts.meta,
                    1 => &mut parts.summary,
                    2 => {
                        let number = match random.below(4) {
                            0 => &mut block.kind,
                            1 => &mut block.records,
                            2 => &mut block.nodes,
                            _ => &mut block.columns,
                        };
                        let bits = change(random, &number.to_le_bytes(), &[vec![0; 4]]);
                        let mut bytes = [0; 4];
                        bytes.iter_mut().zip(bits).for_each(|(a, b)| *a = b);
                        *number = u32::from_le_bytes(bytes);
                        continue;
                    }
                    _ => &mut block.data[column].1,
                };
                let before = target.clone();
                *target = change(random, &before, std::slice::from_ref(&before));
            }
            parts.file()
        }
    }
}

/// What is wrong with an outcome, if anything is; returns whether it is a success.
fn judge<T>(outcome: lvox::Result<T>) -> Result<bool, String> {
    match outcome {
        Ok(_) => Ok(true),
        Err(e) if e.kind() == Kind::Input => Ok(false),
        Err(e) => Err(format!("an error that is not of the input: {e}")),
    }
}

/// Tries one kind of file: the complete check, and what else reads it.
fn own(work: &Work, path: &Path, cases: u64, read: impl Fn(&Path) -> lvox::Result<()>) {
    let whole = fs::read(path).unwrap();
    let name = path.extension().unwrap().to_str().unwrap();
    let file = work.folder.join(format!("damaged.{name}"));
    let target = Target {
        name,
        cases,
        memory: 512 << 20,
        corpus: vec![whole.clone()],
    };
    target.run(damaged, |content| {
        fs::write(&file, content).unwrap();
        let _ = judge(inspect::scattered(&file))?;
        let _ = judge(inspect::packed(&file).map(|p| p.map(|p| p.to_string())))?;
        let _ = judge(inspect::describe(&file).map(|d| d.to_string()))?;
        let is_whole = judge(inspect::verify(&file, &Job::default()))?;
        // A change without right checksums is found, always.
        if is_whole && content != whole {
            let mut repaired = content.to_vec();
            repair(&mut repaired);
            if repaired != content {
                return Err("damage that `verify` does not find".into());
            }
        }
        judge(read(&file))
    });
}

#[test]
fn clouds() {
    let work = Work::new("clouds");
    let out = work.folder.join("out.lvt");
    own(&work, &work.cloud, 150, |file| {
        let settings = build::Settings::default();
        build::run(file, &out, &settings, Overwrite::Replace, &Job::default()).map(drop)
    });
}

#[test]
fn trees() {
    let work = Work::new("trees");
    let out = work.folder.join("out.ply");
    own(&work, &work.tree, 150, |file| {
        inspect::export_ply(file, &out, Some(1000), Overwrite::Replace)?;
        work.shade(&OpenTree::open(file, None)?)
    });
}

/// Light that has bounced, in a medium that scatters forward: all columns of lvoxels.
#[test]
fn trees_of_all_bounces() {
    let mut work = Work::new("bounced");
    work.scene = scene(PhaseFunction::henyey_greenstein(0.6));
    let tree = trees::baked(
        &work.scene,
        &trees::of_surfels(300),
        &work.folder,
        "forward",
    );
    let store = OpenTree::open(&tree, None).unwrap();
    let bounced = work.folder.join("bounced.lvt");
    let (settings, job) = (bounce::Settings::default(), Job::default());
    bounce::run(
        &work.scene,
        &store,
        &bounced,
        &settings,
        Overwrite::Replace,
        &job,
    )
    .unwrap();
    own(&work, &bounced, 150, |file| {
        work.shade(&OpenTree::open(file, None)?)
    });
}

#[test]
fn scattered_light() {
    let work = Work::new("light");
    own(&work, &work.light, 150, |file| {
        work.shade(&OpenTree::open(&work.tree, None)?.with_scatter(file)?)
    });
}

#[test]
fn packed_scenes() {
    let mut work = Work::new("packed");
    let packed = work.folder.join("scene.lvp");
    let files = pack::Files {
        tree: Some(&work.tree),
        light: Some(&work.light),
    };
    let job = Job::default();
    pack::run(&work.scene, files, &packed, Overwrite::Replace, &job).unwrap();
    work.scene = Scene::load(&packed).unwrap();
    own(&work, &packed, 150, |file| {
        let scene = Scene::load(file)?;
        let small = scene.film.width * scene.film.height < 100;
        let store = OpenTree::open(file, None)?.with_scatter(file)?;
        let settings = shade::Settings {
            samples: 4,
            volume_samples: 2,
            ..shade::Settings::default()
        };
        let full = Region::full(scene.film.width, scene.film.height);
        let region = if small {
            full
        } else {
            Region {
                x1: 1,
                y1: 1,
                ..full
            }
        };
        shade::run(&scene, &store, &settings, region, &[], &job).map(drop)
    });
}

/// A file of samples, with its checksum.
fn samples() -> Vec<u8> {
    let origin = br#"{"code":"c","scene":"s","film":[20,10],"settings":{"max_depth":3}}"#;
    let mut file = b"\x89lvs\r\n\x1a\n".to_vec();
    for number in [1, 2, 3, 5, 6, 7, origin.len() as u32] {
        file.extend(number.to_le_bytes());
    }
    file.extend(origin);
    for _ in 5..7 {
        file.extend(9_u32.to_le_bytes());
        file.extend(0_u64.to_le_bytes());
        file.extend([0.25_f64; 18].iter().flat_map(|v| v.to_le_bytes()));
    }
    file.extend([0; 32]);
    sealed(file)
}

fn sealed(mut file: Vec<u8>) -> Vec<u8> {
    if let Some(at) = file.len().checked_sub(32) {
        let sum = *blake3::hash(&file[..at]).as_bytes();
        file[at..].copy_from_slice(&sum);
    }
    file
}

#[test]
fn kept_samples() {
    let path = folder("samples").join("a.sums");
    let target = Target {
        name: "sums",
        cases: 1500,
        memory: 64 << 20,
        corpus: vec![samples()],
    };
    let damaged = |random: &mut Random, whole: &[u8], corpus: &[Vec<u8>]| {
        sealed(change(random, whole, corpus))
    };
    target.run(damaged, |content| {
        fs::write(&path, content).unwrap();
        judge(inspect::samples(&path))
    });
}

/// A header of few bytes that claims volumes of many is refused before there is memory for them.
#[test]
fn volumes_without_lvoxels_take_little_memory() {
    let work = Work::new("volumes");
    let good = Tree::open_path(&work.tree).unwrap();
    for dims in [[8192, 8192, 4096], [MAX_VOXELS_ALONG; 3]] {
        let mut meta = good.meta().clone();
        meta.cloud.volumes[0].dims = dims;
        let path = work.folder.join("vast.lvt");
        let writer = TreeWriter::create(&path, meta, Overwrite::Replace).unwrap();
        let sums = good.summary().cloud_sums.clone();
        writer.finish(None, sums, Vec::new()).unwrap();
        let _alone = crate::harness::ALONE.lock();
        let (opened, bytes) = crate::harness::peak_of(|| OpenTree::open(&path, None));
        let error = opened.unwrap_err();
        assert!(
            error.to_string().contains("vast.lvt: finding the lvoxels"),
            "{error}"
        );
        assert!(bytes < 1 << 20, "{bytes}");
    }
}

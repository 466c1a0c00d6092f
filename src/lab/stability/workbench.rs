//! The whole pipeline on scenes that are made in memory, in a folder that goes away.

use crate::bake::{self, SurfelSampling};
use crate::formats::{CloudMeta, CloudWriter, Lvoxel, Overwrite, Surfel, TemporaryFolder};
use crate::gather::{self, Gatherer, Medium, RayKernel, SampleRange};
use crate::image::{Frame, Region};
use crate::math::{Environment, Rgb};
use crate::run::{Cancel, Job};
use crate::scene::{Camera, Film, Grid, Material, Scene, Volume};
use crate::shade::{self, Settings};
use crate::tree::{Media, OpenTree};
use crate::{Error, Result, bounce, build};
use glam::{Affine3A, DAffine3, DVec3, Vec3};
use std::cell::Cell;
use std::fs;
use std::path::{Path, PathBuf};

/// A folder for scenes, clouds and trees.
pub struct Workbench {
    dir: TemporaryFolder,
    files: Cell<u32>,
    job: Job,
}

impl Workbench {
    /// A folder in that of the job for temporary files. Stages are quiet here, but stop when the
    /// job does.
    pub fn new(job: &Job) -> Result<Self> {
        Ok(Self {
            dir: job.temporary_folder()?,
            files: Cell::new(0),
            job: Job {
                cancel: job.cancel.clone(),
                memory_limit: job.memory_limit,
                temp_dir: job.temp_dir.clone(),
                ..Job::default()
            },
        })
    }

    /// Set when the study is to stop.
    pub fn cancel(&self) -> &Cancel {
        &self.job.cancel
    }

    fn new_path(&self, extension: &str) -> PathBuf {
        self.files.set(self.files.get() + 1);
        self.dir
            .path()
            .join(format!("{}.{extension}", self.files.get()))
    }

    /// Loads a scene from the text of its file, which may name the others by `name`.
    pub fn load(&self, text: &str, others: &[(&str, &[u8])]) -> Result<Scene> {
        let write = |path: &Path, bytes: &[u8]| {
            fs::write(path, bytes).map_err(|e| Error::io("write", path, &e))
        };
        for (name, bytes) in others {
            write(&self.dir.path().join(name), bytes)?;
        }
        let path = self.new_path("toml");
        write(&path, text.as_bytes())?;
        Scene::load(&path)
    }

    /// Bakes and builds with so many surfels.
    pub fn tree(&self, scene: &Scene, surfels: u64) -> Result<OpenTree> {
        let cloud = self.new_path("lvc");
        let settings = bake::Settings {
            surfels: SurfelSampling::Area { count: surfels },
            ..bake::Settings::default()
        };
        bake::run(scene, &settings, &cloud, Overwrite::Replace, &self.job)?;
        self.build(&cloud)
    }

    /// The tree with the light of all bounces.
    pub fn bounced(&self, scene: &Scene, store: OpenTree) -> Result<OpenTree> {
        let tree = self.new_path("lvt");
        let settings = bounce::Settings::default();
        bounce::run(
            scene,
            &store,
            &tree,
            &settings,
            Overwrite::Replace,
            &self.job,
        )?;
        OpenTree::open(&tree, None)
    }

    /// Builds the tree of a cloud of these records.
    pub fn tree_of(
        &self,
        meta: CloudMeta,
        surfels: impl IntoIterator<Item = Surfel>,
        lvoxels: &[Lvoxel],
    ) -> Result<OpenTree> {
        let path = self.new_path("lvc");
        let mut writer = CloudWriter::create(&path, meta, Overwrite::Replace)?;
        let mut surfels = surfels.into_iter();
        loop {
            let chunk: Vec<Surfel> = surfels.by_ref().take(65_536).collect();
            if chunk.is_empty() {
                break;
            }
            writer.push_surfels(&chunk)?;
        }
        writer.push_lvoxels(lvoxels)?;
        writer.finish()?;
        self.build(&path)
    }

    fn build(&self, cloud: &Path) -> Result<OpenTree> {
        let tree = self.new_path("lvt");
        let settings = build::Settings::default();
        build::run(cloud, &tree, &settings, Overwrite::Replace, &self.job)?;
        fs::remove_file(cloud).map_err(|e| Error::io("remove", cloud, &e))?;
        OpenTree::open(&tree, None)
    }

    /// The whole frame.
    pub fn shade(&self, scene: &Scene, store: &OpenTree, settings: &Settings) -> Result<Frame> {
        let region = Region::full(scene.film.width, scene.film.height);
        let aovs = shade::Aov::ALL.map(|(_, aov)| aov);
        shade::run(scene, store, settings, region, &aovs, &self.job)
    }

    /// From the scene to the pixels of its picture.
    pub fn render(
        &self,
        scene: &Scene,
        surfels: u64,
        settings: &Settings,
    ) -> Result<Vec<[f32; 3]>> {
        let store = self.tree(scene, surfels)?;
        pixels(&self.shade(scene, &store, settings)?, "")
    }
}

/// A layer's pixels.
pub fn pixels(frame: &Frame, layer: &str) -> Result<Vec<[f32; 3]>> {
    Ok(frame.picture(layer, &frame.region)?.pixels)
}

/// The lvoxels of a tree.
pub fn lvoxels(store: &OpenTree) -> Result<Vec<Lvoxel>> {
    let tree = store.tree();
    let mut all = Vec::new();
    for page in 0..tree.lvoxel_pages() {
        all.extend(tree.lvoxel_page(page)?);
    }
    Ok(all)
}

/// The lvoxels of a tree.
pub fn media(store: &OpenTree) -> Result<Media> {
    Ok(Media::new(
        &store.tree().meta().cloud.volumes,
        lvoxels(store)?,
    ))
}

/// The media of a tree with the same source function everywhere.
pub fn media_with_source(store: &OpenTree, source: [f32; 3]) -> Result<Media> {
    let mut lvoxels = lvoxels(store)?;
    lvoxels.iter_mut().for_each(|l| l.source = source);
    Ok(Media::new(&store.tree().meta().cloud.volumes, lvoxels))
}

/// The surfels of a tree, ready to gather; nodes below `cut` steradians are taken whole.
pub fn gatherer<M: Medium>(store: &OpenTree, media: M, samples: u32, cut: f32) -> Gatherer<'_, M> {
    Gatherer {
        pages: &store.surfels,
        media,
        settings: gather::RaySettings {
            samples,
            max_solid_angle: cut,
            max_dist: f32::INFINITY,
            kernel: RayKernel::Cone,
            environment: Environment::even(Rgb::BLACK),
            leave_out_bright: false,
        },
    }
}

/// Irradiance, in the first channel, that a flat surface gathers.
pub fn irradiance<M: Medium>(
    gatherer: &Gatherer<'_, M>,
    point: Vec3,
    normal: Vec3,
    seed: u64,
) -> f64 {
    let got = gatherer.irradiance(point, normal, normal, SampleRange::first(seed));
    f64::from(got.light.0[0])
}

/// Mean over all pixels and channels.
pub fn mean(pixels: &[[f32; 3]]) -> f64 {
    let sum: f64 = pixels.iter().flatten().map(|&v| f64::from(v)).sum();
    sum / (3 * pixels.len()) as f64
}

/// Root of the mean squared difference over the mean of the second.
pub fn relative_rms(a: &[[f32; 3]], b: &[[f32; 3]]) -> f64 {
    let pairs = a.iter().flatten().zip(b.iter().flatten());
    let sum: f64 = pairs
        .map(|(a, b)| (f64::from(*a) - f64::from(*b)).powi(2))
        .sum();
    (sum / (3 * a.len()) as f64).sqrt() / mean(b)
}

/// A square film of `side` pixels and a camera at `position` that looks at `target`; nothing to see
/// yet.
pub fn stage(side: u32, position: Vec3, target: Vec3, fov_x_deg: f32) -> Scene {
    let back = (position - target).as_dvec3().normalize();
    let up = if back.y.abs() > 0.9 {
        DVec3::Z
    } else {
        DVec3::Y
    };
    let right = up.cross(back).normalize();
    let axes = [right, back.cross(right), back].map(DVec3::as_vec3);
    Scene::empty(
        Camera {
            name: String::new(),
            scene_from_camera: Affine3A::from_cols(
                axes[0].into(),
                axes[1].into(),
                axes[2].into(),
                position.into(),
            ),
            fov_x_rad: fov_x_deg.to_radians(),
            keys: Vec::new(),
            lens: None,
            shutter: None,
            path: Vec::new(),
        },
        Film {
            width: side,
            height: side,
            exposure: 1.0,
        },
    )
}

/// Adds a parallelogram that faces `across x down`, with a material of its own.
pub fn add_quad(scene: &mut Scene, [corner, across, down]: [Vec3; 3], albedo: f32, emission: f32) {
    let first = scene.mesh.positions.len() as u32;
    let corners = [
        corner,
        corner + across,
        corner + across + down,
        corner + down,
    ];
    scene.mesh.positions.extend(corners);
    for t in [[0, 1, 2], [0, 2, 3]] {
        scene.mesh.triangles.push(t.map(|v| v + first));
        scene.mesh.material.push(scene.materials.len() as u32);
    }
    scene.materials.push(Material {
        emission: [emission; 3],
        ..Material::diffuse("", [albedo; 3])
    });
}

/// Adds the walls of a cube around the origin, all facing inwards.
pub fn add_room(scene: &mut Scene, edge: f32, albedo: f32, emission: f32) {
    for axis in 0..3 {
        for side in [-0.5, 0.5] {
            let unit = |a: usize| Vec3::from(std::array::from_fn(|k| f32::from(u8::from(k == a))));
            let (mut u, mut v) = (unit((axis + 1) % 3) * edge, unit((axis + 2) % 3) * edge);
            let corner = unit(axis) * (side * edge) - 0.5 * (u + v);
            // u x v points along +axis.
            if side > 0.0 {
                std::mem::swap(&mut u, &mut v);
            }
            add_quad(scene, [corner, u, v], albedo, emission);
        }
    }
}

/// A medium placed anywhere.
pub fn volume(sigma_t: Grid, albedo: f32, scene_from_index: DAffine3) -> Volume {
    Volume::new(String::new(), sigma_t, [albedo; 3], scene_from_index)
}

/// The extinction of a ball in the middle of a grid of `n` voxels a side, whose edge its radius is
/// a share of.
pub fn ball(n: usize, radius: f32, sigma_t: f32) -> Grid {
    Grid::from_fn([n; 3], |v| {
        let r2: f32 = v
            .map(|c| (c as f32 + 0.5) / n as f32 - 0.5)
            .iter()
            .map(|c| c * c)
            .sum();
        if r2 < radius * radius { sigma_t } else { 0.0 }
    })
}

/// The map that puts a grid's box onto the cube `[-1/2, 1/2]^3`.
pub fn unit_cube(dims: [usize; 3]) -> DAffine3 {
    DAffine3::from_translation(DVec3::splat(-0.5))
        * DAffine3::from_scale(DVec3::from(dims.map(|n| 1.0 / n as f64)))
}

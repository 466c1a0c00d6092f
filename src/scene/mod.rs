//! What is rendered: geometry, materials, lights, volumes, cameras and film.
//!
//! In come files, or what an application makes in memory; out comes a checked [`Scene`].
//!
//! - `camera`, `light`, `material`, `texture`, `mesh`, `grid`, `volume`: what a scene consists of
//! - `instances`: meshes that are kept once and placed many times
//! - `lens`: depth of field and a shutter that is open while a camera moves
//! - `mask`: where surfaces are there
//! - `texture_mean`: means of textures over triangles
//! - `emissive`: volumes that light comes from
//! - `environment`: the sky, as an image
//! - `builder`: puts a scene together in world space and f64, and checks it as a whole
//! - `load`: readers of scene, mesh, volume and texture files, which fill a builder
//! - `packed`: scenes in one file, which are used as they lie there
//! - `digest`: what of a scene a bake depends on, as hashes
//!
//! Scene space is world space less [`Scene::world_from_scene`], a translation that keeps a scene
//! far from the origin exact in f32. Right-handed, y up, cameras look down their local -z, linear
//! Rec.709.

mod albedo_grid;
mod builder;
mod camera;
mod digest;
mod emissive;
pub(crate) mod environment;
pub(crate) mod grid;
mod instances;
mod lens;
mod light;
pub mod load;
mod mask;
mod material;
mod mesh;
pub(crate) mod packed;
mod texture;
mod texture_mean;
mod volume;

pub use crate::column::Column;
pub use crate::math::PhaseFunction;
pub use albedo_grid::AlbedoGrid;
pub use builder::{
    CameraInput, EmissiveInput, EnvironmentInput, LightInput, MeshInput, SceneBuilder, VolumeInput,
};
pub use camera::{Camera, CameraKey, Film};
pub use emissive::{Emission, EmissiveBlock, EmissiveVolume};
pub use environment::{EnvironmentImage, ImageSun};
pub use grid::{Grid, VolumeGrid};
pub use instances::{Instance, Instances, Prototype};
pub use lens::{CameraRay, Lens, Pose};
pub use light::Light;
pub use mask::{Mask, Masks};
pub use material::Material;
pub use mesh::Mesh;
pub use texture::{Texture, Wrap};
pub use volume::Volume;

use crate::math::{Aabb, Boxes, Rgb};
use crate::run::{Budget, Job};
use crate::{Error, Result};
use glam::{DAffine3, DVec3, Vec3};
use std::path::{Path, PathBuf};

/// Name of the setting of a cloud that says which group of lights it was baked with.
pub const GROUP_SETTING: &str = "group";

/// A whole scene, checked: every value is finite, every index in range, no transform singular.
#[derive(Debug)]
pub struct Scene {
    /// Name, for reports.
    pub name: String,
    /// Translation from scene space to world space, in world units.
    pub world_from_scene: DVec3,
    /// Cameras by name; the first is the default. Never empty.
    pub cameras: Vec<Camera>,
    /// Image size and tone map.
    pub film: Film,
    /// All triangles of the scene; may be empty if there is a volume.
    pub mesh: Mesh,
    /// Materials that the mesh refers to.
    pub materials: Vec<Material>,
    /// Textures that the materials refer to.
    pub textures: Vec<Texture>,
    /// Lights other than emissive materials.
    pub lights: Vec<Light>,
    /// What comes from where no surface is, beside the lights.
    pub environment_image: Option<EnvironmentImage>,
    /// Whether cameras see environments where no surface is; they light the scene in any case.
    pub is_environment_seen: bool,
    /// Participating media; may overlap.
    pub volumes: Vec<Volume>,
    /// Fire and other gases that light comes from; may overlap each other and the media.
    pub emissive: Vec<EmissiveVolume>,
    /// blake3 over the content of the scene file and of all files that it names, or over what was
    /// made in memory.
    pub hash: [u8; 32],
    /// The files that were read, the scene file first.
    pub files: Vec<PathBuf>,
    /// What the user should know: defaults that were chosen, parts of files that were left out.
    pub warnings: Vec<String>,
    /// What was made of it that is worth knowing and nothing amiss.
    pub notes: Vec<String>,
    /// Groups that its lights are in, of a scene file; [`load::DEFAULT_GROUP`] is that of lights in
    /// none.
    pub groups: Vec<String>,
    /// The only one that lights it; `None` if all do.
    pub group: Option<String>,
    /// The frame that it is at: cameras that move are where they are in that; without it at their
    /// first keys.
    pub frame: Option<i32>,
    /// The frame whose files it was made of; `None` if those of all frames are the same.
    pub files_of_frame: Option<i32>,
    /// Whether its file names volumes that have nothing in them, as before smoke rises.
    pub(crate) has_empty_volumes: bool,
    /// The file that it lies in, if that is a packed one.
    pub(crate) packed: Option<packed::PackedScene>,
}

impl Scene {
    /// A scene of a camera and nothing to see, unchecked: [`SceneBuilder`] makes scenes that are
    /// checked.
    #[must_use]
    pub fn empty(camera: Camera, film: Film) -> Self {
        Self {
            name: String::new(),
            world_from_scene: DVec3::ZERO,
            cameras: vec![camera],
            film,
            mesh: Mesh::default(),
            materials: Vec::new(),
            textures: Vec::new(),
            lights: Vec::new(),
            environment_image: None,
            is_environment_seen: true,
            volumes: Vec::new(),
            emissive: Vec::new(),
            hash: [0; 32],
            files: Vec::new(),
            warnings: Vec::new(),
            notes: Vec::new(),
            groups: Vec::new(),
            group: None,
            frame: None,
            files_of_frame: None,
            has_empty_volumes: false,
            packed: None,
        }
    }

    /// The packed file that it lies in.
    #[must_use]
    pub fn packed_path(&self) -> Option<&Path> {
        self.packed.as_ref().map(packed::PackedScene::path)
    }

    /// The packed file that it lies in, if that holds a tree.
    #[must_use]
    pub fn packed_tree(&self) -> Option<&Path> {
        let packed = self.packed.as_ref();
        let packed = packed.filter(|p| p.file().meta().tree_bytes > 0);
        packed.map(packed::PackedScene::path)
    }

    /// The packed file that it lies in, if that holds scattered light.
    #[must_use]
    pub fn packed_light(&self) -> Option<&Path> {
        let packed = self.packed.as_ref();
        let packed = packed.filter(|p| p.file().meta().light_bytes > 0);
        packed.map(packed::PackedScene::path)
    }

    /// Hash of the content of the packed file that it lies in.
    fn packed_hash(&self) -> Option<[u8; 16]> {
        self.packed.as_ref().map(|p| p.file().content_hash())
    }

    /// Refuses results from a packed file that was cut while it was used.
    pub(crate) fn check_file(&self) -> Result<()> {
        match &self.packed {
            Some(packed) => Ok(packed.file().check_length()?),
            None => Ok(()),
        }
    }

    /// Gives the memory of what lies in a packed file and is read from end to end, a part at a
    /// time, back to the system.
    pub(crate) fn release_mesh(&self) {
        if let Some(packed) = &self.packed {
            packed.release_mesh();
        }
    }

    /// The packed file whose triangles are those of the scene, as they lie there.
    pub(crate) fn as_packed(&self) -> Option<&packed::PackedScene> {
        self.packed.as_ref().filter(|packed| packed.has(&self.mesh))
    }

    /// A scene for tests that look at no picture.
    #[cfg(test)]
    pub(crate) fn without_picture() -> Self {
        let camera = Camera {
            name: String::new(),
            scene_from_camera: glam::Affine3A::IDENTITY,
            fov_x_rad: 1.0,
            keys: Vec::new(),
            lens: None,
            shutter: None,
            path: Vec::new(),
        };
        let film = Film {
            width: 1,
            height: 1,
            exposure: 1.0,
        };
        Self::empty(camera, film)
    }

    /// Goes to a frame: cameras that move are where they are in that.
    ///
    /// # Errors
    /// A scene of the files of another frame, or a camera that looks along its `up` there.
    pub fn go_to_frame(&mut self, frame: i32) -> Result<()> {
        if let Some(of) = self.files_of_frame.filter(|of| *of != frame) {
            return Err(Error::input(format!(
                "expected frame {of}, whose files the scene was made of, found frame {frame}"
            ))
            .hint("each frame of such a scene needs a file of its own: pack it for that frame"));
        }
        self.frame = Some(frame);
        self.place_moving_cameras()
    }

    /// Puts cameras that move where they are in the frame that the scene is at.
    fn place_moving_cameras(&mut self) -> Result<()> {
        for camera in &mut self.cameras {
            let Some(first) = camera.keys.first() else {
                continue;
            };
            let frame = self.frame.unwrap_or(first.frame);
            let Some(key) = CameraKey::at(&camera.keys, frame.into()) else {
                continue;
            };
            let map = key.world_from_camera();
            let map = map.map_err(|e| e.at(format!("camera `{}`, frame {frame}", camera.name)))?;
            camera.scene_from_camera = camera::in_scene(&map, self.world_from_scene);
            camera.fov_x_rad = key.fov_x_rad as f32;
            camera.lens = key.lens;
        }
        self.open_shutters()
    }

    /// Finds where cameras that move are while their shutters are open.
    fn open_shutters(&mut self) -> Result<()> {
        for camera in &mut self.cameras {
            let (Some(first), Some(shutter)) = (camera.keys.first(), camera.shutter) else {
                continue;
            };
            let frame = self.frame.unwrap_or(first.frame);
            let times = shutter.map(|t| t + f64::from(frame));
            let path = camera::path_in_shutter(&camera.keys, times, self.world_from_scene);
            camera.path = path.map_err(|e| {
                e.at(format!(
                    "camera `{}`, the shutter of frame {frame}",
                    camera.name
                ))
            })?;
        }
        Ok(())
    }

    /// Radiance from where no surface is: the sum of all environments of one colour.
    #[must_use]
    pub fn environment(&self) -> Rgb {
        let lights = self.lights.iter();
        lights.fold(Rgb::BLACK, |sum, light| match light {
            Light::Environment { radiance } => sum + Rgb(*radiance),
            _ => sum,
        })
    }

    /// Whether cameras see surfaces of every material.
    pub(crate) fn are_all_surfaces_seen(&self) -> bool {
        self.materials.iter().all(|m| m.is_seen)
    }

    /// The volumes that have a grid: the media, then those that light comes from.
    pub(crate) fn grids(&self) -> impl Iterator<Item = &Volume> {
        let emissive = self.emissive.iter().map(|e| &e.values);
        self.volumes.iter().chain(emissive)
    }

    /// Box around all volumes; empty if there is none.
    #[must_use]
    pub fn media_bounds(&self) -> Aabb {
        let corners = self.volumes.iter().flat_map(Volume::corners);
        corners.fold(Aabb::EMPTY, Aabb::with)
    }

    /// The boxes of all volumes, for what asks which of many a ray meets.
    pub(crate) fn volume_boxes(&self) -> Boxes {
        Boxes::new(self.volumes.iter().map(Volume::bounds))
    }

    /// Bytes of memory that the scene takes: triangles, but for those that lie in a packed file,
    /// textures and grids.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        self.bytes_beside_grids() + self.bytes_of_grids()
    }

    /// The same without grids.
    fn bytes_beside_grids(&self) -> u64 {
        let mut textures: Vec<&Texture> = Vec::new();
        for texture in &self.textures {
            if !textures.iter().any(|t| t.shares_texels(texture)) {
                textures.push(texture);
            }
        }
        let textures: u64 = textures.iter().map(|t| t.bytes()).sum();
        let mesh = match self.as_packed() {
            Some(_) => 0,
            None => self.mesh.bytes(),
        };
        let sky = self.environment_image.as_ref().map_or(0, |i| i.bytes());
        mesh + textures + sky
    }

    /// Bytes of the grids of volumes.
    pub(crate) fn bytes_of_grids(&self) -> u64 {
        let extinctions = self.volumes.iter().map(|v| v.sigma_t.bytes());
        extinctions.sum::<usize>() as u64 + self.bytes_of_other_grids()
    }

    /// The same but for those of extinction of media.
    pub(crate) fn bytes_of_other_grids(&self) -> u64 {
        let albedos = self.volumes.iter().filter_map(|v| v.albedo_grid.as_ref());
        let emissive = self.emissive.iter().map(|e| e.values.sigma_t.bytes());
        albedos
            .map(AlbedoGrid::bytes)
            .chain(emissive)
            .sum::<usize>() as u64
    }

    /// What a stage holds that has loaded the scene, whose grids and light in them take so many
    /// bytes.
    pub(crate) fn budget(&self, media_bytes: u64, job: &Job) -> Budget {
        let grids = self.volumes.iter().map(|v| &v.sigma_t);
        let grids = grids.chain(self.emissive.iter().map(|e| &e.values.sigma_t));
        let albedos = self.volumes.iter().filter_map(|v| v.albedo_grid.as_ref());
        let grids = grids.chain(albedos.flat_map(AlbedoGrid::channels));
        let tables = grids.map(VolumeGrid::bytes_in_memory).sum::<usize>();
        let mapped = self.as_packed().map_or(0, |packed| packed.mapped_bytes());
        Budget::default()
            .with("the program and its threads", job.process_bytes)
            .with("the scene", self.bytes_beside_grids())
            .with("tables of media", tables as u64)
            .with_lists(
                "media and their light",
                media_bytes,
                mapped,
                job.memory_limit,
            )
    }

    /// Whether the albedo of any medium varies.
    #[must_use]
    pub(crate) fn has_albedo_grids(&self) -> bool {
        self.volumes.iter().any(|v| v.albedo_grid.is_some())
    }

    /// Box around all triangles, volumes and emissive volumes.
    #[must_use]
    pub fn bounds(&self) -> Aabb {
        let mesh = &self.mesh;
        let vertices = mesh.triangles[..mesh.flat_count()].iter().flatten();
        let vertices = vertices.map(|&v| mesh.positions[v as usize]);
        let instances = mesh.instances.list().iter();
        let vertices = vertices.chain(instances.flat_map(|i| [i.bounds.min, i.bounds.max]));
        let emissive = self.emissive.iter().flat_map(|e| e.values.corners());
        let corners = vertices.chain(emissive);
        corners.fold(self.media_bounds(), Aabb::with)
    }

    /// The same scene in the frame of another: positions in scene space become what they are with
    /// this `world_from_scene`. A tree holds places in the frame of the scene that it was baked of,
    /// which moves as that grows.
    ///
    /// # Errors
    /// A frame so far from the scene that its positions would lose their digits in it.
    pub fn in_frame(mut self, world_from_scene: DVec3) -> Result<Self> {
        let shift = self.world_from_scene - world_from_scene;
        if shift == DVec3::ZERO {
            return Ok(self);
        }
        self.world_from_scene = world_from_scene;
        let moved = |p: Vec3| (p.as_dvec3() + shift).as_vec3();
        let flat = self.mesh.flat_vertices();
        let positions = &mut self.mesh.positions.to_mut()[..flat];
        positions.iter_mut().for_each(|p| *p = moved(*p));
        self.mesh.instances.shift(shift);
        for camera in &mut self.cameras {
            camera.scene_from_camera.translation = moved(camera.origin()).into();
        }
        for light in &mut self.lights {
            if let Light::Point { position, .. } | Light::Spot { position, .. } = light {
                *position = moved(*position);
            }
        }
        let emissive = self.emissive.iter_mut().map(|e| &mut e.values);
        for volume in self.volumes.iter_mut().chain(emissive) {
            volume.place(DAffine3::from_translation(shift) * volume.scene_from_index);
        }
        // To the same digits as where the scene goes to a frame in this place.
        self.place_moving_cameras()?;
        let Aabb { min, max } = self.bounds();
        let far = min.abs().max(max.abs()).as_dvec3().max_element();
        let extent = (max.as_dvec3() - min.as_dvec3()).max_element();
        // Not so for NaN, either: the difference of two places beyond f32.
        let is_near = far <= Self::MAX_EXTENTS_FROM_ORIGIN * extent;
        if !is_near {
            return Err(Error::input(format!(
                "the scene is {far:.3e} units from where the tree was baked, more than {} times \
                 its extent of {extent:.3e}",
                Self::MAX_EXTENTS_FROM_ORIGIN
            ))
            .hint("the scene has moved: bake it again"));
        }
        Ok(self)
    }

    /// Largest coordinate over the extent of a scene in the frame of another: digits enough for its
    /// own.
    const MAX_EXTENTS_FROM_ORIGIN: f64 = 1024.0;

    /// The camera of a name, the first if `None`.
    ///
    /// # Errors
    /// An unknown name; the hint lists those there are.
    pub fn camera(&self, name: Option<&str>) -> Result<&Camera> {
        let Some(name) = name else {
            return Ok(&self.cameras[0]);
        };
        self.cameras.iter().find(|c| c.name == name).ok_or_else(|| {
            let names: Vec<_> = self
                .cameras
                .iter()
                .map(|c| format!("`{}`", c.name))
                .collect();
            Error::input(format!("the scene has no camera `{name}`"))
                .hint(format!("it has {}", names.join(", ")))
        })
    }
}

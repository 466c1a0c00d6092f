//! A scene in the making: everything in world space and f64.
//!
//! In comes what readers of files or applications hand over ([`CameraInput`], [`MeshInput`],
//! [`LightInput`], [`EnvironmentInput`], [`VolumeInput`], [`EmissiveInput`]); out comes a checked
//! [`Scene`] near the origin, in f32.
//!
//! - `camera`, `light`, `environment`, `mesh`, `volume`, `emissive`: what is handed over, and the
//!   checks of each
//! - `bounds`: the box around all, and the exposure that fits it
//! - `copies`: meshes that stand at many places
//! - `merge`: all meshes joined to the one of the scene, triangles without area dropped
//! - `masks`: triangles that masks leave whole, or nothing of
//! - `emission`: triangles of which a texture leaves no light
//! - `packed`: a packed scene in place of meshes and volumes
//! - here: what is checked and made up of the scene as a whole

mod bounds;
mod camera;
mod copies;
mod emission;
mod emissive;
mod environment;
mod light;
mod masks;
mod merge;
mod mesh;
mod packed;
mod volume;

pub use camera::CameraInput;
pub(super) use copies::Copies;
pub use emissive::EmissiveInput;
pub use environment::EnvironmentInput;
pub use light::LightInput;
pub use mesh::MeshInput;
pub(super) use mesh::{DEFAULT_ALBEDO, MESH, extend_attribute, push};
pub(super) use packed::PackedInput;
pub use volume::VolumeInput;

use super::{EnvironmentImage, Film, Scene};
use crate::run::Cancel;
use crate::{Error, Result};
use environment::EnvironmentParts;
use glam::{DAffine3, DVec3};
use std::collections::{BTreeMap, BTreeSet};

/// A scene whose centre is farther from the origin than this many times its extent is moved to the
/// origin.
const FAR: f64 = 16.0;

/// Coordinates beyond this are taken for a mistake: their squares would leave the range of f32.
const MAX_COORDINATE: f64 = 1e15;

/// Emission, intensity and irradiance beyond this are taken for a mistake.
pub(super) const MAX_EMISSION: f32 = 1e30;

/// Tells of a camera that is made up.
const NO_CAMERA: &str = "the scene has no camera: framing everything from the front";
/// Tells of a light that is.
const NO_LIGHT: &str = "the scene has no light: adding an environment of radiance 1";

/// Film of a scene that does not state one.
pub(super) const DEFAULT_FILM: Film = Film {
    width: 640,
    height: 480,
    exposure: 1.0,
};

/// Puts a [`Scene`] together in memory, with the checks and normalisation that scenes from files
/// get. Everything is in world space: right-handed, y up, any unit of length, colours linear
/// Rec.709.
///
/// ```
/// use lvox::scene::{CameraInput, Film, Grid, LightInput, MeshInput, SceneBuilder, VolumeInput};
///
/// let floor = MeshInput::new(
///     "floor",
///     [[-1.0, 0.0, -1.0], [-1.0, 0.0, 1.0], [1.0, 0.0, 1.0], [1.0, 0.0, -1.0]],
///     vec![[0, 1, 2], [0, 2, 3]],
/// );
/// // A ball of fog, of 8^3 voxels with an edge of 1/8.
/// let fog = Grid::from_fn([8; 3], |voxel| {
///     let from_centre = voxel.map(|i| (i as f32 - 3.5) / 4.0);
///     let r2: f32 = from_centre.iter().map(|x| x * x).sum();
///     if r2 < 1.0 { 3.0 } else { 0.0 }
/// });
/// let world_from_grid = glam::DAffine3::from_scale(glam::DVec3::splat(0.125));
///
/// let scene = SceneBuilder::new("a floor in fog")
///     .film(Film { width: 64, height: 48, exposure: 1.0 })
///     .camera(CameraInput::look_at("front", [0.0, 1.0, 4.0], [0.0; 3], [0.0, 1.0, 0.0], 0.7)?)
///     .mesh(floor.albedo([0.8, 0.2, 0.2]))
///     .light(LightInput::point([0.0, 2.0, 0.0], [5.0; 3]))
///     .volume(VolumeInput::new("fog", fog, [0.9; 3], world_from_grid))
///     .build()?;
/// assert_eq!(scene.mesh.triangles.len(), 2);
/// assert!(scene.warnings.is_empty());
/// # Ok::<(), lvox::Error>(())
/// ```
#[derive(Debug, Default)]
pub struct SceneBuilder {
    pub(super) name: String,
    pub(super) film: Option<Film>,
    /// Whether the exposure follows from the lights.
    pub(super) automatic_exposure: bool,
    pub(super) cameras: Vec<CameraInput>,
    /// The frame at which cameras are that move.
    pub(super) frame: Option<i32>,
    pub(super) meshes: Vec<MeshInput>,
    pub(super) lights: Vec<LightInput>,
    pub(super) environment_image: Option<EnvironmentInput>,
    /// Whether cameras do not see environments.
    pub(super) is_environment_unseen: bool,
    pub(super) volumes: Vec<VolumeInput>,
    /// Whether voxels stay those of their files, however far from cubes: for who describes files.
    pub(super) keeps_voxels: bool,
    pub(super) emissive: Vec<EmissiveInput>,
    /// Groups that its lights are in.
    pub(super) groups: Vec<String>,
    /// Whether the lights of other groups are left out.
    pub(super) is_lit_in_part: bool,
    /// Meshes whose emission is, too.
    pub(super) dark_meshes: Vec<usize>,
    /// What takes the place of meshes and volumes.
    pub(super) packed: Option<PackedInput>,
}

impl SceneBuilder {
    /// A builder of an empty scene; the name is for reports.
    #[must_use]
    pub fn new(name: impl Into<String>) -> Self {
        Self {
            name: name.into(),
            ..Self::default()
        }
    }

    /// Sets image size and exposure; without it the film is 640 x 480 with an exposure of 1.
    #[must_use]
    pub fn film(mut self, film: Film) -> Self {
        self.film = Some(film);
        self
    }

    /// Adds a camera; the first is the default. Without any, one frames the whole scene.
    #[must_use]
    pub fn camera(mut self, camera: CameraInput) -> Self {
        self.cameras.push(camera);
        self
    }

    /// Adds a mesh.
    #[must_use]
    pub fn mesh(mut self, mesh: MeshInput) -> Self {
        self.meshes.push(mesh);
        self
    }

    /// Adds a mesh that stands at the places of these maps to the world, each of which is
    /// invertible. Its triangles, and what finds those along rays, are kept once. Where it emits
    /// light it is as if each place had a mesh of its own.
    #[must_use]
    pub fn instances(
        self,
        mesh: MeshInput,
        world_from_mesh: impl IntoIterator<Item = DAffine3>,
    ) -> Self {
        let places = world_from_mesh.into_iter().collect();
        self.mesh(mesh.copied(places))
    }

    /// Sets the frame at which cameras are that move; without it each is at its first key.
    #[must_use]
    pub fn frame(mut self, number: i32) -> Self {
        self.frame = Some(number);
        self
    }

    /// Adds a light. Without any, and without a mesh that emits, the scene gets an environment of
    /// radiance 1.
    #[must_use]
    pub fn light(mut self, light: LightInput) -> Self {
        self.lights.push(light);
        self
    }

    /// Sets the image of what comes from where no surface is, beside environments of one colour.
    #[must_use]
    pub fn environment_image(mut self, image: EnvironmentInput) -> Self {
        self.environment_image = Some(image);
        self
    }

    /// Lets cameras see nothing where no surface is; environments light the scene as ever.
    #[must_use]
    pub fn unseen_environment(mut self) -> Self {
        self.is_environment_unseen = true;
        self
    }

    /// Adds a volume; volumes may overlap, their extinctions add.
    #[must_use]
    pub fn volume(mut self, volume: VolumeInput) -> Self {
        self.volumes.push(volume);
        self
    }

    /// Adds a volume that light comes from; the medium that takes light there, if any, is another.
    #[must_use]
    pub fn emissive(mut self, volume: EmissiveInput) -> Self {
        self.emissive.push(volume);
        self
    }

    /// Checks everything and makes the scene. What had to be made up is in its `warnings`; its
    /// `hash` is over the content of meshes, materials, lights and volumes.
    ///
    /// # Errors
    /// Of kind [`crate::Kind::Input`] for anything that is out of range, not finite or refers to
    /// nothing, and for a scene of nothing; of kind [`crate::Kind::Failed`] if there is no memory.
    pub fn build(self) -> Result<Scene> {
        self.check_values()?;
        let mut scene = self.finish(&Cancel::default())?;
        scene.hash = scene.content_hash();
        Ok(scene)
    }

    /// Refuses what readers of files refuse before they hand it over.
    fn check_values(&self) -> Result<()> {
        if let Some(film) = &self.film {
            film.check()?;
        }
        let mut names = BTreeSet::new();
        for camera in &self.cameras {
            camera.check()?;
            if !names.insert(&camera.name) {
                return Err(Error::input(format!(
                    "two cameras have the name \"{}\"",
                    camera.name
                )));
            }
        }
        for (i, mesh) in self.meshes.iter().enumerate() {
            let checked = mesh.check().and_then(|()| mesh.check_lists());
            checked.map_err(|e| e.at(format!("mesh {}", i + 1)))?;
        }
        (self.volumes.iter()).try_for_each(VolumeInput::check_values)?;
        (self.emissive.iter()).try_for_each(EmissiveInput::check_values)
    }

    /// Adds cameras from a file that may give several the same name.
    pub(super) fn add_cameras(&mut self, cameras: Vec<CameraInput>) {
        let mut taken: BTreeSet<String> = self.cameras.iter().map(|c| c.name.clone()).collect();
        // The number to try next, by the name in the file.
        let mut numbers = BTreeMap::<String, usize>::new();
        for mut camera in cameras {
            let number = numbers.entry(camera.name.clone()).or_insert(2);
            let plain = camera.name.clone();
            while !taken.insert(camera.name.clone()) {
                camera.name = format!("{plain} {number}");
                *number += 1;
            }
            self.cameras.push(camera);
        }
    }

    /// Makes the scene of values that are checked, but for its hash and files.
    pub(super) fn finish(mut self, cancel: &Cancel) -> Result<Scene> {
        if let Some(packed) = self.packed.take() {
            return self.finish_packed(packed);
        }
        (self.meshes.iter_mut()).try_for_each(MeshInput::lay_emitters_flat)?;
        let bounds = self.bounds();
        let mut warnings = Vec::new();
        if self.meshes.iter().all(MeshInput::is_empty) && self.has_no_volume() {
            return Err(Error::input(
                "the scene has neither triangles nor volumes: there is nothing to render",
            ));
        }
        let mut film = self.film.unwrap_or(DEFAULT_FILM);
        if self.automatic_exposure {
            film.exposure = self.default_exposure(&bounds);
        }
        if self.cameras.is_empty() {
            self.cameras.push(CameraInput::framing(&bounds, &film));
            warnings.push(NO_CAMERA.into());
        }
        self.unmask_emitters(&mut warnings);
        for mesh in std::mem::take(&mut self.dark_meshes) {
            let materials = self.meshes[mesh].materials.iter_mut();
            materials.for_each(|m| (m.emission, m.emission_texture) = ([0.0; 3], None));
        }
        let mut notes = Vec::new();
        let environment_image = self.take_sky(&mut notes)?;
        if self.is_dark() && !self.is_lit_in_part && environment_image.is_none() {
            self.lights.push(LightInput::environment([1.0; 3]));
            warnings.push(NO_LIGHT.into());
        }
        self.check_places()?;

        let centre = bounds.centre();
        let world_from_scene = match centre.length() > FAR * bounds.radius() {
            true => centre,
            false => DVec3::ZERO,
        };
        let volumes_are_none = self.has_no_volume();
        let (mesh, materials, textures, clear) =
            merge::merge(self.meshes, world_from_scene, cancel)?;
        if clear > 0 {
            notes.push(format!(
                "{clear} triangles are left out of which masks leave nothing"
            ));
        }
        if mesh.triangles.is_empty() && volumes_are_none {
            return Err(Error::input(match clear {
                0 => format!(
                    "all {} triangles of the scene have zero area: there is nothing to render",
                    mesh.degenerate
                ),
                _ => format!(
                    "masks leave nothing of all {clear} triangles of the scene: \
                     there is nothing to render"
                ),
            }));
        }
        let scene_from_world = DAffine3::from_translation(-world_from_scene);
        let volumes = match self.keeps_voxels {
            true => self.volumes,
            false => VolumeInput::on_even_voxels(self.volumes, &mut notes),
        };
        let volumes = volumes.into_iter();
        let volumes = volumes.map(|v| v.in_scene(scene_from_world));
        let shining = self.emissive.into_iter().filter(|e| !e.emission.is_black());
        let emissive = shining.map(|e| e.in_scene(scene_from_world));
        let cameras = self.cameras.into_iter();
        let cameras = cameras.map(|c| c.in_scene(world_from_scene));
        let lights = self.lights.into_iter();
        let lights = lights.map(|l| l.in_scene(world_from_scene));
        let mut scene = Scene {
            name: self.name,
            world_from_scene,
            cameras: cameras.collect(),
            film,
            mesh,
            materials,
            textures,
            lights: lights.collect(),
            environment_image,
            is_environment_seen: !self.is_environment_unseen,
            volumes: volumes.collect(),
            emissive: emissive.collect(),
            hash: [0; 32],
            files: Vec::new(),
            warnings,
            notes,
            groups: self.groups,
            group: None,
            frame: None,
            files_of_frame: None,
            has_empty_volumes: false,
            packed: None,
        };
        match self.frame {
            Some(frame) => scene.go_to_frame(frame)?,
            None => scene.open_shutters()?,
        }
        Ok(scene)
    }

    /// Takes the masks of what shines: lights of such shapes are not to be had.
    fn unmask_emitters(&mut self, warnings: &mut Vec<String>) {
        let materials = self.meshes.iter_mut().flat_map(|m| &mut m.materials);
        let shining = materials.filter(|m| m.emits());
        let masked = shining.filter_map(|m| m.mask.take().map(|_| format!("`{}`", m.name)));
        let names: Vec<String> = masked.collect();
        if !names.is_empty() {
            warnings.push(format!(
                "surfaces that emit have no mask, they are there everywhere: {}",
                names.join(", ")
            ));
        }
    }

    /// The image of the sky. Suns in it become lights, which are noted, and so does one of a single
    /// colour.
    fn take_sky(&mut self, notes: &mut Vec<String>) -> Result<Option<EnvironmentImage>> {
        let Some(input) = self.environment_image.take() else {
            return Ok(None);
        };
        input.image.check()?;
        Ok(match input.into_parts() {
            EnvironmentParts::Constant(radiance) => {
                self.lights.push(LightInput::environment(radiance));
                None
            }
            EnvironmentParts::Image(image, suns) => {
                for sun in suns {
                    notes.push(environment::note(&sun));
                    self.lights.push(LightInput::of_image(&sun));
                }
                Some(image)
            }
        })
    }

    /// Refuses what is out of the range of f32; meshes are checked as they are read.
    fn check_places(&self) -> Result<()> {
        for volume in self.all_volumes() {
            volume.check_place()?;
        }
        for (i, light) in self.lights.iter().enumerate() {
            light.check(|| format!("light {}", i + 1))?;
        }
        self.cameras.iter().try_for_each(CameraInput::check)
    }

    /// Media, and the grids of emissive volumes.
    fn all_volumes(&self) -> impl Iterator<Item = &VolumeInput> {
        let emissive = self.emissive.iter().map(|e| &e.values);
        self.volumes.iter().chain(emissive)
    }

    fn has_no_volume(&self) -> bool {
        self.all_volumes().next().is_none()
    }

    fn is_dark(&self) -> bool {
        let mut materials = self.meshes.iter().flat_map(|m| &m.materials);
        let mut emissive = self.emissive.iter();
        self.lights.is_empty()
            && materials.all(|m| !m.emits())
            && emissive.all(|e| e.emission.is_black())
    }
}

/// An error for what is so far away that it must be a mistake, as for vertices.
fn check_near(what: impl Fn() -> String, at: DVec3) -> Result<()> {
    // A comparison with NaN is false.
    if at.to_array().iter().all(|v| v.abs() <= MAX_COORDINATE) {
        return Ok(());
    }
    Err(Error::input(format!(
        "{}: the position {:?} is farther than {MAX_COORDINATE:e} from the origin",
        what(),
        at.to_array()
    ))
    .hint("bring the scene near the origin, or to a unit in which it is smaller"))
}

/// Whether a map has no inverse worth the name: its axes are, up to rounding, in one plane.
pub(super) fn is_singular(map: &DAffine3) -> bool {
    let m = map.matrix3;
    let volume = m.x_axis.length() * m.y_axis.length() * m.z_axis.length();
    let finite = map.to_cols_array().iter().all(|x| x.is_finite());
    !finite || volume == 0.0 || m.determinant().abs() < 1e-12 * volume
}

#[cfg(test)]
mod tests {
    use super::merge::{check_counts, has_area};
    use super::*;
    use crate::scene::Light;
    use crate::scene::{Material, Mesh};
    use glam::Vec3;

    fn square(centre: DVec3) -> MeshInput {
        let corner = |x, y| centre + DVec3::new(x, y, 0.0);
        MeshInput {
            positions: vec![
                corner(-1.0, -1.0),
                corner(1.0, -1.0),
                corner(1.0, 1.0),
                corner(-1.0, 1.0),
            ],
            triangles: vec![[0, 1, 2], [0, 2, 3], [0, 1, 1]],
            material: vec![0; 3],
            materials: vec![Material::diffuse("grey", DEFAULT_ALBEDO)],
            ..MeshInput::default()
        }
    }

    #[test]
    fn meshes_that_cannot_be_indexed_are_refused() {
        let (vertices, triangles) = (u32::MAX as usize, Mesh::MAX_TRIANGLES);
        check_counts(vertices, triangles).unwrap();
        for (vertices, triangles, part) in [
            (vertices + 1, triangles, "4294967296 vertices"),
            (vertices, triangles + 1, "134217729 triangles"),
        ] {
            let error = check_counts(vertices, triangles).unwrap_err();
            assert_eq!(error.kind(), crate::Kind::Input);
            assert!(error.to_string().contains(part), "{error}");
        }
    }

    #[test]
    fn zero_area_is_dropped_and_counted() {
        assert!(!has_area([DVec3::ZERO, DVec3::ONE, DVec3::splat(3.0)]));
        assert!(has_area([DVec3::ZERO, DVec3::X * 1e-20, DVec3::Y * 1e-20]));
        let builder = SceneBuilder {
            meshes: vec![square(DVec3::ZERO)],
            ..SceneBuilder::default()
        };
        let scene = builder.finish(&Cancel::default()).unwrap();
        assert_eq!(scene.mesh.triangles.len(), 2);
        assert_eq!(scene.mesh.material, [0, 0]);
        assert_eq!(scene.mesh.degenerate, 1);
        assert_eq!(scene.world_from_scene, DVec3::ZERO);
        assert_eq!(scene.warnings.len(), 2, "{:?}", scene.warnings);
    }

    #[test]
    fn a_scene_far_away_is_brought_home_exactly() {
        let far = DVec3::new(1e6, -3e6, 2e6);
        let builder = SceneBuilder {
            meshes: vec![square(far + 0.125)],
            lights: vec![LightInput {
                light: Light::Point {
                    position: Vec3::ZERO,
                    intensity: [1.0; 3],
                },
                position: far + DVec3::new(0.125, 0.375, 0.125),
            }],
            ..SceneBuilder::default()
        };
        let scene = builder.finish(&Cancel::default()).unwrap();
        assert_eq!(scene.world_from_scene, far + 0.125);
        assert_eq!(scene.mesh.positions[2], Vec3::new(1.0, 1.0, 0.0));
        let Light::Point { position, .. } = scene.lights[0] else {
            unreachable!()
        };
        assert_eq!(position, Vec3::new(0.0, 0.25, 0.0));
    }

    #[test]
    fn the_default_camera_sees_everything() {
        let builder = SceneBuilder {
            meshes: vec![square(DVec3::new(5.0, 0.0, 0.0))],
            ..SceneBuilder::default()
        };
        let scene = builder.finish(&Cancel::default()).unwrap();
        let camera = &scene.cameras[0];
        let half = (0.5 * camera.fov_x_rad).tan();
        for p in &scene.mesh.positions {
            let q = camera.scene_from_camera.inverse().transform_point3(*p);
            assert!(q.z < 0.0 && q.x.abs() < -q.z * half && q.y.abs() < -q.z * half * 0.75);
        }
    }

    #[test]
    fn nothing_to_render_is_an_error() {
        let message = |meshes| {
            let builder = SceneBuilder {
                meshes,
                ..SceneBuilder::default()
            };
            builder.finish(&Cancel::default()).unwrap_err().to_string()
        };
        assert!(message(vec![]).contains("neither triangles nor volumes"));
        let mut flat = square(DVec3::ZERO);
        flat.positions = vec![DVec3::ONE; 4];
        assert!(message(vec![flat]).contains("zero area"));
    }
}

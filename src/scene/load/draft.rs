//! A scene in the making: everything in world space and f64. [`Draft::finish`] checks it as a
//! whole, moves it near the origin and brings it to f32.

use super::super::{Camera, Film, Grid, Light, Mesh, Scene, Volume};
use super::files::Files;
use super::part::{FARTHEST, MESH, Part, merge};
use crate::run::{Cancel, memory};
use crate::{Error, Result};
use glam::{Affine3A, DAffine3, DMat3, DVec3, Vec2, Vec3};

/// A scene whose centre is farther from the origin than this many times its extent is moved to the
/// origin.
const FAR: f64 = 16.0;

/// Layers of voxels thinner than this are taken for a mistake: what a ray passes per unit would
/// leave the range of f32.
const THINNEST: f64 = 1.0 / FARTHEST;

/// Film of a scene that does not state one.
pub(super) const DEFAULT_FILM: Film = Film {
    width: 640,
    height: 480,
    exposure: 1.0,
};

#[derive(Default)]
pub(super) struct Draft {
    pub(super) name: String,
    pub(super) film: Option<Film>,
    /// Whether the exposure follows from the lights.
    pub(super) automatic_exposure: bool,
    pub(super) cameras: Vec<DraftCamera>,
    pub(super) parts: Vec<Part>,
    pub(super) lights: Vec<DraftLight>,
    pub(super) volumes: Vec<DraftVolume>,
}

pub(super) struct DraftCamera {
    pub(super) name: String,
    /// Rotation and position.
    pub(super) world_from_camera: DAffine3,
    pub(super) fov_x_rad: f64,
}

pub(super) struct DraftLight {
    /// The light, but for its position.
    pub(super) light: Light,
    /// Where it is, for kinds that are somewhere.
    pub(super) position: DVec3,
}

pub(super) struct DraftVolume {
    pub(super) name: String,
    pub(super) sigma_t: Grid,
    pub(super) albedo: [f32; 3],
    pub(super) world_from_index: DAffine3,
}

impl DraftVolume {
    /// Corners of its box.
    fn corners(&self) -> [DVec3; 8] {
        let size = self.sigma_t.dims().map(|n| n as f64);
        std::array::from_fn(|corner| {
            let at = |a: usize| if corner >> a & 1 == 1 { size[a] } else { 0.0 };
            let p = DVec3::new(at(0), at(1), at(2));
            self.world_from_index.transform_point3(p)
        })
    }

    /// An error unless it is of a size and at a place that f32 can hold.
    fn check(&self) -> Result<()> {
        let what = || format!("the volume \"{}\"", self.name);
        for corner in self.corners() {
            check_near(|| format!("{}: a corner of its box", what()), corner)?;
        }
        // Rows of the inverse stand on the layers of voxels, and are as long as these are thin.
        let m = self.world_from_index.matrix3.inverse().transpose();
        let steepest = [m.x_axis, m.y_axis, m.z_axis].map(DVec3::length);
        let thinnest = 1.0 / steepest.into_iter().fold(0.0, f64::max);
        // Not the other way round: there may be no number at all.
        if !(steepest.iter().all(|v| v.is_finite()) && thinnest >= THINNEST) {
            return Err(Error::input(format!(
                "{}: expected voxels of at least {THINNEST:e} units in each direction, found {thinnest:e}",
                what()
            ))
            .hint("enlarge the volume by `scale`, or by the matrix that places it"));
        }
        Ok(())
    }
}

/// An error for what is so far away that it must be a mistake, as for vertices.
fn check_near(what: impl Fn() -> String, at: DVec3) -> Result<()> {
    // A comparison with NaN is false.
    if at.to_array().iter().all(|v| v.abs() <= FARTHEST) {
        return Ok(());
    }
    Err(Error::input(format!(
        "{}: the position {:?} is farther than {FARTHEST:e} from the origin",
        what(),
        at.to_array()
    ))
    .hint("bring the scene near the origin, or to a unit in which it is smaller"))
}

/// A box in world space.
#[derive(Clone, Copy)]
struct Bounds {
    low: DVec3,
    high: DVec3,
}

impl Bounds {
    const EMPTY: Self = Self {
        low: DVec3::INFINITY,
        high: DVec3::NEG_INFINITY,
    };

    fn add(&mut self, p: DVec3) {
        self.low = self.low.min(p);
        self.high = self.high.max(p);
    }

    fn centre(&self) -> DVec3 {
        0.5 * (self.low + self.high)
    }

    fn radius(&self) -> f64 {
        0.5 * (self.high - self.low).length()
    }
}

/// Rotation and position of a camera at `position` that looks at `target`; `None` if `up` does not
/// settle it.
pub(super) fn look_at(position: DVec3, target: DVec3, up: DVec3) -> Option<DAffine3> {
    let back = (position - target).try_normalize()?;
    let up = up.try_normalize()?;
    let across = up.cross(back);
    let right = (across.length() > 1e-9).then(|| across.normalize())?;
    Some(DAffine3 {
        matrix3: DMat3::from_cols(right, back.cross(right), back),
        translation: position,
    })
}

impl Draft {
    /// Adds a camera from a file that may give several the same name.
    pub(super) fn add_camera(&mut self, mut camera: DraftCamera) {
        let taken = |name: &str| self.cameras.iter().any(|c| c.name == name);
        let plain = camera.name.clone();
        let mut number = 2;
        while taken(&camera.name) {
            camera.name = format!("{plain} {number}");
            number += 1;
        }
        self.cameras.push(camera);
    }

    /// The checked scene.
    pub(super) fn finish(mut self, mut files: Files) -> Result<Scene> {
        let bounds = self.bounds();
        if self.parts.iter().all(|p| p.triangles.is_empty()) && self.volumes.is_empty() {
            return Err(Error::input(
                "the scene has neither triangles nor volumes: there is nothing to render",
            ));
        }
        let mut film = self.film.unwrap_or(DEFAULT_FILM);
        if self.automatic_exposure {
            film.exposure = self.default_exposure(&bounds);
        }
        if self.cameras.is_empty() {
            self.cameras.push(default_camera(&bounds, &film));
            files.warn("the scene has no camera: framing everything from the front");
        }
        self.light_if_dark(&mut files);
        self.check_places()?;

        let centre = bounds.centre();
        let world_from_scene = match centre.length() > FAR * bounds.radius() {
            true => centre,
            false => DVec3::ZERO,
        };
        let (mesh, materials, textures) = merge_parts(self.parts, world_from_scene, &files.cancel)?;
        if mesh.triangles.is_empty() && self.volumes.is_empty() {
            return Err(Error::input(format!(
                "all {} triangles of the scene have zero area: there is nothing to render",
                mesh.degenerate
            )));
        }
        let scene_from_world = DAffine3::from_translation(-world_from_scene);
        let volumes = self.volumes.into_iter().map(|v| {
            let scene_from_index = scene_from_world * v.world_from_index;
            let mut volume = Volume::new(v.name, v.sigma_t, v.albedo, scene_from_index);
            volume.limit_extinction();
            volume
        });
        let cameras = self.cameras.into_iter().map(|c| Camera {
            name: c.name,
            scene_from_camera: affine_f32(&(scene_from_world * c.world_from_camera)),
            fov_x_rad: c.fov_x_rad as f32,
        });
        let lights = self.lights.into_iter().map(|mut l| {
            if let Light::Point { position, .. } | Light::Spot { position, .. } = &mut l.light {
                *position = (l.position - world_from_scene).as_vec3();
            }
            l.light
        });
        Ok(Scene {
            name: self.name,
            world_from_scene,
            cameras: cameras.collect(),
            film,
            mesh,
            materials,
            textures,
            lights: lights.collect(),
            volumes: volumes.collect(),
            hash: files.hash(),
            files: files.paths,
            warnings: files.warnings,
        })
    }

    /// An error if anything but a mesh, which is checked as it is read, is out of the range of f32.
    fn check_places(&self) -> Result<()> {
        for volume in &self.volumes {
            volume.check()?;
        }
        for (i, light) in self.lights.iter().enumerate() {
            check_near(|| format!("light {}", i + 1), light.position)?;
        }
        for camera in &self.cameras {
            let at = camera.world_from_camera.translation;
            check_near(|| format!("the camera \"{}\"", camera.name), at)?;
        }
        Ok(())
    }

    fn bounds(&self) -> Bounds {
        let mut bounds = Bounds::EMPTY;
        for part in &self.parts {
            // Vertices that no triangle uses are not part of the picture.
            for v in part.triangles.iter().flatten() {
                bounds.add(part.positions[*v as usize]);
            }
        }
        for volume in &self.volumes {
            for corner in volume.corners() {
                bounds.add(corner);
            }
        }
        bounds
    }

    /// For a file that says nothing of film: the exposure at which a white surface in the middle of
    /// the scene that faces all its lights is just white, so that lights in lux and in watts make
    /// the same picture.
    fn default_exposure(&self, bounds: &Bounds) -> f32 {
        let distance2 = (bounds.radius() * bounds.radius()) as f32;
        let brightest: f32 = self
            .lights
            .iter()
            .map(|l| match l.light {
                Light::Directional { irradiance, .. } => irradiance,
                Light::Point { intensity, .. } | Light::Spot { intensity, .. } => {
                    intensity.map(|v| v / distance2)
                }
                Light::Environment { radiance } => radiance.map(|v| v * std::f32::consts::PI),
            })
            .map(|irradiance| irradiance.into_iter().fold(0.0, f32::max) / std::f32::consts::PI)
            .sum();
        if brightest.is_finite() && brightest > 0.0 {
            1.0 / brightest
        } else {
            DEFAULT_FILM.exposure
        }
    }

    fn light_if_dark(&mut self, files: &mut Files) {
        let emits = |p: &Part| p.materials.iter().any(|m| m.emission != [0.0; 3]);
        if self.lights.is_empty() && !self.parts.iter().any(emits) {
            self.lights.push(DraftLight {
                light: Light::Environment { radiance: [1.0; 3] },
                position: DVec3::ZERO,
            });
            files.warn("the scene has no light: adding an environment of radiance 1");
        }
    }
}

fn affine_f32(map: &DAffine3) -> Affine3A {
    Affine3A::from_mat3_translation(map.matrix3.as_mat3(), map.translation.as_vec3())
}

/// A camera in front of everything, a little above, from where the bounding sphere just fits the
/// film.
fn default_camera(bounds: &Bounds, film: &Film) -> DraftCamera {
    let fov_x_rad = 45_f64.to_radians();
    let aspect = f64::from(film.height) / f64::from(film.width);
    let half_x = 0.5 * fov_x_rad;
    let half_y = libm::atan(libm::tan(half_x) * aspect);
    let distance = bounds.radius() / libm::sin(half_x.min(half_y));
    let target = bounds.centre();
    let position = target + DVec3::new(0.3, 0.35, 1.0).normalize() * distance;
    DraftCamera {
        name: "default".into(),
        // The direction is not along y, so this always is a camera unless the scene is a single
        // point.
        world_from_camera: look_at(position, target, DVec3::Y)
            .unwrap_or(DAffine3::from_translation(target)),
        fov_x_rad,
    }
}

type Merged = (
    Mesh,
    Vec<super::super::Material>,
    Vec<super::super::Texture>,
);

/// Refuses meshes that cannot be indexed.
fn check_counts(vertices: usize, triangles: usize) -> Result<()> {
    if vertices > u32::MAX as usize {
        return Err(Error::input(format!(
            "the scene has {vertices} vertices, more than the {} that can be indexed",
            u32::MAX
        )));
    }
    if triangles > Mesh::MOST_TRIANGLES {
        return Err(Error::input(format!(
            "the scene has {triangles} triangles, more than the {} that it may have",
            Mesh::MOST_TRIANGLES
        )));
    }
    Ok(())
}

fn merge_parts(parts: Vec<Part>, world_from_scene: DVec3, cancel: &Cancel) -> Result<Merged> {
    let mut mesh = Mesh::default();
    let mut materials = Vec::new();
    let mut textures = Vec::new();
    let vertices: usize = parts.iter().map(|p| p.positions.len()).sum();
    let count: usize = parts.iter().map(|p| p.triangles.len()).sum();
    check_counts(vertices, count)?;
    mesh.positions = memory::room(MESH, vertices)?;
    mesh.triangles = memory::room(MESH, count)?;
    mesh.material = memory::room(MESH, count)?;
    for part in parts {
        cancel.check()?;
        let first_vertex = mesh.positions.len();
        let first_material = materials.len() as u32;
        let first_texture = textures.len() as u32;
        let moved = part
            .positions
            .iter()
            .map(|p| (p - world_from_scene).as_vec3());
        mesh.positions.extend(moved);
        let total = mesh.positions.len();
        let mut normals = part.normals;
        normals.iter_mut().for_each(|n| *n = n.normalize_or_zero());
        merge(&mut mesh.normals, normals, first_vertex, total, Vec3::ZERO)?;
        merge(&mut mesh.colors, part.colors, first_vertex, total, [1.0; 3])?;
        let textured = part.materials.iter().any(|m| m.texture.is_some());
        let mut uvs = if textured { part.uvs } else { Vec::new() };
        if textured {
            // Whoever sees a texture may count on there being coordinates.
            let missing = part.positions.len().saturating_sub(uvs.len());
            memory::grow(MESH, &mut uvs, missing)?;
            uvs.resize(part.positions.len(), Vec2::ZERO);
        }
        merge(&mut mesh.uvs, uvs, first_vertex, total, Vec2::ZERO)?;
        for (triangle, material) in part.triangles.iter().zip(&part.material) {
            cancel.check()?;
            let triangle = triangle.map(|v| v + first_vertex as u32);
            if has_area(triangle.map(|v| mesh.positions[v as usize].as_dvec3())) {
                mesh.triangles.push(triangle);
                mesh.material.push(material + first_material);
            } else {
                mesh.degenerate += 1;
            }
        }
        materials.extend(part.materials.into_iter().map(|mut m| {
            m.texture = m.texture.map(|t| t + first_texture);
            m
        }));
        textures.extend(part.textures);
    }
    Ok((mesh, materials, textures))
}

/// Whether the area of a triangle is more than the rounding of f64 makes of a line.
fn has_area([a, b, c]: [DVec3; 3]) -> bool {
    let (ab, ac, bc) = (b - a, c - a, c - b);
    let longest = ab
        .length_squared()
        .max(ac.length_squared())
        .max(bc.length_squared());
    ab.cross(ac).length() > 1e-14 * longest
}

#[cfg(test)]
mod tests {
    use super::super::part::DEFAULT_ALBEDO;
    use super::*;
    use crate::scene::Material;

    fn square(centre: DVec3) -> Part {
        let corner = |x, y| centre + DVec3::new(x, y, 0.0);
        Part {
            positions: vec![
                corner(-1.0, -1.0),
                corner(1.0, -1.0),
                corner(1.0, 1.0),
                corner(-1.0, 1.0),
            ],
            triangles: vec![[0, 1, 2], [0, 2, 3], [0, 1, 1]],
            material: vec![0; 3],
            materials: vec![Material::diffuse("grey", DEFAULT_ALBEDO)],
            ..Part::default()
        }
    }

    #[test]
    fn meshes_that_cannot_be_indexed_are_refused() {
        let (vertices, triangles) = (u32::MAX as usize, Mesh::MOST_TRIANGLES);
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
        let draft = Draft {
            parts: vec![square(DVec3::ZERO)],
            ..Draft::default()
        };
        let scene = draft.finish(Files::default()).unwrap();
        assert_eq!(scene.mesh.triangles.len(), 2);
        assert_eq!(scene.mesh.material, [0, 0]);
        assert_eq!(scene.mesh.degenerate, 1);
        assert_eq!(scene.world_from_scene, DVec3::ZERO);
        assert_eq!(scene.warnings.len(), 2, "{:?}", scene.warnings);
    }

    #[test]
    fn a_scene_far_away_is_brought_home_exactly() {
        let far = DVec3::new(1e6, -3e6, 2e6);
        let draft = Draft {
            parts: vec![square(far + 0.125)],
            lights: vec![DraftLight {
                light: Light::Point {
                    position: Vec3::ZERO,
                    intensity: [1.0; 3],
                },
                position: far + DVec3::new(0.125, 0.375, 0.125),
            }],
            ..Draft::default()
        };
        let scene = draft.finish(Files::default()).unwrap();
        assert_eq!(scene.world_from_scene, far + 0.125);
        assert_eq!(scene.mesh.positions[2], Vec3::new(1.0, 1.0, 0.0));
        let Light::Point { position, .. } = scene.lights[0] else {
            unreachable!()
        };
        assert_eq!(position, Vec3::new(0.0, 0.25, 0.0));
    }

    #[test]
    fn the_default_camera_sees_everything() {
        let draft = Draft {
            parts: vec![square(DVec3::new(5.0, 0.0, 0.0))],
            ..Draft::default()
        };
        let scene = draft.finish(Files::default()).unwrap();
        let camera = &scene.cameras[0];
        let half = (0.5 * camera.fov_x_rad).tan();
        for p in &scene.mesh.positions {
            let q = camera.scene_from_camera.inverse().transform_point3(*p);
            assert!(q.z < 0.0 && q.x.abs() < -q.z * half && q.y.abs() < -q.z * half * 0.75);
        }
    }

    #[test]
    fn nothing_to_render_is_an_error() {
        let message = |parts| {
            let draft = Draft {
                parts,
                ..Draft::default()
            };
            draft.finish(Files::default()).unwrap_err().to_string()
        };
        assert!(message(vec![]).contains("neither triangles nor volumes"));
        let mut flat = square(DVec3::ZERO);
        flat.positions = vec![DVec3::ONE; 4];
        assert!(message(vec![flat]).contains("zero area"));
    }
}

//! Surfels where the rays of a camera meet surfaces, in a frustum a little
//! wider than the image.
//!
//! What the camera does not see does not bleed. Area sampling serves better; this is for
//! comparison.

use super::surfels::{SurfelMaker, SurfelSource};
use crate::light::Shadows;
use crate::math::Ray;
use crate::math::magnitude::to_unit;
use crate::scene::{Camera, Film, Scene};
use glam::Vec3;
use lvox_formats::record::Surfel;

/// A ray that grazes a surface this flatly stands for no more area than one at this cosine.
const MIN_COS: f32 = 0.05;

/// The rays of a camera.
pub struct Frustum {
    camera: Camera,
    film: Film,
    axis: Vec3,
    /// Edge of a pixel on the image plane at distance 1.
    pixel: f32,
}

impl Frustum {
    /// So many rays per pixel along each axis, in a frustum so much wider than the image.
    pub fn new(scene: &Scene, camera: &Camera, rate: f32, overscan: f32) -> Self {
        let film = scene.film;
        let size = |n: u32| (n as f32 * rate * overscan).ceil().max(1.0) as u32;
        let film = Film {
            width: size(film.width),
            height: size(film.height),
            ..film
        };
        let camera = Camera {
            fov_x_rad: 2.0 * libm::atanf(libm::tanf(0.5 * camera.fov_x_rad) * overscan),
            ..camera.clone()
        };
        Self {
            axis: camera.scene_from_camera.transform_vector3(-Vec3::Z),
            pixel: 2.0 * libm::tanf(0.5 * camera.fov_x_rad) / film.width as f32,
            camera,
            film,
        }
    }

    /// One surfel for each ray that hits.
    pub fn surfels<'a, S: Shadows>(
        self,
        maker: &'a SurfelMaker<'a, S>,
        overlap: f32,
    ) -> SurfelSource<'a> {
        SurfelSource {
            samples: u64::from(self.film.width) * u64::from(self.film.height),
            unit: "rays",
            make: Box::new(move |i| self.surfel(maker, overlap, i)),
            walked_mesh: None,
        }
    }

    /// The surfel where a ray hits.
    fn surfel<S: Shadows>(&self, maker: &SurfelMaker<S>, overlap: f32, i: u64) -> Option<Surfel> {
        let width = u64::from(self.film.width);
        let (x, y) = ((i % width) as f32, (i / width) as f32);
        let direction = self.camera.direction(&self.film, x + 0.5, y + 0.5);
        let ray = Ray::endless(self.camera.origin(), direction);
        let hit = maker.tracer.closest_seen(&ray)?;
        let mesh = &maker.tracer.scene.mesh;
        let across = mesh.area_vector(hit.triangle as usize);
        // Its square may leave the range of f32.
        let normal = (across * to_unit(across.abs().max_element())).normalize_or_zero();
        // The pixel's square on the image plane, cast onto the surface.
        let cos = normal.dot(direction).abs().max(MIN_COS);
        let depth_cos = self.axis.dot(direction);
        let area = hit.t * hit.t * self.pixel * self.pixel * depth_cos.powi(3) / cos;
        Some(maker.make(hit.triangle, hit.uv, area, overlap, i))
    }
}

//! Pilot gathers: a few gathers all over the frame, before any other, which tell whether few bright
//! places send much of its light.
//!
//! They stand where the frame's pixels tell, not those of a region, so that tiles agree, and not at
//! the points that those see but at the middle of what lies around them, so that a camera that
//! hardly moves finds the same.

use crate::gather::{BrightHit, Crossing, PatchRadiance, PatchRequest, UnknownPatches};
use crate::math::sampling::{self, cosine_hemisphere, sobol2, tangents};
use crate::math::{Environment, Hit, Ray};
use crate::trace::Surface;
use crate::tree::SurfelStore;
use crate::view::View;
use glam::Vec3;
use rayon::prelude::*;

/// Pilot gathers along each axis of the frame.
const PILOTS_ALONG_AXIS: u32 = 12;
/// Rays of each.
const RAYS_PER_PILOT: u32 = 24;
/// What is bright sends so many times the mean of what pilot gathers see: less than one ray in as
/// many meets it.
const BRIGHT_OVER_MEAN: f32 = 16.0;
/// Share of the light that pilot gathers see which has to come from there.
const MIN_BRIGHT_SHARE: f32 = 0.3;

/// Where pilot gathers met what is bright in a frame.
#[derive(Debug)]
pub(super) struct BrightHits {
    /// Where pilot gathers saw it.
    pub hits: Vec<BrightHit>,
    /// What it sends at least, by the mean channel.
    pub least: f32,
}

impl BrightHits {
    /// How many hits speak for a place that is seen: each ray alone reaches as far as to where
    /// others of its gather do.
    pub const MIN_SUPPORT: usize = 4;
}

/// Gathers before any other of a frame, and what they ask.
pub(super) struct PilotGathers<'a> {
    pub view: &'a View<'a>,
    pub patches: &'a PatchRadiance<'a>,
    pub pages: &'a SurfelStore,
    pub environment: Environment<'a>,
    /// A node seen under less than this is taken whole, steradians.
    pub max_solid_angle: f32,
}

impl PilotGathers<'_> {
    /// What is bright, if that sends much of what pilot gathers see.
    pub fn bright(&self) -> Option<BrightHits> {
        let pilots = || (0..PILOTS_ALONG_AXIS * PILOTS_ALONG_AXIS).into_par_iter();
        if self.pages.are_cached() {
            let unknown = pilots().map(|pilot| {
                let rays = self.rays_of(pilot);
                self.patches.unknown_along(&rays, self.request())
            });
            let unknown = UnknownPatches::of_all(unknown.collect());
            self.patches.evaluate_in_order(self.pages, unknown);
        }
        let seen: Vec<_> = pilots()
            .flat_map_iter(|pilot| self.seen_by(pilot))
            .collect();
        let mean = seen.iter().map(|(light, _)| light).sum::<f32>() / seen.len().max(1) as f32;
        let least = BRIGHT_OVER_MEAN * mean;
        let bright: Vec<_> = (seen.iter())
            .filter(|(light, _)| *light > least)
            .copied()
            .collect();
        let light: f32 = bright.iter().map(|(light, _)| light).sum();
        (light > MIN_BRIGHT_SHARE * mean * seen.len() as f32).then(|| BrightHits {
            hits: bright.iter().filter_map(|(_, seed)| *seed).collect(),
            least,
        })
    }

    /// The request that rays make of patches.
    fn request(&self) -> PatchRequest {
        PatchRequest {
            max_solid_angle: self.max_solid_angle,
            leave_out_bright: false,
        }
    }

    /// The rays of a pilot gather; none where it stands nowhere.
    fn rays_of(&self, pilot: u32) -> Vec<Ray> {
        let Some(surface) = self.stand(pilot) else {
            return Vec::new();
        };
        let (origin, normal) = (self.view.off_surface(&surface), surface.face_normal);
        let (x, y) = tangents(normal);
        let key = sampling::mix(u64::from(pilot)) as u32;
        let ray = |i| {
            let d = cosine_hemisphere(sobol2(i, 0, key));
            let d = (x * d.x + y * d.y + normal * d.z).normalize();
            Ray::endless(origin, d)
        };
        (0..RAYS_PER_PILOT).map(ray).collect()
    }

    /// What the rays of a pilot gather bring, by the mean channel, and where they meet surfaces:
    /// those that meet anything.
    fn seen_by(&self, pilot: u32) -> Vec<(f32, Option<BrightHit>)> {
        let mut stack = Default::default();
        let seen = |ray: Ray| {
            let end = (self.patches).cast(self.pages, &ray, self.request(), &mut stack);
            match end {
                Some(Crossing { t, radiance, .. }) => {
                    // Of the disk at that distance that a ray stands for, where it falls straight.
                    let radius = t * (2.0 / RAYS_PER_PILOT as f32).sqrt();
                    let position = ray.at(t);
                    Some((radiance.mean(), Some(BrightHit { position, radius })))
                }
                // What brings nothing because there is nothing does not make the rest bright.
                None => {
                    let sky = self.environment.radiance(ray.direction).mean();
                    (sky > 0.0).then_some((sky, None))
                }
            }
        };
        self.rays_of(pilot).into_iter().filter_map(seen).collect()
    }

    /// The surface on which a pilot gather stands: on what its pixel sees.
    fn stand(&self, pilot: u32) -> Option<Surface> {
        let view = self.view;
        let at = [pilot % PILOTS_ALONG_AXIS, pilot / PILOTS_ALONG_AXIS]
            .map(|c| (c as f32 + 0.5) / PILOTS_ALONG_AXIS as f32);
        let size = [view.film.width, view.film.height].map(|c| c as f32);
        let to_surface = view
            .camera
            .direction(&view.film, at[0] * size[0], at[1] * size[1]);
        let origin = view.camera.origin();
        let hit = view
            .tracer
            .closest_seen(&Ray::endless(origin, to_surface))?;
        let around = 0.25 * size[0] / PILOTS_ALONG_AXIS as f32 * view.pixel_angle * hit.t;
        let corners = view.tracer.scene.mesh.corners(hit.triangle as usize);
        let uv = middle_around(&hit, corners, around);
        Some(Surface::new(view.tracer.scene, hit.triangle, uv).facing(-to_surface))
    }
}

/// The middle of that part of a triangle, about so long, in which a hit is.
fn middle_around(hit: &Hit, [a, b, c]: [Vec3; 3], length: f32) -> [f32; 2] {
    const MAX_LEVELS: u32 = 12;
    let longest = (b - a).length().max((c - a).length());
    let mut parts = 1.0;
    for _ in 0..MAX_LEVELS {
        if longest <= length * parts {
            break;
        }
        parts *= 2.0;
    }
    let [i, j] = hit.uv.map(|w| (w * parts).floor().clamp(0.0, parts - 1.0));
    let j = j.min(parts - 1.0 - i);
    [i, j].map(|c| (c + 1.0 / 3.0) / parts)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_near_each_other_have_one_middle_inside_the_triangle() {
        let corners = [Vec3::ZERO, Vec3::X * 3.0, Vec3::Y];
        let middle = |u: f32, v: f32, length| {
            let hit = Hit {
                t: 1.0,
                triangle: 0,
                uv: [u, v],
                is_back: false,
            };
            middle_around(&hit, corners, length)
        };
        assert_eq!(middle(0.3, 0.3, 9.0), [1.0 / 3.0; 2]);
        assert_eq!(middle(0.26, 0.4, 1.0), middle(0.27, 0.41, 1.0));
        assert_ne!(middle(0.26, 0.4, 1.0), middle(0.24, 0.4, 1.0));
        for i in 0..100 {
            let [a, b] = sampling::r2(i, [0.5; 2]);
            let (u, v) = if a + b > 1.0 {
                (1.0 - a, 1.0 - b)
            } else {
                (a, b)
            };
            let [u, v] = middle(u, v, 0.05);
            assert!(u > 0.0 && v > 0.0 && u + v < 1.0, "{u} {v}");
        }
        assert!(middle(0.5, 0.5, 0.0).iter().all(|c| c.is_finite()));
    }
}

//! Light around a point in a medium so dense that rays end within a voxel of it, where nothing that
//! is stored by voxels tells how light changes.

use super::gatherer::GatherInMedia;
use crate::gather::cone;
use crate::light::{Lights, ShadowRays};
use crate::math::exp::{exp_neg, exp_neg_and_rest};
use crate::math::segment::Segment;
use crate::math::{Ray, Rgb, sampling};
use crate::scene::Volume;
use glam::Vec3;

/// Mean over the sphere of the light from surfaces and media: along each ray one point of the media
/// is lit for all of them, chosen by the share of the ray's light that comes from there, and the
/// surface behind is seen through what they leave.
pub fn mean_radiance<G: GatherInMedia>(
    volumes: &[Volume],
    lights: &Lights,
    surfaces: &G,
    point: Vec3,
    seed: u64,
) -> Rgb {
    let tracer = lights.tracer();
    let count = surfaces.settings().samples.max(1);
    let mut scratch = cone::Scratch::default();
    let mut passed: Vec<Segment> = Vec::new();
    let mut sum = Rgb::BLACK;
    for i in 0..count {
        let [u, v, w, _] = sobol_burley::sample_4d(i, 0, sampling::mix(seed) as u32);
        let direction = sampling::sphere([u, v]);
        let max_dist = surfaces.settings().max_dist;
        let reach = tracer
            .closest(&Ray::new(point, direction, max_dist))
            .map_or(max_dist, |hit| hit.t);
        passed.clear();
        let mut depth = 0.0;
        tracer.march(
            &Ray::new(point, direction, reach),
            |volume, _, _| Rgb(volumes[volume].albedo),
            |s| {
                depth += s.tau;
                passed.push(s);
                depth < OPAQUE_DEPTH
            },
        );
        let (mut through, taken) = if depth < OPAQUE_DEPTH {
            exp_neg_and_rest(depth)
        } else {
            (0.0, 1.0)
        };
        if through > 0.0 && max_dist.is_finite() && reach >= max_dist {
            // Media that are too far away to send light still hide the environment.
            let from = point + direction * max_dist;
            through *= exp_neg(tracer.optical_depth(&Ray::endless(from, direction)));
        }
        let mut target = -libm::log1pf(-w * taken);
        let source = passed.iter().find(|s| {
            let here = target <= s.tau;
            if !here {
                target -= s.tau;
            }
            here
        });
        if let Some(s) = source.or(passed.last()).filter(|_| taken > 0.0) {
            let share = (target / s.tau).min(1.0);
            let at = point + direction * (s.near + (s.far - s.near) * share);
            let rays = ShadowRays::Sequence {
                per_light: 1,
                first: i,
                seed,
            };
            let light =
                lights.mean_radiance(at, rays).light() + lights.environment_mean_radiance(at, rays);
            sum += s.source * light * taken;
        }
        if through > 0.0 {
            sum += surfaces
                .incident_from_surfaces(&Ray::endless(point, direction), &mut scratch)
                .radiance
                * through;
        }
    }
    sum * (1.0 / count as f32)
}

/// Depth behind which nothing is looked at.
const OPAQUE_DEPTH: f32 = 10.0;

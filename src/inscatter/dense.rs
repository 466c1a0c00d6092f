//! Light around a point in a medium so dense that rays end within a voxel of it, where nothing that
//! is stored by voxels tells how light changes.

use super::gatherer::GatherInMedia;
use crate::gather::cone;
use crate::light::{Lights, ShadowRays};
use crate::math::exp::{exp_neg, exp_neg_and_rest};
use crate::math::segment::Segment;
use crate::math::{PhaseFunction, Ray, Rgb, SeenPhase, sampling};
use crate::scene::Volume;
use glam::Vec3;

/// Light from surfaces and media that is scattered along a ray, or its mean over the sphere: along each ray one point of the media
/// is lit for all of them, chosen by the share of the ray's light that comes from there, and the
/// surface behind is seen through what they leave.
pub fn mean_radiance<G: GatherInMedia>(
    volumes: &[Volume],
    lights: &Lights,
    surfaces: &G,
    point: Vec3,
    seen: Option<SeenPhase>,
    seed: u64,
) -> Rgb {
    let tracer = lights.tracer();
    let count = surfaces.settings().samples.max(1);
    let mut scratch = cone::Scratch::default();
    let mut passed: Vec<Segment> = Vec::new();
    let mut sum = Rgb::BLACK;
    for i in 0..count {
        let [u, v, w, _] = sobol_burley::sample_4d(i, 0, sampling::mix(seed) as u32);
        let direction = match seen {
            None => sampling::sphere([u, v]),
            Some(seen) => seen.sample([u, v]),
        };
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
            let seen = SeenPhase::of(phase_at(volumes, at), direction);
            let light = lights.scattered(at, rays, seen).light()
                + lights.scattered_environment(at, rays, seen);
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

/// The phase function of the first medium at a point.
fn phase_at(volumes: &[Volume], point: Vec3) -> PhaseFunction {
    let is_there = |v: &&Volume| {
        let at = v.index_from_scene.transform_point3(point);
        v.sigma_t.sample(at) > 0.0
    };
    match volumes {
        [one] => one.phase,
        _ => (volumes.iter().find(is_there)).map_or(PhaseFunction::ISOTROPIC, |v| v.phase),
    }
}

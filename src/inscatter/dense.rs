//! Light around a point in a medium so dense that rays end within a voxel of it, where nothing that
//! is stored by voxels tells how light changes.

use super::gatherer::GatherInMedia;
use crate::gather::cone;
use crate::light::{Lights, SceneMedia, ShadowRays};
use crate::math::exp::exp_neg;
use crate::math::segment::Segment;
use crate::math::{PhaseFunction, Ray, Rgb, SeenPhase, Spectrum, sampling};
use crate::scene::Volume;
use glam::Vec3;

/// Light from surfaces and media that is scattered along a ray, or its mean over the sphere: along
/// each ray one point of the media is lit for all of them, chosen by the share of the ray's light
/// that comes from there, and the surface behind is seen through what they leave.
pub fn mean_radiance<G: GatherInMedia>(
    volumes: &[Volume],
    lights: &Lights<SceneMedia<G::Share>>,
    surfaces: &G,
    point: Vec3,
    seen: Option<SeenPhase>,
    seed: u64,
) -> Rgb {
    let tracer = lights.tracer();
    let count = surfaces.settings().samples.max(1);
    let mut scratch = cone::Scratch::default();
    let mut passed: Vec<Segment<G::Share>> = Vec::new();
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
        let mut depth = G::Share::default();
        tracer.march(
            &Ray::new(point, direction, reach),
            |volume, passed, _| {
                let middle = point + direction * (0.5 * (passed.near + passed.far));
                volumes[volume].albedo_in_scene(middle)
            },
            |s| {
                depth += s.tau;
                passed.push(s);
                depth.least() < OPAQUE_DEPTH
            },
        );
        let (mut through, taken) = if depth.least() < OPAQUE_DEPTH {
            depth.exp_neg_and_rest()
        } else {
            (G::Share::splat(0.0), G::Share::splat(1.0))
        };
        if through.most() > 0.0 && max_dist.is_finite() && reach >= max_dist {
            // Media that are too far away to send light still hide the environment.
            let from = point + direction * max_dist;
            let beyond = tracer.optical_depth::<G::Share>(&Ray::endless(from, direction));
            through = through.times(beyond.exp_neg());
        }
        // The channel that most is taken of chooses the point for all.
        let mut target = -libm::log1pf(-w * taken.most());
        let source = passed.iter().find(|s| {
            let here = target <= s.tau.most();
            if !here {
                target -= s.tau.most();
            }
            here
        });
        if let Some(s) = source.or(passed.last()).filter(|_| taken.most() > 0.0) {
            let share = (target / s.tau.most()).min(1.0);
            let at = point + direction * (s.near + (s.far - s.near) * share);
            let rays = ShadowRays::Sequence {
                per_light: 1,
                first: i,
                seed,
            };
            let seen = SeenPhase::of(phase_at(volumes, at), direction);
            let light = lights.scattered(at, rays, seen).light()
                + lights.scattered_environment(at, rays, seen);
            sum += weight_of(s, share, &passed, taken).filter(s.source * light);
        }
        if through.most() > 0.0 {
            let incident =
                surfaces.incident_from_surfaces(&Ray::endless(point, direction), &mut scratch);
            sum += through.filter(incident.radiance);
        }
    }
    sum * (1.0 / count as f32)
}

/// Weight of the light at a share of a segment, over the chance with which the channel of the
/// largest depths chooses it: what is taken on the whole way if all channels are one.
fn weight_of<K: Spectrum>(s: &Segment<K>, share: f32, passed: &[Segment<K>], taken: K) -> K {
    if K::IS_GREY {
        return taken;
    }
    let (mut before, mut of_most) = (s.tau * share, s.tau.most() * share);
    for p in passed.iter().take_while(|p| p.near < s.near) {
        before += p.tau;
        of_most += p.tau.most();
    }
    let density = s.tau.times(before.exp_neg());
    let chosen = s.tau.most() * exp_neg(of_most);
    density * (taken.most() / chosen.max(f32::MIN_POSITIVE))
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

//! Light at the fronts of media that are opaque within few voxels, where pixels are wider than
//! those.
//!
//! The camera sees no more than a skin there, over whose depth light changes fast: vertices close
//! enough to tell how are many more than pixels. Direct light is that of the ray's own points. A
//! vertex of indirect light stands for what the camera sees of the medium around it, up to a
//! spacing away: along each direction a ray leaves another point of that, chosen by what of the
//! camera's rays ends there. A pixel shows the same mean over the skin's depth.

use super::segment::RaySegment;
use super::{InScatter, RayMemo};
use crate::inscatter::counts;
use crate::inscatter::gatherer::GatherInMedia;
use crate::inscatter::seen_channels::OPAQUE;
use crate::inscatter::vertices::blend;
use crate::light::{Lights, SceneMedia, SunDepths};
use crate::math::exp::one_minus_exp_neg;
use crate::math::segment::Segment;
use crate::math::{Ray, Rgb, Spectrum, sampling};
use crate::run::walked::note_asked;
use glam::Vec3;
use wide::f32x4;

/// What a camera sees around a vertex.
#[derive(Clone, Copy, Debug, Default)]
pub struct SeenFront {
    /// The channels of the indirect light there times the share of rays that end there, and that
    /// share.
    light_and_share: f32x4,
}

/// A part of a ray around a vertex.
struct SeenPart {
    /// In scene space.
    ends: [Vec3; 2],
    depth: f32,
    /// What of the ray ends there, weighted by how near to the vertex.
    share: f32,
}

impl<G: GatherInMedia> InScatter<'_, G> {
    /// Camera rays past a vertex.
    const FRONT_RAYS: u32 = 4;
    /// Points of a vertex that gather where no probes tell what is around them.
    const FRONT_POINTS: u32 = 4;

    /// Scene units between vertices of the front that a point is in; `None` if it is in none.
    #[inline]
    pub(in crate::inscatter) fn front_spacing(&self, volume: usize, point: Vec3) -> Option<f32> {
        let lattices = &self.lattices[volume];
        if !lattices.fronts.are_any() {
            return None;
        }
        let to_index = &self.volumes[volume].index_from_scene;
        let level = lattices.fronts.at(to_index.transform_point3(point));
        (level > 0).then(|| lattices.voxel * (1 << level) as f32)
    }

    /// Direct light at two points (Gauss-Legendre) of what the camera sees of a segment, with so
    /// many shadow rays each: it is not linear along a dense one.
    pub(super) fn direct_of_points(
        &self,
        segment: &RaySegment<G::Share>,
        lights: &Lights<SceneMedia<G::Share>>,
        suns: Option<&SunDepths>,
        rays: u32,
    ) -> Rgb {
        let mut sum = Rgb::BLACK;
        for share in [0.211_324_87, 0.788_675_1] {
            let point = segment.at_share(share);
            let rays = Self::rays(rays, self.seed_of(point));
            let light = self.lit(lights, point, rays, suns, segment.seen);
            let unshadowed = self.unshadowed([point; 2], segment);
            sum += (light.share * unshadowed + light.rest) * 0.5;
        }
        sum
    }

    /// Unshadowed light of point and spot lights on a part of a pixel's segment.
    pub(super) fn unshadowed(&self, ends: [Vec3; 2], segment: &RaySegment<G::Share>) -> Rgb {
        let camera = self.view.camera.origin();
        let width = |light: Vec3| self.view.pixel_angle * light.distance(camera);
        (self.lights).unshadowed_along(ends, width, segment.seen)
    }

    /// Indirect light on a segment at a front; `None` elsewhere, and if no vertex around is seen.
    pub(super) fn front(&self, segment: &RaySegment<G::Share>, memo: &mut RayMemo) -> Option<Rgb> {
        let (volume, level) = (segment.volume, segment.front);
        if level == 0 {
            return None;
        }
        let lattice = &self.lattices[volume].seen_fronts[level];
        let around = lattice.around(segment.at);
        let values = memo.fronts.values((volume, level), &around, |v| {
            note_asked(true);
            *lattice.get(v, &|p, v| {
                self.seen_front(volume, level, p, self.key(volume, level, v))
            })
        });
        let seen = blend(values, &around.weights, |v| v.light_and_share);
        let [r, g, b, share] = seen.to_array();
        (share > 0.0).then(|| Rgb([r, g, b]) * (1.0 / share))
    }

    /// What the camera sees around a vertex.
    fn seen_front(&self, volume: usize, level: usize, at: Vec3, key: u64) -> SeenFront {
        let spacing = self.lattices[volume].voxel * (1 << level) as f32;
        let vertex = self.to_scene(volume, at);
        let ahead = (vertex - self.view.camera.origin()).normalize_or(Vec3::Z);
        let (right, up) = sampling::tangents(ahead);
        let mut parts = Vec::new();
        for i in 0..Self::FRONT_RAYS {
            let [u, v, ..] = sobol_burley::sample_4d(i, 0, sampling::mix(key) as u32);
            let beside = (right * tent(u) + up * tent(v)) * spacing;
            self.add_seen(vertex + beside, spacing, &mut parts);
        }
        let all: f32 = parts.iter().map(|p| p.share).sum();
        if all <= 0.0 {
            return SeenFront::default();
        }
        let count = self.lattices[volume].far_field.quarters();
        let place = |i: u32| {
            let u = sampling::unit(sampling::hash(&[key, u64::from(i)]));
            let point = point_of(&parts, all * (i as f32 + u) / count as f32);
            let in_index = self.volumes[volume]
                .index_from_scene
                .transform_point3(point);
            (in_index, point)
        };
        let light = self.gathered_at(volume, count, place, key);
        let [r, g, b] = light.0;
        SeenFront {
            light_and_share: f32x4::new([r, g, b, 1.0])
                * f32x4::splat(all / Self::FRONT_RAYS as f32),
        }
    }

    /// Indirect light at places among which all of `count` numbers choose alike.
    fn gathered_at(
        &self,
        volume: usize,
        count: u32,
        place: impl Fn(u32) -> (Vec3, Vec3),
        key: u64,
    ) -> Rgb {
        let Some(gatherer) = self.gatherer else {
            return Rgb::BLACK;
        };
        let medium = &self.volumes[volume];
        if medium.phase.is_isotropic() && gatherer.settings().max_dist.is_infinite() {
            let field = &self.lattices[volume].far_field;
            if let Some(light) = field.seen(medium, gatherer, &place, key, &self.counters) {
                counts::add(&self.counters.gathered, 1);
                return light;
            }
        }
        let mut sum = Rgb::BLACK;
        for i in 0..Self::FRONT_POINTS {
            let (at, point) = place((i * count + count / 2) / Self::FRONT_POINTS);
            let key = sampling::hash(&[key, u64::from(i)]);
            sum += self.gathered(volume, at, point, key);
        }
        sum * (1.0 / Self::FRONT_POINTS as f32)
    }

    /// Adds what a camera ray sees of media up to a spacing before and behind a point.
    fn add_seen(&self, middle: Vec3, spacing: f32, parts: &mut Vec<SeenPart>) {
        let tracer = self.view.tracer;
        let camera = self.view.camera.origin();
        let distance = middle.distance(camera);
        if distance == 0.0 {
            return;
        }
        let direction = (middle - camera) / distance;
        let end = distance + spacing;
        let end = (tracer.closest(&Ray::new(camera, direction, end))).map_or(end, |hit| hit.t);
        let mut through = G::Share::splat(1.0);
        let nothing = |_, _, _| Rgb::BLACK;
        let ray = Ray::new(camera, direction, end);
        tracer.march(&ray, nothing, |s: Segment<G::Share>| {
            let (of_part, taken) = s.tau.exp_neg_and_rest();
            let off = (0.5 * (s.near + s.far) - distance).abs();
            if off < spacing {
                parts.push(SeenPart {
                    ends: [s.near, s.far].map(|t| camera + direction * t),
                    depth: s.tau.mean(),
                    share: through.times(taken).mean() * (1.0 - off / spacing),
                });
            }
            through = through.times(of_part);
            through.most() >= OPAQUE
        });
    }
}

/// A number from -1 to 1, rarer towards these.
fn tent(u: f32) -> f32 {
    match u < 0.5 {
        true => libm::sqrtf(2.0 * u) - 1.0,
        false => 1.0 - libm::sqrtf(2.0 * (1.0 - u)),
    }
}

/// The point before which parts have so much of their shares.
fn point_of(parts: &[SeenPart], before: f32) -> Vec3 {
    let mut left = before;
    for part in parts {
        if left >= part.share {
            left -= part.share;
            continue;
        }
        let of_part = left / part.share;
        let reach = match part.depth > 0.0 {
            true => -libm::log1pf(-of_part * one_minus_exp_neg(part.depth)) / part.depth,
            false => of_part,
        };
        let [from, to] = part.ends;
        return from + (to - from) * reach.min(1.0);
    }
    // By rounding.
    parts.last().map_or(Vec3::ZERO, |part| part.ends[1])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_are_as_dense_as_what_is_seen_of_parts() {
        let part = |at: f32, depth: f32, share: f32| SeenPart {
            ends: [Vec3::X * at, Vec3::X * (at + 1.0)],
            depth,
            share,
        };
        let parts = [
            part(0.0, 1.0, 0.25),
            part(2.0, 0.0, 0.0),
            part(5.0, 3.0, 0.5),
        ];
        for i in 0..100 {
            let before = 0.75 * (i as f32 + 0.5) / 100.0;
            let x = point_of(&parts, before).x;
            let (from, depth, share, rest) = match before < 0.25 {
                true => (0.0, 1.0, 0.25, before),
                false => (5.0, 3.0, 0.5, before - 0.25),
            };
            let found = share * one_minus_exp_neg(depth * (x - from)) / one_minus_exp_neg(depth);
            assert!((found - rest).abs() < 1e-5, "{before}: {x}");
        }
        // Beyond all that is seen.
        assert_eq!(point_of(&parts, 0.76).x, 6.0);
    }
}

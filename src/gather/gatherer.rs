//! The gather itself: rays from a receiver, and what arrives along them.

use super::crossing::Crossing;
use super::directions::Hemisphere;
use super::medium::{Medium, NoMedia};
use super::patch_radiance::{self, PatchRadiance, PatchRequest, UnknownPatches};
use super::{cone, plain};
use crate::math::sampling::{sobol2, sphere};
use crate::math::segment::Composite;
use crate::math::{Environment, Ray, Rgb, SeenPhase, Spectrum, sampling};
use crate::tree::SurfelStore;
use crate::{Error, Result};
use glam::Vec3;
use std::f32::consts::PI;

/// Settings that all rays of a [`Gatherer`] share.
#[derive(Clone, Copy, Debug)]
pub struct RaySettings<'a> {
    /// Rays of each gather.
    pub samples: u32,
    /// A node seen under less than this, in steradians, may stand for all below it, and a cube of
    /// lvoxels under a quarter of it; 0 for disks and lvoxels only. Sets the size of patches, too,
    /// which are never smaller than a disk or so.
    pub max_solid_angle: f32,
    /// Surfaces and media beyond this distance send nothing, but still hide the environment;
    /// infinite for no limit.
    pub max_dist: f32,
    /// The way in which the surface that ends a ray is found.
    pub kernel: RayKernel<'a>,
    /// Radiance where a ray meets nothing.
    pub environment: Environment<'a>,
    /// Whether bright patches count as black, because the caller samples them itself;
    /// [`PatchRadiance::find_bright`] finds them.
    pub leave_out_bright: bool,
}

/// Refuses a largest solid angle that is none.
///
/// # Errors
/// Names the setting, what it may be and what it was.
pub fn check_max_solid_angle(steradians: f32) -> Result<()> {
    if (0.0..=1.0).contains(&steradians) {
        return Ok(());
    }
    Err(Error::input(format!(
        "`max_solid_angle` must be 0 to 1 steradian, found {steradians}"
    )))
}

impl RaySettings<'_> {
    /// Whether surfaces that are too far away to send light matter: before an environment they do.
    fn is_hiding(&self) -> bool {
        self.max_dist.is_finite() && !self.environment.is_black()
    }

    /// Distance up to which surfaces matter, scene units.
    pub(super) fn reach(&self) -> f32 {
        if self.is_hiding() {
            f32::INFINITY
        } else {
            self.max_dist
        }
    }

    /// Width of rays at a distance of 1: what they pass in media may be as coarse. As with surfels,
    /// the plain kernel takes every lvoxel.
    pub fn beam_width(&self) -> f32 {
        /// Over the edge of what is seen under the largest solid angle. Media are seen through, and
        /// cubes of lvoxels have hard edges.
        const BEAM: f32 = 0.5;
        match self.kernel {
            RayKernel::Plain => 0.0,
            RayKernel::Traced(_) | RayKernel::Cone => BEAM * self.max_solid_angle.sqrt(),
        }
    }

    /// The request that rays make of patches.
    fn request(&self) -> PatchRequest {
        PatchRequest {
            max_solid_angle: self.max_solid_angle,
            leave_out_bright: self.leave_out_bright,
        }
    }
}

/// The surfaces that end rays, and how they are found.
#[derive(Clone, Copy, Debug)]
pub enum RayKernel<'a> {
    /// The scene's triangles; the tree tells what they send.
    Traced(&'a PatchRadiance<'a>),
    /// Surfels, and nodes whole below the solid angle, eight children at a time.
    Cone,
    /// The paper's: every disk, one node at a time.
    Plain,
}

/// The light that arrives at a point.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Gathered {
    /// Irradiance for a surface, mean radiance over the sphere for a point in a medium.
    pub light: Rgb,
    /// The part of it that comes straight from the environment.
    pub environment: Rgb,
    /// Harmonic mean of the distance to what was seen, or twice that by the light that comes from
    /// there where this is less: how far away light changes; infinite if nothing was seen.
    pub harmonic_distance: f32,
    /// Mean of the directions of rays, each over the distance of what it met: points to what is
    /// near.
    pub toward: Vec3,
}

/// The light that arrives along one ray.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Incident {
    /// Radiance that arrives at the ray's origin.
    pub radiance: Rgb,
    /// The part of it that comes straight from the environment.
    pub environment: Rgb,
    /// Distance to the surface that ended the ray, infinite if none did. One that is too far away
    /// to send light may be told or not.
    pub distance: f32,
    /// One over the distance of what is seen, in the mean over the surface and the media before it
    /// by the share of the ray that each stops.
    pub inverse_distance: f32,
    /// Share of what that surface sends that arrives: what is left by all before it.
    pub arriving: f32,
    /// Direction in which the ray looks.
    pub direction: Vec3,
}

/// Gathers from a tree, with one type of media, which [`super::PointGatherer`] hides.
#[derive(Clone, Copy, Debug)]
pub struct Gatherer<'a, M> {
    /// Pages of the tree over surfels.
    pub pages: &'a SurfelStore,
    /// The media that rays pass.
    pub media: M,
    /// Rays, limits and kernel of all gathers.
    pub settings: RaySettings<'a>,
}

/// The directions of a gather: a range of a long well-spread sequence. Receivers near each other
/// that take one range each of one sequence are, together, as good as one receiver with all their
/// rays.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SampleRange {
    /// Number of the range in the sequence, from 0.
    pub index: u32,
    /// Key of the sequence.
    pub seed: u64,
}

impl SampleRange {
    /// The first range of a sequence, for a receiver on its own.
    #[must_use]
    pub fn first(seed: u64) -> Self {
        Self { index: 0, seed }
    }
}

/// The sum over the rays of one receiver.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct IncidentSum {
    light: Rgb,
    environment: Rgb,
    inverse_distance: f32,
    /// The same times the light of each ray.
    lit_inverse_distance: f32,
    toward: Vec3,
    /// What an environment that differs by direction would send along rays, and how many these are.
    unhidden: Rgb,
    rays: u32,
}

impl IncidentSum {
    pub fn add(&mut self, seen: Incident) {
        self.light += seen.radiance;
        self.environment += seen.environment;
        self.inverse_distance += seen.inverse_distance;
        self.lit_inverse_distance += seen.radiance.mean() * seen.inverse_distance;
        self.toward += seen.direction * seen.inverse_distance;
    }

    /// Adds what an environment would send along a ray if nothing were before it.
    pub fn add_unhidden(&mut self, radiance: Rgb) {
        self.unhidden += radiance;
        self.rays += 1;
    }

    /// Returns the irradiance of a surface, the mean over `count` rays that are spread by the
    /// cosine to its normal. Of an environment that differs by direction rays tell the share that
    /// is not hidden, so that it has no noise where nothing hides it.
    pub fn irradiance(self, count: u32, normal: Vec3, environment: &Environment) -> Gathered {
        /// Few rays may have missed what is bright.
        const MOST: f32 = 4.0;
        let mut gathered = self.mean(count);
        gathered.light *= PI;
        gathered.environment *= PI;
        if let Some(map) = environment.map().filter(|_| self.rays > 0) {
            let expected = map.irradiance.get(normal);
            let found = self.unhidden * (PI / self.rays as f32);
            for c in 0..3 {
                if found.0[c] > 0.0 {
                    let known = gathered.environment.0[c];
                    let factor = (expected.0[c] / found.0[c]).clamp(1.0 / MOST, MOST);
                    gathered.environment.0[c] = known * factor;
                    gathered.light.0[c] += known * (factor - 1.0);
                }
            }
        }
        gathered
    }

    /// Returns the mean over `count` rays, those that were not added being black and endless.
    pub fn mean(self, count: u32) -> Gathered {
        let n = count as f32;
        // Of rays that find nothing and bring nothing any number may be beside the few that tell
        // how light changes.
        let plain = n / self.inverse_distance;
        let lit = self.light.mean() / self.lit_inverse_distance;
        Gathered {
            light: self.light * (1.0 / n),
            environment: self.environment * (1.0 / n),
            harmonic_distance: plain.min(2.0 * lit),
            toward: self.toward / n,
        }
    }
}

impl<'a, M: Medium> Gatherer<'a, M> {
    /// This gatherer without its media.
    #[must_use]
    pub fn without_media(&self) -> Gatherer<'a, NoMedia> {
        Gatherer {
            pages: self.pages,
            media: NoMedia,
            settings: self.settings,
        }
    }

    /// Gathers the irradiance at a surface point with the given unit normal, of the light on the
    /// side of the geometric one, too: what is behind the facet of a smooth mesh does not reach it.
    /// The point must already be off its own surface.
    #[must_use]
    pub fn irradiance(
        &self,
        point: Vec3,
        normal: Vec3,
        face_normal: Vec3,
        range: SampleRange,
    ) -> Gathered {
        let hemisphere = Hemisphere::new(normal, range.seed);
        let environment = &self.settings.environment;
        let rays = self.rays(point, range.index, |i| {
            hemisphere.direction_above(i, face_normal)
        });
        let mut seen = self.sum_along(&rays);
        if environment.map().is_some() {
            let sent = rays.iter().map(|ray| environment.radiance(ray.direction));
            sent.for_each(|radiance| seen.add_unhidden(radiance));
        }
        seen.irradiance(self.count(), normal, environment)
    }

    /// Gathers the mean over the sphere of the radiance at a point of a medium.
    #[must_use]
    pub fn mean_radiance(&self, point: Vec3, range: SampleRange) -> Gathered {
        let seed = sampling::mix(range.seed) as u32;
        let rays = self.rays(point, range.index, |i| Some(sphere(sobol2(i, 0, seed))));
        self.sum_along(&rays).mean(self.count())
    }

    /// Gathers the radiance that a point of a medium of albedo 1 scatters along a ray.
    #[must_use]
    pub fn scattered(&self, point: Vec3, range: SampleRange, seen: SeenPhase) -> Gathered {
        let seed = sampling::mix(range.seed) as u32;
        let rays = self.rays(point, range.index, |i| {
            Some(seen.sample(sobol2(i, 0, seed)))
        });
        self.sum_along(&rays).mean(self.count())
    }

    /// Rays of each gather.
    pub(super) fn count(&self) -> u32 {
        self.settings.samples.max(1)
    }

    pub(super) fn rays(
        &self,
        point: Vec3,
        range: u32,
        direction: impl Fn(u32) -> Option<Vec3>,
    ) -> Vec<Ray> {
        let count = self.count();
        let directions = (0..count).filter_map(|i| direction(range * count + i));
        let reach = self.settings.reach();
        directions.map(|d| Ray::new(point, d, reach)).collect()
    }

    fn sum_along(&self, rays: &[Ray]) -> IncidentSum {
        let mut seen = IncidentSum::default();
        self.incident_along(rays, |_, s| seen.add(s));
        seen
    }

    /// Tells what arrives along each of some rays, which end where surfaces no longer matter, and
    /// which ray that is, one after the other.
    pub fn incident_along(&self, rays: &[Ray], mut tell: impl FnMut(usize, Incident)) {
        self.incident_and_crossings_along(rays, |i, seen, _| tell(i, seen));
    }

    /// The same with the partly covered nodes before what ends each ray.
    #[inline(always)]
    pub(super) fn incident_and_crossings_along(
        &self,
        rays: &[Ray],
        mut tell: impl FnMut(usize, Incident, &[Crossing]),
    ) {
        let mut scratch = cone::Scratch::default();
        let RayKernel::Traced(patches) = self.settings.kernel else {
            for (i, ray) in rays.iter().enumerate() {
                let seen = self.incident(ray, &mut scratch);
                tell(i, seen, &scratch.crossings);
            }
            return;
        };
        let request = self.settings.request();
        let mut ends = [None; patch_radiance::MAX_PACKET];
        for (packet, first) in rays.chunks(ends.len()).zip((0..).step_by(ends.len())) {
            let open = &mut scratch.open_by_patch;
            patches.cast_packet(self.pages, packet, request, open, &mut ends);
            for ((ray, &end), i) in packet.iter().zip(&ends).zip(first..) {
                let seen = self.incident_before(ray, end, &mut scratch);
                tell(i, seen, &scratch.crossings);
            }
        }
    }

    /// The patches that rays end on, as far as their radiance comes from pages that may be decoded
    /// again and again, and is not known; none where another kernel finds what ends rays.
    pub fn unknown_along(&self, rays: &[Ray]) -> UnknownPatches {
        match self.settings.kernel {
            RayKernel::Traced(patches) if self.pages.are_cached() => {
                patches.unknown_along(rays, self.settings.request())
            }
            _ => UnknownPatches::default(),
        }
    }

    /// Whether [`Self::unknown_along`] may find any.
    pub fn has_unknown(&self) -> bool {
        self.pages.are_cached() && matches!(self.settings.kernel, RayKernel::Traced(_))
    }

    /// Evaluates patches in the order of their places.
    pub fn evaluate(&self, unknown: UnknownPatches) {
        if let RayKernel::Traced(patches) = self.settings.kernel {
            patches.evaluate_in_order(self.pages, unknown);
        }
    }

    /// Returns what arrives along a ray, as far as the settings say: what is beyond its own end
    /// neither sends nor hides.
    #[must_use]
    // Not inlined by itself once it is compiled for more than one kind of medium.
    #[inline(always)]
    pub fn incident(&self, ray: &Ray, scratch: &mut cone::Scratch) -> Incident {
        let ray = &ray.up_to(self.settings.reach());
        let end = match self.settings.kernel {
            RayKernel::Traced(patches) => {
                scratch.crossings.clear();
                let request = self.settings.request();
                patches.cast(self.pages, ray, request, &mut scratch.open_by_patch)
            }
            RayKernel::Cone => {
                let cut = self.settings.max_solid_angle;
                cone::cast(self.pages, ray, cut, scratch)
            }
            RayKernel::Plain => plain::cast(self.pages, ray, scratch),
        };
        self.incident_before(ray, end, scratch)
    }

    /// Returns what arrives along a ray that such a surface ends, with the partly covered nodes
    /// before it in `scratch`.
    #[inline(always)]
    fn incident_before(
        &self,
        ray: &Ray,
        end: Option<Crossing>,
        scratch: &mut cone::Scratch,
    ) -> Incident {
        let RaySettings {
            max_dist,
            environment,
            ..
        } = self.settings;
        let is_hiding = self.settings.is_hiding();
        let mut of_environment = Rgb::BLACK;
        let passed = scratch.crossings_before(end.map_or(f32::INFINITY, |c| c.t));
        let near = passed.partition_point(|c| c.t < max_dist);
        let (near, far) = passed.split_at(near);
        let to_end = ray.up_to(end.map_or(max_dist, |c| c.t.min(max_dist)));
        let mut light = Composite::<M::Share>::default();
        let width = self.settings.beam_width();
        let stopped = self.media.pass(&to_end, width, near, &mut light);
        let distance = end.map_or(f32::INFINITY, |c| c.t);
        let inverse_distance =
            stopped.share * stopped.inverse_distance + (1.0 - stopped.share) / distance;
        let arriving = light.transmittance.mean();
        match end {
            Some(c) if c.t < max_dist => light.surface(1.0, c.radiance),
            Some(_) => {}
            None => {
                if is_hiding {
                    let mut hidden = Composite::<M::Share>::default();
                    let beyond = Ray::endless(ray.at(max_dist), ray.direction);
                    self.media.pass(&beyond, width, &[], &mut hidden);
                    light.transmittance = light.transmittance.times(hidden.transmittance);
                    far.iter()
                        .for_each(|c| light.surface(c.opacity, Rgb::BLACK));
                }
                let environment = environment.radiance(ray.direction);
                of_environment = light.transmittance.filter(environment);
                light.surface(1.0, environment);
            }
        }
        Incident {
            radiance: light.radiance,
            environment: of_environment,
            distance,
            inverse_distance,
            arriving,
            direction: ray.direction,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// How far away light changes, by so many of 100 rays that meet things 2 away, which send this.
    fn distance(rays: u32, radiance: f32) -> f32 {
        let mut sum = IncidentSum::default();
        for _ in 0..rays {
            sum.add(Incident {
                radiance: Rgb::splat(radiance),
                environment: Rgb::BLACK,
                distance: 2.0,
                inverse_distance: 0.5,
                arriving: 1.0,
                direction: Vec3::Z,
            });
        }
        sum.mean(100).harmonic_distance
    }

    #[test]
    fn light_of_few_rays_changes_over_the_distance_that_they_go() {
        assert_eq!(distance(100, 1.0), 2.0);
        assert_eq!(distance(40, 1.0), 4.0);
        assert_eq!(distance(2, 1.0), 4.0);
        // What is dark hides light from afar, if there is any.
        assert_eq!(distance(2, 0.0), 100.0);
        assert_eq!(distance(0, 0.0), f32::INFINITY);
    }
}

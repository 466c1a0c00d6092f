//! What a point inside media asks of a gatherer, for whichever media that was compiled.

use crate::gather::{
    Gathered, Gatherer, Incident, LvoxelBlock, Medium, RaySettings, SampleRange, UnknownPatches,
    cone,
};
use crate::math::segment::{Composite, Segment};
use crate::math::{Ray, SeenPhase, Spectrum};
use glam::Vec3;

/// Gathers of light inside media.
pub trait GatherInMedia: Sync {
    /// What tells depths and shares of light: one number, or one for each channel if media have
    /// colour.
    type Share: Spectrum;

    /// Rays, limits and kernel of the gathers.
    fn settings(&self) -> &RaySettings<'_>;

    /// Mean over the sphere of the radiance at a point of a medium, or what of it is scattered
    /// along a ray.
    fn scattered(&self, point: Vec3, range: SampleRange, seen: Option<SeenPhase>) -> Gathered;

    /// Radiance that surfaces alone send along a ray, as if there were no media.
    fn incident_from_surfaces(&self, ray: &Ray, scratch: &mut cone::Scratch) -> Incident;

    /// The patches that rays evaluate which pass no media, as far as that takes pages of the tree
    /// which may be decoded again and again.
    fn unknown_along(&self, _rays: &[Ray]) -> UnknownPatches {
        UnknownPatches::default()
    }

    /// Evaluates patches in the order of their places.
    fn evaluate(&self, _unknown: UnknownPatches) {}

    /// Whether [`Self::unknown_along`] may find any.
    fn has_unknown(&self) -> bool {
        false
    }

    /// Gives every segment of medium along a ray, front to back, to `add` until
    /// that says no; returns whether it never did.
    fn walk(&self, ray: &Ray, add: &mut impl FnMut(Segment<Self::Share>) -> bool) -> bool;

    /// The same where light travels with the ray, not against it.
    fn walk_with(&self, ray: &Ray, add: &mut impl FnMut(Segment<Self::Share>) -> bool) -> bool {
        self.walk(ray, add)
    }

    /// Voxels along each axis of the grid that the lvoxels of a volume stand on, if these can be
    /// told.
    fn lvoxel_dims(&self, _volume: usize) -> Option<[usize; 3]> {
        None
    }

    /// Gives the lvoxels of a volume to `take`.
    fn each_lvoxel(&self, _volume: usize, _take: &mut impl FnMut(LvoxelBlock)) {}

    /// Adds to `light` what media along a ray send, and takes what they stop. Returns how many
    /// lvoxels that took.
    fn pass(&self, ray: &Ray, light: &mut Composite<Self::Share>) -> u64;
}

impl<M: Medium> GatherInMedia for Gatherer<'_, M> {
    type Share = M::Share;

    fn settings(&self) -> &RaySettings<'_> {
        &self.settings
    }

    fn scattered(&self, point: Vec3, range: SampleRange, seen: Option<SeenPhase>) -> Gathered {
        match seen {
            None => self.mean_radiance(point, range),
            Some(seen) => self.scattered(point, range, seen),
        }
    }

    fn incident_from_surfaces(&self, ray: &Ray, scratch: &mut cone::Scratch) -> Incident {
        self.without_media().incident(ray, scratch)
    }

    fn unknown_along(&self, rays: &[Ray]) -> UnknownPatches {
        self.unknown_along(rays)
    }

    fn evaluate(&self, unknown: UnknownPatches) {
        self.evaluate(unknown);
    }

    fn has_unknown(&self) -> bool {
        self.has_unknown()
    }

    #[inline]
    fn walk(&self, ray: &Ray, add: &mut impl FnMut(Segment<Self::Share>) -> bool) -> bool {
        self.media.walk(ray, add)
    }

    #[inline]
    fn walk_with(&self, ray: &Ray, add: &mut impl FnMut(Segment<Self::Share>) -> bool) -> bool {
        self.media.walk_with(ray, add)
    }

    fn lvoxel_dims(&self, volume: usize) -> Option<[usize; 3]> {
        self.media.lvoxel_dims(volume)
    }

    fn each_lvoxel(&self, volume: usize, take: &mut impl FnMut(LvoxelBlock)) {
        self.media.each_lvoxel(volume, take);
    }

    fn pass(&self, ray: &Ray, light: &mut Composite<Self::Share>) -> u64 {
        let mut passed = 0;
        let width = self.settings.beam_width();
        self.media.walk_beam(ray, width, &mut |s| {
            passed += 1;
            light.medium(s.tau, s.source);
            light.transmittance.most() > Composite::<Self::Share>::NOTHING
        });
        passed
    }
}

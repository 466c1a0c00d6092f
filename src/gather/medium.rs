//! What is between surfaces, as a type: kernels are compiled for each, and a frame chooses one of
//! them once.

use super::Crossing;
use crate::math::segment::{Composite, Segment};
use crate::math::{Ray, Rgb, Spectrum};
use crate::tree::{IncidentGrid, LvoxelBlock, Media};

/// The share of a ray's light that media stopped, and where.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Attenuation {
    /// Share of the light, 0 to 1.
    pub share: f32,
    /// One over the mean distance at which it was stopped, per scene unit; 0 if nothing was.
    pub inverse_distance: f32,
}

/// The media between surfaces, as a type that gather kernels are compiled for.
pub trait Medium: Copy + Sync {
    /// Whether the type stands for no medium at all.
    const IS_NOTHING: bool = false;

    /// What tells depths and shares of light: one number, or one for each channel if media have
    /// colour.
    type Share: Spectrum;

    /// Gives every segment of a ray in a medium, front to back, to `add` until that says no;
    /// returns whether it never did.
    fn walk(&self, ray: &Ray, add: &mut impl FnMut(Segment<Self::Share>) -> bool) -> bool;

    /// The same for a beam that is so wide at a distance of 1: what is narrower may be one segment.
    #[inline]
    fn walk_beam(
        &self,
        ray: &Ray,
        _width: f32,
        add: &mut impl FnMut(Segment<Self::Share>) -> bool,
    ) -> bool {
        self.walk(ray, add)
    }

    /// [`Self::walk`] where light travels with the ray, not against it.
    fn walk_with(&self, ray: &Ray, add: &mut impl FnMut(Segment<Self::Share>) -> bool) -> bool {
        self.walk(ray, add)
    }

    /// Voxels along each axis of the grid that the lvoxels of a volume stand on; `None` if there
    /// are none.
    fn lvoxel_dims(&self, _volume: usize) -> Option<[usize; 3]> {
        None
    }

    /// Gives the lvoxels of a volume to `take`.
    fn each_lvoxel(&self, _volume: usize, _take: &mut impl FnMut(LvoxelBlock)) {}

    /// The light that the lvoxels of a volume send each other; `None` if they do not tell.
    fn incident(&self, _volume: usize) -> Option<IncidentGrid<'_>> {
        None
    }

    /// Media that send no light where they tell what arrives of it in them.
    #[must_use]
    fn without_incident(self) -> Self {
        self
    }

    /// Adds to `light` what media along a beam send that is so wide at a distance of 1, and the
    /// surfaces in `crossings`, which are sorted by distance. Returns what media stopped.
    #[inline]
    fn pass(
        &self,
        ray: &Ray,
        width: f32,
        crossings: &[Crossing],
        light: &mut Composite<Self::Share>,
    ) -> Attenuation {
        let (mut stopped, mut moment) = (0.0, 0.0);
        let mut crossings = crossings.iter().peekable();
        let mut add = |mut s: Segment<Self::Share>| {
            while let Some(c) = crossings.next_if(|c| c.t < s.far) {
                let share = ((c.t - s.near) / (s.far - s.near)).clamp(0.0, 1.0);
                light.medium(s.tau * share, s.source);
                light.surface(c.opacity, c.radiance);
                s.tau = s.tau * (1.0 - share);
                s.near = s.near.max(c.t);
            }
            let before = light.transmittance;
            light.medium(s.tau, s.source);
            let taken = (before - light.transmittance).mean();
            stopped += taken;
            moment += taken * (0.5 * (s.near + s.far));
            light.transmittance.most() > Composite::<Self::Share>::NOTHING
        };
        if self.walk_beam(ray, width, &mut add) {
            crossings.for_each(|c| light.surface(c.opacity, c.radiance));
        }
        Attenuation {
            share: stopped,
            inverse_distance: if moment > 0.0 { stopped / moment } else { 0.0 },
        }
    }
}

/// A scene without media: rays pass nothing between surfaces.
#[derive(Clone, Copy, Debug)]
pub struct NoMedia;

impl Medium for NoMedia {
    const IS_NOTHING: bool = true;
    type Share = f32;

    #[inline]
    fn walk(&self, _: &Ray, _: &mut impl FnMut(Segment) -> bool) -> bool {
        true
    }
}

impl Medium for &Media {
    type Share = f32;

    #[inline]
    fn walk(&self, ray: &Ray, add: &mut impl FnMut(Segment) -> bool) -> bool {
        Media::walk(self, ray, add)
    }

    #[inline]
    fn walk_beam(&self, ray: &Ray, width: f32, add: &mut impl FnMut(Segment) -> bool) -> bool {
        Media::walk_beam(self, ray, width, add)
    }

    fn walk_with(&self, ray: &Ray, add: &mut impl FnMut(Segment) -> bool) -> bool {
        Media::walk_with(self, ray, add)
    }

    fn lvoxel_dims(&self, volume: usize) -> Option<[usize; 3]> {
        self.dims(volume)
    }

    fn each_lvoxel(&self, volume: usize, take: &mut impl FnMut(LvoxelBlock)) {
        self.each_block(volume, take);
    }

    fn incident(&self, volume: usize) -> Option<IncidentGrid<'_>> {
        Media::incident(self, volume)
    }

    fn without_incident(self) -> Self {
        Media::without_incident(self)
    }
}

/// Media that stop one channel of light more than another.
#[derive(Clone, Copy, Debug)]
pub struct ColoredMedia<'a>(pub &'a Media);

impl Medium for ColoredMedia<'_> {
    type Share = Rgb;

    fn walk(&self, ray: &Ray, add: &mut impl FnMut(Segment<Rgb>) -> bool) -> bool {
        self.0.walk(ray, add)
    }

    fn walk_beam(&self, ray: &Ray, width: f32, add: &mut impl FnMut(Segment<Rgb>) -> bool) -> bool {
        self.0.walk_beam(ray, width, add)
    }

    fn walk_with(&self, ray: &Ray, add: &mut impl FnMut(Segment<Rgb>) -> bool) -> bool {
        self.0.walk_with(ray, add)
    }

    fn lvoxel_dims(&self, volume: usize) -> Option<[usize; 3]> {
        self.0.dims(volume)
    }

    fn each_lvoxel(&self, volume: usize, take: &mut impl FnMut(LvoxelBlock)) {
        self.0.each_block(volume, take);
    }

    fn incident(&self, volume: usize) -> Option<IncidentGrid<'_>> {
        self.0.incident(volume)
    }

    fn without_incident(self) -> Self {
        Self(self.0.without_incident())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;

    /// A thin mist, and a dense cloud behind it.
    #[derive(Clone, Copy)]
    struct TwoSlabs;

    impl Medium for TwoSlabs {
        type Share = f32;

        fn walk(&self, _: &Ray, add: &mut impl FnMut(Segment) -> bool) -> bool {
            let slab = |near, far, tau| Segment {
                near,
                far,
                tau,
                source: Rgb::BLACK,
            };
            add(slab(1.0, 3.0, 0.5)) && add(slab(5.0, 7.0, 40.0))
        }
    }

    #[test]
    fn media_count_by_what_they_stop_where_they_do() {
        let mut light = Composite::default();
        let stopped = TwoSlabs.pass(&Ray::endless(Vec3::ZERO, Vec3::X), 0.0, &[], &mut light);
        let mist = 1.0 - (-0.5_f64).exp();
        let distance = mist * 2.0 + (1.0 - mist) * 6.0;
        assert!((f64::from(stopped.share) - 1.0).abs() < 1e-6);
        assert!((1.0 / f64::from(stopped.inverse_distance) / distance - 1.0).abs() < 1e-6);
        // What is in no medium is stopped by none.
        let nothing = NoMedia.pass(&Ray::new(Vec3::ZERO, Vec3::X, 1.0), 0.0, &[], &mut light);
        assert_eq!((nothing.share, nothing.inverse_distance), (0.0, 0.0));
    }
}

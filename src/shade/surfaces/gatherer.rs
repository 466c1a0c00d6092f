//! Gathers of surfaces: over the hemisphere, and from bright patches where a frame has such.

use super::bright::BrightPatchLights;
use crate::Result;
use crate::gather::{
    DirectionOrder, Gathered, Gatherer, Medium, SampleRange, SurfacePoint, UnknownPatches,
};
use crate::math::SphereMap;
use crate::trace::Surface;
use crate::view::View;

/// Gathers of surfaces, whatever media they are compiled for: a call is for many rays.
pub trait GatherAtSurfaces: Sync {
    /// Camera and scene.
    fn view(&self) -> &View<'_>;

    /// Irradiance of surfaces from which nothing hides the environment, by their normals, if it
    /// differs by direction.
    fn unhidden(&self) -> Option<&SphereMap>;

    /// Irradiance of a surface, by a range of the directions that belong to a seed.
    fn gather(&self, surface: &Surface, range: SampleRange) -> Gathered;

    /// Irradiance of surfaces near each other, each by a range of the directions that belong to
    /// one seed.
    fn gather_neighbours(
        &self,
        surfaces: &[(Surface, u32)],
        seed: u64,
        order: &DirectionOrder,
    ) -> Vec<Gathered>;

    /// The patches that [`Self::gather_neighbours`] would evaluate from pages that may be decoded
    /// again and again.
    fn unknown_to_neighbours(
        &self,
        surfaces: &[(Surface, u32)],
        seed: u64,
        order: &DirectionOrder,
    ) -> UnknownPatches;

    /// Evaluates patches in the order of their places.
    fn evaluate(&self, unknown: UnknownPatches);

    /// Whether [`Self::unknown_to_neighbours`] may find any.
    fn has_unknown(&self) -> bool;

    /// The order in which the directions of so many ranges of one seed are taken.
    fn order(&self, ranges: u32) -> DirectionOrder;

    /// An error if a page of the tree could not be read so far.
    ///
    /// # Errors
    /// That of the first such page.
    fn check(&self) -> Result<()>;
}

/// A gatherer and what its rays leave out.
#[derive(Debug)]
pub struct SurfaceGatherer<'a, M> {
    /// Camera and scene.
    pub view: &'a View<'a>,
    /// Over the hemisphere.
    pub gatherer: Gatherer<'a, M>,
    /// Patches that the gatherer's rays leave out.
    pub bright_patches: Option<&'a BrightPatchLights<'a>>,
}

impl<M: Medium> GatherAtSurfaces for SurfaceGatherer<'_, M> {
    fn view(&self) -> &View<'_> {
        self.view
    }

    fn unhidden(&self) -> Option<&SphereMap> {
        let map = self.gatherer.settings.environment.map();
        map.map(|map| &map.irradiance)
    }

    fn gather(&self, surface: &Surface, range: SampleRange) -> Gathered {
        let SurfacePoint {
            position,
            normal,
            face_normal,
            ..
        } = self.point(surface, range.index);
        let mut gathered = (self.gatherer).irradiance(position, normal, face_normal, range);
        self.add_bright_patches(&mut gathered, surface, range);
        gathered
    }

    fn gather_neighbours(
        &self,
        surfaces: &[(Surface, u32)],
        seed: u64,
        order: &DirectionOrder,
    ) -> Vec<Gathered> {
        let point = |(surface, range): &(Surface, u32)| self.point(surface, *range);
        let points: Vec<_> = surfaces.iter().map(point).collect();
        let mut gathered = (self.gatherer).irradiance_at_neighbours(&points, seed, order);
        for (gathered, (surface, index)) in gathered.iter_mut().zip(surfaces) {
            let index = *index;
            self.add_bright_patches(gathered, surface, SampleRange { index, seed });
        }
        gathered
    }

    fn unknown_to_neighbours(
        &self,
        surfaces: &[(Surface, u32)],
        seed: u64,
        order: &DirectionOrder,
    ) -> UnknownPatches {
        let point = |(surface, range): &(Surface, u32)| self.point(surface, *range);
        let points: Vec<_> = surfaces.iter().map(point).collect();
        (self.gatherer).unknown_to_neighbours(&points, seed, order)
    }

    fn evaluate(&self, unknown: UnknownPatches) {
        self.gatherer.evaluate(unknown);
    }

    fn has_unknown(&self) -> bool {
        self.gatherer.has_unknown()
    }

    fn order(&self, ranges: u32) -> DirectionOrder {
        self.gatherer.order(ranges)
    }

    fn check(&self) -> Result<()> {
        self.gatherer.pages.check()
    }
}

impl<M> SurfaceGatherer<'_, M> {
    fn point(&self, surface: &Surface, range: u32) -> SurfacePoint {
        SurfacePoint {
            position: self.view.off_surface(surface),
            normal: surface.normal,
            face_normal: surface.face_normal,
            range,
        }
    }

    fn add_bright_patches(&self, gathered: &mut Gathered, surface: &Surface, range: SampleRange) {
        if let Some(lights) = self.bright_patches {
            gathered.light += lights.irradiance(surface, range);
        }
    }
}

//! Gathers of surfaces: over the hemisphere, and from bright patches where a frame has such.

use super::bright::BrightPatchLights;
use crate::Result;
use crate::gather::{DirectionOrder, Gathered, Gatherer, Medium, SampleRange, SurfacePoint};
use crate::trace::Surface;
use crate::tree::Pages;
use crate::view::View;

/// Gathers of surfaces, whatever pages and media they are compiled for: a call is for many rays.
pub trait GatherAtSurfaces: Sync {
    /// Camera and scene.
    fn view(&self) -> &View<'_>;

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
pub struct SurfaceGatherer<'a, P, M> {
    /// Camera and scene.
    pub view: &'a View<'a>,
    /// Over the hemisphere.
    pub gatherer: Gatherer<'a, P, M>,
    /// Patches that the gatherer's rays leave out.
    pub bright_patches: Option<&'a BrightPatchLights<'a>>,
}

impl<P: Pages, M: Medium> GatherAtSurfaces for SurfaceGatherer<'_, P, M> {
    fn view(&self) -> &View<'_> {
        self.view
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

    fn order(&self, ranges: u32) -> DirectionOrder {
        self.gatherer.order(ranges)
    }

    fn check(&self) -> Result<()> {
        self.gatherer.pages.check()
    }
}

impl<P, M> SurfaceGatherer<'_, P, M> {
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

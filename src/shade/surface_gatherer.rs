//! Gathers of surfaces: over the hemisphere, and from bright patches where a frame has such.

use super::bright::BrightLamps;
use super::view::View;
use crate::gather::{DirectionOrder, Gathered, Gatherer, Medium, SampleRange, SurfacePoint};
use crate::trace::Surface;
use crate::tree::Pages;

/// Gathers indirect light of surfaces.
#[derive(Debug)]
pub struct SurfaceGatherer<'a, P, M> {
    /// Camera and scene.
    pub view: &'a View<'a>,
    /// Over the hemisphere.
    pub gatherer: Gatherer<'a, P, M>,
    /// What that leaves out.
    pub lamps: Option<&'a BrightLamps<'a>>,
}

impl<P: Pages, M: Medium> SurfaceGatherer<'_, P, M> {
    /// Irradiance of a surface.
    #[must_use]
    pub fn gather(&self, surface: &Surface, stretch: SampleRange) -> Gathered {
        let SurfacePoint {
            position,
            normal,
            face_normal,
            ..
        } = self.point(surface, stretch.index);
        let mut gathered = (self.gatherer).irradiance(position, normal, face_normal, stretch);
        self.add_lamps(&mut gathered, surface, stretch);
        gathered
    }

    /// The same of surfaces near each other, each with its stretch of the directions that belong to
    /// a seed.
    #[must_use]
    pub fn gather_neighbours(
        &self,
        surfaces: &[(Surface, u32)],
        seed: u64,
        order: &DirectionOrder,
    ) -> Vec<Gathered> {
        let point = |(surface, stretch): &(Surface, u32)| self.point(surface, *stretch);
        let points: Vec<_> = surfaces.iter().map(point).collect();
        let mut gathered = (self.gatherer).irradiance_at_neighbours(&points, seed, order);
        for (gathered, (surface, index)) in gathered.iter_mut().zip(surfaces) {
            let index = *index;
            self.add_lamps(gathered, surface, SampleRange { index, seed });
        }
        gathered
    }

    fn point(&self, surface: &Surface, stretch: u32) -> SurfacePoint {
        SurfacePoint {
            position: self.view.off_surface(surface),
            normal: surface.normal,
            face_normal: surface.face_normal,
            range: stretch,
        }
    }

    fn add_lamps(&self, gathered: &mut Gathered, surface: &Surface, stretch: SampleRange) {
        if let Some(lamps) = self.lamps {
            gathered.light += lamps.irradiance(surface, stretch);
        }
    }
}

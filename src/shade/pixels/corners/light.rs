//! Lights with an extent, as the shadow rays of corners near each other tell them.

use super::around::{Around, Lit};
use super::{Corner, Corners};
use crate::gather::Medium;
use crate::light::{Arrival, Direct, Prospect, Sight, is_alike};
use crate::shade::air::{Air, Passed};
use crate::shade::pixels::sample::Sample;
use crate::tree::Pages;

/// What rays of a corner, or of several, tell of lights.
type SightOf<T> = Sight<<T as Passed>::Dimming>;

/// Corners near one, along both axes, whose rays tell whether it may be in a penumbra.
const REACH: usize = 2;

impl<'a, P: Pages, M: Medium, A: Air> Corners<'a, P, M, A> {
    /// Shadow rays of a corner in a penumbra.
    const PENUMBRA: u8 = 4;
    /// The first row and column of corners that may be in a penumbra: those of the first ring.
    const FIRST_IN_PENUMBRA: usize = Self::RINGS as usize - 1;

    /// More shadow rays at the corners from which, or from near which, some ray reached a light and
    /// some did not.
    pub(super) fn look_into_penumbrae(&mut self) {
        let rim = Self::FIRST_IN_PENUMBRA;
        let sights = self.sights_in_rows();
        // Of the even corner of each four, once it is asked for.
        let mut prospects = Vec::new();
        for row in rim..self.height - rim {
            if row % 2 == 0 || prospects.is_empty() {
                prospects.clear();
                prospects.resize_with(self.width.div_ceil(2), || None);
            }
            for column in rim..self.width - rim {
                let mut sight = Sight::default();
                for near in row - REACH..=row + REACH {
                    sight += sights[self.index(near, column)];
                }
                if !sight.has_penumbra() {
                    continue;
                }
                if let Some(direct) = self.more_rays(row, column, &mut prospects) {
                    let i = self.index(row, column);
                    let known = &mut self.corners[i].sample.direct;
                    known.rays += direct.rays;
                    known.sight += direct.sight;
                }
            }
        }
        let is_full = |c: &Corner<A::Passed>| {
            let rays = &c.sample.direct.rays;
            rays.arriving == rays.all
        };
        self.is_full_light = self.corners.iter().map(is_full).collect();
    }

    /// What the rays so far of each corner and of those near it in its row tell.
    fn sights_in_rows(&self) -> Vec<SightOf<A::Passed>> {
        let rows = self.corners.chunks_exact(self.width);
        rows.flat_map(|row| {
            (0..row.len()).map(|column| {
                let mut sight = Sight::default();
                for c in &row[column.saturating_sub(REACH)..(column + REACH + 1).min(row.len())] {
                    sight += c.sample.direct.sight;
                }
                sight
            })
        })
        .collect()
    }

    /// What more shadow rays bring of a corner in a penumbra, if light is seen there.
    fn more_rays(
        &self,
        row: usize,
        column: usize,
        prospects: &mut [Option<Prospect<'a>>],
    ) -> Option<Direct<<A::Passed as Passed>::Dimming>> {
        let lights = self.shader.lights;
        let at = |row: usize, column: usize| &self.corners[self.index(row, column)].sample;
        let sample = at(row, column);
        let surface = sample.lit_surface()?;
        let place = Self::place(self.region, column, row);
        let rays = place.rays(self.shader, 1, Self::PENUMBRA - 1);
        let even = at(row - row % 2, column - column % 2);
        let is_alike = is_alike(sample.direct.open.mean(), even.direct.open.mean());
        let own;
        let prospect = match even.lit_surface() {
            Some(even) if is_alike && self.shader.is_lit_alike(surface, even, sample.t) => {
                prospects[column / 2].get_or_insert_with(|| lights.prospect(even))
            }
            _ => {
                own = lights.prospect(surface);
                &own
            }
        };
        Some(lights.irradiance_by(surface, prospect, prospect.open, rays))
    }

    /// The lights with an extent, by the shadow rays of the corners around a pixel that lie on its
    /// piece of surface. `first` is the first of them.
    pub(super) fn lit<'c>(
        &self,
        first: usize,
        like: &Sample<A::Passed>,
        at: impl Fn(usize, usize) -> &'c Corner<A::Passed>,
    ) -> Lit {
        let is_full_row = |row: usize| {
            let first = first + row * self.width;
            let row = self.is_full_light.get(first..first + 4);
            row.is_none_or(|row| row == [true; 4])
        };
        if (0..4).all(is_full_row) {
            return Lit::Arrived(Arrival::default());
        }
        let mut around = Around::default();
        for row in 0..4 {
            for column in 0..4 {
                let sample = &at(column, row).sample;
                if self.shader.same_end(like, sample) {
                    around.add(row, column, &sample.direct);
                }
            }
        }
        around.lit()
    }
}

//! Lights with an extent, as the shadow rays of corners near each other tell them.

use super::around::{Around, Lit};
use super::{Corner, Corners};
use crate::gather::Medium;
use crate::light::{Arrival, Direct, Prospect, Sight, is_alike};
use crate::shade::air::{Air, Passed};
use crate::shade::pixels::sample::Sample;
use crate::tree::Pages;

/// What tells where penumbrae are, on the way down the rows of a region.
#[derive(Debug)]
pub(super) struct Penumbrae<'a, D> {
    /// The next row that is asked for more rays.
    row: Option<usize>,
    /// Of rows around that, one after the other in turn: what the first rays of the five corners
    /// around each in its row tell.
    sights: [Vec<Sight<D>>; 5],
    /// Of the even corner of each four, once it is asked for.
    prospects: Vec<Option<Prospect<'a>>>,
}

impl<D> Default for Penumbrae<'_, D> {
    fn default() -> Self {
        Self {
            row: None,
            sights: Default::default(),
            prospects: Vec::new(),
        }
    }
}

impl<'a, P: Pages, M: Medium, A: Air> Corners<'a, P, M, A> {
    /// Shadow rays of a corner in a penumbra.
    const PENUMBRA: u8 = 4;
    /// The first row and column of corners that may be in a penumbra: those of the first ring.
    const FIRST_IN_PENUMBRA: usize = Self::RINGS as usize - 1;

    /// Whether any corner may be in a penumbra: none is of lights without an extent.
    pub(super) fn has_penumbrae(&self) -> bool {
        !self.shader.lights.rest_is_exact()
    }

    /// The first row that penumbrae are not yet looked for in, or the even one before it, which
    /// tells what it sees.
    pub(super) fn first_for_penumbrae(&self) -> usize {
        let row = self.penumbrae.row.unwrap_or_default();
        row - row % 2
    }

    /// More shadow rays at the corners from which, or from near which, some ray reached a light and
    /// some did not, in all rows that are not yet looked at but have two rows behind them. Returns
    /// the first that is left.
    pub(super) fn look_into_penumbrae(&mut self) -> usize {
        let rim = Self::FIRST_IN_PENUMBRA;
        let first = match self.penumbrae.row {
            Some(row) => row,
            None => {
                (rim - 2..rim + 2).for_each(|row| self.note_sights(row));
                rim
            }
        };
        let end = (self.sampled() - 2).min(self.height - rim);
        for row in first..end {
            self.note_sights(row + 2);
            if row % 2 == 0 || self.penumbrae.prospects.is_empty() {
                let prospects = &mut self.penumbrae.prospects;
                prospects.clear();
                prospects.resize_with(self.width.div_ceil(2), || None);
            }
            for column in rim..self.width - rim {
                if let Some(direct) = self.more_rays(row, column) {
                    let i = self.index(row, column);
                    let known = &mut self.corners[i].sample.direct;
                    known.rays += direct.rays;
                    known.sight += direct.sight;
                }
            }
        }
        self.penumbrae.row = Some(end);
        self.note_full_light(end);
        end
    }

    /// Notes what the first rays of a row tell.
    fn note_sights(&mut self, row: usize) {
        let ends = self.index(row, 0)..self.index(row + 1, 0);
        let sights = &mut self.penumbrae.sights[row % 5];
        sights.clear();
        let row = &self.corners[ends];
        sights.extend((0..self.width).map(|column| {
            let mut sight = Sight::default();
            for c in &row[column.saturating_sub(2)..(column + 3).min(row.len())] {
                sight += c.sample.direct.sight;
            }
            sight
        }));
    }

    /// What more shadow rays of a corner bring, if it may be in a penumbra.
    fn more_rays(
        &mut self,
        row: usize,
        column: usize,
    ) -> Option<Direct<<A::Passed as Passed>::Dimming>> {
        let lights = self.shader.lights;
        let at = |row: usize, column: usize| {
            let i = (row - self.first_row) * self.width + column;
            &self.corners[i].sample
        };
        let sample = at(row, column);
        let surface = sample.lit_surface()?;
        let Penumbrae {
            sights, prospects, ..
        } = &mut self.penumbrae;
        let mut sight = Sight::default();
        sights.iter().for_each(|row| sight += row[column]);
        if !sight.has_penumbra() {
            return None;
        }
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

    /// Notes at which corners before a row nothing took anything of any ray to a light with an
    /// extent.
    fn note_full_light(&mut self, end: usize) {
        let is_full = |c: &Corner<A::Passed>| {
            let rays = &c.sample.direct.rays;
            rays.arriving == rays.all
        };
        let known = self.is_full_light.len();
        let noted = self.corners[known..self.index(end, 0)].iter().map(is_full);
        self.is_full_light.extend(noted);
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

//! Lights with an extent, as the shadow rays of corners near each other tell them.

use super::around::{Around, Lit};
use super::{Corner, Corners};
use crate::gather::{Medium, Pages};
use crate::light::{Arrival, Prospect, Sight, is_alike};
use crate::shade::air::Air;
use crate::shade::pixels::sample::Sample;

impl<P: Pages, M: Medium, A: Air> Corners<'_, P, M, A> {
    /// Shadow rays of a corner in a penumbra.
    const PENUMBRA: u8 = 4;

    /// More shadow rays at the corners from which, or from near which, some ray reached a light and some did not.
    pub(super) fn look_into_penumbrae(&mut self, height: usize) {
        // What the five corners around each in its row tell.
        let in_row = |row: usize| {
            (row * self.width..(row + 1) * self.width).map(|i| {
                let mut sight = Sight::default();
                let around = i.saturating_sub(2)..(i + 3).min(self.corners.len());
                for c in &self.corners[around] {
                    sight += c.sample.direct.sight;
                }
                sight
            })
        };
        let rim = Self::RINGS as usize - 1;
        let lights = self.shader.lights;
        let mut more = Vec::new();
        // Of the even corner of each four, once it is asked for.
        let mut prospects: Vec<Option<Prospect>> = Vec::new();
        // By row, of the five around one.
        let mut rows: [Vec<_>; 5] = Default::default();
        (rim - 2..rim + 2).for_each(|row| rows[row % 5].extend(in_row(row)));
        for row in rim..height - rim {
            let last = &mut rows[(row + 2) % 5];
            last.clear();
            last.extend(in_row(row + 2));
            if row % 2 == 0 || prospects.is_empty() {
                prospects.clear();
                prospects.resize_with(self.width.div_ceil(2), || None);
            }
            for column in rim..self.width - rim {
                let i = row * self.width + column;
                let sample = &self.corners[i].sample;
                let Some(surface) = sample.lit_surface() else {
                    continue;
                };
                let mut sight = Sight::default();
                rows.iter().for_each(|row| sight += row[column]);
                if !sight.has_penumbra() {
                    continue;
                }
                let place = Self::place(self.region, column, row);
                let rays = place.rays(self.shader, 1, Self::PENUMBRA - 1);
                let even = &self.corners[(row - row % 2) * self.width + column - column % 2];
                let [open, of_even] = [sample, &even.sample].map(|s| s.direct.open.mean());
                let is_alike = is_alike(open, of_even);
                let own;
                let prospect = match even.sample.lit_surface() {
                    Some(even) if is_alike && self.shader.is_lit_alike(surface, even, sample.t) => {
                        prospects[column / 2].get_or_insert_with(|| lights.prospect(even))
                    }
                    _ => {
                        own = lights.prospect(surface);
                        &own
                    }
                };
                more.push((
                    i,
                    lights.irradiance_by(surface, prospect, prospect.open, rays),
                ));
            }
        }
        for (i, direct) in more {
            let known = &mut self.corners[i].sample.direct;
            known.rays += direct.rays;
            known.sight += direct.sight;
        }
    }

    /// Notes at which corners nothing took anything of any ray to a light with an extent.
    pub(super) fn note_full_light(&mut self) {
        let is_full = |c: &Corner<A::Passed>| {
            let rays = &c.sample.direct.rays;
            rays.arriving == rays.all
        };
        self.is_full_light = self.corners.iter().map(is_full).collect();
    }

    /// The lights with an extent, by the shadow rays of the corners around a pixel that lie on its piece of surface. `first` is
    /// the first of them.
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

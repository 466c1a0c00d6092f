//! Lights with an extent, as the shadow rays of corners near each other tell them.

use super::penumbra::{LightAtPixel, NearbyRays};
use super::{Corner, Corners};
use crate::light::{DirectLight, ShadowRatio, Unshadowed, Visibility, is_similar};
use crate::shade::pixels::camera_media::CameraMedia;

/// Corners near one, along both axes, whose rays tell whether it may be in a penumbra.
pub(super) const PENUMBRA_REACH: usize = 2;

impl<'a, A: CameraMedia> Corners<'a, A> {
    /// Shadow rays of a corner in a penumbra.
    const PENUMBRA_RAYS: u8 = 4;

    /// More shadow rays at the corners from which, or from near which, some ray reached a light and
    /// some did not.
    pub(super) fn look_into_penumbrae(&mut self) {
        let rim = (self.rings - Self::RINGS_OF_PENUMBRAE) as usize;
        let mut has_penumbra = false;
        let visibilities = self.visibility_in_rows();
        // Of the even corner of each four, once it is asked for.
        let mut unshadowed = Vec::new();
        for row in rim..self.height - rim {
            if row % 2 == 0 || unshadowed.is_empty() {
                unshadowed.clear();
                unshadowed.resize_with(self.width.div_ceil(2), || None);
            }
            for column in rim..self.width - rim {
                let mut visibility = Visibility::default();
                for near in row - PENUMBRA_REACH..=row + PENUMBRA_REACH {
                    visibility += visibilities[self.index(near, column)];
                }
                if !visibility.has_penumbra() {
                    continue;
                }
                has_penumbra = true;
                if let Some(direct) = self.more_rays(row, column, &mut unshadowed) {
                    let i = self.index(row, column);
                    let known = &mut self.corners[i].sample.direct;
                    known.ratio += direct.ratio;
                    known.sky.ratio += direct.sky.ratio;
                    known.visibility += direct.visibility;
                }
            }
        }
        let is_full = |c: &Corner<A::Passed>| {
            let direct = &c.sample.direct;
            let ratios = [&direct.ratio, &direct.sky.ratio];
            ratios
                .iter()
                .all(|ratio| ratio.shadowed == ratio.unshadowed)
        };
        self.is_full_light = self.corners.iter().map(is_full).collect();
        if has_penumbra {
            self.squares = self.sum_squares();
        }
    }

    /// What the rays so far of each corner and of those near it in its row tell.
    fn visibility_in_rows(&self) -> Vec<Visibility> {
        let rows = self.corners.chunks_exact(self.width);
        rows.flat_map(|row| {
            (0..row.len()).map(|column| {
                let mut visibility = Visibility::default();
                for c in &row[column.saturating_sub(PENUMBRA_REACH)
                    ..(column + PENUMBRA_REACH + 1).min(row.len())]
                {
                    visibility += c.sample.direct.visibility;
                }
                visibility
            })
        })
        .collect()
    }

    /// What more shadow rays bring of a corner in a penumbra, if light is seen there.
    fn more_rays(
        &self,
        row: usize,
        column: usize,
        unshadowed: &mut [Option<Unshadowed<'a>>],
    ) -> Option<DirectLight> {
        let lights = self.shader.lights;
        let at = |row: usize, column: usize| &self.corners[self.index(row, column)].sample;
        let sample = at(row, column);
        let surface = sample.lit_surface()?;
        let place = Self::place(self.region, self.rings, column, row);
        let rays = place.rays(self.shader, 1, Self::PENUMBRA_RAYS - 1);
        let even = at(row - row % 2, column - column % 2);
        let is_alike = is_similar(
            sample.direct.unshadowed.mean(),
            even.direct.unshadowed.mean(),
        );
        let own;
        let of = match even.lit_surface() {
            Some(even) if is_alike && self.shader.is_lit_alike(surface, even, sample.t) => {
                unshadowed[column / 2].get_or_insert_with(|| lights.unshadowed(even))
            }
            _ => {
                own = lights.unshadowed(surface);
                &own
            }
        };
        Some(lights.irradiance_by(surface, of, of.light, rays))
    }

    /// The lights with an extent, by the shadow rays of the corners around a pixel that lie on its
    /// piece of surface. `first` is the first of them.
    pub(super) fn lit<'c>(
        &self,
        first: usize,
        like: &Corner<A::Passed>,
        at: impl Fn(usize, usize) -> &'c Corner<A::Passed>,
    ) -> LightAtPixel {
        let is_full_row = |row: usize| {
            let first = first + row * self.width;
            let row = self.is_full_light.get(first..first + 4);
            row.is_none_or(|row| row == [true; 4])
        };
        if (0..4).all(is_full_row) {
            return LightAtPixel::Arrived {
                lamps: ShadowRatio::default(),
                sky: ShadowRatio::default(),
            };
        }
        let mut around = NearbyRays::default();
        for row in 0..4 {
            for column in 0..4 {
                let sample = &at(column, row).sample;
                if self.shader.same_end(&like.sample, sample) {
                    around.add(row, column, &sample.direct);
                }
            }
        }
        around.lit(|| {
            let squares = self.squares_around(first);
            self.is_like_squares(like, squares)
                .then(|| [self.squares.of_lamps(squares), self.squares.of_sky(squares)])
        })
    }
}

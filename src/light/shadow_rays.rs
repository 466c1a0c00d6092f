//! The points of lights that the shadow rays of one point go to.

use crate::math::sampling::{hash, mix, sobol2, unit2};

/// How many shadow rays go from a point to each light with an extent, and to which points of it.
#[derive(Clone, Copy, Debug)]
pub enum ShadowRays {
    /// A range of a Sobol sequence.
    Sequence {
        /// Rays to all emitters together, and to each sun.
        per_light: u32,
        /// First ray; more rays are those of the range that follows.
        first: u32,
        /// Key of the point.
        seed: u64,
    },
    /// Rays in one or more of the 16 equal cells of the lights: neighbours that take the 16 cells
    /// in turn have, together, a well-spread set (Keller & Heidrich 2001), and with four rays each
    /// one in each of 64 cells; so have four such squares, one in each of 256.
    Cells {
        /// Cell of the first ray, 0 to 15; others are in the quarters after it.
        cell: u8,
        /// Which of four squares the point is in, 0 to 3.
        square: u8,
        /// Rays to skip.
        first: u8,
        /// Rays to take.
        count: u8,
        /// Key of the point.
        seed: u64,
        /// Key that the points of all squares share.
        shared_seed: u64,
    },
}

impl ShadowRays {
    /// Rays to all emitters together, and to each sun.
    pub(super) fn count(&self) -> u32 {
        match *self {
            Self::Sequence { per_light, .. } => per_light.max(1),
            Self::Cells { count, .. } => u32::from(count),
        }
    }

    /// Area of an emitter over its squared distance from which its rays have to be uniform over its
    /// solid angle, which takes longer to find. What the shadows of a few rays say is biased if
    /// those stand for parts of different size, by a hundredth beside the emitters of a scene
    /// with media; rays of many points that are added up may differ more.
    pub(super) fn near(&self) -> f32 {
        match self {
            Self::Sequence { .. } => 0.02,
            Self::Cells { .. } => 0.1,
        }
    }

    /// Two numbers in [0,1) for ray `i` to the light, or to the emitters, that `set` tells.
    pub(super) fn point(&self, i: u32, set: u32) -> [f32; 2] {
        match *self {
            Self::Sequence { first, seed, .. } => sobol2(first + i, set, mix(seed) as u32),
            Self::Cells {
                cell,
                square,
                first,
                seed,
                shared_seed,
                ..
            } => {
                let ray = u32::from(first) + i;
                let first = u32::from(cell);
                let cell = (first + 4 * ray) % 16;
                let [x, y] = [cell >> 2 & 2 | cell >> 1 & 1, cell >> 1 & 2 | cell & 1];
                // The four points that a cell gets of the first four rays of all lie in its
                // quarters.
                let quarter = ray + 2 * (first >> 2) + first;
                let [x, y] = [2 * x + (quarter & 1), 2 * y + (quarter >> 1 & 1)];
                // So do those that each of the 64 cells gets of four squares, and those of one
                // point lie in different quarters, so that no few points have them all off one way.
                let turn = hash(&[shared_seed, u64::from(set), u64::from(first)]) as u32;
                let part = u32::from(square) ^ ray ^ turn;
                let [x, y] = [2 * x + (part & 1), 2 * y + (part >> 1 & 1)];
                let [u, v] = unit2(hash(&[seed, u64::from(set), u64::from(ray)]));
                [(x as f32 + u) / 16.0, (y as f32 + v) / 16.0]
            }
        }
    }

    /// Two numbers in [0,1) for ray `i` to one of many emitters, where `per_ray` such rays count as
    /// one. The first number, which chooses the emitter, takes all cells in turn, so that emitters
    /// have as many strata as there are rays.
    pub(super) fn point_of_many(&self, i: u32, per_ray: u32) -> [f32; 2] {
        match *self {
            Self::Sequence { first, seed, .. } => sobol2(first * per_ray + i, 63, mix(seed) as u32),
            Self::Cells {
                cell, first, seed, ..
            } => {
                let ray = u32::from(first) + i / per_ray;
                let cell = (u32::from(cell) + 4 * ray) % 16;
                let part = cell * per_ray + i % per_ray;
                let [u, v] = unit2(hash(&[seed, 63, u64::from(first), u64::from(i)]));
                // The second number by a Hammersley set over the cells. The rays that share a cell,
                // and so an emitter, lie in its four quarters.
                let across = (cell.reverse_bits() >> 28) as f32 * (1.0 / 16.0);
                let v = across + 0.25 * (ray as f32 + v);
                [(part as f32 + u) / (16 * per_ray) as f32, v.fract()]
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    fn in_square(square: u8, cell: u8, first: u8, count: u8) -> ShadowRays {
        ShadowRays::Cells {
            cell,
            square,
            first,
            count,
            seed: u64::from(16 * square + cell) + 7,
            shared_seed: 3,
        }
    }

    #[test]
    fn four_rays_in_each_of_16_cells_lie_in_64_cells() {
        let rays = |cell, first, count| in_square(0, cell, first, count);
        let cells_of = |rays: ShadowRays| {
            (0..rays.count()).map(move |i| rays.point(i, 0).map(|u| (8.0 * u) as u32))
        };
        let all: BTreeSet<_> = (0..16)
            .flat_map(|cell| cells_of(rays(cell, 0, 1)).chain(cells_of(rays(cell, 1, 3))))
            .collect();
        assert_eq!(all.len(), 64);
        let first: BTreeSet<_> = (0..16)
            .flat_map(|cell| cells_of(rays(cell, 0, 1)))
            .map(|[x, y]| [x / 2, y / 2])
            .collect();
        assert_eq!(first.len(), 16);
    }
    #[test]
    fn those_of_four_squares_lie_in_256_cells() {
        let all: BTreeSet<_> = (0..4)
            .flat_map(|square| (0..16).map(move |cell| in_square(square, cell, 0, 4)))
            .flat_map(|rays| (0..4).map(move |i| rays.point(i, 0).map(|u| (16.0 * u) as u32)))
            .collect();
        assert_eq!(all.len(), 256);
    }

    #[test]
    fn those_of_one_point_lie_in_different_quarters_of_their_cells() {
        for cell in 0..16 {
            let rays = in_square(2, cell, 0, 4);
            let quarters = (0..4).map(|i| rays.point(i, 0).map(|u| (16.0 * u) as u32 % 2));
            assert_eq!(quarters.collect::<BTreeSet<_>>().len(), 4);
        }
    }
}

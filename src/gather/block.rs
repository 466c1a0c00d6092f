//! An lvoxel as it is held in memory: in eight bytes, since rays through media wait for memory more than for anything else.

use crate::math::Rgb;

/// The kinds of source function that lvoxels may have: [`Rgb`], or `f32` where all three channels are equal.
pub trait Source: std::fmt::Debug {
    /// How an lvoxel of this kind is held.
    type Block: Block;
}

impl Source for Rgb {
    type Block = ColouredBlock;
}

impl Source for f32 {
    type Block = GreyBlock;
}

/// The largest extinction per scene unit and the largest source function, of any channel, in a volume.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Most {
    /// Extinction.
    pub sigma_t: f32,
    /// Source function.
    pub source: f32,
}

/// Extinction per scene unit and source function of a block of medium, in a volume where they are no larger than a [`Most`].
pub trait Block: Copy + std::fmt::Debug + Default + Send + Sync {
    /// From both.
    fn new(sigma_t: f32, source: Rgb, most: &Most) -> Self;

    /// Both.
    fn read(self, most: &Most) -> (f32, Rgb);

    /// Whether it has no extinction.
    fn is_empty(self) -> bool;
}

/// A block whose source function is the same in all channels.
#[derive(Clone, Copy, Debug, Default)]
pub struct GreyBlock {
    sigma_t: f32,
    source: f32,
}

impl Block for GreyBlock {
    #[inline]
    fn new(sigma_t: f32, source: Rgb, _: &Most) -> Self {
        Self {
            sigma_t,
            source: source.0[0],
        }
    }

    #[inline]
    fn read(self, _: &Most) -> (f32, Rgb) {
        (self.sigma_t, Rgb::splat(self.source))
    }

    #[inline]
    fn is_empty(self) -> bool {
        self.sigma_t == 0.0
    }
}

/// A block of any colour: extinction and channels as shares of the most, each a float of five bits of exponent and eleven of
/// mantissa, within 2.5e-4 of its value down to 1e-9 of the most, and 0 below that.
#[derive(Clone, Copy, Debug, Default)]
#[repr(align(8))]
pub struct ColouredBlock([u16; 4]);

impl ColouredBlock {
    /// 2^96 moves the exponents of numbers up to 1 to where five bits hold them.
    const SHIFT: f32 = 7.922_816_3e28;
    /// Bits of the mantissa of an f32 that are not held.
    const CUT: u32 = 12;

    fn pack(value: f32, most: f32) -> u16 {
        let share = value / most;
        // Not NaN, which 0 of 0 is, nor what would be denormal.
        if share > 1e-9 {
            let bits = (share.min(1.0) / Self::SHIFT).to_bits();
            ((bits + (1 << (Self::CUT - 1))) >> Self::CUT) as u16
        } else {
            0
        }
    }
}

impl Block for ColouredBlock {
    fn new(sigma_t: f32, Rgb([r, g, b]): Rgb, most: &Most) -> Self {
        Self([
            Self::pack(sigma_t, most.sigma_t),
            Self::pack(r, most.source),
            Self::pack(g, most.source),
            Self::pack(b, most.source),
        ])
    }

    #[inline]
    fn read(self, most: &Most) -> (f32, Rgb) {
        let [sigma_t, r, g, b] = self
            .0
            .map(|code| f32::from_bits(u32::from(code) << Self::CUT) * Self::SHIFT);
        (sigma_t * most.sigma_t, Rgb([r, g, b]) * most.source)
    }

    #[inline]
    fn is_empty(self) -> bool {
        self.0[0] == 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_coloured_block_holds_what_it_is_given() {
        assert_eq!(size_of::<ColouredBlock>(), 8);
        for most in [1e-30, 0.7, 1e30] {
            let most = Most {
                sigma_t: most,
                source: most,
            };
            let mut share = 1.0_f32;
            while share > 2e-9 {
                let v = share * most.source;
                let block = ColouredBlock::new(v, Rgb([v, 0.5 * v, 0.0]), &most);
                let (sigma_t, Rgb(got)) = block.read(&most);
                for (got, v) in [(sigma_t, v), (got[0], v), (got[1], 0.5 * v)] {
                    assert!((got - v).abs() <= 2.5e-4 * v, "{got} {v}");
                }
                assert_eq!(got[2], 0.0);
                share *= 0.83;
            }
            let white = Rgb::splat(most.source);
            assert!(ColouredBlock::new(0.0, white, &most).is_empty());
        }
    }

    #[test]
    fn the_most_is_held_exactly_and_black_media_are_black() {
        let most = Most {
            sigma_t: 3.7,
            source: 0.0,
        };
        let (sigma_t, source) = ColouredBlock::new(3.7, Rgb::BLACK, &most).read(&most);
        assert_eq!((sigma_t, source), (3.7, Rgb::BLACK));
    }
}

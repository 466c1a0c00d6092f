//! An lvoxel as it is held in memory: in eight bytes, or four without colour, since rays through media wait for memory more than for anything else.

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

/// A share of the most, up to 1: a float of five bits of exponent and eleven of mantissa, within 2.5e-4 of its value down to
/// 1e-9, and 0 below that.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Share(u16);

impl Share {
    /// 2^96 moves the exponents of numbers up to 1 to where five bits hold them.
    const SHIFT: f32 = 7.922_816_3e28;
    /// Bits of the mantissa of an f32 that are not held.
    const CUT: u32 = 12;

    fn of(value: f32, most: f32) -> Self {
        let share = value / most;
        // Not NaN, which 0 of 0 is, nor what would be denormal.
        if share > 1e-9 {
            let bits = (share.min(1.0) / Self::SHIFT).to_bits();
            Self(((bits + (1 << (Self::CUT - 1))) >> Self::CUT) as u16)
        } else {
            Self(0)
        }
    }

    #[inline]
    fn value(self) -> f32 {
        f32::from_bits(u32::from(self.0) << Self::CUT) * Self::SHIFT
    }
}

/// A block whose source function is the same in all channels.
#[derive(Clone, Copy, Debug, Default)]
#[repr(align(4))]
pub struct GreyBlock([Share; 2]);

impl Block for GreyBlock {
    fn new(sigma_t: f32, source: Rgb, most: &Most) -> Self {
        Self([
            Share::of(sigma_t, most.sigma_t),
            Share::of(source.0[0], most.source),
        ])
    }

    #[inline]
    fn read(self, most: &Most) -> (f32, Rgb) {
        let [sigma_t, source] = self.0.map(Share::value);
        (sigma_t * most.sigma_t, Rgb::splat(source * most.source))
    }

    #[inline]
    fn is_empty(self) -> bool {
        self.0[0] == Share(0)
    }
}

/// A block of any colour.
#[derive(Clone, Copy, Debug, Default)]
#[repr(align(8))]
pub struct ColouredBlock([Share; 4]);

impl Block for ColouredBlock {
    fn new(sigma_t: f32, Rgb([r, g, b]): Rgb, most: &Most) -> Self {
        Self([
            Share::of(sigma_t, most.sigma_t),
            Share::of(r, most.source),
            Share::of(g, most.source),
            Share::of(b, most.source),
        ])
    }

    #[inline]
    fn read(self, most: &Most) -> (f32, Rgb) {
        let [sigma_t, r, g, b] = self.0.map(Share::value);
        (sigma_t * most.sigma_t, Rgb([r, g, b]) * most.source)
    }

    #[inline]
    fn is_empty(self) -> bool {
        self.0[0] == Share(0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_hold_what_they_are_given() {
        assert_eq!((size_of::<GreyBlock>(), size_of::<ColouredBlock>()), (4, 8));
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
                let (grey_sigma_t, Rgb(grey)) =
                    GreyBlock::new(v, Rgb::splat(0.5 * v), &most).read(&most);
                assert_eq!((grey_sigma_t, grey), (sigma_t, [got[1]; 3]));
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

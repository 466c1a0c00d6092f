//! Which channels of a medium a camera ray sees: behind what has stopped red alone, how red light
//! changes in a medium is nothing that a picture shows.

use crate::math::Spectrum;

/// Transmittance below which what follows counts as bright as what was last seen: it sends no more
/// than this share of its radiance.
pub const OPAQUE: f32 = 1e-3;

/// What a part of a medium shows of its channels.
#[derive(Clone, Copy, Debug)]
pub struct SeenChannels<K> {
    /// What each adds to the ray: its extinction, times the share of its light that comes through.
    pub weights: K,
    /// Mean extinction by these weights, over that of the densest channel; 1 in grey media.
    pub extinction: f32,
}

impl<K: Spectrum> SeenChannels<K> {
    /// Those of a medium of such a colour, of which these shares come through.
    #[inline]
    pub fn new(through: K, color: &[f32; 3]) -> Self {
        let color = K::tinted(1.0, color);
        let weights = through.times(color);
        let all = weights.mean();
        let extinction = match K::IS_GREY {
            true => 1.0,
            false if all > 0.0 => weights.times(color).mean() / all,
            false => 1.0,
        };
        Self {
            weights,
            extinction,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::Rgb;

    #[test]
    fn channels_that_are_stopped_do_not_count() {
        let color = [1.0, 0.5, 0.25];
        let of = |through| SeenChannels::new(Rgb(through), &color).extinction;
        assert_eq!(of([0.0, 0.0, 1.0]), 0.25);
        assert_eq!(of([1.0, 0.0, 0.0]), 1.0);
        assert_eq!(of([0.0; 3]), 1.0);
        assert!((of([1.0; 3]) - 1.3125 / 1.75).abs() < 1e-6);
        assert_eq!(SeenChannels::new(0.3, &[1.0; 3]).extinction, 1.0);
    }
}

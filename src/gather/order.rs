//! An order in which what is near in space follows one another.

use crate::math::Aabb;
use glam::Vec3;
use lvox_formats::morton::interleave;

/// Puts things in the order in which a curve through the box around all of them, which fills each
/// eighth before the next (Morton 1966), meets their places. Of places that are not finite nothing
/// is promised.
#[must_use]
pub fn in_order_of_places<T>(things: Vec<T>, place: impl Fn(&T) -> Vec3) -> Vec<T> {
    /// Cells along each axis.
    const CELLS: f32 = (1 << 20) as f32;
    let bounds = things.iter().map(&place).fold(Aabb::EMPTY, Aabb::with);
    let extent = (bounds.max - bounds.min)
        .max_element()
        .max(f32::MIN_POSITIVE);
    let mut things = things;
    things.sort_by_cached_key(|thing| {
        let cell = (place(thing) - bounds.min) * (CELLS / extent);
        interleave(cell.to_array().map(|c| c.clamp(0.0, CELLS - 1.0) as u64))
    });
    things
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_eighth_is_filled_before_the_next() {
        let cells = (0..512).map(|i| (i * 149) % 512);
        let place =
            |i: &usize| Vec3::new((i % 8) as f32, (i / 8 % 8) as f32, (i / 64) as f32) * 1e6 - 3.0;
        let order = in_order_of_places(cells.collect(), place);
        let eighth = |i: &usize| [i % 8 / 4, i / 8 % 8 / 4, i / 256];
        for part in order.chunks(64) {
            assert!(part.iter().all(|i| eighth(i) == eighth(&part[0])));
        }
        assert!(in_order_of_places(Vec::new(), place).is_empty());
        assert_eq!(in_order_of_places(vec![7, 7], place), [7, 7]);
    }
}

//! Places on surfaces by where they are: those nearest to a point, of the side of each that faces
//! as it does (a k-d tree, Bentley 1975).

use arrayvec::ArrayVec;
use glam::Vec3;

/// A point on a surface, and the normal of its front.
#[derive(Clone, Copy, Debug)]
struct Place {
    point: Vec3,
    normal: Vec3,
    number: u32,
    /// Along which those before it and those after it are divided.
    axis: u8,
}

/// Places, each in the middle between those on its one side and those on its other.
#[derive(Debug)]
pub struct Places(Vec<Place>);

/// The nearest so far, nearest first, by the square of their distance, and their number.
struct Nearest<const MOST: usize> {
    point: Vec3,
    normal: Vec3,
    found: ArrayVec<(f32, u32), MOST>,
}

impl Places {
    /// Bytes of each.
    pub const BYTES: usize = size_of::<Place>();
    /// Cosine between the normals of a point and of the side of a place that faces as it does, at
    /// least.
    const FACING: f32 = 0.5;
    /// Places that are looked at one by one.
    const FEW: usize = 8;

    /// Sorts points with the unit normals of their fronts. As they come, the front of each has the
    /// next number, and its back that after it.
    pub fn new(points: impl Iterator<Item = (Vec3, Vec3)>) -> Self {
        let place = |(number, (point, normal))| Place {
            point,
            normal,
            number,
            axis: 0,
        };
        let mut places: Vec<Place> = (0..).step_by(2).zip(points).map(place).collect();
        divide(&mut places);
        Self(places)
    }

    /// The nearest to a point, the side of each that faces as it does, nearest first, at most so
    /// many.
    pub fn nearest<const MOST: usize>(&self, point: Vec3, normal: Vec3) -> ArrayVec<u32, MOST> {
        let mut nearest = Nearest::<MOST> {
            point,
            normal,
            found: ArrayVec::new(),
        };
        nearest.search(&self.0);
        nearest
            .found
            .into_iter()
            .map(|(_, number)| number)
            .collect()
    }
}

/// Puts a place into the middle between those on its one side and those on its other, and so on.
fn divide(places: &mut [Place]) {
    /// From so many on, both sides at a time.
    const MANY: usize = 1 << 13;
    if places.len() <= Places::FEW {
        return;
    }
    let ends = |(low, high): (Vec3, Vec3), p: &Place| (low.min(p.point), high.max(p.point));
    let (low, high) = (places.iter()).fold((Vec3::INFINITY, Vec3::NEG_INFINITY), ends);
    let axis = (high - low).max_position();
    let middle = places.len() / 2;
    let by_place = |p: &Place, q: &Place| {
        let order = p.point[axis].total_cmp(&q.point[axis]);
        order.then(p.number.cmp(&q.number))
    };
    let (before, place, after) = places.select_nth_unstable_by(middle, by_place);
    place.axis = axis as u8;
    if before.len() < MANY {
        divide(before);
        divide(after);
    } else {
        rayon::join(|| divide(before), || divide(after));
    }
}

impl<const MOST: usize> Nearest<MOST> {
    fn search(&mut self, places: &[Place]) {
        if places.len() <= Places::FEW {
            places.iter().for_each(|p| self.ask(p));
            return;
        }
        let (before, rest) = places.split_at(places.len() / 2);
        let Some((place, after)) = rest.split_first() else {
            return;
        };
        let axis = usize::from(place.axis);
        let beyond = self.point[axis] - place.point[axis];
        let (near, far) = if beyond < 0.0 {
            (before, after)
        } else {
            (after, before)
        };
        self.search(near);
        self.ask(place);
        if !self.found.is_full() || self.found.last().is_some_and(|f| beyond * beyond <= f.0) {
            self.search(far);
        }
    }

    fn ask(&mut self, place: &Place) {
        let cos = place.normal.dot(self.normal);
        if cos.abs() <= Places::FACING {
            return;
        }
        let side = place.number + u32::from(cos < 0.0);
        let new = (place.point.distance_squared(self.point), side);
        let at = (self.found.iter()).position(|old| new < *old);
        let at = at.unwrap_or(self.found.len());
        if at < MOST {
            if self.found.is_full() {
                self.found.pop();
            }
            self.found.insert(at, new);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::sampling::{hash, sphere, unit2};

    #[test]
    fn the_nearest_are_those_that_a_look_at_all_finds() {
        let by_chance = |i: u64, key: u64| {
            let [u, v] = [0, 1].map(|n| unit2(hash(&[i, key, n])));
            // Some at one place, and many as high as others.
            let point = Vec3::new(u[0], u[1], (4.0 * v[0]).floor());
            (point, sphere(unit2(hash(&[i, key, 2]))))
        };
        for count in [0, 1, 7, 300, 20_000] {
            let all: Vec<_> = (0..count).map(|i| by_chance(i / 2, 0)).collect();
            let places = Places::new(all.iter().copied());
            for i in 0..200 {
                let (point, normal) = by_chance(i, 1);
                let sides = all.iter().flat_map(|(p, n)| [(p, *n), (p, -*n)]).zip(0..);
                let facing = sides.filter(|((_, n), _)| n.dot(normal) > 0.5);
                let mut expected: Vec<(f32, u32)> = facing
                    .map(|((p, _), number)| (p.distance_squared(point), number))
                    .collect();
                expected.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
                let expected: Vec<u32> = expected.iter().map(|e| e.1).take(8).collect();
                assert_eq!(places.nearest::<8>(point, normal).to_vec(), expected);
                let first = places.nearest::<1>(point, normal);
                assert_eq!(first.first(), expected.first());
            }
        }
    }
}

//! Parallel rays through the box of a volume.

use super::blocks::Blocks;
use crate::math::Ray;
use crate::math::sampling::{hash, unit2};
use crate::trace::offset;
use glam::{DQuat, DVec3, Vec3, Vec3Swizzles};

/// Most rays of a direction along each axis across it.
pub const MOST_ALONG: f64 = 256.0;
/// Edges of blocks between rays: about 8 of all directions together meet each, and light goes along
/// them both ways. With a quarter of them a slab of depth 10 reflects 9 % less: the fewer rays meet
/// a block, the more of what one loses there it is given back.
pub const APART: f64 = 1.5;
/// Number of directions, each of which stands for its opposite, too.
pub const DIRECTIONS: usize = 12;

/// Directions that with their opposites are of equal weight and have the second and fourth moments
/// of the sphere: the level-symmetric set of order 4 (Carlson & Lathrop 1968). It is turned so that
/// the means of |x|, |y| and |z| are a half, too, and as much light leaves through the faces of a
/// box as should: along axes the set lets out 5 % too much. Two further sets have the axes in turn.
pub fn directions(set: u32) -> [Vec3; DIRECTIONS] {
    const NEAR: f64 = 0.350_021_2;
    const FAR: f64 = 0.868_890_3;
    // In doubles: for quaternions of floats glam fuses multiply-adds where the processor can.
    let turn = DQuat::from_xyzw(0.000_403_9, 0.146_452_6, -0.769_206_7, 0.621_990_8).normalize();
    let places = [[NEAR, NEAR, FAR], [NEAR, FAR, NEAR], [FAR, NEAR, NEAR]];
    std::array::from_fn(|i| {
        let signs = DVec3::from([0, 1, 2].map(|a| 1.0 - 2.0 * ((i / 3) >> a & 1) as f64));
        let direction = (turn * (DVec3::from(places[i % 3]) * signs)).normalize();
        let direction = direction.as_vec3();
        match set % 3 {
            0 => direction,
            1 => direction.yzx(),
            _ => direction.zxy(),
        }
    })
}

/// Parallel rays through the box of a volume, from where they enter it to where they leave, and the
/// volume that each stands for, voxels per unit of its length. Each direction has its lattice in
/// another place.
pub fn rays(blocks: &Blocks, direction: Vec3, key: u64) -> (Vec<Ray>, f32) {
    let along = blocks.in_index(direction.as_dvec3());
    let main = (1..3).fold(0, |m, a| {
        if along[a].abs() > along[m].abs() {
            a
        } else {
            m
        }
    });
    let across = [(main + 1) % 3, (main + 2) % 3];
    let dims = blocks.dims.map(f64::from);
    let slope = across.map(|a| along[a] / along[main]);
    let spacing = APART * edge(blocks);
    let spacing = [0, 1].map(|i| {
        let width = dims[across[i]] + slope[i].abs() * dims[main];
        spacing.max(width / MOST_ALONG)
    });
    let shift = unit2(hash(&[key])).map(f64::from);
    // Where rays pass the lower end of the main axis.
    let places = |i: usize| {
        let reach = slope[i] * dims[main];
        let (low, high) = ((-reach).min(0.0), dims[across[i]] + (-reach).max(0.0));
        let first = (low / spacing[i] - shift[i]).floor() as i64;
        let last = (high / spacing[i] - shift[i]).ceil() as i64;
        (first..=last).map(move |n| (n as f64 + shift[i]) * spacing[i])
    };
    let start = if along[main] > 0.0 { 0.0 } else { dims[main] };
    let mut rays = Vec::new();
    for u in places(0) {
        for v in places(1) {
            let mut point = DVec3::ZERO;
            point[main] = start;
            point[across[0]] = u + slope[0] * start;
            point[across[1]] = v + slope[1] * start;
            let origin = blocks.scene_from_index.transform_point3(point).as_vec3();
            // A little before the box, as its end is rounded.
            let origin = origin - direction * (4.0 * offset(origin));
            let ray = Ray::endless(origin, direction);
            if let Some((near, far)) = blocks.ends(&ray) {
                rays.push(Ray::new(ray.at(near), direction, far - near));
            }
        }
    }
    let section = spacing[0] * spacing[1] * along[main].abs();
    (rays, section as f32)
}

/// The edge that half of all blocks are larger than, voxels.
fn edge(blocks: &Blocks) -> f64 {
    let mut counts = [0_usize; 256];
    for level in &blocks.levels {
        counts[usize::from(*level)] += 1;
    }
    let mut smaller = 0;
    let level = counts.iter().position(|n| {
        smaller += n;
        2 * smaller >= blocks.len()
    });
    f64::from(1 << level.unwrap_or(0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn directions_have_the_moments_of_the_sphere() {
        let directions = directions(0).map(|d| [d, -d]).concat();
        let mean = |f: &dyn Fn(Vec3) -> f32| {
            directions.iter().map(|d| f(*d)).sum::<f32>() / directions.len() as f32
        };
        for (found, expected) in [
            (mean(&|d| d.x), 0.0),
            (mean(&|d| d.x * d.y), 0.0),
            (mean(&|d| d.z * d.z), 1.0 / 3.0),
            (mean(&|d| d.y.powi(4)), 1.0 / 5.0),
            (mean(&|d| d.x.abs()), 0.5),
            (mean(&|d| d.y.abs()), 0.5),
            (mean(&|d| d.z.abs()), 0.5),
        ] {
            assert!((found - expected).abs() < 1e-3, "{found} {expected}");
        }
    }
}

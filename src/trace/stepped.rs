//! A volume on few voxels, packed for rays that pass it in even steps.

use crate::math::dda::Passage;
use crate::math::{Ray, unflatten};
use crate::scene::Volume;
use glam::{Affine3A, DAffine3, DVec3, Vec3A, Vec4};
use rayon::prelude::*;
use wide::{f32x8, i32x8};

/// Extinction on a grid of few voxels, for rays that need not know what is in which cell: for what
/// many rays tell together.
///
/// Points some cells apart tell a smooth field as well as the middle of each cell that a ray
/// crosses. They are fewer, and none waits for the one before.
#[derive(Debug)]
pub struct SteppedVolume {
    map: Affine3A,
    exact_map: DAffine3,
    /// The volume's box, voxels.
    dims: Vec3A,
    /// Bounds of the cells that are not empty. Cell coordinates are those of voxels plus a half:
    /// samples stand at whole numbers.
    lower: Vec3A,
    upper: Vec3A,
    /// Samples with a border of copies around them, x fastest.
    samples: Vec<f32>,
    /// Samples from one to the next along each axis.
    strides: [usize; 3],
    /// Cells from one point of a ray to the next, at most.
    pub step: f32,
}

impl SteppedVolume {
    /// The media of volumes on one grid, together, on at most `most` voxels along each axis, passed
    /// in steps of one cell.
    #[must_use]
    pub fn new(volume: &Volume, others: &[&Volume], most: usize) -> Self {
        let grid = &volume.sigma_t;
        let block = grid.dims().map(|n| n.div_ceil(most));
        let blocks = grid.blocks(block);
        let mut means = grid.means(block);
        for other in others {
            let all = means.iter_mut().zip(other.sigma_t.means(block));
            all.for_each(|(mean, other)| *mean += other);
        }
        let means = sharpened(means, blocks, block);
        let [width, height, depth] = blocks.map(|n| n + 2);
        let mut samples = Vec::with_capacity(width * height * depth);
        let (mut lower, mut upper) = (Vec3A::INFINITY, Vec3A::ZERO);
        let inside = |a: usize, at: usize| at.saturating_sub(1).min(blocks[a] - 1);
        for z in 0..depth {
            for y in 0..height {
                let row = (inside(2, z) * blocks[1] + inside(1, y)) * blocks[0];
                for x in 0..width {
                    let sample = means[row + inside(0, x)];
                    samples.push(sample);
                    if sample > 0.0 {
                        let at = Vec3A::new(x as f32, y as f32, z as f32);
                        lower = lower.min(at - 1.0);
                        upper = upper.max(at + 1.0);
                    }
                }
            }
        }
        let size = DVec3::from_array(block.map(|n| n as f64));
        let exact_map = DAffine3::from_scale(size.recip()) * volume.index_from_scene_f64;
        let dims = DVec3::from_array(grid.dims().map(|n| n as f64)) / size;
        Self {
            map: Affine3A::from_cols_array(&exact_map.to_cols_array().map(|v| v as f32)),
            exact_map,
            dims: dims.as_vec3a(),
            lower: lower.min(upper),
            upper,
            samples,
            strides: [1, width, width * height],
            step: 1.0,
        }
    }

    /// The optical depth along a ray.
    #[must_use]
    pub fn optical_depth(&self, ray: &Ray) -> f32 {
        self.optical_depth_up_to(ray, f32::INFINITY)
    }

    /// The same, or any depth from `enough` on where it is more than that.
    #[must_use]
    pub fn optical_depth_up_to(&self, ray: &Ray, enough: f32) -> f32 {
        let map = (&self.map, &self.exact_map);
        let Some(passage) = Passage::new(map, self.dims.to_array(), ray) else {
            return 0.0;
        };
        let Passage { line, end, .. } = passage.in_cells();
        let Some((near, far)) = line.within(self.lower, self.upper, 0.0, end) else {
            return 0.0;
        };
        let cells = line.direction.length() * (far - near);
        let count = (cells / self.step).ceil().max(1.0);
        let step = (far - near) / count;
        let first = line.origin + line.direction * (near + 0.5 * step);
        let by = line.direction * step;
        // At the box's upper faces cells end in their middle.
        let most = self.dims + 0.5;
        let sum = self.sum([first, by], count as u32, most, enough / step);
        sum.element_sum() * step
    }

    /// Values at a point and at others each so far from the one before, with none beyond 0 and
    /// `most`, in cells: the sum of so many as four shares, or of the first that are `enough`.
    /// Where points are is found for some of them side by side.
    #[inline]
    fn sum(&self, [first, by]: [Vec3A; 2], count: u32, most: Vec3A, enough: f32) -> Vec4 {
        const TOGETHER: usize = 8;
        let number = f32x8::new(std::array::from_fn(|k| k as f32));
        let along = |a: usize, i: f32x8| {
            let p = f32x8::splat(first[a]) + f32x8::splat(by[a]) * i;
            p.fast_max(f32x8::ZERO).fast_min(f32x8::splat(most[a]))
        };
        let mut sum = Vec4::ZERO;
        for before in (0..count).step_by(TOGETHER) {
            let i = number + f32x8::splat(before as f32);
            let p: [f32x8; 3] = std::array::from_fn(|a| along(a, i));
            let cell = p.map(|p| p.floor());
            let [x, y, z] = cell.map(|c| c.fast_trunc_int());
            let [_, row, plane] = self.strides.map(|n| i32x8::splat(n as i32));
            let at = (x + y * row + z * plane).to_array();
            let [fx, fy, fz]: [_; 3] = std::array::from_fn(|a| (p[a] - cell[a]).to_array());
            for k in 0..TOGETHER.min((count - before) as usize) {
                sum += self.in_corners(at[k] as usize, [fx[k], fy[k], fz[k]]);
            }
            if sum.element_sum() >= enough {
                break;
            }
        }
        sum
    }

    /// Trilinear value in a cell, as far from its first corner as these shares of it, as the sum of
    /// four shares.
    #[inline]
    fn in_corners(&self, at: usize, f: [f32; 3]) -> Vec4 {
        let [_, row, plane] = self.strides;
        let face = |at: usize| {
            let pair = |at: usize| [self.samples[at], self.samples[at + 1]];
            let ([a, b], [c, d]) = (pair(at), pair(at + row));
            Vec4::new(a, b, c, d)
        };
        let (lower, upper) = (face(at), face(at + plane));
        let x = Vec4::new(1.0, 0.0, 1.0, 0.0) + Vec4::new(-1.0, 1.0, -1.0, 1.0) * f[0];
        let y = Vec4::new(1.0, 1.0, 0.0, 0.0) + Vec4::new(-1.0, -1.0, 1.0, 1.0) * f[1];
        (lower + (upper - lower) * f[2]) * (x * y)
    }
}

/// Means over blocks of so many voxels, sharpened by what linear interpolation over blocks spreads
/// further than over voxels. Their sum stays.
fn sharpened(means: Vec<f32>, dims: [usize; 3], block: [usize; 3]) -> Vec<f32> {
    if block == [1; 3] {
        return means;
    }
    // Variances along an axis, in voxels: a mean of n adds (n^2 - 1) / 12, interpolation n^2 / 6
    // where it was 1 / 6, and the two neighbours along it spread by n^2.
    let by = block.map(|n| 0.25 * (1.0 - 1.0 / (n * n) as f32));
    let strides = [1, dims[0], dims[0] * dims[1]];
    let sharp = |i: usize| {
        let at = unflatten(i, dims);
        let along = |a: usize| {
            let before = i - if at[a] > 0 { strides[a] } else { 0 };
            let behind = i + if at[a] + 1 < dims[a] { strides[a] } else { 0 };
            by[a] * (means[i] - 0.5 * (means[before] + means[behind]))
        };
        (means[i] + (0..3).map(along).sum::<f32>()).max(0.0)
    };
    let sharp: Vec<f32> = (0..means.len()).into_par_iter().map(sharp).collect();
    // Values that would be negative left too much.
    let sum = |v: &[f32]| v.iter().copied().map(f64::from).sum::<f64>();
    let (all, left) = (sum(&means), sum(&sharp));
    let scale = if left > 0.0 { (all / left) as f32 } else { 1.0 };
    sharp.into_iter().map(|v| scale * v).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::sampling;
    use crate::scene::Grid;
    use crate::trace::Cells;
    use glam::{DQuat, Vec3};

    fn tilted() -> DAffine3 {
        DAffine3::from_scale_rotation_translation(
            DVec3::new(0.05, 0.08, 0.03),
            DQuat::from_rotation_y(0.7) * DQuat::from_rotation_x(-0.4),
            DVec3::new(3.0, -1.0, 2.0),
        )
    }

    fn volume(dims: [usize; 3], sigma_t: impl Fn(Vec3) -> f32 + Sync) -> Volume {
        let at = |v: [usize; 3]| sigma_t(Vec3::from_array(v.map(|i| i as f32 + 0.5)));
        Volume::new("test".into(), Grid::from_fn(dims, at), [0.5; 3], tilted())
    }

    /// Rays from outside of the volume and from inside through its middle, some of them short.
    fn rays(v: &Volume) -> impl Iterator<Item = Ray> {
        let dims = DVec3::from_array(v.sigma_t.dims().map(|n| n as f64));
        let map = v.scene_from_index;
        (0..200).map(move |i| {
            let way = sampling::sphere(sampling::r2(i, [0.1; 2])).as_dvec3();
            let reach = if i % 2 == 0 { 0.3 } else { 2.0 };
            let from = map.transform_point3(dims * (0.5 + reach * way));
            let through = map.transform_point3(dims * 0.5);
            let t_max = if i % 3 == 0 { 1.5 } else { f32::INFINITY };
            let direction = (through - from).normalize().as_vec3();
            Ray::new(from.as_vec3(), direction, t_max)
        })
    }

    fn exact(v: &Volume, ray: &Ray) -> f32 {
        Cells::new(v, ray).map_or(0.0, |c| c.optical_depth() as f32)
    }

    #[test]
    fn smooth_media_are_as_deep_as_cell_by_cell() {
        let hill = |p: Vec3| (1.0 - 0.05 * p.distance(Vec3::new(18.0, 10.0, 14.0))).max(0.0);
        let v = volume([36, 20, 28], hill);
        for (step, tolerance) in [(1.0, 0.002), (2.0, 0.01), (4.0, 0.04)] {
            let mut stepped = SteppedVolume::new(&v, &[], 64);
            stepped.step = step;
            for ray in rays(&v) {
                let expected = exact(&v, &ray);
                let got = stepped.optical_depth(&ray);
                assert!(
                    (got - expected).abs() <= tolerance * expected.max(0.1),
                    "{ray:?} in steps of {step}: {got} beside {expected}"
                );
            }
        }
    }

    #[test]
    fn a_box_is_as_long_as_it_was_on_any_number_of_voxels() {
        for (dims, most) in [
            ([1, 1, 1], 8),
            ([16, 9, 12], 16),
            ([17, 9, 30], 8),
            ([5, 40, 7], 3),
        ] {
            let v = volume(dims, |_| 0.7);
            let mut stepped = SteppedVolume::new(&v, &[], most);
            stepped.step = 3.0;
            for ray in rays(&v) {
                let expected = exact(&v, &ray);
                let got = stepped.optical_depth(&ray);
                assert!(
                    (got - expected).abs() <= 1e-5,
                    "{ray:?}: {got} beside {expected}"
                );
            }
        }
    }

    #[test]
    fn media_on_fewer_voxels_hold_as_much_and_are_spread_as_far() {
        // A bump, away from the box.
        let middle = Vec3::splat(24.0);
        let v = volume([48; 3], |p| {
            (-0.5 * (p.distance(middle) / 6.0).powi(2)).exp()
        });
        let stepped = SteppedVolume::new(&v, &[], 16);
        let inside = |p: Vec3| v.sigma_t.sample(p);
        let (mut sums, mut variances) = ([0.0_f64; 2], [0.0_f64; 2]);
        for i in 0..48_usize.pow(3) {
            let p = Vec3::from_array(unflatten(i, [48; 3]).map(|i| i as f32 + 0.5));
            let in_cells = Vec3A::from(p / 3.0 + 0.5);
            let stepped = stepped.sum(
                [in_cells, Vec3A::ZERO],
                1,
                stepped.dims + 0.5,
                f32::INFINITY,
            );
            let values = [inside(p), stepped.element_sum()];
            for (k, value) in values.into_iter().enumerate() {
                sums[k] += f64::from(value);
                variances[k] += f64::from(value * p.distance_squared(middle));
            }
        }
        let mass = sums[1] / sums[0];
        let spread = variances[1] / variances[0];
        assert!((mass - 1.0).abs() < 1e-3, "{mass}");
        assert!((spread - 1.0).abs() < 4e-3, "{spread}");
    }

    #[test]
    fn nothing_is_passed_in_no_time() {
        let v = volume([9; 3], |_| 0.0);
        let stepped = SteppedVolume::new(&v, &[], 64);
        for ray in rays(&v) {
            assert_eq!(stepped.optical_depth(&ray), 0.0);
        }
    }
}

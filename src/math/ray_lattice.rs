//! Parallel rays through a regular grid, one lattice step apart across the grid's axis that they
//! run most along: in each layer of vertices along that axis they stand in a square lattice, so
//! that what they carry is interpolated in it.

use glam::Vec3;

/// The rays of one direction. Lengths are in lattice steps unless said otherwise.
#[derive(Clone, Copy, Debug)]
pub struct RayLattice {
    /// The axis that the rays run most along, and the two across it.
    pub axes: [usize; 3],
    /// Steps along each axis across per step along the first.
    slope: [f32; 2],
    /// Index-space length of a step.
    step: f32,
    /// Whether the direction points to the upper end of the first axis.
    pub upwards: bool,
    /// Length of the direction that was given between two layers.
    pub between: f32,
}

impl RayLattice {
    /// Rays along `direction`, of any length, in index space, for a lattice with a vertex every
    /// `step`.
    #[must_use]
    pub fn new(direction: Vec3, step: f32) -> Self {
        let d = direction.to_array();
        let main = (1..3).fold(0, |m, a| if d[a].abs() > d[m].abs() { a } else { m });
        let axes = [main, (main + 1) % 3, (main + 2) % 3];
        Self {
            axes,
            slope: [d[axes[1]] / d[main], d[axes[2]] / d[main]],
            step,
            upwards: d[main] > 0.0,
            between: step / d[main].abs(),
        }
    }

    /// Place of a point among the rays: along the first axis, and across it. Rays stand at whole
    /// numbers across.
    #[inline]
    #[must_use]
    pub fn place(&self, point: [f32; 3]) -> (f32, [f32; 2]) {
        let [main, u, w] = self.axes.map(|a| point[a]);
        let across = [u - self.slope[0] * main, w - self.slope[1] * main];
        (main, across)
    }

    /// Position of a ray in a layer, along the two axes across.
    #[inline]
    #[must_use]
    pub fn across(&self, ray: [f32; 2], layer: f32) -> [f32; 2] {
        [
            ray[0] + self.slope[0] * layer,
            ray[1] + self.slope[1] * layer,
        ]
    }

    /// Point of index space where a ray meets a layer.
    #[must_use]
    pub fn point(&self, ray: [f32; 2], layer: usize) -> Vec3 {
        let mut p = [0.0; 3];
        let across = self.across(ray, layer as f32);
        p[self.axes[0]] = layer as f32 * self.step;
        p[self.axes[1]] = across[0] * self.step;
        p[self.axes[2]] = across[1] * self.step;
        p.into()
    }

    /// First ray and number of rays along each axis across, so that all vertices of a box, given by
    /// its first and its last, have rays on all sides.
    #[must_use]
    pub fn extent(&self, [first, last]: [[usize; 3]; 2]) -> [(i32, usize); 2] {
        let mut extent = [(i32::MAX, i32::MIN); 2];
        for i in 0..8 {
            let corner = std::array::from_fn(|a| [first, last][i >> a & 1][a] as f32);
            let (_, across) = self.place(corner);
            for (extent, across) in extent.iter_mut().zip(across) {
                extent.0 = extent.0.min(across.floor() as i32 - 2);
                extent.1 = extent.1.max(across.ceil() as i32 + 2);
            }
        }
        extent.map(|(low, high)| (low, (high - low + 1) as usize))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_on_a_ray_keep_their_place_across() {
        for d in [
            Vec3::new(1.0, 0.3, -0.2),
            Vec3::new(0.5, -2.0, 0.7),
            Vec3::new(-0.1, 0.4, -3.0),
        ] {
            let rays = RayLattice::new(d, 2.0);
            let count = [9, 17, 5];
            let extent = rays.extent([[0; 3], count.map(|n| n - 1)]);
            for layer in 0..5 {
                let p = rays.point([3.0, -1.0], layer);
                let (along, across) = rays.place((p / 2.0).to_array());
                assert_eq!(along, layer as f32);
                assert!((across[0] - 3.0).abs() + (across[1] + 1.0).abs() < 1e-5);
                let next = rays.point([3.0, -1.0], layer + 1);
                let sign = if rays.upwards { 1.0 } else { -1.0 };
                assert!((next - p - d * (sign * rays.between)).length() < 1e-5);
            }
            for i in 0..8 {
                let corner = std::array::from_fn(|a| ((count[a] - 1) * (i >> a & 1)) as f32);
                let (_, across) = rays.place(corner);
                for a in 0..2 {
                    let (first, n) = extent[a];
                    assert!(
                        across[a] >= first as f32 && across[a] + 1.0 < (first + n as i32) as f32
                    );
                }
            }
        }
    }
}

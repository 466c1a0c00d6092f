//! The sums over surfels that nodes are made of, in f64.

use crate::formats::{Bounds, Surfel, SurfelAggregate};

/// Sums over surfels. Adding is not associative in floating point, so the order is part of a
/// build's result: surfels of a leaf in Morton order, then children in order.
#[derive(Clone, Copy, Debug)]
pub struct AggregateSums {
    count: f64,
    area: f64,
    /// Of positions, and of area times position.
    positions: [f64; 3],
    moments: [f64; 3],
    normals: [f64; 3],
    /// Area times n n^T: xx, yy, zz, xy, xz, yz.
    outer: [f64; 6],
    /// Of fronts, towards +x, -x, +y, -y, +z, -z.
    axis_area: [f64; 6],
    axis_power: [[f64; 3]; 6],
    /// Of backs, towards the same.
    back_power: [[f64; 3]; 6],
    /// Tight box of all disks as clipped, scene space.
    pub bounds: Bounds,
}

impl AggregateSums {
    /// No surfels.
    pub const NOTHING: Self = Self {
        count: 0.0,
        area: 0.0,
        positions: [0.0; 3],
        moments: [0.0; 3],
        normals: [0.0; 3],
        outer: [0.0; 6],
        axis_area: [0.0; 6],
        axis_power: [[0.0; 3]; 6],
        back_power: [[0.0; 3]; 6],
        bounds: Bounds::EMPTY,
    };

    /// Adds a surfel; the last bits depend on the order.
    pub fn add_surfel(&mut self, s: &Surfel) {
        let area = f64::from(s.area);
        let n = s.normal.map(f64::from);
        self.count += 1.0;
        self.area += area;
        for (k, (p, n)) in s.position.into_iter().zip(n).enumerate() {
            let p = f64::from(p);
            self.positions[k] += p;
            self.moments[k] += area * p;
            self.normals[k] += area * n;
            self.outer[k] += area * n * n;
            let (projected, towards) = ((area * n).abs(), 2 * k + usize::from(n < 0.0));
            self.axis_area[towards] += projected;
            let add = |power: &mut [f64; 3], radiance: [f32; 3]| {
                for (power, l) in power.iter_mut().zip(radiance) {
                    *power += projected * f64::from(l);
                }
            };
            add(&mut self.axis_power[towards], s.front);
            add(&mut self.back_power[towards ^ 1], s.back);
        }
        for (k, (i, j)) in [(0, 1), (0, 2), (1, 2)].into_iter().enumerate() {
            self.outer[3 + k] += area * n[i] * n[j];
        }
        self.bounds = self.bounds.union(Bounds::of_surfel(s));
    }

    /// Adds the sums over other surfels.
    pub fn add(&mut self, other: &Self) {
        let add = |a: &mut [f64], b: &[f64]| {
            for (a, b) in a.iter_mut().zip(b) {
                *a += b;
            }
        };
        self.count += other.count;
        self.area += other.area;
        add(&mut self.positions, &other.positions);
        add(&mut self.moments, &other.moments);
        add(&mut self.normals, &other.normals);
        add(&mut self.outer, &other.outer);
        add(&mut self.axis_area, &other.axis_area);
        add(
            self.axis_power.as_flattened_mut(),
            other.axis_power.as_flattened(),
        );
        add(
            self.back_power.as_flattened_mut(),
            other.back_power.as_flattened(),
        );
        self.bounds = self.bounds.union(other.bounds);
    }

    /// The aggregate of a node over all of them; there must be at least one.
    #[must_use]
    pub fn aggregate(&self) -> SurfelAggregate {
        let centre = if self.area > 0.0 {
            self.moments.map(|m| (m / self.area) as f32)
        } else {
            self.positions.map(|p| (p / self.count) as f32)
        };
        let mean = |power: [f64; 3], area: f64| {
            let over_area = |p: f64| if area > 0.0 { (p / area) as f32 } else { 0.0 };
            power.map(over_area)
        };
        SurfelAggregate {
            area: self.area as f32,
            centre,
            normal_sum: self.normals.map(|n| n as f32),
            second_moment: self.outer.map(|m| m as f32),
            axis_area: self.axis_area.map(|a| a as f32),
            axis_radiance: std::array::from_fn(|d| mean(self.axis_power[d], self.axis_area[d])),
            back_radiance: std::array::from_fn(|d| mean(self.back_power[d], self.axis_area[d ^ 1])),
        }
    }
}

//! Surfels, nodes and lvoxels as what a viewer draws: disks and balls in scene space.

use crate::formats::{Lvoxel, Node, Surfel, VolumeInfo};

/// A disk with one radiance; one without a normal is a ball.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Disk {
    /// Centre, in scene space.
    pub position: [f32; 3],
    /// Unit normal; 0 if there is none.
    pub normal: [f32; 3],
    /// Radius, scene units.
    pub radius: f32,
    /// Radiance that leaves the front, or the source function of a medium.
    pub radiance: [f32; 3],
    /// Extinction of a medium; 0 of a surface.
    pub sigma_t: f32,
}

impl Disk {
    /// The front of a surfel.
    pub fn of_surfel(s: &Surfel) -> Self {
        Self {
            position: s.position,
            normal: s.normal,
            radius: s.radius,
            radiance: s.front,
            sigma_t: 0.0,
        }
    }

    /// What stands for a node: its mean normal, a disk of its area, and the mean radiance of all
    /// sides that send light.
    pub fn of_node(node: &Node) -> Self {
        let a = &node.aggregate;
        let len = a.normal_sum.iter().map(|n| n * n).sum::<f32>().sqrt();
        let is_lit = |d: usize| a.back_radiance[d] != [0.0; 3];
        let back = |d: usize| if is_lit(d) { a.axis_area[d ^ 1] } else { 0.0 };
        let lit: f32 = (0..6).map(|d| a.axis_area[d] + back(d)).sum();
        let radiance = std::array::from_fn(|c| {
            let power =
                |d: usize| a.axis_area[d] * a.axis_radiance[d][c] + back(d) * a.back_radiance[d][c];
            let power: f32 = (0..6).map(power).sum();
            if lit > 0.0 { power / lit } else { 0.0 }
        });
        Self {
            position: a.centre,
            normal: a.normal_sum.map(|n| if len > 0.0 { n / len } else { 0.0 }),
            radius: (a.area / std::f32::consts::PI).sqrt(),
            radiance,
            sigma_t: 0.0,
        }
    }

    /// A ball as large as an lvoxel.
    pub fn of_lvoxel(v: &Lvoxel, map: &SceneFromIndex) -> Self {
        let side = f64::from(1u32 << v.level);
        Self {
            position: map.apply(v.block.map(|b| (f64::from(b) + 0.5) * side)),
            normal: [0.0; 3],
            radius: map.ball_radius(v.level) as f32,
            radiance: v.source,
            sigma_t: v.sigma_t,
        }
    }
}

/// From index space back to scene space.
pub struct SceneFromIndex {
    inverse: [[f64; 3]; 3],
    origin: [f64; 3],
    voxel_volume: f64,
}

impl SceneFromIndex {
    /// `None` for a volume that is flat.
    pub fn of(volume: &VolumeInfo) -> Option<Self> {
        let [a, b, c, origin] = volume.index_from_scene;
        let cross = |a: [f64; 3], b: [f64; 3]| {
            [
                a[1] * b[2] - a[2] * b[1],
                a[2] * b[0] - a[0] * b[2],
                a[0] * b[1] - a[1] * b[0],
            ]
        };
        let dot = |a: [f64; 3], b: [f64; 3]| (0..3).map(|i| a[i] * b[i]).sum::<f64>();
        let det = dot(a, cross(b, c));
        // The rows of the inverse.
        let inverse = [cross(b, c), cross(c, a), cross(a, b)].map(|row| row.map(|v| v / det));
        (det != 0.0 && det.is_finite()).then_some(Self {
            inverse,
            origin,
            voxel_volume: 1.0 / det.abs(),
        })
    }

    /// A place of index space in scene space.
    pub fn apply(&self, index: [f64; 3]) -> [f32; 3] {
        self.inverse.map(|row| {
            (0..3)
                .map(|i| row[i] * (index[i] - self.origin[i]))
                .sum::<f64>() as f32
        })
    }

    /// Edges of a voxel in scene space.
    pub fn edges(&self) -> [[f64; 3]; 3] {
        [0, 1, 2].map(|axis| self.inverse.map(|row| row[axis]))
    }

    /// Radius of the ball that is as large as an lvoxel of a level.
    pub fn ball_radius(&self, level: u8) -> f64 {
        let side = f64::from(1u32 << level);
        let volume = self.voxel_volume * side.powi(3);
        (volume * 0.75 / std::f64::consts::PI).cbrt()
    }
}

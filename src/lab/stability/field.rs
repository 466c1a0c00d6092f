//! Exact integration in f64 of what the kernels integrate in f32: the trilinear field of a grid,
//! and a set of lvoxels.

use crate::formats::{Lvoxel, VolumeInfo};
use crate::math::unflatten;
use crate::scene::Volume;
use glam::{DAffine3, DMat3, DVec3, Vec3};

/// The samples of a grid in f64, with the placement of its volume.
pub struct Field {
    dims: [usize; 3],
    samples: Vec<f64>,
    index_from_scene: DAffine3,
}

impl Field {
    /// The field of a volume.
    pub fn of(volume: &Volume) -> Self {
        let dims = volume.sigma_t.dims();
        let samples = (0..dims[0] * dims[1] * dims[2])
            .map(|i| {
                let centre = Vec3::from(unflatten(i, dims).map(|c| c as f32 + 0.5));
                f64::from(volume.sigma_t.sample(centre))
            })
            .collect();
        Self {
            dims,
            samples,
            index_from_scene: volume.scene_from_index.inverse(),
        }
    }

    fn sample(&self, v: [usize; 3]) -> f64 {
        self.samples[(v[2] * self.dims[1] + v[1]) * self.dims[0] + v[0]]
    }

    /// Trilinear value at a point of index space inside the box, clamped in the outer half voxel.
    fn value(&self, p: DVec3) -> f64 {
        let mut low = [0; 3];
        let mut high = [0; 3];
        let mut f = [0.0; 3];
        for a in 0..3 {
            let at = (p[a] - 0.5).clamp(0.0, (self.dims[a] - 1) as f64);
            low[a] = at as usize;
            high[a] = (low[a] + 1).min(self.dims[a] - 1);
            f[a] = at - low[a] as f64;
        }
        let mut sum = 0.0;
        for corner in 0..8 {
            let mut weight = 1.0;
            let v = std::array::from_fn(|a| {
                let upper = corner >> a & 1 == 1;
                weight *= if upper { f[a] } else { 1.0 - f[a] };
                if upper { high[a] } else { low[a] }
            });
            sum += weight * self.sample(v);
        }
        sum
    }

    /// Optical depth from `origin` to `t_max`: between knees the field is a cubic along the ray,
    /// which two Gauss points integrate exactly.
    pub fn optical_depth(&self, origin: DVec3, direction: DVec3, t_max: f64) -> f64 {
        let o = self.index_from_scene.transform_point3(origin);
        let d = self.index_from_scene.transform_vector3(direction);
        let dims = self.dims.map(|n| n as f64);
        let Some((near, far)) = clip(o, d, [0.0; 3], dims, t_max) else {
            return 0.0;
        };
        let mut knees = vec![near, far];
        for a in 0..3 {
            for k in 0..self.dims[a] {
                let t = (k as f64 + 0.5 - o[a]) / d[a];
                if t > near && t < far {
                    knees.push(t);
                }
            }
        }
        knees.sort_by(f64::total_cmp);
        let gauss = 0.5 / 3.0_f64.sqrt();
        let mut tau = 0.0;
        for pair in knees.windows(2) {
            let (middle, length) = (0.5 * (pair[0] + pair[1]), pair[1] - pair[0]);
            let value = |t: f64| self.value(o + d * t);
            tau += 0.5 * length * (value(middle - gauss * length) + value(middle + gauss * length));
        }
        tau * direction.length()
    }

    /// Value at a point of scene space; 0 outside.
    pub fn at(&self, point: DVec3) -> f64 {
        let p = self.index_from_scene.transform_point3(point);
        let inside = (0..3).all(|a| p[a] >= 0.0 && p[a] <= self.dims[a] as f64);
        if inside { self.value(p) } else { 0.0 }
    }
}

/// Where o + t d is inside a box, for t in 0..t_max.
fn clip(o: DVec3, d: DVec3, low: [f64; 3], high: [f64; 3], t_max: f64) -> Option<(f64, f64)> {
    let (mut near, mut far) = (0.0_f64, t_max);
    for a in 0..3 {
        if d[a] == 0.0 {
            if o[a] < low[a] || o[a] > high[a] {
                return None;
            }
            continue;
        }
        let (t0, t1) = ((low[a] - o[a]) / d[a], (high[a] - o[a]) / d[a]);
        near = near.max(t0.min(t1));
        far = far.min(t0.max(t1));
    }
    (near < far).then_some((near, far))
}

/// The lvoxels of one volume, each a box of constant medium, cut where the volume ends.
pub struct Blocks<'a> {
    index_from_scene: DAffine3,
    dims: [f64; 3],
    lvoxels: Vec<&'a Lvoxel>,
}

impl<'a> Blocks<'a> {
    /// Those of one volume of a tree.
    pub fn of(index: usize, info: &VolumeInfo, all: &'a [Lvoxel]) -> Self {
        let [x, y, z, t] = info.index_from_scene.map(DVec3::from);
        Self {
            index_from_scene: DAffine3 {
                matrix3: DMat3::from_cols(x, y, z),
                translation: t,
            },
            dims: info.dims.map(f64::from),
            lvoxels: all
                .iter()
                .filter(|l| usize::from(l.volume) == index)
                .collect(),
        }
    }

    /// Radiance per channel and transmittance from `origin` to `t_max`, in f64.
    pub fn pass(&self, origin: DVec3, direction: DVec3, t_max: f64) -> ([f64; 3], f64) {
        let o = self.index_from_scene.transform_point3(origin);
        let d = self.index_from_scene.transform_vector3(direction);
        let mut met: Vec<(f64, f64, &Lvoxel)> = Vec::new();
        if clip(o, d, [0.0; 3], self.dims, t_max).is_some() {
            for l in &self.lvoxels {
                let low = l.block.map(|b| f64::from(u32::from(b) << l.level));
                let edge = f64::from(1_u32 << l.level);
                let high = std::array::from_fn(|a| (low[a] + edge).min(self.dims[a]));
                if let Some((near, far)) = clip(o, d, low, high, t_max) {
                    met.push((near, far, l));
                }
            }
        }
        met.sort_by(|a, b| a.0.total_cmp(&b.0));
        let (mut light, mut through) = ([0.0; 3], 1.0);
        for (near, far, l) in met {
            let tau = f64::from(l.sigma_t) * (far - near) * direction.length();
            for (light, source) in light.iter_mut().zip(l.source) {
                *light += through * f64::from(source) * -(-tau).exp_m1();
            }
            through *= (-tau).exp();
        }
        (light, through)
    }
}

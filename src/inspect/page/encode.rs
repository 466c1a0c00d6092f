//! Points as a view holds them: 14 bytes each.
//!
//! | bytes | of a disk | of an lvoxel |
//! | --- | --- | --- |
//! | 0–5 | place in the box, 16 bits an axis | the same |
//! | 6, 7 | normal, folded to an octahedron; 255 255 if there is none | level, 0 |
//! | 8, 9 | radius as a half; negative: it stays where levels are finer | sigma_t as a half |
//! | 10–13 | radiance as RGB9E5: three times nine bits, one exponent | the same |

use super::sample::{GroupKind, Point, Sample};
use crate::formats::{Bounds, VolumeInfo};
use half::f16;
use serde_json::{Value, json};

/// Bytes of a point.
pub const POINT_BYTES: usize = 14;

/// What numbers are stored in.
#[derive(Clone, Copy, Debug)]
pub struct Units {
    bounds: Bounds,
    radius: f32,
    sigma_t: f32,
    radiance: f32,
}

impl Units {
    /// Those in which all points of a sample have room; the mean radiance is about 1.
    pub fn of(sample: &Sample) -> Option<Self> {
        let bounds = sample.bounds()?;
        let size: [f64; 3] =
            std::array::from_fn(|k| f64::from(bounds.max[k]) - f64::from(bounds.min[k]));
        let diagonal = size.iter().map(|s| s * s).sum::<f64>().sqrt();
        let points = || sample.groups.iter().flat_map(|g| &g.points);
        let densest = points().map(|p| p.disk.sigma_t).fold(0.0, f32::max);
        let lit = points().map(|p| f64::from(p.disk.radiance.iter().sum::<f32>()) / 3.0);
        let mean = lit.sum::<f64>() / points().count() as f64;
        let or_1 = |v: f64| if v.is_normal() { v as f32 } else { 1.0 };
        Some(Self {
            bounds,
            radius: or_1(diagonal / 1024.0),
            sigma_t: or_1(f64::from(densest) / 1024.0),
            radiance: or_1(mean),
        })
    }

    /// For the script.
    pub fn to_json(self) -> Value {
        json!({
            "min": self.bounds.min,
            "max": self.bounds.max,
            "radius": self.radius,
            "sigma_t": self.sigma_t,
            "radiance": self.radiance,
        })
    }

    fn point(&self, kind: GroupKind, point: &Point, out: &mut Vec<u8>) {
        let disk = &point.disk;
        for k in 0..3 {
            let (min, max) = (f64::from(self.bounds.min[k]), f64::from(self.bounds.max[k]));
            let share = (f64::from(disk.position[k]) - min) / (max - min);
            // A box may be flat.
            let share = if share.is_finite() {
                share.clamp(0.0, 1.0)
            } else {
                0.0
            };
            out.extend(((share * 65535.0).round() as u16).to_le_bytes());
        }
        let is_lvoxel = matches!(kind, GroupKind::Lvoxels(_));
        let size = if is_lvoxel {
            out.extend([point.mark, 0]);
            to_half(disk.sigma_t / self.sigma_t)
        } else {
            out.extend(octahedral(disk.normal));
            let sign = if point.mark == 0 { 1.0 } else { -1.0 };
            f16::from_f32(to_half(disk.radius / self.radius).to_f32() * sign)
        };
        out.extend(size.to_le_bytes());
        let radiance = disk.radiance.map(|v| v / self.radiance);
        out.extend(rgb9e5(radiance).to_le_bytes());
    }
}

fn to_half(v: f32) -> f16 {
    f16::from_f32(v.clamp(0.0, f16::MAX.to_f32()))
}

/// A unit vector in two bytes, 0 to 254.
fn octahedral(n: [f32; 3]) -> [u8; 2] {
    let sum: f32 = n.iter().map(|v| v.abs()).sum();
    if !(sum > 0.0 && sum.is_finite()) {
        return [255; 2];
    }
    let [x, y] = [n[0] / sum, n[1] / sum];
    let folded = |a: f32, b: f32| (1.0 - b.abs()) * 1.0_f32.copysign(a);
    let [x, y] = if n[2] < 0.0 {
        [folded(x, y), folded(y, x)]
    } else {
        [x, y]
    };
    [x, y].map(|v| ((v * 0.5 + 0.5) * 254.0).round() as u8)
}

/// Three numbers with nine bits each and one exponent, as GPUs have them.
fn rgb9e5(v: [f32; 3]) -> u32 {
    const LARGEST: f32 = 65408.0;
    let v = v.map(|c| if c > 0.0 { c.min(LARGEST) } else { 0.0 });
    let most = v.into_iter().fold(0.0, f32::max);
    let mut exponent = 0_i32;
    // The least exponent in which the largest has nine bits.
    while exponent < 31 && (most / step(exponent)).round() > 511.0 {
        exponent += 1;
    }
    let codes = v.map(|c| (c / step(exponent)).round() as u32);
    codes[0] | codes[1] << 9 | codes[2] << 18 | (exponent as u32) << 27
}

fn step(exponent: i32) -> f32 {
    2.0_f32.powi(exponent - 24)
}

/// All points of a sample in the order of its groups, and the pages that they are of: runs of a
/// difference and a count, seven bits a byte, the difference as zigzag.
pub fn points(sample: &Sample, units: &Units) -> (Vec<u8>, Vec<u8>) {
    let count: usize = sample.groups.iter().map(|g| g.points.len()).sum();
    let mut bytes = Vec::with_capacity(count * POINT_BYTES);
    let mut runs = Vec::new();
    let mut before = 0_i64;
    for group in &sample.groups {
        for point in &group.points {
            units.point(group.kind, point, &mut bytes);
        }
        for run in group.points.chunk_by(|a, b| a.page == b.page) {
            let page = i64::from(run[0].page);
            let difference = page - before;
            before = page;
            varint((difference << 1 ^ difference >> 63) as u64, &mut runs);
            varint(run.len() as u64, &mut runs);
        }
    }
    (bytes, runs)
}

fn varint(mut v: u64, out: &mut Vec<u8>) {
    while v >= 128 {
        out.push(v as u8 | 128);
        v >>= 7;
    }
    out.push(v as u8);
}

/// The groups for the script.
pub fn groups(sample: &Sample, volumes: &[VolumeInfo]) -> Vec<Value> {
    let mut groups = Vec::new();
    for group in &sample.groups {
        let mut value = json!({"count": group.points.len(), "grow": group.grow});
        match group.kind {
            GroupKind::Nodes(level) => {
                value["kind"] = "node".into();
                value["level"] = level.into();
            }
            GroupKind::Surfels => value["kind"] = "surfel".into(),
            GroupKind::Lvoxels(volume) => {
                value["kind"] = "lvoxel".into();
                value["volume"] = volume.into();
                let info = &volumes[usize::from(volume)];
                let name: String = info.name.chars().take(60).collect();
                value["name"] = name.into();
                let map = super::super::disk::SceneFromIndex::of(info);
                let ball = map.as_ref().map_or(0.0, |m| m.ball_radius(0));
                value["ball"] = ball.into();
                value["edges"] = json!(map.map_or([[0.0; 3]; 3], |m| m.edges()));
            }
        }
        groups.push(value);
    }
    groups
}

#[cfg(test)]
mod tests {
    use super::*;

    fn back(code: u32) -> [f32; 3] {
        let step = step((code >> 27) as i32);
        [0, 9, 18].map(|shift| (code >> shift & 511) as f32 * step)
    }

    #[test]
    fn colours_keep_nine_bits_of_the_largest() {
        for v in [
            [1.0, 0.5, 0.25],
            [1e-5, 3.0, 0.0],
            [65000.0, 2.0, 1.0],
            [3e-5, 2e-5, 0.0],
        ] {
            let most = v.into_iter().fold(0.0, f32::max);
            for (a, b) in v.into_iter().zip(back(rgb9e5(v))) {
                assert!((a - b).abs() <= most / 510.0, "{v:?}");
            }
        }
        assert_eq!(back(rgb9e5([f32::NAN, -1.0, 0.0])), [0.0; 3]);
        assert!(back(rgb9e5([f32::INFINITY, 0.0, 0.0]))[0] > 65000.0);
    }

    #[test]
    fn normals_come_back_within_a_degree() {
        for n in [
            [0.0, 0.0, 1.0],
            [0.0, 0.0, -1.0],
            [0.48, -0.6, 0.64],
            [-0.48, 0.6, -0.64],
        ] {
            let [x, y] = octahedral(n).map(|b| f32::from(b) / 127.0 - 1.0);
            let z = 1.0 - x.abs() - y.abs();
            let t = (-z).max(0.0);
            let v = [x - t.copysign(x), y - t.copysign(y), z];
            let len = v.iter().map(|c| c * c).sum::<f32>().sqrt();
            let dot: f32 = (0..3).map(|k| v[k] * n[k]).sum();
            assert!(dot / len > 0.9998, "{n:?} {v:?}");
        }
        assert_eq!(octahedral([0.0; 3]), [255; 2]);
    }
}

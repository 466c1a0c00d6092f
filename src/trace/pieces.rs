//! How densely surfels stand on the pieces of a scene: triangles of one material are a piece.

use crate::scene::{Material, Scene};

/// Samples per area of each piece, over what they would be if samples went by area alone.
///
/// They do, but for pieces so large that they would leave next to nothing for all others together:
/// a ground of any size leaves a room on it a tenth of the samples.
#[derive(Clone, Debug, PartialEq)]
pub struct Pieces {
    density: Vec<f64>,
    /// Area of a sample over the mean; none of black pieces.
    area_over_mean: Vec<Option<f32>>,
}

impl Pieces {
    /// Largest share of the samples that are left that a piece may take. Pieces get samples from
    /// the largest down, and each leaves some for the smaller ones.
    const MAX_SHARE: f64 = 0.9;
    /// Largest share of a piece that reflects nothing: it stops rays, and no more is to be known of
    /// it.
    const MAX_BLACK_SHARE: f64 = 0.5;
    /// Share of all samples below which what remains goes by area alone: most scenes have some tiny
    /// pieces.
    const MIN_SHARED: f64 = 0.05;

    /// The pieces of a scene.
    #[must_use]
    pub fn new(scene: &Scene) -> Self {
        let areas = Self::areas(scene);
        let mut order: Vec<usize> = (0..areas.len()).filter(|&m| areas[m] > 0.0).collect();
        order.sort_by(|&a, &b| areas[b].total_cmp(&areas[a]));
        let area: f64 = areas.iter().sum();
        let mut density = vec![1.0; areas.len()];
        // Area of each piece and all smaller ones; exactly none behind the last.
        let mut of_rest = vec![0.0; order.len() + 1];
        for (i, &m) in order.iter().enumerate().rev() {
            of_rest[i] = of_rest[i + 1] + areas[m];
        }
        // What the samples of the pieces from here on are over what they were by area.
        let mut factor = 1.0;
        for (i, &m) in order.iter().enumerate() {
            density[m] = factor;
            let (left, rest) = (of_rest[i], of_rest[i + 1]);
            if left * factor < Self::MIN_SHARED * area {
                continue;
            }
            let is_black = scene.materials[m].albedo == [0.0; 3];
            let most = if is_black {
                Self::MAX_BLACK_SHARE
            } else {
                Self::MAX_SHARE
            };
            if areas[m] > most * left && rest > 0.0 {
                density[m] = factor * most * left / areas[m];
                factor *= (1.0 - most) * left / rest;
            }
        }
        let weighted: f64 = areas.iter().zip(&density).map(|(a, d)| a * d).sum();
        let over_mean = |(d, material): (&f64, &Material)| {
            (material.albedo != [0.0; 3]).then_some((weighted / area / d) as f32)
        };
        let area_over_mean = density.iter().zip(&scene.materials).map(over_mean);
        Self {
            area_over_mean: area_over_mean.collect(),
            density,
        }
    }

    /// Areas of all pieces; those that a packed scene has are not summed up again.
    #[must_use]
    pub fn areas(scene: &Scene) -> Vec<f64> {
        if let Some(packed) = scene.as_packed() {
            return packed.file().meta().areas.clone();
        }
        scene.mesh.areas(scene.materials.len())
    }

    /// Samples per area on a material, over those by area alone.
    #[must_use]
    pub fn density(&self, material: u32) -> f64 {
        self.density.get(material as usize).copied().unwrap_or(1.0)
    }

    /// Area that a sample stands for on a material, over the mean of all samples; `None` if it
    /// reflects nothing.
    #[must_use]
    #[inline]
    pub fn area_over_mean(&self, material: u32) -> Option<f32> {
        self.area_over_mean[material as usize]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;

    /// Squares of these edges and albedos.
    fn scene(squares: &[(f32, f32)]) -> Scene {
        let mut scene = Scene::without_picture();
        for (m, &(edge, albedo)) in squares.iter().enumerate() {
            let first = scene.mesh.positions.len() as u32;
            let corners = [Vec3::ZERO, Vec3::X, Vec3::ONE - Vec3::Z, Vec3::Y];
            scene.mesh.positions.extend(corners.map(|c| c * edge));
            for t in [[0, 1, 2], [0, 2, 3]] {
                scene.mesh.triangles.push(t.map(|v| v + first));
                scene.mesh.material.push(m as u32);
            }
            scene.materials.push(Material::diffuse("", [albedo; 3]));
        }
        scene
    }

    /// Shares of all samples, which what a sample stands for tells, too.
    fn shares(squares: &[(f32, f32)]) -> Vec<f64> {
        let pieces = Pieces::new(&scene(squares));
        let areas = squares.iter().map(|&(edge, _)| f64::from(edge).powi(2));
        let all: f64 = areas.clone().sum();
        let of = |(m, area): (usize, f64)| {
            let over_mean = pieces.area_over_mean(m as u32);
            assert_eq!(over_mean.is_none(), squares[m].1 == 0.0);
            let share = area * pieces.density(m as u32) / all;
            assert!(
                over_mean.is_none_or(|o| (area / all / f64::from(o) / share - 1.0).abs() < 1e-6)
            );
            share
        };
        areas.enumerate().map(of).collect()
    }

    #[test]
    fn a_huge_piece_leaves_some_for_all_others() {
        let near = |got: Vec<f64>, expected: &[f64]| {
            for (g, e) in got.iter().zip(expected) {
                assert!((g / e - 1.0).abs() < 1e-6, "{got:?} {expected:?}");
            }
        };
        // By area: none is huge, or one is tiny.
        near(
            shares(&[(2.0, 0.5), (1.0, 0.5), (1.0, 0.0)]),
            &[4.0 / 6.0, 1.0 / 6.0, 1.0 / 6.0],
        );
        assert!(
            Pieces::new(&scene(&[(2.0, 0.5), (1.0, 0.5), (1.0, 0.0)]))
                .density
                .iter()
                .all(|&d| d == 1.0)
        );
        near(
            shares(&[(1e4, 0.5), (1.0, 0.5), (3.0, 0.5)]),
            &[0.9, 0.01, 0.09],
        );
        near(
            shares(&[(1.0, 0.5), (1e5, 0.0), (1.0, 0.5)]),
            &[0.25, 0.5, 0.25],
        );
        near(
            shares(&[(1e3, 0.5), (1e6, 0.5), (1.0, 0.5), (1.0, 0.5)]),
            &[0.09, 0.9, 0.005, 0.005],
        );
        // Alone, and nothing at all.
        near(shares(&[(7.0, 0.0)]), &[1.0]);
        assert!(shares(&[]).is_empty());
    }
}

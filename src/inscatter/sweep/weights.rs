//! What of the light from each direction of a sweep a medium scatters towards the camera.
//!
//! Directions are few and lobes are narrow: what counts is the mean of the phase function over the
//! part of the sphere that a direction stands for. So weights are never negative, and those of all
//! directions add up to what an isotropic medium has. Such means are wider than the phase function:
//! they are of a narrower one, so that they have its mean cosine.

use crate::inscatter::far_field::FarField;
use crate::math::{PhaseFunction, SeenPhase, sampling};
use crate::view::View;
use glam::Vec3;
use std::f32::consts::PI;

/// Means of a phase function over quarters of cells of the far field, by where the camera looks.
/// Quarters of a row differ by their angle around the axis alone.
#[derive(Debug)]
pub struct ScatteringWeights {
    phase: PhaseFunction,
    rows: usize,
    columns: usize,
    /// By angle of the look from the axis, row, and angle around the axis from the quarter.
    means: Vec<f32>,
}

/// A look at a vertex.
#[derive(Clone, Copy, Debug, Default)]
pub struct Look {
    /// Angle from the axis, in steps.
    from_axis: f32,
    /// Turns around it.
    turns: f32,
    /// What makes the weights of all directions 1 on average.
    scale: f32,
}

impl ScatteringWeights {
    /// Steps of half a turn, from the axis and around it.
    const STEPS: usize = 32;
    /// Points along each side of a quarter.
    const POINTS: usize = 4;

    /// Those of a volume, or none if it scatters alike in all directions.
    pub fn new(phase: PhaseFunction, field: &FarField) -> Option<Self> {
        let narrower = Self::sharpened(phase, field.rows_and_columns());
        Self::of_means(phase, narrower, field)
    }

    /// The same as means of the phase function itself, not of a narrower one, which has less light
    /// scatter to the sides and back: where light comes from all sides, and for what leaves a
    /// medium after it has scattered once.
    pub fn unsharpened(phase: PhaseFunction, field: &FarField) -> Option<Self> {
        Self::of_means(phase, phase, field)
    }

    /// Mean cosine of the phase function.
    pub fn mean_cosine(&self) -> f32 {
        self.phase.moment(1)
    }

    /// Those of a phase function, that are the means of this one.
    fn of_means(phase: PhaseFunction, of: PhaseFunction, field: &FarField) -> Option<Self> {
        if phase.is_isotropic() {
            return None;
        }
        let [rows, columns] = field.rows_and_columns();
        let along = Self::STEPS + 1;
        let mut means = Vec::with_capacity(along * rows * along);
        for i in 0..along {
            let angle = PI * i as f32 / Self::STEPS as f32;
            let look = Vec3::new(libm::sinf(angle), 0.0, libm::cosf(angle));
            // None of it is isotropic.
            let seen = SeenPhase::of(of, look)?;
            for row in 0..rows {
                for around in 0..along {
                    let turns = 0.5 * around as f32 / Self::STEPS as f32;
                    let points = Self::points([rows, columns], row, turns);
                    let sum: f32 = points.map(|p| seen.response(p)).sum();
                    means.push(sum / (Self::POINTS * Self::POINTS) as f32);
                }
            }
        }
        Some(Self {
            phase,
            rows,
            columns,
            means,
        })
    }

    /// Directions all over a quarter of a row whose middle is so many turns around the axis.
    fn points([rows, columns]: [usize; 2], row: usize, turns: f32) -> impl Iterator<Item = Vec3> {
        (0..Self::POINTS * Self::POINTS).map(move |k| {
            let [u, v] = [k % Self::POINTS, k / Self::POINTS]
                .map(|c| (c as f32 + 0.5) / Self::POINTS as f32);
            sampling::sphere([
                (row as f32 + u) / rows as f32,
                turns + (v - 0.5) / columns as f32,
            ])
        })
    }

    /// What has the mean cosine of a phase function once it is spread over quarters.
    fn sharpened(phase: PhaseFunction, [rows, columns]: [usize; 2]) -> PhaseFunction {
        // The mean direction of a quarter is shorter than 1 by as much as spreading takes.
        let length = |row| {
            let sum: Vec3 = Self::points([rows, columns], row, 0.0).sum();
            sum.length() / (Self::POINTS * Self::POINTS) as f32
        };
        let kept = (0..rows).map(length).sum::<f32>() / rows as f32;
        let sharper = |g: f32| (g / kept).clamp(-PhaseFunction::MAX_G, PhaseFunction::MAX_G);
        PhaseFunction::two_lobes(phase.lobes().map(sharper), phase.mix())
    }

    /// The look of the camera at a point of the scene.
    pub fn look(&self, view: &View, point: Vec3) -> Option<Look> {
        Some(self.look_along(view.seen(self.phase, point)?.direction()))
    }

    /// The look along a unit direction.
    pub fn look_along(&self, direction: Vec3) -> Look {
        let [_, turns] = sampling::square_from_sphere(direction);
        let mut look = Look {
            from_axis: libm::acosf(direction.z.clamp(-1.0, 1.0)) / PI * Self::STEPS as f32,
            turns,
            scale: 1.0,
        };
        let all = (0..self.rows).flat_map(|row| (0..self.columns).map(move |c| [row, c]));
        let sum: f32 = all.map(|at| self.weight(&look, at)).sum();
        look.scale = (self.rows * self.columns) as f32 / sum;
        look
    }

    /// The weight of the quarter in a row and a column, over that of an isotropic medium.
    #[inline]
    pub fn weight(&self, look: &Look, [row, column]: [usize; 2]) -> f32 {
        let along = Self::STEPS + 1;
        let middle = (column as f32 + 0.5) / self.columns as f32;
        let apart = (look.turns - middle).abs();
        let apart = apart.min(1.0 - apart).max(0.0) * (2 * Self::STEPS) as f32;
        let cell = |at: f32| {
            let first = (at as usize).min(Self::STEPS - 1);
            (first, at - first as f32)
        };
        let ((i, f), (k, g)) = (cell(look.from_axis), cell(apart));
        let line = |i: usize| {
            let at = (i * self.rows + row) * along + k;
            self.means[at] * (1.0 - g) + self.means[at + 1] * g
        };
        (line(i) * (1.0 - f) + line(i + 1) * f) * look.scale
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Camera, Film, Grid, Scene, Volume};
    use crate::trace::Tracer;
    use glam::{Affine3A, DAffine3};

    #[test]
    fn weights_keep_energy_and_follow_the_lobe() {
        let grid = Grid::from_fn([16; 3], |_| 1.0);
        let volume = Volume::new("cube".into(), grid, [0.9; 3], DAffine3::IDENTITY);
        let camera = Camera {
            name: String::new(),
            scene_from_camera: Affine3A::IDENTITY,
            fov_x_rad: 1.0,
            keys: Vec::new(),
            lens: None,
            shutter: None,
            path: Vec::new(),
        };
        let film = Film {
            width: 10,
            height: 10,
            exposure: 1.0,
        };
        let scene = Scene::empty(camera, film);
        let tracer = Tracer::new(&scene);
        let view = View::new(&tracer, &scene.cameras[0], scene.film, 0);
        for g in [-0.4, 0.3, 0.75, 0.9] {
            let phase = PhaseFunction::henyey_greenstein(g);
            let field = FarField::new(&volume, 16, 0);
            let weights = ScatteringWeights::new(phase, &field).unwrap();
            let mut off = 0.0;
            for i in 0..50 {
                let point = 5.0 * sampling::sphere(sampling::r2(i, [0.2; 2]));
                let look = weights.look(&view, point).unwrap();
                // Points see a narrow lobe badly; the scale makes up for it.
                assert!((look.scale - 1.0).abs() < 0.2, "{g}: {}", look.scale);
                let (mut sum, mut mean) = (0.0, Vec3::ZERO);
                for quarter in 0..field.quarters() {
                    let weight = weights.weight(&look, field.row_and_column(quarter));
                    assert!(weight >= 0.0);
                    sum += weight;
                    mean += field.direction(quarter) * weight;
                }
                let count = field.quarters() as f32;
                assert!((sum / count - 1.0).abs() < 1e-5);
                let cos = mean.dot(point.normalize()) / count;
                // Quarters are some 25 degrees wide: looks at their middle and between them
                // differ, but not on average.
                assert!((cos - g).abs() < 0.07, "{g}: {cos}");
                off += cos - g;
            }
            assert!((off / 50.0).abs() < 0.01, "{g}: {off}");
        }
        let isotropic = PhaseFunction::ISOTROPIC;
        assert!(ScatteringWeights::new(isotropic, &FarField::new(&volume, 16, 0)).is_none());
    }

    /// Of what scatters twice, the lobe of which has the square of the mean cosine (Henyey &
    /// Greenstein), about as much is sent back as should be, wherever light comes from and the
    /// camera is: lobes at 24 directions, not means around them, would have it differ by a third.
    #[test]
    fn light_that_scatters_twice_goes_where_it_should() {
        let grid = Grid::from_fn([16; 3], |_| 1.0);
        let volume = Volume::new("cube".into(), grid, [0.9; 3], DAffine3::IDENTITY);
        for g in [0.5_f32, 0.75, 0.85] {
            let phase = PhaseFunction::henyey_greenstein(g);
            let twice = PhaseFunction::henyey_greenstein(g * g);
            let field = FarField::new(&volume, 6, 0);
            let once = ScatteringWeights::unsharpened(phase, &field).unwrap();
            let (mut sum, mut squares, mut count) = (0.0, 0.0, 0.0);
            for i in 0..400 {
                let ahead = sampling::sphere(sampling::r2(2 * i, [0.3; 2]));
                let look = sampling::sphere(sampling::r2(2 * i + 1, [0.7; 2]));
                let cos = -look.dot(ahead);
                if cos > 0.0 {
                    continue;
                }
                let (seen, sent) = (once.look_along(look), once.look_along(-ahead));
                let quarters = (0..field.quarters()).map(|q| field.row_and_column(q));
                let light: f32 = quarters
                    .map(|at| once.weight(&seen, at) * once.weight(&sent, at))
                    .sum();
                let off = light / field.quarters() as f32 / twice.over_isotropic(cos) - 1.0;
                sum += off;
                squares += off * off;
                count += 1.0;
            }
            let (mean, rms) = (sum / count, (squares / count).sqrt());
            assert!(mean.abs() < 0.2 && rms < 0.25, "{g}: {mean} {rms}");
        }
    }
}

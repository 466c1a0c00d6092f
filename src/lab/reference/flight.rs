//! What media do to a ray: where it collides, by null-collision tracking (Woodcock et al. 1965),
//! and what share of it gets through, by ratio tracking (Novák, Selle & Jarosz 2014).
//!
//! The majorant is that of each brick of the grid, so empty bricks cost one step and thin ones few.
//! Media that overlap are tracked one by one: of independent Poisson processes the earliest event
//! is the event of their sum, and transmittances multiply.
//!
//! Where extinction has a colour, tentative collisions are those of the channel that has most. The
//! mean over the channels, each by what the path carries in it, decides whether one is real: Kutz
//! et al. 2017, history-aware spectral tracking. It is the balance heuristic between tracking by
//! red, by green and by blue, which Miller, Georgiev & Jarosz 2019 derive as spectral MIS: what a
//! path carries changes colour, and its sum over the channels stays the same.

use super::sampler::Sampler;
use crate::math::dda::{Passage, Steps};
use crate::math::{Ray, Rgb};
use crate::scene::Volume;
use crate::scene::grid::BRICK_CELLS;

/// A collision with a medium.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Collision {
    /// Distance along the ray, scene units.
    pub t: f32,
    /// Index of the volume.
    pub volume: usize,
}

/// The first collision along a ray. `first` in [0,1) decides on the first
/// tentative flight. `throughput`, some channel of which is more than 0, becomes what the path
/// carries after the flight: it changes where extinction has a colour.
///
/// Its mean over the flights that get beyond a point is what the medium leaves of it there, so it
/// also weighs what the path gathers before the collision.
#[must_use]
pub fn collide(
    volumes: &[Volume],
    ray: &Ray,
    first: f32,
    throughput: &mut Rgb,
    sampler: &mut Sampler,
) -> Option<Collision> {
    let mut found: Option<Collision> = None;
    for (i, volume) in volumes.iter().enumerate() {
        let limit = found.map_or(ray.t_max, |c| c.t);
        let u = if i == 0 { first } else { sampler.uniform() };
        let ray = ray.up_to(limit);
        if volume.is_grey() {
            track(volume, &ray, u, sampler, |t, share, s| {
                let collides = s.uniform() < share;
                if collides {
                    found = Some(Collision { t, volume: i });
                }
                !collides
            });
        } else {
            let color = Rgb(volume.extinction_color);
            track(volume, &ray, u, sampler, |t, share, s| {
                let collides = is_real(color, share, s.uniform(), throughput);
                if collides {
                    found = Some(Collision { t, volume: i });
                }
                !collides
            });
        }
    }
    found
}

/// Decides by `u` in [0,1) whether a tentative collision with a medium of that extinction by
/// channel is real, and weighs the throughput by the decision. Its sum stays the same.
#[inline]
fn is_real(color: Rgb, share: f32, u: f32, throughput: &mut Rgb) -> bool {
    let sum = |Rgb([r, g, b]): Rgb| r + g + b;
    let mean = sum(*throughput * color) / sum(*throughput).max(f32::MIN_POSITIVE);
    let chance = share * mean;
    let collides = u < chance;
    let weight = |c: f32| match collides {
        true => c / mean,
        false => (1.0 - share * c) / (1.0 - chance),
    };
    *throughput = *throughput * Rgb(color.0.map(weight));
    collides
}

/// Below this a walk of a transmittance goes on by chance only, with the next value if it does.
const LOW: f32 = 0.1;
const RAISED: f32 = 0.2;

/// An estimate, without bias, of the share of light that media let through along a ray, by channel.
#[must_use]
pub fn transmittance(volumes: &[Volume], ray: &Ray, sampler: &mut Sampler) -> Rgb {
    if volumes.iter().all(Volume::is_grey) {
        return Rgb::splat(grey_transmittance(volumes, ray, sampler));
    }
    let mut through = Rgb::splat(1.0);
    for volume in volumes {
        let color = Rgb(volume.extinction_color);
        let u = sampler.uniform();
        track(volume, ray, u, sampler, |_, share, s| {
            through = through * Rgb(color.0.map(|c| 1.0 - share * c));
            let most = through.max();
            if most < LOW {
                through = if s.uniform() * RAISED < most {
                    through * (RAISED / most)
                } else {
                    Rgb::BLACK
                };
            }
            !through.is_black()
        });
        if through.is_black() {
            break;
        }
    }
    through
}

fn grey_transmittance(volumes: &[Volume], ray: &Ray, sampler: &mut Sampler) -> f32 {
    let mut through = 1.0_f32;
    for volume in volumes {
        let u = sampler.uniform();
        track(volume, ray, u, sampler, |_, share, s| {
            through *= 1.0 - share;
            if through < LOW {
                through = if s.uniform() * RAISED < through {
                    RAISED
                } else {
                    0.0
                };
            }
            through > 0.0
        });
        if through <= 0.0 {
            break;
        }
    }
    through
}

/// Optical depth to a tentative collision, for a number in [0,1).
fn depth(u: f32) -> f32 {
    -libm::log1pf(-u)
}

/// Visits the tentative collisions along a ray, front to back: `visit(t, share, sampler)` with the
/// extinction's share in the majorant, until that says no.
#[inline]
fn track(
    volume: &Volume,
    ray: &Ray,
    first: f32,
    sampler: &mut Sampler,
    mut visit: impl FnMut(f32, f32, &mut Sampler) -> bool,
) {
    let grid = &volume.sigma_t;
    let map = (&volume.index_from_scene, &volume.index_from_scene_f64);
    let dims = grid.dims().map(|n| n as f32);
    let Some(passage) = Passage::new(map, dims, ray) else {
        return;
    };
    let Passage { line, start, end } = passage.in_cells();
    let limit = grid.brick_dims().map(|n| n as i32);
    let mut bricks = Steps::new(&line, 0.0, [0; 3], BRICK_CELLS as f32, limit);
    let mut t = 0.0_f32;
    let mut left = depth(first);
    loop {
        let at = bricks.at();
        let leave = bricks.leave().min(end);
        let inside = bricks.advance();
        if let Some(brick) = grid.brick(at.map(|v| v as usize)) {
            let base = at.map(|v| v * BRICK_CELLS as i32);
            while t < leave {
                let next = t + left / brick.max;
                if next >= leave {
                    // What was not used up goes on at the next brick's majorant.
                    left = (left - brick.max * (leave - t)).max(0.0);
                    break;
                }
                t = next;
                let mut cell = [0; 3];
                let mut f = [0.0; 3];
                for a in 0..3 {
                    let p = line.origin[a] + line.direction[a] * t - base[a] as f32;
                    cell[a] = (p as usize).min(BRICK_CELLS - 1);
                    f[a] = (p - cell[a] as f32).clamp(0.0, 1.0);
                }
                let share = (brick.cell::<true>(cell).value(f.into()) / brick.max).min(1.0);
                if !visit(start + t, share, sampler) {
                    return;
                }
                left = depth(sampler.uniform());
            }
        }
        t = t.max(leave);
        if leave >= end || !inside {
            return;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::sampling;
    use crate::scene::{Grid, Volume};
    use glam::{DAffine3, DQuat, DVec3, Vec3};

    fn volume(grid: Grid, scene_from_index: DAffine3) -> Volume {
        Volume::new("test".into(), grid, [0.5; 3], scene_from_index)
    }

    fn bumpy(scale: f32) -> Volume {
        let grid = Grid::from_fn([21, 17, 40], |[i, j, k]| {
            let v = sampling::unit(sampling::hash(&[i as u64, j as u64, k as u64]));
            if v < 0.4 || (10..20).contains(&k) {
                0.0
            } else {
                scale * v
            }
        });
        let placement = DAffine3::from_scale_rotation_translation(
            DVec3::splat(0.05),
            DQuat::from_rotation_y(0.7) * DQuat::from_rotation_x(-0.4),
            DVec3::new(0.3, -0.1, 0.2),
        );
        volume(grid, placement)
    }

    fn depth_by_steps(volumes: &[Volume], o: Vec3, d: Vec3, t_max: f32) -> f64 {
        let steps = 20_000;
        let dt = t_max / steps as f32;
        (0..steps)
            .map(|s| {
                let p = o + d * ((s as f32 + 0.5) * dt);
                volumes
                    .iter()
                    .map(|v| f64::from(v.sigma_t.sample(v.index_from_scene.transform_point3(p))))
                    .sum::<f64>()
                    * f64::from(dt)
            })
            .sum()
    }

    #[test]
    fn survival_is_the_transmittance_even_where_media_overlap() {
        let volumes = [bumpy(6.0), bumpy(9.0)];
        let centre = volumes[0]
            .scene_from_index
            .transform_point3(DVec3::new(10.0, 8.0, 20.0))
            .as_vec3();
        for i in 0..12 {
            let o = centre + sampling::sphere(sampling::r2(i, [0.1; 2])) * 3.0;
            let target = centre + sampling::sphere(sampling::r2(i, [0.6; 2])) * 0.2;
            let d = (target - o).normalize();
            for t_max in [3.2_f32, 20.0] {
                let expected = (-depth_by_steps(&volumes, o, d, t_max.min(6.0))).exp();
                let n = 20_000;
                let (mut passed, mut through) = (0, 0.0);
                for k in 0..n {
                    let mut sampler = Sampler::new(i, k);
                    let first = sampler.next4()[0];
                    let mut white = Rgb::splat(1.0);
                    let ray = Ray::new(o, d, t_max);
                    match collide(&volumes, &ray, first, &mut white, &mut sampler) {
                        None => passed += 1,
                        Some(c) => assert!(c.t >= 0.0 && c.t <= t_max),
                    }
                    let Rgb([red, ..]) = transmittance(&volumes, &ray, &mut sampler);
                    through += f64::from(red);
                }
                let through = through / f64::from(n);
                let got = f64::from(passed) / f64::from(n);
                let sigma = (expected * (1.0 - expected) / f64::from(n)).sqrt() + 1e-4;
                assert!(
                    (got - expected).abs() < 4.0 * sigma,
                    "ray {i} to {t_max}: {got} against {expected}"
                );
                // Ratio tracking is less noisy than that.
                assert!(
                    (through - expected).abs() < 4.0 * sigma,
                    "ray {i} to {t_max}: {through} against {expected}"
                );
            }
        }
    }

    #[test]
    fn collisions_in_a_constant_medium_are_exponential() {
        let v = [volume(
            Grid::from_fn([1, 1, 30], |_| 2.0),
            DAffine3::IDENTITY,
        )];
        let n = 50_000;
        let (mut sum, mut squares) = (0.0, 0.0);
        for k in 0..n {
            let mut sampler = Sampler::new(9, k);
            let first = sampler.next4()[0];
            let o = Vec3::new(0.5, 0.5, -1.0);
            let ray = Ray::endless(o, Vec3::Z);
            let c = collide(&v, &ray, first, &mut Rgb::splat(1.0), &mut sampler).unwrap();
            let t = f64::from(c.t - 1.0);
            sum += t;
            squares += t * t;
        }
        let n = f64::from(n);
        assert!((sum / n - 0.5).abs() < 0.01, "{}", sum / n);
        assert!((squares / n - 0.5).abs() < 0.02, "{}", squares / n);
    }
}

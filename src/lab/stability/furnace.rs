//! Radiance 1 from everywhere, of an environment or of the walls of a closed box, around a medium
//! that absorbs nothing or all.
//!
//! lvox follows light through at most two scatterings (direct light, and one bounce): what is known
//! is the share of all paths that reach a wall by then, which a walk in f64 finds.

use super::row::Row;
use super::workbench::{Workbench, add_room, mean, pixels, stage, unit_cube, volume};
use crate::Result;
use crate::math::PhaseFunction;
use crate::math::sampling::{hash, unit};
use crate::scene::{Grid, Light, Scene, Volume};
use crate::shade::Settings;
use glam::{DVec3, Vec3};
use rayon::prelude::*;

/// Half the edge of the walls' box; that of the medium is 0.5.
const WALLS: f32 = 0.6;
const EYE: Vec3 = Vec3::new(0.03, 0.02, 0.58);

/// Paths of a walk: its own noise is 0.1 %.
const PATHS: u64 = 400_000;

pub fn rows(bench: &Workbench) -> Result<Vec<Row>> {
    let mut rows = Vec::new();
    // The bias that is stated.
    for (around, limits) in [
        (
            Around::Environment,
            [1e-4, 1e-4, 1e-3, 0.04, 0.05, 0.03, 0.03],
        ),
        (Around::Walls, [1e-4, 1e-4, 2e-3, 0.03, 0.03, 0.03, 0.03]),
    ] {
        let name = around.name();
        for (tau, limit) in [1e-3, 1e-2, 0.1, 1.0, 10.0, 100.0, 1e4]
            .into_iter()
            .zip(limits)
        {
            white(bench, around, tau, limit, &mut rows)?;
        }
        for tau in [1e-3, 0.1, 1.0] {
            let at = format!("tau {tau:e}");
            let black = mean(&picture(bench, around, tau, 0.0, Transport::Once)?);
            rows.push(Row::relative(
                format!("{name}, albedo 0: mean of all pixels"),
                at.clone(),
                absorbed(tau),
                black,
                // Pixels take few samples at the border of the medium.
                1e-5 + 0.02 * tau,
            ));
            let white = mean(&picture(bench, around, tau, 1.0, Transport::Once)?);
            let nearly = mean(&picture(bench, around, tau, 1.0 - 1e-7, Transport::Once)?);
            let case = format!("{name}, albedo 1 - 1e-7 against 1");
            rows.push(Row::relative(case, at, white, nearly, 1e-6));
        }
    }
    for (rho, limit) in [(0.5, 0.002), (0.8, 0.005), (0.9, 0.01), (0.99, 0.05)] {
        let mut scene = stage(8, EYE, Vec3::ZERO, 90.0);
        add_room(&mut scene, 2.0 * WALLS, rho as f32, 1.0);
        let store = bench.bounced(&scene, bench.tree(&scene, 60_000)?)?;
        rows.push(Row::relative(
            "no medium, walls of albedo rho that emit 1, all bounces: 1 / (1 - rho)",
            format!("rho {rho}"),
            1.0 / (1.0 - rho),
            mean(&pixels(&bench.shade(&scene, &store, &settings())?, "")?),
            limit,
        ));
    }
    for (tau, limit) in [(0.1, 0.002), (1.0, 0.015), (10.0, 0.08)] {
        let picture = picture(bench, Around::Environment, tau, 1.0, Transport::All)?;
        rows.push(Row::relative(
            "environment, albedo 1, all scatterings: mean of all pixels",
            format!("tau {tau:e}"),
            1.0,
            mean(&picture),
            limit,
        ));
    }
    for rho in [0.0, 0.5, 1.0] {
        // Emission, its reflection, and one bounce.
        let mut scene = stage(8, EYE, Vec3::ZERO, 90.0);
        add_room(&mut scene, 2.0 * WALLS, rho, 1.0);
        let picture = bench.render(&scene, 60_000, &settings())?;
        let rho = f64::from(rho);
        rows.push(Row::relative(
            "no medium, walls of albedo rho that emit 1: 1 + rho + rho^2",
            format!("rho {rho}"),
            1.0 + rho + rho * rho,
            mean(&picture),
            0.03,
        ));
    }
    Ok(rows)
}

/// Adds rows about a medium that absorbs nothing.
fn white(
    bench: &Workbench,
    around: Around,
    tau: f64,
    limit: f64,
    rows: &mut Vec<Row>,
) -> Result<()> {
    let name = around.name();
    let picture = picture(bench, around, tau, 1.0, Transport::Once)?;
    let at = format!("tau {tau:e}");
    let brightest = picture.iter().flatten().fold(0.0_f32, |a, &b| a.max(b));
    let darkest = picture
        .iter()
        .flatten()
        .fold(f32::INFINITY, |a, &b| a.min(b));
    rows.push(Row::relative(
        format!("{name}, albedo 1: mean of all pixels, against two scatterings"),
        at.clone(),
        seen(tau, PhaseFunction::ISOTROPIC),
        mean(&picture),
        limit,
    ));
    if tau <= 0.1 {
        // What is scattered three times or more is of the order of tau^3.
        rows.push(Row::relative(
            format!("{name}, albedo 1: darkest pixel"),
            at.clone(),
            1.0,
            darkest.into(),
            0.1 * tau + 1e-5,
        ));
    }
    // Rays find what arrives through the medium, with noise of the order of what it takes.
    rows.push(Row::nothing(
        format!("{name}, albedo 1: energy that the brightest pixel gains"),
        at.clone(),
        (f64::from(brightest) - 1.0).max(0.0),
        0.05 * tau.min(0.1) + 1e-5,
    ));
    rows.push(Row::nothing(
        format!("{name}, albedo 1: energy that all pixels gain together"),
        at,
        (mean(&picture) - 1.0).max(0.0),
        1e-6,
    ));
    Ok(())
}

/// Many shadow rays: lights this near make few of them dark.
fn settings() -> Settings {
    Settings {
        samples: 64,
        volume_samples: 32,
        shadow_rays: 64,
        pixel_samples: 4,
        edge_samples: 4,
        ..Settings::default()
    }
}

/// What shines.
#[derive(Clone, Copy, PartialEq)]
enum Around {
    Environment,
    Walls,
}

impl Around {
    fn name(self) -> &'static str {
        match self {
            Self::Environment => "environment",
            Self::Walls => "glowing walls",
        }
    }
}

/// Whether a tree sends light that was scattered once, or all orders of it.
#[derive(Clone, Copy, PartialEq)]
pub enum Transport {
    Once,
    All,
}

fn picture(
    bench: &Workbench,
    around: Around,
    tau: f64,
    albedo: f32,
    transport: Transport,
) -> Result<Vec<[f32; 3]>> {
    let mut scene: Scene = stage(8, EYE, Vec3::ZERO, 60.0);
    if around == Around::Walls {
        add_room(&mut scene, 2.0 * WALLS, 0.0, 1.0);
    } else {
        scene.lights.push(Light::Environment { radiance: [1.0; 3] });
    }
    scene.volumes.push(medium(tau, albedo));
    let mut store = bench.tree(&scene, 100)?;
    if transport == Transport::All {
        store = bench.bounced(&scene, store)?;
    }
    pixels(&bench.shade(&scene, &store, &settings())?, "")
}

fn medium(tau: f64, albedo: f32) -> Volume {
    let grid = Grid::from_fn([16; 3], |_| tau as f32);
    volume(grid, albedo, unit_cube([16; 3]))
}

/// The picture of a medium of albedo 1 in an environment of radiance 1.
pub fn white_picture(
    bench: &Workbench,
    tau: f64,
    phase: PhaseFunction,
    transport: Transport,
) -> Result<Vec<[f32; 3]>> {
    let mut scene: Scene = stage(8, EYE, Vec3::ZERO, 60.0);
    scene.lights.push(Light::Environment { radiance: [1.0; 3] });
    scene.volumes.push(medium(tau, 1.0).with_phase(phase));
    let mut store = bench.tree(&scene, 100)?;
    if transport == Transport::All {
        store = bench.bounced(&scene, store)?;
    }
    pixels(&bench.shade(&scene, &store, &settings())?, "")
}

/// Share of the paths from the camera that leave a medium of albedo 1 after at most two
/// scatterings, by a walk.
pub fn seen(sigma_t: f64, phase: PhaseFunction) -> f64 {
    let chunks = 64;
    let left: Vec<u64> = (0..chunks)
        .into_par_iter()
        .map(|chunk| {
            let mut random = Random(hash(&[5, chunk]));
            (0..PATHS / chunks)
                .map(|_| u64::from(leaves(sigma_t, phase, &mut random)))
                .sum()
        })
        .collect();
    left.iter().sum::<u64>() as f64 / (PATHS / chunks * chunks) as f64
}

/// Mean transmittance of the picture.
fn absorbed(sigma_t: f64) -> f64 {
    const STEPS: usize = 400;
    let at = |k: usize| 2.0 * (k as f64 + 0.5) / STEPS as f64 - 1.0;
    let sum: f64 = (0..STEPS * STEPS)
        .map(|i| {
            let (near, far) = inside(EYE.as_dvec3(), view(at(i % STEPS), at(i / STEPS)));
            (-sigma_t * (far - near).max(0.0)).exp()
        })
        .sum();
    sum / (STEPS * STEPS) as f64
}

/// Direction at a place of the film, from -1 to 1 both ways: a field of view of 60 degrees.
fn view(x: f64, y: f64) -> DVec3 {
    let half = 30.0_f64.to_radians().tan();
    let back = EYE.as_dvec3().normalize();
    let right = DVec3::Y.cross(back).normalize();
    (right * (x * half) + back.cross(right) * (y * half) - back).normalize()
}

/// Where a ray is inside the medium.
fn inside(point: DVec3, direction: DVec3) -> (f64, f64) {
    let (mut near, mut far) = (0.0_f64, f64::INFINITY);
    for a in 0..3 {
        let (t0, t1) = (
            (-0.5 - point[a]) / direction[a],
            (0.5 - point[a]) / direction[a],
        );
        near = near.max(t0.min(t1));
        far = far.min(t0.max(t1));
    }
    (near, far)
}

struct Random(u64);

impl Random {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(1);
        let bits = hash(&[self.0]);
        f64::from(unit(bits)) + f64::from(unit(bits << 24)) / f64::from(1 << 24)
    }
}

/// Whether a path through a random place of the film is out of the medium before its third
/// scattering.
fn leaves(sigma_t: f64, phase: PhaseFunction, random: &mut Random) -> bool {
    let mut point = EYE.as_dvec3();
    let mut direction = view(2.0 * random.next() - 1.0, 2.0 * random.next() - 1.0);
    for _ in 0..3 {
        let (near, far) = inside(point, direction);
        let free = near - (1.0 - random.next()).ln() / sigma_t;
        if near >= far || free >= far {
            return true;
        }
        point += direction * free;
        if !phase.is_isotropic() {
            let u = [random.next() as f32, random.next() as f32];
            direction = phase.sample(direction.as_vec3(), u).as_dvec3().normalize();
            continue;
        }
        let z = 2.0 * random.next() - 1.0;
        let (sin, cos) = (std::f64::consts::TAU * random.next()).sin_cos();
        let r = (1.0 - z * z).sqrt();
        direction = DVec3::new(r * cos, r * sin, z);
    }
    false
}

//! Form factors of disks and plates, in closed form and gathered from surfels, and suns of any
//! size.

use super::row::Row;
use super::workbench::{Workbench, add_quad, gatherer, irradiance, stage};
use crate::Result;
use crate::formats::{CloudMeta, Surfel};
use crate::gather::{NoMedia, RayKernel};
use crate::light::{Lights, SceneMedia, ShadowRays};
use crate::math::polygon;
use crate::scene::Light;
use crate::trace::Tracer;
use glam::{DQuat, DVec3, Vec3};
use std::f64::consts::PI;

pub fn rows(bench: &Workbench) -> Result<Vec<Row>> {
    let mut rows = Vec::new();
    plates(&mut rows);
    grazing(&mut rows);
    suns(&mut rows);
    disks(bench, &mut rows)?;
    tiled(bench, &mut rows)?;
    Ok(rows)
}

/// Form factor from a surface element to a rectangle, by the closed form that lights use.
fn to_rectangle(corner: Vec3, across: Vec3, down: Vec3, point: Vec3, normal: Vec3) -> f64 {
    let p = [
        corner,
        corner + across,
        corner + across + down,
        corner + down,
    ]
    .map(|c| c - point);
    let sum = polygon::irradiance([p[0], p[1], p[2]], normal)
        + polygon::irradiance([p[0], p[2], p[3]], normal);
    f64::from(sum) / PI
}

/// From an element below a corner of a rectangle a x b at height h, parallel to it.
fn parallel_corner(a: f64, b: f64, h: f64) -> f64 {
    let (x, y) = (a / h, b / h);
    let part = |p: f64, q: f64| p / (1.0 + p * p).sqrt() * (q / (1.0 + p * p).sqrt()).atan();
    (part(x, y) + part(y, x)) / (2.0 * PI)
}

/// From an element whose normal points along the plane of a rectangle, at distance c of that plane
/// below its corner; b is the side across, a the side along the normal.
fn perpendicular_corner(a: f64, b: f64, c: f64) -> f64 {
    let far = (a * a + c * c).sqrt();
    ((b / c).atan() - c / far * (b / far).atan()) / (2.0 * PI)
}

fn plates(rows: &mut Vec<Row>) {
    let (x, z) = (Vec3::X, Vec3::Z);
    // Two unit squares at distance h: the mean over one of the factor to the other (Howell, C-11).
    for h in [0.1_f64, 1.0, 10.0] {
        let x2 = 1.0 / (h * h);
        let root = (1.0 + x2).sqrt();
        let side = 1.0 / h;
        let expected = 2.0 / (PI * x2)
            * (((1.0 + x2) * (1.0 + x2) / (1.0 + 2.0 * x2)).sqrt().ln()
                + 2.0 * side * root * (side / root).atan()
                - 2.0 * side * side.atan());
        let got = mean_over_square(1, |u, v| {
            let point = Vec3::new(u as f32, 0.0, v as f32);
            to_rectangle(Vec3::new(0.0, h as f32, 0.0), x, z, point, Vec3::Y)
        });
        let at = format!("distance {h}");
        rows.push(Row::relative(
            "parallel unit squares",
            at,
            expected,
            got,
            1e-5,
        ));
    }
    // Two unit squares with a common edge (Howell, C-14).
    let expected = {
        let r = 2.0_f64.sqrt();
        (2.0 * (PI / 4.0) - r * (1.0 / r).atan() + 0.25 * (4.0 / 3.0 * 0.75 * 0.75_f64).ln()) / PI
    };
    let got = mean_over_square(6, |u, v| {
        let point = Vec3::new(v as f32, 0.0, u as f32);
        to_rectangle(Vec3::ZERO, x, Vec3::Y, point, Vec3::Y)
    });
    rows.push(Row::relative(
        "perpendicular unit squares with a common edge",
        "",
        expected,
        got,
        1e-5,
    ));
    for c in [1.0_f64, 1e-2, 1e-4, 1e-6] {
        // Before the middle of the edge.
        let expected = 2.0 * perpendicular_corner(1.0, 0.5, c);
        let point = Vec3::new(0.5, 0.0, c as f32);
        let got = to_rectangle(Vec3::ZERO, x, Vec3::Y, point, Vec3::Y);
        rows.push(Row::relative(
            "receiver before the edge of a perpendicular square",
            format!("distance {c:e}"),
            expected,
            got,
            1e-5,
        ));
        let expected = parallel_corner(1.0, 0.5, c) * 2.0;
        let point = Vec3::new(0.5, -c as f32, 0.0);
        rows.push(Row::relative(
            "receiver below the edge of a parallel square",
            format!("distance {c:e}"),
            expected,
            to_rectangle(Vec3::ZERO, x, z, point, Vec3::Y),
            1e-5,
        ));
    }
    let touching = [
        ("on the edge of a perpendicular square", Vec3::Y, 0.5),
        ("on the edge of a square in its plane", z, 0.0),
    ];
    for (name, down, most) in touching {
        let got = to_rectangle(Vec3::ZERO, x, down, Vec3::new(0.5, 0.0, 0.0), Vec3::Y);
        let off = (got - most).max(0.0) + if got >= 0.0 { 0.0 } else { f64::INFINITY };
        rows.push(Row::with_error(
            format!("receiver {name}: at most"),
            "distance 0",
            (most, got),
            off,
            1e-6,
        ));
    }
}

/// Mean over the unit square by Gauss points in cells that crowd towards u = 0 with this power.
fn mean_over_square(power: i32, f: impl Fn(f64, f64) -> f64) -> f64 {
    const CELLS: usize = 24;
    let points = [-0.6_f64.sqrt(), 0.0, 0.6_f64.sqrt()];
    let weights = [5.0 / 18.0, 8.0 / 18.0, 5.0 / 18.0];
    let nodes: Vec<(f64, f64)> = (0..CELLS)
        .flat_map(|i| (0..3).map(move |k| (i, k)))
        .map(|(i, k)| {
            let s = (i as f64 + 0.5 + 0.5 * points[k]) / CELLS as f64;
            (s, weights[k] / CELLS as f64)
        })
        .collect();
    let mut sum = 0.0;
    for &(s, ws) in &nodes {
        let (u, du) = (s.powi(power), f64::from(power) * s.powi(power - 1));
        for &(v, wv) in &nodes {
            sum += ws * wv * du * f(u, v);
        }
    }
    sum
}

/// A square of edge `size` at distance 1, seen at an angle from the receiver's normal, all turned
/// some way; against the closed form in f64 for the same corners.
fn grazing(rows: &mut Vec<Row>) {
    let turn = DQuat::from_rotation_y(0.4) * DQuat::from_rotation_x(-1.1);
    for size in [1.0_f64, 1e-1, 1e-2, 1e-3, 1e-4, 1e-6] {
        for degrees in [0.0_f64, 60.0, 89.0, 89.99] {
            let (sin, cos) = degrees.to_radians().sin_cos();
            let half = 0.5 * size;
            if degrees > 0.0 && half.atan() > (90.0 - degrees).to_radians() {
                // It crosses the horizon.
                continue;
            }
            let normal = (turn * DVec3::new(sin, cos, 0.0)).as_vec3().normalize();
            let quad = [(-half, -half), (half, -half), (half, half), (-half, half)]
                .map(|(x, z)| (turn * DVec3::new(x, 1.0, z)).as_vec3());
            let halves = [[quad[0], quad[1], quad[2]], [quad[0], quad[2], quad[3]]];
            let sum = |f: &dyn Fn([Vec3; 3]) -> f64| f(halves[0]) + f(halves[1]);
            let at = format!("edge {size:e}, {degrees} degrees");
            let n = normal.as_dvec3();
            // The closed form itself cancels where the cosine is small.
            rows.push(Row::relative(
                "irradiance of a square at distance 1",
                at,
                sum(&|c| lambert(c.map(|p| p.as_dvec3()), n)),
                sum(&|c| polygon::irradiance(c, normal).into()),
                1e-5 + 3e-7 / cos,
            ));
            if degrees == 0.0 {
                rows.push(Row::relative(
                    "solid angle of a square at distance 1",
                    format!("edge {size:e}"),
                    sum(&|c| solid_angle(c.map(|p| p.as_dvec3()))),
                    sum(&|c| polygon::solid_angle(c).into()),
                    1e-5,
                ));
            }
        }
    }
}

/// Lambert's formula in f64; all corners above the horizon.
fn lambert(corners: [DVec3; 3], n: DVec3) -> f64 {
    let edge = |a: DVec3, b: DVec3| {
        let cross = a.cross(b);
        let sin = cross.length();
        sin.atan2(a.dot(b)) * (cross.dot(n) / sin)
    };
    let [a, b, c] = corners;
    0.5 * (edge(a, b) + edge(b, c) + edge(c, a)).abs()
}

/// Van Oosterom & Strackee in f64.
fn solid_angle([a, b, c]: [DVec3; 3]) -> f64 {
    let (la, lb, lc) = (a.length(), b.length(), c.length());
    let numerator = a.dot((b - a).cross(c - a)).abs();
    2.0 * numerator.atan2(la * lb * lc + a.dot(b) * lc + a.dot(c) * lb + b.dot(c) * la)
}

/// Suns with an angular radius: the irradiance is what was asked for, the mean radiance in a medium
/// follows.
fn suns(rows: &mut Vec<Row>) {
    for radius in [0.0_f64, 0.0047, 0.2, 0.6, 1.2] {
        let mut scene = stage(1, Vec3::Y, Vec3::ZERO, 1.0);
        let corner = Vec3::new(-1.0, -9.0, 1.0);
        add_quad(
            &mut scene,
            [corner, 2.0 * Vec3::X, -2.0 * Vec3::Z],
            0.5,
            0.0,
        );
        scene.lights.push(Light::Directional {
            direction: -Vec3::Y,
            irradiance: [3.0; 3],
            angular_radius_rad: radius as f32,
        });
        let tracer = Tracer::new(&scene);
        let lights = Lights::<SceneMedia>::new(&tracer);
        let rays = ShadowRays::Sequence {
            per_light: 4096,
            first: 0,
            seed: 1,
        };
        let at = format!("radius {radius}");
        let facing = lights
            .irradiance(Vec3::ZERO, Vec3::Y, Vec3::Y, rays)
            .light()
            .0[1];
        rows.push(Row::relative(
            "irradiance of a sun, facing it",
            at.clone(),
            3.0,
            facing.into(),
            1e-5,
        ));
        // In the air, around: 3 / (pi sin^2) over its solid angle, over 4 pi.
        let expected = 3.0 / (2.0 * PI * (1.0 + radius.cos()));
        let around = lights.mean_radiance(Vec3::Y, rays).light().0[1];
        rows.push(Row::relative(
            "mean radiance of a sun in a medium",
            at,
            expected,
            around.into(),
            2e-3,
        ));
    }
}

/// A disk of radiance 1 around the origin that faces +y.
fn disk(radius: f32) -> Surfel {
    Surfel {
        normal: [0.0, 1.0, 0.0],
        radius,
        area: (PI as f32) * radius * radius,
        front: [1.0; 3],
        ..Surfel::default()
    }
}

const KERNELS: [(&str, RayKernel); 2] = [("cone", RayKernel::Cone), ("plain", RayKernel::Plain)];

fn disks(bench: &Workbench, rows: &mut Vec<Row>) -> Result<()> {
    const SAMPLES: u32 = 65_536;
    let meta = CloudMeta {
        disk_overlap: 1.0,
        ..CloudMeta::default()
    };
    let store = bench.tree_of(meta, [disk(1.0)], &[])?;
    for (name, kernel) in KERNELS {
        let mut gatherer = gatherer(&store, NoMedia, SAMPLES, 0.0);
        gatherer.settings.kernel = kernel;
        for d in [1e-3_f64, 0.1, 1.0, 10.0] {
            let expected = 1.0 / (1.0 + d * d);
            let point = Vec3::new(0.0, d as f32, 0.0);
            let got = irradiance(&gatherer, point, -Vec3::Y, 3) / PI;
            // So many samples hit: well-spread ones do better than random ones.
            let limit = 1e-5 + 0.5 / (f64::from(SAMPLES) * expected).sqrt();
            rows.push(Row::relative(
                format!("disk R^2 / (R^2 + d^2), {name} kernel"),
                format!("d / R {d:e}, {SAMPLES} rays"),
                expected,
                got,
                limit,
            ));
        }
        for (what, point, normal) in [
            ("receiver on a disk, facing away", Vec3::ZERO, Vec3::Y),
            (
                "receiver 1e-6 R above a disk, facing away",
                Vec3::Y * 1e-6,
                Vec3::Y,
            ),
            (
                "receiver in the plane of a disk, beside it",
                Vec3::X * 1.5,
                Vec3::Y,
            ),
            ("receiver behind a disk", Vec3::Y * -0.5, Vec3::Y),
        ] {
            let got = irradiance(&gatherer, point, normal, 5);
            rows.push(Row::nothing(
                format!("{what}, {name} kernel"),
                "light",
                got,
                0.0,
            ));
        }
    }
    Ok(())
}

/// A plate of 100 x 100 disks that overlap, as a bake would make it.
fn tiled(bench: &Workbench, rows: &mut Vec<Row>) -> Result<()> {
    const N: usize = 100;
    const OVERLAP: f32 = 1.8;
    let meta = CloudMeta {
        disk_overlap: OVERLAP,
        ..CloudMeta::default()
    };
    let area = 1.0 / (N * N) as f32;
    let plate = (0..N * N).map(|i| {
        let at = |k: usize| (k as f32 + 0.5) / N as f32 - 0.5;
        Surfel {
            position: [at(i % N), 0.0, at(i / N)],
            radius: OVERLAP * (area / PI as f32).sqrt(),
            area,
            ..disk(1.0)
        }
    });
    let store = bench.tree_of(meta, plate, &[])?;
    for cut in [0.0, 0.01, 0.04] {
        let gatherer = gatherer(&store, NoMedia, 65_536, cut);
        // Disks reach over the plate's border by up to 1 % of its edge.
        for h in [0.05_f64, 0.5, 2.0] {
            let point = Vec3::new(0.0, h as f32, 0.0);
            let got = irradiance(&gatherer, point, -Vec3::Y, 3) / PI;
            rows.push(Row::relative(
                "square of 10,000 surfels above a receiver",
                format!("height {h}, nodes below {cut} sr whole"),
                4.0 * parallel_corner(0.5, 0.5, h),
                got,
                0.03,
            ));
        }
    }
    Ok(())
}

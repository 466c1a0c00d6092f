//! LDR-FLIP (Andersson, Nilsson, Akenine-Moller, Oskarsson, Astrom, Fairchild, "FLIP: A Difference
//! Evaluator for Alternating Images", 2020), on tone-mapped pictures taken as sRGB.
//!
//! Colour: contrast sensitivity filters in an opponent space, Hunt-adjusted CIELAB, HyAB distance.
//! Features: first and second Gaussian derivatives of luminance find edges and points. The feature
//! difference is the exponent that amplifies the colour difference. All sums run in f64 where the
//! authors' program uses f32.

use super::blur::{Border, columns, rows};
use crate::image::tone::Display;
use rayon::prelude::*;
use std::f64::consts::{PI, SQRT_2};

/// A screen 3840 pixels and 0.7 m wide, seen from 0.7 m: 67 pixels a degree.
const PIXELS_PER_DEGREE: f64 = 3840.0 * PI / 180.0;

// The paper's q_c, p_c, p_t, w and q_f.
const COLOUR_EXPONENT: f64 = 0.7;
const COLOUR_KNEE: f64 = 0.4;
const COLOUR_KNEE_TO: f64 = 0.95;
const FEATURE_WIDTH_DEG: f64 = 0.082;
const FEATURE_EXPONENT: f64 = 0.5;

/// Contrast sensitivity by opponent channel, as sums of Gaussians `a sqrt(pi/b) exp(-pi^2 x^2 / b)`
/// over degrees.
const LUMINANCE: &[(f64, f64)] = &[(1.0, 0.0047)];
const RED_GREEN: &[(f64, f64)] = &[(1.0, 0.0053)];
const BLUE_YELLOW: &[(f64, f64)] = &[(34.1, 0.04), (13.5, 0.025)];
const WIDEST: f64 = 0.04;

/// XYZ of white, D65.
const WHITE: [f64; 3] = [0.950428545, 1.0, 1.088900371];
const XYZ_FROM_RGB: [[f64; 3]; 3] = [
    [
        10135552.0 / 24577794.0,
        8788810.0 / 24577794.0,
        4435075.0 / 24577794.0,
    ],
    [
        2613072.0 / 12288897.0,
        8788810.0 / 12288897.0,
        887015.0 / 12288897.0,
    ],
    [
        1425312.0 / 73733382.0,
        8788810.0 / 73733382.0,
        70074185.0 / 73733382.0,
    ],
];
const RGB_FROM_XYZ: [[f64; 3]; 3] = [
    [3.241003275, -1.537398934, -0.498615861],
    [-0.969224334, 1.875930071, 0.041554224],
    [0.055639423, -0.204011202, 1.057148933],
];

type Plane = Vec<f64>;

/// Computes the LDR-FLIP error of every pixel, 0 (same) to 1, row by row.
#[must_use]
pub fn error_map(picture: &Display, reference: &Display) -> Vec<f32> {
    let width = picture.width;
    let (opponent_p, opponent_r) = (opponent(picture), opponent(reference));
    let (lab_p, lab_r) = (
        filtered_lab(&opponent_p, width),
        filtered_lab(&opponent_r, width),
    );
    let (features_p, features_r) = (
        Features::new(&opponent_p[0], width),
        Features::new(&opponent_r[0], width),
    );
    let largest = largest_distance();
    let knee = COLOUR_KNEE * largest;
    (0..picture.pixels.len())
        .into_par_iter()
        .with_min_len(4096)
        .map(|i| {
            let distance = hyab(lab_p[i], lab_r[i]).powf(COLOUR_EXPONENT);
            let colour = if distance < knee {
                distance * COLOUR_KNEE_TO / knee
            } else {
                COLOUR_KNEE_TO + (distance - knee) / (largest - knee) * (1.0 - COLOUR_KNEE_TO)
            };
            let edge = (features_p.edges[i] - features_r.edges[i]).abs();
            let point = (features_p.points[i] - features_r.points[i]).abs();
            let feature = (edge.max(point) / SQRT_2).powf(FEATURE_EXPONENT);
            colour.powf(1.0 - feature) as f32
        })
        .collect()
}

/// Averages an error map.
#[must_use]
pub fn mean(error_map: &[f32]) -> f64 {
    error_map.iter().map(|&e| f64::from(e)).sum::<f64>() / error_map.len() as f64
}

/// Luminance, red-green and blue-yellow planes (YCxCz).
fn opponent(display: &Display) -> [Plane; 3] {
    let linear: Vec<f64> = (0..=255u8)
        .map(|v| {
            let v = f64::from(v) / 255.0;
            if v <= 0.04045 {
                v / 12.92
            } else {
                ((v + 0.055) / 1.055).powf(2.4)
            }
        })
        .collect();
    let converted: Vec<[f64; 3]> = display
        .pixels
        .par_iter()
        .with_min_len(4096)
        .map(|pixel| {
            let [x, y, z] = relative_xyz(pixel.map(|v| linear[usize::from(v)]));
            [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
        })
        .collect();
    [0, 1, 2].map(|i| converted.iter().map(|c| c[i]).collect())
}

/// Contrast-sensitivity filtered, Hunt-adjusted CIELAB.
fn filtered_lab(opponent: &[Plane; 3], width: usize) -> Vec<[f64; 3]> {
    let [y, cx, cz] = [LUMINANCE, RED_GREEN, BLUE_YELLOW]
        .iter()
        .zip(opponent)
        .map(|(gaussians, plane)| sensitivity_filter(plane, width, gaussians))
        .collect::<Vec<Plane>>()
        .try_into()
        .unwrap_or_default();
    (0..y.len())
        .into_par_iter()
        .with_min_len(4096)
        .map(|i| {
            let relative_y = (y[i] + 16.0) / 116.0;
            let relative = [
                relative_y + cx[i] / 500.0,
                relative_y,
                relative_y - cz[i] / 200.0,
            ];
            let xyz = [0, 1, 2].map(|k| relative[k] * WHITE[k]);
            let rgb = multiply(&RGB_FROM_XYZ, xyz).map(|v| v.clamp(0.0, 1.0));
            hunt_lab(rgb)
        })
        .collect()
}

/// A sum of two-dimensional Gaussians is not separable, each of them is.
fn sensitivity_filter(plane: &Plane, width: usize, gaussians: &[(f64, f64)]) -> Plane {
    let radius = (3.0 * (WIDEST / (2.0 * PI * PI)).sqrt() * PIXELS_PER_DEGREE).ceil() as i32;
    let mut out = vec![0.0; plane.len()];
    let mut total = 0.0;
    for &(a, b) in gaussians {
        let filter: Vec<f64> = (-radius..=radius)
            .map(|i| {
                let x = f64::from(i) / PIXELS_PER_DEGREE;
                (a * (PI / b).sqrt()).sqrt() * (-PI * PI * x * x / b).exp()
            })
            .collect();
        let sum: f64 = filter.iter().sum();
        total += sum * sum;
        let across = rows(plane, width, &filter, Border::Clamp);
        let down = columns(&across, width, &filter, Border::Clamp);
        for (out, value) in out.iter_mut().zip(down) {
            *out += value;
        }
    }
    for value in &mut out {
        *value /= total;
    }
    out
}

/// Strength of edges and points at every pixel.
struct Features {
    edges: Plane,
    points: Plane,
}

impl Features {
    fn new(luminance: &Plane, width: usize) -> Self {
        let sigma = 0.5 * FEATURE_WIDTH_DEG * PIXELS_PER_DEGREE;
        let radius = (3.0 * sigma).ceil() as i32;
        let kernel = |weight: &dyn Fn(f64) -> f64| -> Vec<f64> {
            let raw: Vec<f64> = (-radius..=radius)
                .map(|i| {
                    let x = f64::from(i);
                    weight(x) * (-x * x / (2.0 * sigma * sigma)).exp()
                })
                .collect();
            balance(&raw)
        };
        let smooth = kernel(&|_| 1.0);
        let first = kernel(&|x| -x);
        let second = kernel(&|x| x * x / (sigma * sigma) - 1.0);
        let gray: Plane = luminance.iter().map(|y| (y + 16.0) / 116.0).collect();
        let smooth_rows = rows(&gray, width, &smooth, Border::Clamp);
        let smooth_columns = columns(&gray, width, &smooth, Border::Clamp);
        let strength = |derivative: &[f64]| -> Plane {
            let across = rows(&smooth_columns, width, derivative, Border::Clamp);
            let down = columns(&smooth_rows, width, derivative, Border::Clamp);
            across.iter().zip(&down).map(|(x, y)| x.hypot(*y)).collect()
        };
        Self {
            edges: strength(&first),
            points: strength(&second),
        }
    }
}

/// Scales positive weights to sum to 1 and negative ones to sum to -1.
fn balance(weights: &[f64]) -> Vec<f64> {
    let positive: f64 = weights.iter().filter(|w| **w > 0.0).sum();
    let negative: f64 = -weights.iter().filter(|w| **w < 0.0).sum::<f64>();
    let scale = |w: &f64| {
        *w / if *w > 0.0 {
            positive
        } else {
            negative.max(f64::MIN_POSITIVE)
        }
    };
    weights.iter().map(scale).collect()
}

/// CIELAB whose chroma fades with lightness, as the Hunt effect has it.
fn hunt_lab(rgb: [f64; 3]) -> [f64; 3] {
    let curve = |t: f64| {
        let delta = 6.0 / 29.0;
        if t > delta * delta * delta {
            t.cbrt()
        } else {
            t / (3.0 * delta * delta) + 4.0 / 29.0
        }
    };
    let [x, y, z] = relative_xyz(rgb).map(curve);
    let lightness = 116.0 * y - 16.0;
    let hunt = 0.01 * lightness;
    [lightness, hunt * 500.0 * (x - y), hunt * 200.0 * (y - z)]
}

fn hyab(a: [f64; 3], b: [f64; 3]) -> f64 {
    (a[0] - b[0]).abs() + (a[1] - b[1]).hypot(a[2] - b[2])
}

/// Between pure green and pure blue, the farthest that colours of a screen can be.
fn largest_distance() -> f64 {
    hyab(hunt_lab([0.0, 1.0, 0.0]), hunt_lab([0.0, 0.0, 1.0])).powf(COLOUR_EXPONENT)
}

/// XYZ over that of white.
fn relative_xyz(rgb: [f64; 3]) -> [f64; 3] {
    let xyz = multiply(&XYZ_FROM_RGB, rgb);
    [0, 1, 2].map(|k| xyz[k] / WHITE[k])
}

fn multiply(matrix: &[[f64; 3]; 3], v: [f64; 3]) -> [f64; 3] {
    matrix.map(|row| row[0] * v[0] + row[1] * v[1] + row[2] * v[2])
}

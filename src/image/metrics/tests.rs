//! Expected values come from NumPy, scikit-image 0.26.0 `structural_similarity`, flip-evaluator 1.7
//! and a NumPy version of the perceptualdiff tool, on the same synthetic pictures.

use super::*;

/// Checks and a ramp against the same with errors everywhere and a firefly in a hundred samples;
/// exact in f32.
fn pair(width: usize, height: usize) -> (Picture, Picture) {
    let make = |noisy: bool| {
        let mut pixels = Vec::new();
        for y in 0..height {
            for x in 0..width {
                pixels.push([0, 1, 2].map(|c| {
                    let ramp = ((x * 5 + y * 3 + c * 17) % 97) as f32 / 128.0;
                    let checks = ((x / 8 + y / 8) % 2) as f32 * 0.25;
                    let n = (x * 7919 + y * 104_729 + c * 1_299_709) % 1021;
                    let noise = (n as f32 - 510.0) / 8192.0;
                    let firefly = if n % 97 == 0 { 0.5 } else { 0.0 };
                    ramp + checks + if noisy { noise + firefly } else { 0.0 }
                }));
            }
        }
        Picture {
            width,
            height,
            pixels,
        }
    };
    (make(true), make(false))
}

#[track_caller]
fn close(value: f64, expected: f64, tolerance: f64) {
    assert!(
        (value - expected).abs() <= tolerance,
        "{value} is not {expected}"
    );
}

#[test]
fn agrees_with_the_python_tools() {
    struct Expected {
        size: (usize, usize),
        rmse: f64,
        relmse: f64,
        trimmed: f64,
        bias: f64,
        max_abs: f64,
        flip: f64,
        ssim: f64,
        pdiff: usize,
    }
    let table = [
        Expected {
            size: (48, 40),
            rmse: 0.06423953028396621,
            relmse: 0.07533871304840617,
            trimmed: 0.0704460860837578,
            bias: 0.011062923704664662,
            max_abs: 0.55615234375,
            flip: 0.06653503328561783,
            ssim: 0.9232295402259156,
            pdiff: 481,
        },
        Expected {
            size: (13, 31),
            rmse: 0.07183776492467894,
            relmse: 0.08905509811690242,
            trimmed: 0.08905509811690242,
            bias: 0.01426232173361619,
            max_abs: 0.55615234375,
            flip: 0.07971405237913132,
            ssim: 0.926082586539886,
            pdiff: 103,
        },
    ];
    for expected in table {
        let (width, height) = expected.size;
        let (picture, reference) = pair(width, height);
        let scores = compare(&picture, &reference, 0.75).unwrap().scores;
        close(scores.rmse, expected.rmse, 1e-12);
        close(scores.relmse, expected.relmse, 1e-12);
        close(scores.relmse_trimmed, expected.trimmed, 1e-12);
        close(scores.bias, expected.bias, 1e-12);
        close(scores.max_abs, expected.max_abs, 0.0);
        // The authors' program sums in f32.
        close(scores.flip, expected.flip, 2e-6);
        close(scores.ssim, expected.ssim, 1e-12);
        close(
            scores.pdiff * (width * height) as f64,
            expected.pdiff as f64,
            1e-9,
        );
    }
}

#[test]
fn pictures_smaller_than_the_filters_have_scores() {
    let (picture, reference) = pair(7, 9);
    let scores = compare(&picture, &reference, 0.75).unwrap().scores;
    close(scores.flip, 0.09068275988101959, 2e-6);
    close(scores.pdiff * 63.0, 14.0, 1e-9);
    assert!(scores.ssim.is_nan());
    let (picture, reference) = pair(1, 1);
    assert!(
        compare(&picture, &reference, 1.0)
            .unwrap()
            .scores
            .flip
            .is_finite()
    );
}

#[test]
fn the_same_picture_has_no_error() {
    let (_, reference) = pair(32, 24);
    let Comparison { scores, error_map } = compare(&reference, &reference, 2.0).unwrap();
    assert_eq!(
        (scores.rmse, scores.relmse, scores.relmse_trimmed),
        (0.0, 0.0, 0.0)
    );
    assert_eq!(
        (scores.bias, scores.flip, scores.pdiff, scores.max_abs),
        (0.0, 0.0, 0.0, 0.0)
    );
    close(scores.ssim, 1.0, 1e-12);
    assert!(error_map.iter().all(|&e| e == 0.0));
}

#[test]
fn black_against_white_is_as_wrong_as_can_be() {
    let flat = |v: f32| Picture {
        width: 40,
        height: 40,
        pixels: vec![[v; 3]; 1600],
    };
    let scores = compare(&flat(0.0), &flat(1.0), 1.0).unwrap().scores;
    close(scores.bias, -1.0, 0.0);
    close(scores.pdiff, 1.0, 0.0);
    assert!(scores.flip > 0.9 && scores.flip <= 1.0);
    assert!(scores.ssim < 0.01);
}

#[test]
fn broken_pixels_are_counted_and_do_not_pass_unseen() {
    let (mut picture, reference) = pair(48, 40);
    picture.pixels[5][1] = f32::NAN;
    picture.pixels[9][0] = f32::INFINITY;
    let scores = compare(&picture, &reference, 1.0).unwrap().scores;
    assert_eq!((scores.non_finite, scores.reference_non_finite), (2, 0));
    let turned = compare(&reference, &picture, 1.0).unwrap().scores;
    assert_eq!((turned.non_finite, turned.reference_non_finite), (0, 2));
    assert!(scores.rmse.is_nan() && scores.max_abs.is_nan());
    assert!(scores.flip.is_finite());
}

#[test]
fn the_trimmed_mean_drops_a_thousandth_rounded_down() {
    for (pixels, dropped) in [
        (0, 0),
        (1, 0),
        (999, 0),
        (1000, 1),
        (1999, 1),
        (262_144, 262),
    ] {
        assert_eq!(pixels - linear::kept(pixels), dropped);
    }
    let flat = |pixels: usize| Picture {
        width: pixels,
        height: 1,
        pixels: vec![[1.0; 3]; pixels],
    };
    for (pixels, is_dropped) in [(999, false), (1000, true)] {
        let mut picture = flat(pixels);
        picture.pixels[7] = [9.0; 3];
        let trimmed = linear::compare(&picture, &flat(pixels)).relmse_trimmed;
        assert_eq!(trimmed == 0.0, is_dropped);
    }
}

#[test]
fn what_cannot_be_compared_is_refused() {
    let ((a, _), (b, _)) = (pair(8, 8), pair(8, 9));
    let error = compare(&a, &b, 1.0).unwrap_err();
    assert!(error.to_string().contains("8x8") && error.to_string().contains("8x9"));
    for exposure in [0.0, -1.0, f32::NAN, f32::INFINITY] {
        assert!(compare(&a, &a, exposure).is_err());
    }
}

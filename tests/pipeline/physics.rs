//! Pictures that are known beforehand: bodies and media that vanish, form factors. Others are cases
//! of `lvox::internals::stability`.

use crate::support::random::Random;
use crate::{beauty, layer, mean, render};
use lvox::image::BACKGROUND_DEPTH;
use lvox::shade::{Kernel, Method, Settings};

fn quick() -> Settings {
    Settings {
        samples: 64,
        volume_samples: 64,
        ..Settings::default()
    }
}

fn film(side: u32) -> String {
    format!(
        "[film]\nwidth = {side}\nheight = {side}\n[[camera]]\nposition = [0.8, 1.1, 3]\n\
         target = [0, 0, 0]\nfov_x_deg = 30\n"
    )
}

/// A homogeneous cube of edge 1 around the origin.
fn fog(sigma_t: f64, albedo: f64) -> String {
    format!(
        "[[volume]]\nfile = \"fog.nrrd\"\nsigma_t_scale = {sigma_t}\n\
         albedo = [{albedo}, {albedo}, {albedo}]\n\
         unitcube_to_world = [[1, 0, 0, -0.5], [0, 1, 0, -0.5], [0, 0, 1, -0.5], [0, 0, 0, 1]]\n"
    )
    .replace(
        "file = \"fog.nrrd\"",
        "file = \"smoke.raw\"\ndims = [1, 1, 1]\ndtype = \"u8\"",
    )
}

const ENVIRONMENT: &str = "[[light]]\ntype = \"environment\"\nradiance = [2, 1, 0.5]\n";

#[test]
fn an_emitter_seen_from_behind_is_dark() {
    for (rotate, expected) in [(90, 3.0), (-90, 0.0)] {
        let text = format!(
            "[film]\nwidth = 8\nheight = 8\n[[camera]]\nposition = [0, 0, 3]\ntarget = [0, 0, 0]\n\
             fov_x_deg = 10\n\
             [[mesh]]\nfile = \"builtin:quad\"\nscale = 4\nrotate_deg = [{rotate}, 0, 0]\n\
             albedo = [0, 0, 0]\nemission = [3, 3, 3]\n"
        );
        // Samples of each pixel's own, and of its corners.
        for pixel_samples in [8, 1] {
            let settings = Settings {
                pixel_samples,
                ..quick()
            };
            let frame = render(&text, 1000, &settings);
            let near = |v: &f32| (v - expected).abs() <= 1e-5 * expected;
            assert!(beauty(&frame).iter().flatten().all(near));
        }
    }
}

/// Quads that no corner of a pixel sees, some of them behind a board in part: the mean over the
/// film is what they cover.
#[test]
fn emitters_smaller_than_a_pixel_are_seen_by_what_they_cover() {
    // The film is 2 x 2 at the distance of the emitters, in 8 x 8 pixels.
    let mut text = String::from(
        "[film]\nwidth = 8\nheight = 8\n[[camera]]\nposition = [0, 0, 1]\ntarget = [0, 0, 0]\n\
         fov_x_deg = 90\n",
    );
    let mut add = |at: [f32; 3], size: f32, emission: f32| {
        text += &format!(
            "[[mesh]]\nfile = \"builtin:quad\"\nscale = {size}\nrotate_deg = [90, 0, 0]\n\
             translate = [{}, {}, {}]\nalbedo = [0, 0, 0]\n\
             emission = [{emission}, {emission}, {emission}]\n",
            at[0], at[1], at[2]
        );
    };
    let side = 0.02;
    for i in 0..5 {
        add(
            [0.3 * i as f32 - 0.61, 0.37 - 0.11 * i as f32, 0.0],
            side,
            100.0,
        );
    }
    // A large one whose sides run through pixels.
    add([-0.55, -0.55, 0.0], 0.43, 2.0);
    let open = 5.0 * side * side * 100.0 + 0.43 * 0.43 * 2.0;
    let board = text.clone()
        + "[[mesh]]\nfile = \"builtin:quad\"\nscale = 0.5\nrotate_deg = [90, 0, 0]\n\
           translate = [-0.39, 0.2225, 0.5]\nalbedo = [0, 0, 0]\n";
    // Over the plane of the emitters it hides what is left of x = -0.28 and above y = -0.055: two
    // emitters.
    let hidden = open - 2.0 * side * side * 100.0;
    for (text, sent) in [(&text, open), (&board, hidden)] {
        for pixel_samples in [8, 1] {
            let settings = Settings {
                pixel_samples,
                ..quick()
            };
            let frame = render(text, 1000, &settings);
            let found = beauty(&frame).iter().map(|p| p[0]).sum::<f32>() / 64.0;
            let expected = sent / 4.0;
            assert!((found / expected - 1.0).abs() < 1e-3, "{found} {expected}");
        }
    }
}

/// A floor that shines, far wider than the camera is above it: all that is below the horizon is as
/// bright.
#[test]
fn a_wide_emitter_below_the_camera_is_even() {
    for size in [4e4, 4e6] {
        let text = format!(
            "[film]\nwidth = 8\nheight = 64\n[[camera]]\nposition = [0, 1, 0]\n\
             target = [0, 1, -1]\nfov_x_deg = 20\n[[mesh]]\nfile = \"builtin:quad\"\n\
             scale = {size}\nalbedo = [0, 0, 0]\nemission = [5, 5, 5]\n"
        );
        for pixel_samples in [8, 1] {
            let settings = Settings {
                pixel_samples,
                ..quick()
            };
            let frame = render(&text, 1000, &settings);
            for (i, pixel) in beauty(&frame)[33 * 8..].iter().enumerate() {
                let row = 33 + i / 8;
                assert!(
                    (pixel[0] / 5.0 - 1.0).abs() < 1e-3,
                    "{size} {row}: {pixel:?}"
                );
            }
        }
    }
}

/// What is further away than light is gathered from sends none, but it still hides the environment.
#[test]
fn walls_and_media_beyond_max_dist_hide_the_environment() {
    const WHITE: &str = "[[light]]\ntype = \"environment\"\nradiance = [1, 1, 1]\n";
    let near = Settings {
        max_dist: Some(0.3),
        ..quick()
    };
    let gathered = |text: &str, settings: &Settings| -> f64 {
        let frame = render(text, 60_000, settings);
        ["environment", "indirect"]
            .iter()
            .map(|name| mean(&layer(&frame, name)))
            .sum()
    };
    let kernels = [Kernel::Traced, Kernel::Cone, Kernel::Plain].map(|kernel| Settings {
        kernel,
        ..near.clone()
    });
    let inside = "[film]\nwidth = 8\nheight = 8\n[[camera]]\nposition = [0.2, 0.1, 0.9]\n\
                  target = [0, 0, 0]\n";
    let cube = "[[mesh]]\nfile = \"builtin:cube\"\nscale = 2\nalbedo = [0.5, 0.5, 0.5]\n";
    for settings in &kernels {
        let found = gathered(&format!("{inside}{WHITE}{cube}"), settings);
        assert!(found < 0.01, "{found} by {:?}", settings.kernel);
    }
    // A floor that sees nothing but the environment, straight and through a medium that is further
    // away.
    let above = "[film]\nwidth = 8\nheight = 8\n[[camera]]\nposition = [0, 0.4, 0]\n\
                 target = [0, 0, 0]\nup = [0, 0, -1]\nfov_x_deg = 20\n\
                 [[mesh]]\nfile = \"builtin:quad\"\nscale = 2\nalbedo = [0.5, 0.5, 0.5]\n";
    let slab = "[[volume]]\nfile = \"smoke.raw\"\ndims = [16, 16, 16]\ndtype = \"u8\"\n\
                value_scale = 0.0039\nsigma_t_scale = 1.5\nalbedo = [0, 0, 0]\n\
                unitcube_to_world = [[8, 0, 0, -4], [0, 1, 0, 0.5], [0, 0, 8, -4], [0, 0, 0, 1]]\n";
    for medium in ["", slab] {
        let text = format!("{above}{WHITE}{medium}");
        for settings in &kernels {
            let far = Settings {
                max_dist: None,
                ..settings.clone()
            };
            let (found, expected) = (gathered(&text, settings), gathered(&text, &far));
            let most = if medium.is_empty() { 0.501 } else { 0.45 };
            assert!(expected > 0.05 && expected < most, "{expected}");
            assert!(
                (found / expected - 1.0).abs() < 1e-3,
                "{found} {expected} by {:?}",
                settings.kernel
            );
        }
    }
}

#[test]
fn a_lone_convex_body_in_a_constant_environment_reflects_its_albedo_everywhere() {
    let albedo = 0.6_f32;
    for (shape, tolerance) in [
        ("cube", 1e-5),
        // Its facets are small against the disks on them, and those stand out over their neighbours
        // a little.
        ("sphere", 0.04),
    ] {
        let mesh = format!(
            "[[mesh]]\nfile = \"builtin:{shape}\"\nalbedo = [{albedo}, {albedo}, {albedo}]\n"
        );
        let frame = render(
            &format!("{}{ENVIRONMENT}{mesh}", film(48)),
            100_000,
            &quick(),
        );
        let depth = &frame.layer("depth").unwrap().channels[0].1;
        let (mut on_body, mut rim, mut sum) = (0, 0, 0.0);
        for (pixel, depth) in beauty(&frame).iter().zip(depth) {
            // Radiance over that of the environment: 1 beside the body, the albedo on it, a mixture
            // at its rim.
            let [r, g, b] = [pixel[0] / 2.0, pixel[1], pixel[2] / 0.5];
            assert!((r - g).abs() < 1e-3 && (g - b).abs() < 1e-3);
            if *depth == BACKGROUND_DEPTH {
                assert_eq!(pixel, &[2.0, 1.0, 0.5]);
            } else if (g - albedo).abs() < tolerance * albedo {
                on_body += 1;
                sum += f64::from(g);
            } else {
                assert!(g > albedo && g < 1.0, "{shape}: {g}");
                rim += 1;
            }
        }
        let average = sum / f64::from(on_body);
        let error = (average / f64::from(albedo) - 1.0).abs();
        assert!(error < 0.25 * f64::from(tolerance), "{shape}: {average}");
        assert!(
            on_body > 500 && rim < on_body / 4,
            "{shape}: {on_body} {rim}"
        );
    }
}

/// Share of the paths from the middle of a side of the unit cube straight inwards that leave it
/// after at most two scatterings: what direct light and one bounce bring of a constant environment.
fn leaves_soon(sigma_t: f32) -> f64 {
    const PATHS: u32 = 1_000_000;
    let mut random = Random(1);
    let mut count = 0;
    for _ in 0..PATHS {
        let (mut point, mut direction) = ([0.0, 0.0, 0.5], [0.0, 0.0, -1.0]);
        for _ in 0..3 {
            let far = (0..3)
                .map(|a| (0.5_f32.copysign(direction[a]) - point[a]) / direction[a])
                .fold(f32::INFINITY, f32::min);
            let free = -(1.0 - random.unit()).ln() / sigma_t;
            if free >= far {
                count += 1;
                break;
            }
            point = std::array::from_fn(|a| point[a] + free * direction[a]);
            direction = random.direction();
        }
    }
    f64::from(count) / f64::from(PATHS)
}

#[test]
fn a_white_medium_in_a_constant_environment_nearly_vanishes() {
    for (sigma_t, tolerance) in [
        (0.01_f32, 1e-5),
        (0.3, 1e-3),
        // Light falls steeply behind the sides of a dense cube, more so than the lattice follows.
        (3.0, 0.04),
    ] {
        let text = format!(
            "[film]\nwidth = 9\nheight = 9\n[[camera]]\nposition = [0, 0, 3]\ntarget = [0, 0, 0]\n\
             fov_x_deg = 1\n{ENVIRONMENT}{}",
            fog(f64::from(sigma_t), 1.0).replace("dims = [1, 1, 1]", "dims = [32, 32, 32]")
        );
        let work = crate::Work::new(&text);
        std::fs::write(work.path("smoke.raw"), vec![1_u8; 32 * 32 * 32]).unwrap();
        let scene = work.scene();
        let tree = work.bake(&scene, 1);
        let frame = crate::shade(&scene, &tree, &quick());
        let behind = layer(&frame, "environment")[40][1];
        assert!((behind - (-sigma_t).exp()).abs() < 1e-5, "{behind}");
        let found = f64::from(beauty(&frame)[40][1]);
        let expected = leaves_soon(sigma_t);
        assert!(
            (found - expected).abs() < tolerance,
            "sigma_t {sigma_t}: {found}, expected {expected}"
        );
    }
}

/// Seen from the side, the light of a sun falls exponentially in a medium: a straight line between
/// points where it is known would lie above that, here by 4 % on average.
#[test]
fn sunlight_in_a_medium_falls_exponentially() {
    let sigma_t = 10.9;
    let text = format!(
        "[film]\nwidth = 64\nheight = 4\n[[camera]]\nposition = [0, 0, 100]\ntarget = [0, 0, 0]\n\
         fov_x_deg = 0.5729\n[[light]]\ntype = \"directional\"\ndirection = [1, 0, 0]\n\
         irradiance = [1, 1, 1]\n{}",
        fog(sigma_t, 1.0).replace("dims = [1, 1, 1]", "dims = [32, 32, 32]")
    );
    let work = crate::Work::new(&text);
    std::fs::write(work.path("smoke.raw"), vec![1_u8; 32 * 32 * 32]).unwrap();
    let scene = work.scene();
    let tree = work.bake(&scene, 1);
    let settings = Settings {
        max_dist: Some(1e-6),
        ..quick()
    };
    let frame = crate::shade(&scene, &tree, &settings);
    let mut errors = Vec::new();
    for (i, pixel) in beauty(&frame).iter().enumerate() {
        let x = (i % 64) as f64 + 0.5;
        if (16.0..48.0).contains(&x) {
            let expected = (-sigma_t * x / 64.0).exp() / (4.0 * std::f64::consts::PI);
            errors.push(f64::from(pixel[0]) / expected - 1.0);
        }
    }
    let mean = errors.iter().sum::<f64>() / errors.len() as f64;
    assert!(mean.abs() < 0.015, "{mean}");
    assert!(errors.iter().all(|e| e.abs() < 0.03), "{errors:?}");
}

/// Beams narrower than the voxels of the medium that shows them, and a wide one.
#[test]
fn a_medium_shows_the_beam_of_a_spot_light() {
    let (side, sigma_t) = (64, 1e-3);
    for (dims, inner, outer) in [(4, 4.0_f64, 6.0_f64), (32, 4.0, 6.0), (16, 17.0, 20.0)] {
        let text = format!(
            "[film]\nwidth = {side}\nheight = {side}\n\
             [[camera]]\nposition = [0, 0, 3]\ntarget = [0, 0, 0]\nfov_x_deg = 22\n\
             [[light]]\ntype = \"spot\"\nposition = [0.1, 0.9, 0.05]\ndirection = [0, -1, 0]\n\
             intensity = [1, 1, 1]\ninner_deg = {inner}\nouter_deg = {outer}\n{}",
            fog(sigma_t, 1.0).replace(
                "dims = [1, 1, 1]",
                &format!("dims = [{dims}, {dims}, {dims}]")
            )
        );
        let work = crate::Work::new(&text);
        std::fs::write(work.path("smoke.raw"), vec![1_u8; dims * dims * dims]).unwrap();
        let scene = work.scene();
        let tree = work.bake(&scene, 1);
        let settings = Settings {
            method: Method::Traditional,
            ..quick()
        };
        let got = layer(&crate::shade(&scene, &tree, &settings), "volume");
        let (cos_inner, cos_outer) = (inner.to_radians().cos(), outer.to_radians().cos());
        let lit = |p: [f64; 3]| {
            if p.iter().any(|c| c.abs() > 0.5) {
                return 0.0;
            }
            let to = [p[0] - 0.1, p[1] - 0.9, p[2] - 0.05];
            let d2: f64 = to.iter().map(|c| c * c).sum();
            let s = ((-to[1] / d2.sqrt() - cos_outer) / (cos_inner - cos_outer)).clamp(0.0, 1.0);
            s * s * (3.0 - 2.0 * s) / d2 * sigma_t / (4.0 * std::f64::consts::PI)
        };
        let reach = 11.0_f64.to_radians().tan() * 2.0 / f64::from(side);
        let (rays, steps) = (4, 300);
        let mut expected = Vec::new();
        for i in 0..side * side {
            let mut sum = 0.0;
            for k in 0..rays * rays {
                let at = |pixel: i32, k: i32| {
                    f64::from(pixel) + (f64::from(k) + 0.5) / f64::from(rays)
                        - f64::from(side) / 2.0
                };
                let (x, y) = (
                    at(i % side, k % rays) * reach,
                    -at(i / side, k / rays) * reach,
                );
                let length = (x * x + y * y + 1.0).sqrt();
                for step in 0..steps {
                    let z = 0.6 - 1.2 * (f64::from(step) + 0.5) / f64::from(steps);
                    sum += lit([x * (3.0 - z), y * (3.0 - z), z]) * length * 1.2 / f64::from(steps);
                }
            }
            expected.push([(sum / f64::from(rays * rays)) as f32; 3]);
        }
        let bias = mean(&got) / mean(&expected) - 1.0;
        let error = crate::relative_rms(&got, &expected);
        assert!(
            bias.abs() < 0.02 && error < 0.2,
            "{dims}, {outer}: {bias}, {error}"
        );
    }
}

/// Nothing is gathered, and still an environment lights media directly.
#[test]
fn an_environment_lights_media_whatever_the_method() {
    let text = format!("{}{ENVIRONMENT}{}", film(16), fog(0.05, 0.9));
    let work = crate::Work::new(&text);
    std::fs::write(work.path("smoke.raw"), [1]).unwrap();
    let scene = work.scene();
    let tree = work.bake(&scene, 1);
    let [extended, traditional] = [Method::Extended, Method::Traditional].map(|method| {
        let settings = Settings { method, ..quick() };
        layer(&crate::shade(&scene, &tree, &settings), "volume")
    });
    assert!(mean(&extended) > 1e-3);
    let error = crate::relative_rms(&traditional, &extended);
    assert!(error < 0.03, "{error}");
}

#[test]
fn a_floor_under_the_sun_lights_what_faces_it() {
    // Light of 2 falls at 45 degrees onto a floor of 10 x 10 and albedo 0.5. A small tile above its
    // middle looks down at it; its shadow is elsewhere and takes away 0.3 %.
    let text = "[film]\nwidth = 16\nheight = 16\n[[camera]]\nposition = [0.1, 0.2, 0.1]\n\
                target = [0, 1, 0]\nfov_x_deg = 8\n\
                [[mesh]]\nfile = \"builtin:quad\"\nscale = 10\nalbedo = [0.5, 0.5, 0.5]\n\
                [[mesh]]\nfile = \"builtin:quad\"\nscale = 0.2\nrotate_deg = [180, 0, 0]\n\
                translate = [0, 1, 0]\nalbedo = [0.8, 0.8, 0.8]\n\
                [[light]]\ntype = \"directional\"\ndirection = [1, -1, 0]\n\
                irradiance = [2, 2, 2]\n";
    let settings = Settings {
        samples: 256,
        ..quick()
    };
    let frame = render(text, 200_000, &settings);
    assert_eq!(mean(&layer(&frame, "direct")), 0.0);
    // Form factor of a square of half side 5 at distance 1: four times that of its quarter.
    let a = 5.0_f64;
    let side = (1.0 + a * a).sqrt();
    let form_factor = 4.0 / std::f64::consts::TAU * 2.0 * (a / side) * (a / side).atan();
    let floor_exitance = 0.5 * 2.0 * 0.5_f64.sqrt();
    let expected = 0.8 * floor_exitance * form_factor / std::f64::consts::PI;
    let found = mean(&beauty(&frame));
    assert!((found / expected - 1.0).abs() < 0.01, "{found} {expected}");
}

#[test]
fn a_point_light_follows_the_inverse_square() {
    let text = "[film]\nwidth = 1\nheight = 1\n[[camera]]\nposition = [0, 3, 0]\n\
                target = [0, 0, 0]\nup = [0, 0, 1]\nfov_x_deg = 0.01\n\
                [[mesh]]\nfile = \"builtin:quad\"\nscale = 2\nalbedo = [0.5, 0.5, 0.5]\n\
                [[light]]\ntype = \"point\"\nposition = [0.6, 0.8, 0]\nintensity = [3, 3, 3]\n";
    let found = beauty(&render(text, 100, &quick()))[0][0];
    let expected = 0.5 / std::f32::consts::PI * 3.0 * 0.8;
    assert!((found / expected - 1.0).abs() < 1e-4, "{found} {expected}");
}

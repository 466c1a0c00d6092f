//! The few places that send most of a frame's light, asked as lights are.

use crate::{Work, beauty, layer, mean, relative_rms, shade, traced, with_threads};
use lvox::image::Region;
use lvox::run::Job;
use lvox::shade::{self as stage, Settings};
use lvox::tree::OpenTree;
use std::fmt::Write;

/// A closed grey room with the sun through a hole in its ceiling, a hundredth of that, and a camera
/// that is turned by an angle.
fn skylight(turned: f64) -> String {
    let mut text = format!(
        "[film]\nwidth = 64\nheight = 48\n[[camera]]\nposition = [0, 1, 0.9]\n\
         target = [{}, 0.9, -1]\nfov_x_deg = 70\n\
         [[light]]\ntype = \"directional\"\ndirection = [-0.3, -1, -0.1]\n\
         irradiance = [60, 55, 45]\n",
        1.9 * turned
    );
    let walls = [
        ("[2, 1, 2]", "[0, 0, 0]", "[0, 0, 0]"),
        ("[2, 1, 2]", "[90, 0, 0]", "[0, 1, -1]"),
        ("[2, 1, 2]", "[-90, 0, 0]", "[0, 1, 1]"),
        ("[2, 1, 2]", "[0, 0, -90]", "[-1, 1, 0]"),
        ("[2, 1, 2]", "[0, 0, 90]", "[1, 1, 0]"),
        ("[0.9, 1, 2]", "[180, 0, 0]", "[-0.55, 2, 0]"),
        ("[0.9, 1, 2]", "[180, 0, 0]", "[0.55, 2, 0]"),
        ("[0.2, 1, 0.9]", "[180, 0, 0]", "[0, 2, -0.55]"),
        ("[0.2, 1, 0.9]", "[180, 0, 0]", "[0, 2, 0.55]"),
    ];
    for (scale, rotate, translate) in walls {
        writeln!(
            text,
            "[[mesh]]\nfile = \"builtin:quad\"\nscale = {scale}\nrotate_deg = {rotate}\n\
             translate = {translate}\nalbedo = [0.5, 0.5, 0.5]"
        )
        .unwrap();
    }
    text
}

/// Settings with bright patches or without.
fn settings(bright_patches: bool) -> Settings {
    Settings {
        bright_patches,
        ..Settings::default()
    }
}

/// Beside many rays to patches as small as surfels: the root mean square difference is 0.74 of the
/// mean where rays meet the sun's spot by chance, and 0.20 where gathers ask it.
#[test]
fn sun_through_a_hole_has_less_noise_and_a_better_mean() {
    let work = Work::new(&skylight(0.0));
    let scene = work.scene();
    let tree = work.bake(&scene, 200_000);
    let indirect = |settings: &Settings| layer(&shade(&scene, &tree, settings), "indirect");
    let expected = indirect(&Settings {
        samples: 4096,
        max_solid_angle: 0.0,
        ..settings(false)
    });
    let [asked, met] = [true, false].map(|b| indirect(&settings(b)));
    let [asked_off, met_off] = [&asked, &met].map(|image| relative_rms(image, &expected));
    assert!(asked_off < 0.5 * met_off, "{asked_off} {met_off}");
    let ratio = mean(&asked) / mean(&expected);
    assert!((ratio - 1.0).abs() < 0.02, "{ratio}");
}

/// A sheet with holes where the sun falls through the skylight: what gathers leave out of their rays
/// is what is there of it, and so much is to be asked.
#[test]
fn bright_patches_send_the_light_of_what_masks_leave() {
    let checks = image::RgbaImage::from_fn(64, 64, |x, y| {
        let is_there = (x / 4 + y / 4) % 2 == 0;
        image::Rgba([255, 255, 255, if is_there { 255 } else { 60 }])
    });
    for opacity in [
        "opacity = 0.3",
        "opacity = \"checks.png\"",
        "opacity = \"checks.png\"\nopacity_cutoff = 0.5",
    ] {
        let sheet = format!(
            "[[mesh]]\nfile = \"builtin:quad\"\nscale = 0.6\ntranslate = [-0.57, 0.1, -0.19]\n\
             albedo = [0.8, 0.8, 0.8]\n{opacity}\n"
        );
        let work = Work::new(&(skylight(0.0) + &sheet));
        checks.save(work.path("checks.png")).unwrap();
        let scene = work.scene();
        let tree = work.bake(&scene, 200_000);
        let found = mean(&beauty(&shade(&scene, &tree, &settings(true))));
        let ratio = found / mean(&traced(&scene, 3, 512));
        assert!((ratio - 1.0).abs() < 0.08, "{opacity}: {ratio}");
    }
}

/// Large ones would blur the borders of bright places.
#[test]
fn near_patches_are_small_beside_bright_ones() {
    let work = Work::new(&skylight(0.0));
    let scene = work.scene();
    let tree = work.bake(&scene, 50_000);
    let off = |bright_patches| {
        let [large, small] = [64, 1].map(|patch_surfels| {
            let settings = Settings {
                patch_surfels,
                ..settings(bright_patches)
            };
            layer(&shade(&scene, &tree, &settings), "indirect")
        });
        relative_rms(&large, &small)
    };
    let [beside_bright, alone] = [true, false].map(off);
    assert!(beside_bright < 0.1 * alone, "{beside_bright} {alone}");
}

#[test]
fn frames_with_bright_patches_do_not_depend_on_threads_or_tiles() {
    let work = Work::new(&skylight(0.0));
    let scene = work.scene();
    let tree = work.bake(&scene, 50_000);
    let frame = |threads, region| {
        let store = OpenTree::open(&tree, None).unwrap();
        let run = || {
            stage::run(
                &scene,
                &store,
                &settings(true),
                region,
                &[],
                &Job::default(),
            )
        };
        layer(&with_threads(threads, run).unwrap(), "")
    };
    let whole = frame(1, Region::full(64, 48));
    assert!(frame(2, Region::full(64, 48)) == whole);
    let part = Region {
        x0: 21,
        y0: 13,
        x1: 50,
        y1: 30,
    };
    let rows = (part.y0..part.y1).flat_map(|y| {
        let row = (64 * y) as usize;
        &whole[row + part.x0 as usize..row + part.x1 as usize]
    });
    assert!(frame(2, part) == rows.copied().collect::<Vec<_>>());
}

/// A set of patches that changes makes other noise: that must not happen from one frame to the
/// next.
#[test]
fn a_camera_that_hardly_moves_finds_the_same_patches() {
    let [still, nudged] = [0.0, 1.2 / 64.0 * 0.01].map(|turned| {
        let work = Work::new(&skylight(turned));
        let scene = work.scene();
        let tree = work.bake(&scene, 50_000);
        layer(&shade(&scene, &tree, &settings(true)), "indirect")
    });
    let change = relative_rms(&still, &nudged);
    assert!(change < 0.01, "{change}");
}

#[test]
fn light_that_comes_from_all_around_or_through_media_is_met_by_rays() {
    const SUN: &str =
        "type = \"directional\"\ndirection = [-0.3, -1, -0.1]\nirradiance = [60, 55, 45]\n";
    const POINT: &str = "type = \"point\"\nposition = [0, 1, 0]\nintensity = [1, 1, 1]\n";
    const MIST: &str = "[[volume]]\nfile = \"smoke.raw\"\ndims = [16, 16, 16]\ndtype = \"u8\"\n\
                        sigma_t_scale = 0.001\nvalue_scale = 0.00392156862745098\n\
                        unitcube_to_world = [[1, 0, 0, -0.5], [0, 1, 0, 0.3], [0, 0, 1, -0.5], \
                        [0, 0, 0, 1]]\nalbedo = [0.8, 0.8, 0.8]\n";
    let sun = skylight(0.0);
    for (text, is_asked) in [
        (sun.replace(SUN, POINT), false),
        (sun.clone() + MIST, false),
        (sun, true),
    ] {
        let work = Work::new(&text);
        let scene = work.scene();
        let tree = work.bake(&scene, 50_000);
        let [with, without] = [true, false].map(|b| layer(&shade(&scene, &tree, &settings(b)), ""));
        assert_eq!(with != without, is_asked, "{text}");
    }
}

//! Light stays where walls keep it.

use crate::{Work, layer, mean, shade};
use lvox::shade::Settings;

/// A dark room, x < 0, and a bright one, both of edge 1; `between` is what divides them. Floor, ceiling and two walls are
/// one piece for both rooms, or end at what divides them.
fn rooms(between: &str, is_floor_shared: bool) -> String {
    let mut text = String::from(
        "[film]\nwidth = 48\nheight = 48\n[[camera]]\nname = \"dark\"\nposition = [-0.95, 0.5, 0.9]\n\
         target = [-0.2, 0.4, 0.1]\nfov_x_deg = 80\n[[camera]]\nname = \"bright\"\nposition = [0.95, 0.5, 0.9]\n\
         target = [0.2, 0.4, 0.1]\nfov_x_deg = 80\n",
    );
    let mut quad = |scale: [f64; 3], rotate: [i32; 3], at: [f64; 3]| {
        text += &format!(
            "[[mesh]]\nfile = \"builtin:quad\"\nscale = {scale:?}\nrotate_deg = {rotate:?}\ntranslate = {at:?}\n\
             albedo = [0.8, 0.8, 0.8]\n"
        );
    };
    let lengths: &[(f64, f64)] = if is_floor_shared {
        &[(0.0, 2.0)]
    } else {
        &[(-0.5, 1.0), (0.5, 1.0)]
    };
    for &(x, length) in lengths {
        quad([length, 1.0, 1.0], [0, 0, 0], [x, 0.0, 0.5]);
        quad([length, 1.0, 1.0], [180, 0, 0], [x, 1.0, 0.5]);
        quad([length, 1.0, 1.0], [90, 0, 0], [x, 0.5, 0.0]);
        quad([length, 1.0, 1.0], [-90, 0, 0], [x, 0.5, 1.0]);
    }
    quad([1.0; 3], [0, 0, -90], [-1.0, 0.5, 0.5]);
    quad([1.0; 3], [0, 0, 90], [1.0, 0.5, 0.5]);
    text + between
        + "[[light]]\ntype = \"point\"\nposition = [0.5, 0.8, 0.5]\nintensity = [1, 1, 1]\n"
}

const SHEET: &str = "[[mesh]]\nfile = \"builtin:quad\"\nrotate_deg = [0, 0, 90]\ntranslate = [0, 0.5, 0.5]\n\
                     albedo = [0.8, 0.8, 0.8]\n";
const WALL: &str = "[[mesh]]\nfile = \"builtin:cube\"\nscale = [0.02, 1, 1]\ntranslate = [0, 0.5, 0.5]\n\
                    albedo = [0.8, 0.8, 0.8]\n";

/// Mean and brightest indirect light of the dark room, over the mean of the bright one.
fn leak(text: &str) -> (f64, f64) {
    let work = Work::new(text);
    let scene = work.scene();
    let tree = work.bake(&scene, 100_000);
    let frame = |camera: &str| {
        let settings = Settings {
            camera: Some(camera.into()),
            ..Settings::default()
        };
        shade(&scene, &tree, &settings)
    };
    let (dark, bright) = (frame("dark"), frame("bright"));
    assert_eq!(mean(&layer(&dark, "direct")), 0.0);
    let reference = mean(&layer(&bright, "indirect"));
    let dark = layer(&dark, "indirect");
    let brightest = dark.iter().flatten().fold(0.0_f32, |a, &b| a.max(b));
    (mean(&dark) / reference, f64::from(brightest) / reference)
}

#[test]
fn a_dark_room_beside_a_bright_one_stays_dark() {
    // Direct light does not leak at all. Disks have a radius of 0.011 here. Through a sheet that has no thickness those of
    // the bright side's floor, ceiling and walls reach to the dark side where they meet the sheet: a line of a few
    // pixels gets up to a tenth of the light. They are cut at borders of the mesh, so less comes through where the floor
    // ends at the sheet. A wall as thick as two radii stops nearly all.
    for (name, text, average_limit, brightest_limit) in [
        ("sheet, own floors", rooms(SHEET, false), 1e-3, 0.2),
        ("sheet, one floor", rooms(SHEET, true), 3e-3, 0.2),
        ("wall, own floors", rooms(WALL, false), 5e-5, 5e-3),
        ("wall, one floor", rooms(WALL, true), 1e-4, 5e-3),
    ] {
        let (average, brightest) = leak(&text);
        assert!(average < average_limit, "{name}: {average:e}");
        assert!(brightest < brightest_limit, "{name}: {brightest:e}");
    }
}

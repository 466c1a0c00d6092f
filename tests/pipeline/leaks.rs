//! Light stays where walls keep it.

use crate::bounce::bounced;
use crate::support::trees;
use crate::{Work, layer, mean, shade};
use lvox::bounce::Bounces;
use lvox::build;
use lvox::shade::{Quality, Settings};

/// A `builtin:quad` of a diffuse grey.
fn quad(scale: [f64; 3], rotate: [i32; 3], at: [f64; 3]) -> String {
    format!(
        "[[mesh]]\nfile = \"builtin:quad\"\nscale = {scale:?}\nrotate_deg = {rotate:?}\n\
         translate = {at:?}\nalbedo = [0.8, 0.8, 0.8]\n"
    )
}

/// A light in the middle of the bright rooms, which are at x > 0.
const LIGHT: &str =
    "[[light]]\ntype = \"point\"\nposition = [0.5, 0.8, 0.5]\nintensity = [1, 1, 1]\n";

/// A dark room, x < 0, and a bright one, both of edge 1; `between` is what divides them. Floor,
/// ceiling and two walls are one piece for both rooms, or end at what divides them.
fn rooms(between: &str, is_floor_shared: bool) -> String {
    let mut text = String::from(
        "[film]\nwidth = 48\nheight = 48\n[[camera]]\nname = \"dark\"\n\
         position = [-0.95, 0.5, 0.9]\ntarget = [-0.2, 0.4, 0.1]\nfov_x_deg = 80\n\
         [[camera]]\nname = \"bright\"\nposition = [0.95, 0.5, 0.9]\ntarget = [0.2, 0.4, 0.1]\n\
         fov_x_deg = 80\n",
    );
    let lengths: &[(f64, f64)] = if is_floor_shared {
        &[(0.0, 2.0)]
    } else {
        &[(-0.5, 1.0), (0.5, 1.0)]
    };
    for &(x, length) in lengths {
        text += &quad([length, 1.0, 1.0], [0, 0, 0], [x, 0.0, 0.5]);
        text += &quad([length, 1.0, 1.0], [180, 0, 0], [x, 1.0, 0.5]);
        text += &quad([length, 1.0, 1.0], [90, 0, 0], [x, 0.5, 0.0]);
        text += &quad([length, 1.0, 1.0], [-90, 0, 0], [x, 0.5, 1.0]);
    }
    text += &quad([1.0; 3], [0, 0, -90], [-1.0, 0.5, 0.5]);
    text += &quad([1.0; 3], [0, 0, 90], [1.0, 0.5, 0.5]);
    text + between + LIGHT
}

/// Closed rooms of edge 1 whose walls have no thickness: a bright one with its least corner at the
/// origin and dark ones with theirs at `dark`, which touch it in an edge or a corner. The camera
/// "dark" is in the first of those.
fn boxes(dark: &[[f64; 3]]) -> String {
    let [x, y, z] = dark[0];
    let mut text = format!(
        "[film]\nwidth = 48\nheight = 48\n[[camera]]\nname = \"dark\"\nposition = {:?}\n\
         target = {:?}\nfov_x_deg = 90\n[[camera]]\nname = \"bright\"\n\
         position = [0.95, 0.4, 0.9]\ntarget = [0.2, 0.4, 0.1]\nfov_x_deg = 90\n",
        [x + 0.05, y + 0.4, z + 0.05],
        [x + 0.95, y + 0.45, z + 0.95]
    );
    for &[x, y, z] in [[0.0; 3]].iter().chain(dark) {
        let [cx, cy, cz] = [x + 0.5, y + 0.5, z + 0.5];
        text += &quad([1.0; 3], [0, 0, 0], [cx, y, cz]);
        text += &quad([1.0; 3], [180, 0, 0], [cx, y + 1.0, cz]);
        text += &quad([1.0; 3], [90, 0, 0], [cx, cy, z]);
        text += &quad([1.0; 3], [-90, 0, 0], [cx, cy, z + 1.0]);
        text += &quad([1.0; 3], [0, 0, -90], [x, cy, cz]);
        text += &quad([1.0; 3], [0, 0, 90], [x + 1.0, cy, cz]);
    }
    text + LIGHT
}

/// A wall of this thickness.
fn wall(thickness: f64) -> String {
    format!(
        "[[mesh]]\nfile = \"builtin:cube\"\nscale = [{thickness}, 1, 1]\n\
         translate = [0, 0.5, 0.5]\nalbedo = [0.8, 0.8, 0.8]\n"
    )
}

const SHEET: &str = "[[mesh]]\nfile = \"builtin:quad\"\nrotate_deg = [0, 0, 90]\n\
                     translate = [0, 0.5, 0.5]\nalbedo = [0.8, 0.8, 0.8]\n";
/// Mean and brightest indirect light of the dark room, over the mean of the bright one, on average
/// over seeds: which rays find a slit is chance, and the brightest value of one seed is up to twice
/// that.
fn leak(text: &str, quality: Quality) -> (f64, f64) {
    leak_of(
        text,
        quality,
        &build::Settings::default(),
        Bounces::Count(1),
    )
}

fn leak_of(
    text: &str,
    quality: Quality,
    of_build: &build::Settings,
    bounces: Bounces,
) -> (f64, f64) {
    const SEEDS: u64 = 8;
    let work = Work::new(text);
    let scene = work.scene();
    let surfels = trees::of_surfels(100_000);
    let mut tree = trees::built(&scene, &surfels, of_build, work.0.path(), "scene");
    if bounces != Bounces::Count(1) {
        tree = bounced(&scene, &tree, bounces, None).unwrap();
    }
    let frame = |camera: &str, seed: u64| {
        let settings = Settings {
            camera: Some(camera.into()),
            seed,
            ..Settings::of(quality)
        };
        shade(&scene, &tree, &settings)
    };
    let reference = mean(&layer(&frame("bright", 0), "indirect"));
    let (mut average, mut brightest) = (0.0, 0.0);
    for seed in 0..SEEDS {
        let dark = frame("dark", seed);
        assert_eq!(mean(&layer(&dark, "direct")), 0.0);
        let dark = layer(&dark, "indirect");
        average += mean(&dark);
        brightest += f64::from(dark.iter().flatten().fold(0.0_f32, |a, &b| a.max(b)));
    }
    let scale = 1.0 / (reference * SEEDS as f64);
    (average * scale, brightest * scale)
}

#[test]
fn a_dark_room_beside_a_bright_one_stays_dark() {
    // Direct light does not leak at all. Disks have a radius of 0.011 here. Those of the bright
    // side's floor, ceiling and walls reach to the dark side of a sheet that has no thickness, and
    // their light is left out where the sheet stands before them; what comes through is of nodes,
    // whose light is a mean over both sides. They are cut at borders of the mesh, so less comes
    // through where the floor ends at the sheet. Limits are 1.5 to 2 times what is measured; where
    // that is nothing, those of the case before.
    keeps_dark(
        Quality::Good,
        &[
            ("sheet, own floors", rooms(SHEET, false), 5e-5, 0.003),
            ("sheet, one floor", rooms(SHEET, true), 1.6e-4, 0.011),
            ("wall, own floors", rooms(&wall(0.02), false), 8e-6, 6e-4),
            ("wall, one floor", rooms(&wall(0.02), true), 8e-6, 6e-4),
        ],
    );
}

#[test]
fn walls_thinner_than_a_disk_keep_a_room_dark() {
    // A third, and a thirtieth, of the radius of a disk.
    let [third, thirtieth] = [0.0035, 0.00035].map(wall);
    keeps_dark(
        Quality::Good,
        &[
            ("3.5 mm, own floors", rooms(&third, false), 4e-5, 0.005),
            ("3.5 mm, one floor", rooms(&third, true), 1.1e-5, 0.0024),
            ("0.35 mm, own floors", rooms(&thirtieth, false), 1e-4, 0.007),
            ("0.35 mm, one floor", rooms(&thirtieth, true), 3.5e-5, 0.003),
        ],
    );
}

#[test]
fn drafts_keep_rooms_dark() {
    // Of patches as large as 32 surfels nodes tell, which do not know what stands before their
    // disks. Where that lets much in, what sends it is found to be bright, and patches are small.
    keeps_dark(
        Quality::Draft,
        &[
            ("sheet, own floors", rooms(SHEET, false), 2e-5, 0.006),
            ("sheet, one floor", rooms(SHEET, true), 1.3e-4, 0.012),
            ("wall, own floors", rooms(&wall(0.02), false), 3e-4, 0.011),
            ("wall, one floor", rooms(&wall(0.02), true), 3e-4, 0.011),
            ("3.5 mm wall", rooms(&wall(0.0035), false), 2e-5, 0.003),
            ("sheet around a light", shells(&[0.3]), 1e-6, 1e-5),
        ],
    );
}

#[test]
fn rooms_that_meet_in_an_edge_or_a_corner_keep_dark() {
    // Their walls lie in the same planes, side by side: what comes through is rounding.
    let edge = [-1.0, 0.0, -1.0];
    keeps_dark(
        Quality::Good,
        &[
            ("edge", boxes(&[edge]), 1e-18, 1e-18),
            ("corner", boxes(&[[-1.0, -1.0, -1.0]]), 1e-18, 1e-18),
            (
                "edge of four rooms",
                boxes(&[edge, [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]),
                1e-18,
                1e-18,
            ),
        ],
    );
}

/// A closed room of edge 1 around closed spheres of these diameters, a light in their middle. The
/// camera "dark" looks at walls and at the largest sphere from outside.
fn shells(diameters: &[f64]) -> String {
    let mut text = String::from(
        "[film]\nwidth = 48\nheight = 48\n[[camera]]\nname = \"dark\"\n\
         position = [0.05, 0.4, 0.05]\ntarget = [0.95, 0.6, 0.95]\nfov_x_deg = 90\n\
         [[camera]]\nname = \"bright\"\nposition = [0.5, 0.8, 0.58]\ntarget = [0.5, 0.8, 0.4]\n\
         fov_x_deg = 60\n[[mesh]]\nfile = \"builtin:cube\"\ntranslate = [0.5, 0.5, 0.5]\n\
         albedo = [0.8, 0.8, 0.8]\n",
    );
    for diameter in diameters {
        text += &format!(
            "[[mesh]]\nfile = \"builtin:sphere\"\nscale = {diameter}\ntranslate = [0.5, 0.8, 0.5]\n\
             albedo = [0.8, 0.8, 0.8]\n"
        );
    }
    text + LIGHT
}

#[test]
fn shells_around_a_light_keep_it_in() {
    // What is lit faces every way, and so does what is dark around it. With one mean for fronts and
    // backs of a node the sheet leaks 6.6e-3 on average and 0.066 at the brightest.
    keeps_dark(
        Quality::Good,
        &[
            ("sheet around a light", shells(&[0.3]), 1e-6, 1e-5),
            ("wall around a light", shells(&[0.28, 0.3]), 1e-6, 1e-5),
        ],
    );
}

/// Holds leaks of scenes, as [`leak`] has them, to limits of their mean and of their brightest
/// value.
#[track_caller]
fn keeps_dark(quality: Quality, cases: &[(&str, String, f64, f64)]) {
    for (name, text, average_limit, brightest_limit) in cases {
        let (average, brightest) = leak(text, quality);
        eprintln!("{name}: mean {average:.1e}, brightest {brightest:.1e}");
        assert!(average < *average_limit, "{name}: {average:e}");
        assert!(brightest < *brightest_limit, "{name}: {brightest:e}");
    }
}

/// Light of all bounces leaks no more than three times as much as that of one may.
#[test]
fn all_bounces_keep_rooms_dark() {
    const THREE: f64 = 3.0;
    for (name, text, average_limit, brightest_limit) in [
        (
            "sheet, own floors",
            rooms(SHEET, false),
            THREE * 5e-5,
            THREE * 0.003,
        ),
        (
            "sheet, one floor",
            rooms(SHEET, true),
            THREE * 1.6e-4,
            THREE * 0.011,
        ),
        (
            "wall, own floors",
            rooms(&wall(0.02), false),
            THREE * 8e-6,
            THREE * 6e-4,
        ),
        (
            "wall, one floor",
            rooms(&wall(0.02), true),
            THREE * 8e-6,
            THREE * 6e-4,
        ),
        (
            "sheet around a light",
            shells(&[0.3]),
            THREE * 1e-6,
            THREE * 1e-5,
        ),
    ] {
        let of_build = build::Settings::default();
        let (average, brightest) = leak_of(&text, Quality::Good, &of_build, Bounces::All);
        eprintln!("{name}, all bounces: mean {average:.1e}, brightest {brightest:.1e}");
        assert!(average < average_limit, "{name}: {average:e}");
        assert!(brightest < brightest_limit, "{name}: {brightest:e}");
    }
}

/// Nodes as large as a patch, which are those of other pages where pages are small, are lit on the
/// inside alone.
#[test]
fn shells_keep_light_in_whatever_the_size_of_pages() {
    for page_bytes in [4096, 16_384] {
        let of_build = build::Settings {
            page_bytes,
            ..build::Settings::default()
        };
        let (average, brightest) =
            leak_of(&shells(&[0.3]), Quality::Good, &of_build, Bounces::Count(1));
        assert!(
            average < 1e-6 && brightest < 1e-5,
            "{page_bytes}: {average:e} {brightest:e}"
        );
    }
}

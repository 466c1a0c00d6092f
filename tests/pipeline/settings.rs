//! Settings do what their help says, or are refused.

use crate::messages::lvox;
use crate::{ROOM, Work, layer, shade};
use lvox::shade::Settings;

#[test]
fn shadow_rays_count_at_every_ray_inside_a_pixel() {
    let work = Work::new(ROOM);
    let scene = work.scene();
    let tree = work.bake(&scene, 2000);
    let direct = |pixel_samples: u32, edge_samples: u32, shadow_rays: u32| {
        let settings = Settings {
            samples: 4,
            volume_samples: 1,
            pixel_samples,
            edge_samples,
            shadow_rays,
            ..Settings::default()
        };
        layer(&shade(&scene, &tree, &settings), "direct")
    };
    // Of pixels that have all their rays already, and of those that get more.
    for (pixel, edge) in [(4, 1), (4, 8), (1, 4)] {
        let (few, many) = (direct(pixel, edge, 1), direct(pixel, edge, 16));
        let changed = few.iter().zip(&many).filter(|(a, b)| a != b).count();
        assert!(changed > 100, "{pixel} {edge}: {changed} pixels");
    }
    // In penumbrae, more of them are nearer to the truth.
    let truth = direct(64, 1, 16);
    let error = |found: &[[f32; 3]]| -> f64 {
        let terms = found.iter().flatten().zip(truth.iter().flatten());
        terms.map(|(a, b)| f64::from(a - b).powi(2)).sum()
    };
    let (few, many) = (error(&direct(4, 1, 1)), error(&direct(4, 1, 16)));
    assert!(many < few, "{many} {few}");
}

#[test]
fn what_a_png_cannot_hold_is_refused() {
    let work = Work::new(ROOM);
    for (option, value) in [("--aov", Some("depth")), ("--float", None)] {
        let args = ["render", "none.toml", "-o", "a.png", option];
        lvox(&work, &[&args[..], value.as_slice()].concat()).refused(
            2,
            &[option, "a.png", ".exr", "hint: "],
            option,
        );
    }
}

#[test]
fn verbs_take_no_option_that_they_do_not_use() {
    let work = Work::new(ROOM);
    for (verb, option) in [
        ("build a -o b", "--seed 1"),
        ("merge a -o b", "--seed 1"),
        ("compare a b", "--seed 1"),
        ("inspect a", "--seed 1"),
        ("verify a", "--seed 1"),
        ("bake a -o b", "--memory-limit 1G"),
        ("inspect a", "--memory-limit 1G"),
        ("verify a", "--memory-limit 1G"),
        ("bake a -o b", "--temp-dir ."),
        ("shade a -t b -o c.exr", "--temp-dir ."),
        ("merge a -o b", "--temp-dir ."),
        ("compare a b", "--temp-dir ."),
        ("reference a -o b.exr", "--temp-dir ."),
    ] {
        let args: Vec<&str> = verb.split(' ').chain(option.split(' ')).collect();
        let run = lvox(&work, &args);
        assert_eq!(run.code, 2, "{args:?}");
        let unexpected = format!("unexpected argument '{}'", args[args.len() - 2]);
        assert!(run.stderr.contains(&unexpected), "{args:?}: {}", run.stderr);
    }
}

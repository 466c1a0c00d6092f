//! Groups of lights: what each sends adds up to what all send.

use crate::support::program::lvox;
use crate::{ROOM, Work, beauty, layer, mean, relative_rms, shade};
use lvox::image::exr;
use lvox::image::mix::{GroupScale, Part, mix};
use lvox::run::Job;
use lvox::scene::Scene;
use lvox::scene::load::{DEFAULT_GROUP, Settings as Reading};
use lvox::shade::Settings;
use std::path::PathBuf;

/// The room with a lamp in one group, a spot light in another, fire, and a sky in none.
fn lit_by_groups() -> String {
    let lamp = "emission = [10, 9, 7]";
    assert!(ROOM.contains(lamp));
    let room = ROOM.replace(lamp, &format!("{lamp}\ngroup = \"lamp\""));
    format!(
        "{room}
emission = {{ scale = 0.002, color = [1, 0.4, 0.1], group = \"fire\" }}

[[light]]
type = \"spot\"
position = [0.2, 1.8, 0.8]
target = [0, 0, -0.5]
intensity = [0.3, 0.5, 1]
outer_deg = 40
group = \"spot-1\"

[[light]]
type = \"environment\"
radiance = [0.2, 0.3, 0.4]
"
    )
}

fn read(work: &Work, group: Option<&str>) -> lvox::Result<Scene> {
    let reading = Reading {
        group: group.map(Into::into),
        ..Reading::default()
    };
    Scene::load_with(&work.path("scene.toml"), &reading, &Job::default())
}

#[test]
fn groups_add_up_to_the_frame_of_all_lights() {
    let work = Work::new(&lit_by_groups());
    let all = read(&work, None).unwrap();
    assert_eq!(all.groups, ["spot-1", DEFAULT_GROUP, "lamp", "fire"]);
    let settings = Settings::default();
    let whole = shade(&all, &work.bake(&all, 20_000), &settings);
    let parts = all.groups.iter().map(|group| {
        let mut scene = read(&work, Some(group)).unwrap();
        assert!(scene.warnings.is_empty(), "{:?}", scene.warnings);
        assert_ne!(scene.hash, all.hash);
        let tree = work.bake(&scene, 20_000);
        // As of a packed scene, which does not say it: its tree does.
        scene.group = None;
        let frame = shade(&scene, &tree, &settings);
        assert_eq!(frame.attributes["lvox/group"], *group);
        assert!(mean(&beauty(&frame)) > 0.0, "{group}");
        // What is seen does not depend on what lights it.
        for name in ["depth", "normal", "position"] {
            let [found, expected] = [&frame, &whole].map(|f| &f.layer(name).unwrap().channels);
            let pairs = found.iter().zip(expected);
            let mut pairs = pairs.flat_map(|(found, expected)| found.1.iter().zip(&expected.1));
            // Edges that light shows are means of other samples.
            let is_same = |(a, b): (&f32, &f32)| a == b || (a - b).abs() < 1e-6 * (1.0 + b.abs());
            assert!(pairs.all(is_same), "{group} {name}");
        }
        Part {
            path: PathBuf::from(group),
            group: Some(group.clone()),
            frame,
        }
    });
    let parts: Vec<Part> = parts.collect();
    let sum = mix(parts, &[]).unwrap();
    assert!(sum.left_out.is_empty());
    for name in ["", "direct", "indirect", "volume", "albedo"] {
        let (found, expected) = (layer(&sum.frame, name), layer(&whole, name));
        let bias = mean(&found) / mean(&expected) - 1.0;
        let noise = relative_rms(&found, &expected);
        // Vertices in smoke stand where light changes: of one group it is another light.
        let bound = if name == "volume" { 0.01 } else { 0.005 };
        assert!(bias.abs() < bound && noise < 0.05, "{name}: {bias} {noise}");
    }
}

#[test]
fn a_scene_without_the_light_of_a_group_is_dark_where_that_alone_is() {
    let text = ROOM.replace(
        "emission = [10, 9, 7]",
        "emission = [10, 9, 7]\ngroup = \"a\"",
    );
    let text = format!(
        "{text}\n[[light]]\ntype = \"point\"\nposition = [0, 1, 0]\nintensity = [0, 0, 0]\n"
    );
    let work = Work::new(&text);
    let dark = read(&work, Some(DEFAULT_GROUP)).unwrap();
    let frame = shade(&dark, &work.bake(&dark, 2000), &Settings::default());
    assert_eq!(mean(&beauty(&frame)), 0.0);
}

#[test]
fn the_program_makes_a_layer_of_each_group_and_lights_the_frame_anew() {
    let work = Work::new(&lit_by_groups());
    let run = |words: &str| lvox(work.0.path(), &words.split(' ').collect::<Vec<_>>());
    let surfels = "--surfels 5000";
    run(&format!(
        "render scene.toml --groups {surfels} --float -o all.exr"
    ))
    .done();
    let all = exr::read(&work.path("all.exr")).unwrap();
    let sum = |channel: &str| -> Vec<f32> {
        let layers = all.layers.iter().filter(|l| l.name.starts_with("light."));
        let mut sum = vec![0.0; all.region.pixels()];
        for layer in layers {
            let samples = layer.channel(channel).unwrap();
            sum.iter_mut().zip(samples).for_each(|(s, v)| *s += v);
        }
        sum
    };
    for channel in ["R", "G", "B"] {
        let beauty = all.layer("").unwrap().channel(channel).unwrap();
        for (found, expected) in sum(channel).iter().zip(beauty) {
            assert!(
                (found - expected).abs() <= 1e-6 * expected,
                "{found} {expected}"
            );
        }
    }

    // Each group by itself, as a farm makes it, is the same.
    for words in [
        format!("bake scene.toml --group lamp {surfels} -o lamp.lvc"),
        "build lamp.lvc -o lamp.lvt".into(),
        "bounce scene.toml --group lamp -t lamp.lvt -o lit.lvt".into(),
        "shade scene.toml --group lamp -t lit.lvt --float -o lamp.exr".into(),
    ] {
        let made = run(&words);
        made.done();
        assert!(!made.stderr.contains("warning"), "{}", made.stderr);
    }
    let lamp = exr::read(&work.path("lamp.exr")).unwrap();
    assert_eq!(beauty(&lamp), layer(&all, "light.lamp"));

    run("mix all.exr --group-scale lamp=0 --group-scale fire=2,1,1 --float -o lit.exr").done();
    let lit = exr::read(&work.path("lit.exr")).unwrap();
    let part = Part {
        path: PathBuf::from("all.exr"),
        group: None,
        frame: all,
    };
    let scales = ["lamp=0", "fire=2,1,1"].map(|s| s.parse::<GroupScale>().unwrap());
    assert_eq!(
        beauty(&lit),
        beauty(&mix(vec![part], &scales).unwrap().frame)
    );
}

#[test]
fn a_wrong_group_is_named_with_those_that_there_are() {
    let work = Work::new(&lit_by_groups());
    let error = read(&work, Some("lamb")).unwrap_err().to_string();
    for word in ["scene.toml", "lamb", "spot-1, default, lamp, fire"] {
        assert!(error.contains(word), "{error}");
    }
    for name in ["default", "", "a.b", "key light"] {
        let text = lit_by_groups().replace("\"lamp\"", &format!("\"{name}\""));
        let error = read(&Work::new(&text), None).unwrap_err().to_string();
        assert!(error.contains("letters, digits"), "{error}");
    }
}

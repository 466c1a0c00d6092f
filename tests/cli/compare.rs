//! `lvox compare`.

use super::{HEIGHT, WIDTH, shade, write_tiles, write_whole};
use crate::support::program::lvox;
use lvox::image::exr::{self, Precision};
use lvox::image::{Frame, Layer, Region};
use std::fs;

#[test]
fn compare_speaks_json_and_tables() {
    let dir = tempfile::tempdir().unwrap();
    write_whole(dir.path(), "a.exr");
    let mut frame = shade(Region::full(WIDTH, HEIGHT), "0");
    for (_, samples) in &mut frame.layers[0].channels {
        samples.iter_mut().for_each(|v| *v *= 1.5);
    }
    exr::write(&dir.path().join("b.exr"), &frame, Precision::Float).unwrap();

    let run = lvox(
        dir.path(),
        &[
            "compare",
            "b.exr",
            "a.exr",
            "--json",
            "--heatmap",
            "heat.png",
        ],
    );
    assert_eq!((run.code, run.stderr.as_str()), (0, ""));
    let json: serde_json::Value = serde_json::from_str(&run.stdout).unwrap();
    for key in [
        "rmse",
        "relmse",
        "relmse_trimmed",
        "bias",
        "grain",
        "flip",
        "ssim",
        "pdiff",
        "max_abs",
    ] {
        assert!(json[key].is_f64(), "{key}");
    }
    assert!((json["bias"].as_f64().unwrap() - 0.5).abs() < 1e-6);
    assert!((0.0..=1.0).contains(&json["pdiff"].as_f64().unwrap()));
    assert!(
        fs::read(dir.path().join("heat.png"))
            .unwrap()
            .starts_with(b"\x89PNG")
    );

    // Half of the mean more, everywhere.
    assert!((json["relmae"].as_f64().unwrap() - 0.5).abs() < 1e-6);
    assert!(json.get("worst").is_none());

    let run = lvox(dir.path(), &["compare", "a.exr", "a.exr"]);
    assert_eq!(run.code, 0);
    let value = |name: &str| {
        let line = run
            .stdout
            .lines()
            .find(|l| l.split_whitespace().next() == Some(name));
        line.and_then(|l| l.split_whitespace().nth(1)?.parse::<f64>().ok())
    };
    assert_eq!(
        (value("rmse"), value("flip"), value("ssim")),
        (Some(0.0), Some(0.0), Some(1.0))
    );
}

#[test]
fn compare_warns_of_images_that_do_not_show_the_same() {
    let dir = tempfile::tempdir().unwrap();
    let write = |name: &str, attributes: &[(&str, &str)]| {
        let mut frame = shade(Region::full(WIDTH, HEIGHT), "00ff");
        let owned = attributes
            .iter()
            .map(|(n, v)| (format!("lvox/{n}"), (*v).into()));
        frame.attributes.extend(owned);
        exr::write(&dir.path().join(name), &frame, Precision::Half).unwrap();
    };
    write(
        "a.exr",
        &[("scene", "aaaa"), ("settings", r#"{"samples":1}"#)],
    );
    write(
        "b.exr",
        &[("scene", "bbbb"), ("settings", r#"{"max_depth":0}"#)],
    );
    write("plain.exr", &[]);
    let run = lvox(dir.path(), &["compare", "a.exr", "b.exr"]);
    assert_eq!(run.code, 0);
    for part in ["warning: a.exr and b.exr", "aaaa… and bbbb…", "any length"] {
        assert!(run.stderr.contains(part), "{part}: {}", run.stderr);
    }
    for other in ["a.exr", "plain.exr"] {
        let run = lvox(dir.path(), &["compare", "a.exr", other]);
        assert_eq!((run.code, run.stderr.as_str()), (0, ""));
    }
}

#[test]
fn compare_has_no_number_for_what_has_no_value() {
    let dir = tempfile::tempdir().unwrap();
    let mut black = Frame::new(1, 1, Region::full(1, 1));
    black.layers.push(Layer::rgb("", &[[0.0; 3]]));
    exr::write(&dir.path().join("black.exr"), &black, Precision::Half).unwrap();
    let args = ["compare", "black.exr", "black.exr", "--worst", "1"];
    let run = lvox(dir.path(), &args);
    assert_eq!((run.code, run.stderr.as_str()), (0, ""));
    for name in ["bias", "ssim"] {
        let line = run.stdout.lines().find(|l| l.starts_with(name)).unwrap();
        assert_eq!(line.split_whitespace().nth(1), Some("-"), "{line}");
    }
    assert!(!run.stdout.contains("NaN") && !run.stdout.contains("inf"));
    let run = lvox(dir.path(), &[&args[..], &["--json"]].concat());
    let json: serde_json::Value = serde_json::from_str(&run.stdout).unwrap();
    assert!(json["bias"].is_null() && json["ssim"].is_null() && json["rmse"] == 0.0);
}

#[test]
fn compare_lists_the_worst_blocks_of_a_layer() {
    let dir = tempfile::tempdir().unwrap();
    write_whole(dir.path(), "a.exr");
    let mut frame = shade(Region::full(WIDTH, HEIGHT), "0");
    let layer = |frame: &mut Frame, name: &str, light: f32| {
        let mut pixels = vec![[0.5; 3]; (WIDTH * HEIGHT) as usize];
        pixels[(20 * WIDTH + 18) as usize] = [0.5, 0.5, 0.5 + light];
        frame.layers.push(Layer::rgb(name, &pixels));
    };
    layer(&mut frame, "indirect", 0.0);
    exr::write(&dir.path().join("c.exr"), &frame, Precision::Float).unwrap();
    frame.layers.pop();
    layer(&mut frame, "indirect", 0.75);
    exr::write(&dir.path().join("d.exr"), &frame, Precision::Float).unwrap();

    let args = ["compare", "d.exr", "c.exr", "--layer", "indirect"];
    let run = lvox(
        dir.path(),
        &[
            &args[..],
            &["--worst", "1", "--region", "2", "4", "40", "32", "--json"],
        ]
        .concat(),
    );
    assert_eq!((run.code, run.stderr.as_str()), (0, ""));
    let json: serde_json::Value = serde_json::from_str(&run.stdout).unwrap();
    let block = &json["worst"][0];
    let corner = ["x0", "y0", "x1", "y1"].map(|k| block[k].as_u64().unwrap());
    assert_eq!(corner, [18, 20, 34, 32]);
    assert!((block["error"].as_f64().unwrap() - 0.75 / (3.0 * 16.0 * 12.0)).abs() < 1e-7);
    let run = lvox(dir.path(), &[&args[..], &["--worst", "2"]].concat());
    let last = run.stdout.lines().rev().nth(1).unwrap();
    let corner: Vec<&str> = last.split_whitespace().take(4).collect();
    assert_eq!(corner, ["16", "16", "32", "32"]);
    lvox(
        dir.path(),
        &["compare", "a.exr", "a.exr", "--layer", "indirekt"],
    )
    .refused(2, &["indirekt.R"]);
}

#[test]
fn the_exposure_comes_from_the_scene_of_the_reference() {
    let dir = tempfile::tempdir().unwrap();
    write_whole(dir.path(), "S_d3.exr");
    let exposure = |args: &[&str]| {
        let run = lvox(
            dir.path(),
            &[&["compare", "S_d3.exr", "S_d3.exr", "--json"], args].concat(),
        );
        let json: serde_json::Value = serde_json::from_str(&run.stdout).unwrap();
        json["exposure"].as_f64().unwrap()
    };
    assert_eq!(exposure(&[]), 1.0);
    fs::write(dir.path().join("S_d3.json"), r#"{"scene": "S.json"}"#).unwrap();
    fs::write(
        dir.path().join("S.json"),
        r#"{"tonemap": {"exposure": 2.5}}"#,
    )
    .unwrap();
    assert_eq!(exposure(&[]), 2.5);
    assert_eq!(exposure(&["--exposure", "4"]), 4.0);
}

#[test]
fn the_exposure_is_noted_in_what_lvox_renders() {
    let dir = tempfile::tempdir().unwrap();
    fs::write(
        dir.path().join("s.toml"),
        "[film]\nwidth = 4\nheight = 3\nexposure = 0.35\n\
         [[camera]]\nname = \"front\"\nposition = [0, 0, 3]\ntarget = [0, 0, 0]\n\
         [[mesh]]\nfile = \"builtin:quad\"\nemission = [1, 1, 1]\n",
    )
    .unwrap();
    let reference = ["reference", "s.toml", "--spp", "1", "-o", "r.exr"];
    let run = lvox(dir.path(), &reference);
    assert_eq!(run.code, 0, "{}", run.stderr);
    let run = lvox(dir.path(), &["render", "s.toml", "-o", "a.exr"]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    // One that tells nothing, as big.
    let png = ["render", "s.toml", "-o", "a.png"];
    assert_eq!(lvox(dir.path(), &png).code, 0);
    // A side-car that names the scene as it was rendered.
    fs::write(dir.path().join("r.json"), r#"{"scene": "s.toml"}"#).unwrap();
    for pair in [["a.png", "r.exr"], ["a.exr", "a.png"], ["a.exr", "r.exr"]] {
        let run = lvox(dir.path(), &["compare", pair[0], pair[1], "--json"]);
        assert_eq!(run.code, 0, "{pair:?}: {}", run.stderr);
        let json: serde_json::Value = serde_json::from_str(&run.stdout).unwrap();
        assert!(
            (json["exposure"].as_f64().unwrap() - 0.35).abs() < 1e-6,
            "{pair:?}"
        );
    }
}

#[test]
fn compare_refuses_what_does_not_fit() {
    let dir = tempfile::tempdir().unwrap();
    write_whole(dir.path(), "a.exr");
    write_tiles(dir.path(), 2);
    lvox(dir.path(), &["compare", "a.exr", "no.exr"]).refused(2, &["no.exr"]);
    lvox(dir.path(), &["compare", ".", "a.exr"]).refused(2, &["."]);

    let mut small = Frame::new(8, 8, Region::full(8, 8));
    small.layers.push(Layer::rgb("", &[[0.5; 3]; 64]));
    exr::write(&dir.path().join("small.exr"), &small, Precision::Half).unwrap();
    lvox(dir.path(), &["compare", "small.exr", "a.exr"]).refused(2, &["8x8", "40x32", "small.exr"]);

    let run = lvox(dir.path(), &["compare", "tile1.exr", "a.exr"]);
    run.refused(2, &["tile1.exr", "hint: ", "--region"]);
    let region = Region::tile(WIDTH, HEIGHT, 1, 2).unwrap().to_string();
    let mut args = vec!["compare", "tile1.exr", "a.exr", "--region"];
    args.extend(region.split(' '));
    assert_eq!(lvox(dir.path(), &args).code, 0);
}

#[test]
fn images_go_by_their_first_bytes_and_not_by_their_names() {
    let dir = tempfile::tempdir().unwrap();
    write_whole(dir.path(), "image");
    fs::write(dir.path().join("text.exr"), "no image").unwrap();
    for verb in ["inspect", "verify"] {
        let run = lvox(dir.path(), &[verb, "image", "--json"]);
        assert_eq!(run.code, 0, "{}", run.stderr);
        let json: serde_json::Value = serde_json::from_str(&run.stdout).unwrap();
        assert_eq!(json["kind"], "image");
        lvox(dir.path(), &[verb, "text.exr"]).refused(2, &["text.exr"]);
    }
}

//! A scene far from the origin is moved to it; what is added to the scene moves it elsewhere, a
//! tree stays where it is.

use crate::messages::lvox;
use crate::{Work, layer, mean, shade};
use lvox::image::Region;
use lvox::run::Job;
use lvox::scene::Scene;
use lvox::shade::{Kernel, Settings};
use lvox::tree::OpenTree;
use std::fmt::Write;
use std::fs;

/// A room at x = 1000, the middle of its floor there, and what is added.
fn room(added: &str) -> String {
    let mut text = String::from(
        "[film]\nwidth = 48\nheight = 36\n[[camera]]\nposition = [1000, 1, 3.9]\n\
         target = [1000, 1, 0]\nfov_x_deg = 40\n",
    );
    for (file, scale, turn, at, albedo, emission) in [
        ("quad", "2", "[0, 0, 0]", "[1000, 0, 0]", 0.7, 0.0),
        ("quad", "2", "[180, 0, 0]", "[1000, 2, 0]", 0.7, 0.0),
        ("quad", "2", "[90, 0, 0]", "[1000, 1, -1]", 0.7, 0.0),
        ("quad", "2", "[0, 0, -90]", "[999, 1, 0]", 0.6, 0.0),
        ("cube", "0.5", "[0, 20, 0]", "[1000.4, 0.25, 0]", 0.6, 0.0),
        ("quad", "0.5", "[180, 0, 0]", "[1000, 1.98, 0]", 0.0, 9.0),
    ] {
        let _ = writeln!(
            text,
            "[[mesh]]\nfile = \"builtin:{file}\"\nscale = {scale}\nrotate_deg = {turn}\n\
             translate = {at}\nalbedo = [{albedo}, {albedo}, {albedo}]\n\
             emission = [{emission}, {emission}, {emission}]"
        );
    }
    text + added
}

const CUBE: &str = "[[mesh]]\nfile = \"builtin:cube\"\nscale = 0.3\ntranslate = [1003, 0.2, -2]\n";

#[test]
fn a_tree_serves_a_scene_that_grew() {
    let work = Work::new(&room(""));
    let old = work.scene();
    let tree = work.bake(&old, 20_000);
    fs::write(work.path("scene.toml"), room(CUBE)).unwrap();
    let grown = work.scene();
    assert_ne!(old.world_from_scene, grown.world_from_scene);

    let store = OpenTree::open(&tree, None).unwrap();
    let region = Region::full(48, 36);
    let refused = lvox::shade::run(
        &grown,
        &store,
        &Settings::default(),
        region,
        &[],
        &Job::default(),
    );
    let error = refused.unwrap_err().to_string();
    assert!(error.contains("frame"), "{error}");

    let indirect = |scene: &Scene, settings: &Settings| {
        mean(&layer(&shade(scene, &tree, settings), "indirect"))
    };
    let frame = old.world_from_scene;
    let grown = grown.in_frame(frame).unwrap();
    for kernel in [Kernel::Traced, Kernel::Cone] {
        let settings = Settings {
            kernel,
            ..Settings::default()
        };
        let (before, after) = (indirect(&old, &settings), indirect(&grown, &settings));
        assert!((after / before - 1.0).abs() < 0.01, "{before} {after}");
    }
    let run = lvox(
        &work,
        &["shade", "scene.toml", "--tree", "scene.lvt", "-o", "a.exr"],
    );
    assert_eq!(run.code, 0, "{}", run.stderr);

    // Moved as a whole.
    fs::write(
        work.path("scene.toml"),
        room("").replace("1000", "90000").replace("999,", "89999,"),
    )
    .unwrap();
    let run = lvox(
        &work,
        &["shade", "scene.toml", "--tree", "scene.lvt", "-o", "b.exr"],
    );
    run.refused(2, &["from where the tree was baked", "bake it again"]);
}

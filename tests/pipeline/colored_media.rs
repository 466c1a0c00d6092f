//! Media whose extinction differs by channel: each channel is that of a grey medium of its own.

use crate::support::program::lvox;
use crate::{ROOM, Work, beauty, shade};
use lvox::shade::Settings;

/// The room with a denser medium of such extinctions.
fn room(sigma_t_scale: &str) -> String {
    let start = ROOM.find("sigma_t_scale = ").expect("there is a medium");
    let end = start + ROOM[start..].find('\n').expect("the line ends");
    format!(
        "{}sigma_t_scale = {sigma_t_scale}{}",
        &ROOM[..start],
        &ROOM[end..]
    )
}

/// The channels of a frame, and their means.
fn channels(sigma_t_scale: &str) -> [Vec<f32>; 3] {
    let work = Work::new(&room(sigma_t_scale));
    let scene = work.scene();
    let frame = shade(&scene, &work.bake(&scene, 20_000), &Settings::default());
    let pixels = beauty(&frame);
    std::array::from_fn(|c| pixels.iter().map(|p| p[c]).collect())
}

#[test]
fn each_channel_is_that_of_a_grey_medium() {
    const SCALES: [f32; 3] = [12.0, 4.0, 1.5];
    let colored = channels("[12, 4, 1.5]");
    for (c, scale) in SCALES.into_iter().enumerate() {
        let grey = &channels(&scale.to_string())[c];
        let mean = |values: &[f32]| values.iter().sum::<f32>() / values.len() as f32;
        let (found, expected) = (mean(&colored[c]), mean(grey));
        assert!(
            (found / expected - 1.0).abs() < 0.015,
            "{c}: {found} {expected}"
        );
        let squares = colored[c].iter().zip(grey).map(|(a, b)| (a - b).powi(2));
        let rms = (squares.sum::<f32>() / grey.len() as f32).sqrt();
        assert!(rms < 0.08 * expected, "{c}: {rms} {expected}");
    }
}

#[test]
fn bounces_that_are_left_out_are_told_and_asked_for_refused() {
    let work = Work::new(&room("[12, 4, 1.5]"));
    let run = |words: &str| lvox(work.0.path(), &words.split(' ').collect::<Vec<_>>());
    let told = run("render scene.toml --surfels 2000 -o image.exr");
    told.done();
    let warning = "bounces but the first are left out: the extinction of the volume";
    assert!(told.stderr.contains(warning), "{}", told.stderr);
    run("render scene.toml --surfels 2000 --bounces all -o more.exr")
        .refused(2, &["differs by channel", "--bounces 1"]);
    // A job on a farm has no task that would fail.
    let farm = |more: &str| run(&format!("farm commands scene.toml -o image.exr{more}"));
    let told = farm("");
    assert_eq!(told.code, 0, "{}", told.stderr);
    assert!(told.stderr.contains(warning), "{}", told.stderr);
    assert!(told.stdout.contains("lvox build") && !told.stdout.contains("lvox bounce"));
    farm(" --bounces all").refused(2, &["differs by channel", "--bounces 1"]);
}

//! Media whose extinction differs by channel: each channel is that of a grey medium of its own.

use crate::{ROOM, Work, beauty, shade};
use lvox::bounce::{self, Bounces};
use lvox::formats::Overwrite;
use lvox::run::Job;
use lvox::scene::Scene;
use lvox::shade::Settings;
use lvox::tree::OpenTree;
use rayon::ThreadPoolBuilder;
use std::fs;
use std::path::PathBuf;

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

/// The channels of a frame of one bounce or of all.
fn channels(sigma_t_scale: &str, bounces: Bounces) -> [Vec<f32>; 3] {
    let work = Work::new(&room(sigma_t_scale));
    let scene = work.scene();
    let tree = bounced(&work, &scene, bounces, &Job::default());
    let pixels = beauty(&shade(&scene, &tree, &Settings::default()));
    std::array::from_fn(|c| pixels.iter().map(|p| p[c]).collect())
}

/// A tree with the light of so many bounces.
fn bounced(work: &Work, scene: &Scene, bounces: Bounces, job: &Job) -> PathBuf {
    let tree = work.bake(scene, 20_000);
    let output = work.path("bounced.lvt");
    let settings = bounce::Settings {
        bounces,
        ..bounce::Settings::default()
    };
    let store = OpenTree::open(&tree, job.memory_limit).unwrap();
    bounce::run(scene, &store, &output, &settings, Overwrite::Replace, job).unwrap();
    output
}

fn each_channel_is_that_of_a_grey_medium(bounces: Bounces) {
    const SCALES: [f32; 3] = [12.0, 4.0, 1.5];
    let colored = channels("[12, 4, 1.5]", bounces);
    for (c, scale) in SCALES.into_iter().enumerate() {
        let grey = &channels(&scale.to_string(), bounces)[c];
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
fn each_channel_of_one_bounce_is_that_of_a_grey_medium() {
    each_channel_is_that_of_a_grey_medium(Bounces::Count(1));
}

#[test]
fn each_channel_of_some_bounces_is_that_of_a_grey_medium() {
    each_channel_is_that_of_a_grey_medium(Bounces::Count(3));
}

#[test]
fn each_channel_of_all_bounces_is_that_of_a_grey_medium() {
    each_channel_is_that_of_a_grey_medium(Bounces::All);
}

#[test]
fn all_bounces_have_the_same_bytes_within_any_limit() {
    let work = Work::new(&room("[12, 4, 1.5]"));
    let scene = work.scene();
    let free = fs::read(bounced(&work, &scene, Bounces::All, &Job::default())).unwrap();
    let job = Job {
        memory_limit: Some(64 << 20),
        ..Job::default()
    };
    let pool = ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let limited = pool.install(|| bounced(&work, &scene, Bounces::All, &job));
    assert!(fs::read(limited).unwrap() == free);
}

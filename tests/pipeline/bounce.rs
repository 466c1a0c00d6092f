//! Trees with the light of every bounce.

use crate::support::program::lvox;
use crate::support::random::Random;
use crate::{Work, beauty, mean, shade, with_threads};
use lvox::bounce::{self, Bounces, Settings};
use lvox::formats::{Overwrite, Tree};
use lvox::run::Job;
use lvox::scene::Scene;
use lvox::tree::OpenTree;
use lvox::{Kind, Result, shade as frames};
use std::fs;
use std::path::{Path, PathBuf};

/// A closed room whose walls have an albedo and emit 1, seen from inside.
pub fn closed_room(albedo: f64) -> String {
    let mut text = String::from(
        "[film]\nwidth = 16\nheight = 16\n[[camera]]\nposition = [0.1, 0.05, 0.4]\n\
         target = [0, 0, 0]\nfov_x_deg = 90\n",
    );
    let walls = [
        ([0, 0, 0], [0.0, -0.5, 0.0]),
        ([180, 0, 0], [0.0, 0.5, 0.0]),
        ([90, 0, 0], [0.0, 0.0, -0.5]),
        ([-90, 0, 0], [0.0, 0.0, 0.5]),
        ([0, 0, -90], [-0.5, 0.0, 0.0]),
        ([0, 0, 90], [0.5, 0.0, 0.0]),
    ];
    for (rotate, translate) in walls {
        text += &format!(
            "[[mesh]]\nfile = \"builtin:quad\"\nscale = 1\nrotate_deg = {rotate:?}\n\
             translate = {translate:?}\nalbedo = [{albedo}, {albedo}, {albedo}]\n\
             emission = [1, 1, 1]\n"
        );
    }
    text
}

/// The tree with more light beside another one.
pub fn bounced(
    scene: &Scene,
    tree: &Path,
    bounces: Bounces,
    limit: Option<u64>,
) -> Result<PathBuf> {
    let settings = Settings {
        bounces,
        ..Settings::default()
    };
    let path = tree.with_file_name(format!("bounced-{bounces}.lvt"));
    let store = OpenTree::open(tree, limit)?;
    let job = Job {
        memory_limit: limit,
        ..Job::default()
    };
    bounce::run(scene, &store, &path, &settings, Overwrite::Replace, &job)?;
    Ok(path)
}

#[test]
fn light_in_a_closed_room_is_a_geometric_series() {
    // Emission counts as no bounce, its reflection as direct light.
    for (albedo, bounces, limit) in [
        (0.5, Bounces::All, 0.002),
        (0.8, Bounces::All, 0.005),
        (0.9, Bounces::All, 0.01),
        (0.99, Bounces::All, 0.05),
        (0.8, Bounces::Count(1), 0.005),
        (0.8, Bounces::Count(2), 0.005),
        (0.8, Bounces::Count(5), 0.005),
    ] {
        let work = Work::new(&closed_room(albedo));
        let scene = work.scene();
        let tree = work.bake(&scene, 30_000);
        let tree = bounced(&scene, &tree, bounces, None).unwrap();
        let left = match bounces {
            Bounces::All => 0.0,
            Bounces::Count(n) => albedo.powi(n as i32 + 2),
        };
        let expected = (1.0 - left) / (1.0 - albedo);
        let found = mean(&beauty(&shade(&scene, &tree, &frames::Settings::default())));
        assert!(
            (found / expected - 1.0).abs() < limit,
            "{albedo} {bounces}: {found} beside {expected}"
        );
    }
}

/// Smoke that takes no light changes nothing in a room whose walls all shine, and its box ends
/// right on these.
#[test]
fn smoke_that_takes_nothing_may_fill_a_closed_room() {
    let text = format!(
        "{}[[volume]]\nfile = \"full.raw\"\ndims = [8, 8, 8]\ndtype = \"u8\"\nvalue_scale = 0.004\n\
         sigma_t_scale = 3\nalbedo = [1, 1, 1]\nunitcube_to_world = [[1, 0, 0, -0.5], \
         [0, 1, 0, -0.5], [0, 0, 1, -0.5], [0, 0, 0, 1]]\n",
        closed_room(0.8)
    );
    let work = Work::new(&text);
    fs::write(work.path("full.raw"), [250; 512]).unwrap();
    let scene = work.scene();
    let tree = work.bake(&scene, 30_000);
    let tree = bounced(&scene, &tree, Bounces::All, None).unwrap();
    let found = mean(&beauty(&shade(&scene, &tree, &frames::Settings::default())));
    assert!((found / 5.0 - 1.0).abs() < 0.01, "{found}");
}

/// Smoke in two parts, each of its own albedo, is lit as smoke of both of them together: it is 5 %
/// darker, and was 21 % where each part was lit by itself.
#[test]
fn volumes_on_one_grid_light_each_other() {
    let picture = |parts: &[(f32, f32)]| {
        let mut text = String::from(
            "[film]\nwidth = 24\nheight = 18\n[[camera]]\nposition = [0, 0, 3]\n\
             target = [0, 0, 0]\nfov_x_deg = 24\n[[light]]\ntype = \"directional\"\n\
             direction = [0.2, -1, 0.3]\nirradiance = [3, 3, 3]\n",
        );
        for (sigma_t, albedo) in parts {
            text += &format!(
                "[[volume]]\nfile = \"full.raw\"\ndims = [16, 16, 16]\ndtype = \"u8\"\n\
                 value_scale = 0.004\nsigma_t_scale = {sigma_t}\n\
                 albedo = [{albedo}, {albedo}, {albedo}]\n\
                 unitcube_to_world = [[1, 0, 0, -0.5], [0, 1, 0, -0.5], [0, 0, 1, -0.5], \
                 [0, 0, 0, 1]]\n"
            );
        }
        let work = Work::new(&text);
        fs::write(work.path("full.raw"), [250; 4096]).unwrap();
        let scene = work.scene();
        let tree = work.bake(&scene, 1000);
        let tree = bounced(&scene, &tree, Bounces::All, None).unwrap();
        beauty(&shade(&scene, &tree, &frames::Settings::default()))
    };
    let one = picture(&[(8.0, 0.9)]);
    let two = picture(&[(5.0, 0.96), (3.0, 0.8)]);
    let [of_one, of_two] = [&one, &two].map(|picture| mean(picture));
    assert!(
        (of_two / of_one - 1.0).abs() < 0.08,
        "{of_two} beside {of_one}"
    );
}

#[test]
fn parts_of_a_cloud_that_lie_side_by_side_are_told() {
    let warnings = |offsets: &[f64], bounces: Bounces| {
        let mut text = String::from(
            "[film]\nwidth = 4\nheight = 4\n[[camera]]\nposition = [0, 0, 3]\ntarget = [0, 0, 0]\n\
             fov_x_deg = 24\n[[light]]\ntype = \"environment\"\nradiance = [1, 1, 1]\n",
        );
        for (i, offset) in offsets.iter().enumerate() {
            text += &format!(
                "[[volume]]\nname = \"part {i}\"\nfile = \"full.raw\"\ndims = [8, 8, 8]\n\
                 dtype = \"u8\"\nvalue_scale = 0.004\nsigma_t_scale = 2\nalbedo = [0.8, 0.8, 0.8]\n\
                 unitcube_to_world = [[1, 0, 0, {offset}], [0, 1, 0, 0], [0, 0, 1, 0], \
                 [0, 0, 0, 1]]\n"
            );
        }
        let work = Work::new(&text);
        fs::write(work.path("full.raw"), [250; 512]).unwrap();
        let scene = work.scene();
        let tree = work.bake(&scene, 1000);
        let store = OpenTree::open(&tree, None).unwrap();
        let settings = Settings {
            bounces,
            ..Settings::default()
        };
        let (job, path) = (Job::default(), work.path("bounced.lvt"));
        bounce::run(&scene, &store, &path, &settings, Overwrite::Replace, &job).unwrap();
        job.progress.warnings()
    };
    let [told] = &warnings(&[0.0, 3.0, 0.9], Bounces::All)[..] else {
        panic!("expected one warning");
    };
    assert!(told.contains("\"part 0\" and \"part 2\""), "{told}");
    assert_eq!(warnings(&[0.0, 1.0], Bounces::Count(1)), [""; 0]);
    // Apart, and in each other.
    assert_eq!(warnings(&[0.0, 1.4, -0.01], Bounces::All), [""; 0]);
}

/// A convex body under a sky sends all of its light away: there is nothing to bounce.
#[test]
fn a_sky_is_reflected_once() {
    let text = "[film]\nwidth = 16\nheight = 12\n[[camera]]\nposition = [2, 1.5, 3]\n\
                target = [0, 0, 0]\nfov_x_deg = 40\n[[mesh]]\nfile = \"builtin:cube\"\n\
                albedo = [0.5, 0.6, 0.7]\n\
                [[light]]\ntype = \"environment\"\nradiance = [2, 1, 0.5]\n";
    let work = Work::new(text);
    let scene = work.scene();
    let old = work.bake(&scene, 5000);
    let new = bounced(&scene, &old, Bounces::All, None).unwrap();
    let [old, new] = [old, new].map(|path| Tree::open_path(&path).unwrap());
    for (old, new) in old.summary().sums.flux.iter().zip(new.summary().sums.flux) {
        assert!(*old > 0.0 && (new / old - 1.0).abs() < 1e-3, "{old} {new}");
    }
}

/// Radiance that a cube of edge 1, albedo 0.9 and this extinction sends from the middle of its
/// front in the light of a sun: paths of any length, each lit at all of its points.
fn sent_by_a_cube(sigma_t: f32, sun: [f32; 3]) -> f64 {
    const PATHS: u32 = 100_000;
    let far = |p: [f32; 3], d: [f32; 3]| {
        let along = (0..3).map(|a| (0.5_f32.copysign(d[a]) - p[a]) / d[a]);
        along.fold(f32::INFINITY, f32::min)
    };
    let mut random = Random(1);
    let mut sum = 0.0;
    for _ in 0..PATHS {
        let (mut point, mut direction) = ([0.0, 0.0, 0.5], [0.0, 0.0, -1.0]);
        let mut weight = 0.9;
        loop {
            let free = -(1.0 - random.unit()).ln() / sigma_t;
            if free >= far(point, direction) {
                break;
            }
            point = std::array::from_fn(|a| point[a] + free * direction[a]);
            let lit = (-sigma_t * far(point, sun.map(|c| -c))).exp();
            sum += weight * f64::from(lit) / 4.0;
            weight *= 0.9;
            direction = random.direction();
        }
    }
    sum / f64::from(PATHS)
}

/// Next to a hard edge light rises in a curve that few points do not tell.
#[test]
fn media_are_as_bright_behind_a_hard_edge_as_paths_say() {
    for sigma_t in [4.0_f32, 8.0] {
        let text = format!(
            "[film]\nwidth = 9\nheight = 9\n[[camera]]\nposition = [0, 0, 3]\ntarget = [0, 0, 0]\n\
             fov_x_deg = 1\n[[light]]\ntype = \"directional\"\ndirection = [0.6, 0, -0.8]\n\
             irradiance = [{0}, {0}, {0}]\n\
             [[volume]]\nfile = \"smoke.raw\"\ndims = [24, 24, 24]\ndtype = \"u8\"\n\
             sigma_t_scale = {sigma_t}\nalbedo = [0.9, 0.9, 0.9]\n\
             unitcube_to_world = [[1, 0, 0, -0.5], [0, 1, 0, -0.5], [0, 0, 1, -0.5], \
             [0, 0, 0, 1]]\n",
            std::f32::consts::PI
        );
        let work = Work::new(&text);
        fs::write(work.path("smoke.raw"), vec![1_u8; 24 * 24 * 24]).unwrap();
        let scene = work.scene();
        let tree = work.bake(&scene, 1);
        let tree = bounced(&scene, &tree, Bounces::All, None).unwrap();
        let found = mean(&beauty(&shade(&scene, &tree, &frames::Settings::default())));
        let expected = sent_by_a_cube(sigma_t, [0.6, 1e-6, -0.8]);
        assert!(
            (found / expected - 1.0).abs() < 0.02,
            "sigma_t {sigma_t}: {found}, expected {expected}"
        );
    }
}

#[test]
fn one_bounce_leaves_a_tree_as_it_is() {
    let work = Work::new(crate::ROOM);
    let scene = work.scene();
    let old = work.bake(&scene, 20_000);
    let new = bounced(&scene, &old, Bounces::Count(1), None).unwrap();
    let [old, new] = [old, new].map(|path| Tree::open_path(&path).unwrap());
    new.verify().unwrap();
    assert_eq!(old.surfel_pages(), new.surfel_pages());
    for i in 0..old.surfel_pages() {
        let (mut a, mut b) = (old.surfel_page(i).unwrap(), new.surfel_page(i).unwrap());
        assert_eq!(a.surfels, b.surfels);
        for (a, b) in a.nodes.iter_mut().zip(&mut b.nodes) {
            let light = |n: &lvox::formats::Node| {
                let a = &n.aggregate;
                [a.axis_radiance, a.back_radiance].concat().concat()
            };
            for (a, b) in light(a).into_iter().zip(light(b)) {
                assert!((a - b).abs() <= 0.01 * a + 1e-3, "{a} {b}");
            }
            for node in [a, b] {
                node.aggregate.axis_radiance = [[0.0; 3]; 6];
                node.aggregate.back_radiance = [[0.0; 3]; 6];
            }
        }
        assert_eq!(a.nodes, b.nodes);
    }
    for i in 0..old.lvoxel_pages() {
        assert_eq!(old.lvoxel_page(i).unwrap(), new.lvoxel_page(i).unwrap());
    }
    let (old, new) = (old.summary(), new.summary());
    assert_eq!(old.sums, new.sums);
    assert_eq!(old.left_out, new.left_out);
    assert_eq!(old.errors.len(), new.errors.len());
}

#[test]
fn surfels_find_their_surface_behind_others_and_through_masks() {
    // Spheres that cross each other, and a card of which half is there.
    let mut text = String::from(
        "[[camera]]\nposition = [0, 1, 5]\ntarget = [0, 0, 0]\n[[light]]\ntype = \"environment\"\n\
         radiance = [1, 1, 1]\n[[mesh]]\nfile = \"builtin:quad\"\nscale = 3\n\
         translate = [0, -1, 0]\nopacity = 0.5\n",
    );
    for i in 0..20 {
        let [x, z] = [0.1 * f64::from(i % 5), 0.15 * f64::from(i / 5)];
        text += &format!("[[mesh]]\nfile = \"builtin:sphere\"\ntranslate = [{x}, 0, {z}]\n");
    }
    let work = Work::new(&text);
    let here = work.path("");
    for words in [
        "bake scene.toml -o a.lvc --surfels 40000",
        "build a.lvc -o a.lvt",
        "bounce scene.toml -t a.lvt -o b.lvt --strict --report r.json",
    ] {
        lvox(&here, &words.split(' ').collect::<Vec<_>>()).done();
    }
    let report = fs::read_to_string(work.path("r.json")).unwrap();
    let report: serde_json::Value = serde_json::from_str(&report).unwrap();
    let stages = report["stages"].as_array().unwrap();
    let lost = stages
        .iter()
        .find_map(|s| s["counts"]["surfels without a surface"].as_f64());
    // Rounding in pages may hide one where spheres cross.
    assert!(lost.is_some_and(|lost| lost <= 2.0), "{lost:?}");
}

#[test]
fn threads_and_memory_change_no_byte() {
    let work = Work::new(crate::ROOM);
    let scene = work.scene();
    let tree = work.bake(&scene, 20_000);
    let bytes = |threads, limit| {
        let path = with_threads(threads, || bounced(&scene, &tree, Bounces::All, limit));
        fs::read(path.unwrap()).unwrap()
    };
    let expected = bytes(1, None);
    for (threads, limit) in [(2, None), (8, None), (2, Some(160 << 20))] {
        assert!(bytes(threads, limit) == expected, "{threads} {limit:?}");
    }
}

#[test]
fn light_that_has_bounced_or_does_not_fade_is_refused() {
    let refused = |result: Result<PathBuf>, says: &str| {
        let error = result.unwrap_err();
        assert_eq!(error.kind(), Kind::Input);
        assert!(error.to_string().contains(says), "{error}");
    };
    let work = Work::new(&closed_room(1.0));
    let scene = work.scene();
    let tree = work.bake(&scene, 5000);
    refused(
        bounced(&scene, &tree, Bounces::All, None),
        "bounces the next one",
    );
    assert!(!work.names().iter().any(|name| name.starts_with("bounced")));
    let twice = bounced(&scene, &tree, Bounces::Count(3), None).unwrap();
    refused(
        bounced(&scene, &twice, Bounces::Count(2), None),
        "has bounced",
    );
    refused(bounced(&scene, &tree, Bounces::Count(0), None), "`bounces`");
    refused(bounced(&scene, &tree, Bounces::All, Some(8 << 20)), "needs");
}

//! The same bytes, however the work is cut up.

use crate::{ROOM, Work, shade, with_threads};
use lvox::bake::{self, Part, SurfelSampling};
use lvox::build;
use lvox::formats::Overwrite;
use lvox::image::exr::{self, Precision};
use lvox::image::{Frame, Missing, Region, merge};
use lvox::internals::tree;
use lvox::run::Job;
use lvox::shade::{self as stage, Aov, Settings};
use lvox::tree::{OpenTree, TreeNeeds};
use std::fs;
use std::path::{Path, PathBuf};

/// Seven tiles of odd sizes that cover 64 x 48.
const TILES: [[u32; 4]; 7] = [
    [0, 0, 21, 13],
    [21, 0, 64, 13],
    [0, 13, 7, 32],
    [7, 13, 38, 32],
    [38, 13, 64, 32],
    [0, 32, 45, 48],
    [45, 32, 64, 48],
];

fn limited(bytes: u64) -> Job {
    Job {
        memory_limit: Some(bytes),
        ..Job::default()
    }
}

#[test]
fn parts_of_a_bake_make_the_undivided_cloud_and_tree() {
    let work = Work::new(ROOM);
    let scene = work.scene();
    let from_camera = SurfelSampling::Camera {
        name: None,
        rate: 6.0,
        overscan: 1.1,
    };
    for surfels in [
        SurfelSampling::ByLight,
        SurfelSampling::Area { count: 200_000 },
        from_camera,
    ] {
        let bake = |name: &str, part: Part| {
            let settings = bake::Settings {
                surfels: surfels.clone(),
                part,
                ..bake::Settings::default()
            };
            let cloud = work.path(name);
            bake::run(
                &scene,
                &settings,
                &cloud,
                Overwrite::Replace,
                &Job::default(),
            )
            .unwrap();
            cloud
        };
        let whole = bake("whole.lvc", Part::WHOLE);
        for count in [1, 3, 5] {
            let mut parts: Vec<_> = (0..count)
                .map(|i| bake(&format!("{i}.lvc"), Part::new(i, count).unwrap()))
                .collect();
            parts.reverse();
            let build = |clouds: &[PathBuf], name: &str| {
                let tree = work.path(name);
                let settings = build::Settings::default();
                build::run_parts(
                    clouds,
                    &tree,
                    &settings,
                    Overwrite::Replace,
                    &Job::default(),
                )
                .map(|_| fs::read(&tree).unwrap())
            };
            let expected = build(std::slice::from_ref(&whole), "whole.lvt").unwrap();
            assert!(
                build(&parts, "parts.lvt").unwrap() == expected,
                "{count} parts"
            );
            if count > 1 {
                let joined = work.path("joined.lvc");
                build::join(&parts, &joined, Overwrite::Replace, &Job::default()).unwrap();
                assert!(fs::read(&joined).unwrap() == fs::read(&whole).unwrap());
                let refused = |clouds: &[PathBuf], words: &str| {
                    let error = build(clouds, "none.lvt").unwrap_err().to_string();
                    assert!(error.contains(words), "{error}");
                };
                refused(&parts[..1], "expected a whole cloud, found part");
                refused(&parts[1..], &format!("missing: {}", count - 1));
                refused(&[&parts[..], &parts[..1]].concat(), "both are part");
                refused(&[parts[0].clone(), whole.clone()], "found a whole cloud");
            }
        }
    }
}

#[test]
fn many_missing_parts_are_counted() {
    let work = Work::new(ROOM);
    let scene = work.scene();
    let part = |index: u32| {
        let settings = bake::Settings {
            surfels: SurfelSampling::Area { count: 1000 },
            part: Part::new(index, 40).unwrap(),
            ..bake::Settings::default()
        };
        let (cloud, job) = (work.path(&format!("{index}.lvc")), Job::default());
        bake::run(&scene, &settings, &cloud, Overwrite::Refuse, &job).unwrap();
        cloud
    };
    let (parts, tree) = ([part(0), part(3)], work.path("none.lvt"));
    let (settings, job) = (build::Settings::default(), Job::default());
    let error = build::run_parts(&parts, &tree, &settings, Overwrite::Refuse, &job).unwrap_err();
    let error = error.to_string();
    assert!(
        error.contains("missing: 1, 2, 4, 5, 6, 7, 8, 9 and 30 more"),
        "{error}"
    );
}

#[test]
fn clouds_and_trees_do_not_depend_on_threads_or_memory() {
    let work = Work::new(ROOM);
    let scene = work.scene();
    let settings = bake::Settings {
        surfels: SurfelSampling::Area { count: 300_000 },
        shadow_rays: 1,
        ..bake::Settings::default()
    };
    let clouds = [1, 2].map(|threads| {
        let cloud = work.path(&format!("{threads}.lvc"));
        with_threads(threads, || {
            bake::run(
                &scene,
                &settings,
                &cloud,
                Overwrite::Refuse,
                &Job::default(),
            )
            .unwrap();
        });
        cloud
    });
    let cloud = fs::read(&clouds[0]).unwrap();
    assert!(cloud == fs::read(&clouds[1]).unwrap());
    let mut trees = Vec::new();
    let mut spilled = Vec::new();
    for threads in [1, 2] {
        for limit in [64 << 20, 4 << 30] {
            let tree = work.path("a.lvt");
            let outcome = with_threads(threads, || {
                let settings = build::Settings::default();
                build::run(
                    &clouds[0],
                    &tree,
                    &settings,
                    Overwrite::Replace,
                    &limited(limit),
                )
                .unwrap()
            });
            spilled.push(outcome.spilled_bytes > 0);
            trees.push(fs::read(&tree).unwrap());
        }
    }
    assert_eq!(spilled, [true, false, true, false]);
    assert!(trees.iter().all(|t| *t == trees[0]));
}

fn tile(work: &Work, store: &OpenTree, region: Region) -> Frame {
    let settings = Settings {
        samples: 16,
        volume_samples: 8,
        ..Settings::default()
    };
    let aovs = [Aov::Indirect, Aov::Normal];
    stage::run(
        &work.scene(),
        store,
        &settings,
        region,
        &aovs,
        &Job::default(),
    )
    .unwrap()
}

fn bytes(frame: &Frame, path: &Path) -> Vec<u8> {
    exr::write(path, frame, Precision::Half).unwrap();
    fs::read(path).unwrap()
}

#[test]
fn frames_do_not_depend_on_threads_tiles_or_caches() {
    let work = Work::new(ROOM);
    let tree = work.bake(&work.scene(), 100_000);
    let kept = OpenTree::open(&tree, None).unwrap();
    let full = Region::full(64, 48);
    let whole = bytes(&tile(&work, &kept, full), &work.path("whole.exr"));
    for threads in [1, 2] {
        let frame = with_threads(threads, || tile(&work, &kept, full));
        assert!(bytes(&frame, &work.path("again.exr")) == whole);
    }

    // The least memory with which this tree can be used holds some pages, not all.
    let least = (20..)
        .map(|shift| 1 << shift)
        .find(|&l| OpenTree::open(&tree, Some(l)).is_ok())
        .unwrap();
    let cached = OpenTree::open(&tree, Some(least)).unwrap();
    assert!(tree::surfels(&cached).are_cached(), "{least}");
    let frame = tile(&work, &cached, full);
    assert!(bytes(&frame, &work.path("again.exr")) == whole);
    let stats = cached.stats();
    assert!(
        stats.hits > stats.misses && stats.misses > 0,
        "not cached: {stats:?}"
    );

    // Each tile as a process of its own would: with a store that has seen nothing yet.
    let parts: Vec<_> = TILES
        .iter()
        .enumerate()
        .map(|(i, &[x0, y0, x1, y1])| {
            let store = OpenTree::open(&tree, (i % 2 == 0).then_some(least)).unwrap();
            let frame = with_threads(1 + i % 2, || tile(&work, &store, Region { x0, y0, x1, y1 }));
            let path = work.path(&format!("tile{i}.exr"));
            exr::write(&path, &frame, Precision::Half).unwrap();
            path
        })
        .collect();
    let merged = work.path("merged.exr");
    merge(&parts, &merged, Missing::Refuse, None, &Job::default()).unwrap();
    assert!(fs::read(&merged).unwrap() == whole);
}

/// Media and penumbrae decide for each corner how much is asked there, and must do so by the corner
/// alone.
#[test]
fn smoke_before_penumbrae_has_no_seams() {
    // Thin smoke in all of the room, of voxels so large that most corners take what their
    // neighbours have, before the shadow of the block in the light of a large emitter.
    let text = ROOM
        .replace("width = 64\nheight = 48", "width = 96\nheight = 72")
        .replace(
            "scale = 0.5\nrotate_deg = [180",
            "scale = 1.2\nrotate_deg = [180",
        )
        .replace("sigma_t_scale = 6", "sigma_t_scale = 1")
        .replace(
            "[[0.9, 0, 0, -0.9], [0, 0.9, 0, 0.3], [0, 0, 0.9, -0.2]",
            "[[2, 0, 0, -1], [0, 2, 0, 0], [0, 0, 2, -1]",
        );
    let work = Work::new(&text);
    let scene = work.scene();
    let store = OpenTree::open(&work.bake(&scene, 5000), None).unwrap();
    for corner_spacing in [1, 2] {
        let settings = Settings {
            samples: 8,
            volume_samples: 4,
            corner_spacing,
            ..Settings::default()
        };
        let radiance =
            |regions: &[Region]| stage::pixels(&scene, &store, &settings, regions, &Job::default());
        let whole = radiance(&[Region::full(96, 72)]).unwrap().concat();
        let tiles = Region::full(96, 72).blocks([7; 2]);
        let mut differ = 0;
        for (tile, pixels) in tiles.iter().zip(radiance(&tiles).unwrap()) {
            let at = (tile.y0..tile.y1).flat_map(|y| (tile.x0..tile.x1).map(move |x| y * 96 + x));
            differ += at
                .zip(pixels)
                .filter(|&(i, pixel)| pixel.radiance.0 != whole[i as usize].radiance.0)
                .count();
        }
        assert_eq!(differ, 0, "pixels of {}, {corner_spacing}", whole.len());
    }
}

#[test]
fn the_seed_and_the_tree_decide_and_are_written_down() {
    let work = Work::new(ROOM);
    let scene = work.scene();
    let settings = Settings {
        samples: 8,
        volume_samples: 4,
        ..Settings::default()
    };
    let few = shade(&scene, &work.bake(&scene, 2000), &settings);
    let tree = work.bake(&scene, 3000);
    let more = shade(&scene, &tree, &settings);
    assert_ne!(few.attributes["lvox/tree"], more.attributes["lvox/tree"]);
    assert_eq!(few.attributes["lvox/scene"], more.attributes["lvox/scene"]);
    let other = shade(
        &scene,
        &tree,
        &Settings {
            seed: 1,
            ..settings
        },
    );
    assert_ne!(crate::beauty(&other), crate::beauty(&more));
    assert_ne!(
        other.attributes["lvox/settings"],
        more.attributes["lvox/settings"]
    );
}

#[test]
fn what_memory_cannot_hold_is_told_before_it_is_made() {
    let work = Work::new(ROOM);
    let scene = work.scene();
    let tree = work.bake(&scene, 1000);
    let error = OpenTree::open(&tree, Some(1000)).unwrap_err().to_string();
    assert!(error.contains("lvoxels needs"), "{error}");
    // The picture alone, whatever the tree takes.
    let store = OpenTree::open(&tree, None).unwrap();
    let settings = Settings::default();
    let part = Region {
        x0: 8,
        y0: 8,
        x1: 16,
        y1: 12,
    };
    let held = |region| {
        let needs = TreeNeeds::default();
        lvox::shade::check_memory(&scene, &settings, region, &[], needs, &Job::default()).unwrap()
    };
    let job = Job {
        memory_limit: Some(held(part) + 70_000),
        ..Job::default()
    };
    let shade = |region| lvox::shade::run(&scene, &store, &settings, region, &[], &job);
    let error = shade(Region::full(64, 48)).unwrap_err();
    assert!(error.to_string().contains("3072 pixels"), "{error}");
    shade(part).unwrap();
}

#[test]
fn frames_and_tiles_that_share_a_radiance_cache_are_those_that_do_not() {
    let work = Work::new(ROOM);
    let scene = work.scene();
    let store = OpenTree::open(&work.bake(&scene, 20_000), None).unwrap();
    let settings = Settings::default();
    let whole = Region::full(64, 48);
    let evaluated = |job: &Job, region: Region| {
        let frame = stage::run(&scene, &store, &settings, region, &[], job).unwrap();
        let counts = &job.report.stages()[0].counts;
        (frame, counts["patches"])
    };
    let (plain, alone) = evaluated(&Job::default(), whole);
    let sharing = || Job {
        radiance_cache: Some(work.path("a.cache")),
        ..Job::default()
    };
    let mut sum = 0.0;
    for i in 0..7 {
        let tile = Region::tile(64, 48, i, 7).unwrap();
        let (shared, patches) = evaluated(&sharing(), tile);
        let (own, _) = evaluated(&Job::default(), tile);
        assert!(shared == own, "tile {i}");
        sum += patches;
    }
    // Threads may evaluate a patch at the same time.
    assert!(
        sum < 1.1 * alone,
        "{sum} patches by tiles, {alone} by the frame"
    );
    let (again, patches) = evaluated(&sharing(), whole);
    assert!(again == plain);
    assert!(patches < 0.01 * alone, "{patches} of {alone} again");

    let other = OpenTree::open(&work.bake(&scene, 10_000), None).unwrap();
    let error = stage::run(&scene, &other, &settings, whole, &[], &sharing()).unwrap_err();
    assert!(error.to_string().contains("one of others"), "{error}");
}

#[test]
fn patches_that_are_new_to_a_filled_cache_do_not_speak_for_the_frame() {
    let work = Work::new(ROOM);
    let scene = work.scene();
    let red = "albedo = [0.6, 0.05, 0.05]";
    assert!(ROOM.contains(red));
    let without = Work::new(&ROOM.replace(
        &format!("translate = [-1, 1, 0]\n{red}"),
        &format!("translate = [-9, 1, 0]\n{red}"),
    ));
    let store = OpenTree::open(&without.bake(&without.scene(), 20_000), None).unwrap();
    let mut warnings = Vec::new();
    for region in [Region::full(64, 48), Region::tile(64, 48, 3, 7).unwrap()] {
        let job = Job {
            radiance_cache: Some(work.path("a.cache")),
            ..Job::default()
        };
        stage::run(&scene, &store, &Settings::default(), region, &[], &job).unwrap();
        warnings.push(job.progress.warnings());
    }
    let [first, second] = &warnings[..] else {
        panic!()
    };
    assert!(first[0].contains("no surfels on"), "{first:?}");
    assert!(second.is_empty(), "{second:?}");
}

#[test]
fn tiles_that_share_gathers_are_those_that_do_not() {
    let work = Work::new(ROOM);
    let scene = work.scene();
    let store = OpenTree::open(&work.bake(&scene, 20_000), None).unwrap();
    let settings = Settings::default();
    let shade = |job: &Job, settings: &Settings, region: Region| {
        let frame = stage::run(&scene, &store, settings, region, &[], job)?;
        Ok::<_, lvox::Error>((frame, job.report.stages()[0].counts["patches"]))
    };
    let sharing = || Job {
        gather_cache: Some(work.path("a.gathers")),
        ..Job::default()
    };
    let (mut with, mut without) = (0.0, 0.0);
    for i in 0..7 {
        let tile = Region::tile(64, 48, i, 7).unwrap();
        let (shared, patches) = shade(&sharing(), &settings, tile).unwrap();
        let (own, own_patches) = shade(&Job::default(), &settings, tile).unwrap();
        assert!(shared == own, "tile {i}");
        with += patches;
        without += own_patches;
    }
    let whole = Region::full(64, 48);
    let (plain, _) = shade(&Job::default(), &settings, whole).unwrap();
    let (again, _) = shade(&sharing(), &settings, whole).unwrap();
    assert!(again == plain);
    assert!(
        with < 0.5 * without,
        "{with} patches by tiles that share, {without} by others"
    );

    let others = Settings {
        samples: 20,
        ..settings
    };
    let error = shade(&sharing(), &others, whole).unwrap_err();
    assert!(error.to_string().contains("one of others"), "{error}");
}

//! Trees hold what their clouds hold, whatever the memory and the threads.

mod pages;
#[path = "../support/mod.rs"]
mod support;

use lvox::build::{self, Settings};
use lvox::formats::*;
use lvox::run::Job;
use std::ops::Range;
use std::path::{Path, PathBuf};
use support::program::lvox;
use support::random::Random;

const OVERLAP: f32 = 1.7;

/// A colour that no rounding changes, different for every index.
fn colour(i: usize) -> [f32; 3] {
    [256 + i % 256, i / 256 % 512, i / 131_072].map(|c| c as f32)
}

fn index(s: &Surfel) -> u32 {
    let [r, g, b] = s.front.map(|c| c as u32);
    r - 256 + 256 * g + 131_072 * b
}

/// Surfels on the six walls of a box and on a small dense ball in it; some are clipped, some lit
/// from behind.
fn room(n: usize) -> Vec<Surfel> {
    let mut random = Random(1);
    let wall_area = 24.0 / n as f32;
    (0..n)
        .map(|i| {
            let (a, b) = (random.unit() * 2.0 - 1.0, random.unit() * 2.0 - 1.0);
            let mut s = Surfel {
                area: wall_area,
                front: colour(i),
                ..Surfel::default()
            };
            if i % 4 == 0 {
                let z = random.unit() * 2.0 - 1.0;
                let phi = a * std::f32::consts::PI;
                let r = (1.0 - z * z).sqrt();
                s.normal = [r * phi.cos(), r * phi.sin(), z];
                s.position = s.normal.map(|c| 0.3 + 0.01 * c);
                s.area = 0.005 / n as f32;
                s.back = [0.1, 0.0, 0.0];
            } else {
                let axis = i % 3;
                let side = if random.next() & 1 == 0 { 1.0 } else { -1.0 };
                s.position[axis] = side;
                s.position[(axis + 1) % 3] = a;
                s.position[(axis + 2) % 3] = b;
                s.normal[axis] = -side;
            }
            if i % 50 == 0 {
                s.clips.count = 1;
                s.clips.edges[0] = ClipEdge {
                    angle: 1.0,
                    offset: 0.5,
                };
            }
            s.radius = OVERLAP * (s.area / std::f32::consts::PI).sqrt();
            s
        })
        .collect()
}

fn volumes() -> Vec<VolumeInfo> {
    (0..2)
        .map(|i| VolumeInfo {
            name: format!("v{i}"),
            dims: [80, 60, 70],
            index_from_scene: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0; 3]],
            albedo: [1.0; 3],
            extinction_color: [1.0; 3],
        })
        .collect()
}

fn smoke(n: usize) -> Vec<Lvoxel> {
    let mut random = Random(2);
    (0..n)
        .map(|_| {
            let level = (random.next() % 4) as u8;
            let mut at = |size: u64| ((random.next() % size) >> level) as u16;
            Lvoxel {
                level,
                block: [at(80), at(60), at(70)],
                volume: (random.next() % 2) as u16,
                sigma_t: 0.1 + random.unit(),
                source: [random.unit(), 0.5, 0.1],
                lobe: [(random.below(120)) as i8 - 60, 50, -20],
                incident: [0.0; 3],
                single: Default::default(),
            }
        })
        .collect()
}

struct Case {
    _dir: tempfile::TempDir,
    cloud: PathBuf,
    tree: PathBuf,
}

fn case(surfels: &[Surfel], lvoxels: &[Lvoxel]) -> Case {
    let dir = tempfile::tempdir().unwrap();
    let case = Case {
        cloud: dir.path().join("a.lvc"),
        tree: dir.path().join("a.lvt"),
        _dir: dir,
    };
    let meta = CloudMeta {
        volumes: volumes(),
        disk_overlap: OVERLAP,
        ..CloudMeta::default()
    };
    let mut writer = CloudWriter::create(&case.cloud, meta, Overwrite::Replace).unwrap();
    writer.push_surfels(surfels).unwrap();
    writer.push_lvoxels(lvoxels).unwrap();
    writer.finish().unwrap();
    case
}

fn built(case: &Case, settings: &Settings) -> build::Outcome {
    let outcome = build::run(
        &case.cloud,
        &case.tree,
        settings,
        Overwrite::Replace,
        &Job::default(),
    )
    .unwrap();
    Tree::open_path(&case.tree).unwrap().verify().unwrap();
    outcome
}

fn buckets(surfels: u64) -> Settings {
    Settings {
        bucket_surfels: Some(surfels),
        ..Settings::default()
    }
}

/// The surfels of a tree in its order, and for each node which of them are below it.
#[derive(Default)]
struct Walk {
    surfels: Vec<Surfel>,
    nodes: Vec<(Node, Range<usize>)>,
}

impl Walk {
    fn page(&mut self, tree: &Tree<MappedFile>, page: u32) {
        let page = tree.surfel_page(page as usize).unwrap();
        self.node(tree, &page, 0);
    }

    fn node(&mut self, tree: &Tree<MappedFile>, page: &SurfelPage, i: u32) {
        let start = self.surfels.len();
        let node = page.nodes[i as usize];
        match node.below {
            Below::Nodes { first, count } => {
                for child in first..first + u32::from(count) {
                    self.node(tree, page, child);
                }
            }
            Below::Surfels { first, count } => {
                let first = first as usize;
                let own = &page.surfels[first..first + usize::from(count)];
                self.surfels.extend(own);
            }
            Below::Page(next) | Below::EvenPage(next) => self.page(tree, next),
        }
        self.nodes.push((node, start..self.surfels.len()));
    }
}

fn near(a: f64, b: f64, relative: f64) -> bool {
    (a - b).abs() <= relative * a.abs().max(b.abs()).max(1e-30)
}

/// Every surfel once, and every node's aggregate equal to plain sums over the surfels below it.
fn check(case: &Case, given: &[Surfel]) {
    let tree = Tree::open_path(&case.tree).unwrap();
    let mut walk = Walk::default();
    if let Some(root) = tree.root_page() {
        walk.page(&tree, root);
    }
    let surfels = walk.surfels;
    assert_eq!(surfels.len(), given.len());
    let mut indices: Vec<_> = surfels.iter().map(index).collect();
    indices.sort_unstable();
    assert!(indices.into_iter().eq(0..given.len() as u32));
    for s in &surfels {
        let original = &given[index(s) as usize];
        for (a, b) in s.position.iter().zip(original.position) {
            assert!((a - b).abs() <= original.radius / 64.0 + b.abs() * 1e-6);
        }
    }

    let summary = tree.summary();
    let cloud = Cloud::open_path(&case.cloud).unwrap();
    assert_eq!(summary.cloud_sums, cloud.summary().sums);
    assert!(near(summary.sums.area, summary.cloud_sums.area, 1e-4));
    for c in 0..3 {
        let (a, b) = (summary.sums.flux[c], summary.cloud_sums.flux[c]);
        let largest = summary.cloud_sums.flux.into_iter().fold(0.0, f64::max);
        assert!((a - b).abs() <= largest / 512.0);
    }
    let of_levels = |f: fn(&TreeLevel) -> u64| summary.levels.iter().map(f).sum::<u64>();
    assert_eq!(of_levels(|l| l.surfels), given.len() as u64);
    let links = tree.surfel_pages().saturating_sub(1) as u64;
    assert_eq!(of_levels(|l| l.nodes) + links, summary.nodes);
    for error in &summary.errors {
        assert!(error.worst <= error.bound * 1.001, "{error:?}");
    }

    let positions = given.iter().flat_map(|s| s.position);
    let scale = positions.fold(0f32, |m, c| m.max(c.abs()));
    for (node, range) in &walk.nodes {
        check_node(node, &surfels[range.clone()], scale);
    }
}

fn check_node(node: &Node, below: &[Surfel], scale: f32) {
    let a = &node.aggregate;
    let sum = |f: &dyn Fn(&Surfel) -> f64| {
        let terms = below.iter().map(|s| f64::from(s.area) * f(s));
        terms.sum::<f64>()
    };
    let area = sum(&|_| 1.0);
    assert!(near(f64::from(a.area), area, 2e-3));
    let tolerance = 1e-3 * area;
    for k in 0..3 {
        let centre = sum(&|s| f64::from(s.position[k])) / area;
        assert!((centre - f64::from(a.centre[k])).abs() <= 1e-3 * f64::from(scale));
        let normal = sum(&|s| f64::from(s.normal[k]));
        assert!((normal - f64::from(a.normal_sum[k])).abs() <= tolerance);
        for (side, sign) in [1.0, -1.0].into_iter().enumerate() {
            // Towards an axis, the fronts that face it and the backs of those that face away.
            let facing = |s: &Surfel, sign: f64| (sign * f64::from(s.normal[k])).max(0.0);
            let check_side =
                |sign: f64, seen: usize, sent: [f32; 3], light: fn(&Surfel) -> [f32; 3]| {
                    let expected = sum(&|s| facing(s, sign));
                    let found = f64::from(a.axis_area[seen]);
                    assert!((expected - found).abs() <= tolerance);
                    if expected < 0.01 * area {
                        return;
                    }
                    for (c, found) in sent.into_iter().enumerate() {
                        let mean = sum(&|s| facing(s, sign) * f64::from(light(s)[c])) / expected;
                        // Aggregates are rounded by up to 2^-9 of their largest channel, which is
                        // below 512.
                        assert!((mean - f64::from(found)).abs() <= 1.1, "{mean} {found}");
                    }
                };
            let d = 2 * k + side;
            check_side(sign, d, a.axis_radiance[d], |s| s.front);
            check_side(-sign, d ^ 1, a.back_radiance[d], |s| s.back);
        }
    }
    let pairs = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)];
    for (m, (i, j)) in a.second_moment.iter().zip(pairs) {
        let expected = sum(&|s| f64::from(s.normal[i]) * f64::from(s.normal[j]));
        assert!((expected - f64::from(*m)).abs() <= tolerance);
    }
    for s in below {
        let b = Bounds::of_surfel(s);
        for k in 0..3 {
            assert!(node.bounds.min[k] <= b.min[k] && node.bounds.max[k] >= b.max[k]);
        }
    }
}

#[test]
fn nodes_stand_for_what_is_below() {
    let surfels = room(20_000);
    let case = case(&surfels, &[]);
    let outcome = built(&case, &Settings::default());
    assert_eq!(outcome.spilled_bytes, 0);
    check(&case, &surfels);
}

#[test]
fn small_pages_and_small_buckets() {
    let surfels = room(20_000);
    let case = case(&surfels, &[]);
    for bucket_surfels in [None, Some(64), Some(3000)] {
        let settings = Settings {
            page_bytes: 4096,
            bucket_surfels,
        };
        built(&case, &settings);
        check(&case, &surfels);
    }
}

#[test]
fn same_bytes_for_any_memory_and_threads() {
    let case = case(&room(150_000), &smoke(30_000));
    let mut files: Vec<Vec<u8>> = Vec::new();
    for (threads, bucket_surfels) in [
        (2, None),
        (1, None),
        (1, Some(20_000)),
        (2, Some(20_000)),
        (2, Some(100)),
        (3, Some(149_999)),
    ] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
        let settings = Settings {
            bucket_surfels,
            ..Settings::default()
        };
        let outcome = pool.build().unwrap().install(|| built(&case, &settings));
        assert_eq!(outcome.spilled_bytes > 0, bucket_surfels.is_some());
        files.push(std::fs::read(&case.tree).unwrap());
    }
    for (i, file) in files.iter().enumerate() {
        assert!(*file == files[0], "build {i} differs");
    }
}

#[test]
fn a_real_memory_limit_spills_and_changes_nothing() {
    let case = case(&room(600_000), &[]);
    let mut files = Vec::new();
    for (limit, spills) in [(build::MIN_MEMORY, true), (4 << 30, false)] {
        let job = Job {
            memory_limit: Some(limit),
            ..Job::default()
        };
        let settings = Settings::default();
        let outcome =
            build::run(&case.cloud, &case.tree, &settings, Overwrite::Replace, &job).unwrap();
        assert_eq!(outcome.spilled_bytes > 0, spills);
        files.push(std::fs::read(&case.tree).unwrap());
    }
    assert!(files[0] == files[1]);
}

#[test]
fn a_plan_is_near_what_a_build_takes() {
    let case = case(&room(300_000), &smoke(40_000));
    for (job, spills) in [
        (Job::default(), false),
        (
            Job {
                memory_limit: Some(build::MIN_MEMORY),
                ..Job::default()
            },
            true,
        ),
    ] {
        let settings = Settings::default();
        let plan = build::plan(std::slice::from_ref(&case.cloud), &settings, &job).unwrap();
        assert!(!case.tree.exists());
        let outcome =
            build::run(&case.cloud, &case.tree, &settings, Overwrite::Replace, &job).unwrap();
        let tree_bytes = std::fs::metadata(&case.tree).unwrap().len();
        assert!(
            near(plan.tree_bytes as f64, tree_bytes as f64, 0.2),
            "{plan:?}, {tree_bytes}"
        );
        assert_eq!(outcome.spilled_bytes > 0, spills);
        let spilled = outcome.spilled_bytes as f64;
        assert!(
            near(plan.temporary_bytes as f64, spilled, 0.2),
            "{plan:?}, {spilled}"
        );
        assert_eq!((plan.surfels, plan.lvoxels), (300_000, 40_000));
        std::fs::remove_file(&case.tree).unwrap();
    }
}

/// The memory of a build is that of its process, and so the program is asked.
#[cfg(target_os = "linux")]
#[test]
fn a_plan_is_near_the_memory_that_a_build_takes() {
    let case = case(&room(600_000), &smoke(40_000));
    let dir = case.cloud.parent().unwrap();
    for limit in ["64M", "4G"] {
        let limited = ["build", "a.lvc", "--memory-limit", limit];
        let plan = lvox(dir, &[&limited[..], &["--plan", "--json"]].concat());
        let plan: serde_json::Value = serde_json::from_str(&plan.stdout).unwrap();
        assert!(!case.tree.exists());
        let reported = ["-o", "a.lvt", "--report", "report.json", "--force"];
        lvox(dir, &[&limited[..], &reported[..]].concat()).done();
        let report = std::fs::read(dir.join("report.json")).unwrap();
        let report: serde_json::Value = serde_json::from_slice(&report).unwrap();
        let planned = plan["memory_bytes"].as_f64().unwrap();
        let taken = report["peak_memory_bytes"].as_f64().unwrap();
        assert!(near(planned, taken, 0.2), "{limit}: {plan}, {taken}");
        std::fs::remove_file(&case.tree).unwrap();
    }
}

fn disk(i: usize, position: [f32; 3], radius: f32) -> Surfel {
    Surfel {
        position,
        normal: [0.0, 1.0, 0.0],
        radius,
        area: std::f32::consts::PI * (radius / OVERLAP).powi(2),
        front: colour(i),
        ..Surfel::default()
    }
}

/// Every depth of their trees has all surfels' area, and no surfel is lost.
#[test]
fn degenerate_clouds_lose_nothing() {
    let n = 30_000;
    let along_a_line = |i: usize| disk(i, [i as f32 * 1e-3, 0.0, 0.0], 1e-3);
    // Ever closer to one point, down to the steps of f32.
    let ever_closer = |i: usize| disk(i, [1.0 + 0.99_f32.powi(i as i32), 1.0, 1.0], 1e-3);
    let lattice = |i: usize| {
        let cell = [i % 31, i / 31 % 31, i / 961].map(|c| c as f32);
        disk(i, cell, 0.5)
    };
    let one_huge = |i: usize| match i {
        0 => disk(0, [0.5; 3], 1e6),
        i => disk(i, [i as f32 * 1e-5, 0.5, (i % 173) as f32 * 1e-5], 1e-6),
    };
    let two_places = |i: usize| disk(i, [if i < n / 2 { -1e6 } else { 1e6 }, 0.0, 0.0], 1.0);
    let clouds: [&dyn Fn(usize) -> Surfel; 5] = [
        &along_a_line,
        &ever_closer,
        &lattice,
        &one_huge,
        &two_places,
    ];
    for (kind, surfel) in clouds.iter().enumerate() {
        let surfels: Vec<Surfel> = (0..n).map(surfel).collect();
        let case = case(&surfels, &[]);
        for bucket_surfels in [None, Some(500)] {
            let settings = Settings {
                bucket_surfels,
                ..Settings::default()
            };
            let outcome = built(&case, &settings);
            let (found, given) = (&outcome.summary.sums, &outcome.summary.cloud_sums);
            assert_eq!(found.surfels, n as u64, "cloud {kind}");
            // Radii are within 2^-11, radiance within 2^-9 of what they were.
            assert!(near(found.area, given.area, 1e-3), "cloud {kind}");
            let largest = given.flux.into_iter().fold(0.0, f64::max);
            for (a, b) in found.flux.into_iter().zip(given.flux) {
                assert!((a - b).abs() <= 3e-3 * largest, "cloud {kind}");
            }
            let found = lvox::inspect::verify(&case.tree, &Job::default()).unwrap();
            assert!(found.passed, "cloud {kind}: {found}");
            assert!(found.depths.len() <= 25, "cloud {kind}: {found}");
        }
    }
}

#[test]
fn surfels_at_one_spot() {
    let one = room(4)[1];
    let crowd = |range: std::ops::Range<_>| {
        range.map(|i| Surfel {
            front: colour(i),
            ..one
        })
    };
    let mut all: Vec<Vec<Surfel>> = [9, 1000, 100_000].map(|n| crowd(0..n).collect()).into();
    // One in a room, too large for a bucket.
    all.push(room(5000).into_iter().chain(crowd(5000..10_000)).collect());
    for surfels in all {
        let case = case(&surfels, &[]);
        built(&case, &Settings::default());
        let plain = std::fs::read(&case.tree).unwrap();
        built(&case, &buckets(700));
        assert!(std::fs::read(&case.tree).unwrap() == plain);
        check(&case, &surfels);
    }
}

#[test]
fn few_surfels_or_none() {
    for n in [0, 1, 2, 8, 9, 17] {
        let surfels = room(n.max(1))[..n].to_vec();
        let case = case(&surfels, &[]);
        let outcome = built(&case, &Settings::default());
        assert_eq!(outcome.summary.root_page.is_some(), n > 0);
        check(&case, &surfels);
    }
}

#[test]
fn lvoxels_by_volume_and_brick() {
    let given = smoke(30_000);
    let case = case(&[], &given);
    for settings in [Settings::default(), buckets(1000)] {
        let outcome = built(&case, &settings);
        let spills = settings.bucket_surfels.is_some();
        assert_eq!(outcome.spilled_bytes > 0, spills);
        let tree = Tree::open_path(&case.tree).unwrap();
        assert_eq!(tree.root_page(), None);
        let mut all = Vec::new();
        let mut bricks = std::collections::HashSet::new();
        for i in 0..tree.lvoxel_pages() {
            let page = tree.lvoxel_page(i).unwrap();
            assert!(page.iter().all(|v| v.volume == page[0].volume));
            let brick = |v: &Lvoxel| (v.volume, v.block.map(|b| (u32::from(b) << v.level) >> 3));
            let own: std::collections::HashSet<_> = page.iter().map(brick).collect();
            for brick in own {
                assert!(bricks.insert(brick), "a brick in two pages");
            }
            all.extend(page);
        }
        let id = |v: &Lvoxel| (v.volume, v.level, v.block);
        let mut a: Vec<_> = given.iter().map(id).collect();
        let mut b: Vec<_> = all.iter().map(id).collect();
        a.sort_unstable();
        b.sort_unstable();
        assert_eq!(a, b);
        let summary = tree.summary();
        for (a, b) in summary.sums.volumes.iter().zip(&summary.cloud_sums.volumes) {
            assert!(near(a.extinction, b.extinction, 1e-4));
        }
    }
}

#[test]
fn wrong_input_is_refused() {
    let case = case(&room(100), &[]);
    let run = |cloud: &Path, settings: &Settings, memory_limit, overwrite| {
        let job = Job {
            memory_limit,
            ..Job::default()
        };
        build::run(cloud, &case.tree, settings, overwrite, &job).map(drop)
    };
    let plain = Settings::default();
    let error = run(&case.cloud, &plain, Some(1 << 20), Overwrite::Refuse).unwrap_err();
    assert_eq!(error.kind(), lvox::Kind::Input);
    assert!(error.to_string().contains("64.0 MiB"), "{error}");
    let tiny = Settings {
        page_bytes: 1,
        ..plain.clone()
    };
    assert!(run(&case.cloud, &tiny, None, Overwrite::Refuse).is_err());
    let error = run(Path::new("nowhere.lvc"), &plain, None, Overwrite::Refuse).unwrap_err();
    assert!(error.to_string().contains("nowhere.lvc"));
    run(&case.cloud, &plain, None, Overwrite::Refuse).unwrap();
    let error = run(&case.cloud, &plain, None, Overwrite::Refuse).unwrap_err();
    assert!(error.hint_text().unwrap().contains("`overwrite`"));
    let error = run(&case.tree, &plain, None, Overwrite::Replace).unwrap_err();
    assert!(error.to_string().contains("expected a cloud"), "{error}");
    let job = Job::default();
    job.cancel.request();
    let error = build::run(&case.cloud, &case.tree, &plain, Overwrite::Replace, &job).unwrap_err();
    assert_eq!(error.kind(), lvox::Kind::Cancelled);
}

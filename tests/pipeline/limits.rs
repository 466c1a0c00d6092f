//! Limits on memory that hold, and what little of it costs.

use crate::support::program::lvox;
use crate::{ROOM, Work};
use lvox::build;
use lvox::formats::Overwrite;
use lvox::image::Region;
use lvox::internals::tree;
use lvox::run::Job;
use lvox::shade::{self, Settings};
use lvox::tree::{OpenTree, PageStats};
use std::fs;
use std::path::Path;

/// Bytes of all pages of a tree once they are decoded.
fn decoded_bytes(store: &OpenTree) -> usize {
    let pages = tree::surfels(store);
    assert!(!pages.are_cached());
    let bytes = |id| {
        let page = pages.page(id);
        page.nodes().bytes() + page.leaves().bytes()
    };
    (0..store.tree().surfel_pages() as u32).map(bytes).sum()
}

/// Bakes the room, without smoke or with it, and builds a tree of pages as small as they may be.
fn tree_of_small_pages(work: &Work, surfels: u64) -> std::path::PathBuf {
    work.bake(&work.scene(), surfels);
    let settings = build::Settings {
        page_bytes: 4096,
        ..build::Settings::default()
    };
    let tree = work.path("small.lvt");
    let cloud = work.path("scene.lvc");
    build::run(
        &cloud,
        &tree,
        &settings,
        Overwrite::Replace,
        &Job::default(),
    )
    .unwrap();
    tree
}

#[test]
fn a_cache_of_a_twentieth_of_the_tree_decodes_each_page_few_times() {
    let work = Work::new(&ROOM.replace("width = 64\nheight = 48", "width = 160\nheight = 120"));
    let path = tree_of_small_pages(&work, 300_000);
    let scene = work.scene();
    let region = Region::full(160, 120);
    let settings = Settings {
        samples: 32,
        volume_samples: 8,
        ..Settings::default()
    };
    let shaded = |store: &OpenTree| {
        let frame = shade::run(&scene, store, &settings, region, &[], &Job::default()).unwrap();
        crate::beauty(&frame)
    };
    let resident = OpenTree::open(&path, None).unwrap();
    let whole = shaded(&resident);
    let once = resident.stats();
    let limit = tree::media(&resident).bytes() + decoded_bytes(&resident) / 20;
    let cached = OpenTree::open(&path, Some(limit as u64)).unwrap();
    assert!(tree::surfels(&cached).are_cached());
    assert!(shaded(&cached) == whole);
    let stats = cached.stats();
    let decoded = |stats: PageStats| (stats.decoded + stats.decoded_leaves) as f64;
    let again = decoded(stats) / decoded(once);
    let hits = stats.hits as f64 / (stats.hits + stats.misses) as f64;
    assert!(
        again < 2.5 && hits > 0.9,
        "{again:.2}, {hits:.4}, {stats:?}"
    );
}

/// Fog of one layer of voxels under a sky: most rays along it pass beside it.
const FLAT: &str = r#"
[film]
width = 64
height = 48

[[camera]]
position = [0, 1, 3]
target = [0, 0, 0]
fov_x_deg = 50

[[light]]
type = "environment"
radiance = [1, 1, 1]

[[volume]]
file = "flat.raw"
dims = [256, 1, 256]
dtype = "u8"
value_scale = 0.004
sigma_t_scale = 5
albedo = 0.9
unitcube_to_world = [[8, 0, 0, -4], [0, 0.03, 0, 0], [0, 0, 8, -4], [0, 0, 0, 1]]
"#;

/// What a run had in memory, from its report: anonymous bytes, and all.
fn peak(report: &Path) -> [u64; 2] {
    let report: serde_json::Value = serde_json::from_slice(&fs::read(report).unwrap()).unwrap();
    let stages = report["stages"].as_array().unwrap();
    ["anonymous_bytes", "resident_bytes"].map(|name| {
        let seen = stages.iter().filter_map(|s| s["peak"][name].as_u64());
        seen.max().unwrap()
    })
}

#[cfg(target_os = "linux")]
#[test]
fn what_is_done_within_a_limit_is_within_it() {
    let work = Work::new(ROOM);
    let path = tree_of_small_pages(&work, 1_000_000);
    fs::rename(path, work.path("scene.lvt")).unwrap();
    fs::write(work.path("flat.toml"), FLAT).unwrap();
    let fog: Vec<u8> = (0..256 * 256_u32).map(|i| (i % 251) as u8).collect();
    fs::write(work.path("flat.raw"), fog).unwrap();
    let run = |line: &str, limit: Option<u64>| {
        let limit = limit.map(|bytes| format!(" --memory-limit {bytes}"));
        let line = format!(
            "{line}{} --threads 2 --force --progress none --report report.json",
            limit.unwrap_or_default()
        );
        let words: Vec<&str> = line.split(' ').collect();
        lvox(work.0.path(), &words)
    };
    for (line, output) in [
        ("bake flat.toml -o new.lvc", "new.lvc"),
        ("reference scene.toml -o new.exr --spp 1", "new.exr"),
        ("scatter scene.toml -t scene.lvt -o new.lvs", "new.lvs"),
        ("bake scene.toml -o new.lvc --surfels 200000", "new.lvc"),
        ("build scene.lvc -o new.lvt", "new.lvt"),
        ("shade scene.toml -t scene.lvt -o new.exr", "new.exr"),
        (
            "shade scene.toml -t scene.lvt -o new.exr --kernel cone --samples 16",
            "new.exr",
        ),
    ] {
        run(line, None).done();
        let [need, _] = peak(&work.path("report.json"));
        let bytes = fs::read(work.path(output)).unwrap();
        let mut done = 0;
        for percent in [10, 50, 100, 400, 4000] {
            let limit = need * percent / 100;
            fs::remove_file(work.path(output)).unwrap_or_default();
            let told = run(line, Some(limit));
            if told.code == 2 {
                told.refused(2, &["needs", "--memory-limit is", "hint: "]);
                assert!(!work.path(output).exists(), "{line}");
                continue;
            }
            told.done();
            done += 1;
            assert!(fs::read(work.path(output)).unwrap() == bytes, "{line}");
            let [anonymous, all] = peak(&work.path("report.json"));
            let told = format!("{line} at {percent} % of {need}, {limit}: {anonymous}, {all}");
            assert!(anonymous <= limit, "{told}");
            // The program's own file is a large share of little memory.
            assert!(all <= limit + limit / 10 || limit < 64 << 20, "{told}");
        }
        assert!(done > 0, "{line}");
    }
}

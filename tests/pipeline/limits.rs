//! Limits on memory that hold, and what little of it costs.

use crate::support::program::{Run, command, lvox};
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

/// A scene under a sky, seen at an angle of so many degrees, with more in it.
fn under_a_sky(fov_deg: u32, more: &str) -> String {
    format!(
        r#"
[film]
width = 64
height = 48

[[camera]]
position = [0, 1, 3]
target = [0, 0, 0]
fov_x_deg = {fov_deg}

[[light]]
type = "environment"
radiance = [1, 1, 1]
{more}"#
    )
}

/// Fog of so many voxels in a box of such edges around a place.
fn fog(file: &str, dims: [usize; 3], edges: [f32; 3], [x, y, z]: [f32; 3]) -> String {
    let [a, b, c] = edges;
    let [x, y, z] = [x - 0.5 * a, y - 0.5 * b, z - 0.5 * c];
    format!(
        r#"
[[volume]]
file = "{file}"
dims = {dims:?}
dtype = "u8"
value_scale = 0.004
sigma_t_scale = 2
albedo = 0.9
unitcube_to_world = [[{a}, 0, 0, {x}], [0, {b}, 0, {y}], [0, 0, {c}, {z}], [0, 0, 0, 1]]
"#
    )
}

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
    // One layer of voxels: most rays along it pass beside it.
    let flat = fog("flat.raw", [256, 1, 256], [8.0, 0.03, 8.0], [0.0; 3]);
    fs::write(work.path("flat.toml"), under_a_sky(50, &flat)).unwrap();
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

/// A control group of this limit and a tenth, where the machine lets us make one.
#[cfg(target_os = "linux")]
struct Group(std::path::PathBuf);

#[cfg(target_os = "linux")]
impl Group {
    fn of(limit: u64) -> Option<Self> {
        let name = format!("lvox-test-{}", std::process::id());
        ["memory/memory.limit_in_bytes", "memory.max"]
            .into_iter()
            .find_map(|file| {
                let (root, file) = file.rsplit_once('/').unwrap_or(("", file));
                let group = Path::new("/sys/fs/cgroup").join(root).join(&name);
                fs::create_dir(&group).ok()?;
                let group = Self(group);
                let all = (limit + limit / 10).to_string();
                fs::write(group.0.join(file), all).ok().map(|()| group)
            })
    }

    /// The same command in it.
    fn command(&self, command: &std::process::Command) -> std::process::Command {
        let mut inside = std::process::Command::new("sh");
        let folder = command.get_current_dir().unwrap();
        inside
            .current_dir(folder)
            .args(["-c", "echo $$ >\"$0\"; exec \"$@\""]);
        inside.arg(self.0.join("cgroup.procs"));
        inside.arg(command.get_program()).args(command.get_args());
        inside
    }
}

#[cfg(target_os = "linux")]
impl Drop for Group {
    fn drop(&mut self) {
        // A group without processes goes soon after the last has ended.
        for _ in 0..100 {
            if fs::remove_dir(&self.0).is_ok() {
                return;
            }
            std::thread::sleep(std::time::Duration::from_millis(10));
        }
    }
}

/// Runs a command that takes more than a limit, and within it: the same output.
#[cfg(target_os = "linux")]
fn is_within(work: &Work, line: &str, output: &str, limit: u64) {
    let run = |more: &str, group: Option<&Group>| {
        let line = format!("{line} -o {output} --force --progress none --report report.json{more}");
        let words: Vec<&str> = line.split(' ').collect();
        let mut plain = command(work.0.path(), &words);
        match group {
            Some(group) => Run::of(&mut group.command(&plain)).done(),
            None => Run::of(&mut plain).done(),
        }
        let peak = peak(&work.path("report.json"));
        (fs::read(work.path(output)).unwrap(), peak)
    };
    let (bytes, [_, all]) = run("", None);
    assert!(all > limit + limit / 10, "{line}: {all}");
    let group = Group::of(limit);
    if group.is_none() {
        eprintln!("skips the control group: the machine lets us make none");
    }
    let limited = format!(" --temp-dir . --memory-limit {limit}");
    let (within, [anonymous, _]) = run(&limited, group.as_ref());
    assert!(anonymous <= limit, "{line} within {limit}: {anonymous}");
    assert!(within == bytes, "{line}");
}

#[cfg(target_os = "linux")]
#[test]
fn voxels_beyond_a_limit_are_in_files() {
    let sun = "[[light]]\ntype = \"directional\"\ndirection = [0.2, -1, 0.1]\n\
               irradiance = [3, 3, 3]\n";
    let vast = fog("vast.raw", [240; 3], [1.0; 3], [0.0; 3]);
    let work = Work::new(&under_a_sky(5, &format!("{sun}{vast}")));
    let voxel = |i: u32| (i.wrapping_mul(2_654_435_761) >> 25) as u8 + 1;
    let voxels: Vec<u8> = (0..240 * 240 * 240).map(voxel).collect();
    fs::write(work.path("vast.raw"), voxels).unwrap();
    let files = || fs::read_dir(work.0.path()).unwrap().count();
    is_within(&work, "bake scene.toml", "scene.lvc", 80 << 20);
    let plan = "bake scene.toml -o new.lvc --plan --temp-dir . --memory-limit 80M";
    let told = lvox(work.0.path(), &plan.split(' ').collect::<Vec<_>>()).stdout;
    assert!(told.contains("at least 80.0 MiB"), "{told}");
    let before = files();
    lvox(work.0.path(), &["build", "scene.lvc", "-o", "scene.lvt"]).done();
    lvox(work.0.path(), &["pack", "scene.toml", "-o", "scene.lvp"]).done();
    is_within(
        &work,
        "shade scene.lvp -t scene.lvt --max-dist 1e9",
        "a.exr",
        80 << 20,
    );
    assert_eq!(files(), before + 3);
}

#[cfg(target_os = "linux")]
#[test]
fn many_small_volumes_are_within_a_limit() {
    let place = |i: usize| [(i % 20) as f32 - 10.0, 0.0, (i / 20) as f32 - 5.0];
    let all = (0..200).map(|i| fog("small.raw", [40; 3], [0.9; 3], place(i)));
    let work = Work::new(&under_a_sky(50, &all.collect::<String>()));
    let voxels: Vec<u8> = (0..40 * 40 * 40_u32).map(|i| (i % 250) as u8 + 1).collect();
    fs::write(work.path("small.raw"), voxels).unwrap();
    is_within(&work, "bake scene.toml", "scene.lvc", 96 << 20);
}

#[cfg(target_os = "linux")]
#[test]
fn triangles_of_packed_scenes_are_given_back() {
    const EDGE: u32 = 720;
    let work = Work::new(
        r#"
[[camera]]
position = [0.5, 0.6, 1.6]
target = [0.5, 0, 0.5]
fov_x_deg = 50

[[light]]
type = "environment"
radiance = [1, 1, 1]

[[mesh]]
file = "hills.ply"
"#,
    );
    let mut ply = format!(
        "ply\nformat binary_little_endian 1.0\nelement vertex {}\nproperty float x\nproperty \
         float y\nproperty float z\nelement face {}\nproperty list uchar int vertex_indices\n\
         end_header\n",
        EDGE * EDGE,
        2 * (EDGE - 1) * (EDGE - 1)
    )
    .into_bytes();
    let at = |i: u32| i as f32 / (EDGE - 1) as f32;
    for i in 0..EDGE * EDGE {
        let [x, z] = [i % EDGE, i / EDGE].map(at);
        let height = 0.05 * ((40.0 * x).sin() * (40.0 * z).cos());
        [x, height, z]
            .iter()
            .for_each(|c| ply.extend(c.to_le_bytes()));
    }
    for i in 0..(EDGE - 1) * (EDGE - 1) {
        let first = i / (EDGE - 1) * EDGE + i % (EDGE - 1);
        for corners in [[0, EDGE, 1], [1, EDGE, EDGE + 1]] {
            ply.push(3);
            corners
                .iter()
                .for_each(|c| ply.extend((first + c).to_le_bytes()));
        }
    }
    fs::write(work.path("hills.ply"), ply).unwrap();
    for line in [
        "pack scene.toml -o scene.lvp",
        "bake scene.lvp -o scene.lvc",
        "build scene.lvc -o scene.lvt",
    ] {
        let words: Vec<&str> = line.split(' ').collect();
        lvox(
            work.0.path(),
            &[&words[..], &["--progress", "none"]].concat(),
        )
        .done();
    }
    is_within(
        &work,
        "shade scene.lvp -t scene.lvt --resolution 320x240",
        "a.exr",
        72 << 20,
    );
}

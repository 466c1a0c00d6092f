//! Light of media that is made before any frame.

use crate::messages::lvox;
use crate::support::parts::{Parts, repair};
use crate::support::program::Run;
use crate::support::trees;
use crate::{ROOM, Work, beauty, layer, relative_rms, with_threads};
use lvox::formats::{BlockKind, Overwrite, Scatter};
use lvox::image::Region;
use lvox::run::{Job, OnWarning};
use lvox::scatter;
use lvox::scene::Scene;
use lvox::shade::{self, Aov, Settings};
use lvox::tree::OpenTree;
use std::fs;
use std::path::{Path, PathBuf};

/// Four rays of media; what presets ask for, no more.
fn few() -> Settings {
    Settings {
        samples: 8,
        volume_samples: 4,
        ..Settings::default()
    }
}

/// What a frame of those settings finds, at all vertices.
fn like(settings: &Settings) -> scatter::Settings {
    scatter::Settings {
        volume_samples: settings.volume_samples,
        max_solid_angle: settings.max_solid_angle,
        shadow_rays: 4,
        seed: settings.seed,
    }
}

fn scattered(
    work: &Work,
    scene: &Scene,
    tree: &Path,
    name: &str,
    settings: &scatter::Settings,
) -> PathBuf {
    let store = OpenTree::open(tree, None).unwrap();
    let output = work.path(name);
    scatter::run(
        scene,
        &store,
        &output,
        settings,
        Overwrite::Replace,
        &Job::default(),
    )
    .unwrap();
    output
}

/// All of the light of a region, and what media scatter.
fn pixels(
    scene: &Scene,
    store: &OpenTree,
    settings: &Settings,
    region: Region,
) -> [Vec<[f32; 3]>; 2] {
    let frame = shade::run(
        scene,
        store,
        settings,
        region,
        &[Aov::Volume],
        &Job::default(),
    );
    let frame = frame.unwrap();
    [beauty(&frame), layer(&frame, "volume")]
}

/// Lights of all kinds, whose shadows are soft and sharp.
fn lit_by_all() -> String {
    ROOM.to_owned()
        + r#"
[[light]]
type = "point"
position = [-0.6, 1.7, 0.6]
intensity = [0.4, 0.5, 0.6]

[[light]]
type = "directional"
direction = [0.3, -0.4, -1]
irradiance = [1, 1, 0.8]
angular_radius_deg = 1
"#
}

#[test]
fn it_is_the_light_that_frames_find_themselves() {
    for text in [ROOM.to_owned(), lit_by_all()] {
        let work = Work::new(&text);
        let scene = work.scene();
        let tree = work.bake(&scene, 5000);
        let settings = few();
        let file = scattered(&work, &scene, &tree, "a.lvs", &like(&settings));
        for camera in ["front", "below"] {
            let settings = Settings {
                camera: Some(camera.into()),
                ..settings.clone()
            };
            let whole = Region::full(scene.film.width, scene.film.height);
            let store = OpenTree::open(&tree, None).unwrap();
            let [_, own] = pixels(&scene, &store, &settings, whole);
            let store = store.with_scatter(&file).unwrap();
            let [_, taken] = pixels(&scene, &store, &settings, whole);
            // But for the rounding of what is stored.
            let differs = relative_rms(&taken, &own);
            assert!(differs > 0.0 && differs < 2e-4, "{camera}: {differs}");
        }
    }
}

#[test]
fn it_does_not_depend_on_threads_and_tiles_of_it_have_no_seams() {
    let work = Work::new(&lit_by_all());
    let scene = work.scene();
    let tree = work.bake(&scene, 5000);
    let make = |threads, name| {
        let settings = scatter::Settings::default();
        let path = with_threads(threads, || scattered(&work, &scene, &tree, name, &settings));
        (fs::read(&path).unwrap(), path)
    };
    let (bytes, path) = make(1, "1.lvs");
    assert_eq!(make(3, "3.lvs").0, bytes);
    let kinds = |kind| Scatter::open(&bytes).unwrap().clusters(kind, 0).count();
    assert!(kinds(BlockKind::Direct) > 0 && kinds(BlockKind::Indirect) > 0);

    let open = || {
        OpenTree::open(&tree, None)
            .unwrap()
            .with_scatter(&path)
            .unwrap()
    };
    let film = &scene.film;
    let whole = Region::full(film.width, film.height);
    let [all, _] = pixels(&scene, &open(), &few(), whole);
    let width = film.width as usize;
    for (x0, x1) in [(0, 20), (20, 33), (33, film.width)] {
        let region = Region { x0, x1, ..whole };
        let [part, _] = pixels(&scene, &open(), &few(), region);
        let columns = x0 as usize..x1 as usize;
        let expected = all
            .chunks(width)
            .flat_map(|row| row[columns.clone()].to_vec());
        assert!(part.into_iter().eq(expected), "{x0} to {x1}");
    }
}

#[test]
fn more_rays_than_a_frame_would_take_leave_less_noise() {
    let work = Work::new(ROOM);
    let scene = work.scene();
    let tree = work.bake(&scene, 5000);
    let whole = Region::full(scene.film.width, scene.film.height);
    let store = OpenTree::open(&tree, None).unwrap();
    let many = Settings {
        volume_samples: 256,
        ..few()
    };
    let [_, expected] = pixels(&scene, &store, &many, whole);
    let [_, own] = pixels(&scene, &store, &few(), whole);
    let file = scattered(&work, &scene, &tree, "a.lvs", &scatter::Settings::default());
    let store = store.with_scatter(&file).unwrap();
    let [_, taken] = pixels(&scene, &store, &few(), whole);
    let [own, taken] = [own, taken].map(|pixels| relative_rms(&pixels, &expected));
    assert!(taken < 0.7 * own, "{taken} {own}");
}

/// The room with a tree and the light that its smoke scatters: [`OWN`].
fn lit_room() -> Work {
    let work = Work::new(ROOM);
    work.bake(&work.scene(), 2000);
    scattering(&work, &["-t", "scene.lvt", "-o", "a.lvs"]).done();
    work
}

const OWN: [&str; 4] = ["-t", "scene.lvt", "--scatter", "a.lvs"];

fn scattering(work: &Work, args: &[&str]) -> Run {
    let base = ["scatter", "scene.toml", "--progress", "none"];
    let few = ["--volume-samples", "2"];
    lvox(work, &[&base[..], &few, args].concat())
}

fn shaded(work: &Work, scene: &str, args: &[&str]) -> Run {
    let base = ["shade", scene, "-o", "x.exr", "--progress", "none"];
    lvox(work, &[&base[..], &["--samples", "4"], args].concat())
}

#[test]
fn what_cannot_be_scattered_is_refused_and_files_stay_as_they_were() {
    let work = lit_room();
    let made = fs::read(work.path("a.lvs")).unwrap();
    let refused = |args: &[&str], says: &[&str]| {
        scattering(&work, &[&["-t", "scene.lvt", "-o"], args].concat()).refused(2, says);
    };
    refused(&["a.lvs"], &["a.lvs", "--force"]);
    refused(&["scene.lvt", "--force"], &["scene.lvt"]);
    refused(&["b.lvs", "--shadow-rays", "0"], &["--shadow-rays"]);
    let cut = ROOM.find("[[volume]]").unwrap();
    fs::write(work.path("clear.toml"), &ROOM[..cut]).unwrap();
    let clear = ["scatter", "clear.toml", "-t", "scene.lvt", "-o", "c.lvs"];
    lvox(&work, &[&clear[..], &["--progress", "none"]].concat()).refused(2, &["no volumes"]);
    assert_eq!(fs::read(work.path("a.lvs")).unwrap(), made);
    assert!(!work.path("b.lvs").exists() && !work.path("c.lvs").exists());
}

#[test]
fn light_of_other_trees_and_for_other_settings_is_refused() {
    let work = lit_room();
    trees::baked(
        &work.scene(),
        &trees::of_surfels(1000),
        work.0.path(),
        "other",
    );
    let made = fs::read(work.path("a.lvs")).unwrap();
    shaded(&work, "scene.toml", &OWN).done();
    let with = |args: &[&str]| shaded(&work, "scene.toml", &[&OWN[..], args].concat());
    with(&["--method", "traditional"]).refused(2, &["--method", "--scatter"]);
    with(&["--max-dist", "3"]).refused(2, &["--max-dist", "--scatter"]);
    let other = ["-t", "other.lvt", "--scatter", "a.lvs"];
    shaded(&work, "scene.toml", &other).refused(2, &["a.lvs", "tree", "lvox scatter"]);
    let wrong = ["-t", "scene.lvt", "--scatter", "scene.lvt"];
    shaded(&work, "scene.toml", &wrong).refused(
        2,
        &[
            "file of scattered light (.lvs)",
            "tree (.lvt)",
            "lvox scatter",
        ],
    );
    assert_eq!(fs::read(work.path("a.lvs")).unwrap(), made);
}

#[test]
fn light_that_is_out_of_date_is_told_and_of_other_volumes_refused() {
    let work = lit_room();
    let made = fs::read(work.path("a.lvs")).unwrap();
    let changed = |from: &str, to: &str| {
        assert!(ROOM.contains(from));
        fs::write(work.path("changed.toml"), ROOM.replace(from, to)).unwrap();
    };
    changed("emission = [10, 9, 7]", "emission = [1, 9, 7]");
    let told = shaded(&work, "changed.toml", &OWN);
    told.done();
    for file in ["scene.lvt", "a.lvs"] {
        let warning = format!("{file}: baked from a scene of other lights");
        assert!(told.stderr.contains(&warning), "{}", told.stderr);
    }
    // Packed in one file they are told once.
    let pack = [
        "pack",
        "changed.toml",
        "-o",
        "all.lvp",
        "--progress",
        "none",
    ];
    lvox(&work, &[&pack[..], &OWN].concat()).done();
    let told = shaded(&work, "all.lvp", &[]).stderr;
    assert_eq!(told.matches("all.lvp: baked from").count(), 1, "{told}");
    // What is added far away moves the frame of the scene, and no volume.
    let far = "[[mesh]]\nfile = \"builtin:cube\"\ntranslate = [1000, 5, 0]\n[[volume]]";
    changed("[[volume]]", far);
    let told = shaded(&work, "changed.toml", &OWN);
    told.done();
    assert!(told.stderr.contains("other surfaces"), "{}", told.stderr);
    changed("0.9, -0.2]", "0.9, -0.1]");
    shaded(&work, "changed.toml", &OWN).refused(2, &["\"smoke\"", "lvox scatter"]);
    assert_eq!(fs::read(work.path("a.lvs")).unwrap(), made);
}

#[test]
fn damage_is_found_before_it_is_light() {
    let work = lit_room();
    let mut damaged = fs::read(work.path("a.lvs")).unwrap();
    damaged[200] ^= 1;
    fs::write(work.path("a.lvs"), &damaged).unwrap();
    shaded(&work, "scene.toml", &OWN).refused(2, &["a.lvs", "checksum"]);
    assert!(!work.path("x.exr").exists());
    lvox(&work, &["verify", "a.lvs", "--progress", "none"]).refused(2, &["a.lvs", "checksum"]);
}

#[test]
fn what_is_wrong_behind_right_checksums_is_told_and_makes_no_picture() {
    let work = Work::new(ROOM);
    let scene = work.scene();
    let tree = work.bake(&scene, 2000);
    let file = scattered(&work, &scene, &tree, "a.lvs", &like(&few()));
    let mut bytes = fs::read(&file).unwrap();
    repair(&mut bytes);
    assert_eq!(bytes, fs::read(&file).unwrap());
    // Where compressed data says what it is.
    bytes[104] ^= 0xff;
    repair(&mut bytes);
    fs::write(&file, &bytes).unwrap();
    let store = OpenTree::open(&tree, None).unwrap();
    let store = store.with_scatter(&file).unwrap();
    let region = Region::full(scene.film.width, scene.film.height);
    let error = shade::run(&scene, &store, &few(), region, &[], &Job::default()).unwrap_err();
    assert_eq!(error.kind(), lvox::Kind::Input);
    let message = error.to_string();
    assert!(
        message.contains("a.lvs") && message.contains("cluster 0"),
        "{message}"
    );
}

/// Values out of range behind right checksums: what shades, what describes and what checks refuse
/// them alike, or, of values that only decoding shows, what shades and what checks.
#[test]
fn values_out_of_range_are_refused_by_all_that_read_them() {
    let work = Work::new(ROOM);
    let scene = work.scene();
    let tree = work.bake(&scene, 2000);
    let file = scattered(&work, &scene, &tree, "a.lvs", &like(&few()));
    let whole = Parts::of(&fs::read(&file).unwrap());
    let shade = [
        "shade",
        "scene.toml",
        "-t",
        "scene.lvt",
        "--scatter",
        "a.lvs",
    ];
    let shade = [&shade[..], &["-o", "out.exr", "--progress", "none"]].concat();
    let refused = |parts: &Parts, args: &[&str], says: &str| {
        fs::write(&file, parts.file()).unwrap();
        lvox(&work, args).refused(2, &["a.lvs", says]);
        assert!(!work.path("out.exr").exists());
    };
    // Clusters begin behind their count: volume, level, then their place.
    for (at, value, says) in [(8, 9, "volume"), (10, 4, "level"), (12, 3, "vertices")] {
        let mut parts = whole.clone();
        parts.summary[at] = value;
        for args in [
            &shade[..],
            &["inspect", "a.lvs"],
            &["verify", "a.lvs", "--progress", "none"],
        ] {
            refused(&parts, args, says);
        }
    }
    for value in [f32::NAN, f32::INFINITY, -1.0] {
        let mut parts = whole.clone();
        for block in &mut parts.blocks {
            let rows = block.records as usize;
            let start = 8 * lvox::formats::CLUSTER_CUBES;
            block.set(0, (start, rows), [0, 0], &value.to_le_bytes());
        }
        for args in [&shade[..], &["verify", "a.lvs", "--progress", "none"]] {
            refused(&parts, args, "finite numbers of at least 0");
        }
    }
}

/// Each value is one that light can have, and their sum is more than a float holds.
#[test]
fn pixels_that_are_not_finite_are_told_and_end_strict_jobs() {
    let work = Work::new(ROOM);
    let scene = work.scene();
    let tree = work.bake(&scene, 2000);
    let file = scattered(&work, &scene, &tree, "a.lvs", &like(&few()));
    let mut parts = Parts::of(&fs::read(&file).unwrap());
    for block in &mut parts.blocks {
        // Of the columns only `chosen` and `light` are there, as no light is a point or a spot.
        assert_eq!(block.columns, 0b01001);
        let rows = block.records as usize;
        let start = 8 * lvox::formats::CLUSTER_CUBES;
        for at in (0..rows).flat_map(|row| [0, 4, 8].map(|byte| [row, byte])) {
            block.set(0, (start, rows), at, &f32::MAX.to_le_bytes());
        }
    }
    fs::write(&file, parts.file()).unwrap();
    let store = OpenTree::open(&tree, None).unwrap();
    let store = store.with_scatter(&file).unwrap();
    let region = Region::full(scene.film.width, scene.film.height);
    let shade = |on_warning| {
        let job = Job {
            on_warning,
            ..Job::default()
        };
        let frame = shade::run(&scene, &store, &few(), region, &[], &job);
        (frame, job.progress.warnings())
    };
    let (frame, warnings) = shade(OnWarning::GoOn);
    let found = frame.unwrap().not_finite().unwrap().to_string();
    assert_eq!(warnings.len(), 1, "{warnings:?}");
    assert!(warnings[0].contains(&found), "{warnings:?}");
    let error = shade(OnWarning::Fail).0.unwrap_err().to_string();
    assert!(error.contains(&found), "{error}");
}

#[test]
fn it_can_be_inspected() {
    let work = Work::new(ROOM);
    let scene = work.scene();
    let tree = work.bake(&scene, 2000);
    scattered(&work, &scene, &tree, "a.lvs", &like(&few()));
    let told = |args: &[&str]| {
        let run = lvox(&work, args);
        assert_eq!(run.code, 0, "{}", run.stderr);
        run.stdout
    };
    let json: serde_json::Value =
        serde_json::from_str(&told(&["inspect", "a.lvs", "--json"])).unwrap();
    let scatter = Scatter::open(fs::read(work.path("a.lvs")).unwrap()).unwrap();
    let vertices: u64 = scatter.blocks().iter().map(|b| u64::from(b.records)).sum();
    let lattices = json["lattices"].as_array().unwrap().iter();
    let sum: u64 = lattices.map(|l| l["vertices"].as_u64().unwrap()).sum();
    assert!(sum == vertices && vertices > 100, "{sum} {vertices}");
    assert_eq!(json["kind"], "scatter");
    let text = told(&["inspect", "a.lvs"]);
    for part in ["scattered light", "volume-samples 4", "indirect", "share"] {
        assert!(text.contains(part), "{part:?} is not in {text}");
    }
    assert!(told(&["verify", "a.lvs", "--progress", "none"]).contains("undamaged"));
    lvox(&work, &["inspect", "a.lvs", "--points", "1"]).refused(2, &["no points"]);
}

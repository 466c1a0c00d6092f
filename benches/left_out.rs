//! What features cost that a scene has, does not have, or does not have while the kernel is ready
//! for them: bytes a point and time a receiver; and what is read for parts of a frame: the tables
//! of `docs/left-out.md`.

#![allow(clippy::print_stdout)]

#[allow(dead_code)]
mod common;

use common::rays;
use lvox::Rgb;
use lvox::bake::{self, SurfelSampling};
use lvox::build;
use lvox::formats::Overwrite;
use lvox::image::Region;
use lvox::inspect::{self, Description};
use lvox::internals::gather::{self, Gatherer, Medium, NoMedia, PatchRadiance, SampleRange};
use lvox::internals::tree::{self, Media, SurfelStore};
use lvox::internals::{Environment, Tracer};
use lvox::run::Job;
use lvox::scene::Scene;
use lvox::shade::{self, Kernel};
use lvox::tree::OpenTree;
use std::fs;
use std::hint::black_box;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// A room with a block and a panel under an emitter; `WALL` and `EMISSION` are to be filled in.
const ROOM: &str = r#"
[film]
width = 256
height = 192

[[camera]]
name = "front"
position = [0, 1, 3.9]
target = [0, 1, 0]
fov_x_deg = 45

[[mesh]]
file = "builtin:quad"
scale = [2.6, 1, 2]
albedo = WALL

[[mesh]]
file = "builtin:quad"
scale = [2.6, 1, 2]
rotate_deg = [180, 0, 0]
translate = [0, 2, 0]
albedo = WALL

[[mesh]]
file = "builtin:quad"
scale = [2.6, 1, 2]
rotate_deg = [90, 0, 0]
translate = [0, 1, -1]
albedo = WALL

[[mesh]]
file = "builtin:quad"
scale = 2
rotate_deg = [0, 0, -90]
translate = [-1.3, 1, 0]
albedo = WALL

[[mesh]]
file = "builtin:quad"
scale = 2
rotate_deg = [0, 0, 90]
translate = [1.3, 1, 0]
albedo = WALL

[[mesh]]
file = "builtin:cube"
scale = [0.5, 0.95, 0.5]
rotate_deg = [0, 22, 0]
translate = [0.72, 0.475, -0.45]
albedo = WALL

[[mesh]]
file = "builtin:quad"
scale = 0.8
translate = [-0.6, 0.5, 0.3]
albedo = [0.6, 0.6, 0.6]

[[mesh]]
file = "builtin:quad"
scale = [0.7, 1, 0.5]
rotate_deg = [180, 0, 0]
translate = [-0.1, 1.985, 0]
albedo = [0, 0, 0]
emission = EMISSION
"#;

const SMOKE: &str = include_str!("../tests/pipeline/left_out/smoke.toml");

/// A blue light under the panel and a red one near the block.
const MORE_LIGHTS: &str = include_str!("../tests/pipeline/left_out/lights.toml");

/// A house behind the back wall, which no ray into the room meets.
const HOUSE: &str = r#"
[[mesh]]
file = "builtin:cube"
scale = [2.6, 2, 2]
translate = [0, 1, -2.5]
albedo = [0.7, 0.7, 0.7]
"#;

const UNLIT: [&str; 2] = ["[0.7, 0.4, 0.3]", "[0, 0, 0]"];
const WHITE: [&str; 2] = ["[0.7, 0.7, 0.7]", "[12, 12, 12]"];
const WARM: [&str; 2] = ["[0.7, 0.4, 0.3]", "[17, 12.5, 7]"];

/// How much to measure.
struct Effort {
    surfels: u64,
    receivers: u64,
    repetitions: usize,
}

/// A baked scene.
struct Baked {
    cloud: Description,
    tree: Description,
    path: PathBuf,
    scene: Scene,
    store: OpenTree,
    /// Seconds.
    bake: f64,
}

impl Baked {
    /// Bakes the room with walls and emitter of the given colours, and what else there is.
    fn new(effort: &Effort, name: &str, colours: [&str; 2], more: &str, crease: f32) -> Self {
        let surfels = SurfelSampling::Area {
            count: effort.surfels,
        };
        Self::sampled(name, colours, more, crease, surfels)
    }

    fn sampled(
        name: &str,
        [wall, emission]: [&str; 2],
        more: &str,
        crease: f32,
        surfels: SurfelSampling,
    ) -> Self {
        let dir = Path::new(env!("CARGO_TARGET_TMPDIR")).join("left_out");
        fs::create_dir_all(&dir).unwrap();
        let file = |extension: &str| dir.join(format!("{name}.{extension}"));
        let text = ROOM.replace("WALL", wall).replace("EMISSION", emission) + more;
        fs::write(file("toml"), text).unwrap();
        let scene = Scene::load(&file("toml")).unwrap();
        let settings = bake::Settings {
            surfels,
            crease_deg: crease,
            ..bake::Settings::default()
        };
        let (cloud, tree, job) = (file("lvc"), file("lvt"), Job::default());
        let start = Instant::now();
        bake::run(&scene, &settings, &cloud, Overwrite::Replace, &job).unwrap();
        let bake = start.elapsed().as_secs_f64();
        build::run(
            &cloud,
            &tree,
            &build::Settings::default(),
            Overwrite::Replace,
            &job,
        )
        .unwrap();
        Self {
            cloud: inspect::describe(&cloud).unwrap(),
            tree: inspect::describe(&tree).unwrap(),
            store: OpenTree::open(&tree, None).unwrap(),
            path: tree,
            scene,
            bake,
        }
    }

    fn pages(&self) -> &SurfelStore {
        tree::surfels(&self.store)
    }

    /// Microseconds a receiver, with the code that a frame of this tree would choose.
    fn time(&self, kernel: Kernel, receivers: u64) -> f64 {
        if tree::media(&self.store).is_empty() {
            self.time_with(self.pages(), NoMedia, kernel, receivers)
        } else {
            self.time_with(self.pages(), tree::media(&self.store), kernel, receivers)
        }
    }

    /// Microseconds a receiver at the default settings, with other code. Nothing is known of
    /// patches at first, as in a frame.
    fn time_with<M: Medium>(
        &self,
        pages: &SurfelStore,
        media: M,
        kernel: Kernel,
        receivers: u64,
    ) -> f64 {
        let tracer = Tracer::new(&self.scene);
        let settings = shade::Settings::default();
        let samples = receivers as usize * settings.samples as usize;
        let outgoing = PatchRadiance::new(&tracer, self.store.area_per_surfel(), samples).unwrap();
        let gatherer = Gatherer {
            pages,
            media,
            settings: gather::RaySettings {
                samples: settings.samples,
                max_solid_angle: settings.max_solid_angle,
                max_dist: f32::INFINITY,
                kernel: match kernel {
                    Kernel::Traced => gather::RayKernel::Traced(&outgoing),
                    Kernel::Cone => gather::RayKernel::Cone,
                    Kernel::Plain => gather::RayKernel::Plain,
                },
                environment: Environment::even(Rgb::BLACK),
                leave_out_bright: false,
            },
        };
        let all = rays(receivers);
        let start = Instant::now();
        for (i, &(point, normal)) in all.iter().enumerate() {
            black_box(gatherer.irradiance(point, normal, normal, SampleRange::first(i as u64)));
        }
        1e6 * start.elapsed().as_secs_f64() / receivers as f64
    }
}

/// A region of the frame and what is read of the tree for it: milliseconds and bytes.
fn shade(baked: &Baked, region: Region) -> (f64, u64) {
    let store = OpenTree::open(&baked.path, None).unwrap();
    let (settings, job) = (shade::Settings::default(), Job::default());
    let start = Instant::now();
    shade::run(&baked.scene, &store, &settings, region, &[], &job).unwrap();
    (
        1e3 * start.elapsed().as_secs_f64(),
        store.stats().bytes_read,
    )
}

/// A column of times, measured in turn with the others of its row.
type Timing<'a> = Box<dyn Fn(u64) -> f64 + 'a>;

/// That of a scene with the code of its own.
fn of(baked: &Baked, kernel: Kernel) -> Timing<'_> {
    Box::new(move |receivers| baked.time(kernel, receivers))
}

/// Medians of the times, and of their ratios to the first with the quartiles of those.
fn times(effort: &Effort, timings: &[Timing]) -> Vec<String> {
    let mut found = vec![Vec::new(); timings.len()];
    for repetition in 0..=effort.repetitions {
        for (timing, found) in timings.iter().zip(&mut found) {
            let time = timing(effort.receivers);
            // The first decodes pages.
            if repetition > 0 {
                found.push(time);
            }
        }
    }
    let quartiles = |mut values: Vec<f64>| {
        values.sort_by(f64::total_cmp);
        [1, 2, 3].map(|q| values[q * (values.len() - 1) / 4])
    };
    let first = found[0].clone();
    let cell = |times: &Vec<f64>| {
        let ratios = times.iter().zip(&first).map(|(t, f)| t / f).collect();
        let [low, middle, high] = quartiles(ratios);
        let time = quartiles(times.clone())[1];
        format!("{time:.1} ({middle:.3}; {low:.3} to {high:.3})")
    };
    let mut cells: Vec<String> = found.iter().map(cell).collect();
    cells[0] = format!("{:.1}", quartiles(first.clone())[1]);
    cells
}

/// Bytes a point that a file was saved before compression, by column.
fn saved(file: &Description, columns: &[&str], count: u64) -> String {
    let of = |c: &&lvox::formats::LeftOut| columns.contains(&c.name.as_str());
    let bytes: u64 = file.left_out.iter().filter(of).map(|c| c.raw_bytes).sum();
    format!("{:.1}", bytes as f64 / count as f64)
}

fn row(cells: &[String]) {
    println!("| {} |", cells.join(" | "));
}

// Long because it is the page: one table after another.
fn main() {
    // Cargo asks for one quick run with `--test`.
    let effort = if std::env::args().any(|a| a == "--test") {
        Effort {
            surfels: 2000,
            receivers: 10,
            repetitions: 1,
        }
    } else {
        Effort {
            surfels: 200_000,
            receivers: 2000,
            repetitions: 15,
        }
    };
    let bake = |name, colours, more, crease| Baked::new(&effort, name, colours, more, crease);
    let coloured_smoke = format!("{SMOKE}\n{MORE_LIGHTS}");
    let plain = bake("plain", WARM, "", 8.0);
    let uncut = bake("uncut", WARM, "", 180.0);
    let grey = bake("grey", WHITE, "", 8.0);
    let backs = bake("backs", WARM, MORE_LIGHTS, 8.0);
    let smoke = bake("smoke", WARM, SMOKE, 8.0);
    let grey_smoke = bake("grey_smoke", WHITE, SMOKE, 8.0);
    let rgb_smoke = bake("rgb_smoke", WARM, &coloured_smoke, 8.0);

    println!(
        "| feature | points | cloud, without | with | tree, without | with | saved in the tree |"
    );
    println!("| --- | --- | --- | --- | --- | --- | --- |");
    let each = |bytes: f64| format!("{bytes:.2}");
    for (name, without, with, columns) in [
        (
            "clipped disks",
            &uncut,
            &plain,
            &["clip_count", "clip_edge"][..],
        ),
        ("back faces lit", &plain, &backs, &["back"]),
        (
            "colour on surfaces",
            &grey,
            &plain,
            &["front", "axis_radiance"],
        ),
    ] {
        row(&[
            name.into(),
            "surfels".into(),
            each(without.cloud.surfels.bytes_each),
            each(with.cloud.surfels.bytes_each),
            each(without.tree.surfels.bytes_each),
            each(with.tree.surfels.bytes_each),
            saved(&without.tree, columns, without.tree.surfels.count),
        ]);
    }
    for (name, with) in [
        ("colour in media, lights of several hues", &rgb_smoke),
        ("colour in media, one warm emitter", &smoke),
    ] {
        let without = &grey_smoke;
        row(&[
            name.into(),
            "lvoxels".into(),
            each(without.cloud.lvoxels.bytes_each),
            each(with.cloud.lvoxels.bytes_each),
            each(without.tree.lvoxels.bytes_each),
            each(with.tree.lvoxels.bytes_each),
            saved(&without.tree, &["source"], without.tree.lvoxels.count),
        ]);
    }
    let total = |d: &Description| d.lvoxels.stored_bytes.to_string();
    row(&[
        "media, bytes in all".into(),
        "lvoxels".into(),
        total(&plain.cloud),
        total(&smoke.cloud),
        total(&plain.tree),
        total(&smoke.tree),
        String::new(),
    ]);

    let nothing = Media::new(&[], []);
    // The most memory with which pages are still cached, to 256 KiB.
    let limited = (1..400).rev().find_map(|steps| {
        let store = OpenTree::open(&plain.path, Some(steps << 18)).ok()?;
        matches!(tree::surfels(&store), SurfelStore::Cached(_)).then_some(store)
    });
    println!("\n| feature | kernel | without | forced on | with |");
    println!("| --- | --- | --- | --- | --- |");
    for (kernel_name, kernel) in [("traced", Kernel::Traced), ("cone", Kernel::Cone)] {
        let of = |baked| of(baked, kernel);
        let media: Timing = Box::new(|n| plain.time_with(plain.pages(), &nothing, kernel, n));
        let cached = limited.as_ref().map(|store| -> Timing {
            let plain = &plain;
            Box::new(move |n| plain.time_with(tree::surfels(store), NoMedia, kernel, n))
        });
        for (name, timings) in [
            ("media", vec![of(&plain), media, of(&smoke)]),
            ("colour in media", vec![of(&grey_smoke), of(&rgb_smoke)]),
            (
                "pages in a cache",
                [of(&plain)].into_iter().chain(cached).collect(),
            ),
        ] {
            let mut cells = vec![name.to_owned(), kernel_name.to_owned()];
            cells.extend(times(&effort, &timings));
            cells.resize_with(5, || "-".to_owned());
            row(&cells);
        }
        for (name, without, with) in [
            ("clipped disks", &uncut, &plain),
            ("back faces lit", &plain, &backs),
            ("colour on surfaces", &grey, &plain),
        ] {
            let [without, with] = [without, with].map(of);
            let cells = times(&effort, &[without, with]);
            row(&[
                name.into(),
                kernel_name.into(),
                cells[0].clone(),
                "-".into(),
                cells[1].clone(),
            ]);
        }
    }
    lights(&effort, &plain);
    reads(&effort);
}

/// Rooms without light, with an emitter, and with many point lights.
fn lights(effort: &Effort, one: &Baked) {
    let points: String = (0..100)
        .map(|i| {
            let (x, z) = (
                0.24 * f64::from(i % 10) - 1.08,
                0.18 * f64::from(i / 10) - 0.81,
            );
            let hue = 0.5 + 0.05 * f64::from(i % 7);
            format!(
                "[[light]]\ntype = \"point\"\nposition = [{x:.2}, 1.9, {z:.2}]\n\
                 intensity = [{hue:.2}, 0.6, {:.2}]\n",
                1.4 - hue
            )
        })
        .collect();
    let none = Baked::new(effort, "unlit", UNLIT, "", 8.0);
    let many = Baked::new(effort, "many_lights", UNLIT, &points, 8.0);
    let all = [&none, one, &many];
    let timings: Vec<Timing> = all.into_iter().map(|b| of(b, Kernel::Traced)).collect();
    let receivers = times(effort, &timings);
    let frames: Vec<Timing> = all
        .into_iter()
        .map(|baked| -> Timing { Box::new(|_| shade(baked, whole(&baked.scene)).0) })
        .collect();
    // A frame of 100 lights takes seconds.
    let few = Effort {
        repetitions: effort.repetitions.min(2),
        ..*effort
    };
    let frames = times(&few, &frames);
    println!("\n| lights | cloud | tree | saved in the tree | bake, s | receiver | frame |");
    println!("| --- | --- | --- | --- | --- | --- | --- |");
    let names = ["none", "a panel", "100 points"];
    for (((name, baked), receiver), frame) in names.iter().zip(all).zip(receivers).zip(frames) {
        row(&[
            (*name).into(),
            format!("{:.2}", baked.cloud.surfels.bytes_each),
            format!("{:.2}", baked.tree.surfels.bytes_each),
            saved(
                &baked.tree,
                &["front", "back", "axis_radiance"],
                baked.tree.surfels.count,
            ),
            format!("{:.2}", baked.bake),
            receiver,
            frame,
        ]);
    }
}

fn whole(scene: &Scene) -> Region {
    Region::full(scene.film.width, scene.film.height)
}

/// Bytes of pages that parts of a frame read: of surfels over all surfaces, and of those that the
/// camera sees.
fn reads(effort: &Effort) {
    let seen = SurfelSampling::Camera {
        name: None,
        // As many surfels as there are in the part of the others that the camera sees, about.
        rate: (effort.surfels as f32 / 65_536.0).sqrt(),
        overscan: 1.2,
    };
    let everywhere = Baked::new(effort, "house", WARM, HOUSE, 8.0);
    let from_camera = Baked::sampled("house_camera", WARM, HOUSE, 8.0, seen);
    println!(
        "\n| surfels | count | bake, s | bytes of pages | a frame reads | its middle | its corner |"
    );
    println!("| --- | --- | --- | --- | --- | --- | --- |");
    for (name, baked) in [
        ("everywhere", &everywhere),
        ("from the camera", &from_camera),
    ] {
        let frame = whole(&baked.scene);
        let tile = |x0, y0| Region {
            x0,
            y0,
            x1: x0 + 32,
            y1: y0 + 32,
        };
        let read = |region| {
            let (millis, bytes) = shade(baked, region);
            format!("{bytes} ({millis:.0} ms)")
        };
        row(&[
            name.into(),
            baked.tree.surfels.count.to_string(),
            format!("{:.2}", baked.bake),
            baked.tree.surfels.stored_bytes.to_string(),
            read(frame),
            read(tile(112, 80)),
            read(tile(0, 0)),
        ]);
    }
}

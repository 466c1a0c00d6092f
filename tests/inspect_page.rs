//! Pages of `inspect --html`: what is in them, that they are small, the same each time and safe,
//! and what a real browser shows of them.

mod support;

use lvox::build;
use lvox::formats::*;
use lvox::image::{Frame, Layer, Region, exr};
use lvox::run::Job;
use serde_json::Value;
use std::fs;
use std::path::Path;
use support::browser;
use support::program::lvox;

const FRONT: [f32; 3] = [1.0, 0.5, 0.25];
const SOURCE: [f32; 3] = [0.125, 0.25, 0.5];
/// What a page of a cloud or tree may have.
const MAX_BYTES: u64 = 5_000_000;
const EVIL: &str = "</script><script>alert(1)</script><!--";

/// Writes `NAME.lvc`, a ball of surfels and a block of smoke, and `NAME.lvt`.
fn files(dir: &Path, name: &str, surfels: usize, lvoxels: usize, scene: &str) {
    let (cloud, tree) = (
        dir.join(format!("{name}.lvc")),
        dir.join(format!("{name}.lvt")),
    );
    let area = 4.0 * std::f32::consts::PI / surfels.max(1) as f32;
    let surfel = |i: usize| {
        let z = 1.0 - (2 * i + 1) as f32 / surfels as f32;
        let phi = (i as f64 * 2.399_963_229_728_653 % std::f64::consts::TAU) as f32;
        let r = (1.0 - z * z).sqrt();
        let normal = [r * phi.cos(), r * phi.sin(), z];
        Surfel {
            position: normal,
            normal,
            area,
            radius: 2.0 * (area / std::f32::consts::PI).sqrt(),
            front: FRONT,
            ..Surfel::default()
        }
    };
    let lvoxel = |i: usize| Lvoxel {
        block: [i % 64, i / 64 % 64, i / 4096].map(|b| b as u16),
        level: 1,
        sigma_t: 5.0,
        source: SOURCE,
        ..Lvoxel::default()
    };
    let meta = CloudMeta {
        scene_name: scene.into(),
        volumes: vec![VolumeInfo {
            name: scene.into(),
            dims: [128; 3],
            index_from_scene: [
                [32.0, 0.0, 0.0],
                [0.0, 32.0, 0.0],
                [0.0, 0.0, 32.0],
                [64.0; 3],
            ],
            albedo: [0.9; 3],
            extinction_color: [1.0; 3],
        }],
        settings: vec![("density".into(), scene.into())],
        disk_overlap: 2.0,
        ..CloudMeta::default()
    };
    let mut writer = CloudWriter::create(&cloud, meta, Overwrite::Replace).unwrap();
    let all: Vec<Surfel> = (0..surfels).map(surfel).collect();
    writer.push_surfels(&all).unwrap();
    let all: Vec<Lvoxel> = (0..lvoxels).map(lvoxel).collect();
    writer.push_lvoxels(&all).unwrap();
    writer.finish().unwrap();
    let settings = build::Settings {
        page_bytes: 8192,
        ..build::Settings::default()
    };
    build::run(
        &cloud,
        &tree,
        &settings,
        Overwrite::Replace,
        &Job::default(),
    )
    .unwrap();
}

fn page(dir: &Path, file: &str) -> String {
    lvox(dir, &["inspect", file, "--html", "page.html", "--force"]).done();
    fs::read_to_string(dir.join("page.html")).unwrap()
}

/// The object that scripts of a page read.
fn data(page: &str) -> Value {
    let json = page.split("id=\"data\">").nth(1).unwrap();
    serde_json::from_str(json.split("</script>").next().unwrap()).unwrap()
}

fn counts(page: &str, kind: &str) -> Vec<u64> {
    let data = data(page);
    let groups = data["view"]["groups"].as_array().unwrap();
    let of_kind = groups.iter().filter(|g| g["kind"] == kind);
    of_kind.map(|g| g["count"].as_u64().unwrap()).collect()
}

#[test]
fn pages_have_all_that_inspect_tells_and_are_the_same_each_time() {
    let dir = tempfile::tempdir().unwrap();
    files(dir.path(), "ball", 3000, 500, "ball");
    for file in ["ball.lvc", "ball.lvt"] {
        let first = page(dir.path(), file);
        assert_eq!(first, page(dir.path(), file));
        for part in [
            "<title>ball.lv",
            "content hash",
            "<h3>columns</h3>",
            "<h3>left out</h3>",
            "<h3>bake settings</h3>",
            "<h3>volumes</h3>",
            "id=\"canvas\"",
            "id=\"map\"",
        ] {
            assert!(first.contains(part), "{part} in {file}");
        }
        // It loads nothing.
        for part in ["src=", "href=", "http:", "https:"] {
            assert!(!first.contains(part), "{part} in {file}");
        }
        assert_eq!(counts(&first, "surfel"), [3000]);
        assert_eq!(counts(&first, "lvoxel"), [500]);
    }
    let tree = page(dir.path(), "ball.lvt");
    for part in ["<h3>levels</h3>", "<h3>errors</h3>", "build settings"] {
        assert!(tree.contains(part), "{part}");
    }
    // Levels of nodes as the tree counts them.
    let levels = lvox::inspect::describe(&dir.path().join("ball.lvt"))
        .unwrap()
        .levels;
    let levels: Vec<u64> = levels.iter().map(|l| l.nodes).filter(|&n| n > 0).collect();
    assert_eq!(counts(&tree, "node"), levels);
    let notes = data(&tree)["notes"].to_string();
    for part in ["3,000 of 3,000", "500 of 500", "levels 0 to"] {
        assert!(notes.contains(part), "{part} in {notes}");
    }
}

#[test]
fn large_files_are_sampled_and_their_pages_stay_small() {
    let dir = tempfile::tempdir().unwrap();
    files(dir.path(), "large", 450_000, 260_000, "large");
    for file in ["large.lvc", "large.lvt"] {
        let page = page(dir.path(), file);
        assert!((page.len() as u64) < MAX_BYTES, "{file}: {}", page.len());
        let all: u64 = ["node", "surfel", "lvoxel"]
            .iter()
            .flat_map(|kind| counts(&page, kind))
            .sum();
        assert!((100_000..=200_000).contains(&all), "{file}: {all}");
        let (surfels, lvoxels) = (counts(&page, "surfel")[0], counts(&page, "lvoxel")[0]);
        assert!(
            surfels >= 45_000 && lvoxels >= 80_000,
            "{surfels} {lvoxels}"
        );
        let notes = data(&page)["notes"].to_string();
        assert!(notes.contains("of 450,000, one in ") && notes.contains("of 260,000, one in 3"));
    }
}

#[test]
fn names_of_files_and_scenes_are_text() {
    let dir = tempfile::tempdir().unwrap();
    files(dir.path(), "a", 50, 5, EVIL);
    let name = "<script>alert(1)<b>&'\".lvc";
    fs::rename(dir.path().join("a.lvc"), dir.path().join(name)).unwrap();
    for file in [name, "a.lvt"] {
        let page = page(dir.path(), file);
        assert!(!page.contains("<script>alert") && !page.contains("<!--") && !page.contains("<b>"));
        assert!(page.contains("&lt;script&gt;alert(1)"));
        // Data, blocks and the script: each opens and ends.
        assert_eq!(
            page.matches("<script").count(),
            page.matches("</script").count()
        );
        assert!(data(&page)["view"]["groups"][0]["kind"].is_string());
    }
    assert!(
        page(dir.path(), name)
            .contains("<title>&lt;script&gt;alert(1)&lt;b&gt;&amp;&#39;&quot;.lvc")
    );
}

#[test]
fn other_kinds_of_files_have_tables_alone() {
    let dir = tempfile::tempdir().unwrap();
    let scene = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/scene/load/demo.toml");
    let page = page(dir.path(), scene.to_str().unwrap());
    for part in ["<h3>cameras</h3>", "<h3>materials</h3>", "class=\"bars\""] {
        assert!(page.contains(part), "{part}");
    }
    let data = data(&page);
    assert!(
        data.get("view").is_none() && data.get("picture").is_none() && data.get("map").is_none()
    );
}

#[test]
fn bad_input_is_one_line_and_nothing_is_written() {
    let dir = tempfile::tempdir().unwrap();
    files(dir.path(), "a", 500, 0, "a");
    fs::write(dir.path().join("notes.txt"), "no file of ours").unwrap();
    fs::write(dir.path().join("a.png"), b"\x89PNG\r\n\x1a\n").unwrap();
    fs::write(dir.path().join("a.exr"), [0x76, 0x2f, 0x31, 0x01, 9, 9]).unwrap();
    // A page of the tree is damaged, which its tables don't show.
    let mut bytes = fs::read(dir.path().join("a.lvt")).unwrap();
    let tree = Tree::open_path(&dir.path().join("a.lvt")).unwrap();
    bytes[tree.surfel_blocks()[0].offset as usize + 3] ^= 0x40;
    fs::write(dir.path().join("b.lvt"), bytes).unwrap();
    for file in ["notes.txt", "a.png", "a.exr", "b.lvt", "missing.lvt"] {
        let run = lvox(dir.path(), &["inspect", file, "--html", "page.html"]);
        run.refused(2, &[file]);
        assert!(!dir.path().join("page.html").exists(), "{file}");
    }
    fs::write(dir.path().join("kept.html"), "kept").unwrap();
    let run = lvox(dir.path(), &["inspect", "a.lvt", "--html", "kept.html"]);
    run.refused(2, &["kept.html", "--force"]);
    assert_eq!(fs::read(dir.path().join("kept.html")).unwrap(), b"kept");
    let run = lvox(
        dir.path(),
        &["inspect", "a.lvt", "--html", "a.lvt", "--force"],
    );
    run.refused(2, &["--html"]);
    for option in [&["--json"][..], &["--points", "3"], &["--export", "a.ply"]] {
        let args = [&["inspect", "a.lvt", "--html", "page.html"], option].concat();
        assert_eq!(lvox(dir.path(), &args).code, 2);
    }
    assert!(!dir.path().join("page.html").exists());
}

/// A tile of a frame whose values are told by their place, the depth in 32 bits.
fn image(path: &Path, width: u32, height: u32) {
    let region = Region {
        x0: 2,
        y0: 1,
        x1: 2 + width,
        y1: 1 + height,
    };
    let mut frame = Frame::new(width + 5, height + 5, region);
    let places = (0..height).flat_map(|y| (0..width).map(move |x| [x as f32, y as f32, 0.25]));
    let pixels: Vec<[f32; 3]> = places.collect();
    let depth = pixels.iter().map(|p| p[0] + 0.1).collect();
    frame.layers.push(Layer::rgb("", &pixels));
    frame.layers.push(Layer::single("depth", "Z", depth));
    exr::write(path, &frame, exr::Precision::Half).unwrap();
}

#[test]
fn large_images_are_thinned_and_that_is_told() {
    let dir = tempfile::tempdir().unwrap();
    image(&dir.path().join("a.exr"), 2100, 1000);
    let page = page(dir.path(), "a.exr");
    let picture = &data(&page)["picture"];
    assert_eq!(
        (&picture["stride"], &picture["width"], &picture["height"]),
        (&2.into(), &1050.into(), &500.into())
    );
    assert_eq!(picture["layers"][1]["channels"][0]["bits"], 32);
    assert_eq!(picture["layers"][0]["channels"][0]["bits"], 16);
}

/// What the scripts of a page found in a browser.
fn probed(browser: &str, dir: &Path, file: &str, probe: &str) -> Value {
    page(dir, file);
    let address = format!("{}{probe}", dir.join("page.html").display());
    let dom = browser::dom(browser, &address, dir);
    let found = dom.split("id=\"probe\">").nth(1);
    let found = found.unwrap_or_else(|| panic!("the page of {file} did not run: {dom:.3000}"));
    serde_json::from_str(found.split("</pre>").next().unwrap()).unwrap()
}

/// All three are within so large a share of what is expected.
#[track_caller]
fn near(found: &Value, expected: [f32; 3], share: f64) {
    for (k, e) in expected.into_iter().enumerate() {
        let (v, e) = (found[k].as_f64().unwrap(), f64::from(e));
        assert!((v - e).abs() <= share * e, "{found} is not {expected:?}");
    }
}

#[test]
fn a_browser_draws_the_points_in_their_colours() {
    let Some(browser) = browser::find() else {
        return;
    };
    let dir = tempfile::tempdir().unwrap();
    files(dir.path(), "ball", 3000, 0, "ball");
    files(dir.path(), "smoke", 0, 4096, "smoke");
    for (file, points, colour, least) in [
        ("ball.lvc", 3000, FRONT, 0.07),
        ("ball.lvt", 3000, FRONT, 0.07),
        ("smoke.lvc", 4096, SOURCE, 0.02),
    ] {
        let found = probed(browser, dir.path(), file, "#probe");
        assert_eq!(found["webgl"], true, "{file}: {found}");
        assert_eq!(found["error"], 0, "{file}: {found}");
        assert_eq!(found["drawn"], points, "{file}: {found}");
        let share = found["share"].as_f64().unwrap();
        assert!(share > least && share < 0.9, "{file}: {found}");
        near(&found["mean_of_file"], colour, 0.002);
        near(&found["mean_of_points"], colour, 0.005);
        near(&found["mean_of_pixels"], colour, 0.03);
    }
}

/// Share of a view that a box covers, of three edges that are not at right angles.
fn covered(edges: [[f64; 3]; 3], size: [f64; 2]) -> f64 {
    let dot = |a: [f64; 3], b: [f64; 3]| (0..3).map(|k| a[k] * b[k]).sum::<f64>();
    let corner = |i: usize| -> [f64; 3] {
        let half = |a: usize| if i >> a & 1 == 1 { 0.5 } else { -0.5 };
        std::array::from_fn(|k| (0..3).map(|a| half(a) * edges[a][k]).sum())
    };
    // As the view stands at first: around the box of all points, which is that of a ball as large.
    let volume = {
        let [a, b, c] = edges;
        let cross = [
            b[1] * c[2] - b[2] * c[1],
            b[2] * c[0] - b[0] * c[2],
            b[0] * c[1] - b[1] * c[0],
        ];
        dot(a, cross).abs()
    };
    let radius = (volume * 0.75 / std::f64::consts::PI).cbrt();
    let (yaw, pitch, distance) = (0.6_f64, 0.35_f64, 2.5 * radius * 3.0_f64.sqrt());
    let (sin_yaw, cos_yaw) = yaw.sin_cos();
    let (sin_pitch, cos_pitch) = pitch.sin_cos();
    let back = [sin_yaw * cos_pitch, sin_pitch, cos_yaw * cos_pitch];
    let right = [cos_yaw, 0.0, -sin_yaw];
    let up = [
        back[1] * right[2] - back[2] * right[1],
        back[2] * right[0] - back[0] * right[2],
        back[0] * right[1] - back[1] * right[0],
    ];
    let aspect = size[0] / size[1];
    let scale = 1.0 / 0.38_f64.tan() / (1.0 / aspect).max(1.0);
    let mut points: Vec<[f64; 2]> = (0..8)
        .map(|i| {
            let p = corner(i);
            let ahead = distance - dot(p, back);
            [
                dot(p, right) * scale / aspect / ahead,
                dot(p, up) * scale / ahead,
            ]
        })
        .collect();
    // The area of their hull, by one chain below and one above.
    points.sort_by(|a, b| a[0].total_cmp(&b[0]));
    let turn = |o: [f64; 2], a: [f64; 2], b: [f64; 2]| {
        (a[0] - o[0]) * (b[1] - o[1]) - (a[1] - o[1]) * (b[0] - o[0])
    };
    let chain = |points: &mut dyn Iterator<Item = [f64; 2]>| {
        let mut chain: Vec<[f64; 2]> = Vec::new();
        for p in points {
            while chain.len() > 1 && turn(chain[chain.len() - 2], chain[chain.len() - 1], p) <= 0.0
            {
                chain.pop();
            }
            chain.push(p);
        }
        chain
    };
    let lower = chain(&mut points.iter().copied());
    let upper = chain(&mut points.iter().rev().copied());
    let hull = [&lower[..lower.len() - 1], &upper[..]].concat();
    let twice: f64 = hull
        .windows(2)
        .map(|p| p[0][0] * p[1][1] - p[0][1] * p[1][0])
        .sum();
    0.5 * twice / 4.0
}

#[test]
fn a_browser_draws_lvoxels_as_boxes() {
    let Some(browser) = browser::find() else {
        return;
    };
    let dir = tempfile::tempdir().unwrap();
    // Edges of a voxel, which are three times as long in one direction, and sheared.
    let edges = [[1.5, 0.0, 0.0], [0.25, 0.5, 0.0], [0.0, 0.0, 0.5]];
    let [a, b, c] = [1.0 / 1.5, 2.0, 2.0];
    let index_from_scene = [[a, 0.0, 0.0], [-a * 0.5, b, 0.0], [0.0, 0.0, c], [0.0; 3]];
    for (k, edge) in edges.iter().enumerate() {
        let back: [f64; 3] =
            std::array::from_fn(|r| (0..3).map(|col| index_from_scene[col][r] * edge[col]).sum());
        assert!(
            (0..3).all(|r| (back[r] - f64::from(u8::from(r == k))).abs() < 1e-12),
            "{back:?}"
        );
    }
    let meta = CloudMeta {
        scene_name: "box".into(),
        volumes: vec![VolumeInfo {
            name: "box".into(),
            dims: [4; 3],
            index_from_scene,
            albedo: [0.9; 3],
            extinction_color: [1.0; 3],
        }],
        disk_overlap: 2.0,
        ..CloudMeta::default()
    };
    let path = dir.path().join("box.lvc");
    let mut writer = CloudWriter::create(&path, meta, Overwrite::Replace).unwrap();
    let opaque = Lvoxel {
        block: [1, 1, 1],
        level: 0,
        sigma_t: 1e4,
        source: SOURCE,
        ..Lvoxel::default()
    };
    writer.push_lvoxels(&[opaque]).unwrap();
    writer.finish().unwrap();
    let found = probed(browser, dir.path(), "box.lvc", "#probe");
    assert_eq!(
        (&found["drawn"], &found["error"]),
        (&1.into(), &0.into()),
        "{found}"
    );
    let size = [0, 1].map(|i| found["size"][i].as_f64().unwrap());
    let (share, expected) = (found["share"].as_f64().unwrap(), covered(edges, size));
    assert!(
        (share / expected - 1.0).abs() < 0.02,
        "{share} is not {expected}"
    );
    near(&found["mean_of_pixels"], SOURCE, 0.03);
    let picked = found["picked"].as_str().unwrap();
    assert!(picked.contains("edges1.5, 0.559, 0.5"), "{picked}");
}

#[test]
fn a_browser_probes_the_values_of_the_file() {
    let Some(browser) = browser::find() else {
        return;
    };
    let dir = tempfile::tempdir().unwrap();
    image(&dir.path().join("a.exr"), 40, 30);
    let found = probed(browser, dir.path(), "a.exr", "#probe=7,5");
    let values = &found["values"];
    assert_eq!(
        (&values["R"], &values["G"], &values["B"]),
        (&"7".into(), &"5".into(), &"0.25".into())
    );
    let depth: f32 = values["depth.Z"].as_str().unwrap().parse().unwrap();
    assert_eq!(depth, 7.0 + 0.1);
    // At exposure 1, by the tone map of lvox.
    assert_eq!(found["shown"], serde_json::json!([255, 255, 136]));
    assert_eq!(found["layers"], serde_json::json!(["", "depth"]));
}

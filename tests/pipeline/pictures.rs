//! What compositors and denoisers take: alpha, depth, positions, albedo, and where the camera is.

use crate::messages::lvox;
use crate::{ROOM, Work, beauty, layer};
use lvox::image::exr::{self, Precision};
use lvox::image::{BACKGROUND_DEPTH, Frame, Region, png};
use lvox::run::Job;
use lvox::scene::Scene;
use lvox::shade::{self, Aov, Quality, Settings};
use lvox::tree::OpenTree;

/// What is behind the open room.
const SKY: [f32; 3] = [0.5, 0.75, 1.0];

/// A room that is open behind the camera and on its right, with smoke before it and a small emitter
/// before the sky, far from the origin of the world.
fn open_room() -> String {
    let sky = "[[light]]\ntype = \"environment\"\nradiance = [0.5, 0.75, 1]\n";
    let lamp = "[[mesh]]\nfile = \"builtin:quad\"\nscale = 0.02\nrotate_deg = [90, 0, 0]\n\
                translate = [1.3, 1.0, 0.0]\nalbedo = [0, 0, 0]\nemission = [40, 40, 40]\n";
    let smoke = "[[0.9, 0, 0, -0.9], [0, 0.9, 0, 0.3]";
    let out_of_the_door = "[[0.9, 0, 0, 0.7], [0, 0.9, 0, 1.2]";
    assert!(ROOM.contains(smoke));
    format!("{}{sky}{lamp}", ROOM.replace(smoke, out_of_the_door))
}

fn settings(background: bool) -> Settings {
    Settings {
        background,
        ..Settings::of(Quality::Draft)
    }
}

/// Alpha and all layers, of a region.
fn shade(scene: &Scene, store: &OpenTree, settings: &Settings, region: Region) -> Frame {
    let mut aovs = Aov::ALL.map(|(_, aov)| aov).to_vec();
    aovs.push(Aov::Alpha);
    shade::run(scene, store, settings, region, &aovs, &Job::default()).unwrap()
}

fn channel<'a>(frame: &'a Frame, layer: &str, name: &str) -> &'a [f32] {
    frame.layer(layer).unwrap().channel(name).unwrap()
}

/// A point as a row before a matrix, divided by its fourth coordinate.
fn times(p: [f64; 3], matrix: &[f32; 16]) -> [f64; 3] {
    let along = |j: usize| {
        let row = |i: usize| f64::from(matrix[4 * i + j]);
        p[0] * row(0) + p[1] * row(1) + p[2] * row(2) + row(3)
    };
    [0, 1, 2].map(|j| along(j) / along(3))
}

#[test]
fn hidden_background_is_what_alpha_says() {
    let work = Work::new(&open_room());
    let scene = work.scene();
    let store = OpenTree::open(&work.bake(&scene, 5000), None).unwrap();
    let full = Region::full(64, 48);
    for corners in [true, false] {
        let with = |background| Settings {
            pixel_samples: if corners { 1 } else { 4 },
            ..settings(background)
        };
        let seen = shade(&scene, &store, &with(true), full);
        let hidden = shade(&scene, &store, &with(false), full);
        let alone = shade::run(&scene, &store, &with(true), full, &[], &Job::default()).unwrap();
        assert_eq!(beauty(&seen), beauty(&alone), "alpha changes no colour");
        let alpha = channel(&hidden, "", "A");
        assert_eq!(alpha, channel(&seen, "", "A"));
        let (mut open, mut closed, mut between) = (0, 0, 0);
        for (i, (&alpha, (over, bare))) in
            (alpha.iter().zip(beauty(&seen).iter().zip(beauty(&hidden)))).enumerate()
        {
            match alpha {
                0.0 => open += 1,
                1.0 => closed += 1,
                _ => between += 1,
            }
            for c in 0..3 {
                let composed = bare[c] + (1.0 - alpha) * SKY[c];
                // The lamp covers what its rays may have missed.
                let lamp = 1e-3 + if bare[c] > 1.5 { 0.05 } else { 0.0 };
                let off = (composed - over[c]).abs();
                assert!(
                    off < lamp * (1.0 + over[c]),
                    "pixel {i}: {composed} {}",
                    over[c]
                );
            }
        }
        assert!(
            open > 100 && closed > 100 && between > 100,
            "{open} {closed} {between}"
        );
        let hidden = beauty(&hidden);
        let mut lit = hidden.iter().zip(alpha).filter(|(p, _)| p[0] > 0.0);
        assert!(lit.all(|(_, &alpha)| alpha > 0.0), "no light without alpha");
    }
}

#[test]
fn depths_and_positions_are_where_the_matrices_put_them() {
    let far = [4.0e5, -3.0e5, 2.0e5];
    for moved in [[0.0; 3], far] {
        let camera = format!(
            "name = \"front\"\nposition = [{}, {}, {}]\ntarget = [{}, {}, {}]\nfov_x_deg = 40",
            moved[0] + 0.4,
            moved[1] + 1.2,
            moved[2] + 3.9,
            moved[0],
            moved[1] + 1.0,
            moved[2],
        );
        let cube = format!(
            "[[mesh]]\nfile = \"builtin:cube\"\nalbedo = [0.25, 0.5, 0.75]\n\
             rotate_deg = [10, 30, 0]\ntranslate = [{}, {}, {}]\n",
            moved[0],
            moved[1] + 1.0,
            moved[2],
        );
        let sun = "[[light]]\ntype = \"environment\"\nradiance = [1, 1, 1]\n";
        let film = "[film]\nwidth = 64\nheight = 48\n";
        let work = Work::new(&format!("{film}[[camera]]\n{camera}\n{cube}{sun}"));
        let scene = work.scene();
        let store = OpenTree::open(&work.bake(&scene, 2000), None).unwrap();
        let frame = shade(&scene, &store, &settings(true), Region::full(64, 48));
        let matrices = frame.camera.unwrap();
        // Positions far away are as exact as 32 bits are.
        let grain = moved[0] * 1e-6 + 1e-4;
        let [depth, distance] = ["depth", "distance"].map(|name| channel(&frame, name, "Z"));
        let position = ["X", "Y", "Z"].map(|c| channel(&frame, "position", c));
        let (albedo, alpha) = (layer(&frame, "albedo"), channel(&frame, "", "A"));
        let mut on_cube = 0;
        for (i, (x, y)) in Region::full(64, 48).coordinates().enumerate() {
            let p = position.map(|c| f64::from(c[i]));
            if depth[i] == BACKGROUND_DEPTH {
                assert_eq!(
                    (p, distance[i], alpha[i]),
                    ([0.0; 3], BACKGROUND_DEPTH, 0.0)
                );
                assert_eq!(albedo[i], [0.0; 3]);
                continue;
            }
            on_cube += 1;
            assert!(depth[i] <= distance[i] * (1.0 + 1e-6));
            let [_, _, z] = times(p, &matrices.world_to_camera);
            assert!(
                (z - f64::from(depth[i])).abs() < grain * 4.0,
                "{z} {}",
                depth[i]
            );
            let [u, v, _] = times(p, &matrices.world_to_ndc);
            let off = [u * 64.0 - f64::from(x), v * 48.0 - f64::from(y)];
            let room = grain * 40.0;
            assert!(
                off.iter().all(|o| (-room..=1.0 + room).contains(o)),
                "{off:?}"
            );
            if alpha[i] == 1.0 {
                let [r, g, b] = albedo[i];
                assert!((r - 0.25).abs() + (g - 0.5).abs() + (b - 0.75).abs() < 1e-5);
            }
        }
        assert!(on_cube > 200, "{on_cube}");
    }
}

#[test]
fn tiles_keep_alpha_layers_and_matrices() {
    let work = Work::new(&open_room());
    let scene = work.scene();
    let store = OpenTree::open(&work.bake(&scene, 5000), None).unwrap();
    let whole = shade(&scene, &store, &settings(false), Region::full(64, 48));
    let whole = exr::encode(&whole, Precision::Half).unwrap();
    let tiles: Vec<_> = (0..4)
        .map(|i| {
            let region = Region::tile(64, 48, i, 4).unwrap();
            let tile = shade(&scene, &store, &settings(false), region);
            let path = work.path(&format!("{i}.exr"));
            exr::write(&path, &tile, Precision::Half).unwrap();
            path
        })
        .collect();
    let merged = work.path("merged.exr");
    let rest = lvox::image::Missing::Refuse;
    lvox::image::merge(&tiles, &merged, rest, None, &Job::default()).unwrap();
    assert!(std::fs::read(&merged).unwrap() == whole);
    let info = exr::info(&merged).unwrap();
    assert_eq!(info.attributes["colorInteropID"], "lin_rec709_scene");
    assert!(info.camera.is_some());
    assert!(info.attributes["lvox/settings"].contains("\"background\":false"));
    for name in ["depth.Z", "distance.Z", "position.X"] {
        assert_eq!(info.channels[name], Precision::Float, "{name}");
    }
    for name in ["A", "R", "albedo.R", "normal.X"] {
        assert_eq!(info.channels[name], Precision::Half, "{name}");
    }
}

/// Boxes that shine before each other, so small that borders of many are in one pixel.
#[test]
fn no_pixel_is_covered_more_than_once_by_lamps() {
    let mut text = String::from(
        "[film]\nwidth = 64\nheight = 48\n[[camera]]\nposition = [0, 0, 3]\ntarget = [0, 0, 0]\n\
         fov_x_deg = 30\n",
    );
    for i in 0..80 {
        let place =
            [0.618_034, 0.754_878, 0.569_84].map(|step| (f64::from(i) * step).fract() - 0.5);
        let turn = [37 * i % 360, 61 * i % 360, 0];
        text += &format!(
            "[[mesh]]\nfile = \"builtin:cube\"\nscale = 0.08\nrotate_deg = {turn:?}\n\
             translate = {place:?}\nemission = [1, 1, 1]\nalbedo = [0, 0, 0]\n"
        );
    }
    let work = Work::new(&text);
    let scene = work.scene();
    let store = OpenTree::open(&work.bake(&scene, 5000), None).unwrap();
    let frame = shade(&scene, &store, &settings(false), Region::full(64, 48));
    let alpha = channel(&frame, "", "A");
    assert!(alpha.iter().all(|a| (0.0..=1.0).contains(a)));
    let brightest = beauty(&frame)
        .iter()
        .fold(0.0, |most: f32, p| most.max(p[0]));
    assert!(brightest < 1.2, "{brightest}");
}

#[test]
fn the_command_line_adds_alpha() {
    let work = Work::new(&open_room());
    work.bake(&work.scene(), 2000);
    let shade = |name: &str, options: &[&str]| {
        let args = "shade scene.toml -t scene.lvt --quality draft --progress none -o";
        let args: Vec<&str> = args.split(' ').chain([name]).collect();
        lvox(&work, &[&args[..], options].concat()).done();
        work.path(name)
    };
    let plain = exr::info(&shade("plain.exr", &[])).unwrap();
    assert_eq!(plain.channels.keys().collect::<Vec<_>>(), ["B", "G", "R"]);
    assert!(!plain.attributes["lvox/settings"].contains("background"));
    for option in ["--alpha", "--no-background"] {
        let info = exr::info(&shade("alpha.exr", &[option])).unwrap();
        assert_eq!(
            info.channels.keys().collect::<Vec<_>>(),
            ["A", "B", "G", "R"]
        );
    }
    // Of a PNG, colours are those before alpha took its share.
    let opaque = png::read(&shade("plain.png", &[])).unwrap();
    let path = shade("alpha.png", &["--no-background"]);
    let cut_out = image::open(&path).unwrap().into_rgba8();
    let frame = exr::read(&work.path("alpha.exr")).unwrap();
    let alpha = channel(&frame, "", "A");
    for ((found, &alpha), seen) in cut_out.pixels().zip(alpha).zip(&opaque.pixels) {
        assert!((f32::from(found.0[3]) - 255.0 * alpha).abs() <= 0.75);
        if alpha == 1.0 {
            let mut pairs = found.0.iter().zip(seen);
            assert!(
                pairs.all(|(a, b)| a.abs_diff(*b) <= 1),
                "{found:?} {seen:?}"
            );
        }
        if alpha == 0.0 {
            assert_eq!(found.0, [0; 4]);
        }
    }
}

#[test]
fn arrays_and_exposures_are_of_the_whole_frame() {
    let work = Work::new(&open_room());
    work.bake(&work.scene(), 2000);
    let run = |words: &str| lvox(&work, &words.split(' ').collect::<Vec<_>>());
    let shade = "shade scene.toml -t scene.lvt --quality draft";
    let said = run(&format!(
        "{shade} -o a.npy --alpha --aov depth --progress plain"
    ));
    assert_eq!(said.code, 0, "{}", said.stderr);
    let told = "a.npy: 48 x 64 x 5 of float32, channels R G B A depth.Z";
    assert!(said.stderr.contains(told), "{}", said.stderr);
    run(&format!(
        "{shade} -o a.exr --float --alpha --aov depth --progress none"
    ))
    .done();
    let exact = exr::read(&work.path("a.exr")).unwrap();
    let array = lvox::image::npy::read(&work.path("a.npy"), None).unwrap();
    assert_eq!(array.pixels, beauty(&exact));
    let scores = run("compare a.npy a.exr --json");
    let scores: serde_json::Value = serde_json::from_str(&scores.stdout).unwrap();
    assert_eq!(scores["rmse"], 0.0);

    // Tiles, merged, come to the same as the frame, in all kinds of images.
    let mut tiles = String::new();
    for i in 0..3 {
        run(&format!(
            "{shade} -o {i}.exr --float --alpha --aov depth --tile {i}/3 --progress none"
        ))
        .done();
        tiles += &format!(" {i}.exr");
    }
    let read = |name: &str| std::fs::read(work.path(name)).unwrap();
    run(&format!("merge{tiles} -o merged.npy --progress none")).done();
    let merged = lvox::image::npy::read(&work.path("merged.npy"), None).unwrap();
    assert_eq!(merged.pixels, array.pixels);
    for (name, option) in [
        ("a", ""),
        ("b", " --exposure 0.25"),
        ("c", " --exposure auto"),
    ] {
        run(&format!(
            "{shade} -o {name}.png --alpha{option} --progress none"
        ))
        .done();
        run(&format!(
            "merge{tiles} -o merged.png{option} --progress none"
        ))
        .done();
        assert!(
            read("merged.png") == read(&format!("{name}.png")),
            "{option}"
        );
    }
    assert!(read("a.png") != read("b.png") && read("b.png") != read("c.png"));
    let said = run(&format!(
        "{shade} -o c.png --exposure auto --progress plain"
    ));
    assert!(
        said.stderr.contains("automatic exposure "),
        "{}",
        said.stderr
    );

    let parts = ["--exposure", "hint: "];
    run(&format!("{shade} -o d.exr --exposure 2")).refused(2, &parts);
    run(&format!("merge{tiles} -o d.npy --exposure 2")).refused(2, &parts);
    run(&format!("{shade} -o d.png --exposure auto --tile 0/2")).refused(2, &parts);
    run(&format!("{shade} -o d.npy --float")).refused(2, &["--float", ".exr"]);
    assert!(!work.names().iter().any(|name| name.starts_with("d.")));
}

/// What a viewer of tev's protocol shows: its name, size, and channels of samples.
#[derive(Default)]
struct Shown {
    name: String,
    size: [usize; 2],
    channels: Vec<Vec<f32>>,
    parts: usize,
}

/// Takes the front off some bytes.
fn take<'a>(bytes: &mut &'a [u8], count: usize) -> &'a [u8] {
    let (front, rest) = bytes.split_at(count);
    *bytes = rest;
    front
}

fn word(bytes: &mut &[u8]) -> usize {
    u32::from_le_bytes(take(bytes, 4).try_into().unwrap()) as usize
}

fn text(bytes: &mut &[u8]) -> String {
    let end = bytes.iter().position(|&b| b == 0).unwrap();
    let text = String::from_utf8(take(bytes, end).to_vec()).unwrap();
    take(bytes, 1);
    text
}

/// Follows the packets of one connection: an image is made, then parts of it come.
fn shown(mut bytes: &[u8]) -> Shown {
    let mut shown = Shown::default();
    while !bytes.is_empty() {
        let length = word(&mut bytes);
        let mut packet = take(&mut bytes, length - 4);
        let kind = take(&mut packet, 2)[0];
        let name = text(&mut packet);
        match kind {
            4 => {
                shown.name = name;
                shown.size = [word(&mut packet), word(&mut packet)];
                let names: Vec<String> =
                    (0..word(&mut packet)).map(|_| text(&mut packet)).collect();
                assert_eq!(names, ["R", "G", "B"]);
                shown.channels = vec![vec![-1.0; shown.size[0] * shown.size[1]]; 3];
            }
            6 => {
                assert_eq!(name, shown.name);
                shown.parts += 1;
                assert_eq!(word(&mut packet), 3);
                (0..3).for_each(|_| drop(text(&mut packet)));
                let [x, y, w, h] = [0; 4].map(|_| word(&mut packet));
                take(&mut packet, 6 * 8);
                let samples = packet.chunks_exact(4);
                for (i, v) in samples.enumerate() {
                    let (channel, at) = (i / (w * h), i % (w * h));
                    let place = (y + at / w) * shown.size[0] + x + at % w;
                    shown.channels[channel][place] = f32::from_le_bytes(v.try_into().unwrap());
                }
            }
            _ => panic!("a packet of kind {kind}"),
        }
    }
    shown
}

#[test]
fn viewers_see_the_frame_while_it_is_made() {
    use std::io::Read;
    let work = Work::new(&ROOM.replace("width = 64\nheight = 48", "width = 200\nheight = 150"));
    work.bake(&work.scene(), 2000);
    let run = |words: &str| lvox(&work, &words.split(' ').collect::<Vec<_>>());
    let shade = "shade scene.toml -t scene.lvt --quality draft --float --progress none";
    let path_traced = "reference scene.toml --spp 2 --progress none";
    for (verb, parts) in [(shade, 2), (path_traced, 1)] {
        let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let place = listener.local_addr().unwrap();
        let viewer = std::thread::spawn(move || {
            // The first connection asks whether anybody listens.
            let mut last = Vec::new();
            for socket in listener.incoming().take(2) {
                last.clear();
                socket.unwrap().read_to_end(&mut last).unwrap();
            }
            last
        });
        run(&format!("{verb} -o a.exr --tev {place}")).done();
        let shown = shown(&viewer.join().unwrap());
        assert_eq!((shown.name.as_str(), shown.size), ("a.exr", [200, 150]));
        assert!(shown.parts >= parts, "{}", shown.parts);
        let frame = exr::read(&work.path("a.exr")).unwrap();
        for (name, seen) in ["R", "G", "B"].into_iter().zip(&shown.channels) {
            assert!(channel(&frame, "", name) == seen, "{name}");
        }
        // Nobody listens any more.
        let shown = std::fs::read(work.path("a.exr")).unwrap();
        let said = run(&format!(
            "{} -o b.exr --tev {place}",
            verb.replace("none", "plain")
        ));
        assert_eq!(said.code, 0, "{}", said.stderr);
        assert!(said.stderr.contains("no viewer listens"), "{}", said.stderr);
        assert!(std::fs::read(work.path("b.exr")).unwrap() == shown);
        run(&format!("{verb} -o c.exr --strict --tev {place}")).refused(2, &["no viewer listens"]);
        assert!(!work.path("c.exr").exists());
    }
}

//! Settings do what their help says, or are refused.

use crate::messages::lvox;
use crate::{ROOM, Work, layer, shade};
use lvox::bake::BlockSize;
use lvox::bake::{self, SurfelSampling};
use lvox::formats::Cloud;
use lvox::formats::Overwrite;
use lvox::image::Region;
use lvox::run::Job;
use lvox::shade::{Aov, Settings};
use lvox::tree::OpenTree;

#[test]
fn shadow_rays_count_at_every_ray_inside_a_pixel() {
    let work = Work::new(ROOM);
    let scene = work.scene();
    let tree = work.bake(&scene, 2000);
    let direct = |pixel_samples: u32, edge_samples: u32, shadow_rays: u32| {
        let settings = Settings {
            samples: 4,
            volume_samples: 1,
            pixel_samples,
            edge_samples,
            shadow_rays,
            ..Settings::default()
        };
        layer(&shade(&scene, &tree, &settings), "direct")
    };
    // Of pixels that have all their rays already, and of those that get more.
    for (pixel, edge) in [(4, 1), (4, 8), (1, 4)] {
        let (few, many) = (direct(pixel, edge, 1), direct(pixel, edge, 16));
        let changed = few.iter().zip(&many).filter(|(a, b)| a != b).count();
        assert!(changed > 100, "{pixel} {edge}: {changed} pixels");
    }
    // In penumbrae, more of them are nearer to the truth.
    let truth = direct(64, 1, 16);
    let error = |found: &[[f32; 3]]| -> f64 {
        let terms = found.iter().flatten().zip(truth.iter().flatten());
        terms.map(|(a, b)| f64::from(a - b).powi(2)).sum()
    };
    let (few, many) = (error(&direct(4, 1, 1)), error(&direct(4, 1, 16)));
    assert!(many < few, "{many} {few}");
}

/// Rays at every second corner change pixels, but not how far those are off.
#[test]
fn corners_may_stand_apart_where_light_is_even() {
    let work = Work::new(ROOM);
    let scene = work.scene();
    let tree = work.bake(&scene, 2000);
    let direct = |settings: Settings| {
        let settings = Settings {
            samples: 4,
            volume_samples: 1,
            ..settings
        };
        layer(&shade(&scene, &tree, &settings), "direct")
    };
    let corners = |corner_spacing| -> Vec<[f32; 3]> {
        let of_seed = |seed| {
            direct(Settings {
                corner_spacing,
                seed,
                ..Settings::default()
            })
        };
        (0..4).flat_map(of_seed).collect()
    };
    let truth = direct(Settings {
        pixel_samples: 64,
        shadow_rays: 16,
        ..Settings::default()
    });
    let [dense, apart] = [1, 2].map(corners);
    let off = |found: &[[f32; 3]]| -> Vec<f64> {
        let relative =
            |(a, b): (&[f32; 3], &[f32; 3])| f64::from(a[1] - b[1]) / f64::from(b[1] + 0.05);
        found
            .iter()
            .zip(truth.iter().cycle())
            .map(relative)
            .collect()
    };
    let mean = |off: &[f64]| off.iter().map(|d| d * d).sum::<f64>() / off.len() as f64;
    let (dense_off, apart_off) = (off(&dense), off(&apart));
    let changed = dense.iter().zip(&apart).filter(|(a, b)| a != b).count();
    assert!(changed > dense.len() / 12, "{changed} of {}", dense.len());
    let (dense, apart) = (mean(&dense_off), mean(&apart_off));
    assert!(apart < 1.1 * dense, "{apart} {dense}");
}

#[test]
fn what_a_png_cannot_hold_is_refused() {
    let work = Work::new(ROOM);
    for (option, value) in [("--aov", Some("depth")), ("--float", None)] {
        let args = ["render", "none.toml", "-o", "a.png", option];
        lvox(&work, &[&args[..], value.as_slice()].concat())
            .refused(2, &[option, "a.png", ".exr", "hint: "]);
    }
}

#[test]
fn verbs_take_no_option_that_they_do_not_use() {
    let work = Work::new(ROOM);
    for (verb, option) in [
        ("build a -o b", "--seed 1"),
        ("merge a -o b", "--seed 1"),
        ("compare a b", "--seed 1"),
        ("inspect a", "--seed 1"),
        ("verify a", "--seed 1"),
        ("inspect a", "--memory-limit 1G"),
        ("verify a", "--memory-limit 1G"),
        ("merge a -o b", "--temp-dir ."),
        ("compare a b", "--temp-dir ."),
        ("inspect a", "--temp-dir ."),
        ("stability a", "--output b"),
        ("stability a", "--quick"),
        ("stability a", "--memory-limit 1G"),
        ("stability a", "--seed 1"),
    ] {
        let args: Vec<&str> = verb.split(' ').chain(option.split(' ')).collect();
        let run = lvox(&work, &args);
        assert_eq!(run.code, 2, "{args:?}");
        let unexpected = format!(
            "unexpected argument '{}'",
            option.split(' ').next().unwrap()
        );
        assert!(run.stderr.contains(&unexpected), "{args:?}: {}", run.stderr);
    }
    // And none that others leave without use.
    for (verb, first, second) in [("bake a -o b", "--surfels-from-camera", "--surfels 9")] {
        let args = format!("{verb} {first} {second}");
        let run = lvox(&work, &args.split(' ').collect::<Vec<_>>());
        assert_eq!((run.code, run.stdout.as_str()), (2, ""), "{args}");
        let refusal = run.stderr.lines().next().unwrap_or_default();
        for option in [first, second] {
            let name = option.split(' ').next().unwrap();
            assert!(refusal.contains(name), "{args}: {refusal}");
        }
    }
}

/// A thin cloud alone before the camera, lit by an emitter and by a wall behind the camera: light
/// from the wall is all that is chosen at random.
#[test]
fn the_seed_keys_what_media_see_of_surfaces() {
    let cube = "[[volume]]\nfile = \"smoke.raw\"\ndims = [16, 16, 16]\ndtype = \"u8\"\n\
                value_scale = 0.0039\nsigma_t_scale = 2\nalbedo = [0.8, 0.8, 0.8]\n";
    let at = |x: f32| {
        format!(
            "{cube}unitcube_to_world = [[1, 0, 0, {x}], [0, 1, 0, -0.5], [0, 0, 1, -0.5], \
             [0, 0, 0, 1]]\n"
        )
    };
    let text = format!(
        "[film]\nwidth = 24\nheight = 12\n[[camera]]\nposition = [0, 0, 3]\ntarget = [0, 0, 0]\n\
         fov_x_deg = 50\n\
         [[light]]\ntype = \"point\"\nposition = [0, 3, 4]\nintensity = [9, 9, 9]\n\
         [[mesh]]\nfile = \"builtin:quad\"\nscale = 8\nrotate_deg = [90, 0, 0]\n\
         translate = [0, 0, 6]\nalbedo = [0.9, 0.2, 0.2]\n{}{}",
        at(-1.1),
        at(0.1)
    );
    let work = Work::new(&text);
    let scene = work.scene();
    let tree = work.bake(&scene, 2000);
    let volume = |seed| {
        let settings = Settings {
            seed,
            ..Settings::default()
        };
        layer(&shade(&scene, &tree, &settings), "volume")
    };
    let found = [0, 0, 1].map(volume);
    assert!(found[0] == found[1]);
    // Of both volumes.
    for half in [0, 12] {
        let pixels = |i: usize| -> Vec<[f32; 3]> {
            let rows = found[i].chunks_exact(24);
            rows.flat_map(|row| row[half..half + 12].to_vec()).collect()
        };
        assert!(pixels(0) != pixels(2), "{half}");
        let noise = crate::relative_rms(&pixels(0), &pixels(2));
        assert!(noise < 0.2, "{noise}");
    }
}

#[test]
fn volumes_that_are_alike_do_not_share_their_samples() {
    let cube = "[[volume]]\nfile = \"smoke.raw\"\ndims = [16, 16, 16]\ndtype = \"u8\"\n\
                sigma_t_scale = 1\nalbedo = [0, 0, 0]\n\
                unitcube_to_world = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]\n";
    let work = Work::new(&format!("{cube}{cube}"));
    let settings = bake::Settings {
        surfels: SurfelSampling::Area { count: 1 },
        blocks: BlockSize::Fixed {
            level: 2,
            samples: 2,
        },
        ..bake::Settings::default()
    };
    let path = work.path("two.lvc");
    bake::run(
        &work.scene(),
        &settings,
        &path,
        Overwrite::Refuse,
        &Job::default(),
    )
    .unwrap();
    let cloud = Cloud::open_path(&path).unwrap();
    let mut sigma_t = [Vec::new(), Vec::new()];
    for i in 0..cloud.lvoxel_chunks() {
        for l in cloud.lvoxel_chunk(i).unwrap() {
            sigma_t[usize::from(l.volume)].push((l.block, l.sigma_t));
        }
    }
    let [first, second] = sigma_t;
    assert!(first.len() > 8 && first != second);
}

#[test]
fn numbers_out_of_range_are_named_with_what_was_found() {
    let work = Work::new(ROOM);
    let render = |options: &str| {
        let args = ["render", "scene.toml", "-o", "a.exr"];
        let args: Vec<&str> = args.into_iter().chain(options.split(' ')).collect();
        lvox(&work, &args)
    };
    render("--max-dist -1").refused(2, &["--max-dist must be more than 0, found -1"]);
    render("--region 0 0 65 4").refused(2, &["65", "hint: ", "0 0 64 48"]);
    for (options, part) in [
        ("--seed -1", "invalid value '-1' for '--seed <N>'"),
        ("--tile 0/0", "one tile at least"),
    ] {
        let run = render(options);
        assert_eq!(run.code, 2);
        assert!(run.stderr.contains(part), "{}", run.stderr);
        assert!(!run.stderr.contains("unexpected"), "{}", run.stderr);
    }
}

#[test]
fn limits_of_memory_that_are_too_small_are_named() {
    let work = Work::new(ROOM);
    work.bake(&work.scene(), 500);
    let build = ["build", "scene.lvc", "-o", "b.lvt", "--memory-limit", "1K"];
    lvox(&work, &build).refused(2, &["64.0 MiB", "1.00 KiB"]);
    let shade = ["shade", "scene.toml", "-t", "scene.lvt", "-o", "a.exr"];
    let run = lvox(&work, &[&shade[..], &["--memory-limit", "1"]].concat());
    run.refused(2, &["--memory-limit is 1 B", "hint: raise"]);
    assert!(!run.stderr.contains("verify"), "{}", run.stderr);
}

/// Near a gather, patches as large as a few leaves of the tree are told by its nodes: no leaf is
/// decoded, and light hardly changes.
#[test]
fn large_patches_need_no_leaves() {
    let work = Work::new(ROOM);
    let scene = work.scene();
    let store = OpenTree::open(&work.bake(&scene, 20_000), None).unwrap();
    let indirect = |patch_surfels| {
        let settings = Settings {
            patch_surfels,
            ..Settings::default()
        };
        let region = Region::full(64, 48);
        let (aovs, job) = ([Aov::Indirect], Job::default());
        let frame = lvox::shade::run(&scene, &store, &settings, region, &aovs, &job).unwrap();
        (layer(&frame, "indirect"), store.stats().decoded_leaves)
    };
    let (coarse, leaves) = indirect(64);
    assert_eq!(leaves, 0);
    let (fine, leaves) = indirect(1);
    assert!(leaves > 0);
    let (mut off, mut sum) = (0.0, 0.0);
    for (a, b) in coarse.iter().flatten().zip(fine.iter().flatten()) {
        off += f64::from((a - b).abs());
        sum += f64::from(*b);
    }
    assert!(coarse != fine);
    assert!(off < 0.02 * sum, "{}", off / sum);
}

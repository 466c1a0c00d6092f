//! What is written is read back within the bounds of `SPEC.md`, from the same bytes every time.

mod common;

use common::*;
use lvox_formats::*;
use proptest::prelude::*;
use std::path::Path;

fn degrees_between(a: [f32; 3], b: [f32; 3]) -> f64 {
    let chord = (0..3)
        .map(|i| (f64::from(a[i]) - f64::from(b[i])).powi(2))
        .sum::<f64>()
        .sqrt();
    (2.0 * (chord / 2.0).asin()).to_degrees()
}

fn close(a: f32, b: f32, relative: f64) -> bool {
    (f64::from(a) - f64::from(b)).abs() <= relative * f64::from(a).abs()
}

fn colours_close(given: [f32; 3], decoded: [f32; 3], bound: f32) -> bool {
    let max = given[0].max(given[1]).max(given[2]);
    (0..3).all(|i| (given[i] - decoded[i]).abs() <= bound * max)
}

fn check_shape(given: &Surfel, decoded: &Surfel) {
    assert!(degrees_between(given.normal, decoded.normal) < 0.005);
    assert_eq!(given.clips.count, decoded.clips.count);
    let n = usize::from(given.clips.count);
    for (a, b) in given.clips.edges[..n].iter().zip(&decoded.clips.edges) {
        assert!(
            b.offset >= a.offset - 1e-3 && b.offset <= a.offset + 0.02,
            "{a:?} {b:?}"
        );
    }
}

#[test]
fn cloud_keeps_records_and_order() {
    let dir = tempfile::tempdir().unwrap();
    for (i, style) in styles().into_iter().enumerate() {
        let path = dir.path().join(format!("{i}.lvc"));
        let mut random = Random(i as u64);
        let given = surfels(&mut random, 70_000, style);
        let voxels = lvoxels(&mut random, 1000, style);
        let summary = write_cloud(&path, &given, &voxels, style);
        let cloud = Cloud::open_path(&path).unwrap();
        cloud.verify().unwrap();
        assert_eq!(cloud.summary(), &summary);
        assert_eq!(cloud.meta(), &cloud_meta(style));
        assert_eq!(cloud.surfel_chunks(), 2);
        let decoded: Vec<Surfel> = (0..2)
            .flat_map(|i| cloud.surfel_chunk(i).unwrap())
            .collect();
        assert_eq!(decoded.len(), given.len());
        for (a, b) in given.iter().zip(&decoded) {
            assert_eq!(a.position, b.position);
            assert_eq!((a.radius, a.front, a.back), (b.radius, b.front, b.back));
            assert!(close(
                a.area,
                b.area,
                if style.free_area { 0.0 } else { 1e-6 }
            ));
            check_shape(a, b);
        }
        let positions = cloud.surfel_positions(1).unwrap();
        assert_eq!(positions[3], given[CHUNK_RECORDS + 3].position);
        assert_eq!(cloud.lvoxel_chunk(0).unwrap(), voxels);

        // Reading and writing again changes nothing more.
        let again = dir.path().join("again.lvc");
        write_cloud(&again, &decoded, &voxels, style);
        assert!(std::fs::read(&path).unwrap() == std::fs::read(&again).unwrap());
    }
}

fn styles() -> Vec<Style> {
    let plain = Style::default();
    vec![
        plain,
        Style {
            grey: true,
            back: false,
            clips: false,
            ..plain
        },
        Style {
            overlap: 2.2,
            free_area: true,
            ..plain
        },
        Style {
            light: 0.0,
            ..plain
        },
        Style {
            light: 1e30,
            scale: 1e6,
            ..plain
        },
        Style {
            light: 1e-30,
            scale: 1e-6,
            ..plain
        },
    ]
}

#[test]
fn columns_that_are_not_needed_are_absent() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.lvc");
    let style = Style {
        grey: true,
        back: false,
        clips: false,
        ..Style::default()
    };
    let given = surfels(&mut Random(1), 1000, style);
    let summary = write_cloud(&path, &given, &[], style);
    let names: Vec<_> = summary.columns.iter().map(|c| c.name.as_str()).collect();
    assert_eq!(names, ["position", "normal", "radius", "front_grey"]);
    let out: Vec<_> = summary
        .left_out
        .iter()
        .map(|c| (c.name.as_str(), c.raw_bytes))
        .collect();
    assert_eq!(
        out,
        [
            ("area", 4000),
            ("front", 8000),
            ("back", 12000),
            ("clip_counts", 1000)
        ]
    );
    let stored: u64 = summary.columns.iter().map(|c| c.stored_bytes).sum();
    let blocks: u64 = Cloud::open_path(&path)
        .unwrap()
        .surfel_blocks()
        .iter()
        .map(|b| u64::from(b.stored_bytes))
        .sum();
    assert_eq!(stored, blocks);
}

#[test]
fn how_surfels_are_pushed_does_not_matter() {
    let dir = tempfile::tempdir().unwrap();
    let style = Style::default();
    let given = surfels(&mut Random(3), 150_000, style);
    let (one, many) = (dir.path().join("one.lvc"), dir.path().join("many.lvc"));
    write_cloud(&one, &given, &[], style);
    let mut writer = CloudWriter::create(&many, cloud_meta(style), Overwrite::Refuse).unwrap();
    for some in given.chunks(777) {
        writer.push_surfels(some).unwrap();
    }
    writer.finish().unwrap();
    assert!(std::fs::read(one).unwrap() == std::fs::read(many).unwrap());
}

#[test]
fn empty_files() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.lvc");
    let summary = write_cloud(&path, &[], &[], Style::default());
    assert_eq!(summary.bounds, None);
    let cloud = Cloud::open_path(&path).unwrap();
    cloud.verify().unwrap();
    assert_eq!((cloud.surfel_chunks(), cloud.lvoxel_chunks()), (0, 0));

    let path = dir.path().join("a.lvt");
    write_tree(&path, Style::default(), 0, 0);
    let tree = Tree::open_path(&path).unwrap();
    tree.verify().unwrap();
    assert_eq!(tree.root_page(), None);
}

#[test]
fn nothing_is_left_behind_and_nothing_overwritten() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.lvc");
    let style = Style::default();
    let given = surfels(&mut Random(3), 100, style);
    let mut writer = CloudWriter::create(&path, cloud_meta(style), Overwrite::Refuse).unwrap();
    writer.push_surfels(&given).unwrap();
    drop(writer);
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0);

    write_cloud(&path, &given, &[], style);
    let error = CloudWriter::create(&path, cloud_meta(style), Overwrite::Refuse)
        .err()
        .unwrap();
    assert!(matches!(error.cause(), FormatError::Exists));
    assert!(error.to_string().contains("a.lvc") && error.hint().unwrap().contains("`overwrite`"));

    // A name that was taken between create and finish is not overwritten either.
    let other = dir.path().join("b.lvc");
    let writer = CloudWriter::create(&other, cloud_meta(style), Overwrite::Refuse).unwrap();
    std::fs::write(&other, "mine").unwrap();
    assert!(matches!(
        writer.finish().err().unwrap().cause(),
        FormatError::Exists
    ));
    assert_eq!(std::fs::read(&other).unwrap(), b"mine");
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 2);
}

#[test]
fn surfels_that_no_reader_accepts_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let style = Style::default();
    let good = surfels(&mut Random(3), 1, style)[0];
    let bad = [
        (
            "position",
            Surfel {
                position: [f32::NAN, 0.0, 0.0],
                ..good
            },
        ),
        (
            "normal",
            Surfel {
                normal: [0.0; 3],
                ..good
            },
        ),
        (
            "radius",
            Surfel {
                radius: 0.0,
                ..good
            },
        ),
        ("area", Surfel { area: -1.0, ..good }),
        (
            "front radiance",
            Surfel {
                front: [f32::INFINITY, 0.0, 0.0],
                ..good
            },
        ),
        (
            "back radiance",
            Surfel {
                back: [0.0, -1.0, 0.0],
                ..good
            },
        ),
    ];
    for (what, surfel) in bad {
        let path = dir.path().join("a.lvc");
        let mut writer = CloudWriter::create(&path, cloud_meta(style), Overwrite::Refuse).unwrap();
        let error = writer
            .push_surfels(&[good, surfel])
            .unwrap_err()
            .to_string();
        assert!(
            error.contains(what) && error.contains("surfel 1") && error.contains("a.lvc"),
            "{error}"
        );
    }
}

#[test]
fn lvoxels_that_no_reader_accepts_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let style = Style::default();
    let path = dir.path().join("a.lvc");
    let mut writer = CloudWriter::create(&path, cloud_meta(style), Overwrite::Refuse).unwrap();
    let voxel = lvoxels(&mut Random(1), 1, style)[0];
    for bad in [
        Lvoxel { volume: 2, ..voxel },
        Lvoxel { level: 4, ..voxel },
        Lvoxel {
            level: 0,
            block: [64, 0, 0],
            ..voxel
        },
        Lvoxel {
            sigma_t: f32::NAN,
            ..voxel
        },
        Lvoxel {
            source: [-1.0; 3],
            ..voxel
        },
        Lvoxel {
            lobe: [127, 0, 0],
            ..voxel
        },
        Lvoxel {
            single: record::LightPart {
                share: 1,
                lobe: [0, -127, 0],
            },
            ..voxel
        },
    ] {
        assert!(writer.push_lvoxels(&[bad]).is_err());
    }
}

/// Compares a tree's pages with what was given, with the bounds of the format.
fn check_tree(path: &std::path::Path, given: &[SurfelPage], style: Style) {
    let tree = Tree::open_path(path).unwrap();
    tree.verify().unwrap();
    for error in &tree.summary().errors {
        assert!(
            error.worst <= error.bound * (1.0 + 1e-3) + 1e-6,
            "{error:?}"
        );
    }
    assert_eq!(tree.surfel_pages(), given.len());
    // Used again for each page, as readers do.
    let (mut nodes, mut leaves) = (Vec::new(), SurfelLeaves::default());
    for (i, given) in given.iter().enumerate() {
        let page = tree.surfel_page(i).unwrap();
        let root = page.nodes[0].bounds;
        let half_step: [f32; 3] = std::array::from_fn(|k| {
            (root.max[k] - root.min[k]) / 65535.0 * 0.51
                + root.max[k].abs().max(root.min[k].abs()) * 1e-6
        });
        assert_eq!(page.surfels.len(), given.surfels.len());
        tree.surfel_nodes(i, &mut nodes).unwrap();
        assert_eq!(nodes, page.nodes);
        tree.surfel_leaves(i, &mut leaves).unwrap();
        assert_eq!(leaves.surfels, page.surfels);
        let counts: Vec<u8> = page
            .nodes
            .iter()
            .filter_map(|n| n.below.surfels())
            .collect();
        assert_eq!(leaves.counts, counts);
        for (a, b) in given.surfels.iter().zip(&page.surfels) {
            let near = |k: usize| (a.position[k] - b.position[k]).abs() <= half_step[k] * 1.01;
            assert!((0..3).all(near));
            assert!(close(a.radius, b.radius, 5e-4));
            assert!(close(a.area, b.area, 1.1e-3));
            assert!(colours_close(a.front, b.front, 1.0 / 512.0));
            assert!(colours_close(a.back, b.back, 1.0 / 512.0));
            check_shape(a, b);
        }
        for (a, b) in given.nodes.iter().zip(&page.nodes) {
            assert_eq!(a.below, b.below);
            for k in 0..3 {
                assert!(b.bounds.min[k] <= a.bounds.min[k] && b.bounds.max[k] >= a.bounds.max[k]);
            }
            let (a, b) = (&a.aggregate, &b.aggregate);
            assert_eq!(a.area, b.area);
            let near = |k: usize| {
                (a.centre[k] - b.centre[k]).abs() <= half_step[k] * 1.01
                    && (a.normal_sum[k] - b.normal_sum[k]).abs() <= a.area * 1.6e-5
            };
            assert!((0..3).all(near));
            for k in 0..6 {
                assert!((a.second_moment[k] - b.second_moment[k]).abs() <= a.area * 1.6e-5);
                assert!((a.axis_area[k] - b.axis_area[k]).abs() <= a.area * 1.6e-5);
                assert!(colours_close(
                    a.axis_radiance[k],
                    b.axis_radiance[k],
                    1.0 / 512.0
                ));
                assert!(colours_close(
                    a.back_radiance[k],
                    b.back_radiance[k],
                    1.0 / 512.0
                ));
            }
        }
    }
    let _ = style;
}

#[test]
fn tree_pages_within_bounds() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.lvt");
    for style in styles() {
        let given = write_tree(&path, style, 4, 700);
        check_tree(&path, &given, style);
    }
}

#[test]
fn lvoxels_come_back_in_any_order_and_take_least_room_in_morton_order() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.lvt");
    let grey = smooth_lvoxels();
    let mut coloured = grey.clone();
    for (i, v) in coloured.iter_mut().enumerate() {
        v.source[0] *= 1.0 + 1e-3 * i as f32;
    }
    let mut turned = grey.clone();
    turned.reverse();
    let mut twice = grey.clone();
    twice.extend(&grey);
    let write = |voxels: &[Lvoxel]| {
        let meta = TreeMeta {
            cloud: cloud_meta(Style::default()),
            cloud_hash: [0; 16],
            settings: vec![],
        };
        let mut writer = TreeWriter::create(&path, meta, Overwrite::Replace).unwrap();
        push_lvoxels(&mut writer, voxels, Style::default());
        let sums = Sums::of_nothing(2);
        writer.finish(None, sums, vec![]).unwrap();
        let tree = Tree::open_path(&path).unwrap();
        tree.verify().unwrap();
        (tree.lvoxel_page(0).unwrap(), tree.lvoxel_blocks()[0])
    };
    for voxels in [&grey, &coloured, &turned, &twice] {
        let (decoded, block) = write(voxels);
        assert_eq!(decoded.len(), voxels.len());
        for (a, b) in voxels.iter().zip(&decoded) {
            assert_eq!((a.volume, a.level, a.block), (b.volume, b.level, b.block));
            assert!(close(a.sigma_t, b.sigma_t, 1.0 / 2048.0));
            assert!(colours_close(a.source, b.source, 1.0 / 512.0));
        }
        let (again, same) = write(&decoded);
        assert_eq!(decoded, again);
        assert_eq!(block.checksum, same.checksum);
    }
    // The same numbers, whatever order they come in.
    let mut back = write(&turned).0;
    back.reverse();
    assert_eq!(back, write(&grey).0);
    assert!(write(&grey).1.stored_bytes < write(&turned).1.stored_bytes);
}

#[test]
fn tree_lvoxels_within_bounds() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.lvt");
    for (style, same) in [
        (Style::default(), true),
        (styles()[1], false),
        (styles()[3], true),
    ] {
        let mut voxels = lvoxels(&mut Random(9), 3000, style);
        if same {
            for v in &mut voxels {
                (v.volume, v.level, v.sigma_t) = (1, 0, 0.25);
            }
        }
        let meta = TreeMeta {
            cloud: cloud_meta(style),
            ..TreeMeta::default()
        };
        let mut writer = TreeWriter::create(&path, meta, Overwrite::Replace).unwrap();
        push_lvoxels(&mut writer, &voxels, style);
        let sums = Sums::of_nothing(2);
        let summary = writer.finish(None, sums, Vec::new()).unwrap();
        assert_eq!(summary.columns.iter().any(|c| c.name == "sigma_t"), !same);
        let tree = Tree::open_path(&path).unwrap();
        tree.verify().unwrap();
        for (a, b) in voxels.iter().zip(tree.lvoxel_page(0).unwrap()) {
            assert_eq!((a.volume, a.level, a.block), (b.volume, b.level, b.block));
            assert!(close(a.sigma_t, b.sigma_t, if same { 0.0 } else { 5e-4 }));
            assert!(colours_close(a.source, b.source, 1.0 / 512.0));
        }
    }
}

#[test]
fn a_page_needs_order() {
    let mut random = Random(2);
    let own = surfels(&mut random, 40, Style::default());
    let good = page(
        &mut random,
        &own,
        &[(
            3,
            Bounds {
                min: [0.0; 3],
                max: [1.0; 3],
            },
        )],
    );
    assert!(EncodedPage::new(&good, 4, 1.7).is_ok());
    assert!(EncodedPage::new(&good, 3, 1.7).is_err(), "a link to itself");
    let mut bad = good.clone();
    bad.nodes.swap(1, 2);
    assert!(EncodedPage::new(&bad, 4, 1.7).is_err());
    let mut bad = good.clone();
    bad.surfels.pop();
    assert!(EncodedPage::new(&bad, 4, 1.7).is_err());
    let mut bad = good.clone();
    bad.nodes[0].below = Below::Nodes { first: 0, count: 1 };
    assert!(EncodedPage::new(&bad, 4, 1.7).is_err());
    assert!(EncodedPage::new(&SurfelPage::default(), 4, 1.7).is_err());
}

/// A tree of one page.
fn write_page(path: &Path, page: &SurfelPage, style: Style) {
    let meta = TreeMeta {
        cloud: cloud_meta(style),
        ..TreeMeta::default()
    };
    let mut writer = TreeWriter::create(path, meta, Overwrite::Replace).unwrap();
    let encoded = EncodedPage::new(page, 0, style.overlap).unwrap();
    writer.push_surfel_page(&encoded).unwrap();
    let sums = Sums::of_nothing(2);
    writer.finish(Some(0), sums, Vec::new()).unwrap();
}

#[test]
fn tiny_disks_in_a_wide_page_keep_their_place() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.lvt");
    let style = Style {
        scale: 1e-4,
        ..Style::default()
    };
    let mut own = surfels(&mut Random(2), 16, style);
    own[15].position = [1e4, -1e4, 1e4];
    let page = page(&mut Random(2), &own, &[]);
    write_page(&path, &page, style);
    let tree = Tree::open_path(&path).unwrap();
    tree.verify().unwrap();
    for (a, b) in own.iter().zip(tree.surfel_page(0).unwrap().surfels) {
        assert_eq!(a.position, b.position);
    }
}

proptest! {
    #![proptest_config(ProptestConfig {
        failure_persistence: None,
        ..ProptestConfig::with_cases(60)
    })]

    #[test]
    fn pages_of_any_scale(
        seed: u64,
        scale in -15f32..15.0,
        light in -30f32..30.0,
        n in 1usize..200,
        free_area: bool,
        x in -1e3f32..1e3,
    ) {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.lvt");
        let style = Style {
            scale: 10f32.powf(scale),
            light: 10f32.powf(light),
            free_area,
            ..Style::default()
        };
        let mut random = Random(seed);
        let mut own = surfels(&mut random, n, style);
        for s in &mut own {
            s.position[0] += x * style.scale;
        }
        let page = page(&mut random, &own, &[]);
        write_page(&path, &page, style);
        check_tree(&path, &[page], style);
    }

    #[test]
    fn light_of_all_sizes_in_one_page(seed: u64) {
        let mut random = Random(seed);
        let mut own = surfels(&mut random, 100, Style::default());
        for s in &mut own {
            let size = 10f32.powf(random.unit() * 60.0 - 30.0);
            s.front = s.front.map(|c| c * size);
        }
        let given = page(&mut random, &own, &[]);
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.lvt");
        write_page(&path, &given, Style::default());
        check_tree(&path, &[given], Style::default());
    }
}

//! What `inspect` says of files is what is in them.

use lvox::build::{self, Settings};
use lvox::formats::*;
use lvox::inspect;
use lvox::run::Job;
use std::path::{Path, PathBuf};

const N: usize = 3000;

/// A sphere of surfels and a block of smoke.
fn files(dir: &Path) -> (PathBuf, PathBuf) {
    let (cloud, tree) = (dir.join("ball.lvc"), dir.join("ball.lvt"));
    let area = 4.0 * std::f32::consts::PI / N as f32;
    let surfels: Vec<Surfel> = (0..N)
        .map(|i| {
            let z = 1.0 - (2 * i + 1) as f32 / N as f32;
            let phi = i as f32 * 2.399_963;
            let r = (1.0 - z * z).sqrt();
            let normal = [r * phi.cos(), r * phi.sin(), z];
            Surfel {
                position: normal,
                normal,
                area,
                radius: 2.0 * (area / std::f32::consts::PI).sqrt(),
                front: [1.0, 0.5, 0.25],
                ..Surfel::default()
            }
        })
        .collect();
    let lvoxels: Vec<Lvoxel> = (0..64)
        .map(|i| Lvoxel {
            block: [i % 4, i / 4 % 4, i / 16],
            level: 1,
            sigma_t: 0.5,
            source: [0.1; 3],
            ..Lvoxel::default()
        })
        .collect();
    let meta = CloudMeta {
        scene_name: "ball".into(),
        volumes: vec![VolumeInfo {
            name: "smoke".into(),
            dims: [8; 3],
            index_from_scene: [[2.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 2.0], [4.0; 3]],
            albedo: [0.9; 3],
            extinction_color: [1.0; 3],
        }],
        settings: vec![("density".into(), "1".into())],
        disk_overlap: 2.0,
        ..CloudMeta::default()
    };
    let mut writer = CloudWriter::create(&cloud, meta, Overwrite::Replace).unwrap();
    writer.push_surfels(&surfels).unwrap();
    writer.push_lvoxels(&lvoxels).unwrap();
    writer.finish().unwrap();
    let settings = Settings {
        page_bytes: 8192,
        ..Settings::default()
    };
    build::run(
        &cloud,
        &tree,
        &settings,
        Overwrite::Replace,
        &Job::default(),
    )
    .unwrap();
    (cloud, tree)
}

#[test]
fn descriptions() {
    let dir = tempfile::tempdir().unwrap();
    let (cloud, tree) = files(dir.path());
    let cloud = inspect::describe(&cloud).unwrap();
    let tree = inspect::describe(&tree).unwrap();
    assert_eq!((cloud.kind, tree.kind), ("cloud", "tree"));
    assert_eq!(tree.cloud_hash.as_ref(), Some(&cloud.content_hash));
    assert_eq!((cloud.surfels.count, cloud.lvoxels.count), (N as u64, 64));
    assert!(tree.surfels.blocks > 3 && tree.nodes > 300);
    assert_eq!(tree.levels.iter().map(|l| l.surfels).sum::<u64>(), N as u64);
    let stored: u64 = tree.levels.iter().map(|l| l.bytes).sum();
    assert!(stored.abs_diff(tree.surfels.stored_bytes) < 100);
    for text in [cloud.to_string(), tree.to_string()] {
        for part in ["scene 'ball'", "smoke", "density", "left out", "area"] {
            assert!(text.contains(part), "{part} in {text}");
        }
    }
    assert!(tree.to_string().contains("worst error"));
    let json = serde_json::to_value(&tree).unwrap();
    for key in [
        "kind",
        "content_hash",
        "sums",
        "columns",
        "left_out",
        "levels",
        "errors",
    ] {
        assert!(!json[key].is_null(), "{key}");
    }
}

#[test]
fn verification_audits_every_depth() {
    let dir = tempfile::tempdir().unwrap();
    let (cloud, tree) = files(dir.path());
    let job = Job::default();
    assert!(inspect::verify(&cloud, &job).unwrap().passed);
    let found = inspect::verify(&tree, &job).unwrap();
    assert!(found.passed, "{found}");
    assert!(found.depths.len() > 3);
    // What was counted while the tree was built is what is there.
    let counted = inspect::describe(&tree).unwrap().levels;
    let found_counts = found.depths.iter().map(|d| (d.nodes, d.surfels));
    let counts: Vec<_> = counted.iter().map(|l| (l.nodes, l.surfels)).collect();
    assert_eq!(found_counts.collect::<Vec<_>>(), counts);
    assert_eq!(
        found.depths.iter().map(|d| d.surfels).sum::<u64>(),
        N as u64
    );
    assert!(
        found
            .checks
            .iter()
            .any(|c| c.name.contains("sigma_t x voxels"))
    );
    assert!(found.to_string().contains("undamaged"));

    let mut bytes = std::fs::read(&tree).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    std::fs::write(&tree, bytes).unwrap();
    let error = inspect::verify(&tree, &job).unwrap_err();
    assert_eq!(error.kind(), lvox::Kind::Input);
    assert!(error.to_string().contains("ball.lvt"));
}

#[test]
fn first_points() {
    let dir = tempfile::tempdir().unwrap();
    let (cloud, tree) = files(dir.path());
    for file in [cloud, tree] {
        let points = inspect::points(&file, 5).unwrap();
        assert_eq!((points.surfels.len(), points.lvoxels.len()), (5, 5));
        assert_eq!(points.to_json()["surfels"][4]["front"][0], 1.0);
        assert!(points.to_string().contains("sigma_t"));
        assert_eq!(inspect::points(&file, 5000).unwrap().surfels.len(), N);
    }
}

/// Positions and radii of a PLY file, which must be as long as its header says.
fn vertices(path: &Path) -> Vec<[f32; 7]> {
    let bytes = std::fs::read(path).unwrap();
    let end = bytes
        .windows(11)
        .position(|w| w == b"end_header\n")
        .unwrap()
        + 11;
    let header = std::str::from_utf8(&bytes[..end]).unwrap();
    assert!(header.starts_with("ply\nformat binary_little_endian 1.0\n"));
    let count: usize = header
        .lines()
        .find_map(|l| l.strip_prefix("element vertex "))
        .unwrap()
        .parse()
        .unwrap();
    let rows: Vec<_> = bytes[end..].chunks(47).collect();
    assert_eq!(rows.len(), count);
    rows.iter()
        .map(|row| {
            std::array::from_fn(|i| f32::from_le_bytes(row[4 * i..4 * i + 4].try_into().unwrap()))
        })
        .collect()
}

#[test]
fn ply_files() {
    let dir = tempfile::tempdir().unwrap();
    let (cloud, tree) = files(dir.path());
    let out = dir.path().join("out.ply");
    for file in [&cloud, &tree] {
        let exported = inspect::export_ply(file, &out, None, Overwrite::Replace).unwrap();
        assert_eq!(
            (exported.vertices, exported.surfels_or_nodes),
            (N as u64 + 64, N as u64)
        );
        let all = vertices(&out);
        for v in &all[..N] {
            let len = v[..3].iter().map(|c| c * c).sum::<f32>().sqrt();
            assert!((len - 1.0).abs() < 1e-3);
        }
        // Blocks of 2^3 voxels of half a unit, from -2 on.
        assert!(all[N..].iter().any(|v| v[..3] == [-1.5; 3]));
    }
    // Nodes of any level cover the ball.
    for level in [0, 1, 2, 4, 9] {
        let exported = inspect::export_ply(&tree, &out, Some(level), Overwrite::Replace).unwrap();
        let n = exported.surfels_or_nodes as usize;
        assert_eq!(level == 0, n == 1);
        let area: f32 = vertices(&out)[..n]
            .iter()
            .map(|v| std::f32::consts::PI * v[6] * v[6])
            .sum();
        assert!((area / (4.0 * std::f32::consts::PI) - 1.0).abs() < 1e-3);
    }
    assert!(inspect::export_ply(&cloud, &out, Some(1), Overwrite::Replace).is_err());
    let error = inspect::export_ply(&cloud, &out, None, Overwrite::Refuse).unwrap_err();
    assert!(error.hint_text().unwrap().contains("`overwrite`"));
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 3);
}

//! Files of every version that is still read, as they were written when that version was frozen.
//!
//! `LVOX_WRITE_GOLDEN=1 cargo test -p lvox-formats --test golden` writes those of the current
//! version anew: only while it is not released.

mod common;

use common::*;
use lvox_formats::*;
use std::path::{Path, PathBuf};

fn golden(name: &str) -> PathBuf {
    [env!("CARGO_MANIFEST_DIR"), "tests", "golden", name]
        .iter()
        .collect()
}

/// The files as they are written now, in a folder.
fn fresh(dir: &Path) -> [PathBuf; 2] {
    let (cloud, tree) = (dir.join("fresh.lvc"), dir.join("fresh.lvt"));
    let style = Style::default();
    let mut random = Random(1);
    let own = surfels(&mut random, 12, style);
    let voxels = lvoxels(&mut random, 5, style);
    write_cloud(&cloud, &own, &voxels, style);
    write_tree(&tree, style, 3, 12);
    [cloud, tree]
}

/// Compares the files kept of a version, whose trees have so many pages of lvoxels, with new ones.
fn compare(version: u32, lvoxel_pages: usize) {
    let dir = tempfile::tempdir().unwrap();
    let [cloud, tree] = fresh(dir.path());
    let [kept_cloud, kept_tree] = ["lvc", "lvt"].map(|e| golden(&format!("v{version}.{e}")));
    if version == VERSION && std::env::var_os("LVOX_WRITE_GOLDEN").is_some() {
        std::fs::copy(&cloud, &kept_cloud).unwrap();
        std::fs::copy(&tree, &kept_tree).unwrap();
    }

    let kept = Cloud::open_path(&kept_cloud).unwrap();
    kept.verify().unwrap();
    let fresh = Cloud::open_path(&cloud).unwrap();
    assert_eq!((kept.version(), fresh.version()), (version, VERSION));
    assert_eq!(kept.meta(), fresh.meta());
    assert_eq!(
        kept.surfel_chunk(0).unwrap(),
        fresh.surfel_chunk(0).unwrap()
    );
    assert_eq!(
        kept.lvoxel_chunk(0).unwrap(),
        fresh.lvoxel_chunk(0).unwrap()
    );
    let own = surfels(&mut Random(1), 12, Style::default());
    assert_eq!(kept.surfel_chunk(0).unwrap()[3].position, own[3].position);

    let kept = Tree::open_path(&kept_tree).unwrap();
    kept.verify().unwrap();
    let fresh = Tree::open_path(&tree).unwrap();
    assert_eq!((kept.version(), fresh.version()), (version, VERSION));
    assert_eq!(kept.meta(), fresh.meta());
    for i in 0..3 {
        let mut fresh = fresh.surfel_page(i).unwrap();
        if version < 3 {
            // One mean stood for fronts and backs.
            for node in &mut fresh.nodes {
                node.aggregate.back_radiance = node.aggregate.axis_radiance;
            }
        }
        assert_eq!(kept.surfel_page(i).unwrap(), fresh);
        assert!(kept.has_backs(i));
    }
    assert_eq!(kept.lvoxel_pages(), lvoxel_pages);
    for i in 0..lvoxel_pages {
        assert_eq!(kept.lvoxel_page(i).unwrap(), fresh.lvoxel_page(i).unwrap());
    }
}

#[test]
fn version_1() {
    compare(1, 1);
}

#[test]
fn version_2() {
    compare(2, 2);
    // The second page has the columns that came with this version.
    let tree = Tree::open_path(&golden("v2.lvt")).unwrap();
    assert_eq!(tree.lvoxel_blocks()[1].columns >> 8, 0b111);
}

#[test]
fn version_3() {
    compare(3, 2);
    // The column that came with this version, the 29th.
    let tree = Tree::open_path(&golden("v3.lvt")).unwrap();
    assert!(tree.surfel_blocks().iter().all(|b| b.columns >> 28 == 1));
}

#[test]
fn scattered_light_of_version_3() {
    let dir = tempfile::tempdir().unwrap();
    let (fresh, kept) = (dir.path().join("fresh.lvs"), golden("v3.lvs"));
    let given = parts(&mut Random(1));
    write_scatter(&fresh, &given);
    if std::env::var_os("LVOX_WRITE_GOLDEN").is_some() {
        std::fs::copy(&fresh, &kept).unwrap();
    }
    let kept = Scatter::open_path(&kept).unwrap();
    kept.verify().unwrap();
    assert_eq!((kept.version(), kept.meta()), (3, &scatter_meta()));
    for (i, (kind, place, part)) in given.iter().enumerate() {
        assert_eq!(kept.blocks()[i].kind, *kind);
        assert_eq!(kept.summary().parts[i], *place);
        assert_eq!(kept.part(i).unwrap(), *part);
    }
}

#[test]
fn columns_of_later_versions_are_refused() {
    for (file, version) in [("v2.lvt", 1), ("v3.lvt", 2)] {
        let mut bytes = std::fs::read(golden(file)).unwrap();
        bytes[12] = version;
        let sum = xxhash_rust::xxh3::xxh3_64(&bytes[..96]);
        bytes[96..104].copy_from_slice(&sum.to_le_bytes());
        let error = Tree::open(bytes).err().unwrap().to_string();
        let expected = format!("those of version {version}");
        assert!(error.contains(&expected), "{error}");
    }
}

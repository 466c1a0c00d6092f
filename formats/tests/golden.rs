//! Files of every version that is still read, as they were written when that version was frozen.
//!
//! `LVOX_WRITE_GOLDEN=1 cargo test -p lvox-formats --test golden` writes those of the current version anew: only while
//! it is not released.

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
        assert_eq!(kept.surfel_page(i).unwrap(), fresh.surfel_page(i).unwrap());
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
fn columns_of_version_2_are_refused_in_version_1() {
    let mut bytes = std::fs::read(golden("v2.lvt")).unwrap();
    bytes[12] = 1;
    let sum = xxhash_rust::xxh3::xxh3_64(&bytes[..96]);
    bytes[96..104].copy_from_slice(&sum.to_le_bytes());
    let error = Tree::open(bytes).err().unwrap();
    assert!(error.to_string().contains("version 1"), "{error}");
}

//! Files of every version that is still read, as they were written when that version was frozen.
//!
//! `LVOX_WRITE_GOLDEN=1 cargo test -p lvox-formats --test golden` writes those of the current version anew: only while
//! it is not released.

mod common;

use common::*;
use lvox_formats::*;
use std::path::PathBuf;

fn golden(name: &str) -> PathBuf {
    [env!("CARGO_MANIFEST_DIR"), "tests", "golden", name]
        .iter()
        .collect()
}

#[test]
fn version_1() {
    let dir = tempfile::tempdir().unwrap();
    let (cloud, tree) = (dir.path().join("v1.lvc"), dir.path().join("v1.lvt"));
    let style = Style::default();
    let mut random = Random::new(1);
    let own = surfels(&mut random, 12, style);
    let voxels = lvoxels(&mut random, 5, style);
    write_cloud(&cloud, &own, &voxels, style);
    write_tree(&tree, style, 3, 12);
    for path in [&cloud, &tree] {
        let kept = golden(path.file_name().unwrap().to_str().unwrap());
        if std::env::var_os("LVOX_WRITE_GOLDEN").is_some() {
            std::fs::copy(path, &kept).unwrap();
        }
    }

    let kept = Cloud::open_path(&golden("v1.lvc")).unwrap();
    kept.verify().unwrap();
    let fresh = Cloud::open_path(&cloud).unwrap();
    assert_eq!(kept.meta(), fresh.meta());
    assert_eq!(
        kept.surfel_chunk(0).unwrap(),
        fresh.surfel_chunk(0).unwrap()
    );
    assert_eq!(
        kept.lvoxel_chunk(0).unwrap(),
        fresh.lvoxel_chunk(0).unwrap()
    );
    assert_eq!(kept.surfel_chunk(0).unwrap()[3].position, own[3].position);

    let kept = Tree::open_path(&golden("v1.lvt")).unwrap();
    kept.verify().unwrap();
    let fresh = Tree::open_path(&tree).unwrap();
    assert_eq!(kept.meta(), fresh.meta());
    for i in 0..3 {
        assert_eq!(kept.surfel_page(i).unwrap(), fresh.surfel_page(i).unwrap());
    }
    assert_eq!(kept.lvoxel_page(0).unwrap(), fresh.lvoxel_page(0).unwrap());
}

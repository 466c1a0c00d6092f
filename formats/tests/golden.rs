//! The files of the current version, kept as they are written.
//!
//! `LVOX_WRITE_GOLDEN=1 cargo test -p lvox-formats --test golden` writes them anew. It does so only
//! while that version is not released: then the files of a released version stay, and the next
//! version gets its own.

mod common;

use common::*;
use lvox_formats::*;
use std::path::{Path, PathBuf};

/// The file `v1.<extension>`; written anew from `fresh` on request.
fn golden(extension: &str, fresh: &Path) -> PathBuf {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden");
    let kept = folder.join(format!("v{VERSION}.{extension}"));
    if std::env::var_os("LVOX_WRITE_GOLDEN").is_some() {
        std::fs::copy(fresh, &kept).unwrap();
    }
    kept
}

#[test]
fn cloud() {
    let dir = tempfile::tempdir().unwrap();
    let fresh = dir.path().join("fresh.lvc");
    let style = Style::default();
    let mut random = Random(1);
    let given = surfels(&mut random, 12, style);
    let voxels = lvoxels(&mut random, 5, style);
    write_cloud(&fresh, &given, &voxels, style);
    let kept = Cloud::open_path(&golden("lvc", &fresh)).unwrap();
    kept.verify().unwrap();
    let fresh = Cloud::open_path(&fresh).unwrap();
    assert_eq!((kept.version(), fresh.version()), (VERSION, VERSION));
    assert_eq!(kept.meta(), fresh.meta());
    let surfels = kept.surfel_chunk(0).unwrap();
    assert_eq!(surfels, fresh.surfel_chunk(0).unwrap());
    assert_eq!(surfels[3].position, given[3].position);
    assert_eq!(kept.lvoxel_chunk(0).unwrap(), voxels);
}

#[test]
fn tree() {
    let dir = tempfile::tempdir().unwrap();
    let fresh = dir.path().join("fresh.lvt");
    write_tree(&fresh, Style::default(), 3, 12);
    let kept = Tree::open_path(&golden("lvt", &fresh)).unwrap();
    kept.verify().unwrap();
    let fresh = Tree::open_path(&fresh).unwrap();
    assert_eq!((kept.version(), fresh.version()), (VERSION, VERSION));
    assert_eq!(kept.meta(), fresh.meta());
    assert_eq!((kept.surfel_pages(), kept.lvoxel_pages()), (3, 2));
    for i in 0..3 {
        assert_eq!(kept.surfel_page(i).unwrap(), fresh.surfel_page(i).unwrap());
        assert!(kept.has_backs(i));
    }
    for i in 0..2 {
        assert_eq!(kept.lvoxel_page(i).unwrap(), fresh.lvoxel_page(i).unwrap());
    }
}

#[test]
fn scattered_light() {
    let dir = tempfile::tempdir().unwrap();
    let fresh = dir.path().join("fresh.lvs");
    let given = clusters(&mut Random(1));
    write_scatter(&fresh, &given);
    let kept = Scatter::open_path(&golden("lvs", &fresh)).unwrap();
    kept.verify().unwrap();
    assert_eq!((kept.version(), kept.meta()), (VERSION, &scatter_meta()));
    for (i, (kind, id, cluster)) in given.iter().enumerate() {
        assert_eq!(kept.blocks()[i].kind, *kind);
        assert_eq!(kept.summary().clusters[i], *id);
        assert_eq!(kept.cluster(i).unwrap(), *cluster);
    }
}

#[test]
fn packed_scene() {
    let dir = tempfile::tempdir().unwrap();
    let fresh = dir.path().join("fresh.lvp");
    write_packed(&fresh);
    let kept = Packed::open_path(&golden("lvp", &fresh)).unwrap();
    kept.verify().unwrap();
    assert_eq!((kept.version(), kept.meta()), (VERSION, &packed_meta()));
    for (column, _) in kept.columns() {
        let range = kept.range(column.column, column.item);
        assert!((range.start as u64).is_multiple_of(COLUMN_ALIGNMENT));
        assert_eq!(
            kept.rows(column.column, column.item),
            packed_rows(column.column)
        );
    }
    for (i, bricks) in packed_levels().into_iter().enumerate() {
        let level = kept.level(0, i).unwrap();
        let places: Vec<_> = level.table().entries().iter().map(|e| e.place).collect();
        assert_eq!(places, bricks.iter().map(|b| b.0).collect::<Vec<_>>());
        let mut found = Vec::new();
        let page = kept.media_page(&level, 0, |_, samples| found.push(*samples));
        page.unwrap();
        assert_eq!(found, bricks.iter().map(|b| b.1).collect::<Vec<_>>());
    }
}

/// Colours of extinction go behind the metadata of grey media, whichever kind of file has it.
#[test]
fn extinction_colors_go_behind_all_else() {
    let dir = tempfile::tempdir().unwrap();
    let style = Style::default();
    let tail = |path: &Path| {
        let meta = metadata(path);
        meta[meta.len() - 28..].to_vec()
    };
    let expected = [1_u32, 1, 0, 0]
        .map(u32::to_le_bytes)
        .into_iter()
        .chain([0.5_f32, 1.0, 0.25].map(f32::to_le_bytes));
    let expected: Vec<u8> = expected.flatten().collect();
    let color = |volumes: &mut [VolumeInfo]| volumes[0].extinction_color = [0.5, 1.0, 0.25];
    let mut cloud = cloud_meta(style);
    color(&mut cloud.volumes);
    let path = dir.path().join("a.lvc");
    let writer = CloudWriter::create(&path, cloud.clone(), Overwrite::Refuse).unwrap();
    writer.finish().unwrap();
    assert_eq!(tail(&path), expected);
    assert_eq!(Cloud::open_path(&path).unwrap().meta(), &cloud);
    let mut scatter = scatter_meta();
    color(&mut scatter.volumes);
    let path = dir.path().join("a.lvs");
    let writer = ScatterWriter::create(&path, scatter.clone(), Overwrite::Refuse).unwrap();
    writer.finish().unwrap();
    assert_eq!(tail(&path), expected);
    assert_eq!(Scatter::open_path(&path).unwrap().meta(), &scatter);
}

/// The metadata of a file.
fn metadata(path: &Path) -> Vec<u8> {
    let file = std::fs::read(path).unwrap();
    let number = |at: usize| u64::from_le_bytes(file[at..at + 8].try_into().unwrap()) as usize;
    let (start, length) = (number(24), number(32));
    file[start..start + length].to_vec()
}

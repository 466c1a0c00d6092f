//! Scattered light is read back as it was written, from the same bytes every time, and what no
//! reader would take is not written.

mod common;

use common::*;
use lvox_formats::*;

#[test]
fn scattered_light_keeps_its_vertices_and_only_the_columns_that_it_needs() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.lvs");
    let given = clusters(&mut Random(3));
    let summary = write_scatter(&path, &given);
    let bytes = std::fs::read(&path).unwrap();
    assert_eq!(write_scatter(&path, &given), summary);
    assert_eq!(std::fs::read(&path).unwrap(), bytes, "the same bytes");
    let scatter = Scatter::open_path(&path).unwrap();
    scatter.verify().unwrap();
    assert_eq!(scatter.summary(), &summary);
    let masks: Vec<u32> = scatter.blocks().iter().map(|b| b.columns).collect();
    assert_eq!(masks, [0b0_1011, 0b0_1001, 0b1_0001]);
    for (i, (.., cluster)) in given.iter().enumerate() {
        assert_eq!(scatter.cluster(i).unwrap(), *cluster);
    }
    assert_eq!(scatter.clusters(BlockKind::Indirect, 1).count(), 1);
    assert_eq!(scatter.clusters(BlockKind::Direct, 0).count(), 0);
    let columns: Vec<&str> = summary.columns.iter().map(|c| c.name.as_str()).collect();
    assert_eq!(columns, ["chosen", "share", "light", "light_grey"]);
    let left_out: Vec<&str> = summary.left_out.iter().map(|c| c.name.as_str()).collect();
    assert_eq!(left_out, ["share", "light"]);
}

#[test]
fn parts_that_no_reader_would_take_are_not_written() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.lvs");
    let refused = |kind: BlockKind, id: ClusterId, cluster: &VertexCluster, expected: &str| {
        let mut writer = ScatterWriter::create(&path, scatter_meta(), Overwrite::Replace).unwrap();
        let (first_kind, first_place, first) = clusters(&mut Random(1)).swap_remove(0);
        writer.push(first_kind, first_place, &first).unwrap();
        let error = writer.push(kind, id, cluster).unwrap_err().to_string();
        assert!(
            error.contains("a.lvs") && error.contains(expected),
            "{error}"
        );
    };
    let [first, second, third]: [_; 3] = clusters(&mut Random(1)).try_into().unwrap();
    let (kind, id, cluster) = second;
    refused(first.0, first.1, &first.2, "order of clusters");
    refused(third.0, third.1, &first.2, "no share of point lights");
    let with = |change: &dyn Fn(&mut ClusterId, &mut VertexCluster), expected: &str| {
        let (mut id, mut cluster) = (id, cluster.clone());
        change(&mut id, &mut cluster);
        refused(kind, id, &cluster, expected);
    };
    with(&|id, _| id.volume = 2, "a volume below 2");
    with(&|id, _| id.level = 4, "at most 3");
    // The volume has 64 voxels along x.
    with(&|id, _| id.zyx = [0, 0, 2], "inside [33, 17, 51]");
    with(&|_, cluster| cluster.chosen.fill(0), "with vertices");
    with(&|_, cluster| cluster.chosen.truncate(9), "cubes");
    with(&|_, cluster| cluster.light.truncate(1), "values");
    with(&|_, cluster| cluster.light[0][1] = -1.0, "at least 0");
    with(&|_, cluster| cluster.light[0][2] = f32::NAN, "finite");
    assert!(!path.exists());
}

//! Any damage is found, and no bytes make a reader panic, hang or allocate without bound.

#[path = "../common/mod.rs"]
mod common;
mod packed;

use common::parts::{Part, Parts, repair};
use common::*;
use lvox_formats::*;
use proptest::prelude::*;

fn small_cloud() -> Vec<u8> {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.lvc");
    let style = Style::default();
    let mut random = Random(1);
    let own = surfels(&mut random, 12, style);
    let voxels = lvoxels(&mut random, 5, style);
    write_cloud(&path, &own, &voxels, style);
    std::fs::read(path).unwrap()
}

fn small_tree() -> Vec<u8> {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.lvt");
    write_tree(&path, Style::default(), 3, 12);
    std::fs::read(path).unwrap()
}

fn small_scatter() -> Vec<u8> {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.lvs");
    write_scatter(&path, &clusters(&mut Random(1)));
    std::fs::read(path).unwrap()
}

fn small_packed() -> Vec<u8> {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.lvp");
    write_packed(&path);
    std::fs::read(path).unwrap()
}

fn read_packed(bytes: &[u8]) -> Result<()> {
    Packed::open(bytes)?.verify()
}

fn read_cloud(bytes: &[u8]) -> Result<()> {
    Cloud::open(bytes)?.verify()
}

fn read_tree(bytes: &[u8]) -> Result<()> {
    Tree::open(bytes)?.verify()
}

fn read_scatter(bytes: &[u8]) -> Result<()> {
    Scatter::open(bytes)?.verify()
}

type Reader = fn(&[u8]) -> Result<()>;

fn files() -> [(Vec<u8>, Reader); 4] {
    [
        (small_cloud(), read_cloud),
        (small_tree(), read_tree),
        (small_scatter(), read_scatter),
        (small_packed(), read_packed),
    ]
}

#[test]
fn every_flipped_bit_is_found() {
    for (mut bytes, read) in files() {
        read(&bytes).unwrap();
        for i in 0..bytes.len() {
            for bit in 0..8 {
                bytes[i] ^= 1 << bit;
                assert!(read(&bytes).is_err(), "bit {bit} of byte {i}");
                bytes[i] ^= 1 << bit;
            }
        }
    }
}

#[test]
fn every_cut_and_every_addition_is_found_by_open() {
    for (bytes, read) in files() {
        for len in 0..bytes.len() {
            let error = read(&bytes[..len]).unwrap_err();
            match len {
                0 => assert!(matches!(error, FormatError::NotOurs { .. })),
                _ => assert!(
                    matches!(error, FormatError::Truncated { .. }),
                    "{len}: {error}"
                ),
            }
        }
        let longer = [&bytes[..], &[0]].concat();
        assert!(matches!(read(&longer), Err(FormatError::Truncated { .. })));
    }
}

#[test]
fn other_files_have_their_own_errors() {
    let (cloud, tree) = (small_cloud(), small_tree());
    let error = Cloud::open(&tree).err().unwrap();
    assert!(matches!(error, FormatError::WrongKind { .. }));
    assert_eq!(
        error.to_string(),
        "expected a cloud (.lvc), found a tree (.lvt)"
    );
    let error = Tree::open(&cloud).err().unwrap();
    assert!(matches!(error, FormatError::WrongKind { .. }));
    assert!(error.hint().unwrap().contains("build"));

    let error = Cloud::open(b"\x89PNG\r\n\x1a\nand so on").err().unwrap();
    assert!(matches!(error, FormatError::NotOurs { .. }));
    // As of lvox files of another kind.
    let hints = [
        (Cloud::open(b"").err(), "bake"),
        (Tree::open(b"").err(), "build"),
        (Scatter::open(b"").err(), "scatter"),
        (Packed::open(b"").err(), "pack"),
    ];
    for (error, verb) in hints {
        let hint = error.unwrap().hint().unwrap();
        assert!(hint.contains(&format!("`lvox {verb}`")), "{hint}");
    }
    // A text transfer drops the carriage return.
    let mut text = cloud.clone();
    text.remove(4);
    assert!(matches!(
        Cloud::open(&text),
        Err(FormatError::NotOurs { .. })
    ));

    for found in [0u32, 2, 999] {
        let mut other = cloud.clone();
        other[12..16].copy_from_slice(&found.to_le_bytes());
        let error = Cloud::open(&other).err().unwrap();
        assert!(matches!(
            error,
            FormatError::Version {
                supported: VERSION,
                ..
            }
        ));
        assert!(error.to_string().contains(&found.to_string()));
    }
    assert_eq!(FileKind::of(&tree).unwrap(), FileKind::Tree);
    assert!(FileKind::of(&cloud[..9]).is_err());
}

#[test]
fn errors_name_the_file() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("scene.lvc");
    let error = Cloud::open_path(&path).err().unwrap();
    assert!(error.to_string().contains("scene.lvc") && error.io_error().is_some());
    std::fs::write(&path, "").unwrap();
    let error = Cloud::open_path(&path).err().unwrap();
    assert!(error.to_string().contains("scene.lvc"));
    let mut bytes = small_cloud();
    bytes[150] ^= 1;
    std::fs::write(&path, bytes).unwrap();
    let error = Cloud::open_path(&path).unwrap().verify().unwrap_err();
    assert!(error.to_string().contains("scene.lvc"), "{error}");
    assert!(matches!(error.cause(), FormatError::Checksum { .. }));
    assert!(Cloud::open_path(dir.path()).is_err(), "a folder");
}

#[test]
fn chunks_pages_and_parts_that_do_not_exist() {
    let (cloud, tree) = (small_cloud(), small_tree());
    let cloud = Cloud::open(cloud).unwrap();
    assert!(cloud.surfel_chunk(1).is_err() && cloud.lvoxel_chunk(9).is_err());
    let tree = Tree::open(tree).unwrap();
    assert!(tree.surfel_page(3).is_err() && tree.lvoxel_page(2).is_err());
    let scatter = Scatter::open(small_scatter()).unwrap();
    assert!(scatter.cluster(2).is_ok() && scatter.cluster(3).is_err());
}

/// Float numbers that no reader takes where light, an area or an extinction is meant.
const NOT_LIGHT: [f32; 4] = [f32::NAN, f32::INFINITY, -f32::INFINITY, -1.0];

/// Refused, as invalid and not as damaged, by the complete check and by the reader of each block;
/// the message says what is wrong.
#[track_caller]
fn refused(file: &[u8], read: Reader, says: &str) {
    let error = read(file).unwrap_err();
    assert!(
        matches!(error.cause(), FormatError::Invalid { .. }),
        "{error}"
    );
    assert!(error.to_string().contains(says), "{says}: {error}");
}

/// The file with one of its parts changed, and right checksums.
fn changed(file: &[u8], change: impl FnOnce(&mut Parts)) -> Vec<u8> {
    let mut parts = Parts::of(file);
    change(&mut parts);
    parts.file()
}

#[test]
fn files_put_together_again_are_whole() {
    for (bytes, read) in files() {
        let again = changed(&bytes, |_| {});
        read(&again).unwrap();
        let (a, b) = (Parts::of(&bytes), Parts::of(&again));
        assert!(a.meta == b.meta && a.summary == b.summary);
        assert!((a.blocks.iter().zip(&b.blocks)).all(|(a, b)| a.data == b.data));
    }
}

#[test]
fn scattered_light_that_is_no_light_is_refused() {
    let file = small_scatter();
    // Planes of `chosen`, then of the share and the light of its vertices.
    let start = 8 * CLUSTER_CUBES;
    for column in 0..2 {
        for value in NOT_LIGHT {
            let bytes = changed(&file, |parts| {
                let block = &mut parts.blocks[0];
                let rows = block.records as usize;
                let start = start + column * 12 * rows;
                block.set(0, (start, rows), [rows - 1, 8], &value.to_le_bytes());
            });
            let name = ["share", "light"][column];
            refused(&bytes, read_scatter, name);
            assert!(Scatter::open(&bytes).unwrap().cluster(0).is_err());
        }
    }
    // Vertices outside of the lattice, and other ones than the table counts.
    let bytes = changed(&file, |parts| {
        let at = CLUSTER_CUBES - 1;
        let first = parts.blocks[1].data[0]
            .1
            .iter()
            .position(|b| *b != 0)
            .unwrap();
        let block = &mut parts.blocks[1].data[0].1;
        block[at] = block[first];
        block[first] = 0;
    });
    refused(&bytes, read_scatter, "vertices of the cluster");
}

/// The files of a volume that is not grey, and those of a grey one before them.
#[test]
fn extinction_colors_are_read_or_refused() {
    const COLOR: [f32; 3] = [0.25, 1.0, 0.5];
    for (i, (grey, read)) in files().into_iter().take(3).enumerate() {
        // Behind a file of grey media nothing stands, as programs expect that know of no colours.
        let end = Parts::of(&grey).meta.len();
        let part = |volumes: &[(u32, [f32; 3])]| {
            let mut part = 1_u32.to_le_bytes().to_vec();
            part.extend((volumes.len() as u64).to_le_bytes());
            for (volume, color) in volumes {
                part.extend(volume.to_le_bytes());
                part.extend(color.map(f32::to_le_bytes).as_flattened());
            }
            part
        };
        let with = |bytes: &[u8]| changed(&grey, |parts| parts.meta.extend(bytes));
        let colored = with(&part(&[(1, COLOR)]));
        read(&colored).unwrap();
        let volumes = match i {
            0 => Cloud::open(&colored[..]).unwrap().meta().volumes.clone(),
            1 => {
                let tree = Tree::open(&colored[..]).unwrap();
                tree.meta().cloud.volumes.clone()
            }
            _ => Scatter::open(&colored[..]).unwrap().meta().volumes.clone(),
        };
        assert_eq!(volumes[0].extinction_color, [1.0; 3]);
        assert_eq!(volumes[1].extinction_color, COLOR);
        let both = part(&[(0, [1.0, 0.0, 1.0]), (1, COLOR)]);
        read(&with(&both)).unwrap();
        let [twice, unknown] = [[&both[..], &both].concat(), [&[9], &both[1..]].concat()];
        for (bytes, says) in [
            (part(&[]), "a part that says nothing"),
            (part(&[(2, COLOR)]), "of no volume"),
            (part(&[(1, COLOR), (0, COLOR)]), "out of order"),
            (part(&[(1, COLOR), (1, COLOR)]), "out of order"),
            (part(&[(1, [1.0; 3])]), "that is grey"),
            (part(&[(1, [0.5; 3])]), "the largest 1"),
            (part(&[(1, [1.0, f32::NAN, 1.0])]), "extinction colour"),
            (part(&[(1, [1.0, f32::INFINITY, 1.0])]), "from 0 to 1"),
            (part(&[(1, [1.0, -0.5, 1.0])]), "from 0 to 1"),
            (twice, "parts out of order"),
            (unknown, "unknown kind"),
            (both[..both.len() - 1].to_vec(), "metadata"),
            ([&both[..], &[0]].concat(), "metadata"),
        ] {
            refused(&with(&bytes), read, says);
        }
        assert_eq!(Parts::of(&colored).meta.len() - end, 4 + 8 + 16);
    }
}

#[test]
fn clusters_outside_of_their_lattice_are_refused() {
    // In the summary: a count, then volume, level and place of each cluster.
    for (at, value, says) in [
        (8, 2, "a volume below 2"),
        (10, 4, "at most 3"),
        (10, u8::MAX, "at most 3"),
        (11, 5, "inside"),
        (12, 1, "inside"),
        (16, 200, "inside"),
    ] {
        let bytes = changed(&small_scatter(), |parts| parts.summary[at] = value);
        refused(&bytes, read_scatter, says);
        assert!(Scatter::open(&bytes).is_err(), "no stage gets hold of it");
    }
}

#[test]
fn values_of_clouds_are_checked() {
    let file = small_cloud();
    // Column, byte in the row, and what it must be.
    let columns = [
        (0, 4, "position"),
        (2, 0, "radius"),
        (3, 8, "front"),
        (4, 0, "back"),
    ];
    for (column, byte, says) in columns {
        for value in NOT_LIGHT
            .into_iter()
            .filter(|v| says != "position" || !v.is_finite())
        {
            let bytes = changed(&file, |parts| {
                let rows = parts.blocks[0].records as usize;
                parts.blocks[0].set(column, (0, rows), [rows - 1, byte], &value.to_le_bytes());
            });
            refused(&bytes, read_cloud, says);
            assert!(Cloud::open(&bytes).unwrap().surfel_chunk(0).is_err());
        }
    }
    // Volume, level, block and extinction of an lvoxel.
    for (column, value, says) in [
        (0, &[2, 0][..], "volume"),
        (1, &[4], "level"),
        (1, &[255], "level"),
        (2, &[0, 0, 255, 255], "block"),
        (3, &f32::NAN.to_le_bytes(), "sigma_t"),
        (4, &(-1f32).to_le_bytes(), "source"),
        (5, &[127], "lobe"),
    ] {
        let bytes = changed(&file, |parts| {
            let rows = parts.blocks[1].records as usize;
            parts.blocks[1].set(column, (0, rows), [1, 0], value);
        });
        refused(&bytes, read_cloud, says);
        assert!(Cloud::open(&bytes).unwrap().lvoxel_chunk(0).is_err());
    }
}

#[test]
fn values_of_trees_are_checked() {
    let file = small_tree();
    let page = &Parts::of(&file).blocks[0];
    let nodes = page.nodes as usize;
    // Areas of nodes are the first four bytes behind kinds and boxes.
    let areas = (64 + 13 * nodes, nodes);
    for value in NOT_LIGHT {
        let bytes = changed(&file, |parts| {
            parts.blocks[0].set(0, areas, [1, 0], &value.to_le_bytes());
        });
        refused(&bytes, read_tree, "area of node 1");
        let tree = Tree::open(&bytes).unwrap();
        assert!(tree.surfel_nodes(0, &mut Vec::new()).is_err());
    }
    // An area whose sum of normals is infinite, by a code beyond -1.
    let bytes = changed(&file, |parts| {
        let page = &mut parts.blocks[0];
        page.set(0, areas, [1, 0], &f32::MAX.to_le_bytes());
        let normals = (64 + (13 + 4 + 6) * nodes, nodes);
        page.set(0, normals, [1, 0], &i16::MIN.to_le_bytes());
    });
    refused(&bytes, read_tree, "normal sum of node 1");
    // The page's box, and a radius base of NaN.
    for (at, says) in [(24, "box of the page"), (48, "radius")] {
        let bytes = changed(&file, |parts| {
            parts.blocks[0].data[0].1[at..at + 4].copy_from_slice(&f32::NAN.to_le_bytes());
        });
        refused(&bytes, read_tree, says);
    }
    // The volume of a page of lvoxels, and their levels behind its header.
    for (at, value, says) in [(14, 2, "volume"), (20, 4, "gap"), (20, 255, "gap")] {
        let bytes = changed(&file, |parts| {
            parts.blocks.last_mut().unwrap().data[0].1[at] = value;
        });
        refused(&bytes, read_tree, says);
        assert!(Tree::open(&bytes).unwrap().lvoxel_page(1).is_err());
    }
}

/// Where `bytes` are in a section, the first time.
fn find(section: &[u8], bytes: &[u8]) -> usize {
    let found = section.windows(bytes.len()).position(|w| w == bytes);
    found.unwrap()
}

#[test]
fn values_of_metadata_and_summary_are_checked() {
    let albedo: Vec<u8> = [0.9f32, 0.8, 0.7]
        .iter()
        .flat_map(|v| v.to_le_bytes())
        .collect();
    let dims: Vec<u8> = [64u32, 32, 100]
        .iter()
        .flat_map(|v| v.to_le_bytes())
        .collect();
    let column: Vec<u8> = [10f64, 0.0, 0.0]
        .iter()
        .flat_map(|v| v.to_le_bytes())
        .collect();
    // A packed scene has checks of its own.
    for (bytes, read) in files().into_iter().take(3) {
        let meta = Parts::of(&bytes).meta;
        let [albedo, dims, column] = [&albedo, &dims, &column].map(|b| find(&meta, b));
        for (at, value, says) in [
            (albedo, &1.5f32.to_le_bytes()[..], "albedo"),
            (albedo + 8, &f32::NAN.to_le_bytes(), "albedo"),
            (albedo, &(-0.1f32).to_le_bytes(), "albedo"),
            (dims, &[0; 4], "size"),
            (dims + 4, &[0, 0, 9, 0], "size"),
            (dims + 8, &[255; 4], "size"),
            (column, &f64::NAN.to_le_bytes(), "place"),
            (column, &1e300f64.to_le_bytes(), "place"),
            (column, &[0; 8], "place"),
        ] {
            let changed = changed(&bytes, |parts| {
                parts.meta[at..at + value.len()].copy_from_slice(value);
            });
            refused(&changed, read, says);
        }
    }
    // Sums begin with a count, an area and three fluxes.
    for (bytes, read) in &files()[..2] {
        for at in [8, 16, 32] {
            for value in [f64::NAN, f64::INFINITY, -1.0] {
                let changed = changed(bytes, |parts| {
                    parts.summary[at..at + 8].copy_from_slice(&value.to_le_bytes());
                });
                refused(&changed, *read, "sums in the summary");
            }
        }
        // Counts of lvoxels whose sum is right where it may pass the largest number.
        let changed = changed(bytes, |parts| {
            let sums = &mut parts.summary[48..];
            let count =
                |sums: &[u8], at: usize| u64::from_le_bytes(sums[at..at + 8].try_into().unwrap());
            let (a, b) = (count(sums, 0), count(sums, 16));
            sums[..8].copy_from_slice(&a.wrapping_sub(b + 1).to_le_bytes());
            sums[16..24].copy_from_slice(&(2 * b + 1).to_le_bytes());
        });
        read(&changed).unwrap_err();
    }
}

proptest! {
    #![proptest_config(ProptestConfig {
        failure_persistence: None,
        ..ProptestConfig::with_cases(3000)
    })]

    /// Correct checksums over wrong bytes: any result will do, but it must come, and a page that is
    /// returned must be safe to walk.
    #[test]
    fn hostile_files(
        file in 0_usize..4,
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..4),
    ) {
        static FILES: std::sync::OnceLock<[Vec<u8>; 4]> = std::sync::OnceLock::new();
        let files = FILES.get_or_init(|| files().map(|(bytes, _)| bytes));
        let mut bytes = files[file].clone();
        for (at, value) in changes {
            let at = at.index(bytes.len());
            bytes[at] = value;
        }
        repair(&mut bytes);
        let _ = read_cloud(&bytes);
        let _ = read_packed(&bytes);
        if let Ok(scatter) = Scatter::open(&bytes) {
            let _ = scatter.verify();
            for (i, block) in scatter.blocks().iter().enumerate() {
                let Ok(cluster) = scatter.cluster(i) else { continue };
                prop_assert_eq!(cluster.len(), block.records as usize);
                for light in [&cluster.share, &cluster.light] {
                    prop_assert!(light.is_empty() || light.len() == cluster.len());
                }
            }
        }
        let Ok(tree) = Tree::open(&bytes) else { return Ok(()) };
        let _ = tree.verify();
        for i in 0..tree.surfel_pages() {
            let Ok(page) = tree.surfel_page(i) else { continue };
            for (n, node) in page.nodes.iter().enumerate() {
                match node.below {
                    Below::Nodes { first, count } => {
                        prop_assert!(first as usize > n && count > 0);
                        prop_assert!(first as usize + usize::from(count) <= page.nodes.len());
                    }
                    Below::Surfels { first, count } => {
                        let end = first as usize + usize::from(count);
                        prop_assert!(count > 0 && end <= page.surfels.len());
                    }
                    Below::Page(link) | Below::EvenPage(link) => {
                        prop_assert!((link as usize) < i);
                    }
                }
            }
        }
    }
}

//! Any damage is found, and no bytes make a reader panic, hang or allocate without bound.

mod common;

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

fn files() -> [(Vec<u8>, Reader); 3] {
    [
        (small_cloud(), read_cloud),
        (small_tree(), read_tree),
        (small_scatter(), read_scatter),
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

/// Puts the checksums right again after a change: what a hostile writer would do.
fn repair(bytes: &mut [u8]) {
    use xxhash_rust::xxh3::xxh3_64;
    let number = |bytes: &[u8], at: usize| {
        usize::try_from(u64::from_le_bytes(bytes[at..at + 8].try_into().unwrap()))
            .unwrap_or(usize::MAX)
    };
    let range = |bytes: &[u8], at: usize, len: usize| {
        (at.checked_add(len)?)
            .le(&bytes.len())
            .then_some(at..at + len)
    };
    let is_cloud = &bytes[8..11] == b"LVC";
    // From the inside out: columns, blocks, sections, header.
    for entry in range(bytes, number(bytes, 72), number(bytes, 80))
        .into_iter()
        .flatten()
        .step_by(40)
    {
        if entry + 40 > bytes.len() {
            break;
        }
        let u32_at = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
        let (len, columns) = (
            u32_at(entry + 8) as usize,
            u32_at(entry + 28).count_ones() as usize,
        );
        let Some(mut block) = range(bytes, number(bytes, entry), len) else {
            continue;
        };
        if is_cloud && columns * 16 <= block.len() {
            let directory = block.start..block.start + columns * 16;
            let mut start = directory.end;
            for column in directory.clone().step_by(16) {
                let len = u32::from_le_bytes(bytes[column..column + 4].try_into().unwrap());
                if let Some(stored) = range(bytes, start, len as usize) {
                    start = stored.end;
                    let sum = xxh3_64(&bytes[stored]);
                    bytes[column + 8..column + 16].copy_from_slice(&sum.to_le_bytes());
                }
            }
            block = directory;
        }
        let sum = xxh3_64(&bytes[block]);
        bytes[entry + 32..entry + 40].copy_from_slice(&sum.to_le_bytes());
    }
    for section in [24, 48, 72] {
        if let Some(range) = range(bytes, number(bytes, section), number(bytes, section + 8)) {
            let sum = xxh3_64(&bytes[range]);
            bytes[section + 16..section + 24].copy_from_slice(&sum.to_le_bytes());
        }
    }
    let sum = xxh3_64(&bytes[..96]);
    bytes[96..104].copy_from_slice(&sum.to_le_bytes());
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
        file in 0_usize..3,
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..4),
    ) {
        static FILES: std::sync::OnceLock<[Vec<u8>; 3]> = std::sync::OnceLock::new();
        let files = FILES.get_or_init(|| [small_cloud(), small_tree(), small_scatter()]);
        let mut bytes = files[file].clone();
        for (at, value) in changes {
            let at = at.index(bytes.len());
            bytes[at] = value;
        }
        repair(&mut bytes);
        let _ = read_cloud(&bytes);
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
                    Below::Page(link) => prop_assert!((link as usize) < i),
                }
            }
        }
    }
}

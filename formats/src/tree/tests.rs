//! Pages made by a hostile hand: the checksum and the compression are right, the bytes are not.

use super::columns as col;
use super::encode::PAGE_HEADER_BYTES;
use super::{decode, lvoxels, stats};
use crate::frame::{Block, BlockKind};
use crate::record::{
    Below, Bounds, ClipEdge, Clips, LightPart, Lvoxel, Node, Surfel, SurfelAggregate, SurfelPage,
};
use crate::{EncodedPage, bytes};
use proptest::prelude::*;

const ID: u32 = 5;

fn page() -> SurfelPage {
    let surfels: Vec<Surfel> = (0..20)
        .map(|i| {
            let x = i as f32;
            Surfel {
                position: [x, x * x, 1.0],
                normal: [0.0, 0.6, 0.8],
                radius: 1.0 + 0.1 * x,
                area: 1.0 + x,
                front: [x, 1.0, 2.0],
                back: [0.0, x, 0.0],
                clips: Clips {
                    count: (i % 3) as u8,
                    edges: [ClipEdge {
                        angle: x,
                        offset: 0.5,
                    }; 3],
                },
            }
        })
        .collect();
    let bounds = Bounds {
        min: [-9.0; 3],
        max: [400.0; 3],
    };
    let node = |below| Node {
        bounds,
        below,
        aggregate: SurfelAggregate {
            area: 3.0,
            centre: [5.0; 3],
            normal_sum: [0.0, 1.0, 2.0],
            second_moment: [1.0; 6],
            axis_area: [0.0, 1.0, 0.0, 2.0, 0.0, 0.5],
            axis_radiance: [[0.5, 1.0, 2.0]; 6],
            back_radiance: std::array::from_fn(|k| [[0.0; 3], [2.0, 1.0, 0.5]][k / 2 % 2]),
        },
    };
    let leaf = |first, count| node(Below::Surfels { first, count });
    SurfelPage {
        nodes: vec![
            node(Below::Nodes { first: 1, count: 4 }),
            leaf(0, 8),
            node(Below::Nodes { first: 5, count: 1 }),
            leaf(8, 4),
            node(Below::Page(2)),
            leaf(12, 8),
        ],
        surfels,
    }
}

fn raw_page() -> Vec<u8> {
    let encoded = EncodedPage::new(&page(), ID, 0.0).unwrap();
    let mut raw = vec![0; encoded.raw_bytes as usize];
    if encoded.bytes.len() == raw.len() {
        raw.copy_from_slice(&encoded.bytes);
    } else {
        bytes::decompress(&encoded.bytes, &mut raw, "page").unwrap();
    }
    raw
}

fn number(raw: &[u8], at: usize) -> u32 {
    u32::from_le_bytes(raw[at..at + 4].try_into().unwrap())
}

/// The entry of the block table that agrees with the page.
fn block(records: u32, nodes: u32, columns: u32) -> Block {
    Block {
        offset: 0,
        stored_bytes: 0,
        raw_bytes: 0,
        kind: BlockKind::Surfels,
        records,
        nodes,
        columns,
        checksum: 0,
    }
}

fn change(raw: &mut Vec<u8>, changes: &[(prop::sample::Index, u8)], cut: usize) {
    for (at, value) in changes {
        let at = at.index(raw.len());
        raw[at] = *value;
    }
    raw.truncate(raw.len() - cut.min(raw.len()));
}

fn is_safe_to_walk(page: &SurfelPage) -> bool {
    page.nodes.iter().enumerate().all(|(i, node)| {
        let inside = |first: u32, count: u8, len: usize| {
            (1..=8).contains(&count) && first as usize + usize::from(count) <= len
        };
        match node.below {
            Below::Nodes { first, count } => {
                first as usize > i && inside(first, count, page.nodes.len())
            }
            Below::Surfels { first, count } => inside(first, count, page.surfels.len()),
            Below::Page(link) | Below::EvenPage(link) => link < ID,
        }
    })
}

fn is_finite(page: &SurfelPage) -> bool {
    let finite = |v: &[f32]| v.iter().all(|v| v.is_finite());
    page.nodes.iter().all(|n| {
        let a = &n.aggregate;
        finite(&[n.bounds.min, n.bounds.max, a.centre, a.normal_sum].concat())
            && finite(&[a.second_moment, a.axis_area].concat())
            && finite(a.axis_radiance.as_flattened())
            && finite(a.back_radiance.as_flattened())
            && a.area.is_finite()
    }) && page
        .surfels
        .iter()
        .all(|s| finite(&[s.position, s.normal, s.front, s.back].concat()) && s.radius > 0.0)
}

#[test]
fn an_honest_page_is_read() {
    let raw = raw_page();
    let block = block(20, 6, number(&raw, 20));
    let decoded = decode::surfel_page(&raw, &block, ID, 0.0).unwrap();
    assert!(is_safe_to_walk(&decoded) && is_finite(&decoded));
    for (a, b) in page().nodes.iter().zip(&decoded.nodes) {
        assert_eq!(a.below, b.below);
    }
}

#[test]
fn links_to_even_pages_have_a_code_and_others_are_refused() {
    let mut raw = raw_page();
    let block = block(20, 6, number(&raw, 20));
    // What is below nodes comes first, a byte for each; the fifth has a link.
    let code = PAGE_HEADER_BYTES + 4;
    assert_eq!(raw[code], 0x20);
    raw[code] = 0x21;
    let page = decode::surfel_page(&raw, &block, ID, 0.0).unwrap();
    assert_eq!(page.nodes[4].below, Below::EvenPage(2));
    raw[code] = 0x22;
    let error = decode::surfel_page(&raw, &block, ID, 0.0).unwrap_err();
    assert!(error.to_string().contains("code 0x22"), "{error}");
}

#[test]
fn backs_of_axes_that_nothing_faces_are_refused() {
    let good = raw_page();
    // The column of backs is the last, a byte for each node: in this page they send towards +y, as
    // fronts face -y.
    assert_eq!(good.last(), Some(&0b100));
    for (axes, says) in [
        (0b110, "fronts that face the other way"),
        (0x44, "six axes"),
    ] {
        let mut raw = good.clone();
        *raw.last_mut().unwrap() = axes;
        let block = block(20, 6, number(&raw, 20));
        let error = decode::surfel_nodes(&raw, &block, ID, &mut Vec::new()).unwrap_err();
        assert!(error.to_string().contains(says), "{error}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig {
        failure_persistence: None,
        ..ProptestConfig::with_cases(20_000)
    })]

    #[test]
    fn surfel_pages(
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..4),
        header in prop::collection::vec((0usize..64, any::<u8>()), 0..2),
        cut in prop::sample::select(vec![0usize, 0, 0, 1, 100]),
    ) {
        let mut raw = raw_page();
        change(&mut raw, &changes, cut);
        for (at, value) in header {
            if at < raw.len() {
                raw[at] = value;
            }
        }
        if raw.len() >= 24 {
            let block = block(number(&raw, 4), number(&raw, 0), number(&raw, 20));
            if let Ok(page) = decode::surfel_page(&raw, &block, ID, 1.0) {
                prop_assert!(is_safe_to_walk(&page) && is_finite(&page));
            }
        }
    }

    #[test]
    fn lvoxel_pages(
        smooth: bool,
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..4),
        header in prop::collection::vec((0usize..20, any::<u8>()), 0..2),
        cut in prop::sample::select(vec![0usize, 0, 0, 0, 1, 100]),
    ) {
        static PAGES: std::sync::OnceLock<[Vec<u8>; 2]> = std::sync::OnceLock::new();
        let pages = PAGES.get_or_init(|| [any_lvoxels(), smooth_lvoxels()].map(|given| {
            let mut columns = stats::lvoxel_columns();
            lvoxels::encode(&given, &mut columns, &mut stats::Errors::default()).unwrap().raw
        }));
        let mut raw = pages[usize::from(smooth)].clone();
        change(&mut raw, &changes, cut);
        for (at, value) in header {
            if at < raw.len() {
                raw[at] = value;
            }
        }
        if raw.len() >= 8 {
            let block = block(number(&raw, 0), 0, number(&raw, 4));
            if let Ok(lvoxels) = lvoxels::decode(&raw, &block) {
                prop_assert_eq!(lvoxels.len(), block.records as usize);
                prop_assert!(lvoxels.iter().all(|v| v.source.iter().all(|c| c.is_finite())));
            }
        }
    }

    /// Gaps and codes that no writer would give.
    #[test]
    fn hostile_gaps(
        gaps in prop::collection::vec((any::<u64>(), 0u32..64), 1..100),
        level in any::<u8>(),
        codes in any::<u16>(),
        sparse: bool,
    ) {
        let n = gaps.len();
        let mask = 1u32 << col::BLOCK_GAP | 1 << col::SIGMA_T | 1 << (col::SOURCE + 1);
        let mut raw = Vec::new();
        raw.extend((n as u32).to_le_bytes());
        raw.extend(mask.to_le_bytes());
        raw.extend([0, 0, 0x80, 0x3f, 0, 0, 0, 0, 13, level % 4, 0, 0]);
        let gaps = gaps.iter().map(|(gap, shift)| if sparse { gap >> shift } else { gap >> 61 });
        let rows: Vec<u8> = gaps.flat_map(u64::to_le_bytes).collect();
        bytes::to_planes(&rows, 8, &mut raw);
        for _ in 0..2 {
            let code = |i: u16| (codes.wrapping_mul(i) >> 5).to_le_bytes();
            let rows: Vec<u8> = (0..n as u16).flat_map(code).collect();
            bytes::to_planes(&rows, 2, &mut raw);
        }
        let block = block(n as u32, 0, mask);
        if let Ok(lvoxels) = lvoxels::decode(&raw, &block) {
            prop_assert!(lvoxels.iter().all(|v| v.source[0].is_finite() && v.sigma_t > 0.0));
        }
        // A page says where its lvoxels are.
        let mask = mask & !(1 << col::BLOCK_GAP);
        raw[4..8].copy_from_slice(&mask.to_le_bytes());
        raw.drain(20..20 + 8 * n);
        let block = Block { columns: mask, ..block };
        prop_assert!(lvoxels::decode(&raw, &block).is_err());
    }
}

#[test]
fn the_lobes_of_lvoxels_come_back() {
    let given = any_lvoxels();
    let mut columns = stats::lvoxel_columns();
    let page = lvoxels::encode(&given, &mut columns, &mut stats::Errors::default()).unwrap();
    let block = block(number(&page.raw, 0), 0, number(&page.raw, 4));
    let found = lvoxels::decode(&page.raw, &block).unwrap();
    let lobes = |v: &[Lvoxel]| -> Vec<_> { v.iter().map(|v| (v.lobe, v.single)).collect() };
    assert_eq!(lobes(&found), lobes(&given));
}

/// In no order.
fn any_lvoxels() -> Vec<Lvoxel> {
    (0..10)
        .map(|i| Lvoxel {
            volume: i % 2,
            level: (i % 3) as u8,
            block: [i; 3],
            sigma_t: 1.0 + f32::from(i),
            source: [f32::from(i), 1.0, 0.0],
            lobe: [i as i8, -120, 3],
            incident: [0.0, f32::from(i), 2.0],
            single: LightPart {
                share: 55 + i as u8,
                lobe: [-3, i as i8, 100],
            },
        })
        .collect()
}

/// A slab of voxels in Morton order; extinction and grey source change little by little.
fn smooth_lvoxels() -> Vec<Lvoxel> {
    (0..300u16)
        .map(|i| {
            let axis = |shift: u16| (0..3).fold(0, |x, k| x | (i >> (3 * k + shift) & 1) << k);
            let block = [axis(2), axis(1), axis(0)];
            let [x, y, z] = block.map(f32::from);
            Lvoxel {
                volume: 0,
                level: 0,
                block,
                sigma_t: 8.0 + 0.5 * x + 0.1 * y * z,
                source: [3.0 + 0.1 * x - 0.2 * y + 0.05 * z; 3],
                ..Lvoxel::default()
            }
        })
        .collect()
}

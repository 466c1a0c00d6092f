//! Trees that no program of ours would write: what shades from them and what exports them ends, and
//! says what is wrong.

use glam::Vec3;
use lvox::Ray;
use lvox::formats::{
    Below, Bounds, EncodedPage, Node, Overwrite, Sums, Surfel, SurfelAggregate, SurfelPage,
    TreeMeta, TreeWriter,
};
use lvox::inspect::export_ply;
use lvox::internals::tree::{self, SurfelStore};
use lvox::internals::{Scratch, cone, plain};
use lvox::tree::OpenTree;

const OVERLAP: f32 = 1.8;

/// A tree of these pages, opened with and without a limit that keeps it from being held whole.
fn stores(pages: &[SurfelPage], limit: Option<u64>) -> (tempfile::TempDir, Vec<OpenTree>) {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.lvt");
    let mut writer = TreeWriter::create(&path, TreeMeta::default(), Overwrite::Refuse).unwrap();
    for (id, page) in (0..).zip(pages) {
        let page = EncodedPage::new(page, id, OVERLAP).unwrap();
        writer.push_surfel_page(&page).unwrap();
    }
    let root = pages.len() as u32 - 1;
    writer.finish(Some(root), Sums::default(), vec![]).unwrap();
    let limits = [None].into_iter().chain(limit.map(Some));
    let stores = limits.map(|l| OpenTree::open(&path, l).unwrap());
    (dir, stores.collect())
}

/// A node around a disk at the origin.
fn node(below: Below) -> Node {
    Node {
        bounds: Bounds {
            min: [-1.0; 3],
            max: [1.0; 3],
        },
        below,
        aggregate: SurfelAggregate {
            area: 1.0,
            ..SurfelAggregate::default()
        },
    }
}

fn leaf() -> SurfelPage {
    SurfelPage {
        nodes: vec![node(Below::Surfels { first: 0, count: 1 })],
        surfels: vec![Surfel {
            normal: [0.0, 0.0, 1.0],
            radius: 0.1,
            area: 0.01,
            ..Surfel::default()
        }],
    }
}

/// A page of a root and its links.
fn links(to: &[u32]) -> SurfelPage {
    let count = to.len() as u8;
    let root = node(Below::Nodes { first: 1, count });
    let links = to.iter().map(|&id| node(Below::Page(id)));
    SurfelPage {
        nodes: [root].into_iter().chain(links).collect(),
        surfels: vec![],
    }
}

/// Whether two rays meet anything by both kernels, one through the disk and one beside it, and what
/// is then said of the pages.
fn cast(pages: &SurfelStore) -> (Vec<bool>, lvox::Result<()>) {
    let mut scratch = Scratch::default();
    let mut met = Vec::new();
    for x in [0.05, 0.5] {
        let (origin, direction) = (Vec3::new(x, 0.0, 5.0), Vec3::NEG_Z);
        let a = plain::cast(pages, &Ray::new(origin, direction, 9.0), &mut scratch);
        let b = cone::cast(pages, &Ray::new(origin, direction, 9.0), 0.0, &mut scratch);
        assert_eq!(a.map(|c| c.t), b.map(|c| c.t));
        met.push(a.is_some());
    }
    (met, pages.check())
}

fn cast_in(store: &OpenTree) -> (Vec<bool>, lvox::Result<()>) {
    cast(tree::surfels(store))
}

#[test]
fn a_tree_in_which_a_page_is_linked_twice_is_refused() {
    // Eight ways down at each of many pages are more than can ever be gone.
    let eightfold = (1..41).map(|id| links(&[id - 1; 8]));
    let eightfold: Vec<_> = [leaf()].into_iter().chain(eightfold).collect();
    // Each two pages link to the page before them and to the one before that.
    let crossed = (2..41).map(|id| links(&[id - 1, id - 2]));
    let crossed: Vec<_> = [leaf(), links(&[0])].into_iter().chain(crossed).collect();
    for pages in [eightfold, crossed] {
        let (dir, stores) = stores(&pages, Some(1 << 16));
        assert!(tree::surfels(&stores[1]).are_cached());
        for store in &stores {
            let error = cast_in(store).1.unwrap_err();
            assert_eq!(error.kind(), lvox::Kind::Input);
            let message = error.to_string();
            assert!(message.contains("a.lvt: links to page"), "{message}");
            assert!(message.contains("expected one, found one in page"));
        }
        let (tree, out) = (dir.path().join("a.lvt"), dir.path().join("a.ply"));
        let error = export_ply(&tree, &out, Some(1000), Overwrite::Refuse).unwrap_err();
        assert_eq!(error.kind(), lvox::Kind::Input);
        let message = error.to_string();
        assert!(message.contains("a.lvt: links to page"), "{message}");
        assert!(!out.exists());
    }
    // As a page is decoded again and again, its links stay the same.
    let chain = (1..41).map(|id| links(&[id - 1]));
    let chain: Vec<_> = [leaf()].into_iter().chain(chain).collect();
    let (_dir, stores) = stores(&chain, Some(1 << 14));
    for store in &stores {
        let (met, pages) = cast_in(store);
        pages.unwrap();
        assert_eq!(met, [true, false]);
    }
    assert!(stores[1].stats().decoded > 41, "{:?}", stores[1].stats());
}

#[test]
fn a_tree_may_be_as_deep_as_its_file_is_long() {
    const NODES: u32 = 19_000;
    let mut page = leaf();
    let chain = (1..NODES).map(|first| node(Below::Nodes { first, count: 1 }));
    page.nodes.splice(0..0, chain);
    let linked = (1..5000).map(|id| SurfelPage {
        nodes: vec![node(Below::Page(id - 1))],
        surfels: vec![],
    });
    let pages: Vec<_> = [page].into_iter().chain(linked).collect();
    let (dir, stores) = stores(&pages, None);
    let (met, pages) = cast_in(&stores[0]);
    pages.unwrap();
    assert_eq!(met, [true, false]);
    let (tree, out) = (dir.path().join("a.lvt"), dir.path().join("a.ply"));
    let exported = export_ply(&tree, &out, Some(u32::MAX), Overwrite::Refuse).unwrap();
    assert_eq!(exported.surfels_or_nodes, 1);
}

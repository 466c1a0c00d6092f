//! Where a tree is cut into pages, and what links tell of them.

use crate::support::random::Random;
use crate::{OVERLAP, built, case, room};
use lvox::build::Settings;
use lvox::formats::*;

#[test]
fn links_tell_of_pages_whose_parts_send_alike() {
    // A floor in even light, with a bright strip along one side.
    let n = 40_000;
    let mut random = Random(4);
    let floor = (0..n).map(|_| {
        let [x, z] = [0; 2].map(|_| random.unit() * 2.0 - 1.0);
        Surfel {
            position: [x, 0.0, z],
            normal: [0.0, 1.0, 0.0],
            radius: OVERLAP * (4.0 / (n as f32 * std::f32::consts::PI)).sqrt(),
            area: 4.0 / n as f32,
            front: [if x > 0.9 { 10.0 } else { 1.0 + 0.2 * z }; 3],
            ..Surfel::default()
        }
    });
    let case = case(&floor.collect::<Vec<_>>(), &[]);
    let settings = Settings {
        page_bytes: 4096,
        ..Settings::default()
    };
    built(&case, &settings);
    let tree = Tree::open_path(&case.tree).unwrap();
    let to_y = |node: &Node| node.aggregate.axis_radiance[2][0];
    let (mut even, mut uneven) = (0, 0);
    for page in 0..tree.surfel_pages() {
        for node in tree.surfel_page(page).unwrap().nodes {
            let linked = |link| tree.surfel_page(link as usize).unwrap().nodes;
            let below = node.below.page().map_or_else(Vec::new, linked);
            let Some(&Below::Nodes { first, count }) = below.first().map(|root| &root.below) else {
                continue;
            };
            let parts = below[first as usize..][..usize::from(count)].iter();
            let off = parts.map(|p| (to_y(p) / to_y(&below[0]) - 1.0).abs());
            let off = off.fold(0.0, f32::max);
            let is_even = matches!(node.below, Below::EvenPage(_));
            assert!(if is_even { off < 0.5 } else { off > 0.45 }, "{off}");
            *(if is_even { &mut even } else { &mut uneven }) += 1;
        }
    }
    assert!(uneven > 0 && even > 5 * uneven, "{even}, {uneven}");
}

#[test]
fn pages_above_others_hold_many_links() {
    let case = case(&room(60_000), &[]);
    let settings = Settings {
        page_bytes: 4096,
        ..Settings::default()
    };
    built(&case, &settings);
    let tree = Tree::open_path(&case.tree).unwrap();
    let links = |page| {
        let page: SurfelPage = tree.surfel_page(page).unwrap();
        page.nodes.iter().filter_map(|n| n.below.page()).count()
    };
    let above = (0..tree.surfel_pages()).filter(|page| links(*page) > 0);
    let (above, pages) = (above.count(), tree.surfel_pages());
    // Cut largest first alone, they are 1 of 4.
    assert!(above > 1 && 2 * pages > 9 * above, "{above} of {pages}");
}

//! Walks the nodes of a tree from its root and prints the largest, with nothing but the crate of
//! the file formats: `cargo run --release --example read_a_tree TREE [DEPTH]`.

#![allow(clippy::print_stdout)] // What it prints is the point.

use lvox::formats::{Below, Node, SurfelPage, Tree};
use std::path::Path;

fn main() -> lvox::Result<()> {
    let mut arguments = std::env::args().skip(1);
    let path = arguments.next();
    let path = path.ok_or_else(|| lvox::Error::input("name a tree (.lvt)"))?;
    let depth = arguments.next().and_then(|text| text.parse().ok());
    let tree = Tree::open_path(Path::new(&path))?;
    let summary = tree.summary();
    println!(
        "{path}: {} surfels, {} lvoxels, {} nodes in {} pages",
        summary.sums.surfels,
        summary.sums.lvoxels(),
        summary.nodes,
        tree.surfel_pages()
    );
    // Node 0 of the root page stands for all surfels. A tree of volumes alone has none.
    if let Some(root) = tree.root_page() {
        let page = tree.surfel_page(root as usize)?;
        print_below(&tree, &page, &page.nodes[0], 0, depth.unwrap_or(2))?;
    }
    Ok(())
}

/// Prints a node and, down to a depth, what is below it.
fn print_below<D: AsRef<[u8]>>(
    tree: &Tree<D>,
    page: &SurfelPage,
    node: &Node,
    depth: usize,
    deepest: usize,
) -> lvox::Result<()> {
    match node.below {
        // Node 0 of that page is this node once more, with its children beside it.
        Below::Page(id) | Below::EvenPage(id) => {
            let page = tree.surfel_page(id as usize)?;
            return print_below(tree, &page, &page.nodes[0], depth, deepest);
        }
        Below::Nodes { first, count } if depth < deepest => {
            print_node(node, depth);
            for child in &page.nodes[first as usize..][..usize::from(count)] {
                print_below(tree, page, child, depth + 1, deepest)?;
            }
        }
        Below::Nodes { .. } | Below::Surfels { .. } => print_node(node, depth),
    }
    Ok(())
}

fn print_node(node: &Node, depth: usize) {
    let [x, y, z] = node.aggregate.centre;
    let area = node.aggregate.area;
    let indent = 2 * depth;
    println!("{:indent$}area {area:.4} around {x:.3} {y:.3} {z:.3}", "");
}

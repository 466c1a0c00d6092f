//! A page of a tree with other light, and everything else to the bit.

use super::columns::{self as col, PageBuilder, PageColumns};
use super::decode::{self, Header};
use super::encode::{
    EncodedPage, Laid, PAGE_HEADER_BYTES, back_light, below_code, check_node, header, links,
    lit_backs, push_axis_radiance, push_back_axes, push_surfel_radiance,
};
use super::shapes::ShapeParams;
use super::stats::{self, Errors};
use super::{Tree, read};
use crate::record::SurfelPage;
use crate::{FormatError, Result, check};

/// Columns of radiance come in three codings.
const CODINGS: usize = 3;

/// Whether a column of a page of surfels holds light.
pub fn is_light(column: usize) -> bool {
    let coded = [col::AXIS_RADIANCE, col::FRONT, col::BACK];
    column == col::BACK_AXES || coded.iter().any(|c| (*c..c + CODINGS).contains(&column))
}

impl EncodedPage {
    /// Encodes page `i` of a tree with the light of `page`, which is that page as
    /// [`Tree::surfel_page`] decodes it but for `front` and `back` of its surfels, `axis_radiance`
    /// and `back_radiance` of its nodes, and which links are to even pages. Places, shapes and
    /// boxes stay as they are in the file, to the bit, so that other pages may link to it as
    /// before.
    ///
    /// # Errors
    /// Those of [`Tree::surfel_page`], and [`FormatError::Invalid`] for a page of other counts or
    /// for radiance that is out of range.
    pub fn relit<D: AsRef<[u8]>>(tree: &Tree<D>, i: usize, page: &SurfelPage) -> Result<Self> {
        tree.unpacked(tree.surfel_blocks(), i, read::SURFEL_PAGE, |raw, block| {
            let (header, columns) = decode::open_page(raw, block)?;
            if (header.nodes, header.surfels) != (page.nodes.len(), page.surfels.len()) {
                return Err(FormatError::invalid(
                    "counts of the page",
                    format!("{} nodes, {} surfels", header.nodes, header.surfels),
                    format!("{} nodes, {} surfels", page.nodes.len(), page.surfels.len()),
                ));
            }
            for (k, surfel) in page.surfels.iter().enumerate() {
                check::surfel(surfel, &|| format!("surfel {k} of the page"))?;
            }
            for (k, node) in page.nodes.iter().enumerate() {
                check_node(node, k)?;
            }
            relit(&header, &columns, page, i as u32)
        })
    }
}

fn relit(
    old: &Header,
    columns: &PageColumns<'_>,
    page: &SurfelPage,
    id: u32,
) -> Result<EncodedPage> {
    let links = links(page, id)?;
    let axis_area = columns.required(col::AXIS_AREA)?;
    let lit = page.nodes.iter().enumerate().flat_map(|(i, node)| {
        let a = &node.aggregate;
        let fronts = (0..6).filter(move |k| axis_area.u16(i, *k) > 0);
        let fronts = fronts.map(|k| a.axis_radiance[k]);
        fronts.chain(back_light(a, lit_backs(a)))
    });
    let mut told = stats::surfel_columns();
    let mut errors = Errors::default();
    let mut surfels = page.surfels.clone();
    let mut builder = PageBuilder::new(&col::SURFELS, PAGE_HEADER_BYTES);
    let keep = |builder: &mut PageBuilder, range: std::ops::Range<usize>| {
        for index in range.filter(|i| !is_light(*i)) {
            if let Some(planes) = columns.planes(index) {
                builder.push_u8(index, planes.iter().copied());
            }
        }
    };
    let has_backs = (page.nodes.iter()).any(|n| lit_backs(&n.aggregate) != 0);
    builder.push_u8(col::BELOW, page.nodes.iter().map(below_code));
    keep(&mut builder, col::LINK..col::AXIS_RADIANCE);
    let lit = push_axis_radiance(
        &mut builder,
        lit.collect(),
        page.nodes.len(),
        has_backs,
        &mut errors,
        &mut told,
    );
    keep(&mut builder, col::AXIS_RADIANCE..col::FRONT);
    let colours = push_surfel_radiance(&mut builder, &mut surfels, page, &mut errors, &mut told);
    keep(&mut builder, col::FRONT..col::BACK_AXES);
    push_back_axes(&mut builder, &page.nodes, &mut told);

    let mask = builder.mask();
    let counts = [old.nodes, old.surfels, old.links, old.edges, lit.count];
    let shape = ShapeParams {
        radius: old.radius,
        area: old.area,
    };
    let bases = [colours[0], colours[1], lit.base];
    Laid {
        header: header(counts, mask, &old.bounds, &shape, bases),
        builder,
        nodes: old.nodes,
        surfels: &surfels,
        links: &links,
        bounds: page.nodes[0].bounds,
        columns: told,
        errors,
    }
    .packed()
}

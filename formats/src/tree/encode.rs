//! From a page of nodes and surfels to the bytes of a block.

use super::columns::{self as col, PageBuilder, radiance};
use super::place::{Placement, in_steps};
use super::shapes::{ShapeParams, Shapes};
use super::stats::{self, ColumnStats, Errors};
use super::{MAX_PAGE_BYTES, MAX_PAGE_RECORDS};
use crate::record::{Below, Bounds, Node, Surfel, SurfelAggregate, SurfelPage};
use crate::summary::Sums;
use crate::{FormatError, Result, check};
use xxhash_rust::xxh3::xxh3_64;

/// Bytes of the header of a page of surfels.
pub const PAGE_HEADER_BYTES: usize = 64;
pub const NODES_BELOW: u8 = 0x00;
pub const SURFELS_BELOW: u8 = 0x10;
pub const PAGE_BELOW: u8 = 0x20;
pub const EVEN_PAGE_BELOW: u8 = 0x21;

/// A page of nodes and surfels, quantised and compressed, that [`super::TreeWriter`] can append.
/// Pages can be encoded by many threads.
#[derive(Clone)]
pub struct EncodedPage {
    pub(super) bytes: Vec<u8>,
    pub(super) raw_bytes: u32,
    pub(super) records: u32,
    pub(super) nodes: u32,
    pub(super) mask: u32,
    pub(super) checksum: u64,
    pub(super) furthest_link: u32,
    pub(super) bounds: Bounds,
    pub(super) sums: Sums,
    pub(super) columns: ColumnStats,
    pub(super) errors: Errors,
}

/// Bytes that a node takes in a page before compression, unless the page needs floats.
#[must_use]
pub fn node_bytes(aggregate: &SurfelAggregate) -> u32 {
    let fronts = aggregate.axis_area.iter().filter(|a| **a > 0.0).count() as u32;
    let backs = lit_backs(aggregate).count_ones();
    1 + 12 + 4 + 6 + 6 + 12 + 12 + 4 * (fronts + backs) + u32::from(backs > 0)
}

/// Bytes that a surfel takes in a page before compression, unless the page needs floats.
#[must_use]
pub fn surfel_bytes(surfel: &Surfel) -> u32 {
    let back = if surfel.back == [0.0; 3] { 0 } else { 4 };
    6 + 4 + 2 + 4 + back + 1 + 2 * u32::from(surfel.clips.count)
}

/// A bit for each axis to which backs radiate.
pub(super) fn lit_backs(a: &SurfelAggregate) -> u8 {
    let is_lit = |d: usize| a.axis_area[d ^ 1] > 0.0 && a.back_radiance[d] != [0.0; 3];
    (0..6).fold(0, |bits, d| bits | u8::from(is_lit(d)) << d)
}

impl EncodedPage {
    /// Encodes a page. `id` is the page id that links are counted back from: the page's own, or any
    /// number that differs from it by as much as the links differ from the linked pages' ids. So
    /// pages of a part of the tree can be encoded before it is known how many pages come before
    /// that part.
    ///
    /// `disk_overlap` is that of the metadata.
    ///
    /// # Errors
    /// [`FormatError::Invalid`] for nodes that are not in breadth-first order, links that do not go
    /// back, values that are out of range, or too many of them.
    pub fn new(page: &SurfelPage, id: u32, disk_overlap: f32) -> Result<Self> {
        let links = links(page, id)?;
        for (i, surfel) in page.surfels.iter().enumerate() {
            check::surfel(surfel, &|| format!("surfel {i} of the page"))?;
        }
        for (i, node) in page.nodes.iter().enumerate() {
            check_node(node, i)?;
        }
        let mut columns = stats::surfel_columns();
        let mut errors = Errors::default();

        let mut surfels = page.surfels.clone();
        let shapes = Shapes::new(&mut surfels, disk_overlap, &mut errors);
        let (place, placed) = Placement::choose(page, &mut surfels, &mut errors);

        let mut builder = PageBuilder::new(&col::SURFELS, PAGE_HEADER_BYTES);
        builder.push_u8(col::BELOW, page.nodes.iter().map(below_code));
        if !links.is_empty() {
            builder.push_u32(col::LINK, &links);
        }
        placed.push_boxes(&mut builder);
        let lit = push_aggregates(&mut builder, &page.nodes, &place, &mut errors, &mut columns);
        placed.push_positions(&mut builder);
        let params = shapes.push(&mut builder, &mut columns);

        let colours =
            push_surfel_radiance(&mut builder, &mut surfels, page, &mut errors, &mut columns);
        push_clips(&mut builder, &surfels, &shapes.edges, &mut columns);
        push_back_axes(&mut builder, &page.nodes, &mut columns);

        let mask = builder.mask();
        let counts = [
            page.nodes.len(),
            surfels.len(),
            links.len(),
            shapes.edges.len(),
            lit.count,
        ];
        let bases = [colours[0], colours[1], lit.base];
        Laid {
            header: header(counts, mask, &place.bounds, &params, bases),
            builder,
            nodes: page.nodes.len(),
            surfels: &surfels,
            links: &links,
            bounds: placed.boxes[0],
            columns,
            errors,
        }
        .packed()
    }

    /// The box of the page's root as a reader decodes it: a node that links to the page must hold
    /// it.
    #[must_use]
    pub fn bounds(&self) -> Bounds {
        self.bounds
    }

    /// Bytes in the file.
    #[must_use]
    pub fn stored_bytes(&self) -> usize {
        self.bytes.len()
    }
}

/// A page whose columns are laid out.
pub(super) struct Laid<'a> {
    pub builder: PageBuilder,
    pub header: Vec<u8>,
    pub nodes: usize,
    /// As a reader decodes them.
    pub surfels: &'a [Surfel],
    pub links: &'a [[u32; 1]],
    /// Box of the root, as a reader decodes it.
    pub bounds: Bounds,
    pub columns: ColumnStats,
    pub errors: Errors,
}

impl Laid<'_> {
    /// Compresses it.
    pub fn packed(mut self) -> Result<EncodedPage> {
        let mask = self.builder.mask();
        let (raw, ranges) = self.builder.build(&self.header);
        (self.columns).add_page(&raw, &ranges, stats::SURFEL_ZSTD_LEVEL)?;
        let (bytes, raw_bytes) = stats::pack_page(raw, stats::SURFEL_ZSTD_LEVEL)?;
        let mut sums = Sums::default();
        self.surfels.iter().for_each(|s| sums.add_surfel(s));
        Ok(EncodedPage {
            checksum: xxh3_64(&bytes),
            bytes,
            raw_bytes,
            records: self.surfels.len() as u32,
            nodes: self.nodes as u32,
            mask,
            furthest_link: self.links.iter().map(|[link]| *link).max().unwrap_or(0),
            bounds: self.bounds,
            sums,
            columns: self.columns,
            errors: self.errors,
        })
    }
}

/// The header of a page. Counts are of nodes, surfels, links, clip edges and lit axes; bases are
/// the exponents of front, back and axis radiance.
pub(super) fn header(
    counts: [usize; 5],
    mask: u32,
    bounds: &Bounds,
    params: &ShapeParams,
    bases: [i16; 3],
) -> Vec<u8> {
    let mut header = Vec::with_capacity(PAGE_HEADER_BYTES);
    for count in counts {
        header.extend((count as u32).to_le_bytes());
    }
    header.extend(mask.to_le_bytes());
    let corners = bounds.min.iter().chain(&bounds.max);
    header.extend(corners.flat_map(|v| v.to_le_bytes()));
    header.extend(params.radius.base.to_le_bytes());
    header.extend(params.area.base.to_le_bytes());
    for base in bases {
        header.extend(base.to_le_bytes());
    }
    header.extend([params.radius.shift, params.area.shift]);
    debug_assert_eq!(header.len(), PAGE_HEADER_BYTES);
    header
}

fn push_clips(
    builder: &mut PageBuilder,
    surfels: &[Surfel],
    edges: &[[u8; 2]],
    columns: &mut ColumnStats,
) {
    if edges.is_empty() {
        columns.leave_out(col::CLIP_COUNT, surfels.len() as u64);
    } else {
        let counts = surfels.iter().map(|s| s.clips.count);
        builder.push_u8(col::CLIP_COUNT, counts);
        let edges: Vec<_> = edges.iter().map(|e| [u16::from_le_bytes(*e)]).collect();
        builder.push_u16(col::CLIP_EDGE, &edges);
    }
}

pub(super) fn push_back_axes(builder: &mut PageBuilder, nodes: &[Node], columns: &mut ColumnStats) {
    let backs: Vec<u8> = nodes.iter().map(|n| lit_backs(&n.aggregate)).collect();
    if backs.iter().any(|bits| *bits != 0) {
        builder.push_u8(col::BACK_AXES, backs);
    } else {
        // Its own byte, and radiance towards six axes.
        columns.leave_out(col::BACK_AXES, 25 * nodes.len() as u64);
    }
}

/// Checks the order of nodes and surfels, and returns how far back each link goes.
pub(super) fn links(page: &SurfelPage, id: u32) -> Result<Vec<[u32; 1]>> {
    let limit = |what: &str, n: usize, least: usize| {
        if (least..=MAX_PAGE_RECORDS).contains(&n) {
            Ok(())
        } else {
            Err(FormatError::invalid(
                what,
                format!("{least} to {MAX_PAGE_RECORDS}"),
                n,
            ))
        }
    };
    limit("nodes of the page", page.nodes.len(), 1)?;
    limit("surfels of the page", page.surfels.len(), 0)?;
    let (mut next_node, mut next_surfel) = (1, 0);
    let mut links = Vec::new();
    for (i, node) in page.nodes.iter().enumerate() {
        let (first, count, next) = match node.below {
            Below::Nodes { first, count } => (first, count, &mut next_node),
            Below::Surfels { first, count } => (first, count, &mut next_surfel),
            Below::Page(link) | Below::EvenPage(link) => {
                if link >= id {
                    return Err(FormatError::invalid(
                        format!("link of node {i}"),
                        format!("a page before {id}"),
                        link,
                    ));
                }
                links.push([id - link]);
                continue;
            }
        };
        if first != *next || !(1..=8).contains(&count) {
            return Err(FormatError::invalid(
                format!("range below node {i}"),
                format!("1 to 8 from {next}, breadth first"),
                format!("{count} from {first}"),
            ));
        }
        *next += u32::from(count);
        if i as u32 + 1 >= next_node && i + 1 < page.nodes.len() {
            return Err(FormatError::invalid(
                format!("node {}", i + 1),
                "a parent before it",
                "none",
            ));
        }
    }
    if (next_node as usize, next_surfel as usize) != (page.nodes.len(), page.surfels.len()) {
        return Err(FormatError::invalid(
            "nodes and surfels below the root",
            format!("{} and {}", page.nodes.len(), page.surfels.len()),
            format!("{next_node} and {next_surfel}"),
        ));
    }
    Ok(links)
}

pub(super) fn below_code(node: &Node) -> u8 {
    match node.below {
        Below::Nodes { count, .. } => NODES_BELOW | count,
        Below::Surfels { count, .. } => SURFELS_BELOW | count,
        Below::Page(_) => PAGE_BELOW,
        Below::EvenPage(_) => EVEN_PAGE_BELOW,
    }
}

pub(super) fn check_node(node: &Node, i: usize) -> Result<()> {
    check::node(node, &|| format!("node {i} of the page"))?;
    let a = &node.aggregate;
    let mut light = a.axis_radiance.iter().chain(&a.back_radiance);
    match light.find(|c| !check::is_radiance(**c)) {
        Some(c) => Err(FormatError::invalid(
            format!("axis radiance of node {i} of the page"),
            "numbers of at least 0",
            format!("{c:?}"),
        )),
        None => Ok(()),
    }
}

/// Numbers for the header.
pub(super) struct Lit {
    pub count: usize,
    pub base: i16,
}

fn push_aggregates(
    builder: &mut PageBuilder,
    nodes: &[Node],
    place: &Placement,
    errors: &mut Errors,
    columns: &mut ColumnStats,
) -> Lit {
    let n = nodes.len();
    let mut area = Vec::with_capacity(n);
    let mut centre: Vec<[u16; 3]> = Vec::with_capacity(n);
    let mut normal = Vec::with_capacity(n);
    let mut moment = Vec::with_capacity(n);
    let mut axis_area = Vec::with_capacity(n);
    let mut lit = Vec::with_capacity(3 * n);
    let mut has_backs = false;
    for node in nodes {
        let a = &node.aggregate;
        area.push([a.area]);
        if let Some(spans) = &place.spans {
            centre.push(std::array::from_fn(|k| {
                let c = a.centre[k].clamp(place.bounds.min[k], place.bounds.max[k]);
                let code = spans[k].nearest(c);
                let off = f64::from(spans[k].decode(code)) - f64::from(c);
                errors.note(stats::CENTRE, in_steps(off.abs(), c, &spans[k]));
                code
            }));
        }
        let share = |v: f32| {
            if a.area > 0.0 {
                f64::from(v) / f64::from(a.area)
            } else {
                0.0
            }
        };
        let signed = |v: f32| (share(v).clamp(-1.0, 1.0) * 32767.0).round() as i16 as u16;
        normal.push(a.normal_sum.map(signed));
        moment.push(a.second_moment.map(signed));
        let codes = a.axis_area.map(|v| {
            // What radiates at all keeps at least one step, and its radiance.
            let code = (share(v).clamp(0.0, 1.0) * 65535.0).round() as u16;
            if v > 0.0 { code.max(1) } else { 0 }
        });
        axis_area.push(codes);
        let fronts = codes.iter().zip(a.axis_radiance);
        lit.extend(fronts.filter(|(code, _)| **code > 0).map(|(_, c)| c));
        let backs = lit_backs(a);
        has_backs |= backs != 0;
        lit.extend(back_light(a, backs));
    }
    builder.push_f32(col::NODE_AREA, &area);
    if place.spans.is_some() {
        builder.push_u16(col::CENTRE, &centre);
    } else {
        let centre: Vec<_> = nodes.iter().map(|node| node.aggregate.centre).collect();
        builder.push_f32(col::CENTRE_F32, &centre);
    }
    builder.push_u16(col::NODE_NORMAL, &normal);
    builder.push_u16(col::MOMENT, &moment);
    builder.push_u16(col::AXIS_AREA, &axis_area);
    push_axis_radiance(builder, lit, n, has_backs, errors, columns)
}

/// Radiance of backs towards the axes that a bit is set for.
pub(super) fn back_light(a: &SurfelAggregate, backs: u8) -> impl Iterator<Item = [f32; 3]> {
    let is_lit = move |d: &usize| backs >> d & 1 == 1;
    (0..6).filter(is_lit).map(|d| a.back_radiance[d])
}

/// Radiance of so many nodes along axes: of each that of its fronts, then that of its backs.
pub(super) fn push_axis_radiance(
    builder: &mut PageBuilder,
    mut lit: Vec<[f32; 3]>,
    nodes: usize,
    has_backs: bool,
    errors: &mut Errors,
    columns: &mut ColumnStats,
) -> Lit {
    let given = lit.clone();
    let written = radiance::encode(builder, col::AXIS_RADIANCE, &mut lit);
    for (given, decoded) in given.iter().zip(&lit) {
        errors.note_radiance(*given, *decoded);
    }
    let axes = if has_backs { 12 } else { 6 };
    let dark = (axes * nodes - lit.len()) as u64 * 4;
    columns.leave_out(col::AXIS_RADIANCE, written.saved + dark);
    Lit {
        count: lit.len(),
        base: written.base,
    }
}

pub(super) fn push_surfel_radiance(
    builder: &mut PageBuilder,
    surfels: &mut [Surfel],
    page: &SurfelPage,
    errors: &mut Errors,
    columns: &mut ColumnStats,
) -> [i16; 2] {
    let mut front: Vec<_> = page.surfels.iter().map(|s| s.front).collect();
    let mut back: Vec<_> = page.surfels.iter().map(|s| s.back).collect();
    let sides = [(col::FRONT, &mut front), (col::BACK, &mut back)];
    let bases = sides.map(|(column, values)| {
        let written = radiance::encode(builder, column, values);
        columns.leave_out(column, written.saved);
        written.base
    });
    for (i, s) in surfels.iter_mut().enumerate() {
        errors.note_radiance(s.front, front[i]);
        errors.note_radiance(s.back, back[i]);
        (s.front, s.back) = (front[i], back[i]);
    }
    bases
}

const _: () = assert!(MAX_PAGE_BYTES <= u32::MAX as usize);

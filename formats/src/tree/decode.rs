//! From the bytes of a block to a page of nodes and surfels.

use super::MAX_PAGE_RECORDS;
use super::columns::{self as col, PageColumns, Rows, radiance};
use super::encode::{EVEN_PAGE_BELOW, NODES_BELOW, PAGE_BELOW, SURFELS_BELOW};
use crate::bytes::Cursor;
use crate::frame::Block;
use crate::quantise::{NORMAL_MAX, Span, Steps, area_of_disk, decode_clips, decode_normal};
use crate::record::{Below, Bounds, Node, Surfel, SurfelAggregate, SurfelLeaves, SurfelPage};
use crate::{FormatError, Result, check};

pub(super) struct Header {
    pub nodes: usize,
    pub surfels: usize,
    pub links: usize,
    pub edges: usize,
    lit: usize,
    pub bounds: Bounds,
    pub radius: Steps,
    pub area: Steps,
    front: i16,
    back: i16,
    axis: i16,
}

/// Decodes page `id`. The page is valid: nodes and surfels below each node exist, parents come
/// before their children, links go to pages before this one, and all numbers are finite.
pub fn surfel_page(raw: &[u8], block: &Block, id: u32, overlap: f32) -> Result<SurfelPage> {
    let (header, columns) = open_page(raw, block)?;
    let mut page = SurfelPage::default();
    decode_nodes(&header, &columns, id, &mut page.nodes)?;
    decode_surfels(&header, &columns, overlap, &mut page.surfels)?;
    Ok(page)
}

/// Decodes the nodes of page `id` alone, in place of what `nodes` holds; they are as valid as those
/// of the whole page.
pub fn surfel_nodes(raw: &[u8], block: &Block, id: u32, nodes: &mut Vec<Node>) -> Result<()> {
    let (header, columns) = open_page(raw, block)?;
    decode_nodes(&header, &columns, id, nodes)
}

/// Decodes the surfels of page `id`, leaf by leaf, in place of what `leaves` holds; they are as
/// valid as those of the whole page.
pub fn surfel_leaves(
    raw: &[u8],
    block: &Block,
    id: u32,
    overlap: f32,
    leaves: &mut SurfelLeaves,
) -> Result<()> {
    let (header, columns) = open_page(raw, block)?;
    leaves.counts.clear();
    decode_order(&header, &columns, id, |below| {
        leaves.counts.extend(below.surfels())
    })?;
    decode_surfels(&header, &columns, overlap, &mut leaves.surfels)
}

pub(super) fn open_page<'a>(raw: &'a [u8], block: &Block) -> Result<(Header, PageColumns<'a>)> {
    let mut cursor = Cursor::new(raw, "page");
    let (header, mask) = read_header(&mut cursor)?;
    if (header.nodes, header.surfels, mask)
        != (block.nodes as usize, block.records as usize, block.columns)
    {
        return Err(FormatError::invalid(
            "counts and columns of the page",
            format!(
                "{} nodes, {} surfels, {:#x}",
                block.nodes, block.records, block.columns
            ),
            format!(
                "{} nodes, {} surfels, {mask:#x}",
                header.nodes, header.surfels
            ),
        ));
    }
    let columns = PageColumns::read(&mut cursor, &col::SURFELS, mask, |rows| match rows {
        Rows::Nodes => header.nodes,
        Rows::Links => header.links,
        Rows::LitAxes => header.lit,
        Rows::Surfels => header.surfels,
        Rows::Edges => header.edges,
        Rows::Lvoxels => 0,
    })?;
    Ok((header, columns))
}

fn read_header(cursor: &mut Cursor<'_>) -> Result<(Header, u32)> {
    let mut count = |what: &str, least: usize, most: usize| {
        let n = cursor.u32()? as usize;
        if (least..=most).contains(&n) {
            Ok(n)
        } else {
            Err(FormatError::invalid(
                format!("{what} of the page"),
                format!("{least} to {most}"),
                n,
            ))
        }
    };
    let nodes = count("nodes", 1, MAX_PAGE_RECORDS)?;
    let surfels = count("surfels", 0, MAX_PAGE_RECORDS)?;
    let links = count("links", 0, nodes)?;
    let edges = count("clip edges", 0, 3 * surfels)?;
    let lit = count("lit axes", 0, 12 * nodes)?;
    let mask = cursor.u32()?;
    let mut numbers = [0.0; 6];
    for v in &mut numbers {
        *v = cursor.f32()?;
    }
    let [x0, y0, z0, x1, y1, z1] = numbers;
    let bounds = Bounds {
        min: [x0, y0, z0],
        max: [x1, y1, z1],
    };
    check::bounds(&bounds, &|| "box of the page".into())?;
    let (radius_base, area_base) = (cursor.u32()?, cursor.u32()?);
    let (front, back, axis) = (cursor.i16()?, cursor.i16()?, cursor.i16()?);
    let mut steps = |base| {
        let shift = cursor.u8()?;
        if shift > Steps::MAX_SHIFT {
            return Err(FormatError::invalid(
                "step of the page",
                format!("at most {}", Steps::MAX_SHIFT),
                shift,
            ));
        }
        Ok(Steps { base, shift })
    };
    Ok((
        Header {
            nodes,
            surfels,
            links,
            edges,
            lit,
            bounds,
            radius: steps(radius_base)?,
            area: steps(area_base)?,
            front,
            back,
            axis,
        },
        mask,
    ))
}

fn spans(b: &Bounds) -> [Span; 3] {
    std::array::from_fn(|k| Span::new(b.min[k], b.max[k]))
}

fn decode_nodes(
    header: &Header,
    columns: &PageColumns<'_>,
    id: u32,
    nodes: &mut Vec<Node>,
) -> Result<()> {
    nodes.clear();
    nodes.reserve(header.nodes);
    decode_order(header, columns, id, |below| {
        nodes.push(Node {
            bounds: header.bounds,
            below,
            aggregate: SurfelAggregate::default(),
        });
    })?;

    let spans = spans(&header.bounds);
    decode_boxes(columns, &spans, nodes)?;
    decode_aggregates(columns, &spans, nodes)?;
    for (i, node) in nodes.iter().enumerate() {
        check::node(node, &|| format!("node {i} of the page"))?;
    }
    decode_light(header, columns, nodes)
}

fn decode_boxes(columns: &PageColumns<'_>, spans: &[Span; 3], nodes: &mut [Node]) -> Result<()> {
    columns.one_of(&[col::BOX, col::BOX_F32])?;
    if let Some(rows) = columns.get(col::BOX) {
        for (k, span) in spans.iter().enumerate() {
            let ends = rows.u16s(k).zip(rows.u16s(k + 3));
            for (node, (min, max)) in nodes.iter_mut().zip(ends) {
                node.bounds.min[k] = span.decode(min);
                node.bounds.max[k] = span.decode(max);
            }
        }
    } else if let Some(rows) = columns.get(col::BOX_F32) {
        for (i, node) in nodes.iter_mut().enumerate() {
            node.bounds = Bounds {
                min: rows.f32x3(i, 0),
                max: rows.f32x3(i, 3),
            };
        }
    }
    Ok(())
}

/// Areas, centres, normals and moments; the light of nodes is a column of its own.
fn decode_aggregates(
    columns: &PageColumns<'_>,
    spans: &[Span; 3],
    nodes: &mut [Node],
) -> Result<()> {
    columns.one_of(&[col::CENTRE, col::CENTRE_F32])?;
    let area = columns.required(col::NODE_AREA)?;
    let normal = columns.required(col::NODE_NORMAL)?;
    let moment = columns.required(col::MOMENT)?;
    let axis_area = columns.required(col::AXIS_AREA)?;
    let (centre, centre_f32) = (columns.get(col::CENTRE), columns.get(col::CENTRE_F32));
    for (i, node) in nodes.iter_mut().enumerate() {
        let a = &mut node.aggregate;
        a.area = area.f32(i, 0);
        if let Some(rows) = centre_f32 {
            a.centre = rows.f32x3(i, 0);
        }
    }
    if let Some(rows) = centre {
        for (k, span) in spans.iter().enumerate() {
            for (node, code) in nodes.iter_mut().zip(rows.u16s(k)) {
                node.aggregate.centre[k] = span.decode(code);
            }
        }
    }
    let signed = |area: f32, code: u16| {
        (f64::from(area) * f64::from(code as i16) / f64::from(i16::MAX)) as f32
    };
    for k in 0..3 {
        for (node, code) in nodes.iter_mut().zip(normal.u16s(k)) {
            node.aggregate.normal_sum[k] = signed(node.aggregate.area, code);
        }
    }
    for k in 0..6 {
        let codes = moment.u16s(k).zip(axis_area.u16s(k));
        for (node, (moment, facing)) in nodes.iter_mut().zip(codes) {
            let a = &mut node.aggregate;
            a.second_moment[k] = signed(a.area, moment);
            a.axis_area[k] = (f64::from(a.area) * f64::from(facing) / f64::from(u16::MAX)) as f32;
        }
    }
    Ok(())
}

/// Ranges and links, given to `add` node by node: nodes and surfels are handed out in order, so
/// ranges cannot overlap or form a loop.
fn decode_order(
    header: &Header,
    columns: &PageColumns<'_>,
    id: u32,
    mut add: impl FnMut(Below),
) -> Result<()> {
    let below = columns.required(col::BELOW)?;
    let links = columns.get(col::LINK);
    let (mut next_node, mut next_surfel, mut next_link) = (1, 0, 0);
    for i in 0..header.nodes {
        let code = below.u8(i);
        let wrong = |expected: &str, found: String| {
            Err(FormatError::invalid(
                format!("what is below node {i}"),
                expected,
                found,
            ))
        };
        if i as u32 >= next_node {
            return wrong("a parent before the node", "none".into());
        }
        let count = code & 15;
        match code & 0xf0 {
            NODES_BELOW if (1..=8).contains(&count) => {
                add(Below::Nodes {
                    first: next_node,
                    count,
                });
                next_node += u32::from(count);
            }
            SURFELS_BELOW if (1..=8).contains(&count) => {
                add(Below::Surfels {
                    first: next_surfel,
                    count,
                });
                next_surfel += u32::from(count);
            }
            PAGE_BELOW if code <= EVEN_PAGE_BELOW => {
                let Some(rows) = links.filter(|_| next_link < header.links) else {
                    return wrong("a link", "none".into());
                };
                let back = rows.u32(next_link, 0);
                next_link += 1;
                if back == 0 || back > id {
                    return wrong(
                        &format!("a page 1 to {id} before this one"),
                        back.to_string(),
                    );
                }
                let below = match code {
                    EVEN_PAGE_BELOW => Below::EvenPage,
                    _ => Below::Page,
                };
                add(below(id - back));
            }
            _ => return wrong("nodes, surfels or a page", format!("code {code:#04x}")),
        }
        if next_node as usize > header.nodes || next_surfel as usize > header.surfels {
            return wrong(
                &format!(
                    "at most {} nodes and {} surfels",
                    header.nodes, header.surfels
                ),
                format!("{next_node} and {next_surfel}"),
            );
        }
    }
    let found = (next_node as usize, next_surfel as usize, next_link);
    if found != (header.nodes, header.surfels, header.links) {
        return Err(FormatError::invalid(
            "nodes, surfels and links below the root",
            format!("{:?}", (header.nodes, header.surfels, header.links)),
            format!("{found:?}"),
        ));
    }
    Ok(())
}

fn decode_surfels(
    header: &Header,
    columns: &PageColumns<'_>,
    overlap: f32,
    surfels: &mut Vec<Surfel>,
) -> Result<()> {
    surfels.clear();
    surfels.resize(header.surfels, Surfel::default());
    if surfels.is_empty() {
        return Ok(());
    }
    columns.one_of(&[col::POSITION, col::POSITION_F32])?;
    if let Some(rows) = columns.get(col::POSITION) {
        for (k, span) in spans(&header.bounds).iter().enumerate() {
            for (s, code) in surfels.iter_mut().zip(rows.u16s(k)) {
                s.position[k] = span.decode(code);
            }
        }
    } else if let Some(rows) = columns.get(col::POSITION_F32) {
        for (i, s) in surfels.iter_mut().enumerate() {
            s.position = rows.f32x3(i, 0);
        }
    }
    let rows = columns.required(col::NORMAL)?;
    for (s, code) in surfels.iter_mut().zip(rows.u16s(0).zip(rows.u16s(1))) {
        let code = [code.0, code.1];
        if code.iter().any(|c| *c > NORMAL_MAX) {
            return Err(FormatError::invalid(
                "normal code",
                format!("at most {NORMAL_MAX}"),
                format!("{code:?}"),
            ));
        }
        s.normal = decode_normal(code);
    }
    columns.at_most_one_of(&[col::RADIUS, col::RADIUS_F32])?;
    let (steps, floats) = (columns.get(col::RADIUS), columns.get(col::RADIUS_F32));
    for (i, s) in surfels.iter_mut().enumerate() {
        s.radius = match floats {
            Some(rows) => rows.f32(i, 0),
            None => header.radius.decode(steps.map_or(0, |rows| rows.u16(i, 0))),
        };
    }
    columns.at_most_one_of(&[col::AREA, col::AREA_F32])?;
    let (steps, floats) = (columns.get(col::AREA), columns.get(col::AREA_F32));
    if steps.is_none() && floats.is_none() && overlap <= 0.0 {
        return Err(FormatError::invalid(
            "columns of the page",
            "an area, as radii are free",
            "none",
        ));
    }
    for (i, s) in surfels.iter_mut().enumerate() {
        s.area = match (steps, floats) {
            (Some(rows), _) => header.area.decode(rows.u16(i, 0)),
            (_, Some(rows)) => rows.f32(i, 0),
            (None, None) => area_of_disk(s.radius, overlap),
        };
    }
    decode_edges(header, columns, surfels)?;
    let front = surfels.iter_mut().map(|s| &mut s.front);
    radiance::decode(columns, col::FRONT, header.front, front)?;
    let back = surfels.iter_mut().map(|s| &mut s.back);
    radiance::decode(columns, col::BACK, header.back, back)?;
    for (i, s) in surfels.iter().enumerate() {
        check::surfel(s, &|| format!("surfel {i} of the page"))?;
    }
    Ok(())
}

fn decode_edges(header: &Header, columns: &PageColumns<'_>, surfels: &mut [Surfel]) -> Result<()> {
    let (counts, edges) = (columns.get(col::CLIP_COUNT), columns.get(col::CLIP_EDGE));
    let mut next = 0;
    if let (Some(counts), Some(edges)) = (counts, edges) {
        for (i, s) in surfels.iter_mut().enumerate() {
            let count = usize::from(counts.u8(i));
            if count > 3 || next + count > header.edges {
                return Err(FormatError::invalid(
                    "clip count",
                    format!("at most 3, and {} edges in all", header.edges),
                    count,
                ));
            }
            let mut codes = [[0; 2]; 3];
            for code in &mut codes[..count] {
                *code = edges.u16(next, 0).to_le_bytes();
                next += 1;
            }
            s.clips = decode_clips(&codes[..count]);
        }
    }
    if next != header.edges || counts.is_some() != edges.is_some() {
        return Err(FormatError::invalid(
            "clip edges of the page",
            header.edges.to_string(),
            next,
        ));
    }
    Ok(())
}

/// Radiance of nodes along axes: that of each node's fronts, then that of its backs.
fn decode_light(header: &Header, columns: &PageColumns<'_>, nodes: &mut [Node]) -> Result<()> {
    let mut lit = vec![[0.0; 3]; header.lit];
    radiance::decode(columns, col::AXIS_RADIANCE, header.axis, lit.iter_mut())?;
    let axis_area = columns.required(col::AXIS_AREA)?;
    let backs = columns.get(col::BACK_AXES);
    let mut next = lit.into_iter();
    let mut used = 0;
    for (i, node) in nodes.iter_mut().enumerate() {
        let has_fronts: [bool; 6] = std::array::from_fn(|k| axis_area.u16(i, k) > 0);
        let a = &mut node.aggregate;
        for (radiance, _) in a.axis_radiance.iter_mut().zip(has_fronts).filter(|r| r.1) {
            used += 1;
            *radiance = next.next().unwrap_or_default();
        }
        let lit_backs = backs.map_or(0, |rows| rows.u8(i));
        if lit_backs >> 6 != 0 {
            return Err(FormatError::invalid(
                format!("backs of node {i}"),
                "six axes",
                format!("{lit_backs:#04x}"),
            ));
        }
        for (k, radiance) in a.back_radiance.iter_mut().enumerate() {
            if lit_backs >> k & 1 == 1 {
                if !has_fronts[k ^ 1] {
                    return Err(FormatError::invalid(
                        format!("backs of node {i}"),
                        "fronts that face the other way",
                        format!("axes {lit_backs:#04x}"),
                    ));
                }
                used += 1;
                *radiance = next.next().unwrap_or_default();
            }
        }
    }
    if used != header.lit {
        return Err(FormatError::invalid(
            "lit axes of the page",
            used.to_string(),
            header.lit,
        ));
    }
    Ok(())
}

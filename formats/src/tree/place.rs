//! Where things are in a page: its box, positions and the boxes of nodes.

use super::columns::{self as col, PageBuilder};
use super::stats::{self, Errors};
use crate::quantise::Span;
use crate::record::{Below, Bounds, Reach, Surfel, SurfelPage};

/// The page's box, and whether what is in it is stored in its steps or as floats.
pub struct Placement {
    pub bounds: Bounds,
    pub spans: Option<[Span; 3]>,
}

/// Rows of what was placed.
pub struct Placed {
    rows: Rows,
    /// Boxes of all nodes, as a reader decodes them.
    pub boxes: Vec<Bounds>,
}

enum Rows {
    /// Of boxes and positions.
    Steps(Vec<[u16; 6]>, Vec<[u16; 3]>),
    /// Of positions.
    Floats(Vec<[f32; 3]>),
}

impl Placement {
    /// Steps of the page's box where they are fine enough, floats otherwise. The surfels become
    /// what a reader decodes; all of them but their positions is that already.
    pub fn choose(
        page: &SurfelPage,
        surfels: &mut [Surfel],
        errors: &mut Errors,
    ) -> (Self, Placed) {
        let reaches: Vec<Reach> = surfels.iter().map(Reach::of).collect();
        let mut bounds = Bounds::EMPTY;
        let mut least_radius = f32::INFINITY;
        for (surfel, reach) in surfels.iter().zip(&reaches) {
            bounds = bounds.union(reach.around(surfel.position));
            least_radius = least_radius.min(surfel.radius);
        }
        let mut inner = Bounds::EMPTY;
        for node in &page.nodes {
            match node.below {
                Below::Surfels { .. } => bounds = bounds.union(node.bounds),
                _ => inner = inner.union(node.bounds),
            }
        }
        let bounds = inner.union(rounded_out(bounds));
        // Rounding moves positions, and disks with them, by up to half a step: make room for three.
        let padded = pad(bounds);
        let spans: [Span; 3] = std::array::from_fn(|k| Span::new(padded.min[k], padded.max[k]));
        let half_steps = spans
            .iter()
            .map(|s| (s.step() / 2.0).powi(2))
            .sum::<f64>()
            .sqrt();
        let is_finite = padded.min.iter().chain(&padded.max).all(|v| v.is_finite());
        let fine = half_steps <= f64::from(least_radius) * stats::ERRORS[stats::POSITION_RADII].1;
        if is_finite && fine {
            let place = Self {
                bounds: padded,
                spans: Some(spans),
            };
            let mut trial = Errors::default();
            if let Some(placed) = in_steps_of(&spans, page, surfels, &reaches, &mut trial) {
                errors.add(&trial);
                return (place, placed);
            }
            for (surfel, given) in surfels.iter_mut().zip(&page.surfels) {
                surfel.position = given.position;
            }
        }
        let boxes = boxes(page, surfels, &reaches, Some).unwrap_or_default();
        let placed = Placed {
            rows: Rows::Floats(surfels.iter().map(|s| s.position).collect()),
            boxes,
        };
        (
            Self {
                bounds: placed.boxes[0],
                spans: None,
            },
            placed,
        )
    }
}

/// Places a page in steps, if all of it fits.
fn in_steps_of(
    spans: &[Span; 3],
    page: &SurfelPage,
    surfels: &mut [Surfel],
    reaches: &[Reach],
    errors: &mut Errors,
) -> Option<Placed> {
    let mut positions = Vec::with_capacity(surfels.len());
    for s in surfels.iter_mut() {
        let mut off = 0.0f64;
        positions.push(std::array::from_fn(|k| {
            let span = &spans[k];
            let code = span.nearest(s.position[k]);
            let p = span.decode(code);
            let d = (f64::from(p) - f64::from(s.position[k])).abs();
            off += d * d;
            errors.note(stats::POSITION_STEPS, in_steps(d, p, span));
            s.position[k] = p;
            code
        }));
        errors.note(stats::POSITION_RADII, off.sqrt() / f64::from(s.radius));
    }
    let mut codes = vec![[0u16; 6]; page.nodes.len()];
    let mut next = page.nodes.len();
    let boxes = boxes(page, surfels, reaches, |holds| {
        next -= 1;
        let mut decoded = Bounds::EMPTY;
        for (k, span) in spans.iter().enumerate() {
            let (low, high) = (span.below(holds.min[k]), span.above(holds.max[k]));
            codes[next][k] = low;
            codes[next][k + 3] = high;
            (decoded.min[k], decoded.max[k]) = (span.decode(low), span.decode(high));
            if decoded.min[k] > holds.min[k] || decoded.max[k] < holds.max[k] {
                return None;
            }
            let under = f64::from(holds.min[k]) - f64::from(decoded.min[k]);
            let over = f64::from(decoded.max[k]) - f64::from(holds.max[k]);
            errors.note(stats::BOX, in_steps(under, holds.min[k], span));
            errors.note(stats::BOX, in_steps(over, holds.max[k], span));
        }
        Some(decoded)
    })?;
    Some(Placed {
        rows: Rows::Steps(codes, positions),
        boxes,
    })
}

impl Placed {
    pub fn push_boxes(&self, builder: &mut PageBuilder) {
        match &self.rows {
            Rows::Steps(codes, _) => builder.push_u16(col::BOX, codes),
            Rows::Floats(_) => {
                let corners = |b: &Bounds| {
                    let [[a, b, c], [d, e, f]] = [b.min, b.max];
                    [a, b, c, d, e, f]
                };
                let rows: Vec<_> = self.boxes.iter().map(corners).collect();
                builder.push_f32(col::BOX_F32, &rows);
            }
        }
    }

    pub fn push_positions(&self, builder: &mut PageBuilder) {
        match &self.rows {
            Rows::Steps(_, rows) if !rows.is_empty() => builder.push_u16(col::POSITION, rows),
            Rows::Floats(rows) if !rows.is_empty() => builder.push_f32(col::POSITION_F32, rows),
            _ => {}
        }
    }
}

/// A difference in steps, less what the rounding of `value` to a float may have added.
pub fn in_steps(difference: f64, value: f32, span: &Span) -> f64 {
    let ulp = f64::from(value.abs().next_up()) - f64::from(value.abs());
    (difference - ulp).max(0.0) / span.step().max(f64::MIN_POSITIVE)
}

/// Boxes of all nodes, children before parents, each rounded by `round` around all that it must
/// hold.
fn boxes(
    page: &SurfelPage,
    surfels: &[Surfel],
    reaches: &[Reach],
    mut round: impl FnMut(Bounds) -> Option<Bounds>,
) -> Option<Vec<Bounds>> {
    let mut boxes = vec![Bounds::EMPTY; page.nodes.len()];
    for (i, node) in page.nodes.iter().enumerate().rev() {
        let mut holds = node.bounds;
        match node.below {
            Below::Nodes { first, count } => {
                for child in first..first + u32::from(count) {
                    holds = holds.union(boxes[child as usize]);
                }
            }
            Below::Surfels { first, count } => {
                let own = first as usize..first as usize + usize::from(count);
                let mut disks = Bounds::EMPTY;
                for (surfel, reach) in surfels[own.clone()].iter().zip(&reaches[own]) {
                    disks = disks.union(reach.around(surfel.position));
                }
                holds = holds.union(rounded_out(disks));
            }
            Below::Page(_) | Below::EvenPage(_) => {}
        }
        boxes[i] = round(holds)?;
    }
    Some(boxes)
}

/// The box of disks, also when a reader computes it with other rounding.
fn rounded_out(bounds: Bounds) -> Bounds {
    Bounds {
        min: bounds.min.map(f32::next_down),
        max: bounds.max.map(f32::next_up),
    }
}

fn pad(bounds: Bounds) -> Bounds {
    let mut padded = bounds;
    for k in 0..3 {
        let (min, max) = (f64::from(bounds.min[k]), f64::from(bounds.max[k]));
        let room = (max - min) * (3.0 / 65535.0);
        padded.min[k] = ((min - room) as f32).next_down().min(bounds.min[k]);
        padded.max[k] = ((max + room) as f32).next_up().max(bounds.max[k]);
    }
    padded
}

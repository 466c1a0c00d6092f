//! Where things are in a page: its box, positions and the boxes of nodes.

use super::columns::{self as col, PageBuilder};
use super::stats::{self, Errors};
use crate::quantise::Span;
use crate::record::{Below, Bounds, Surfel, SurfelPage};

/// The page's box, and whether what is in it is stored in its steps or as floats.
pub struct Placement {
    pub bounds: Bounds,
    pub spans: Option<[Span; 3]>,
}

/// Rows of what was placed.
pub struct Placed {
    floats: bool,
    box_rows: Vec<u8>,
    position_rows: Vec<u8>,
    /// As a reader decodes them.
    pub boxes: Vec<Bounds>,
}

impl Placement {
    /// Steps of the page's box where they are fine enough, floats otherwise. The surfels become
    /// what a reader decodes.
    pub fn choose(
        page: &SurfelPage,
        surfels: &mut [Surfel],
        errors: &mut Errors,
    ) -> (Self, Placed) {
        let mut bounds = Bounds::EMPTY;
        let mut least_radius = f32::INFINITY;
        for (given, decoded) in page.surfels.iter().zip(surfels.iter()) {
            bounds = bounds.union(disk(given)).union(disk(decoded));
            least_radius = least_radius.min(decoded.radius);
        }
        for node in &page.nodes {
            bounds = bounds.union(node.bounds);
        }
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
            let mut moved = surfels.to_vec();
            let place = Self {
                bounds: padded,
                spans: Some(spans),
            };
            let mut trial = Errors::default();
            if let Some(placed) = place.in_steps(page, &mut moved, &spans, &mut trial) {
                surfels.copy_from_slice(&moved);
                errors.add(&trial);
                return (place, placed);
            }
        }
        let boxes = boxes(page, surfels, Some).unwrap_or_default();
        let rows = boxes.iter().flat_map(|b| [b.min, b.max]);
        let placed = Placed {
            floats: true,
            box_rows: rows.flatten().flat_map(f32::to_le_bytes).collect(),
            position_rows: surfels
                .iter()
                .flat_map(|s| s.position)
                .flat_map(f32::to_le_bytes)
                .collect(),
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

    fn in_steps(
        &self,
        page: &SurfelPage,
        surfels: &mut [Surfel],
        spans: &[Span; 3],
        errors: &mut Errors,
    ) -> Option<Placed> {
        let mut position_rows = Vec::with_capacity(surfels.len() * 6);
        for s in surfels.iter_mut() {
            let mut off = 0.0f64;
            for (k, span) in spans.iter().enumerate() {
                let code = span.nearest(s.position[k]);
                let p = span.decode(code);
                let d = (f64::from(p) - f64::from(s.position[k])).abs();
                off += d * d;
                errors.note(stats::POSITION_STEPS, in_steps(d, p, span));
                s.position[k] = p;
                position_rows.extend(code.to_le_bytes());
            }
            errors.note(stats::POSITION_RADII, off.sqrt() / f64::from(s.radius));
        }
        let mut codes = vec![[0u16; 6]; page.nodes.len()];
        let mut next = page.nodes.len();
        let boxes = boxes(page, surfels, |holds| {
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
            floats: false,
            box_rows: codes
                .iter()
                .flatten()
                .flat_map(|c| c.to_le_bytes())
                .collect(),
            position_rows,
            boxes,
        })
    }
}

impl Placed {
    pub fn push_boxes(&self, builder: &mut PageBuilder) {
        let column = if self.floats { col::BOX_F32 } else { col::BOX };
        builder.push(column, self.box_rows.clone());
    }

    pub fn push_positions(&self, builder: &mut PageBuilder) {
        if !self.position_rows.is_empty() {
            let column = if self.floats {
                col::POSITION_F32
            } else {
                col::POSITION
            };
            builder.push(column, self.position_rows.clone());
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
                for surfel in first..first + u32::from(count) {
                    holds = holds.union(disk(&surfels[surfel as usize]));
                }
            }
            Below::Page(_) => {}
        }
        boxes[i] = round(holds)?;
    }
    Some(boxes)
}

/// The box of a disk, also when a reader computes it with other rounding.
fn disk(surfel: &Surfel) -> Bounds {
    let b = Bounds::of_surfel(surfel);
    Bounds {
        min: b.min.map(f32::next_down),
        max: b.max.map(f32::next_up),
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

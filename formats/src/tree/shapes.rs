//! The shapes of surfels in a page: normals, radii, areas and clip edges.

use super::columns::{self as col, PageBuilder};
use super::stats::{self, ColumnStats, Errors};
use crate::quantise::{
    Steps, area_of_disk, decode_edge, decode_normal, encode_edge, encode_normal, is_area_of_disk,
};
use crate::record::Surfel;

/// Everything of a surfel but its place and its light.
pub struct Shapes {
    normals: Vec<[u16; 2]>,
    radii: Coded,
    areas: Coded,
    pub edges: Vec<[u8; 2]>,
}

/// Rows of a column, in one of its codings.
enum Coded {
    /// No rows: they follow from another column.
    Derived,
    Steps(Steps, Vec<[u16; 1]>),
    Floats(Vec<[f32; 1]>),
}

impl Coded {
    /// Steps where they serve.
    fn new(steps: Option<Steps>, count: usize) -> Self {
        match steps {
            Some(steps) => Self::Steps(steps, Vec::with_capacity(count)),
            None => Self::Floats(Vec::with_capacity(count)),
        }
    }

    /// Adds a row; returns what a reader decodes, or `None` if that follows from another column.
    fn push(&mut self, value: f32) -> Option<f32> {
        match self {
            Self::Derived => None,
            Self::Steps(steps, rows) => {
                let code = steps.encode(value);
                rows.push([code]);
                Some(steps.decode(code))
            }
            Self::Floats(rows) => {
                rows.push([value]);
                Some(value)
            }
        }
    }

    /// The steps, for the header.
    fn steps(&self) -> Steps {
        match self {
            Self::Steps(steps, _) => *steps,
            _ => Steps { base: 0, shift: 0 },
        }
    }
}

/// Numbers for the header.
pub struct ShapeParams {
    pub radius: Steps,
    pub area: Steps,
}

impl Shapes {
    /// Quantises; the surfels become what a reader decodes.
    pub fn new(surfels: &mut [Surfel], overlap: f32, errors: &mut Errors) -> Self {
        let areas_follow = surfels
            .iter()
            .all(|s| is_area_of_disk(s.area, s.radius, overlap));
        let count = surfels.len();
        let radii = Steps::fit(surfels.iter().map(|s| s.radius));
        let areas = Steps::fit(surfels.iter().map(|s| s.area));
        let mut shapes = Self {
            normals: Vec::with_capacity(count),
            radii: Coded::new(radii, count),
            areas: match areas_follow {
                true => Coded::Derived,
                false => Coded::new(areas, count),
            },
            edges: Vec::new(),
        };
        // The angle grows with the chord: the largest of both belong together.
        let mut chord = 0.0f64;
        for s in surfels {
            let code = encode_normal(s.normal);
            let normal = decode_normal(code);
            chord = chord.max(chord_between(s.normal, normal));
            for edge in &mut s.clips.edges[..usize::from(s.clips.count)] {
                let code = encode_edge(*edge, s.normal, normal);
                *edge = decode_edge(code);
                shapes.edges.push(code);
            }
            s.normal = normal;
            shapes.normals.push(code);
            if let Some(radius) = shapes.radii.push(s.radius) {
                let off = f64::from(radius) / f64::from(s.radius) - 1.0;
                errors.note(stats::RADIUS, off.abs());
                s.radius = radius;
            }
            s.area = match shapes.areas.push(s.area) {
                Some(area) => area,
                None => area_of_disk(s.radius, overlap),
            };
        }
        errors.note(stats::NORMAL, degrees(chord));
        shapes
    }

    pub fn push(&self, builder: &mut PageBuilder, columns: &mut ColumnStats) -> ShapeParams {
        let params = ShapeParams {
            radius: self.radii.steps(),
            area: self.areas.steps(),
        };
        let count = self.normals.len() as u64;
        if count == 0 {
            return params;
        }
        builder.push_u16(col::NORMAL, &self.normals);
        match &self.radii {
            Coded::Steps(_, rows) if rows.iter().any(|row| *row != [0]) => {
                builder.push_u16(col::RADIUS, rows);
            }
            Coded::Floats(rows) => builder.push_f32(col::RADIUS_F32, rows),
            _ => columns.leave_out(col::RADIUS, 2 * count),
        }
        match &self.areas {
            Coded::Derived => columns.leave_out(col::AREA, 2 * count),
            Coded::Steps(_, rows) => builder.push_u16(col::AREA, rows),
            Coded::Floats(rows) => builder.push_f32(col::AREA_F32, rows),
        }
        params
    }
}

/// The chord between two directions on the unit sphere; `b` has unit length.
fn chord_between(a: [f32; 3], b: [f32; 3]) -> f64 {
    let length = a.iter().map(|c| f64::from(*c).powi(2)).sum::<f64>().sqrt();
    (0..3)
        .map(|i| (f64::from(a[i]) / length - f64::from(b[i])).powi(2))
        .sum::<f64>()
        .sqrt()
}

fn degrees(chord: f64) -> f64 {
    (2.0 * libm::asin((chord / 2.0).min(1.0))).to_degrees()
}

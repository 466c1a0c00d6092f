//! What a writer notes of its pages, for the summary.

use super::columns::{self as col, Column};
use crate::bytes;
use crate::summary::{ColumnBytes, LeftOut, WorstError};
use crate::{FormatError, Result};
use std::ops::Range;
use xxhash_rust::xxh3::xxh3_64;

/// Quantisation errors that are tracked: name and promised bound.
pub const ERRORS: [(&str, f64); 8] = [
    ("surfel position, steps of the page's box", 0.5),
    ("surfel position, radii", 1.0 / 64.0),
    ("surfel normal, degrees", 0.005),
    ("surfel radius, relative", 1.0 / 2048.0),
    ("radiance, relative to the largest channel", 1.0 / 512.0),
    ("node centre, steps of the page's box", 0.5),
    ("node box, steps beyond what it holds", 1.0),
    ("lvoxel extinction, relative", 1.0 / 2048.0),
];
pub const POSITION_STEPS: usize = 0;
pub const POSITION_RADII: usize = 1;
pub const NORMAL: usize = 2;
pub const RADIUS: usize = 3;
pub const RADIANCE: usize = 4;
pub const CENTRE: usize = 5;
pub const BOX: usize = 6;
pub const SIGMA_T: usize = 7;

/// Bytes by column.
#[derive(Clone)]
pub struct ColumnStats {
    table: &'static [Column],
    raw: Vec<u64>,
    /// Raw and stored bytes of the columns of the sampled pages, each compressed on its own.
    sampled: Vec<(u64, u64)>,
    left_out: Vec<u64>,
}

impl ColumnStats {
    pub fn new(table: &'static [Column]) -> Self {
        Self {
            table,
            raw: vec![0; table.len()],
            sampled: vec![(0, 0); table.len()],
            left_out: vec![0; table.len()],
        }
    }

    /// Notes bytes that a column would have taken.
    pub fn leave_out(&mut self, index: usize, bytes: u64) {
        self.left_out[index] += bytes;
    }

    /// Notes what a file leaves out of columns that `is_kept` says are the same in this one.
    pub fn keep_left_out(&mut self, of_file: &[LeftOut], is_kept: impl Fn(usize) -> bool) {
        for (i, column) in self.table.iter().enumerate().filter(|(i, _)| is_kept(*i)) {
            let left_out = of_file.iter().filter(|l| l.name == column.name);
            self.left_out[i] += left_out.map(|l| l.raw_bytes).sum::<u64>();
        }
    }

    /// Notes the columns of a page. One page in eight, chosen by its content so that the choice is
    /// the same whoever writes it, has its columns compressed apart.
    pub fn add_page(
        &mut self,
        raw: &[u8],
        ranges: &[(usize, Range<usize>)],
        level: i32,
    ) -> Result<()> {
        let sampled = xxh3_64(raw).is_multiple_of(8);
        for (index, range) in ranges {
            self.raw[*index] += range.len() as u64;
            if sampled {
                let column = &raw[range.clone()];
                let packed = bytes::compress(column, level)?.map_or(column.len(), |p| p.len());
                self.sampled[*index].0 += column.len() as u64;
                self.sampled[*index].1 += packed as u64;
            }
        }
        Ok(())
    }

    pub fn add(&mut self, other: &Self) {
        for i in 0..self.raw.len() {
            self.raw[i] += other.raw[i];
            self.sampled[i].0 += other.sampled[i].0;
            self.sampled[i].1 += other.sampled[i].1;
            self.left_out[i] += other.left_out[i];
        }
    }

    /// The columns, with `stored` bytes shared out among them.
    pub fn columns(&self, stored: u64) -> Vec<ColumnBytes> {
        let weights: Vec<f64> = (0..self.raw.len())
            .map(|i| match self.sampled[i] {
                (0, _) => self.raw[i] as f64,
                (raw, packed) => self.raw[i] as f64 * packed as f64 / raw as f64,
            })
            .collect();
        let sum: f64 = weights.iter().sum();
        (0..self.raw.len())
            .filter(|i| self.raw[*i] > 0)
            .map(|i| ColumnBytes {
                name: self.table[i].name.into(),
                raw_bytes: self.raw[i],
                stored_bytes: (stored as f64 * weights[i] / sum).round() as u64,
            })
            .collect()
    }

    pub fn left_out(&self) -> Vec<LeftOut> {
        (0..self.raw.len())
            .filter(|i| self.left_out[*i] > 0)
            .map(|i| LeftOut {
                name: self.table[i].name.into(),
                because: reason(self.table[i].name).into(),
                raw_bytes: self.left_out[i],
            })
            .collect()
    }
}

fn reason(column: &str) -> &'static str {
    match column {
        "area" => "it follows from the radius",
        "radius" | "level" | "sigma_t" => "all the same in a page",
        "volume" => "one volume in a page",
        "clip_count" => "nothing is clipped",
        "axis_radiance" => "nothing radiates that way, or grey",
        "back_axes" => "no back is lit",
        _ => "dark, or grey",
    }
}

/// Worst errors, by [`ERRORS`].
#[derive(Clone, Copy, Default)]
pub struct Errors([f64; ERRORS.len()]);

impl Errors {
    pub fn note(&mut self, index: usize, error: f64) {
        self.0[index] = self.0[index].max(error);
    }

    pub fn add(&mut self, other: &Self) {
        for (i, error) in other.0.iter().enumerate() {
            self.note(i, *error);
        }
    }

    /// Notes the errors that a file tells.
    pub fn add_list(&mut self, errors: &[WorstError]) {
        for (i, (name, _)) in ERRORS.iter().enumerate() {
            let told = errors.iter().filter(|e| e.name == *name);
            told.for_each(|e| self.note(i, e.worst));
        }
    }

    pub fn list(&self) -> Vec<WorstError> {
        ERRORS
            .iter()
            .zip(self.0)
            .map(|((name, bound), worst)| WorstError {
                name: (*name).into(),
                worst,
                bound: *bound,
            })
            .collect()
    }

    /// Notes how far radiance moved, relative to its largest channel.
    pub fn note_radiance(&mut self, given: [f32; 3], decoded: [f32; 3]) {
        let max = given[0].max(given[1]).max(given[2]);
        if max > 0.0 {
            let off = |k: usize| (f64::from(given[k]) - f64::from(decoded[k])).abs();
            let most = off(0).max(off(1)).max(off(2));
            self.note(RADIANCE, most / f64::from(max));
        }
    }
}

/// Compresses a page; a page that does not shrink is stored as it is, which a reader sees from
/// equal lengths.
pub fn pack_page(raw: Vec<u8>, level: i32) -> Result<(Vec<u8>, u32)> {
    if raw.len() > super::MAX_PAGE_BYTES {
        return Err(FormatError::invalid(
            "bytes of a page",
            format!("at most {}", super::MAX_PAGE_BYTES),
            raw.len(),
        ));
    }
    let raw_bytes = raw.len() as u32;
    Ok((bytes::compress(&raw, level)?.unwrap_or(raw), raw_bytes))
}

/// zstd's level for pages of surfels.
pub const SURFEL_ZSTD_LEVEL: i32 = 3;

/// zstd's level for pages of lvoxels, which gain more by it than those of surfels.
pub const LVOXEL_ZSTD_LEVEL: i32 = 6;

pub fn surfel_columns() -> ColumnStats {
    ColumnStats::new(&col::SURFELS)
}

pub fn lvoxel_columns() -> ColumnStats {
    ColumnStats::new(&col::LVOXELS)
}

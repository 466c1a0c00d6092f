//! Regions of the frame, shaded by many threads.

use super::corners::Corners;
use super::planes::{Block, Part, Planes, assemble};
use super::shader::PixelShader;
use crate::Result;
use crate::gather::{Medium, Pages};
use crate::image::Region;
use crate::run::{Job, Task};
use crate::shade::air::Air;
use rayon::prelude::*;

/// Pixels along an edge of the blocks that threads take: what blocks need around them is a smaller share of large ones, and
/// small ones share out the work better where there are few.
const BLOCK: [u32; 2] = [128, 64];
/// Blocks for each thread, at least, for them to be large.
const ENOUGH: usize = 6;

/// These parts of the pixels of a region.
///
/// # Errors
/// If cancelled.
pub fn shade_region<P: Pages, M: Medium, A: Air>(
    shader: &PixelShader<P, M, A>,
    region: Region,
    parts: &[Part],
    job: &Job,
    task: &Task,
) -> Result<Planes> {
    let blocks = if shader.counts.pixel == 1 {
        from_corners(shader, region, parts, job, task)
    } else {
        from_own_samples(shader, region, parts, job, task)
    };
    Ok(assemble(region, parts, &blocks?))
}

/// Shades a region by samples of each pixel's own, row by row.
fn from_own_samples<P: Pages, M: Medium, A: Air>(
    shader: &PixelShader<P, M, A>,
    region: Region,
    parts: &[Part],
    job: &Job,
    task: &Task,
) -> Result<Vec<Block>> {
    (region.y0..region.y1)
        .into_par_iter()
        .map(|y| {
            let y1 = y + 1;
            let row = Region {
                y0: y,
                y1,
                ..region
            };
            let mut shaded = Block::new(row, parts);
            for x in region.x0..region.x1 {
                job.cancel.check()?;
                shaded.push(parts, &shader.shade(x, y));
            }
            task.add(u64::from(region.width()));
            Ok(shaded)
        })
        .collect()
}

/// Shades a region from the corners of its pixels, block by block.
fn from_corners<P: Pages, M: Medium, A: Air>(
    shader: &PixelShader<P, M, A>,
    region: Region,
    parts: &[Part],
    job: &Job,
    task: &Task,
) -> Result<Vec<Block>> {
    let many = ENOUGH * rayon::current_num_threads();
    let large = region.blocks(BLOCK[0]);
    let blocks = if large.len() >= many {
        large
    } else {
        region.blocks(BLOCK[1])
    };
    blocks
        .par_iter()
        .map(|&block| {
            job.cancel.check()?;
            let corners = Corners::new(shader, block);
            let mut shaded = Block::new(block, parts);
            for (x, y) in block.coordinates() {
                job.cancel.check()?;
                shaded.push(parts, &corners.shade(x, y));
            }
            task.add(block.pixels() as u64);
            Ok(shaded)
        })
        .collect()
}

//! Regions of the frame, shaded by many threads.

use super::corners::Corners;
use super::pixel::Pixel;
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

/// The pixels of a region, row by row.
///
/// # Errors
/// If cancelled.
pub fn shade_region<P: Pages, M: Medium, A: Air>(
    shader: &PixelShader<P, M, A>,
    region: Region,
    job: &Job,
    task: &Task,
) -> Result<Vec<Pixel>> {
    if shader.counts.pixel == 1 {
        return shade_blocks(shader, region, job, task);
    }
    (region.y0..region.y1)
        .into_par_iter()
        .map(|y| {
            let row = (region.x0..region.x1).map(|x| {
                job.cancel.check()?;
                Ok(shader.shade(x, y))
            });
            let row: Vec<Pixel> = row.collect::<Result<_>>()?;
            task.add(u64::from(region.width()));
            Ok(row)
        })
        .collect::<Result<Vec<_>>>()
        .map(|rows| rows.concat())
}

/// Shades a region from the corners of its pixels, block by block.
fn shade_blocks<P: Pages, M: Medium, A: Air>(
    shader: &PixelShader<P, M, A>,
    region: Region,
    job: &Job,
    task: &Task,
) -> Result<Vec<Pixel>> {
    let many = ENOUGH * rayon::current_num_threads();
    let large = region.blocks(BLOCK[0]);
    let blocks = if large.len() >= many {
        large
    } else {
        region.blocks(BLOCK[1])
    };
    let shaded: Vec<Vec<Pixel>> = blocks
        .par_iter()
        .map(|&block| {
            job.cancel.check()?;
            let corners = Corners::new(shader, block);
            let pixels = (block.y0..block.y1)
                .flat_map(|y| (block.x0..block.x1).map(move |x| (x, y)))
                .map(|(x, y)| {
                    job.cancel.check()?;
                    Ok(corners.shade(x, y))
                })
                .collect::<Result<_>>()?;
            task.add(block.pixels() as u64);
            Ok(pixels)
        })
        .collect::<Result<_>>()?;
    let mut pixels = vec![Pixel::default(); region.pixels()];
    for (block, shaded) in blocks.iter().zip(&shaded) {
        let width = block.width() as usize;
        for (row, y) in shaded.chunks_exact(width).zip(block.y0..) {
            let first = (y - region.y0) as usize * region.width() as usize
                + (block.x0 - region.x0) as usize;
            pixels[first..first + width].copy_from_slice(row);
        }
    }
    Ok(pixels)
}

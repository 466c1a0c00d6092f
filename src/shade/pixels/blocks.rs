//! Regions of the frame, shaded by many threads.

use super::corners::Corners;
use super::layers::{Planes, Quantity};
use super::pixel::Pixel;
use super::planes::{Block, assemble};
use super::shader::PixelShader;
use crate::Result;
use crate::image::{Onlooker, Region};
use crate::run::{Job, Task};
use crate::shade::pixels::camera_media::CameraMedia;
use rayon::prelude::*;

/// Width and height of the blocks that threads take, pixels: what blocks need around them is a
/// smaller share of large ones, and small ones share out the work better where there are few.
pub const BLOCK_SIZES: [[u32; 2]; 2] = [[128, 128], [64, 64]];
/// The same where pixels share nothing.
const SIZES_ALONE: [[u32; 2]; 3] = [[64, 64], [32, 32], [8, 8]];
/// Blocks for each thread, at least, for them to be larger than the smallest.
const BLOCKS_PER_THREAD: usize = 4;

/// Shades the pixels of a region, and keeps some quantities of them.
///
/// # Errors
/// If cancelled, or if there is no memory for the pixels.
pub fn shade_region<A: CameraMedia>(
    shader: &PixelShader<A>,
    region: Region,
    quantities: &[Quantity],
    onlooker: Option<&dyn Onlooker>,
    job: &Job,
    task: &Task,
) -> Result<Planes> {
    let finished = |region, block: &Block| {
        if let Some(onlooker) = onlooker {
            onlooker.see(region, block.planes());
        }
        task.add(region.pixels() as u64);
    };
    let blocks = if shader.counts.pixel == 1 {
        let blocks = blocks_of(region, BLOCK_SIZES);
        shade_blocks(&blocks, quantities, job, finished, |block| {
            let corners = Corners::new(shader, block);
            move |x, y| corners.shade(x, y)
        })
    } else {
        let blocks = blocks_of(region, SIZES_ALONE);
        shade_blocks(&blocks, quantities, job, finished, |_| {
            |x, y| shader.shade(x, y)
        })
    };
    assemble(region, quantities, &blocks?)
}

/// The parts of a region that threads take: of the first of some sizes that gives enough of them,
/// or of the last.
pub fn blocks_of<const N: usize>(region: Region, sizes: [[u32; 2]; N]) -> Vec<Region> {
    let many = BLOCKS_PER_THREAD * rayon::current_num_threads();
    let mut blocks = Vec::new();
    for size in sizes {
        blocks = region.blocks(size);
        if blocks.len() >= many {
            break;
        }
    }
    blocks
}

/// Shades blocks by what `prepare` makes of each.
fn shade_blocks<S: FnMut(u32, u32) -> Pixel>(
    blocks: &[Region],
    quantities: &[Quantity],
    job: &Job,
    finished: impl Fn(Region, &Block) + Sync,
    prepare: impl Fn(Region) -> S + Sync,
) -> Result<Vec<Block>> {
    blocks
        .par_iter()
        .map(|&block| {
            job.cancel.check()?;
            let mut shade = prepare(block);
            let mut shaded = Block::new(block, quantities)?;
            for (x, y) in block.coordinates() {
                job.cancel.check()?;
                shaded.push(quantities, &shade(x, y));
            }
            finished(block, &shaded);
            Ok(shaded)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_are_blocks_and_enough_of_them() {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(4);
        let pool = pool.build().unwrap();
        let of =
            |width, height| pool.install(|| blocks_of(Region::full(width, height), SIZES_ALONE));
        for (width, height, edge) in [(1920, 1080, 64), (160, 120, 32), (64, 48, 8), (3, 2, 3)] {
            let blocks = of(width, height);
            assert_eq!(blocks[0].width(), edge, "{width} x {height}");
            assert!(blocks.len() >= 16 || edge <= 8, "{width} x {height}");
            let pixels: usize = blocks.iter().map(Region::pixels).sum();
            assert_eq!(pixels, width as usize * height as usize);
        }
    }
}

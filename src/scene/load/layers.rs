//! Passes over all voxels of a field, one layer after another.

use crate::Result;
use crate::run::Cancel;
use crate::scene::grid::VoxelBox;
use rayon::prelude::*;
use std::ops::Range;

/// Voxels that are looked at at one time, at most, but for what eight rows of eight layers have.
const MOST_AT_ONCE: usize = 1 << 22;

/// Voxels to look at, with empty ones on every side that do not count.
pub(super) struct Voxels<F> {
    /// Voxels per axis, padding included.
    pub(super) dims: [usize; 3],
    /// Index in the file of the first voxel, that of the padding.
    pub(super) first: [i64; 3],
    pub(super) padding: usize,
    /// Writes the values of a box of voxels, x fastest.
    pub(super) read: F,
}

/// What `add` makes of the rows of each layer, without the padding, from `start` on.
pub(super) fn layers<F, T>(
    voxels: &Voxels<F>,
    cancel: &Cancel,
    start: &T,
    add: impl Fn(&mut T, &[f32]) + Sync,
) -> Result<Vec<T>>
where
    F: Fn(&VoxelBox, &mut [f32]) -> Result<()> + Sync,
    T: Clone + Send + Sync,
{
    let pad = voxels.padding;
    let [nx, ny, nz] = voxels.dims.map(|n| n - pad);
    let width = nx - pad;
    // Files keep voxels in leaves of this edge: none is to be unpacked for one layer after another.
    let edge = 8;
    let slabs = (0..nz).step_by(edge).map(|z| z.max(pad)..nz.min(z + edge));
    let slabs: Vec<_> = slabs.filter(|slab| !slab.is_empty()).collect();
    let height = (MOST_AT_ONCE / (width * edge)).max(edge);
    let slab = |slab: &Range<usize>| {
        let mut layers = vec![start.clone(); slab.len()];
        for y in (pad..ny).step_by(height) {
            cancel.check()?;
            let part = VoxelBox {
                first: [pad, y, slab.start],
                dims: [width, height.min(ny - y), slab.len()],
            };
            let mut values = vec![0.0; part.count()];
            (voxels.read)(&part, &mut values)?;
            for ([_, _, z], at) in part.rows() {
                add(&mut layers[z - slab.start], &values[at..at + width]);
            }
        }
        Ok(layers)
    };
    let slabs: Vec<Result<Vec<T>>> = slabs.par_iter().map(slab).collect();
    let slabs = slabs.into_iter().collect::<Result<Vec<_>>>()?;
    Ok(slabs.into_iter().flatten().collect())
}

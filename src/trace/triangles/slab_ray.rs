//! A ray and the boxes of the hierarchy.

use super::{Child, Node};
use crate::math::Ray;
use crate::trace::watertight::{Block, LANES};
use arrayvec::ArrayVec;
use wide::{f32x4, f32x8};

/// Children that are still to be visited, each with the distance at which the ray enters it.
pub(super) type Stack<T> = ArrayVec<(f32, T), MAX_ENTRIES>;

/// More than any hierarchy needs: those that would need more are not built.
pub(super) const MAX_ENTRIES: usize = 256;

/// Pushes an entry so that of those from `below` on the nearest is popped first.
#[inline(always)]
pub(super) fn push_sorted<T: Copy>(stack: &mut Stack<T>, below: usize, entry: (f32, T)) {
    let mut i = stack.len();
    stack.push(entry);
    while i > below && stack[i - 1].0 < entry.0 {
        stack[i] = stack[i - 1];
        i -= 1;
    }
    stack[i] = entry;
}

/// A ray prepared for slab tests.
pub(super) struct SlabRay {
    origin: [f32; 3],
    inverse: [f32; 3],
    /// Planes at which the ray enters and leaves boxes, by axis.
    first: [usize; 3],
    last: [usize; 3],
}

impl SlabRay {
    /// More than the rounding of a distance to a plane, twice: no box is missed whose triangle is
    /// met.
    pub(super) const ROUNDING: f32 = 1.0 + 1e-6;

    pub(super) fn new(ray: &Ray) -> Self {
        // A zero would make 0 * inf of a plane that the ray lies in.
        let inverse = ray.direction.to_array().map(|v| {
            let least = 1e-18_f32.copysign(v);
            1.0 / if v.abs() < 1e-18 { least } else { v }
        });
        let first = std::array::from_fn(|a| if inverse[a] < 0.0 { 3 + a } else { a });
        let last = std::array::from_fn(|a| if inverse[a] < 0.0 { a } else { 3 + a });
        Self {
            origin: ray.origin.to_array(),
            inverse,
            first,
            last,
        }
    }

    /// Returns the distances at which the ray enters the boxes of a node's children, and which of
    /// them it enters before `t_end`.
    #[inline(always)]
    pub(super) fn meet(&self, node: &Node, t_end: f32) -> (f32x8, f32x8) {
        let (mut near, mut far) = (f32x8::ZERO, f32x8::splat(t_end));
        for a in 0..3 {
            let (o, inverse) = (f32x8::splat(self.origin[a]), f32x8::splat(self.inverse[a]));
            near = near.fast_max((node.planes[self.first[a]] - o) * inverse);
            far = far.fast_min((node.planes[self.last[a]] - o) * inverse);
        }
        (near, near.simd_le(far * f32x8::splat(Self::ROUNDING)))
    }

    /// Returns the distances at which the ray enters boxes, of which corners of triangles are the
    /// ends, and a bit for each of them that it enters before `t_end`.
    #[inline]
    pub(super) fn meet_boxes(&self, boxes: &Block, t_end: f32) -> ([f32; LANES], u32) {
        let [low, high] = boxes.ends();
        let (mut near, mut far) = (f32x4::ZERO, f32x4::splat(t_end));
        for a in 0..3 {
            let (o, inverse) = (f32x4::splat(self.origin[a]), f32x4::splat(self.inverse[a]));
            let (first, last) = match self.inverse[a] < 0.0 {
                true => (high[a], low[a]),
                false => (low[a], high[a]),
            };
            near = near.fast_max((first - o) * inverse);
            far = far.fast_min((last - o) * inverse);
        }
        let is_met = near
            .simd_le(far * f32x4::splat(Self::ROUNDING))
            .to_bitmask();
        (near.to_array(), is_met & boxes.present())
    }

    /// The nearest child whose box the ray enters before `t_end`; the others go on the stack, the
    /// next nearest last.
    // A call for each node would keep the ray out of registers.
    #[inline(always)]
    pub(super) fn enter(&self, node: &Node, t_end: f32, stack: &mut Stack<Child>) -> Option<Child> {
        let (near, met) = self.meet(node, t_end);
        let mut met = met.to_bitmask();
        let near = near.to_array();
        if met == 0 {
            return None;
        }
        let k = met.trailing_zeros() as usize;
        met &= met - 1;
        let mut nearest = (near[k], node.children[k]);
        let below = stack.len();
        while met != 0 {
            let k = met.trailing_zeros() as usize;
            met &= met - 1;
            let mut other = (near[k], node.children[k]);
            if other.0 < nearest.0 {
                std::mem::swap(&mut other, &mut nearest);
            }
            push_sorted(stack, below, other);
        }
        Some(nearest.1)
    }
}

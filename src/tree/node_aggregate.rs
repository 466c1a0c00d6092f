//! What stands for the surfels below a node of the tree.

use lvox_formats::record::Node;

/// The surfels below a node as one: what stands for them where a node is taken whole.
#[derive(Clone, Copy, Debug)]
pub struct NodeAggregate {
    /// Mean of the surfels' normals weighted by area, unit length.
    pub normal: [f32; 3],
    /// The plane through the mean position: `normal . x = plane`.
    pub plane: f32,
    /// Share of that plane inside the node's box that is covered; negative if the node is not flat.
    pub coverage: f32,
    /// Sum of surfel areas, scene units squared.
    pub(super) area: f32,
    /// Second moment as in [`lvox_formats::record::SurfelAggregate`], but over the area.
    second_moment: [f32; 6],
    /// The axes that its surfels face; what they send to those is in its page.
    pub(super) axes: Axes,
}

/// The axes that surfels face, a bit each, and the index of the first of what they send to those.
#[derive(Clone, Copy, Debug)]
pub(super) struct Axes {
    pub mask: u32,
    pub first: u32,
}

impl NodeAggregate {
    /// A node is flat if its normals agree this well: mean length over area.
    const MIN_FLATNESS: f32 = 0.97;

    /// The aggregate of a node whose surfels face these axes.
    pub(super) fn new(node: &Node, axes: Axes) -> Self {
        let g = &node.aggregate;
        let over_area = |v: f32| per_area(v, g.area);
        let n = g.normal_sum.map(over_area);
        let length = (n[0] * n[0] + n[1] * n[1] + n[2] * n[2]).sqrt();
        let normal = if length > 0.0 {
            n.map(|v| v / length)
        } else {
            [0.0, 0.0, 1.0]
        };
        let plane = (0..3).map(|a| normal[a] * g.centre[a]).sum();
        let coverage = if length > Self::MIN_FLATNESS {
            let e: [f32; 3] = std::array::from_fn(|a| node.bounds.max[a] - node.bounds.min[a]);
            // The plane's section of the box is no larger than the box's face over the normal's
            // cosine.
            let section = (0..3)
                .map(|a| e[(a + 1) % 3] * e[(a + 2) % 3] / normal[a].abs().max(1e-6))
                .fold(f32::INFINITY, f32::min);
            if section > 0.0 { g.area / section } else { 1.0 }
        } else {
            -1.0
        };
        Self {
            normal,
            plane,
            coverage,
            area: g.area,
            second_moment: g.second_moment.map(over_area),
            axes,
        }
    }

    /// Whether the node is met as a patch of its plane.
    #[must_use]
    pub fn is_flat(&self) -> bool {
        self.coverage >= 0.0
    }

    /// Mean squared cosine between the normals of its surfels and a unit direction, weighted by
    /// area; none where it has none.
    #[must_use]
    pub fn squared_cosine(&self, d: [f32; 3]) -> f32 {
        let [xx, yy, zz, xy, xz, yz] = self.second_moment;
        let quadratic = xx * d[0] * d[0]
            + yy * d[1] * d[1]
            + zz * d[2] * d[2]
            + 2.0 * (xy * d[0] * d[1] + xz * d[0] * d[2] + yz * d[1] * d[2]);
        quadratic.max(0.0)
    }

    /// Share of the box, as seen along `d`, that surfels cover.
    #[must_use]
    pub fn opacity(&self, d: [f32; 3], extent: [f32; 3]) -> f32 {
        let projected = self.area * self.squared_cosine(d).sqrt();
        let section = d[0].abs() * extent[1] * extent[2]
            + d[1].abs() * extent[2] * extent[0]
            + d[2].abs() * extent[0] * extent[1];
        if section > 0.0 {
            (projected / section).min(1.0)
        } else {
            1.0
        }
    }
}

/// A sum over surfels divided by the sum of their areas; none where that is none.
#[inline]
pub(super) fn per_area(sum: f32, area: f32) -> f32 {
    if area > 0.0 { sum / area } else { 0.0 }
}

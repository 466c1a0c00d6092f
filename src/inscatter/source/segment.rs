//! A segment of a camera ray in a volume.

use crate::math::SeenPhase;
use crate::math::exp::one_minus_exp_neg;
use glam::Vec3;

/// A segment of a ray in a volume.
pub(super) struct RaySegment<K> {
    pub volume: usize,
    pub ends: [Vec3; 2],
    /// Of the densest channel, and of what the ray sees of all: other depths are of the latter.
    pub depth: f32,
    pub seen_depth: f32,
    /// What each channel adds to the ray.
    pub channels: K,
    /// What stands for it, in scene space and in the volume's index space.
    pub point: Vec3,
    pub at: Vec3,
    /// Depth of a voxel of the densest medium in the brick, and of one as dense as on the segment.
    pub densest: f32,
    pub voxel_depth: f32,
    /// How the ray sees the phase function, if that is not isotropic.
    pub seen: Option<SeenPhase>,
    /// Whether light between the vertices of the brick is as good as linear.
    pub is_thin: bool,
    /// The coarsest lattice that its brick allows.
    pub level: usize,
    /// The finest that the camera needs of direct light, and of indirect light.
    pub finest: usize,
    pub finest_indirect: usize,
    /// How many lattices of direct light are fine enough beside emitters.
    pub levels: usize,
    /// The lattice of the front that it is in; 0 if it is in none.
    pub front: usize,
}

impl<K> RaySegment<K> {
    /// The point before which this share of the light comes from that the camera sees of the
    /// segment.
    pub fn at_share(&self, share: f32) -> Vec3 {
        let reach = if self.seen_depth > 0.0 {
            -libm::log1pf(-share * one_minus_exp_neg(self.seen_depth)) / self.seen_depth
        } else {
            share
        };
        let [from, to] = self.ends;
        from + (to - from) * reach.min(1.0)
    }
}

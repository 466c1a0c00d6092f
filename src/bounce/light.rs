//! What lvoxels, rays and solvers reckon with.

use glam::Vec3A;

/// Light, by channel.
pub type Light = Vec3A;

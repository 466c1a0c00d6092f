//! Surfaces on rays through a volume, and the light that they send along these.

use super::light::Light;
use super::links::Sites;
use crate::math::{Hit, Ray, Rgb};
use crate::trace::{Surface, Tracer, offset};

/// Most surfaces on a ray in a volume: what is behind so many is lit by the last.
const MOST: usize = 16;

/// What one side of a surface sends.
#[derive(Clone, Copy, Debug)]
pub struct WallSide {
    /// Of the light in the tree.
    sent: Rgb,
    /// The share of what arrives at a receiver.
    albedo: Rgb,
    receiver: u32,
}

impl WallSide {
    /// One that sends nothing.
    const DARK: Self = Self {
        sent: Rgb::BLACK,
        albedo: Rgb::BLACK,
        receiver: u32::MAX,
    };

    /// One that sends this of the light in the tree, and no other.
    #[cfg(test)]
    pub fn of(sent: Rgb) -> Self {
        Self { sent, ..Self::DARK }
    }
}

/// A surface from which light enters a ray on either side.
#[derive(Clone, Copy, Debug)]
pub struct Wall {
    /// Distance from the ray's origin.
    pub t: f32,
    /// Blocks that the ray crosses before it.
    pub before: u32,
    /// The side from which light goes on along the ray.
    pub ahead: WallSide,
    /// The side from which light goes back.
    pub back: WallSide,
}

/// The light of surfaces beside a volume.
pub struct WallLight<'a> {
    /// Whether they send what is in the tree.
    pub sends_tree: bool,
    /// By receiver: irradiance over pi.
    pub light: &'a [Rgb],
}

impl WallLight<'_> {
    /// No light at all.
    pub const NONE: Self = Self {
        sends_tree: false,
        light: &[],
    };

    /// What is in the tree, and no other.
    #[cfg(test)]
    pub fn tree() -> Self {
        Self {
            sends_tree: true,
            ..Self::NONE
        }
    }

    /// What one side of a surface sends.
    pub fn sent(&self, side: &WallSide) -> Light {
        let mut sent = Rgb::BLACK;
        if self.sends_tree {
            sent += side.sent;
        }
        if let Some(light) = self.light.get(side.receiver as usize) {
            sent += side.albedo * *light;
        }
        Light::from(sent.0)
    }
}

/// The surfaces on a ray's way through a volume, which send nothing.
pub fn hiding(tracer: &Tracer, ray: &Ray) -> Vec<Wall> {
    let mut walls = Vec::new();
    let mut from = 0.0;
    while walls.len() < MOST && from < ray.t_max {
        let rest = Ray::new(ray.at(from), ray.direction, ray.t_max - from);
        let Some(hit) = tracer.closest(&rest) else {
            break;
        };
        walls.push(Wall {
            t: from + hit.t,
            before: 0,
            ahead: WallSide::DARK,
            back: WallSide::DARK,
        });
        from += hit.t + 16.0 * offset(rest.at(hit.t));
    }
    walls
}

/// What finds the surfaces on rays, and what they send.
pub struct Walls<'a> {
    /// The scene.
    pub tracer: &'a Tracer<'a>,
    /// Receivers, the runs of which tell what surfaces send.
    pub sites: &'a Sites<'a>,
}

impl Walls<'_> {
    /// The surfaces from which light enters a ray at its ends and on its way through a volume.
    pub fn on(&self, ray: &Ray) -> Vec<Wall> {
        let mut walls = Vec::new();
        if self.tracer.scene.mesh.triangles.is_empty() {
            return walls;
        }
        let &Ray {
            origin,
            direction,
            t_max,
        } = ray;
        // From a little within: a box of a volume may stand right on a surface.
        let inside = 16.0 * offset(origin).max(offset(ray.at(t_max)));
        let start = origin + direction * inside;
        if let Some(ahead) = self.seen(&Ray::endless(start, -direction)) {
            walls.push(Wall {
                t: f32::NEG_INFINITY,
                before: 0,
                ahead,
                back: WallSide::DARK,
            });
        }
        let mut from = 0.0;
        while walls.len() < MOST && from < t_max {
            let rest = Ray::new(ray.at(from), direction, t_max - from);
            let Some(hit) = self.tracer.closest(&rest) else {
                break;
            };
            let point = rest.at(hit.t);
            // Beyond it, light comes from its other side.
            let off = 16.0 * offset(point);
            let behind = Ray::new(point + direction * off, -direction, 2.0 * off);
            walls.push(Wall {
                t: from + hit.t,
                before: 0,
                ahead: self.seen(&behind).unwrap_or(WallSide::DARK),
                back: self.side(&hit),
            });
            from += hit.t + off;
        }
        if let Some(back) = self.seen(&Ray::endless(ray.at(t_max - inside), direction)) {
            walls.push(Wall {
                t: f32::INFINITY,
                before: 0,
                ahead: WallSide::DARK,
                back,
            });
        }
        walls
    }

    /// The side of a surface that ends a ray.
    fn seen(&self, ray: &Ray) -> Option<WallSide> {
        let hit = self.tracer.closest(ray)?;
        Some(self.side(&hit))
    }

    /// The side of a surface that was hit.
    fn side(&self, hit: &Hit) -> WallSide {
        let surface = Surface::new(self.tracer.scene, hit.triangle, hit.uv);
        if surface.albedo.is_black() {
            return WallSide::DARK;
        }
        let normal = surface.face_normal * if hit.is_back { -1.0 } else { 1.0 };
        let Some(receiver) = self.sites.nearest(surface.position, normal) else {
            return WallSide::DARK;
        };
        WallSide {
            sent: self.sites.receivers[receiver as usize].sent_at(surface.position),
            albedo: surface.albedo,
            receiver,
        }
    }
}

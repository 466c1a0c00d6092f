//! Emissive triangles.

use super::tree::Tree;
use crate::math::{Rgb, polygon, sampling};
use crate::scene::Scene;
use crate::trace::unit_normal;
use glam::Vec3;

/// A triangle that emits.
#[derive(Clone, Copy, Debug)]
pub struct Emitter {
    /// Corners.
    pub corners: [Vec3; 3],
    /// Unit normal of the side that emits.
    pub normal: Vec3,
    /// Emitted radiance.
    pub radiance: Rgb,
    /// Area, scene units squared.
    pub area: f32,
    /// Whether the other side emits, too.
    pub both_sides: bool,
}

impl Emitter {
    /// Uniform point for two numbers in [0,1).
    fn point(&self, u: [f32; 2]) -> Vec3 {
        let w = sampling::triangle(u);
        self.corners[0] * w[0] + self.corners[1] * w[1] + self.corners[2] * w[2]
    }

    /// A direction from `origin` to the emitter, the distance along it, and its density per steradian: uniform over the
    /// emitter's solid angle where that is large, else uniform over its area.
    pub fn look_at(&self, origin: Vec3, u: [f32; 2]) -> (Vec3, f32, f32) {
        /// Area over squared distance from which the two differ enough to pay for the first.
        const NEAR: f32 = 0.02;
        let corners = self.corners.map(|c| c - origin);
        let middle = (corners[0] + corners[1] + corners[2]) * (1.0 / 3.0);
        if self.area > NEAR * middle.length_squared()
            && let Some(d) = polygon::sample_solid_angle(corners, u)
        {
            let distance = corners[0].dot(self.normal) / d.dot(self.normal);
            return (d, distance, 1.0 / polygon::solid_angle(corners));
        }
        let to_light = self.point(u) - origin;
        let distance = to_light.length();
        let d = to_light / distance;
        let pdf = distance * distance / (self.area * self.normal.dot(d).abs());
        (d, distance, pdf)
    }

    fn lights(&self, point: Vec3) -> bool {
        self.both_sides || (point - self.corners[0]).dot(self.normal) > 0.0
    }
}

/// The emissive triangles of a scene.
#[derive(Debug)]
pub struct Emitters {
    all: Vec<Emitter>,
    /// Over them, if there are many.
    tree: Option<Tree>,
}

impl Emitters {
    /// Up to this many are all asked; more are asked by a tree.
    pub const FEW: usize = 64;

    /// Finds them.
    pub fn new(scene: &Scene) -> Self {
        let mut all = Vec::new();
        for (t, &m) in scene.mesh.material.iter().enumerate() {
            let material = &scene.materials[m as usize];
            let radiance = Rgb(material.emission);
            if !radiance.is_black() {
                let corners = scene.mesh.corners(t);
                all.push(Emitter {
                    corners,
                    normal: unit_normal(corners),
                    radiance,
                    area: scene.mesh.area_vector(t).length(),
                    both_sides: material.emits_both_sides,
                });
            }
        }
        Self::of(all)
    }

    /// These.
    pub fn of(all: Vec<Emitter>) -> Self {
        let tree = if all.len() > Self::FEW {
            Tree::new(&all)
        } else {
            None
        };
        Self { all, tree }
    }

    /// How many there are.
    #[cfg(test)]
    pub fn len(&self) -> usize {
        self.all.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.all.is_empty()
    }

    /// The emitter of an index, one that [`Self::facing`] or the tree gave.
    pub fn get(&self, index: u32) -> &Emitter {
        &self.all[index as usize]
    }

    /// The tree over many; `None` if they are few.
    pub fn tree(&self) -> Option<&Tree> {
        self.tree.as_ref()
    }

    /// The emitters that face a point, with their indices: of [`Self::FEW`] at most.
    pub fn facing(&self, point: Vec3) -> impl Iterator<Item = (u32, &Emitter)> {
        let few = self.all.iter().take(Self::FEW).enumerate();
        few.filter(move |(_, e)| e.lights(point))
            .map(|(i, e)| (i as u32, e))
    }
}

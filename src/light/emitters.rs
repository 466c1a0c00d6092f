//! The emissive triangles of a scene.

use super::emitter::Emitter;
use super::tree::Tree;
use crate::math::Rgb;
use crate::scene::Scene;
use crate::trace::unit_normal;
use glam::Vec3;

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

    /// Finds those of a scene.
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
                    area: scene.mesh.area(t),
                    both_sides: material.emits_both_sides,
                });
            }
        }
        Self::of(all)
    }

    /// A tree over them, if they are many.
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

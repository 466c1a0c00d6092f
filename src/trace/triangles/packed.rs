//! The hierarchy in a packed scene, where it is used as it lies.

use super::instances::InstanceBvh;
use super::{Blocks, Node, TriangleBvh};
use crate::Result;
use crate::formats::{PackedColumn, PackedHierarchy, PackedMeta, PackedWriter};
use crate::run::Cancel;
use crate::scene::packed::PackedScene;
use crate::scene::{Mesh, Scene};
use crate::trace::watertight::{Block, VertexBlock};
use bytemuck::{Pod, Zeroable};

const _: () = assert!(size_of::<Node>() == 224 && size_of::<Block>() == 160);
const _: () = assert!(size_of::<VertexBlock>() == 64);

// SAFETY: 56 numbers of 32 bits each, of which any are a node, without a gap.
unsafe impl Zeroable for Node {}
// SAFETY: as above.
unsafe impl Pod for Node {}
// SAFETY: 40 numbers of 32 bits each, of which any are a block, without a gap.
unsafe impl Zeroable for Block {}
// SAFETY: as above.
unsafe impl Pod for Block {}
// SAFETY: 16 numbers of 32 bits each, of which any are a block, without a gap.
unsafe impl Zeroable for VertexBlock {}
// SAFETY: as above.
unsafe impl Pod for VertexBlock {}

impl<'a> TriangleBvh<'a> {
    /// The hierarchy over the triangles of a scene: the one of its packed file, where it lies, or
    /// else one that is built.
    ///
    /// # Errors
    /// If cancelled.
    pub fn of_scene(scene: &'a Scene, cancel: &Cancel) -> Result<Self> {
        let Some(packed) = scene.as_packed() else {
            return Ok(Self::new_until(&scene.mesh, cancel)?.with_masks(scene));
        };
        let meta = packed.file().meta();
        let mesh = &scene.mesh;
        let mut all = Self::in_file(packed, mesh, (0, meta.hierarchy))?.with_masks(scene);
        let prototypes = meta.parts.instances.iter().flat_map(|i| &i.prototypes);
        let prototypes = (1..).zip(prototypes.map(|p| p.hierarchy));
        let prototypes = prototypes.map(|of| Self::in_file(packed, mesh, of));
        let prototypes = prototypes.collect::<Result<_>>()?;
        all.instances = InstanceBvh::new(mesh, prototypes).map(Box::new);
        Ok(all)
    }

    /// A hierarchy of a packed file, by its number there.
    fn in_file(
        packed: &PackedScene,
        mesh: &'a Mesh,
        (item, hierarchy): (u32, Option<PackedHierarchy>),
    ) -> Result<Self> {
        // Without triangles, or with none that any ray could meet.
        let Some(hierarchy) = hierarchy else {
            return Ok(Self::default());
        };
        Ok(Self {
            nodes: packed.column(PackedColumn::Nodes, item)?,
            blocks: match hierarchy.by_vertex {
                true => Blocks::Vertices(packed.column(PackedColumn::VertexBlocks, item)?),
                false => Blocks::Corners(packed.column(PackedColumn::Blocks, item)?),
            },
            positions: &mesh.positions,
            scale: hierarchy.scale,
            masks: None,
            instances: None,
        })
    }

    /// This hierarchy, and those over prototypes.
    fn each(&self) -> impl Iterator<Item = &Self> {
        let instances = self.instances.iter();
        std::iter::once(self).chain(instances.flat_map(|i| i.prototypes()))
    }

    /// Whether all triangles in leaves are those of a mesh, each once, and instances stand where
    /// their boxes are.
    #[must_use]
    pub fn has_right_blocks(&self, mesh: &Mesh) -> bool {
        let mut is_seen = vec![false; mesh.triangles.len()];
        let mut lanes = |triangles: &[u32]| {
            let there = triangles.iter().take_while(|t| **t != u32::MAX).count();
            let are_new = triangles[..there].iter().all(|&t| {
                let seen = is_seen.get_mut(t as usize);
                seen.is_some_and(|seen| !std::mem::replace(seen, true))
            });
            (there > 0 && are_new).then_some(there)
        };
        let instances = mesh.instances.list().iter();
        let mut bounds = mesh.bounds_of_instances().into_iter();
        let are_bounded = instances
            .zip(&mut bounds)
            .all(|(i, bounds)| i.bounds == bounds);
        let has_right_blocks = |of: &Self| match &of.blocks {
            Blocks::Corners(blocks) => blocks.iter().all(|block| {
                lanes(&block.triangles).is_some_and(|n| {
                    let right = Block::new(mesh, &block.triangles[..n], of.scale);
                    bytemuck::bytes_of(&right) == bytemuck::bytes_of(block)
                })
            }),
            Blocks::Vertices(blocks) => blocks.iter().all(|block| {
                lanes(&block.triangles).is_some_and(|n| {
                    let right = VertexBlock::new(mesh, &block.triangles[..n]);
                    bytemuck::bytes_of(&right) == bytemuck::bytes_of(block)
                })
            }),
        };
        are_bounded && self.each().all(has_right_blocks)
    }

    /// Says in what a packed file says of its scene how large it is, and those of prototypes are.
    pub fn describe(&self, meta: &mut PackedMeta) {
        meta.hierarchy = self.description();
        let described = meta.parts.instances.iter_mut();
        let described = described.flat_map(|i| &mut i.prototypes);
        for (prototype, bvh) in described.zip(self.each().skip(1)) {
            prototype.hierarchy = bvh.description();
        }
    }

    /// What a packed file says of it; `None` if it is empty.
    fn description(&self) -> Option<PackedHierarchy> {
        (!self.nodes.is_empty()).then(|| PackedHierarchy {
            nodes: self.nodes.len() as u64,
            blocks: self.blocks.len() as u64,
            by_vertex: matches!(self.blocks, Blocks::Vertices(_)),
            scale: self.scale,
        })
    }

    /// Writes its columns.
    ///
    /// # Errors
    /// As [`PackedWriter::column`], and if cancelled.
    pub fn write(&self, writer: &mut PackedWriter, cancel: &Cancel) -> Result<()> {
        let all = || {
            (0..)
                .zip(self.each())
                .filter(|(_, bvh)| !bvh.nodes.is_empty())
        };
        for (item, bvh) in all() {
            let nodes = bytemuck::cast_slice(&bvh.nodes);
            writer.column(PackedColumn::Nodes, item, nodes, || cancel.check())?;
        }
        for (item, bvh) in all() {
            let (column, blocks) = match &bvh.blocks {
                Blocks::Corners(blocks) => (PackedColumn::Blocks, bytemuck::cast_slice(blocks)),
                Blocks::Vertices(blocks) => {
                    (PackedColumn::VertexBlocks, bytemuck::cast_slice(blocks))
                }
            };
            writer.column(column, item, blocks, || cancel.check())?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn leaves_hold_the_triangles_of_their_mesh_alone() {
        let mut scene = Scene::demo().unwrap();
        let nodes = TriangleBvh::new(&scene.mesh).nodes.to_vec();
        let blocks = |mesh: &Mesh| match &TriangleBvh::new(mesh).blocks {
            Blocks::Corners(blocks) => blocks.to_vec(),
            Blocks::Vertices(_) => Vec::new(),
        };
        let of = |blocks: Vec<Block>| TriangleBvh {
            nodes: nodes.clone().into(),
            blocks: Blocks::Corners(blocks.into()),
            positions: &[],
            scale: TriangleBvh::new(&scene.mesh).scale,
            masks: None,
            instances: None,
        };
        let right = blocks(&scene.mesh);
        assert!(of(right.clone()).has_right_blocks(&scene.mesh));
        let mut twice = right.clone();
        twice.push(right[0]);
        assert!(!of(twice).has_right_blocks(&scene.mesh));
        let found = of(right);
        let moved = scene.mesh.triangles[5][0] as usize;
        let mut positions = scene.mesh.positions.to_vec();
        positions[moved].x += 0.5;
        scene.mesh.positions = positions.into();
        assert!(!found.has_right_blocks(&scene.mesh));
    }
}

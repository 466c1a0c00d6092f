//! The hierarchy in a packed scene, where it is used as it lies.

use super::{Blocks, Node, TriangleBvh};
use crate::Result;
use crate::formats::{PackedColumn, PackedHierarchy, PackedWriter};
use crate::run::Cancel;
use crate::scene::{Masks, Mesh, Scene};
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
        match packed.file().meta().hierarchy {
            Some(hierarchy) => Ok(Self {
                nodes: packed.column(PackedColumn::Nodes, 0)?,
                blocks: match hierarchy.by_vertex {
                    true => Blocks::Vertices(packed.column(PackedColumn::VertexBlocks, 0)?),
                    false => Blocks::Corners(packed.column(PackedColumn::Blocks, 0)?),
                },
                positions: &scene.mesh.positions,
                scale: hierarchy.scale,
                masks: Masks::of(scene),
                instances: None,
            }),
            // Without triangles, or with none that any ray could meet.
            None => Ok(Self::default()),
        }
    }

    /// Whether all triangles in leaves are those of a mesh, each once.
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
        match &self.blocks {
            Blocks::Corners(blocks) => blocks.iter().all(|block| {
                lanes(&block.triangles).is_some_and(|n| {
                    let right = Block::new(mesh, &block.triangles[..n], self.scale);
                    bytemuck::bytes_of(&right) == bytemuck::bytes_of(block)
                })
            }),
            Blocks::Vertices(blocks) => blocks.iter().all(|block| {
                lanes(&block.triangles).is_some_and(|n| {
                    let right = VertexBlock::new(mesh, &block.triangles[..n]);
                    bytemuck::bytes_of(&right) == bytemuck::bytes_of(block)
                })
            }),
        }
    }

    /// What a packed file says of it; `None` if it is empty.
    #[must_use]
    pub fn description(&self) -> Option<PackedHierarchy> {
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
        if self.nodes.is_empty() {
            return Ok(());
        }
        let nodes = bytemuck::cast_slice(&self.nodes);
        writer.column(PackedColumn::Nodes, 0, nodes, || cancel.check())?;
        let (column, blocks) = match &self.blocks {
            Blocks::Corners(blocks) => (PackedColumn::Blocks, bytemuck::cast_slice(blocks)),
            Blocks::Vertices(blocks) => (PackedColumn::VertexBlocks, bytemuck::cast_slice(blocks)),
        };
        writer.column(column, 0, blocks, || cancel.check())
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

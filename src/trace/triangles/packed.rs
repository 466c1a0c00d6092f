//! The hierarchy in a packed scene, where it is used as it lies.

use super::{Blocks, Node, TriangleBvh};
use crate::Result;
use crate::formats::{PackedColumn, PackedHierarchy, PackedWriter};
use crate::run::Cancel;
use crate::scene::Scene;
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
            return Self::new_until(&scene.mesh, cancel);
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
            }),
            // Without triangles, or with none that any ray could meet.
            None => Ok(Self::default()),
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

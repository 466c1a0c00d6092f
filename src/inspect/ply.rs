//! Points and nodes as binary PLY, which every viewer opens.

use super::File;
use super::disk::{Disk, SceneFromIndex};
use crate::formats::{AtomicFile, Below, FormatError, Lvoxel, MappedFile, Overwrite, Sums, Tree};
use crate::{Error, Result};
use std::collections::HashSet;
use std::io::{BufWriter, Seek, SeekFrom, Write};
use std::path::Path;
use std::rc::Rc;

/// Counts of an export.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct Exported {
    /// Vertices in the file.
    pub vertices: u64,
    /// Vertices that are surfels or nodes; the others are lvoxels.
    pub surfels_or_nodes: u64,
}

/// Writes the points of a file, in scene space: position, normal, radius, radiance, extinction, and
/// a colour for display.
///
/// With `level`, the nodes of a tree that many steps below the root are written in place of the
/// surfels, and leaves above them, so that all of the surface is covered: a node's normal is its
/// mean normal, its radius that of a disk of its area. Lvoxels have no normal; their radius is that
/// of a ball of their volume.
///
/// # Errors
/// Wrong input for a level of a cloud, an output that exists and may not be replaced, or a damaged
/// file.
pub fn export_ply(
    path: &Path,
    out: &Path,
    level: Option<u32>,
    overwrite: Overwrite,
) -> Result<Exported> {
    let file = File::open(path)?;
    if let (File::Cloud(_), Some(_)) = (&file, level) {
        return Err(
            Error::input(format!("{}: a cloud has no levels", path.display()))
                .hint("build a tree with `lvox build`, and export that"),
        );
    }
    let (sums, volumes) = match &file {
        File::Cloud(cloud) => (&cloud.summary().sums, &cloud.meta().volumes),
        File::Tree(tree) => (&tree.summary().sums, &tree.meta().cloud.volumes),
    };
    let mut ply = Ply::create(out, exposure(sums), overwrite)?;
    match (&file, level) {
        (File::Cloud(cloud), _) => {
            for i in 0..cloud.surfel_chunks() {
                for s in cloud.surfel_chunk(i)? {
                    ply.disk(&Disk::of_surfel(&s))?;
                }
            }
        }
        (File::Tree(tree), None) => {
            for i in 0..tree.surfel_pages() {
                for s in tree.surfel_page(i)?.surfels {
                    ply.disk(&Disk::of_surfel(&s))?;
                }
            }
        }
        (File::Tree(tree), Some(level)) => {
            if let Some(root) = tree.root_page() {
                nodes(tree, path, root, level, &mut ply)?;
            }
        }
    }
    let surfels_or_nodes = ply.vertices;
    let to_scene: Vec<Option<SceneFromIndex>> = volumes.iter().map(SceneFromIndex::of).collect();
    let mut lvoxels = |all: Vec<Lvoxel>| {
        all.iter()
            .try_for_each(|v| match &to_scene[usize::from(v.volume)] {
                Some(map) => ply.disk(&Disk::of_lvoxel(v, map)),
                None => Ok(()),
            })
    };
    match &file {
        File::Cloud(cloud) => {
            for i in 0..cloud.lvoxel_chunks() {
                lvoxels(cloud.lvoxel_chunk(i)?)?;
            }
        }
        File::Tree(tree) => {
            for i in 0..tree.lvoxel_pages() {
                lvoxels(tree.lvoxel_page(i)?)?;
            }
        }
    }
    let vertices = ply.vertices;
    ply.finish()?;
    Ok(Exported {
        vertices,
        surfels_or_nodes,
    })
}

/// The factor that makes the mean radiance a middle grey.
fn exposure(sums: &Sums) -> f32 {
    let mean = sums.flux.iter().sum::<f64>() / 3.0 / std::f64::consts::PI / sums.area;
    if mean.is_finite() && mean > 0.0 {
        (0.18 / mean) as f32
    } else {
        1.0
    }
}

/// The nodes that many steps below the root, and leaves above them, in the order of the tree.
fn nodes(tree: &Tree<MappedFile>, path: &Path, root: u32, level: u32, ply: &mut Ply) -> Result<()> {
    let page = |id: u32| Ok::<_, Error>(Rc::new(tree.surfel_page(id as usize)?));
    let mut linked = HashSet::from([root]);
    let mut todo = vec![(page(root)?, 0, level)];
    while let Some((of, i, below)) = todo.pop() {
        let node = &of.nodes[i as usize];
        match node.below {
            _ if below == 0 => ply.disk(&Disk::of_node(node))?,
            Below::Nodes { first, count } => {
                let children = (first..first + u32::from(count)).rev();
                todo.extend(children.map(|child| (Rc::clone(&of), child, below - 1)));
            }
            Below::Surfels { .. } => ply.disk(&Disk::of_node(node))?,
            // The link and the page's root are the same node.
            Below::Page(next) | Below::EvenPage(next) if linked.insert(next) => {
                todo.push((page(next)?, 0, below));
            }
            // Else a damaged tree could have more paths than anyone can walk.
            Below::Page(next) | Below::EvenPage(next) => {
                return Err(FormatError::Invalid {
                    what: format!("links to page {next}"),
                    expected: "one".into(),
                    found: "two".into(),
                }
                .at(path)
                .into());
            }
        }
    }
    Ok(())
}

/// Room for a header; what it does not need is a comment.
const PLY_HEADER_BYTES: usize = 512;

/// A PLY file of vertices, whose count is written last.
struct Ply {
    file: BufWriter<AtomicFile>,
    exposure: f32,
    vertices: u64,
}

impl Ply {
    fn create(path: &Path, exposure: f32, overwrite: Overwrite) -> Result<Self> {
        let mut ply = Self {
            file: BufWriter::with_capacity(1 << 20, AtomicFile::create(path, overwrite)?),
            exposure,
            vertices: 0,
        };
        ply.write(&[b' '; PLY_HEADER_BYTES])?;
        Ok(ply)
    }

    fn write(&mut self, bytes: &[u8]) -> Result<()> {
        self.file.write_all(bytes).map_err(|e| self.failed(&e))
    }

    fn failed(&self, error: &std::io::Error) -> Error {
        Error::io("write", self.file.get_ref().path(), error)
    }

    fn disk(&mut self, disk: &Disk) -> Result<()> {
        let mut row = Vec::with_capacity(47);
        let floats = disk.position.iter().chain(&disk.normal);
        let floats = floats.chain([&disk.radius]).chain(&disk.radiance);
        row.extend(floats.chain([&disk.sigma_t]).flat_map(|v| v.to_le_bytes()));
        row.extend(disk.radiance.map(|l| srgb(l * self.exposure)));
        self.vertices += 1;
        self.write(&row)
    }

    fn finish(mut self) -> Result<()> {
        let mut header = format!(
            "ply\nformat binary_little_endian 1.0\n\
             comment scene space; radiance times {:e} is the colour\nelement vertex {}\n",
            self.exposure, self.vertices
        );
        for name in [
            "x",
            "y",
            "z",
            "nx",
            "ny",
            "nz",
            "radius",
            "radiance_r",
            "radiance_g",
            "radiance_b",
            "sigma_t",
        ] {
            header += &format!("property float {name}\n");
        }
        header += "property uchar red\nproperty uchar green\nproperty uchar blue\ncomment ";
        let end = "\nend_header\n";
        let room = PLY_HEADER_BYTES - end.len() - header.len();
        header += &".".repeat(room);
        header += end;
        self.file
            .seek(SeekFrom::Start(0))
            .and_then(|_| self.file.write_all(header.as_bytes()))
            .and_then(|()| self.file.flush())
            .map_err(|e| self.failed(&e))?;
        // Nothing is left in the buffer.
        Ok(self.file.into_parts().0.commit()?)
    }
}

fn srgb(linear: f32) -> u8 {
    let l = linear.clamp(0.0, 1.0);
    let encoded = if l <= 0.003_130_8 {
        12.92 * l
    } else {
        1.055 * l.powf(1.0 / 2.4) - 0.055
    };
    (encoded * 255.0).round() as u8
}

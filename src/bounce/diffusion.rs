//! Light that diffuses between the blocks of a volume, face to face: about what becomes of light
//! that scatters so often that it differs little from one block to the next. Sweeps take many turns
//! to bring that on its way, and these equations know it at once.
//!
//! They are solved about, by one cycle of a multigrid method: blocks, and cells that hold two of
//! the level before along each axis, until few are left.

use super::blocks::Blocks;
use super::light::{Light, Share};
use glam::DMat3;
use rayon::prelude::*;

/// Cells of one size or larger, and what goes on between them.
#[derive(Debug)]
struct Level<K> {
    /// By cell: where its contacts start among all; one more for the end.
    starts: Vec<u32>,
    contacts: Vec<Contact<K>>,
    cells: Vec<Cell<K>>,
    /// By cell: the one that holds it in the next level; none in the last one.
    parents: Vec<u32>,
}

/// How much light goes from one cell to another that it touches, for each unit by which it is
/// brighter.
#[derive(Clone, Copy, Debug)]
struct Contact<K> {
    cell: u32,
    passes: K,
}

/// A cube of voxels.
#[derive(Clone, Copy, Debug)]
struct Cell<K> {
    corner: [u32; 3],
    /// Voxels.
    edge: u32,
    /// Volume times extinction, of what is in it.
    depth: K,
    /// What goes to all that it touches, and out of the medium.
    leaves: K,
}

/// Diffusion in one volume.
#[derive(Debug)]
pub struct Diffusion<K> {
    levels: Vec<Level<K>>,
    /// By channel: share of light that does not scatter.
    absorbed: Light,
}

impl<K: Share> Diffusion<K> {
    /// Bytes a block, about: three contacts and a half, two ways, of it and of the cells above.
    pub const BYTES_A_BLOCK: usize = (7 * size_of::<Contact<K>>()
        + size_of::<Cell<K>>()
        + 2 * size_of::<u32>()
        + 3 * size_of::<Light>())
        * 8
        / 7;
    /// Cells that are few enough.
    const FEW: usize = 32;
    /// Times that few cells are smoothed.
    const LAST_TURNS: u32 = 16;
    /// Share of what a cell lacks that it is given, while those around it are given theirs.
    const DAMPED: f32 = 0.8;

    /// The cells of a volume.
    pub fn new(blocks: &Blocks) -> Self {
        let mut levels = vec![Level::of_blocks(blocks)];
        let mut edge = 2;
        while levels.last().is_some_and(|l| l.cells.len() > Self::FEW) && edge < 1 << 20 {
            if let Some(last) = levels.last_mut()
                && let Some(next) = last.next(edge)
            {
                levels.push(next);
            }
            edge *= 2;
        }
        Self {
            levels,
            absorbed: Light::ONE - Light::from(blocks.albedo),
        }
    }

    /// The light of blocks, about, that are given so much.
    pub fn spread(&self, given: &[Light]) -> Vec<Light> {
        self.cycle(0, given)
    }

    fn cycle(&self, number: usize, given: &[Light]) -> Vec<Light> {
        let level = &self.levels[number];
        let rows = || (0..given.len()).into_par_iter().with_min_len(1 << 10);
        let share = |i: usize, lacks: Light| {
            let Cell { depth, leaves, .. } = level.cells[i];
            let all = self.absorbed * depth.light() + leaves.light();
            let part = |c: usize| match all[c] > 0.0 {
                true => Self::DAMPED * lacks[c] / all[c],
                false => 0.0,
            };
            Light::new(part(0), part(1), part(2))
        };
        let lacks = |i: usize, light: &[Light]| {
            let Cell { depth, leaves, .. } = level.cells[i];
            let brought = level
                .own(i)
                .iter()
                .map(|c| light[c.cell as usize] * c.passes.light());
            let spent = (self.absorbed * depth.light() + leaves.light()) * light[i];
            given[i] - spent + brought.sum::<Light>()
        };
        let smoothed = |light: &[Light]| -> Vec<Light> {
            rows()
                .map(|i| light[i] + share(i, lacks(i, light)))
                .collect()
        };
        let mut light: Vec<Light> = rows().map(|i| share(i, given[i])).collect();
        if level.parents.is_empty() {
            for _ in 0..Self::LAST_TURNS {
                light = smoothed(&light);
            }
            return light;
        }
        let rest: Vec<Light> = rows().map(|i| lacks(i, &light)).collect();
        let mut of_parents = vec![Light::ZERO; self.levels[number + 1].cells.len()];
        for (rest, parent) in rest.iter().zip(&level.parents) {
            of_parents[*parent as usize] += *rest;
        }
        let more = self.cycle(number + 1, &of_parents);
        (light.par_iter_mut().zip(&level.parents)).for_each(|(l, p)| *l += more[*p as usize]);
        smoothed(&light)
    }
}

impl<K: Share> Level<K> {
    fn own(&self, cell: usize) -> &[Contact<K>] {
        &self.contacts[self.starts[cell] as usize..self.starts[cell + 1] as usize]
    }

    /// A level of cells whose contacts are found one by one.
    fn of(cells: Vec<Cell<K>>, contacts: impl Fn(usize, &mut Vec<Contact<K>>) -> K + Sync) -> Self {
        const TOGETHER: usize = 1 << 12;
        let parts = cells.par_chunks(TOGETHER).enumerate().map(|(n, cells)| {
            let mut found = Vec::new();
            let own = (0..cells.len()).map(|i| {
                let first = found.len();
                let out = contacts(n * TOGETHER + i, &mut found);
                let passes = sum(&found[first..]);
                (found.len() - first, out + passes)
            });
            let own: Vec<(usize, K)> = own.collect();
            (own, found)
        });
        let parts: Vec<_> = parts.collect();
        let mut level = Self {
            cells,
            starts: vec![0],
            contacts: Vec::new(),
            parents: Vec::new(),
        };
        let mut cells = level.cells.iter_mut();
        let mut end = 0;
        for (own, found) in parts {
            for ((count, leaves), cell) in own.into_iter().zip(&mut cells) {
                cell.leaves = leaves;
                end += count as u32;
                level.starts.push(end);
            }
            level.contacts.extend(found);
        }
        level
    }

    /// The blocks of a volume.
    fn of_blocks(blocks: &Blocks) -> Self {
        // Scene units per voxel along each axis.
        let DMat3 {
            x_axis,
            y_axis,
            z_axis,
        } = blocks.scene_from_index.matrix3;
        let wide = [x_axis, y_axis, z_axis].map(|a| a.length() as f32);
        let cell = |i: usize| {
            let edge = 1_u32 << blocks.levels[i];
            Cell {
                corner: blocks.corners[i],
                edge,
                depth: blocks.depth((edge as f32).powi(3) * blocks.sigma_t[i]),
                leaves: K::default(),
            }
        };
        let cells = (0..blocks.len()).into_par_iter().map(cell).collect();
        Self::of(cells, |i, found| {
            let (corner, edge) = (blocks.corners[i], 1_u32 << blocks.levels[i]);
            let deep = |block: usize| {
                let edge = (1_u32 << blocks.levels[block]) as f32;
                blocks.depth::<K>(1.5 * edge * blocks.sigma_t[block])
            };
            let is_met = blocks.at(corner) == Some(i);
            let mut out = K::default();
            for axis in 0..3 {
                for is_up in [false, true] {
                    let mut open = edge * edge;
                    let beyond = match is_up {
                        true => corner[axis].checked_add(edge),
                        false => corner[axis].checked_sub(1),
                    };
                    if let Some(beyond) = beyond.filter(|_| is_met) {
                        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
                        let mut at = corner;
                        at[axis] = beyond;
                        // Blocks beyond a face are of one size.
                        let step = blocks.edge_at(at).min(edge);
                        for n in 0..(edge / step).pow(2) {
                            at[u] = corner[u] + n % (edge / step) * step;
                            at[v] = corner[v] + n / (edge / step) * step;
                            if let Some(other) = blocks.at(at) {
                                let area = (step * step) as f32;
                                let deep = (deep(i) + deep(other)) * wide[axis];
                                found.push(Contact {
                                    cell: other as u32,
                                    passes: deep.each(|d| area / (wide[axis] * d.max(LEAST_DEPTH))),
                                });
                                open -= step * step;
                            }
                        }
                    }
                    // To where nothing comes back from (Marshak).
                    let open = open as f32;
                    out += deep(i).each(|d| open / (wide[axis] * (2.0 + wide[axis] * d)));
                }
            }
            out
        })
    }

    /// Cells of at least this edge, unless there are as many of them as here.
    fn next(&mut self, edge: u32) -> Option<Self> {
        let grown = |cell: &Cell<K>| {
            let edge = cell.edge.max(edge);
            (cell.corner.map(|c| c / edge * edge), edge)
        };
        let mut order: Vec<([u32; 3], u32)> = (self.cells.par_iter().enumerate())
            .map(|(i, cell)| (grown(cell).0, i as u32))
            .collect();
        order.par_sort_unstable();
        let groups: Vec<&[([u32; 3], u32)]> = order.chunk_by(|a, b| a.0 == b.0).collect();
        if groups.len() == self.cells.len() {
            return None;
        }
        self.parents = vec![0; self.cells.len()];
        let mut out = Vec::with_capacity(groups.len());
        let mut cells = Vec::with_capacity(groups.len());
        for (number, group) in groups.iter().enumerate() {
            let (corner, edge) = grown(&self.cells[group[0].1 as usize]);
            let (mut depth, mut leaves_medium) = (K::default(), K::default());
            for (_, i) in *group {
                let cell = &self.cells[*i as usize];
                let inside = sum(self.own(*i as usize));
                self.parents[*i as usize] = number as u32;
                depth += cell.depth;
                leaves_medium += (cell.leaves - inside).each(|l| l.max(0.0));
            }
            out.push(leaves_medium);
            cells.push(Cell {
                corner,
                edge,
                depth,
                leaves: K::default(),
            });
        }
        let edges: Vec<u32> = cells.iter().map(|c| c.edge).collect();
        Some(Self::of(cells, |number, found| {
            let first = found.len();
            for (_, i) in groups[number] {
                let small = &self.cells[*i as usize];
                for contact in self.own(*i as usize) {
                    let other = self.parents[contact.cell as usize];
                    if other as usize == number {
                        continue;
                    }
                    // Their middles are farther apart.
                    let near = small.edge + self.cells[contact.cell as usize].edge;
                    let far = edges[number] + edges[other as usize];
                    let passes = contact.passes.each(|p| p * near as f32 / far as f32);
                    match found[first..].iter_mut().find(|c| c.cell == other) {
                        Some(known) => known.passes += passes,
                        None => found.push(Contact {
                            cell: other,
                            passes,
                        }),
                    }
                }
            }
            out[number]
        }))
    }
}

/// What goes over all of some contacts.
fn sum<K: Share>(contacts: &[Contact<K>]) -> K {
    contacts.iter().fold(K::default(), |sum, c| sum + c.passes)
}

/// Depth between two cells, at least, times 1.5: light crosses thin ones as fast as it will.
const LEAST_DEPTH: f32 = 0.05;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bounce::blocks::tests::uneven;
    use crate::math::sampling::{hash, unit2};

    fn product(a: &[Light], b: &[Light]) -> f64 {
        let of = |(a, b): (&Light, &Light)| (*a * *b).as_dvec3().element_sum();
        a.iter().zip(b).map(of).sum()
    }

    #[test]
    fn light_spreads_as_far_one_way_as_the_other_and_is_never_turned_round() {
        let blocks = uneven(1.0);
        let diffusion = Diffusion::<f32>::new(&blocks);
        assert!(diffusion.levels.len() >= 3);
        let [a, b] = [1, 2].map(|key| {
            let light = |i| Light::splat(unit2(hash(&[key, i as u64]))[0] - 0.5);
            (0..blocks.len()).map(light).collect::<Vec<_>>()
        });
        let [of_a, of_b] = [&a, &b].map(|v| diffusion.spread(v));
        let (there, back) = (product(&of_a, &b), product(&of_b, &a));
        let scale = (product(&of_a, &a) * product(&of_b, &b)).sqrt();
        assert!(product(&of_a, &a) > 0.0 && product(&of_b, &b) > 0.0);
        assert!(
            (there - back).abs() < 1e-4 * scale,
            "{there} {back} {scale}"
        );
    }

    #[test]
    fn cells_touch_each_other_and_all_of_a_level_have_the_depth_of_the_blocks() {
        let blocks = uneven(1.0);
        let levels = Diffusion::<f32>::new(&blocks).levels;
        let depth = |level: &Level<f32>| level.cells.iter().map(|c| c.depth).sum::<f32>();
        for level in &levels {
            assert!((depth(level) / depth(&levels[0]) - 1.0).abs() < 1e-4);
            for cell in 0..level.cells.len() {
                for contact in level.own(cell) {
                    let mut others = level.own(contact.cell as usize).iter();
                    let back = others.find(|c| c.cell as usize == cell).unwrap();
                    assert!((contact.passes / back.passes - 1.0).abs() < 1e-4);
                }
            }
        }
    }
}

//! Chosen vertices of a lattice, numbered, and values at them.

use crate::math::unflatten;

/// Vertices along an edge of a cube.
const CUBE_EDGE: usize = 4;

/// A set of vertices, each with a number that is found in two steps.
#[derive(Debug)]
pub struct SparseLattice {
    count: [usize; 3],
    bounds: [[usize; 3]; 2],
    cubes_along: [usize; 3],
    cubes: Vec<VertexCube>,
}

/// Four by four by four vertices.
#[derive(Clone, Copy, Debug, Default)]
struct VertexCube {
    /// A bit for each vertex that is in the set.
    chosen: u64,
    /// Number of the first of those.
    first: u32,
}

impl SparseLattice {
    /// The set of those of `count` vertices along each axis that `choose` names.
    pub fn new(count: [usize; 3], choose: impl FnOnce(&mut dyn FnMut([usize; 3]))) -> Self {
        let cubes_along = count.map(|n| n.div_ceil(CUBE_EDGE));
        let mut set = Self {
            count,
            bounds: [count, [0; 3]],
            cubes_along,
            cubes: vec![VertexCube::default(); cubes_along.iter().product()],
        };
        choose(&mut |v| {
            let (cube, bit) = set.place(v);
            set.cubes[cube].chosen |= 1 << bit;
            let [first, last] = &mut set.bounds;
            for (a, &c) in v.iter().enumerate() {
                first[a] = first[a].min(c);
                last[a] = last[a].max(c);
            }
        });
        let mut first = 0;
        for cube in &mut set.cubes {
            cube.first = first;
            first += cube.chosen.count_ones();
        }
        set
    }

    /// The cubes that hold any: their place among cubes, a bit for each vertex, and the number of
    /// the first.
    pub fn cubes(&self) -> impl Iterator<Item = ([usize; 3], u64, usize)> {
        let cubes = self.cubes.iter().enumerate().filter(|(_, c)| c.chosen != 0);
        cubes.map(|(i, c)| (unflatten(i, self.cubes_along), c.chosen, c.first as usize))
    }

    /// Vertices along each axis, chosen or not.
    pub fn count(&self) -> [usize; 3] {
        self.count
    }

    /// The first and the last of the set along each axis.
    pub fn bounds(&self) -> [[usize; 3]; 2] {
        self.bounds
    }

    /// Bytes of memory that the set takes.
    pub fn bytes(&self) -> usize {
        size_of_val(&*self.cubes)
    }

    /// How many are in the set.
    pub fn len(&self) -> usize {
        self.cubes
            .last()
            .map_or(0, |c| (c.first + c.chosen.count_ones()) as usize)
    }

    /// The number of a vertex, if it is in the set.
    #[inline]
    pub fn index(&self, v: [usize; 3]) -> Option<usize> {
        let (cube, bit) = self.place(v);
        let cube = &self.cubes[cube];
        let before = cube.chosen & ((1 << bit) - 1);
        (cube.chosen >> bit & 1 == 1).then(|| (cube.first + before.count_ones()) as usize)
    }

    /// All in the set, by their numbers.
    pub fn vertices(&self) -> impl Iterator<Item = [usize; 3]> {
        let cubes_along = self.cubes_along;
        let cubes = self.cubes.iter().enumerate();
        cubes.flat_map(move |(i, cube)| vertices_of(unflatten(i, cubes_along), cube.chosen))
    }

    #[inline]
    fn place(&self, [x, y, z]: [usize; 3]) -> (usize, usize) {
        let [nx, ny, _] = self.cubes_along;
        let cube = (z / CUBE_EDGE * ny + y / CUBE_EDGE) * nx + x / CUBE_EDGE;
        (
            cube,
            (z % CUBE_EDGE * CUBE_EDGE + y % CUBE_EDGE) * CUBE_EDGE + x % CUBE_EDGE,
        )
    }
}

/// The vertices of a cube whose bits are set.
fn vertices_of(cube: [usize; 3], chosen: u64) -> impl Iterator<Item = [usize; 3]> {
    let corner = cube.map(|c| c * CUBE_EDGE);
    let mut left = chosen;
    std::iter::from_fn(move || {
        let bit = (left != 0).then(|| left.trailing_zeros() as usize)?;
        left &= left - 1;
        let [x, y, z] = unflatten(bit, [CUBE_EDGE; 3]);
        Some([corner[0] + x, corner[1] + y, corner[2] + z])
    })
}

/// A value at each vertex of a set.
#[derive(Debug)]
pub struct SparseValues<T> {
    pub set: SparseLattice,
    /// By the numbers of the vertices.
    pub values: Vec<T>,
}

impl<T> SparseValues<T> {
    /// The value at a vertex, if it is in the set.
    #[inline]
    pub fn get(&self, v: [usize; 3]) -> Option<&T> {
        self.values.get(self.set.index(v)?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_count_the_chosen_vertices_in_order() {
        let chosen = |v: &[usize; 3]| (v[0] * 7 + v[1] * 3 + v[2]).is_multiple_of(5);
        let count = [9, 4, 6];
        let all = || {
            (0..count[2]).flat_map(move |z| {
                (0..count[1]).flat_map(move |y| (0..count[0]).map(move |x| [x, y, z]))
            })
        };
        let set = SparseLattice::new(count, |choose| all().filter(chosen).for_each(choose));
        let listed: Vec<_> = set.vertices().collect();
        assert_eq!(listed.len(), all().filter(chosen).count());
        assert_eq!(listed.len(), set.len());
        for v in all() {
            let at = listed.iter().position(|l| *l == v);
            assert_eq!(set.index(v), at, "{v:?}");
            assert_eq!(at.is_some(), chosen(&v));
        }
    }
}

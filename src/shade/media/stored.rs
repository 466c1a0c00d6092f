//! Light at vertices that was made beforehand: from and to files of scattered light.

use super::direct::{self, Vertex};
use super::filled;
use super::sparse::SparseValues;
use super::sweep::{self, Sweep};
use crate::light::MediumLight;
use crate::math::Rgb;
use crate::run::Job;
use crate::scene::{Grid, Volume};
use crate::shade::view::{Seen, View};
use crate::{Error, Result};
use glam::Vec3;
use lvox_formats::{
    BlockKind, CLUSTER_EDGE, ClusterId, MappedFile, Scatter, ScatterWriter, VertexCluster,
};
use lvox_formats::{CLUSTER_CUBES, CUBE_EDGE, FormatError};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::sync::OnceLock;

/// Light at vertices of one volume, to be kept.
#[derive(Debug, Default)]
pub struct Made {
    pub direct: direct::Levels,
    pub indirect: sweep::Levels,
}

/// Light at vertices of one volume, as it was kept. A part is decoded when a ray first asks for one
/// of its vertices.
#[derive(Debug)]
pub struct Lit<'a> {
    scatter: &'a Scatter<MappedFile>,
    direct: [Option<Level<Vertex>>; direct::LEVELS],
    indirect: [Option<Level<Rgb>>; sweep::LEVELS],
    /// The first part that could not be decoded.
    failure: OnceLock<FormatError>,
}

/// Parts of one lattice.
#[derive(Debug)]
struct Level<T> {
    parts_along: [usize; 3],
    /// By place, x first.
    parts: Vec<Option<(usize, OnceLock<Values<T>>)>>,
}

/// Values at the vertices of a part.
#[derive(Debug)]
struct Values<T> {
    /// By cube, a bit for each vertex that has a value, and the number of the first.
    cubes: Vec<(u64, u32)>,
    values: Vec<T>,
}

/// Cubes along an edge of a part.
const CUBES: usize = CLUSTER_EDGE / CUBE_EDGE;

impl<'a> Lit<'a> {
    /// Finds what may matter of a volume, by its number in the scene, which must be that of the
    /// file, and checks its bytes.
    ///
    /// # Errors
    /// Damage; if cancelled.
    pub fn open(
        scatter: &'a Scatter<MappedFile>,
        index: usize,
        view: &View,
        seen: Seen,
        job: &Job,
    ) -> Result<Self> {
        let volume = &view.tracer.scene.volumes[index];
        let parts = |kind| {
            let matters =
                |place: &ClusterId| view.may_matter(seen, Sweep::MARGIN, hull(volume, place));
            let parts = scatter.clusters(kind, index).filter(|(_, p)| matters(p));
            parts.collect::<Vec<_>>()
        };
        let (direct, indirect) = (parts(BlockKind::Direct), parts(BlockKind::Indirect));
        direct.par_iter().chain(&indirect).try_for_each(|(i, _)| {
            job.cancel.check()?;
            Ok::<(), Error>(scatter.check_cluster(*i)?)
        })?;
        let grid = &volume.sigma_t;
        Ok(Self {
            scatter,
            direct: std::array::from_fn(|level| Level::new(&direct, grid, level)),
            indirect: std::array::from_fn(|level| Level::new(&indirect, grid, level)),
            failure: OnceLock::new(),
        })
    }

    /// Direct light at a vertex, if it was kept.
    #[inline]
    pub fn direct(&self, level: usize, v: [usize; 3]) -> Option<&Vertex> {
        let value = |share, rest| Vertex::new(MediumLight { share, rest });
        self.direct[level]
            .as_ref()?
            .get(v, |i| self.decode(i, value))
    }

    /// Mean over the sphere of the gathered radiance at a vertex, if it was kept.
    #[inline]
    pub fn indirect(&self, level: usize, v: [usize; 3]) -> Option<Rgb> {
        let level = self.indirect[level].as_ref()?;
        level.get(v, |i| self.decode(i, |_, light| light)).copied()
    }

    /// An error if any part could not be decoded so far; rays found its light themselves.
    ///
    /// # Errors
    /// The first of them.
    pub fn check(&self) -> Result<()> {
        let failure = self.failure.get();
        failure.map_or(Ok(()), |e| Err(Error::input(e.to_string())))
    }

    /// A part; `value` makes values of the share and of the rest of the light.
    #[cold]
    fn decode<T>(&self, i: usize, value: impl Fn(Rgb, Rgb) -> T) -> Values<T> {
        let part = self.scatter.cluster(i).unwrap_or_else(|e| {
            let _ = self.failure.set(e);
            VertexCluster::default()
        });
        let mut first = 0;
        let cube = |&chosen: &u64| {
            let cube = (chosen, first);
            first += chosen.count_ones();
            cube
        };
        let of = |values: &[[f32; 3]], i: usize| values.get(i).map_or(Rgb::BLACK, |c| Rgb(*c));
        let values = (0..part.len()).map(|i| value(of(&part.share, i), of(&part.light, i)));
        Values {
            values: values.collect(),
            cubes: part.chosen.iter().map(cube).collect(),
        }
    }
}

impl<T> Level<T> {
    /// Those of parts that have a level.
    fn new(parts: &[(usize, ClusterId)], grid: &Grid, level: usize) -> Option<Self> {
        let count = filled::vertices_along(grid, 1 << level);
        let parts_along = count.map(|n| n.div_ceil(CLUSTER_EDGE));
        let mut here = parts
            .iter()
            .filter(|(_, p)| usize::from(p.level) == level)
            .peekable();
        here.peek()?;
        let all = parts_along.iter().product();
        let mut found = Self {
            parts_along,
            parts: std::iter::repeat_with(|| None).take(all).collect(),
        };
        for (i, place) in here {
            let at = found.at(place.first());
            found.parts[at] = Some((*i, OnceLock::new()));
        }
        Some(found)
    }

    /// Where the part of a vertex is among all.
    #[inline]
    fn at(&self, v: [usize; 3]) -> usize {
        let [x, y, z] = v.map(|c| c / CLUSTER_EDGE);
        let [nx, ny, _] = self.parts_along;
        (z * ny + y) * nx + x
    }

    #[inline]
    fn get(&self, v: [usize; 3], decode: impl Fn(usize) -> Values<T>) -> Option<&T> {
        let (i, values) = self.parts.get(self.at(v))?.as_ref()?;
        let Values { cubes, values } = values.get_or_init(|| decode(*i));
        let [cx, cy, cz] = v.map(|c| c % CLUSTER_EDGE / CUBE_EDGE);
        let [x, y, z] = v.map(|c| c % CUBE_EDGE);
        let (chosen, first) = *cubes.get((cz * CUBES + cy) * CUBES + cx)?;
        let bit = (z * CUBE_EDGE + y) * CUBE_EDGE + x;
        let before = (chosen & ((1 << bit) - 1)).count_ones();
        (chosen >> bit & 1 == 1).then(|| values.get((first + before) as usize))?
    }
}

/// The corners of the cells around the vertices of a part, in scene space.
fn hull(volume: &Volume, place: &ClusterId) -> [Vec3; 8] {
    let step = (1 << place.level) as f32;
    let first = Vec3::from(place.first().map(|c| c as f32)) - 1.0;
    std::array::from_fn(|i| {
        let end = Vec3::from(std::array::from_fn(|a| (i >> a & 1) as f32));
        let at = (first + end * (CLUSTER_EDGE as f32 + 1.0)) * step;
        let in_scene = volume.scene_from_index.transform_point3(at.as_dvec3());
        in_scene.as_vec3()
    })
}

/// Appends the light of a volume to a file.
///
/// # Errors
/// Light that 32-bit floats cannot hold, or a file that cannot be written.
pub fn pack(made: &Made, volume: usize, writer: &mut ScatterWriter) -> Result<()> {
    for (level, lit) in made.direct.iter().enumerate() {
        let parts = parts(lit, volume, level, |vertex| {
            [vertex.light.share, vertex.light.rest]
        });
        write(BlockKind::Direct, parts, writer)?;
    }
    for (level, lit) in made.indirect.iter().enumerate() {
        let parts = parts(lit, volume, level, |light| {
            [Rgb::BLACK, light.unwrap_or_default()]
        });
        write(BlockKind::Indirect, parts, writer)?;
    }
    Ok(())
}

type Parts = BTreeMap<ClusterId, VertexCluster>;

/// Vertices in parts; `light` gives share and rest of their light.
fn parts<T>(
    lit: &Option<SparseValues<T>>,
    volume: usize,
    level: usize,
    light: impl Fn(&T) -> [Rgb; 2],
) -> Parts {
    let mut parts = Parts::new();
    let Some(SparseValues { set, values }) = lit else {
        return parts;
    };
    for (cube, chosen, first) in set.cubes() {
        let [x, y, z] = cube.map(|c| (c / CUBES) as u16);
        let place = ClusterId {
            volume: volume as u16,
            level: level as u8,
            zyx: [z, y, x],
        };
        let part = parts.entry(place).or_insert_with(|| VertexCluster {
            chosen: vec![0; CLUSTER_CUBES],
            ..VertexCluster::default()
        });
        let [x, y, z] = cube.map(|c| c % CUBES);
        part.chosen[(z * CUBES + y) * CUBES + x] = chosen;
        for value in &values[first..first + chosen.count_ones() as usize] {
            let [share, rest] = light(value);
            part.share.push(rounded(share));
            part.light.push(rounded(rest));
        }
    }
    for part in parts.values_mut() {
        for values in [&mut part.share, &mut part.light] {
            if values.iter().all(|c| *c == [0.0; 3]) {
                values.clear();
            }
        }
    }
    parts
}

fn write(kind: BlockKind, parts: Parts, writer: &mut ScatterWriter) -> Result<()> {
    for (place, part) in &parts {
        writer.push(kind, *place, part)?;
    }
    Ok(())
}

/// Light to 12 bits behind the binary point, off by 2^-13 at most: what it has of noise is more,
/// and zeros take no space.
fn rounded(light: Rgb) -> [f32; 3] {
    const DROPPED: u32 = 23 - 12;
    light.0.map(|v| {
        let bits = v.to_bits().saturating_add(1 << (DROPPED - 1)) >> DROPPED << DROPPED;
        f32::from_bits(bits).min(f32::MAX)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::sampling;
    use crate::shade::media::sparse::SparseLattice;

    #[test]
    fn rounding_is_small_and_keeps_what_floats_hold() {
        for i in 0..1000 {
            let v = f32::from_bits((sampling::hash(&[i]) as u32) >> 1);
            if v.is_finite() {
                let [r, ..] = rounded(Rgb::splat(v));
                let most = (v / 8192.0).max(f32::MIN_POSITIVE / 8192.0);
                assert!((r - v).abs() <= most, "{v} {r}");
            }
        }
        for v in [0.0, 1.0, 0.5] {
            assert_eq!(rounded(Rgb::splat(v)), [v; 3]);
        }
        assert!(rounded(Rgb::splat(f32::MAX))[0].is_finite());
    }

    #[test]
    fn vertices_find_their_values_in_the_parts_of_a_lattice() {
        let count = [40, 70, 9];
        let all = || {
            (0..count[2]).flat_map(move |z| {
                (0..count[1]).flat_map(move |y| (0..count[0]).map(move |x| [x, y, z]))
            })
        };
        let chosen = |v: &[usize; 3]| (v[0] * 5 + v[1] * 3 + v[2]).is_multiple_of(7);
        let value = |[x, y, z]: [usize; 3]| Rgb([x as f32, y as f32, 0.5 + z as f32]);
        let set = SparseLattice::new(count, |choose| all().filter(chosen).for_each(choose));
        let values = set.vertices().map(value).collect();
        let parts = parts(&Some(SparseValues { set, values }), 3, 1, |v| {
            [Rgb::BLACK, *v]
        });
        assert_eq!(parts.len(), 2 * 3);
        let mut found = 0;
        for (place, part) in &parts {
            assert_eq!((place.volume, place.level), (3, 1));
            assert!(part.share.is_empty());
            let mut light = part.light.iter();
            for (i, &bits) in part.chosen.iter().enumerate() {
                let corner = [i % CUBES, i / CUBES % CUBES, i / (CUBES * CUBES)];
                for bit in (0..64).filter(|b| bits >> b & 1 == 1) {
                    let within = [bit % 4, bit / 4 % 4, bit / 16];
                    let first = place.first();
                    let v = std::array::from_fn(|a| first[a] + 4 * corner[a] + within[a]);
                    assert!(chosen(&v));
                    assert_eq!(light.next(), Some(&value(v).0), "{v:?}");
                    found += 1;
                }
            }
            assert!(light.next().is_none());
        }
        assert_eq!(found, all().filter(chosen).count());
    }
}

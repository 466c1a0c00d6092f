//! Light at vertices that was made beforehand: from and to files of scattered light.

use super::direct::{self, Vertex};
use super::filled;
use super::sparse::{SparseLattice, SparseValues};
use super::sweep::{self, Sweep};
use crate::Result;
use crate::light::InMedium;
use crate::math::Rgb;
use crate::run::Job;
use crate::scene::Volume;
use crate::shade::memory;
use crate::shade::view::{Seen, View};
use glam::Vec3;
use lvox_formats::{BlockKind, MappedFile, PART_EDGE, Part, PartPlace, Scatter, ScatterWriter};
use lvox_formats::{PART_CUBES, VERTEX_CUBE};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Light at vertices of one volume.
#[derive(Debug, Default)]
pub struct Lit {
    pub direct: direct::Levels,
    pub indirect: sweep::Levels,
}

/// Cubes along an edge of a part.
const CUBES: usize = PART_EDGE / VERTEX_CUBE;

impl Lit {
    /// Reads what may matter of a volume, by its number in the scene, which must be that of the file.
    ///
    /// # Errors
    /// Damage; more vertices than the memory limit allows; if cancelled.
    pub fn read(
        scatter: &Scatter<MappedFile>,
        index: usize,
        view: &View,
        seen: Seen,
        job: &Job,
    ) -> Result<Self> {
        let volume = &view.tracer.scene.volumes[index];
        let parts = |kind| {
            let parts = scatter.parts(kind, index);
            let matters =
                |place: &PartPlace| view.may_matter(seen, Sweep::MARGIN, hull(volume, place));
            parts
                .filter(|(_, place)| matters(place))
                .collect::<Vec<_>>()
        };
        let (direct, indirect) = (parts(BlockKind::Direct), parts(BlockKind::Indirect));
        let vertices = |parts: &[(usize, PartPlace)]| {
            let records = parts
                .iter()
                .map(|(i, _)| u64::from(scatter.blocks()[*i].records));
            records.sum::<u64>()
        };
        let [of_direct, of_indirect] = [&direct, &indirect].map(|parts| vertices(parts));
        let bytes =
            of_direct * size_of::<Vertex>() as u64 + of_indirect * size_of::<Option<Rgb>>() as u64;
        memory::check_scattered(
            volume,
            seen,
            of_direct + of_indirect,
            bytes,
            job.memory_limit,
        )?;
        let read = Reading {
            scatter,
            volume,
            job,
        };
        Ok(Self {
            direct: read.levels(&direct, |share, rest| Vertex::new(InMedium { share, rest }))?,
            indirect: read.levels(&indirect, |_, light| Some(light))?,
        })
    }
}

/// The corners of the cells around the vertices of a part, in scene space.
fn hull(volume: &Volume, place: &PartPlace) -> [Vec3; 8] {
    let step = (1 << place.level) as f32;
    let first = Vec3::from(place.first().map(|c| c as f32)) - 1.0;
    std::array::from_fn(|i| {
        let end = Vec3::from(std::array::from_fn(|a| (i >> a & 1) as f32));
        let at = (first + end * (PART_EDGE as f32 + 1.0)) * step;
        let in_scene = volume.scene_from_index.transform_point3(at.as_dvec3());
        in_scene.as_vec3()
    })
}

/// Parts of one volume, and what to do with them.
struct Reading<'a> {
    scatter: &'a Scatter<MappedFile>,
    volume: &'a Volume,
    job: &'a Job,
}

impl Reading<'_> {
    /// Values at the vertices of parts, by level; `value` makes them of the share and of the rest of the light.
    fn levels<T: Clone + Send + Sync, const N: usize>(
        &self,
        parts: &[(usize, PartPlace)],
        value: impl Fn(Rgb, Rgb) -> T + Sync,
    ) -> Result<[Option<SparseValues<T>>; N]> {
        let decoded = parts
            .par_iter()
            .map(|&(i, place)| {
                self.job.cancel.check()?;
                let part = self.scatter.part(i)?;
                let of =
                    |values: &[[f32; 3]], i: usize| values.get(i).map_or(Rgb::BLACK, |c| Rgb(*c));
                let values = (0..part.len()).map(|i| value(of(&part.share, i), of(&part.light, i)));
                Ok((place, values.collect::<Vec<T>>(), part.chosen))
            })
            .collect::<Result<Vec<_>>>()?;
        Ok(std::array::from_fn(|level| {
            let here = || (decoded.iter()).filter(|(place, ..)| usize::from(place.level) == level);
            here().next()?;
            let count = filled::vertices_along(&self.volume.sigma_t, 1 << level);
            let cubes = here().flat_map(|(place, _, chosen)| {
                let cubes = chosen.iter().enumerate();
                cubes.map(|(i, &chosen)| (cube_of(place, i), chosen))
            });
            let set = SparseLattice::of_cubes(count, cubes.clone());
            // Cubes are numbered alike in parts and in the set, but parts are not in the order of all cubes.
            let mut order: Vec<([usize; 3], &[T])> = Vec::new();
            for (place, values, chosen) in here() {
                let mut rest = &values[..];
                for (i, chosen) in chosen.iter().enumerate().filter(|(_, c)| **c != 0) {
                    let (own, others) = rest.split_at(chosen.count_ones() as usize);
                    order.push((cube_of(place, i), own));
                    rest = others;
                }
            }
            order.sort_unstable_by_key(|([x, y, z], _)| [*z, *y, *x]);
            let values = order
                .iter()
                .flat_map(|(_, own)| own.iter().cloned())
                .collect();
            Some(SparseValues { set, values })
        }))
    }
}

/// Where a cube of a part is among the cubes of its lattice.
fn cube_of(place: &PartPlace, i: usize) -> [usize; 3] {
    let first = place.first().map(|c| c / VERTEX_CUBE);
    let at = [i % CUBES, i / CUBES % CUBES, i / (CUBES * CUBES)];
    std::array::from_fn(|a| first[a] + at[a])
}

/// Appends the light of a volume to a file.
///
/// # Errors
/// Light that 32-bit floats cannot hold, or a file that cannot be written.
pub fn pack(lit: &Lit, volume: usize, writer: &mut ScatterWriter) -> Result<()> {
    for (level, lit) in lit.direct.iter().enumerate() {
        let parts = parts(lit, volume, level, |vertex| {
            [vertex.light.share, vertex.light.rest]
        });
        write(BlockKind::Direct, parts, writer)?;
    }
    for (level, lit) in lit.indirect.iter().enumerate() {
        let parts = parts(lit, volume, level, |light| {
            [Rgb::BLACK, light.unwrap_or_default()]
        });
        write(BlockKind::Indirect, parts, writer)?;
    }
    Ok(())
}

type Parts = BTreeMap<PartPlace, Part>;

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
        let place = PartPlace {
            volume: volume as u16,
            level: level as u8,
            zyx: [z, y, x],
        };
        let part = parts.entry(place).or_insert_with(|| Part {
            chosen: vec![0; PART_CUBES],
            ..Part::default()
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

/// Light to 12 bits behind the binary point, off by 2^-13 at most: what it has of noise is more, and zeros take no space.
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
                let cube = SparseLattice::of_cubes(count, [(cube_of(place, i), bits)]);
                for v in cube.vertices() {
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

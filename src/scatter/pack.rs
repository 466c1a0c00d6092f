//! Light at vertices, packed into the clusters of a file of scattered light.

use crate::Result;
use crate::inscatter::{SparseValues, VolumeLight};
use crate::math::Rgb;
use lvox_formats::{
    BlockKind, CLUSTER_CUBES, CLUSTER_EDGE, CUBE_EDGE, ClusterId, ScatterWriter, VertexCluster,
};
use std::collections::BTreeMap;

/// Cubes along an edge of a cluster.
const CUBES_ALONG_CLUSTER: usize = CLUSTER_EDGE / CUBE_EDGE;

/// Appends the light of a volume to a file.
///
/// # Errors
/// Light that 32-bit floats cannot hold, or a file that cannot be written.
pub fn pack(made: &VolumeLight, volume: usize, writer: &mut ScatterWriter) -> Result<()> {
    for (level, lit) in made.direct.iter().enumerate() {
        let clusters = clusters(lit, volume, level, |vertex| {
            [vertex.light.share, vertex.light.rest]
        });
        write(BlockKind::Direct, clusters, writer)?;
    }
    for (level, lit) in made.indirect.iter().enumerate() {
        let clusters = clusters(lit, volume, level, |light| {
            [Rgb::BLACK, light.unwrap_or_default()]
        });
        write(BlockKind::Indirect, clusters, writer)?;
    }
    Ok(())
}

type Clusters = BTreeMap<ClusterId, VertexCluster>;

/// Vertices in clusters; `light` gives share and rest of their light.
fn clusters<T>(
    lit: &Option<SparseValues<T>>,
    volume: usize,
    level: usize,
    light: impl Fn(&T) -> [Rgb; 2],
) -> Clusters {
    let mut clusters = Clusters::new();
    let Some(SparseValues { set, values }) = lit else {
        return clusters;
    };
    for (cube, chosen, first) in set.cubes() {
        let [x, y, z] = cube.map(|c| (c / CUBES_ALONG_CLUSTER) as u16);
        let place = ClusterId {
            volume: volume as u16,
            level: level as u8,
            zyx: [z, y, x],
        };
        let cluster = clusters.entry(place).or_insert_with(|| VertexCluster {
            chosen: vec![0; CLUSTER_CUBES],
            ..VertexCluster::default()
        });
        let [x, y, z] = cube.map(|c| c % CUBES_ALONG_CLUSTER);
        cluster.chosen[(z * CUBES_ALONG_CLUSTER + y) * CUBES_ALONG_CLUSTER + x] = chosen;
        for value in &values[first..first + chosen.count_ones() as usize] {
            let [share, rest] = light(value);
            cluster.share.push(rounded(share));
            cluster.light.push(rounded(rest));
        }
    }
    for cluster in clusters.values_mut() {
        for values in [&mut cluster.share, &mut cluster.light] {
            if values.iter().all(|c| *c == [0.0; 3]) {
                values.clear();
            }
        }
    }
    clusters
}

fn write(kind: BlockKind, clusters: Clusters, writer: &mut ScatterWriter) -> Result<()> {
    for (place, cluster) in &clusters {
        writer.push(kind, *place, cluster)?;
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
    use crate::inscatter::sparse::SparseLattice;
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
        let clusters = clusters(&Some(SparseValues { set, values }), 3, 1, |v| {
            [Rgb::BLACK, *v]
        });
        assert_eq!(clusters.len(), 2 * 3);
        let mut found = 0;
        for (place, cluster) in &clusters {
            assert_eq!((place.volume, place.level), (3, 1));
            assert!(cluster.share.is_empty());
            let mut light = cluster.light.iter();
            for (i, &bits) in cluster.chosen.iter().enumerate() {
                let corner = [
                    i % CUBES_ALONG_CLUSTER,
                    i / CUBES_ALONG_CLUSTER % CUBES_ALONG_CLUSTER,
                    i / (CUBES_ALONG_CLUSTER * CUBES_ALONG_CLUSTER),
                ];
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

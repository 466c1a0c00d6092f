//! Light at vertices that was made beforehand, read from a file.

use super::direct::{DIRECT_LEVELS, Vertex};
use super::occupied;
use super::sweep::{SWEPT_LEVELS, Sweep};
use crate::light::MediumLight;
use crate::math::Rgb;
use crate::run::Job;
use crate::scene::{Grid, Scene, Volume};
use crate::view::{View, VisibleMedia};
use crate::{Error, Result};
use glam::{DAffine3, DVec3, Vec3};
use lvox_formats::record::VolumeInfo;
use lvox_formats::{
    BlockKind, CLUSTER_EDGE, CUBE_EDGE, ClusterId, FormatError, MappedFile, Scatter, VertexCluster,
};
use rayon::prelude::*;
use std::sync::OnceLock;

/// Light at vertices of one volume, as it was kept. A cluster is decoded when a ray first asks for
/// one of its vertices.
#[derive(Debug)]
pub struct ScatteredLight<'a> {
    scatter: &'a Scatter<MappedFile>,
    direct: [Option<ScatteredLevel<Vertex>>; DIRECT_LEVELS],
    indirect: [Option<ScatteredLevel<Rgb>>; SWEPT_LEVELS],
    /// The first cluster that could not be decoded.
    failure: OnceLock<FormatError>,
}

/// Clusters of one lattice.
#[derive(Debug)]
struct ScatteredLevel<T> {
    clusters_along: [usize; 3],
    /// By place, x first.
    clusters: Vec<Option<(usize, OnceLock<ClusterValues<T>>)>>,
}

/// Values at the vertices of a cluster.
#[derive(Debug)]
struct ClusterValues<T> {
    /// By cube, a bit for each vertex that has a value, and the number of the first.
    cubes: Vec<(u64, u32)>,
    values: Vec<T>,
}

/// Cubes along an edge of a cluster.
const CUBES_ALONG_CLUSTER: usize = CLUSTER_EDGE / CUBE_EDGE;

impl<'a> ScatteredLight<'a> {
    /// Finds what may matter of a volume, by its number in the scene, which must be that of the
    /// file, and checks its bytes.
    ///
    /// # Errors
    /// Damage; if cancelled.
    pub fn open(
        scatter: &'a Scatter<MappedFile>,
        index: usize,
        view: &View,
        visible: VisibleMedia,
        job: &Job,
    ) -> Result<Self> {
        let volume = &view.tracer.volumes[index];
        let clusters = |kind| {
            let matters = |place: &ClusterId| {
                view.may_matter(visible, Sweep::MARGIN_PIXELS, hull(volume, place))
            };
            let clusters = scatter.clusters(kind, index).filter(|(_, p)| matters(p));
            clusters.collect::<Vec<_>>()
        };
        let (direct, indirect) = (clusters(BlockKind::Direct), clusters(BlockKind::Indirect));
        direct.par_iter().chain(&indirect).try_for_each(|(i, _)| {
            job.cancel.check()?;
            Ok::<(), Error>(scatter.check_cluster(*i)?)
        })?;
        let grid = &volume.sigma_t;
        Ok(Self {
            scatter,
            direct: std::array::from_fn(|level| ScatteredLevel::new(&direct, grid, level)),
            indirect: std::array::from_fn(|level| ScatteredLevel::new(&indirect, grid, level)),
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

    /// An error if any cluster could not be decoded so far; rays found its light themselves.
    ///
    /// # Errors
    /// The first of them.
    pub fn check(&self) -> Result<()> {
        let failure = self.failure.get();
        failure.map_or(Ok(()), |e| Err(Error::input(e.to_string())))
    }

    /// A cluster; `value` makes values of the share and of the rest of the light.
    #[cold]
    fn decode<T>(&self, i: usize, value: impl Fn(Rgb, Rgb) -> T) -> ClusterValues<T> {
        let cluster = self.scatter.cluster(i).unwrap_or_else(|e| {
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
        let values =
            (0..cluster.len()).map(|i| value(of(&cluster.share, i), of(&cluster.light, i)));
        ClusterValues {
            values: values.collect(),
            cubes: cluster.chosen.iter().map(cube).collect(),
        }
    }
}

impl<T> ScatteredLevel<T> {
    /// The clusters of a level, if there are any.
    fn new(clusters: &[(usize, ClusterId)], grid: &Grid, level: usize) -> Option<Self> {
        let count = occupied::vertices_along(grid, 1 << level);
        let clusters_along = count.map(|n| n.div_ceil(CLUSTER_EDGE));
        let mut here = clusters
            .iter()
            .filter(|(_, p)| usize::from(p.level) == level)
            .peekable();
        here.peek()?;
        let all = clusters_along.iter().product();
        let mut found = Self {
            clusters_along,
            clusters: std::iter::repeat_with(|| None).take(all).collect(),
        };
        for (i, place) in here {
            let at = found.at(place.first());
            found.clusters[at] = Some((*i, OnceLock::new()));
        }
        Some(found)
    }

    /// Where the cluster of a vertex is among all.
    #[inline]
    fn at(&self, v: [usize; 3]) -> usize {
        let [x, y, z] = v.map(|c| c / CLUSTER_EDGE);
        let [nx, ny, _] = self.clusters_along;
        (z * ny + y) * nx + x
    }

    #[inline]
    fn get(&self, v: [usize; 3], decode: impl Fn(usize) -> ClusterValues<T>) -> Option<&T> {
        let (i, values) = self.clusters.get(self.at(v))?.as_ref()?;
        let ClusterValues { cubes, values } = values.get_or_init(|| decode(*i));
        let [cx, cy, cz] = v.map(|c| c % CLUSTER_EDGE / CUBE_EDGE);
        let [x, y, z] = v.map(|c| c % CUBE_EDGE);
        let (chosen, first) =
            *cubes.get((cz * CUBES_ALONG_CLUSTER + cy) * CUBES_ALONG_CLUSTER + cx)?;
        let bit = (z * CUBE_EDGE + y) * CUBE_EDGE + x;
        let before = (chosen & ((1 << bit) - 1)).count_ones();
        (chosen >> bit & 1 == 1).then(|| values.get((first + before) as usize))?
    }
}

/// The corners of the cells around the vertices of a cluster, in scene space.
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

/// Refuses volumes of a file that are not those of a scene, on whose grids vertices stand.
///
/// # Errors
/// Lists the volumes of both.
pub fn check_volumes(found: &[VolumeInfo], scene: &Scene) -> Result<()> {
    let volumes = &scene.volumes;
    if volumes.len() == found.len()
        && volumes
            .iter()
            .zip(found)
            .all(|(v, info)| is_grid_of(info, v))
    {
        return Ok(());
    }
    let list = |volumes: Vec<String>| match volumes[..] {
        [] => "none".to_owned(),
        _ => volumes.join(", "),
    };
    let text = |name: &str, dims: &dyn std::fmt::Debug| format!("{name:?} of {dims:?} voxels");
    let expected = volumes.iter().map(|v| text(&v.name, &v.sigma_t.dims()));
    let found = found.iter().map(|v| text(&v.name, &v.dims));
    Err(Error::input(format!(
        "expected the light of the scene's volumes at their places ({}), found that of others ({})",
        list(expected.collect()),
        list(found.collect())
    )))
}

/// Refuses a tree of grey media for a scene whose media have colour: kernels are chosen by the
/// tree.
///
/// # Errors
/// Says so.
pub fn check_colors(found: &[VolumeInfo], scene: &Scene) -> Result<()> {
    match scene.volumes.iter().all(Volume::is_grey) || !found.iter().all(VolumeInfo::is_grey) {
        true => Ok(()),
        false => Err(Error::input(
            "expected a tree of media whose extinction differs by channel, found one of grey media",
        )
        .hint("bake the scene and build its tree again")),
    }
}

/// Whether a volume is a grid of as many voxels in the same place, but for the rounding of a scene
/// whose frame was another.
fn is_grid_of(info: &VolumeInfo, volume: &Volume) -> bool {
    /// In voxels.
    const ROUNDING: f64 = 1e-3;
    let dims = volume.sigma_t.dims().map(|n| n as u32);
    let index_from_scene = DAffine3::from_cols_array_2d(&info.index_from_scene);
    let difference = index_from_scene * volume.scene_from_index;
    let is_kept = |i: u32| {
        let corner = DVec3::from(std::array::from_fn(|a| f64::from((i >> a & 1) * dims[a])));
        let off = difference.transform_point3(corner) - corner;
        off.abs().max_element() < ROUNDING
    };
    info.dims == dims && (0..8).all(is_kept)
}

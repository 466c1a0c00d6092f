//! The sweep of a volume without surfaces in it, or other media but on its own grid: all vertices
//! at once, layer by layer of cells.

use super::cells::{SourceCells, SourceLayers, Towards, VertexLayers};

use super::rows::Arriving;
use super::weights::{Look, ScatteringWeights};
use super::{MediaBox, SweepScope};
use crate::Result;
use crate::inscatter::counts;
use crate::inscatter::far_field::Surroundings;
use crate::inscatter::gatherer::GatherInMedia;
use crate::inscatter::sparse::{SparseLattice, SparseValues};
use crate::math::ray_lattice::RayLattice;
use crate::math::{Rgb, Spectrum};
use crate::scene::Volume;
use glam::Vec3;
use rayon::prelude::*;

/// The media of one grid on cells, through which parallel rays go all at once.
pub struct LayeredSweep<'a, G> {
    scope: &'a SweepScope<'a, G>,
    cells: SourceCells,
    weights: Option<ScatteringWeights>,
}

/// What arrives along one direction at the vertices of each set.
type AtSets<K> = Vec<Vec<Arriving<K>>>;

/// Vertices of one spacing, and what has arrived there.
struct LitVertices<'a> {
    step: usize,
    set: SparseLattice,
    surroundings: Vec<Option<Surroundings<'a>>>,
    looks: Vec<Look>,
    sums: Vec<Rgb>,
}

impl<'a, G: GatherInMedia> LayeredSweep<'a, G> {
    /// Directions along one axis that are passed together.
    const DIRECTIONS_TOGETHER: usize = 8;

    /// Whether there is no more in the box of a volume than itself, and media of the same grid if
    /// it is thin: its extinction is at most `densest` where it is swept.
    pub fn is_for(scope: &SweepScope<G>, media: &MediaBox, densest: f32) -> bool {
        /// Optical depth of a cell. Deep bone on cells of two voxels is 2 % too dark.
        const THIN: f32 = 0.7;
        let is_alone = match &scope.view.tracer.scene.volumes[..] {
            [_] => true,
            [first, others @ ..] => {
                let adds = |v: &Volume| v.phase.is_isotropic() && v.adds_to(first);
                let cell = SourceCells::edge(scope.volume) as f32;
                let deepest = densest * scope.volume.longest_voxel_edge() * cell;
                first.phase.is_isotropic() && others.iter().all(adds) && deepest <= THIN
            }
            [] => false,
        };
        is_alone
            && !media.has_walls
            && SourceCells::are_enough(scope.volume)
            && scope.gatherer.lvoxel_dims(0).is_some()
    }

    /// Whether the light of vertices so far apart may be found on cells.
    pub fn serves(scope: &SweepScope<G>, step: usize) -> bool {
        step >= SourceCells::edge(scope.volume)
    }

    /// Bytes that sweeping sets of so many vertices in all takes.
    pub fn bytes(scope: &SweepScope<G>, coarsest: usize, vertices: u64) -> u64 {
        let held = Self::DIRECTIONS_TOGETHER * size_of::<Arriving<G::Share>>();
        let a_vertex =
            size_of::<Option<Surroundings>>() + size_of::<Rgb>() + size_of::<Look>() + held;
        SourceCells::bytes(scope.volume, coarsest, Self::DIRECTIONS_TOGETHER)
            + vertices * a_vertex as u64
    }

    /// The media, for vertices at most so many voxels apart; `None` if their lvoxels stand on
    /// another grid.
    pub fn new(scope: &'a SweepScope<'a, G>, coarsest: usize) -> Option<Self> {
        let volumes = scope.view.tracer.volumes.len();
        let cells = SourceCells::new(scope.gatherer, volumes, scope.volume, coarsest)?;
        let (phase, field) = (scope.volume.phase, scope.far_field);
        let unsharpened = || ScatteringWeights::unsharpened(phase, field);
        let (cells, weights) = match cells.tell_single().then(unsharpened).flatten() {
            Some(once) => (cells.seen_in(once), unsharpened()),
            None => (cells, ScatteringWeights::new(phase, field)),
        };
        Some(Self {
            scope,
            cells,
            weights,
        })
    }

    /// Sweeps sets of vertices, each so many voxels apart.
    ///
    /// # Errors
    /// If cancelled.
    pub fn sweep(
        &self,
        sets: Vec<(usize, SparseLattice)>,
    ) -> Result<Vec<SparseValues<Option<Rgb>>>> {
        let scope = self.scope;
        let mut lit = sets
            .into_iter()
            .map(|(step, set)| self.unlit(step, set))
            .collect::<Result<Vec<_>>>()?;
        let directions = scope.far_field.quarters();
        let lattices: Vec<(u32, RayLattice)> = (0..directions)
            .map(|q| {
                let d = scope.volume.index_from_scene;
                let d = d.transform_vector3(scope.far_field.direction(q));
                (q, self.cells.lattice(d))
            })
            .collect();
        for main in 0..3 {
            let axes = [main, (main + 1) % 3, (main + 2) % 3];
            let of_axis: Vec<_> = lattices.iter().filter(|l| l.1.axes == axes).collect();
            if of_axis.is_empty() {
                continue;
            }
            let layers =
                (!self.cells.have_lobes()).then(|| self.cells.layers(axes, Towards::default()));
            let vertices: Vec<_> = lit
                .iter()
                .map(|l| VertexLayers::new(&l.set, l.step, &self.cells, axes))
                .collect();
            for together in of_axis.chunks(Self::DIRECTIONS_TOGETHER) {
                let arriving = self.pass(layers.as_ref(), together, &vertices)?;
                for ((q, _), arriving) in together.iter().zip(&arriving) {
                    for (lit, arriving) in lit.iter_mut().zip(arriving) {
                        let weight = |i| scope.weight(self.weights.as_ref(), lit.looks.get(i), *q);
                        add(&mut lit.sums, &lit.surroundings, *q, arriving, weight);
                    }
                }
            }
        }
        let scale = 1.0 / directions as f32;
        Ok(lit.into_iter().map(|lit| lit.values(scale)).collect())
    }

    /// What arrives along some directions at the vertices of each set; each has layers of its own
    /// if cells send more light some ways than others.
    fn pass(
        &self,
        layers: Option<&SourceLayers>,
        lattices: &[&(u32, RayLattice)],
        vertices: &[VertexLayers],
    ) -> Result<Vec<AtSets<G::Share>>> {
        let passed = lattices.par_iter().map(|(q, rays)| {
            self.scope.job.cancel.check()?;
            let (arriving, passed) = match layers {
                Some(layers) => layers.pass(rays, vertices),
                None => {
                    let field = self.scope.far_field;
                    let towards = Towards {
                        travel: -field.direction(*q),
                        row_and_column: field.row_and_column(*q),
                    };
                    self.cells.layers(rays.axes, towards).pass(rays, vertices)
                }
            };
            counts::add(&self.scope.counters.cells, passed);
            Ok(arriving)
        });
        passed.collect()
    }

    fn unlit(&self, step: usize, set: SparseLattice) -> Result<LitVertices<'a>> {
        let scope = self.scope;
        let vertices: Vec<[usize; 3]> = set.vertices().collect();
        counts::add(&scope.counters.swept, vertices.len() as u64);
        let to_index = |v: [usize; 3]| Vec3::from(v.map(|c| (c * step) as f32));
        let around = |&v: &[usize; 3]| {
            scope.job.cancel.check()?;
            let field = scope.far_field;
            Ok(field.around(scope.volume, scope.gatherer, to_index(v)))
        };
        let surroundings = vertices.par_iter().map(around).collect::<Result<_>>()?;
        let places = vertices.iter().map(|&v| to_index(v));
        Ok(LitVertices {
            step,
            set,
            surroundings,
            looks: scope.looks(self.weights.as_ref(), places),
            sums: vec![Rgb::BLACK; vertices.len()],
        })
    }
}

/// Adds what arrives in a quarter of a cell of the far field, as much of it as a vertex scatters.
fn add<K: Spectrum>(
    sums: &mut [Rgb],
    surroundings: &[Option<Surroundings>],
    quarter: u32,
    arriving: &[Arriving<K>],
    weight: impl Fn(usize) -> f32 + Sync,
) {
    let all = sums.par_iter_mut().zip(surroundings).zip(arriving);
    all.enumerate().for_each(|(i, ((sum, around), a))| {
        if let Some(around) = around {
            let weight = weight(i);
            *sum += a.radiance * weight;
            *sum += around.radiance_through(quarter, &[a.transmittance * weight]);
        }
    });
}

impl LitVertices<'_> {
    fn values(self, scale: f32) -> SparseValues<Option<Rgb>> {
        let values = self.sums.into_iter().zip(self.surroundings);
        SparseValues {
            set: self.set,
            values: values
                .map(|(sum, around)| around.map(|_| sum * scale))
                .collect(),
        }
    }
}

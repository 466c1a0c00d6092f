//! The lattices of one volume, before any ray asks for their light.

use super::bends::Bends;
use super::front::SeenFront;
use crate::Result;
use crate::inscatter::counts::Counters;
use crate::inscatter::density::Densities;
use crate::inscatter::direct::{DIRECT_LEVELS, Vertex};
use crate::inscatter::far_field::FarField;
use crate::inscatter::gatherer::GatherInMedia;
use crate::inscatter::lvoxel_light::LvoxelLight;
use crate::inscatter::near_emitters::NearEmitters;
use crate::inscatter::scattered::ScatteredLight;
use crate::inscatter::spacing::LeastSpacing;
use crate::inscatter::sweep::{SWEPT_LEVELS, Sweep, SweepScope};
use crate::inscatter::vertices::{BORDER_MARGIN_VOXELS, Vertices};
use crate::inscatter::walls;
use crate::light::{Lights, SceneMedia};
use crate::math::{Aabb, Rgb, sampling};
use crate::run::Job;
use crate::tree::IncidentGrid;
use crate::view::{View, VisibleMedia};
use lvox_formats::{MappedFile, Scatter};

/// In-scattered light of one volume: a lattice for each spacing, of which each brick of the volume
/// uses one.
#[derive(Debug)]
pub(super) struct VolumeLattices<'a> {
    /// By log2 of the voxels between vertices.
    pub direct: [Vertices<Vertex>; DIRECT_LEVELS],
    /// Where light of emitters bends; `None` if none is near.
    pub bends: Option<Bends>,
    /// Vertices that were lit beforehand.
    pub scattered: Option<ScatteredLight<'a>>,
    /// By log2 of the voxels between vertices.
    pub indirect: [Vertices<Rgb>; SWEPT_LEVELS],
    /// By the first vertex of a cell, whether indirect light bends in it; none where no surface
    /// sends any, and where walls stand among vertices, so that light ends at them.
    pub indirect_bends: Option<[Vertices<bool>; SWEPT_LEVELS]>,
    /// At fronts, by log2 of the voxels between vertices.
    pub seen_fronts: [Vertices<SeenFront>; DIRECT_LEVELS],
    pub far_field: FarField,
    pub sweep: Option<Sweep>,
    /// What lvoxels send each other, if that is known.
    pub lvoxels: Option<LvoxelLight<'a>>,
    /// Whether nothing else lights them indirectly.
    pub lvoxels_tell_all: bool,
    pub densities: Densities,
    /// Spacings that the camera needs, of direct and of indirect light.
    pub least_direct: LeastSpacing,
    pub least_indirect: LeastSpacing,
    pub emitters: NearEmitters,
    /// Spacings at fronts of what is opaque within few voxels; 0 elsewhere.
    pub fronts: LeastSpacing,
    /// Longest edge of a voxel, scene units.
    pub voxel: f32,
    /// Whether the camera tells no single voxel of a lone medium.
    pub shows_light_alone: bool,
}

/// Indirect light that is not swept stands at twice the spacing of direct light.
const _: () = assert!(SWEPT_LEVELS > DIRECT_LEVELS);

/// Vertices of scattered light may be so much further apart, as an optical depth in all media of a
/// place together, than they are in one medium.
const SHARED_DEPTH: f32 = 0.7;

/// Optical depth between vertices of direct light that no camera makes larger: up to it, light
/// between them is as good as linear.
const MAX_DIRECT_DEPTH: f32 = 0.7;
/// That of indirect light, which comes from all around.
const MAX_INDIRECT_DEPTH: f32 = 2.0;

/// The light that media scatter.
#[derive(Debug)]
pub struct MediaLights<'a, G: GatherInMedia> {
    /// Direct light.
    pub lights: &'a Lights<'a, SceneMedia<'a, G::Share>>,
    /// Gathers of indirect light, if there are any.
    pub gatherer: Option<&'a G>,
    /// Light that was made beforehand.
    pub scattered: Option<&'a Scatter<MappedFile>>,
    /// What lvoxels send each other, which is not gathered then.
    pub incident: Option<IncidentGrid<'a>>,
}

impl<'a> VolumeLattices<'a> {
    /// The lattices of the volume at an index.
    ///
    /// # Errors
    /// As [`super::InScatter::new`].
    pub fn new<G: GatherInMedia>(
        index: usize,
        view: &View<'a>,
        visible: VisibleMedia,
        light: &MediaLights<'a, G>,
        counters: &Counters,
        job: &Job,
    ) -> Result<Self> {
        let volume = &view.tracer.volumes[index];
        let volume_samples = light.gatherer.map_or(1, |g| g.settings().samples);
        let dims = volume.sigma_t.dims();
        // Where volumes overlap, or are alike, their probes must not have the same noise.
        let seed = match index {
            0 => view.seed,
            _ => sampling::hash(&[view.seed, index as u64]),
        };
        let far_field = FarField::new(volume, volume_samples, seed);
        let voxel = volume.longest_voxel_edge();
        let volumes = view.tracer.volumes;
        let is_alone = volumes.len() == 1 && view.tracer.scene.mesh.triangles.is_empty();
        let densities = Densities::new(volumes, view.tracer.boxes(), index);
        let least =
            |depth| LeastSpacing::new(view, visible, volume, &densities, depth, DIRECT_LEVELS - 1);
        let least_direct = least(MAX_DIRECT_DEPTH);
        let least_indirect = least(MAX_INDIRECT_DEPTH);
        let has_emitters = light.lights.emitters().next().is_some();
        let finest = match light.scattered {
            None if has_emitters => least_direct.least(&volume.sigma_t),
            _ => 0,
        };
        let emitters = NearEmitters::new(volume, light.lights.emitters(), finest);
        // Vertices that were lit beforehand stand as close there as elsewhere.
        let fronts = match light.scattered {
            None => LeastSpacing::of_fronts(view, visible, volume, &densities, volume_samples),
            Some(_) => LeastSpacing::none(),
        };
        let depth_of = |brick, own| {
            if fronts.of(brick) > 0 {
                return f32::INFINITY;
            }
            let all = densities.of_all(brick, own);
            densities.of(brick).max(SHARED_DEPTH * all) * voxel
        };
        let lvoxels = light.incident.map(LvoxelLight::new);
        let lvoxels_tell_all = lvoxels.is_some() && is_alone;
        let is_for_all_cameras = matches!(visible, VisibleMedia::All);
        let sweeper = (light.gatherer)
            .filter(|g| g.settings().max_dist.is_infinite())
            .filter(|_| volume.phase.is_isotropic() || !is_for_all_cameras)
            .filter(|_| !lvoxels_tell_all);
        // What was made for all cameras does not know where this one is.
        let scattered = (light.scattered).filter(|_| volume.phase.is_isotropic());
        let (scattered, sweep) = match (scattered, sweeper) {
            (Some(file), _) => {
                let scattered = ScatteredLight::open(file, index, view, visible, job)?;
                let sweep = sweeper.map(|_| Sweep::made_beforehand(volume, is_alone, depth_of));
                (Some(scattered), sweep)
            }
            (None, Some(gatherer)) => {
                let scope = SweepScope {
                    view,
                    visible,
                    gatherer,
                    volume,
                    far_field: &far_field,
                    job,
                    counters,
                };
                (None, Some(Sweep::new(&scope, &least_indirect, depth_of)?))
            }
            (None, None) => Default::default(),
        };
        let own = volume.bounds();
        let border = BORDER_MARGIN_VOXELS * voxel;
        let inner = Aabb {
            min: own.min + border,
            max: own.max - border,
        };
        let mesh = &view.tracer.scene.mesh;
        let may_bend = sweeper.is_some() && !is_alone && !walls::are_within(mesh, inner);
        Ok(Self {
            direct: std::array::from_fn(|level| Vertices::new(dims, 1 << level)),
            bends: emitters.are_any().then(|| Bends::new(dims)),
            scattered,
            indirect: std::array::from_fn(|level| Vertices::new(dims, 1 << level)),
            indirect_bends: may_bend
                .then(|| std::array::from_fn(|level| Vertices::new(dims, 1 << level))),
            seen_fronts: std::array::from_fn(|level| Vertices::new(dims, 1 << level)),
            far_field,
            sweep,
            lvoxels,
            lvoxels_tell_all,
            densities,
            least_direct,
            least_indirect,
            emitters,
            fronts,
            voxel,
            shows_light_alone: is_alone && view.shows_no_voxels(visible, volume),
        })
    }
}

//! In-scattered light inside media, interpolated from vertices on the volume's own grid.
//!
//! A vertex is evaluated when a ray first needs it and depends on its coordinates alone, so it does not matter which
//! tile or thread asks. Direct light is smooth at the scale of an optical depth, indirect light at twice that, so each
//! brick of a volume has the spacing that its own density asks for. Vertices
//! in empty space around the medium are evaluated like any other: leaving them dark would darken its rim.

use super::far_field::FarField;
use super::sweep::{Scope, Sweep};
use super::vertices::Vertices;
use super::view::View;
use crate::Result;
use crate::gather::{Gatherer, Medium, Pages, Stretch};
use crate::image::Region;
use crate::light::{InMedium, Lights, ShadowRays, SunDepths};
use crate::math::exp::mean_reach;
use crate::math::{Rgb, sampling};
use crate::run::Cancel;
use crate::scene::Volume;
use glam::Vec3;

/// In-scattered light of one volume: a lattice for each spacing, of which each brick of the volume uses one.
#[derive(Debug)]
struct Lattices {
    /// By log2 of the voxels between vertices.
    direct: [Vertices<InMedium>; LEVELS],
    indirect: [Vertices<Rgb>; LEVELS],
    far_field: FarField,
    sweep: Option<Sweep>,
    /// Longest edge of a voxel, scene units.
    voxel: f32,
}

/// Spacings of 1, 2 and 4 voxels.
pub(super) const LEVELS: usize = 3;

/// In-scattered light of all volumes of a scene.
pub struct InScatter<'a, P, M> {
    volumes: &'a [Volume],
    lights: &'a Lights<'a>,
    gatherer: Option<&'a Gatherer<'a, P, M>>,
    lattices: Vec<Lattices>,
    suns: SunDepths<'a>,
    seed: u64,
}

impl<'a, P: Pages, M: Medium> InScatter<'a, P, M> {
    /// Optical depth between vertices of the direct lattice. Cells deeper than this are lit at their own point.
    const DEPTH: f32 = 0.7;
    /// Cells deeper than this are lit by other surfaces and media at their own point, too: rays end within a few of them.
    const STIFF: f32 = 2.0;
    /// Voxels that vertices keep from the border of their volume.
    const INSIDE: f32 = 0.1;
    /// Shadow rays of a vertex or point to lights with an extent.
    const SHADOW_RAYS: u32 = 4;

    /// Lattices that are still empty but for what is swept, for rays of a region of the film. Without a gatherer there is
    /// direct light only.
    ///
    /// # Errors
    /// If cancelled.
    pub fn new(
        view: &View<'a>,
        region: Region,
        lights: &'a Lights<'a>,
        gatherer: Option<&'a Gatherer<'a, P, M>>,
        cancel: &Cancel,
    ) -> Result<Self> {
        let volumes = &view.tracer.scene.volumes;
        let mut lattices = Vec::with_capacity(volumes.len());
        for volume in volumes {
            let volume_samples = gatherer.map_or(1, |g| g.settings.samples);
            let dims = volume.sigma_t.dims();
            let far_field = FarField::new(volume, volume_samples);
            let voxel = volume.longest_voxel_edge();
            let sweep = gatherer
                .filter(|g| g.settings.max_dist.is_infinite())
                .map(|gatherer| {
                    let scope = Scope {
                        view,
                        region,
                        gatherer,
                        volume,
                        far_field: &far_field,
                        cancel,
                    };
                    Sweep::new(&scope, |densest| Self::swept_level(densest * voxel))
                })
                .transpose()?;
            lattices.push(Lattices {
                direct: std::array::from_fn(|level| Vertices::new(dims, 1 << level)),
                indirect: std::array::from_fn(|level| Vertices::new(dims, 2 << level)),
                far_field,
                sweep,
                voxel,
            });
        }
        Ok(Self {
            volumes,
            lights,
            gatherer,
            lattices,
            suns: SunDepths::new(view.tracer.scene),
            seed: view.seed,
        })
    }

    /// Which lattices serve a brick whose densest voxel has this optical depth: thin parts of a volume are lit from few
    /// vertices, whatever its densest part needs.
    fn level(densest: f32) -> usize {
        (0..LEVELS)
            .rev()
            .find(|&l| densest * (1 << l) as f32 <= Self::DEPTH)
            .unwrap_or(0)
    }

    /// The same where a brick is thin enough for light to be interpolated between the rays of a sweep.
    fn swept_level(densest: f32) -> Option<usize> {
        (densest <= Self::DEPTH).then(|| Self::level(densest))
    }

    /// Source function of a volume along a stretch of a ray, given its ends in scene space, its optical depth, and that
    /// of the cell that it is in.
    #[must_use]
    pub fn source(&self, volume: usize, [from, to]: [Vec3; 2], depth: f32, tau: f32) -> Rgb {
        let medium = &self.volumes[volume];
        let lattices = &self.lattices[volume];
        // Where its light comes from on average: near its front if it is dense.
        let point = from + (to - from) * mean_reach(depth);
        let at = medium.index_from_scene.transform_point3(point);
        // Vertices on the border stand a little inside: there may be a floor or a lamp in the border's plane.
        let dims = Vec3::from(medium.sigma_t.dims().map(|n| n as f32));
        let to_scene = |p: Vec3| {
            medium
                .scene_from_index
                .transform_point3(
                    p.clamp(Vec3::splat(Self::INSIDE), dims - Self::INSIDE)
                        .as_dvec3(),
                )
                .as_vec3()
        };
        let densest = medium.sigma_t.brick_max_at(at) * lattices.voxel;
        let level = Self::level(densest);
        let key = |v: [usize; 3]| {
            sampling::hash(&[
                self.seed,
                volume as u64,
                level as u64,
                v[0] as u64,
                v[1] as u64,
                v[2] as u64,
            ])
        };
        let seed_of = |point: Vec3| {
            let [x, y, z] = point.to_array().map(|c| u64::from(c.to_bits()));
            sampling::hash(&[self.seed, x, y, z])
        };
        let direct = if tau > Self::DEPTH {
            let light = self.direct(point, seed_of(point), None);
            light.share * self.lights.sent(point, point) + light.rest
        } else {
            let light = lattices.direct[level].interpolate(at, |p, v| {
                self.direct(to_scene(p), key(v), Some(&self.suns))
            });
            light.share * self.lights.sent(from, to) + light.rest
        };
        let indirect = self.gatherer.map_or(Rgb::BLACK, |gatherer| {
            let around = |at: Vec3, point: Vec3, seed: u64| {
                lattices
                    .far_field
                    .mean_radiance(medium, gatherer, at, point, seed)
                    .unwrap_or_else(|| gatherer.mean_radiance(point, Stretch::first(seed)).light)
            };
            if tau > Self::STIFF {
                around(at, point, seed_of(point))
            } else {
                let alone = &lattices.indirect[level];
                let sweep = Self::swept_level(densest).and(lattices.sweep.as_ref());
                let mut sum = Rgb::BLACK;
                for (v, weight) in alone.around(at) {
                    if weight > 0.0 {
                        let swept = sweep.and_then(|s| s.get(level, v));
                        let light = swept.unwrap_or_else(|| {
                            *alone.get(v, &|p, v| around(p, to_scene(p), key(v)))
                        });
                        sum += light * weight;
                    }
                }
                sum
            }
        });
        Rgb(medium.albedo) * (direct + indirect)
    }

    fn direct(&self, point: Vec3, seed: u64, suns: Option<&SunDepths>) -> InMedium {
        let rays = ShadowRays::Sequence {
            per_light: Self::SHADOW_RAYS,
            first: 0,
            seed,
        };
        self.lights.in_medium(point, rays, suns)
    }
}

//! In-scattered light inside media, interpolated from vertices on the volume's own grid.
//!
//! A vertex is evaluated when a ray first needs it and depends on its coordinates alone, so it does not matter which
//! tile or thread asks. Direct light is smooth at the scale of an optical depth, indirect light at twice that, so each
//! brick of a volume has the spacing that its own density asks for. Vertices
//! in empty space around the medium are evaluated like any other: leaving them dark would darken its rim.

use super::far_field::FarField;
use super::vertices::Vertices;
use crate::gather::{Gatherer, Medium, Pages, Stretch};
use crate::light::{Lights, ShadowRays};
use crate::math::{Rgb, sampling};
use crate::scene::Volume;
use glam::Vec3;

/// In-scattered light of one volume: a lattice for each spacing, of which each brick of the volume uses one.
#[derive(Debug)]
struct Lattices {
    /// By log2 of the voxels between vertices.
    direct: [Vertices<Rgb>; LEVELS],
    indirect: [Vertices<Rgb>; LEVELS],
    far_field: FarField,
    /// Longest edge of a voxel, scene units.
    voxel: f32,
}

/// Spacings of 1, 2 and 4 voxels.
const LEVELS: usize = 3;

/// In-scattered light of all volumes of a scene.
pub struct InScatter<'a, P, M> {
    volumes: &'a [Volume],
    lights: &'a Lights<'a>,
    vertex_lights: &'a Lights<'a>,
    gatherer: Option<&'a Gatherer<'a, P, M>>,
    lattices: Vec<Lattices>,
    seed: u64,
}

impl<'a, P: Pages, M: Medium> InScatter<'a, P, M> {
    /// Optical depth between vertices of the direct lattice. Cells deeper than this are lit at their own point.
    const DEPTH: f32 = 0.7;
    /// Shadow rays of a vertex to lights with an extent.
    const VERTEX_RAYS: u8 = 2;
    /// Shadow rays of a point that is lit by itself.
    const POINT_RAYS: u32 = 4;

    /// Empty lattices. Without a gatherer there is direct light only.
    #[must_use]
    pub fn new(
        volumes: &'a [Volume],
        lights: &'a Lights<'a>,
        vertex_lights: &'a Lights<'a>,
        gatherer: Option<&'a Gatherer<'a, P, M>>,
        seed: u64,
    ) -> Self {
        let lattices = volumes
            .iter()
            .map(|v| {
                let volume_samples = gatherer.map_or(1, |g| g.settings.samples);
                let axes = v.scene_from_index.matrix3;
                let voxel = axes
                    .x_axis
                    .length()
                    .max(axes.y_axis.length())
                    .max(axes.z_axis.length());
                let vertices = |level| Vertices::new(v.sigma_t.dims(), 1_usize << level);
                Lattices {
                    direct: std::array::from_fn(vertices),
                    indirect: std::array::from_fn(|level| vertices(level + 1)),
                    far_field: FarField::new(v, volume_samples),
                    voxel: voxel as f32,
                }
            })
            .collect();
        Self {
            volumes,
            lights,
            vertex_lights,
            gatherer,
            lattices,
            seed,
        }
    }

    /// Source function of a volume at a point of scene space, given the optical depth of the cell around it.
    #[must_use]
    pub fn source(&self, volume: usize, point: Vec3, tau: f32) -> Rgb {
        let medium = &self.volumes[volume];
        let lattices = &self.lattices[volume];
        let at = medium.index_from_scene.transform_point3(point);
        let to_scene = |p: Vec3| {
            medium
                .scene_from_index
                .transform_point3(p.as_dvec3())
                .as_vec3()
        };
        // Thin parts of a volume are lit from few vertices, whatever its densest part needs.
        let depth = medium.sigma_t.brick_max_at(at) * lattices.voxel;
        let level = (0..LEVELS)
            .rev()
            .find(|&l| depth * (1 << l) as f32 <= Self::DEPTH)
            .unwrap_or(0);
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
        let direct = if tau > Self::DEPTH {
            let bits = point.to_array().map(|c| u64::from(c.to_bits()));
            self.direct(
                point,
                sampling::hash(&[self.seed, bits[0], bits[1], bits[2]]),
            )
        } else {
            lattices.direct[level]
                .interpolate(at, |p, v| self.direct_at_vertex(to_scene(p), v, key(v)))
        };
        let indirect = self.gatherer.map_or(Rgb::BLACK, |gatherer| {
            lattices.indirect[level].interpolate(at, |p, v| {
                let point = to_scene(p);
                lattices
                    .far_field
                    .mean_radiance(medium, gatherer, p, point, key(v))
                    .unwrap_or_else(|| gatherer.mean_radiance(point, Stretch::first(key(v))).light)
            })
        });
        Rgb(medium.albedo) * (direct + indirect)
    }

    /// Direct light at a vertex, whose neighbours ask other parts of the lights.
    fn direct_at_vertex(&self, point: Vec3, v: [usize; 3], seed: u64) -> Rgb {
        let [x, y, z] = v.map(|c| (c % 2) as u8);
        let rays = ShadowRays::Cells {
            cell: 8 * x + 4 * y + 2 * z,
            first: 0,
            count: Self::VERTEX_RAYS,
            seed,
        };
        self.vertex_lights.mean_radiance(point, rays).light()
    }

    fn direct(&self, point: Vec3, seed: u64) -> Rgb {
        self.lights
            .mean_radiance(
                point,
                ShadowRays::Sequence {
                    per_light: Self::POINT_RAYS,
                    first: 0,
                    seed,
                },
            )
            .light()
    }
}

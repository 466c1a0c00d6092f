//! What a ray meets: triangles, exactly and watertight, and media, cell by cell. Shared by the
//! stages that have the scene at hand.
//!
//! A scene enters, a [`Tracer`] leaves, which takes rays.
//!
//! | file | what it does |
//! | --- | --- |
//! | `triangles` | the hierarchy over triangles, and the way of one ray or a packet through it |
//! | `watertight` | the test of a ray against four triangles |
//! | `surface` | the surface at a point of a triangle: normals, albedo, emission |
//! | `pieces` | how densely surfels stand on the pieces of a scene |
//! | `cells` | a ray through the cells of a volume, each with its exact optical depth |
//! | `emission` | the light of emissive volumes along a ray |
//! | `stepped` | a ray through a volume of few voxels, in even steps |

mod cells;
mod emission;
mod pieces;
mod stepped;
mod surface;
mod triangles;
mod watertight;

pub use crate::math::Hit;
pub use cells::{Cells, RayInVolume};
#[cfg(feature = "lab")]
pub use emission::each_emitting_cell;
pub use pieces::Pieces;
pub use stepped::SteppedVolume;
pub use surface::{Surface, offset, short_of, unit_normal, weights_in_triangle};
pub use triangles::TriangleBvh;

use crate::Result;
use crate::math::segment::{Interval, Segment, flatten_overlaps};
use crate::math::{Aabb, Boxes, Ray, Rgb, Spectrum};
use crate::run::{Cancel, walked};
use crate::scene::{Scene, Volume};
use glam::Vec3;

/// A scene made ready for rays.
#[derive(Debug)]
pub struct Tracer<'a> {
    /// The scene whose triangles rays meet.
    pub scene: &'a Scene,
    /// The media that rays pass: the scene's own, or the same on larger voxels.
    pub volumes: &'a [Volume],
    /// The density of surfels on the pieces of the scene.
    pub pieces: Pieces,
    triangles: TriangleBvh<'a>,
    /// Of the scene's volumes.
    boxes: Boxes,
    /// Whether cameras see all surfaces.
    are_all_seen: bool,
}

impl<'a> Tracer<'a> {
    /// Builds what rays need of a scene.
    #[must_use]
    pub fn new(scene: &'a Scene) -> Self {
        Self {
            scene,
            volumes: &scene.volumes,
            pieces: Pieces::new(scene),
            triangles: TriangleBvh::new(&scene.mesh).with_masks(scene),
            boxes: scene.volume_boxes(),
            are_all_seen: scene.are_all_surfaces_seen(),
        }
    }

    /// Does what [`Tracer::new`] does, but stops on request, and takes what a packed scene has.
    ///
    /// # Errors
    /// As [`TriangleBvh::new_until`], and [`Volume::ready`].
    pub fn new_until(scene: &'a Scene, cancel: &Cancel) -> Result<Self> {
        Self::with_volumes(scene, &scene.volumes, cancel)
    }

    /// Builds what [`Tracer::new`] does, with media that stand in for the scene's own, one for each
    /// and in the same box. The grids of these are read, but not those of the scene's own.
    ///
    /// # Errors
    /// As [`TriangleBvh::new_until`], and [`Volume::ready`].
    pub fn with_volumes(scene: &'a Scene, volumes: &'a [Volume], cancel: &Cancel) -> Result<Self> {
        volumes.iter().try_for_each(Volume::ready)?;
        let mut emissive = scene.emissive.iter();
        emissive.try_for_each(|e| e.values.ready())?;
        Ok(Self {
            scene,
            volumes,
            pieces: Pieces::new(scene),
            triangles: TriangleBvh::of_scene(scene, cancel)?,
            boxes: scene.volume_boxes(),
            are_all_seen: scene.are_all_surfaces_seen(),
        })
    }

    /// Box around all media; empty if there are none.
    #[must_use]
    pub fn media_bounds(&self) -> Aabb {
        let bounds = self.volumes.iter().map(Volume::bounds);
        bounds.fold(Aabb::EMPTY, |all, b| all.with(b.min).with(b.max))
    }

    /// Bytes that making it takes beside the scene, about; none of a packed scene, which has what
    /// rays need.
    #[must_use]
    pub fn bytes_for(scene: &Scene) -> u64 {
        match scene.as_packed() {
            Some(_) => 0,
            None => {
                let mesh = &scene.mesh;
                TriangleBvh::bytes_for(mesh.triangles.len())
                    + TriangleBvh::bytes_for_places(mesh.instances.list().len())
            }
        }
    }

    /// The boxes of the scene's volumes.
    #[must_use]
    pub fn boxes(&self) -> &Boxes {
        &self.boxes
    }

    /// The nearest triangle along a ray.
    #[must_use]
    pub fn closest(&self, ray: &Ray) -> Option<Hit> {
        walked::note_rays(1);
        self.triangles.closest(ray)
    }

    /// The nearest triangle along a ray, whether its mask says that it is there or not.
    #[must_use]
    pub fn closest_unmasked(&self, ray: &Ray) -> Option<Hit> {
        walked::note_rays(1);
        self.triangles.closest_unmasked(ray)
    }

    /// The nearest triangle along each ray of a packet, as [`Tracer::closest`] finds it, in `hits`,
    /// which has as many; faster where the rays go much the same way.
    pub fn closest_of_packet(&self, rays: &[Ray], hits: &mut [Option<Hit>]) {
        walked::note_rays(rays.len() as u64);
        self.triangles.closest_of_packet(rays, hits);
    }

    /// The nearest triangle along a ray of a camera, of those that cameras see.
    #[must_use]
    pub fn closest_seen(&self, ray: &Ray) -> Option<Hit> {
        walked::note_rays(1);
        self.triangles.closest_seen(ray, self.scene)
    }

    /// Whether cameras see all surfaces.
    #[must_use]
    pub fn are_all_seen(&self) -> bool {
        self.are_all_seen
    }

    /// The share of light that a camera sees from the end of a ray to its origin: 0 behind a
    /// surface that it sees, else the transmittance of the media between.
    #[must_use]
    pub fn seen_transmittance<K: Spectrum>(&self, ray: &Ray) -> K {
        if self.closest_seen(ray).is_some() {
            K::default()
        } else if self.volumes.is_empty() {
            K::splat(1.0)
        } else {
            self.optical_depth::<K>(ray).exp_neg()
        }
    }

    /// Whether a ray meets any surface.
    #[must_use]
    pub fn is_occluded(&self, ray: &Ray) -> bool {
        walked::note_rays(1);
        self.triangles.is_occluded(ray)
    }

    /// What [`Tracer::closest_seen`] finds, and whether masks have a say in that: the ray ends on a
    /// masked triangle, or has passed one.
    #[must_use]
    pub fn closest_seen_and_masked(&self, ray: &Ray) -> (Option<Hit>, bool) {
        walked::note_rays(1);
        (self.triangles).closest_seen_and_masked(ray, self.scene)
    }

    /// Whether nothing of a triangle is there, by its mask, at barycentric weights of its second
    /// and third corner.
    #[must_use]
    #[inline]
    pub fn is_clear(&self, triangle: u32, uv: [f32; 2]) -> bool {
        let masks = self.triangles.masks();
        masks.is_some_and(|masks| {
            let (stored, instance) = self.scene.mesh.place(triangle as usize);
            let uv = instance.map_or(uv, |i| i.turned(uv));
            masks.is_clear(stored as u32, uv)
        })
    }

    /// The share of a triangle that is there at barycentric weights of its second and third corner;
    /// `None` if it has no mask.
    #[must_use]
    pub fn opacity(&self, triangle: u32, uv: [f32; 2]) -> Option<f32> {
        let masks = self.triangles.masks()?;
        let (stored, instance) = self.scene.mesh.place(triangle as usize);
        masks.of_triangle(stored as u32)?;
        let uv = instance.map_or(uv, |i| i.turned(uv));
        Some((1.0 - masks.let_through(stored as u32, uv)).clamp(0.0, 1.0))
    }

    /// The share of light that surfaces let through along a ray: 0 behind one, but for masks.
    #[must_use]
    #[inline]
    pub fn let_through(&self, ray: &Ray) -> f32 {
        walked::note_rays(1);
        self.triangles.let_through(ray)
    }

    /// Whether a surface is between two points.
    #[must_use]
    pub fn is_between(&self, from: Vec3, to: Vec3) -> bool {
        let distance = from.distance(to);
        distance > 0.0 && self.is_occluded(&Ray::new(from, (to - from) / distance, distance))
    }

    /// The share of light that gets from the end of a ray to its origin: what surfaces let through,
    /// times the transmittance of the media between.
    #[must_use]
    pub fn transmittance<K: Spectrum>(&self, ray: &Ray) -> K {
        let through = self.let_through(ray);
        if through == 0.0 || self.volumes.is_empty() {
            K::splat(through)
        } else {
            self.optical_depth::<K>(ray).exp_neg() * through
        }
    }

    /// The optical depth of one volume along a ray, exact, cell by cell: of the channel that has
    /// most.
    #[must_use]
    pub fn optical_depth_in(&self, volume: usize, ray: &Ray) -> f32 {
        Cells::new(&self.volumes[volume], ray).map_or(0.0, Cells::optical_depth) as f32
    }

    /// The optical depth of all media along a ray, exact, cell by cell.
    #[must_use]
    pub fn optical_depth<K: Spectrum>(&self, ray: &Ray) -> K {
        let mut depth = [0.0; 3];
        for volume in self.boxes.along(ray).map(|v| &self.volumes[v]) {
            let tau = Cells::new(volume, ray).map_or(0.0, Cells::optical_depth);
            match K::IS_GREY {
                true => depth[0] += tau,
                false => (depth.iter_mut().zip(volume.extinction_color))
                    .for_each(|(depth, color)| *depth += tau * f64::from(color)),
            }
        }
        K::of_channels(depth.map(|d| d as f32))
    }

    /// Passes every segment of a ray in a medium, front to back, to `emit` until that says no.
    /// `source(volume, cell, tau)` gives the source function of a volume in a part of the ray, in a
    /// cell of the optical depth `tau`; depths there are those of the channel that has most.
    pub fn march<K: Spectrum>(
        &self,
        ray: &Ray,
        source: impl Fn(usize, RayInVolume, f32) -> Rgb,
        mut emit: impl FnMut(Segment<K>) -> bool,
    ) {
        let of_volume = |v: usize, tau: f32| K::tinted(tau, &self.volumes[v].extinction_color);
        let cells = |v: usize| Some((v, Cells::new(&self.volumes[v], ray)?));
        let mut walks = self.boxes.along(ray).filter_map(cells);
        let Some((first, cells)) = walks.next() else {
            return;
        };
        let to_segment = |v: usize, c: RayInVolume, tau: f32| Segment {
            near: c.near,
            far: c.far,
            tau: of_volume(v, c.tau),
            source: source(v, c, tau),
        };
        let Some(second) = walks.next() else {
            cells.each(|cell| {
                cell.pieces()
                    .all(|piece| emit(to_segment(first, piece, cell.tau)))
            });
            return;
        };
        let walks = [(first, cells), second].into_iter().chain(walks);
        let walks = walks.map(|(v, mut cells)| {
            std::iter::from_fn(move || cells.next_cell()).flat_map(move |cell| {
                cell.pieces().map(move |piece| Interval {
                    near: piece.near,
                    far: piece.far,
                    tau: of_volume(v, piece.tau),
                    of: (v, piece, cell.tau),
                })
            })
        });
        flatten_overlaps(walks, |(v, piece, tau)| source(v, piece, tau), emit);
    }
}

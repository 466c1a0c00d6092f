//! Triangles that a scene keeps once and places many times.
//!
//! A [`Mesh`](super::Mesh) stores flat triangles, in scene space, and behind them those of
//! prototypes, each in a space of its own. An instance places a prototype by an affine map.
//! Triangles of the scene are numbered as if all were flat: the flat ones first, then those of each
//! instance.

use super::Mesh;
use crate::math::Aabb;
use glam::{DAffine3, DMat3, DVec3, Vec3};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::ops::Range;

/// Triangles that are kept once: where they are stored in the mesh.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Prototype {
    /// Its triangles, as they are stored.
    pub triangles: Range<u32>,
    /// Its vertices.
    pub vertices: Range<u32>,
}

/// A prototype at a place.
#[derive(Clone, Debug, PartialEq)]
pub struct Instance {
    /// Index of the prototype.
    pub prototype: u32,
    /// Number of its first triangle in the scene.
    pub first: u32,
    /// Map from the prototype's space to scene space.
    pub scene_from_prototype: DAffine3,
    /// Box around it, scene space.
    pub bounds: Aabb,
}

impl Instance {
    /// Whether the map turns what is left to what is right: corners of triangles change places, so
    /// that fronts stay fronts.
    #[must_use]
    #[inline]
    pub fn is_mirrored(&self) -> bool {
        self.scene_from_prototype.matrix3.determinant() < 0.0
    }

    /// Barycentric weights of second and third corners as the prototype has them, from those as the
    /// scene has them, and back.
    #[must_use]
    #[inline]
    pub fn turned<T>(&self, [u, v]: [T; 2]) -> [T; 2] {
        match self.is_mirrored() {
            true => [v, u],
            false => [u, v],
        }
    }

    /// A point of the prototype in scene space.
    #[must_use]
    #[inline]
    pub fn point(&self, p: Vec3) -> Vec3 {
        (self.scene_from_prototype.transform_point3(p.as_dvec3())).as_vec3()
    }

    /// How many times larger areas are than those of the prototype, if the map makes all of them as
    /// much larger.
    #[must_use]
    pub fn area_scale(&self) -> Option<f64> {
        /// Of lengths, as much as the rounding of products of a few maps.
        const ROUNDING: f64 = 1e-12;
        let DMat3 {
            x_axis: x,
            y_axis: y,
            z_axis: z,
        } = self.scene_from_prototype.matrix3;
        let scale = x.length_squared();
        let is_even = [y, z]
            .iter()
            .all(|a| (a.length_squared() / scale - 1.0).abs() < ROUNDING)
            && [x.dot(y), y.dot(z), z.dot(x)]
                .iter()
                .all(|d| d.abs() < ROUNDING * scale);
        is_even.then_some(scale)
    }
}

/// The prototypes of a mesh and where they stand; of most scenes none.
#[derive(Clone, Debug, PartialEq)]
pub struct Instances {
    /// Triangles that lie in scene space; more than there are where there is no instance.
    flat: u32,
    prototypes: Vec<Prototype>,
    list: Vec<Instance>,
    /// Triangles of all instances.
    triangles: u64,
}

impl Default for Instances {
    fn default() -> Self {
        Self {
            flat: u32::MAX,
            prototypes: Vec::new(),
            list: Vec::new(),
            triangles: 0,
        }
    }
}

impl Instances {
    /// Triangles of a scene with instances, at most: what numbers them, and their edges, has 32
    /// bits.
    pub(crate) const MAX_TRIANGLES: u64 = 1 << 30;

    /// Instances of prototypes, which follow each other at the end of what a mesh stores. Places
    /// are indices of prototypes and maps to scene space; `None` for an index without a prototype,
    /// and for more triangles than can be numbered.
    pub(crate) fn new(
        prototypes: Vec<Prototype>,
        places: impl IntoIterator<Item = (u32, DAffine3)>,
    ) -> Option<Self> {
        let Some(first) = prototypes.first() else {
            return Some(Self::default());
        };
        let flat = first.triangles.start;
        let mut next = u64::from(flat);
        let mut list = Vec::new();
        for (prototype, scene_from_prototype) in places {
            let triangles = prototypes.get(prototype as usize)?.triangles.len();
            list.push(Instance {
                prototype,
                first: u32::try_from(next).ok()?,
                scene_from_prototype,
                bounds: Aabb::EMPTY,
            });
            next += triangles as u64;
        }
        (next <= Self::MAX_TRIANGLES).then(|| Self {
            flat,
            triangles: next - u64::from(flat),
            prototypes,
            list,
        })
    }

    /// Sets the box around each, in their order.
    pub(super) fn set_bounds(&mut self, bounds: impl Iterator<Item = Aabb>) {
        for (instance, bounds) in self.list.iter_mut().zip(bounds) {
            instance.bounds = bounds;
        }
    }

    /// Whether there are none.
    #[must_use]
    #[inline]
    pub fn is_empty(&self) -> bool {
        self.prototypes.is_empty()
    }

    /// The prototypes.
    #[must_use]
    pub fn prototypes(&self) -> &[Prototype] {
        &self.prototypes
    }

    /// The instances, by rising number of their triangles.
    #[must_use]
    pub fn list(&self) -> &[Instance] {
        &self.list
    }

    /// Where the triangles of an instance are stored.
    #[must_use]
    pub fn stored(&self, instance: &Instance) -> Range<u32> {
        self.prototypes[instance.prototype as usize]
            .triangles
            .clone()
    }

    /// Whether a triangle lies in scene space.
    #[inline(always)]
    pub(super) fn is_flat(&self, triangle: usize) -> bool {
        triangle < self.flat as usize
    }

    /// The instance that a triangle belongs to, which is not flat, and where that is stored.
    pub(super) fn find(&self, triangle: usize) -> (&Instance, usize) {
        let behind = self.list.partition_point(|i| i.first as usize <= triangle);
        let instance = &self.list[behind - 1];
        let stored = self.prototypes[instance.prototype as usize].triangles.start;
        (
            instance,
            triangle - instance.first as usize + stored as usize,
        )
    }

    /// Bytes of memory that they take.
    pub(super) fn bytes(&self) -> u64 {
        (size_of_val(&self.prototypes[..]) + size_of_val(&self.list[..])) as u64
    }

    /// Moves what stands in scene space.
    pub(super) fn shift(&mut self, by: DVec3) {
        for instance in &mut self.list {
            instance.scene_from_prototype.translation += by;
            let Aabb { min, max } = instance.bounds;
            instance.bounds = Aabb {
                min: (min.as_dvec3() + by).as_vec3(),
                max: (max.as_dvec3() + by).as_vec3(),
            };
        }
    }

    /// Follows where of stored triangles only some were kept, in their order.
    pub(super) fn keep(&mut self, is_kept: impl Fn(usize) -> bool, stored: usize) {
        if self.is_empty() {
            return;
        }
        let mut before = Vec::with_capacity(stored + 1);
        let mut kept = 0;
        for t in 0..stored {
            before.push(kept);
            kept += u32::from(is_kept(t));
        }
        before.push(kept);
        let prototypes = self.prototypes.iter().map(|p| Prototype {
            triangles: before[p.triangles.start as usize]..before[p.triangles.end as usize],
            vertices: p.vertices.clone(),
        });
        let places = self
            .list
            .iter()
            .map(|i| (i.prototype, i.scene_from_prototype));
        // Fewer triangles than before can be numbered.
        if let Some(kept) = Self::new(prototypes.collect(), places) {
            *self = kept;
        }
    }
}

fn area_of(corners: [Vec3; 3]) -> f64 {
    let [a, b, c] = corners.map(|p| p.as_dvec3());
    0.5 * (b - a).cross(c - a).length()
}

impl Mesh {
    /// Number of triangles in the scene, each instance counted.
    #[must_use]
    pub fn triangle_count(&self) -> usize {
        match self.instances.is_empty() {
            true => self.triangles.len(),
            false => self.flat_count() + self.instances.triangles as usize,
        }
    }

    /// Number of triangles that lie in scene space as they are stored, which come first.
    #[must_use]
    pub fn flat_count(&self) -> usize {
        self.triangles.len().min(self.instances.flat as usize)
    }

    /// Number of vertices that lie in scene space, which come first.
    #[must_use]
    pub fn flat_vertices(&self) -> usize {
        let first = self.instances.prototypes.first();
        first.map_or(self.positions.len(), |p| p.vertices.start as usize)
    }

    /// Where a triangle of the scene is stored.
    #[must_use]
    #[inline]
    pub fn stored(&self, triangle: usize) -> usize {
        match self.instances.is_flat(triangle) {
            true => triangle,
            false => self.instances.find(triangle).1,
        }
    }

    /// Where a triangle of the scene is stored, and the instance that it belongs to if it is not
    /// flat.
    #[must_use]
    #[inline]
    pub fn place(&self, triangle: usize) -> (usize, Option<&Instance>) {
        match self.instances.is_flat(triangle) {
            true => (triangle, None),
            false => {
                let (instance, stored) = self.instances.find(triangle);
                (stored, Some(instance))
            }
        }
    }

    /// Index of the material of a triangle.
    #[must_use]
    #[inline]
    pub fn material_of(&self, triangle: usize) -> u32 {
        self.material[self.stored(triangle)]
    }

    /// Indices of the corners of a triangle.
    #[must_use]
    #[inline]
    pub fn vertices_of(&self, triangle: usize) -> [u32; 3] {
        let (stored, instance) = self.place(triangle);
        let [a, b, c] = self.triangles[stored];
        let [b, c] = instance.map_or([b, c], |i| i.turned([b, c]));
        [a, b, c]
    }

    /// Shading normals at the corners of a triangle, as [`Mesh::normals`]; there are some.
    #[must_use]
    #[inline]
    pub fn normals_of(&self, triangle: usize) -> [Vec3; 3] {
        let normals = self.vertices_of(triangle).map(|v| self.normals[v as usize]);
        match self.instances.is_flat(triangle) {
            true => normals,
            false => self.placed_normals(triangle, normals),
        }
    }

    #[inline(never)]
    fn placed_normals(&self, triangle: usize, normals: [Vec3; 3]) -> [Vec3; 3] {
        let map = self.instances.find(triangle).0.scene_from_prototype.matrix3;
        let scene_from_prototype = map.inverse().transpose();
        normals.map(|n| {
            (scene_from_prototype * n.as_dvec3())
                .normalize_or_zero()
                .as_vec3()
        })
    }

    /// Corners of a triangle that is not flat, scene space.
    #[inline(never)]
    pub(super) fn placed_corners(&self, triangle: usize) -> [Vec3; 3] {
        let (instance, stored) = self.instances.find(triangle);
        let [a, b, c] = self.own_corners(stored).map(|p| instance.point(p));
        let [b, c] = instance.turned([b, c]);
        [a, b, c]
    }

    /// Finds the box around each instance.
    pub(super) fn find_bounds(&mut self) {
        let bounds = self.bounds_of_instances();
        self.instances.set_bounds(bounds.into_iter());
    }

    /// The box around each instance; a point where none of its triangles is left.
    pub(crate) fn bounds_of_instances(&self) -> Vec<Aabb> {
        let used = |p: &Prototype| {
            let mut is_used = vec![false; p.vertices.len()];
            let triangles = p.triangles.start as usize..p.triangles.end as usize;
            for v in self.triangles[triangles].iter().flatten() {
                if let Some(used) = is_used.get_mut(v.wrapping_sub(p.vertices.start) as usize) {
                    *used = true;
                }
            }
            let vertices = p.vertices.clone().zip(is_used);
            let used = vertices.filter(|(_, is_used)| *is_used);
            used.map(|(v, _)| self.positions[v as usize])
                .collect::<Vec<Vec3>>()
        };
        let points: Vec<Vec<Vec3>> = self.instances.prototypes.par_iter().map(used).collect();
        let bounds = |instance: &Instance| {
            let points = &points[instance.prototype as usize][..];
            let points = if points.is_empty() {
                &[Vec3::ZERO]
            } else {
                points
            };
            let points = points.iter().map(|p| instance.point(*p));
            points.fold(Aabb::EMPTY, Aabb::with)
        };
        self.instances.list.par_iter().map(bounds).collect()
    }

    /// Material and area of each of some triangles that follow each other, which are not flat.
    pub(crate) fn placed_areas(&self, triangles: Range<usize>) -> impl Iterator<Item = (u32, f64)> {
        // Most that follow each other are of one instance, which need not be found again.
        let mut found: Option<(&Instance, Range<usize>, usize)> = None;
        triangles.map(move |t| {
            let (instance, of, first) = match found.take() {
                Some(last) if last.1.contains(&t) => last,
                _ => {
                    let (instance, stored) = self.instances.find(t);
                    let all = self.instances.stored(instance);
                    let first = instance.first as usize;
                    let of = first..first + all.len();
                    (instance, of, stored - (t - first))
                }
            };
            let stored = first + (t - of.start);
            let corners = self.own_corners(stored).map(|p| instance.point(p));
            found = Some((instance, of, first));
            (self.material[stored], area_of(corners))
        })
    }

    /// Areas of all triangles by so many materials.
    #[must_use]
    pub fn areas(&self, materials: usize) -> Vec<f64> {
        let mut areas = vec![0.0; materials];
        for t in 0..self.flat_count() {
            areas[self.material[t] as usize] += area_of(self.own_corners(t));
        }
        for (material, (_, area)) in self.areas_of_instances() {
            areas[material as usize] += area;
        }
        areas
    }

    /// Number and area of the triangles of each material, instance by instance.
    pub(crate) fn areas_of_instances(&self) -> impl Iterator<Item = (u32, (u64, f64))> {
        let of_stored = |stored: Range<u32>, point: &(dyn Fn(Vec3) -> Vec3 + Sync)| {
            // By material: prototypes have few, and may be many.
            let mut sums = BTreeMap::<u32, (u64, f64)>::new();
            for t in stored {
                let corners = self.own_corners(t as usize).map(point);
                let (count, sum) = sums.entry(self.material[t as usize]).or_default();
                *count += 1;
                *sum += area_of(corners);
            }
            sums
        };
        let prototypes = self.instances.prototypes.par_iter();
        let prototypes: Vec<_> = prototypes
            .map(|p| of_stored(p.triangles.clone(), &|p| p))
            .collect();
        let instances = self.instances.list.par_iter();
        let instances: Vec<_> = instances
            .map(|instance| match instance.area_scale() {
                Some(scale) => {
                    let sums = prototypes[instance.prototype as usize].iter();
                    sums.map(|(m, (count, area))| (*m, (*count, area * scale)))
                        .collect()
                }
                None => of_stored(self.instances.stored(instance), &|p| instance.point(p)),
            })
            .collect();
        instances.into_iter().flatten()
    }
}

//! The optical depth of media towards suns: exact for the first few voxels, then from rays that are
//! kept (deep shadow maps, Lokovic & Veach 2000).

use super::baked_depth::BakedDepth;
use super::checks::{Checks, Levels};
use super::kept_rays::{KeptRays, mean_depth};
use super::shadows::{MediaBeforeSuns, ShadowMedia};
use crate::Result;
use crate::math::ray_lattice::RayLattice;
use crate::math::{Aabb, Boxes, Ray, Spectrum};
use crate::scene::{Light, Scene, Volume};
use crate::trace::{Cells, Tracer};
use glam::Vec3;
use std::sync::OnceLock;

/// The media's depth towards each sun of a scene. Rays are made when first asked for, and depend on
/// nothing but the scene.
#[derive(Debug)]
pub struct SunDepths<'a> {
    lights: &'a [Light],
    volumes: &'a [Volume],
    /// Whether the voxels of a volume are so many, or so small in the picture, that its rays are to
    /// go through coarse cells where these are near enough.
    in_cells: Vec<bool>,
    /// By light; of a scene that has many only some are ever asked for.
    suns: Vec<OnceLock<Option<SunDepth<'a>>>>,
}

/// Depth towards one sun, whatever direction is asked for.
#[derive(Debug)]
struct SunDepth<'a> {
    to_sun: Vec3,
    volumes: Vec<Towards<'a>>,
    /// Of each volume, its extinction by channel over that of the largest.
    colors: Vec<[f32; 3]>,
    boxes: Boxes,
}

/// How the depth of one volume towards one sun is known.
#[derive(Debug)]
enum Towards<'a> {
    /// By rays that are made when first asked for.
    Asked(VolumeDepth<'a>),
    /// By rays that were made beforehand.
    Kept(KeptRays),
    /// As a bake needs it.
    Baked(BakedDepth<'a>),
}

impl<'a> SunDepths<'a> {
    /// Angular radius, radians, beyond which shadows are too soft for rays along one direction.
    const MAX_ANGULAR_RADIUS: f32 = 0.02;
    /// Optical depth between rays, and along them between the depths that are kept.
    const MAX_DEPTH: f32 = 0.7;
    /// Voxels between rays, at most.
    const MAX_VOXELS: u32 = 8;
    /// Rays' distances from a point up to which its depth is exact: what is nearer has the sharpest
    /// shadows.
    const EXACT_RAY_SPACINGS: f32 = 6.0;

    /// Cells that the rays to all suns pass in all volumes, at most.
    const MOST_CELLS: usize = 1 << 24;
    /// Fewer for a sun in a volume are not worth it.
    const FEWEST_CELLS: usize = 1 << 20;
    /// Points at which they are checked, and the root mean square by which light may differ there:
    /// pictures show it, where bakes show means of many points.
    const CHECKS: usize = 1024;
    const MAX_ERROR: f64 = 0.5 * Checks::MAX_ERROR;

    /// Nothing is known yet.
    #[must_use]
    pub fn new(tracer: &Tracer<'a>, in_cells: impl Fn(&Volume) -> bool) -> Self {
        let lights = &tracer.scene.lights;
        let mut depths = Self {
            lights,
            volumes: tracer.volumes,
            in_cells: tracer.volumes.iter().map(in_cells).collect(),
            suns: lights.iter().map(|_| OnceLock::new()).collect(),
        };
        if depths.cells_of_each() < Self::FEWEST_CELLS {
            depths.in_cells.fill(false);
        }
        depths
    }

    /// Cells that the rays to one sun may pass in one volume.
    fn cells_of_each(&self) -> usize {
        let volumes = self.in_cells.iter().filter(|is| **is).count();
        if volumes == 0 {
            return Self::MOST_CELLS;
        }
        Self::MOST_CELLS / (volumes * Self::suns(self.lights)).max(1)
    }

    fn suns(lights: &[Light]) -> usize {
        lights.iter().filter_map(Self::direction).count()
    }

    /// Bytes that rays in coarse cells take while they are made, about; `in_cells` as for
    /// [`Self::new`].
    #[must_use]
    pub fn bytes_for(scene: &Scene, in_cells: impl Fn(&Volume) -> bool) -> u64 {
        let volumes: Vec<_> = scene.volumes.iter().filter(|v| in_cells(v)).collect();
        let suns = Self::suns(&scene.lights);
        let most = Self::MOST_CELLS / (volumes.len() * suns).max(1);
        if suns == 0 || most < Self::FEWEST_CELLS {
            return 0;
        }
        let cells: usize = volumes.iter().map(|v| Levels::cells(v, most)).sum();
        (cells * (Levels::CELL_BYTES + suns * KeptRays::CELL_BYTES)) as u64
    }

    /// Makes what goes through coarse cells, with all threads. Not when a task of theirs first
    /// asks: while it waits for others it could take up one that waits for the same.
    ///
    /// # Errors
    /// A stop on request.
    pub fn make_in_cells(&self, go_on: &impl Fn() -> Result<()>) -> Result<()> {
        if !self.in_cells.contains(&true) {
            return Ok(());
        }
        for (light, sun) in self.lights.iter().zip(&self.suns) {
            let depth = self.depth(light, go_on)?;
            sun.get_or_init(|| depth);
        }
        Ok(())
    }

    fn depth(
        &self,
        light: &Light,
        go_on: &impl Fn() -> Result<()>,
    ) -> Result<Option<SunDepth<'a>>> {
        let (volumes, in_cells) = (self.volumes, &self.in_cells[..]);
        let most = self.cells_of_each();
        SunDepth::new(volumes, in_cells, light, most, go_on)
    }

    /// Knows of no sun.
    pub(super) fn none(scene: &'a Scene) -> Self {
        Self {
            lights: &scene.lights,
            volumes: &scene.volumes,
            in_cells: Vec::new(),
            suns: Vec::new(),
        }
    }

    /// Has for each volume, by its number, and each sun, by the direction to it, what `bake` gives.
    pub(super) fn baked(
        scene: &'a Scene,
        bake: impl Fn(usize, Vec3) -> Result<BakedDepth<'a>>,
    ) -> Result<Self> {
        let of = |light: &Light| {
            let Some(to_sun) = Self::direction(light) else {
                return Ok(None);
            };
            let depths = (0..scene.volumes.len()).map(|v| bake(v, to_sun).map(Towards::Baked));
            Ok(Some(SunDepth {
                to_sun,
                volumes: depths.collect::<Result<_>>()?,
                colors: colors(&scene.volumes),
                boxes: Boxes::new(scene.volumes.iter().map(Volume::bounds)),
            }))
        };
        let suns = scene.lights.iter().map(|l| of(l).map(OnceLock::from));
        Ok(Self {
            lights: &scene.lights,
            volumes: &scene.volumes,
            in_cells: Vec::new(),
            suns: suns.collect::<Result<_>>()?,
        })
    }

    /// Unit direction to a light, scene space, if it is a sun that is narrow enough.
    pub(super) fn direction(light: &Light) -> Option<Vec3> {
        match *light {
            Light::Directional {
                direction,
                angular_radius_rad,
                ..
            } if angular_radius_rad <= Self::MAX_ANGULAR_RADIUS => Some(-direction),
            _ => None,
        }
    }

    /// What is known of a light, by its index; `None` if it is no sun or too wide a one.
    #[must_use]
    pub fn of<K: Spectrum>(&self, light: usize) -> Option<&dyn ShadowMedia<K>> {
        let depth = self.suns.get(light)?.get_or_init(|| {
            let light = self.lights.get(light)?;
            self.depth(light, &|| Ok(())).ok().flatten()
        });
        Some(depth.as_ref()?)
    }
}

impl<K: Spectrum> MediaBeforeSuns<K> for SunDepths<'_> {
    /// Rays through coarse cells, where all media before a sun have these: shadows on surfaces are
    /// then no sharper than pixels.
    fn before_sun(&self, light: usize) -> Option<&dyn ShadowMedia<K>> {
        let depth = self.suns.get(light)?.get()?.as_ref()?;
        let mut volumes = depth.volumes.iter();
        let are_kept = volumes.all(|volume| matches!(volume, Towards::Kept(_)));
        are_kept.then_some(depth)
    }
}

/// Of each volume, its extinction by channel over that of the largest.
fn colors(volumes: &[Volume]) -> Vec<[f32; 3]> {
    volumes.iter().map(|v| v.extinction_color).collect()
}

impl<'a> SunDepth<'a> {
    fn new(
        all: &'a [Volume],
        in_cells: &[bool],
        light: &Light,
        most_cells: usize,
        go_on: &impl Fn() -> Result<()>,
    ) -> Result<Option<Self>> {
        let Some(to_sun) = SunDepths::direction(light) else {
            return Ok(None);
        };
        let of_volume = |(volume, &in_cells): (&'a Volume, &bool)| {
            let asked = VolumeDepth::new(volume, to_sun);
            let bounds = asked.bounds();
            let kept = match in_cells {
                true => Self::kept(volume, to_sun, most_cells, go_on)?,
                false => None,
            };
            Ok((bounds, kept.map_or(Towards::Asked(asked), Towards::Kept)))
        };
        let towards = all.iter().zip(in_cells).map(of_volume);
        let (boxes, volumes): (Vec<_>, Vec<_>) =
            towards.collect::<Result<Vec<_>>>()?.into_iter().unzip();
        Ok(Some(Self {
            to_sun,
            colors: colors(all),
            boxes: Boxes::new(boxes),
            volumes,
        }))
    }

    /// Rays through coarse cells of a volume, if they are near enough.
    fn kept(
        volume: &Volume,
        to_sun: Vec3,
        most_cells: usize,
        go_on: &impl Fn() -> Result<()>,
    ) -> Result<Option<KeptRays>> {
        let checks = Checks::new(volume, SunDepths::CHECKS, &[to_sun]);
        let levels = Levels::new(volume, most_cells);
        checks.coarsest_rays(SunDepths::MAX_ERROR, &levels, go_on, to_sun)
    }
}

impl<K: Spectrum> ShadowMedia<K> for SunDepth<'_> {
    fn optical_depth(&self, _: &Tracer, ray: &Ray) -> K {
        let depth = |v: usize| {
            let depth = match &self.volumes[v] {
                Towards::Asked(depth) => depth.at(ray.origin),
                Towards::Kept(rays) => rays.depth(ray.origin),
                Towards::Baked(depth) => depth.at(ray.origin),
            };
            K::tinted(depth, &self.colors[v])
        };
        let met = self.boxes.along(&Ray::endless(ray.origin, self.to_sun));
        met.map(depth).fold(K::default(), |sum, depth| sum + depth)
    }

    fn is_dark(&self, point: Vec3) -> bool {
        let is_dark = |volume: &Towards| match volume {
            Towards::Baked(depth) => depth.is_dark(point),
            Towards::Asked(_) | Towards::Kept(_) => false,
        };
        self.volumes.iter().any(is_dark)
    }
}

/// One volume's depth towards one sun.
#[derive(Debug)]
struct VolumeDepth<'a> {
    volume: &'a Volume,
    /// Unit direction to the sun, scene space.
    to_sun: Vec3,
    rays: RayLattice,
    /// Steps of the lattice of rays and layers per voxel.
    per_voxel: f32,
    /// Layers along the rays' first axis.
    layers: usize,
    extent: [(i32, usize); 2],
    /// By row of rays, then by ray.
    rows: Vec<OnceLock<Box<[OnceLock<DepthRay>]>>>,
}

/// Depth between the sun and the layers along one ray, counted from the sun.
#[derive(Debug)]
struct DepthRay {
    /// The first layer with any medium before it.
    first: usize,
    /// From there on, as far as it grows.
    depths: Box<[f32]>,
}

impl DepthRay {
    fn at(&self, layer: usize) -> f32 {
        let within = layer.checked_sub(self.first);
        within.map_or(0.0, |i| {
            let last = self.depths.last().copied().unwrap_or(0.0);
            self.depths.get(i).copied().unwrap_or(last)
        })
    }
}

impl<'a> VolumeDepth<'a> {
    fn new(volume: &'a Volume, to_sun: Vec3) -> Self {
        let densest = volume.sigma_t.max() * volume.longest_voxel_edge();
        let mut step = 1;
        while step < SunDepths::MAX_VOXELS && densest * (2 * step) as f32 <= SunDepths::MAX_DEPTH {
            step *= 2;
        }
        let direction = volume.index_from_scene.transform_vector3(to_sun);
        let rays = RayLattice::new(direction, step as f32);
        let count = volume.sigma_t.dims().map(|n| n.div_ceil(step as usize) + 1);
        let extent = rays.extent([[0; 3], count.map(|n| n - 1)]);
        Self {
            volume,
            to_sun,
            rays,
            per_voxel: 1.0 / step as f32,
            layers: count[rays.axes[0]],
            extent,
            rows: (0..extent[1].1).map(|_| OnceLock::new()).collect(),
        }
    }

    /// Box around all that changes the depth: the volume, and what is beside it by a ray.
    fn bounds(&self) -> Aabb {
        let Aabb { min, max } = self.volume.bounds();
        let beside = 2.0 * self.volume.longest_voxel_edge() / self.per_voxel;
        Aabb {
            min: min - beside,
            max: max + beside,
        }
    }

    /// Optical depth from a point to the sun.
    fn at(&self, point: Vec3) -> f32 {
        let exact = SunDepths::EXACT_RAY_SPACINGS * self.rays.between;
        let near = depth_of(self.volume, &Ray::new(point, self.to_sun, exact));
        near + self.kept(point + self.to_sun * exact)
    }

    /// The same from the rays that are kept alone.
    fn kept(&self, point: Vec3) -> f32 {
        let p = self.volume.index_from_scene.transform_point3(point) * self.per_voxel;
        let (along, [x, y]) = self.rays.place(p.to_array());
        let last = (self.layers - 1) as f32;
        let along = if self.rays.upwards {
            last - along
        } else {
            along
        }
        .clamp(0.0, last);
        let layer = (along as usize).min(self.layers - 2);
        let f = along - layer as f32;
        let (x0, y0) = (x.floor(), y.floor());
        let (fx, fy) = (x - x0, y - y0);
        let ray = |cx: f32, cy: f32| {
            let ray = self.ray(cx, cy);
            ray.map_or(0.0, |ray| ray.at(layer) * (1.0 - f) + ray.at(layer + 1) * f)
        };
        mean_depth([
            ((1.0 - fx) * (1.0 - fy), ray(x0, y0)),
            ((1.0 - fx) * fy, ray(x0, y0 + 1.0)),
            (fx * (1.0 - fy), ray(x0 + 1.0, y0)),
            (fx * fy, ray(x0 + 1.0, y0 + 1.0)),
        ])
    }

    /// A ray; `None` if it passes beside the volume.
    fn ray(&self, x: f32, y: f32) -> Option<&DepthRay> {
        let [(first_x, nx), (first_y, ny)] = self.extent;
        let (i, j) = (x - first_x as f32, y - first_y as f32);
        if !(i >= 0.0 && j >= 0.0 && i < nx as f32 && j < ny as f32) {
            return None;
        }
        let row = self.rows[j as usize].get_or_init(|| (0..nx).map(|_| OnceLock::new()).collect());
        Some(row[i as usize].get_or_init(|| self.pass([x, y])))
    }

    fn pass(&self, ray: [f32; 2]) -> DepthRay {
        let first = if self.rays.upwards {
            self.layers - 1
        } else {
            0
        };
        let origin = self.volume.scene_from_index;
        let origin = origin
            .transform_point3(self.rays.point(ray, first).as_dvec3())
            .as_vec3();
        // From the sun on.
        let mut depths = vec![0.0; self.layers];
        let mut tau = 0.0_f64;
        let mut layer = 1;
        if let Some(cells) = Cells::new(self.volume, &Ray::endless(origin, -self.to_sun)) {
            cells.each(|cell| {
                while layer < self.layers {
                    let t = self.rays.between * layer as f32;
                    if t >= cell.far {
                        break;
                    }
                    let share = ((t - cell.near) / (cell.far - cell.near)).max(0.0);
                    depths[layer] = (tau + f64::from(cell.tau * share)) as f32;
                    layer += 1;
                }
                tau += f64::from(cell.tau);
                true
            });
        }
        depths[layer..].fill(tau as f32);
        let total = tau as f32;
        let first = depths.iter().take_while(|&&d| d == 0.0).count();
        let grown = depths.iter().take_while(|&&d| d < total).count();
        let end = (grown + 1).clamp(first, depths.len());
        DepthRay {
            first,
            depths: depths[first..end].into(),
        }
    }
}

fn depth_of(volume: &Volume, ray: &Ray) -> f32 {
    Cells::new(volume, ray).map_or(0.0, |c| c.optical_depth() as f32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::exp::exp_neg;
    use crate::math::sampling;
    use crate::scene::{Grid, LightInput, SceneBuilder, VolumeInput};
    use glam::{DAffine3, DQuat, DVec3};

    #[test]
    fn depths_towards_a_sun_agree_with_rays_of_their_own() {
        let sigma_t = Grid::from_fn([40, 28, 33], |[i, j, k]| {
            let p = Vec3::new(i as f32 - 20.0, j as f32 - 14.0, k as f32 - 16.0) / 13.0;
            4.0 * (1.0 - p.length()).max(0.0)
        });
        let scene_from_index = DAffine3::from_scale_rotation_translation(
            DVec3::new(0.05, 0.08, 0.04),
            DQuat::from_rotation_y(0.7) * DQuat::from_rotation_x(-0.4),
            DVec3::new(3.0, -1.0, 2.0),
        );
        let volume = Volume::new("ball".into(), sigma_t, [0.5; 3], scene_from_index);
        let mut squares = [0.0; 2];
        for i in 0..30 {
            let to_sun = sampling::sphere(sampling::r2(i, [0.2; 2]));
            let map = VolumeDepth::new(&volume, to_sun);
            for j in 0..50 {
                let u = sampling::r2(j, [0.4, 0.9]);
                let w = sampling::unit(sampling::hash(&[j, i]));
                // Beside the volume, too.
                let at = DVec3::new(f64::from(u[0]), f64::from(u[1]), f64::from(w)) * 1.4 - 0.2;
                let p = scene_from_index.transform_point3(at * DVec3::new(40.0, 28.0, 33.0));
                let p = p.as_vec3();
                let exact = depth_of(&volume, &Ray::endless(p, to_sun));
                for (square, got) in squares.iter_mut().zip([map.at(p), map.kept(p)]) {
                    let error = exp_neg(got) - exp_neg(exact);
                    assert!(error.abs() < 0.04, "{got} for {exact} at {at}");
                    *square += error * error / 1500.0;
                }
            }
        }
        let [rms, rms_kept] = squares.map(f32::sqrt);
        assert!(
            rms < 0.7 * rms_kept && rms_kept < 0.01,
            "{rms} and {rms_kept}"
        );
    }

    #[test]
    fn surfaces_are_behind_kept_rays_where_voxels_are_many() {
        let puffs = Grid::from_fn([128; 3], |at| {
            let p = Vec3::from(at.map(|i| i as f32 - 63.5)) / 64.0;
            let wave = |x: f32| 0.5 + 0.5 * libm::sinf(9.0 * x);
            if p.length() > 0.95 {
                0.0
            } else {
                0.05 * wave(p.x) * wave(p.y) * wave(p.z)
            }
        });
        let place = DAffine3::from_scale(DVec3::splat(1.0 / 64.0));
        let puffs = VolumeInput::new("puffs", puffs, [0.5; 3], place);
        let sun = LightInput::sun([0.3, -1.0, 0.2], [1.0; 3], 0.0).unwrap();
        let scene = SceneBuilder::new("test").volume(puffs).light(sun);
        let scene = scene.build().unwrap();
        let tracer = Tracer::new(&scene);
        let to_sun = SunDepths::direction(&scene.lights[0]).unwrap();
        let made = |in_cells: bool| {
            let suns = SunDepths::new(&tracer, |_| in_cells);
            suns.make_in_cells(&|| Ok(())).unwrap();
            suns
        };
        let suns = made(true);
        let media: &dyn ShadowMedia<f32> = suns.before_sun(0).unwrap();
        // Below the volume, beside it and in it.
        let (mut squares, mut sum) = (0.0_f32, [0.0_f32; 2]);
        for i in 0..400 {
            let [u, v] = sampling::r2(i, [0.1, 0.6]).map(|u| 3.0 * u - 0.5);
            let ray = Ray::endless(Vec3::new(u, (i % 3) as f32 * 0.6 - 0.8, v), to_sun);
            let depths = [
                media.optical_depth(&tracer, &ray),
                depth_of(&scene.volumes[0], &ray),
            ];
            let [found, exact] = depths.map(exp_neg);
            squares += (found - exact) * (found - exact) / 400.0;
            sum = [sum[0] + found, sum[1] + exact];
        }
        assert!(squares.sqrt() < SunDepths::MAX_ERROR as f32, "{squares}");
        assert!((sum[0] / sum[1] - 1.0).abs() < 2e-3, "{sum:?}");
        let others = made(false);
        let others: Option<&dyn ShadowMedia<f32>> = others.before_sun(0);
        assert!(others.is_none());
    }
}

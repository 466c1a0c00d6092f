//! Light of suns and of a kept sky in the voxels of a brick: known at their corners, interpolated
//! between. Deep voxels ask for it at dozens of points each.

use super::baked_depth::BakedDepth;
use super::kept_light::KeptLight;
use super::lights::Lights;
use super::shading_point::INVERSE_SPHERE;
use super::shadows::{SceneMedia, ShadowMedia};
use crate::math::{Ray, Rgb, Spectrum};
use crate::scene::{Light, Volume};
use glam::{DVec3, Vec3};
use std::cell::OnceCell;

/// Corners along an edge of a brick.
const CORNERS: usize = VoxelLight::<f32>::VOXELS + 1;

/// The light in a brick of a volume, if all lights are parallel ones and a sky that is kept.
#[derive(Debug)]
pub struct VoxelLight<'a, K = f32> {
    lights: &'a Lights<'a, SceneMedia<'a, K>>,
    kept: &'a KeptLight<'a>,
    volume: &'a Volume,
    /// Its first voxel.
    first: DVec3,
    suns: Vec<Parallel<'a, K>>,
    /// At corners of voxels, x fastest.
    corners: Vec<OnceCell<Corner<K>>>,
}

/// A parallel light.
#[derive(Debug)]
struct Parallel<'a, K> {
    to_sun: Vec3,
    /// Its mean over the sphere.
    radiance: Rgb,
    media: &'a dyn ShadowMedia<K>,
}

/// Light at a corner of voxels.
#[derive(Debug)]
struct Corner<K> {
    /// Depth towards each sun, and whether light of it may arrive: where any is left, whether no
    /// surface is before it.
    suns: Box<[(K, bool)]>,
    /// Of the sky.
    sky: Rgb,
}

impl<'a, K: Spectrum> VoxelLight<'a, K> {
    /// Voxels along an edge of a brick.
    pub const VOXELS: usize = 8;
    /// Share of the depth between corners that is that of their mean light; the rest is the mean of
    /// their depths. Depths alone darken deep voxels by 4 % (a CT scan) and 0.6 % (a cloud), light
    /// alone brightens them by 14 and 3 %.
    const BY_LIGHT: f32 = 0.25;
    /// Depth from corner to corner from which on it is less: within one so deep all but the depth
    /// along the ray is too small to tell.
    const FLAT_SPREAD: f32 = 3.0;

    /// The light in the brick that begins at a voxel; `None` if there are lights of other kinds.
    #[must_use]
    pub fn new(
        lights: &'a Lights<'a, SceneMedia<'a, K>>,
        kept: &'a KeptLight<'a>,
        volume: &'a Volume,
        first: [usize; 3],
    ) -> Option<Self> {
        /// Each takes memory at each corner.
        const MOST_SUNS: usize = 8;
        let has_extended = !lights.emitters.is_empty() || lights.glow.is_some();
        if has_extended || lights.groups.is_some() || !kept.knows_sky(lights) {
            return None;
        }
        let all = lights.tracer.scene.lights.iter().enumerate();
        let others = all.filter(|(_, light)| !matches!(light, Light::Environment { .. }));
        let sun = |(index, light): (usize, &Light)| match *light {
            Light::Directional {
                direction,
                irradiance,
                angular_radius_rad: 0.0,
            } => Some(Parallel {
                to_sun: -direction,
                radiance: Rgb(irradiance) * INVERSE_SPHERE,
                media: kept.sun(index)?,
            }),
            _ => None,
        };
        let suns: Vec<_> = others.map(sun).collect::<Option<_>>()?;
        (suns.len() <= MOST_SUNS).then(|| Self {
            lights,
            kept,
            volume,
            first: DVec3::from(first.map(|n| n as f64)),
            suns,
            corners: (0..CORNERS.pow(3)).map(|_| OnceCell::new()).collect(),
        })
    }

    /// Whether no light gets to the corners of a voxel of the brick.
    #[must_use]
    pub fn is_dark(&self, voxel: [usize; 3]) -> bool {
        self.around(voxel).iter().all(|corner| {
            let is_dark =
                |(depth, arrives): &(K, bool)| !arrives || depth.least() >= BakedDepth::NO_LIGHT;
            corner.suns.iter().all(is_dark) && corner.sky.is_black()
        })
    }

    /// Mean over the sphere of the direct radiance at a point of a voxel of the brick, from the
    /// voxel's first corner, in voxels; and of its mean channel times the direction in which it
    /// travels, where light of the sky travels all ways alike.
    #[must_use]
    pub fn at(&self, voxel: [usize; 3], place: [f32; 3]) -> (Rgb, Vec3) {
        let corners = self.around(voxel);
        let weight = |i: usize| -> f32 {
            let along = |a: usize| match i >> a & 1 {
                0 => 1.0 - place[a],
                _ => place[a],
            };
            along(0) * along(1) * along(2)
        };
        let weights: [f32; 8] = std::array::from_fn(weight);
        let (mut light, mut way) = (Rgb::BLACK, Vec3::ZERO);
        for (corner, &weight) in corners.iter().zip(&weights) {
            light += corner.sky * weight;
        }
        for (s, sun) in self.suns.iter().enumerate() {
            let (mut depth, mut through, mut arriving) = (K::default(), K::default(), 0.0);
            let (mut least, mut most) = (f32::INFINITY, 0.0_f32);
            for (corner, &weight) in corners.iter().zip(&weights) {
                let (tau, arrives) = corner.suns[s];
                depth += tau * weight;
                through += tau.exp_neg() * weight;
                (least, most) = (least.min(tau.most()), most.max(tau.most()));
                arriving += if arrives { weight } else { 0.0 };
            }
            let mean = match depth.most() > 0.0 {
                true => through.each(|through| -libm::logf(through.max(1e-30))),
                false => K::default(),
            };
            let spread = (most - least) * (1.0 / Self::FLAT_SPREAD);
            let by_light = Self::BY_LIGHT / (1.0 + spread * spread * spread * spread);
            let depth = depth + (mean - depth) * by_light;
            let of_sun = (depth.exp_neg() * arriving).filter(sun.radiance);
            light += of_sun;
            way -= sun.to_sun * of_sun.mean();
        }
        (light, way)
    }

    fn around(&self, voxel: [usize; 3]) -> [&Corner<K>; 8] {
        std::array::from_fn(|i| self.corner([0, 1, 2].map(|a| voxel[a] + (i >> a & 1))))
    }

    fn corner(&self, at: [usize; 3]) -> &Corner<K> {
        self.corners[(at[2] * CORNERS + at[1]) * CORNERS + at[0]].get_or_init(|| {
            let at = self.first + DVec3::from(at.map(|n| n as f64));
            let point = self.volume.scene_from_index.transform_point3(at).as_vec3();
            let sun = |sun: &Parallel<K>| {
                let ray = Ray::endless(point, sun.to_sun);
                let depth = sun.media.optical_depth(self.lights.tracer, &ray);
                match depth.least() >= BakedDepth::NO_LIGHT || sun.media.is_dark(point) {
                    true => (depth.each(|d| d.max(BakedDepth::NO_LIGHT)), true),
                    false => (depth, !self.lights.tracer.is_occluded(&ray)),
                }
            };
            Corner {
                suns: self.suns.iter().map(sun).collect(),
                sky: self.kept.sky_at(self.lights, point),
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::sampling;
    use crate::scene::{Grid, LightInput, MeshInput, SceneBuilder, VolumeInput};
    use crate::trace::Tracer;
    use glam::DAffine3;

    #[test]
    fn light_between_corners_is_that_of_rays_of_their_own() {
        let grid = Grid::from_fn([16; 3], |_| 0.5);
        let volume = VolumeInput::new("box", grid, [0.9; 3], DAffine3::IDENTITY);
        let sun = LightInput::sun([0.3, -0.9, 0.2], [5.0; 3], 0.0).unwrap();
        let corners = [[-90.0, -1.0, -90.0], [0.0, -1.0, 90.0], [90.0, -1.0, -90.0]];
        let floor = MeshInput::new("floor", corners, vec![[0, 1, 2]]);
        let scene = SceneBuilder::new("test")
            .volume(volume)
            .light(sun)
            .mesh(floor);
        let scene = scene.build().unwrap();
        let tracer = Tracer::new(&scene);
        let lights = Lights::<SceneMedia>::new(&tracer);
        let kept = KeptLight::new(&Tracer::new(&scene), || Ok(())).unwrap();
        let first = [0, 8, 8];
        let light = VoxelLight::new(&lights, &kept, &scene.volumes[0], first).unwrap();
        let (mut ratio, mut squares) = ([0.0; 2], 0.0);
        for i in 0..400_u64 {
            let unit = |n: u64| sampling::unit(sampling::hash(&[i, n]));
            let voxel = [0, 1, 2].map(|a| (unit(a) * 8.0) as usize);
            let place = [3, 4, 5].map(unit);
            let at: [f32; 3] = std::array::from_fn(|a| (first[a] + voxel[a]) as f32 + place[a]);
            let rays = crate::light::ShadowRays::Sequence {
                per_light: 1,
                first: 0,
                seed: 0,
            };
            let exact = lights.mean_radiance(at.into(), rays).light().mean();
            let (found, way) = light.at(voxel, place);
            let found = found.mean();
            assert!((way.length() - found).abs() < 1e-5 && way.y <= 0.0);
            let off = f64::from((found - exact) / exact);
            squares += off * off;
            // At edges of the box the sun comes in through another face.
            assert!(
                (found - exact).abs() < 0.5 * exact + 0.01,
                "{found} {exact}"
            );
            ratio[0] += found;
            ratio[1] += exact;
        }
        let rms = (squares / 400.0_f64).sqrt();
        assert!(rms < 0.1, "{rms}");
        assert!((ratio[0] / ratio[1] - 1.0).abs() < 0.03, "{ratio:?}");
    }

    #[test]
    fn what_is_behind_a_surface_or_deep_is_dark() {
        let grid = Grid::from_fn([32, 32, 32], |_| 4.0);
        let volume = VolumeInput::new("box", grid, [0.9; 3], DAffine3::IDENTITY);
        let sun = LightInput::sun([0.0, -1.0, 0.0], [5.0; 3], 0.0).unwrap();
        // Above the half of the volume that has small x.
        let corners = [
            [16.0, 40.0, -900.0],
            [16.0, 40.0, 900.0],
            [-900.0, 40.0, 0.0],
        ];
        let roof = MeshInput::new("roof", corners, vec![[0, 1, 2]]);
        let scene = SceneBuilder::new("test")
            .volume(volume)
            .light(sun)
            .mesh(roof);
        let scene = scene.build().unwrap();
        let tracer = Tracer::new(&scene);
        let lights = Lights::<SceneMedia>::new(&tracer);
        let kept = KeptLight::new(&Tracer::new(&scene), || Ok(())).unwrap();
        let is_dark = |first| {
            let light = VoxelLight::new(&lights, &kept, &scene.volumes[0], first).unwrap();
            light.is_dark([4, 7, 4])
        };
        assert!(is_dark([8, 24, 8]) && !is_dark([16, 24, 8]) && is_dark([16, 8, 8]));
    }
}

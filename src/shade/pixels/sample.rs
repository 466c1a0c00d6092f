//! Samples of a pixel.

use crate::light::DirectLight;
use crate::math::Rgb;
use crate::shade::pixels::camera_media::PassedMedia;
use crate::shade::settings::Settings;
use crate::trace::Surface;
use glam::Vec3;

/// One primary ray.
#[derive(Clone, Copy)]
pub struct Sample<T: PassedMedia> {
    /// The nearest surface, `None` if it met none.
    pub surface: Option<Surface>,
    /// Index of the triangle that this is on; `u32::MAX` for none.
    pub triangle: u32,
    /// Whether a mask had a say in where it ends: rays beside it may end elsewhere.
    pub is_masked: bool,
    /// How far away, scene units; infinite if nothing.
    pub t: f32,
    /// Unit direction from the camera, scene space.
    pub direction: Vec3,
    /// Direct irradiance there.
    pub direct: DirectLight,
    /// Media on the way.
    pub passed: T,
}

impl<T: PassedMedia> Sample<T> {
    /// The surface, if light on it or beside is seen.
    pub fn lit_surface(&self) -> Option<&Surface> {
        self.surface.as_ref().filter(|s| s.reflects)
    }

    /// This sample on a surface of another albedo.
    pub fn with_albedo(mut self, albedo: Rgb) -> Self {
        if let Some(surface) = &mut self.surface {
            surface.albedo = albedo;
        }
        self
    }

    /// Where a ray between some others would end, if all of those end on one smooth triangle of one
    /// albedo; light and media not yet looked for.
    pub fn amid<const N: usize>(around: [&Self; N]) -> Option<Self> {
        let first = around[0];
        let like = first.lit_surface()?;
        let mut surface = *like;
        // Small, so that their sum rounds little.
        let mut away = Vec3::ZERO;
        let (mut normal, mut direction, mut t) = (Vec3::ZERO, Vec3::ZERO, 0.0);
        for sample in around {
            let other = sample.surface.as_ref()?;
            if sample.triangle != first.triangle
                || sample.is_masked
                || other.albedo != like.albedo
                || !like.faces_as(other)
            {
                return None;
            }
            away += other.position - like.position;
            normal += other.normal;
            direction += sample.direction;
            t += sample.t;
        }
        let share = 1.0 / N as f32;
        surface.position += away * share;
        surface.normal = normal.normalize();
        Some(Self {
            surface: Some(surface),
            triangle: first.triangle,
            is_masked: false,
            t: t * share,
            direction: direction.normalize(),
            direct: DirectLight::default(),
            passed: T::default(),
        })
    }
}

/// How many samples a pixel has, and what it looks at.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SampleCounts {
    /// Always taken; 1 for the pixel's corners, which neighbours share.
    pub pixel: u32,
    /// Corners from one ray to the next where those around end on one triangle, 1 or 2.
    pub corner_spacing: u32,
    /// Taken where those disagree.
    pub edge: u32,
    /// Shadow rays to lights with an extent, at each of those; shared corners take a number of
    /// their own.
    pub shadow: u32,
    /// Gather rays of each vertex in media.
    pub volume: u32,
}

impl SampleCounts {
    /// Times as many samples in pixels in which masks have a say: these have many edges, and short
    /// ones. A tree has half the error in 1.3 times the time.
    const OF_MASKS: u32 = 3;

    /// Samples taken where corners disagree, in a pixel in which masks have a say or not.
    pub fn edge_of(&self, is_masked: bool) -> u32 {
        match is_masked {
            true => self.edge.saturating_mul(Self::OF_MASKS),
            false => self.edge,
        }
    }

    /// As settings ask.
    pub fn of(settings: &Settings) -> Self {
        Self {
            pixel: settings.pixel_samples,
            corner_spacing: settings.corner_spacing,
            edge: settings.edge_samples,
            shadow: settings.shadow_rays,
            volume: settings.volume_samples,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::Vacuum;
    use crate::scene::{Material, Scene};

    /// A sample at a point of one of two triangles of a square.
    fn sample(triangle: u32, uv: [f32; 2]) -> Sample<Vacuum> {
        let mut scene = Scene::without_picture();
        let corners = [
            [0.0, 0.0, 0.0],
            [1.0, 0.0, 0.0],
            [0.0, 1.0, 0.0],
            [1.0, 1.0, 0.0],
        ];
        scene.mesh.positions = corners.map(Vec3::from).to_vec().into();
        scene.mesh.triangles = vec![[0, 1, 2], [2, 1, 3]].into();
        scene.mesh.material = vec![0, 0].into();
        scene.materials = vec![Material::diffuse("", [0.5; 3])];
        let surface = Surface::new(&scene, triangle, uv);
        Sample {
            surface: Some(surface),
            triangle,
            is_masked: false,
            t: 2.0 + uv[0],
            direction: Vec3::new(uv[0], uv[1], -1.0).normalize(),
            direct: DirectLight::default(),
            passed: Vacuum,
        }
    }

    #[test]
    fn between_like_samples_is_their_mean() {
        let around = [
            sample(0, [0.2, 0.2]),
            sample(0, [0.4, 0.2]),
            sample(0, [0.2, 0.4]),
            sample(0, [0.4, 0.4]),
        ];
        let mean = Sample::amid(around.each_ref()).unwrap();
        let position = mean.surface.unwrap().position;
        assert!(
            position.distance(Vec3::new(0.3, 0.3, 0.0)) < 1e-6,
            "{position}"
        );
        assert!((mean.t - 2.3).abs() < 1e-6);
        assert!((mean.direction.length() - 1.0).abs() < 1e-6);
        assert_eq!(mean.triangle, 0);
    }

    #[test]
    fn nothing_is_told_between_samples_that_differ() {
        let like = sample(0, [0.2, 0.2]);
        let mut painted = sample(0, [0.4, 0.2]);
        painted.surface.as_mut().unwrap().albedo = Rgb([0.4, 0.5, 0.5]);
        let mut tilted = sample(0, [0.4, 0.2]);
        tilted.surface.as_mut().unwrap().normal = Vec3::new(0.1, 0.0, 1.0).normalize();
        let mut gone = sample(0, [0.4, 0.2]);
        (gone.surface, gone.triangle) = (None, u32::MAX);
        let across = sample(1, [0.4, 0.2]);
        let mut masked = sample(0, [0.4, 0.2]);
        masked.is_masked = true;
        for (name, other) in [
            ("painted", painted),
            ("tilted", tilted),
            ("gone", gone),
            ("across", across),
            ("masked", masked),
        ] {
            assert!(Sample::amid([&like, &other]).is_none(), "{name}");
            assert!(Sample::amid([&other, &like]).is_none(), "{name}");
        }
        assert!(Sample::amid([&like, &like]).is_some());
    }
}

//! The light of emissive media along a ray.

use super::Tracer;
use super::cells::Cells;
use crate::math::exp::one_minus_exp_neg;
use crate::math::segment::Segment;
use crate::math::{Ray, Rgb, Spectrum};
use crate::scene::{Emission, EmissiveVolume};

/// Gives the light of each cell of an emissive volume that a ray passes to `add`, front to back,
/// with where the cell begins and ends: the integral of what is sent per unit of length.
pub fn each_emitting_cell(
    volume: &EmissiveVolume,
    ray: &Ray,
    mut add: impl FnMut(f32, f32, Rgb) -> bool,
) {
    /// Two points that integrate cubics exactly (Gauss-Legendre).
    const POINTS: [f32; 2] = [0.211_324_87, 0.788_675_1];
    let Some(cells) = Cells::new(&volume.values, ray) else {
        return;
    };
    cells.each(|cell| {
        let (near, far) = (cell.near, cell.far);
        let light = match volume.emission {
            // The integral of the values is known.
            Emission::Proportional { radiance } => Rgb(radiance) * cell.tau,
            emission @ Emission::Blackbody { .. } => {
                let at = |share: f32| {
                    let point = ray.at(near + (far - near) * share);
                    let in_index = volume.values.index_from_scene.transform_point3(point);
                    emission.of(volume.values.sigma_t.sample(in_index))
                };
                let [first, second] = POINTS.map(at);
                (first + second) * (0.5 * (far - near))
            }
        };
        add(near, far, light)
    });
}

impl Tracer<'_> {
    /// Radiance that emissive media send to the origin of a ray, through the media before them.
    #[must_use]
    pub fn emitted<K: Spectrum>(&self, ray: &Ray) -> Rgb {
        /// Optical depth behind which nothing is seen.
        const OPAQUE: f32 = 70.0;
        let mut sum = Rgb::BLACK;
        let mut depths: Option<Depths<K>> = None;
        for volume in &self.scene.emissive {
            let mut walk = 0;
            each_emitting_cell(volume, ray, |near, far, light| {
                let depths = depths.get_or_insert_with(|| Depths::along(self, ray, OPAQUE));
                let before = depths.at(near, &mut walk);
                let within = depths.at(far, &mut walk) - before;
                let within = mean_transmittance(within);
                sum += before.exp_neg().times(within).filter(light);
                before.least() < OPAQUE
            });
        }
        sum
    }
}

/// Mean transmittance from the points of an even stretch of a medium to its end.
fn mean_transmittance<K: Spectrum>(tau: K) -> K {
    const THIN: f32 = 1e-3;
    tau.each(|tau| match tau < THIN {
        true => 1.0 - 0.5 * tau,
        false => one_minus_exp_neg(tau) / tau,
    })
}

/// The optical depth of all media along a ray.
struct Depths<K>(Vec<Stretch<K>>);

/// A part of a ray in media, and the depth of all before it.
#[derive(Clone, Copy, Debug)]
struct Stretch<K> {
    near: f32,
    far: f32,
    before: K,
    tau: K,
}

impl<K: Spectrum> Depths<K> {
    fn along(tracer: &Tracer, ray: &Ray, most: f32) -> Self {
        let mut all = Vec::new();
        let mut before = K::default();
        tracer.march(
            ray,
            |_, _, _| Rgb::BLACK,
            |s: Segment<K>| {
                all.push(Stretch {
                    near: s.near,
                    far: s.far,
                    before,
                    tau: s.tau,
                });
                before += s.tau;
                before.least() < most
            },
        );
        Self(all)
    }

    /// The depth from the origin to a distance. `walk` is where the last search ended; distances do
    /// not fall from one to the next.
    fn at(&self, t: f32, walk: &mut usize) -> K {
        while self.0.get(*walk).is_some_and(|s| s.far <= t) {
            *walk += 1;
        }
        match (self.0.get(*walk), walk.checked_sub(1)) {
            (Some(s), _) => {
                let share = ((t - s.near) / (s.far - s.near)).clamp(0.0, 1.0);
                s.before + s.tau * share
            }
            (None, Some(last)) => self.0[last].before + self.0[last].tau,
            (None, None) => K::default(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{EmissiveInput, Grid, SceneBuilder, VolumeInput};
    use glam::{DAffine3, DVec3, Vec3};

    fn scene(emission: Emission, value: f32, sigma_t: f32, moved: f64) -> crate::scene::Scene {
        let cube = |value: f32| Grid::from_fn([16; 3], |_| value);
        let place = DAffine3::from_scale(DVec3::splat(1.0 / 16.0));
        let before = DAffine3::from_translation(DVec3::new(0.0, 0.0, moved)) * place;
        let builder = SceneBuilder::new("fire").emissive(EmissiveInput::new(
            "fire",
            cube(value),
            emission,
            place,
        ));
        let smoke = || VolumeInput::new("smoke", cube(sigma_t), [0.0; 3], before);
        let builder = match sigma_t > 0.0 {
            true => builder.volume(smoke()),
            false => builder,
        };
        builder.build().expect("the scene is right")
    }

    fn seen(scene: &crate::scene::Scene) -> Rgb {
        let tracer = Tracer::new(scene);
        tracer.emitted::<f32>(&Ray::endless(Vec3::new(0.43, 0.51, 5.0), -Vec3::Z))
    }

    #[test]
    fn light_is_the_integral_of_what_is_sent() {
        let radiance = [3.0, 2.0, 0.5];
        let even = Emission::Proportional { radiance };
        let found = seen(&scene(even, 2.0, 0.0, 0.0));
        for (found, sent) in found.0.into_iter().zip(radiance) {
            assert!((found - 2.0 * sent).abs() < 1e-5, "{found} {sent}");
        }
        let hot = Emission::Blackbody { scale: 0.5 };
        let found = seen(&scene(hot, 1800.0, 0.0, 0.0));
        let expected = hot.of(1800.0);
        assert!((found.0[0] / expected.0[0] - 1.0).abs() < 1e-5, "{found:?}");
    }

    #[test]
    fn media_take_of_it_what_they_take_of_all_light() {
        let even = Emission::Proportional { radiance: [1.0; 3] };
        // Within its smoke, of depth 1.5 over the unit that it is wide, and behind that.
        let within = seen(&scene(even, 1.0, 1.5, 0.0)).0[0];
        assert!(
            (within - (1.0 - (-1.5_f32).exp()) / 1.5).abs() < 2e-3,
            "{within}"
        );
        let behind = seen(&scene(even, 1.0, 1.5, 1.0)).0[0];
        assert!((behind - (-1.5_f32).exp()).abs() < 2e-3, "{behind}");
        let before = seen(&scene(even, 1.0, 1.5, -1.0)).0[0];
        assert!((before - 1.0).abs() < 1e-5, "{before}");
    }
}

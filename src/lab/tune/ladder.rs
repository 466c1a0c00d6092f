//! Settings from coarse to fine, near the Pareto front of error against run time.

use crate::shade::Settings;

/// The finest rung.
pub const FINEST: f64 = (RUNGS.len() - 1) as f64;

/// What rungs differ in.
struct Rung {
    samples: u32,
    max_solid_angle: f32,
    patch_surfels: u32,
    lattice: u32,
    volume_samples: u32,
    edge_samples: u32,
    shadow_rays: u32,
}

/// From each to the next noise falls by 1.7 to 4 times. All pixels share the samples at their
/// corners: samples of their own cost more at the same error (`docs/gather.md`).
const RUNGS: [Rung; 8] = {
    const fn row(counts: [u32; 5], max_solid_angle: f32, patch_surfels: u32) -> Rung {
        let [samples, lattice, volume_samples, edge_samples, shadow_rays] = counts;
        Rung {
            samples,
            max_solid_angle,
            patch_surfels,
            lattice,
            volume_samples,
            edge_samples,
            shadow_rays,
        }
    }
    [
        row([4, 16, 1, 2, 1], 0.04, 32),
        row([4, 8, 2, 3, 1], 0.04, 32),
        row([8, 6, 4, 4, 1], 0.03, 32),
        row([12, 4, 4, 6, 1], 0.02, 32),
        row([32, 4, 8, 16, 1], 0.01, 1),
        row([64, 3, 16, 32, 1], 0.01, 1),
        row([128, 2, 32, 48, 1], 0.005, 1),
        row([256, 2, 64, 128, 1], 0.0025, 1),
    ]
};

/// The settings of a place on the ladder, 0 to [`FINEST`]; between rungs they are interpolated.
#[must_use]
pub fn rung(place: f64) -> Settings {
    let place = place.clamp(0.0, FINEST);
    let below = (place as usize).min(RUNGS.len() - 2);
    let (a, b) = (&RUNGS[below], &RUNGS[below + 1]);
    let f = place - below as f64;
    let mix = |a: f64, b: f64| a * libm::pow(b / a, f);
    let count = |a: u32, b: u32| mix(a.into(), b.into()).round() as u32;
    Settings {
        samples: count(a.samples, b.samples),
        max_solid_angle: mix(a.max_solid_angle.into(), b.max_solid_angle.into()) as f32,
        patch_surfels: count(a.patch_surfels, b.patch_surfels),
        lattice: count(a.lattice, b.lattice),
        volume_samples: count(a.volume_samples, b.volume_samples),
        pixel_samples: 1,
        edge_samples: count(a.edge_samples, b.edge_samples),
        shadow_rays: count(a.shadow_rays, b.shadow_rays),
        ..Settings::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_ladder_rises_everywhere() {
        let places: Vec<Settings> = (0..=140).map(|i| rung(f64::from(i) * 0.05)).collect();
        assert_eq!(places[0].samples, RUNGS[0].samples);
        assert_eq!(places[140].samples, RUNGS[7].samples);
        for pair in places.windows(2) {
            assert!(pair[0].samples <= pair[1].samples);
            assert!(pair[0].lattice >= pair[1].lattice);
            assert!(pair[0].volume_samples <= pair[1].volume_samples);
            assert!(pair[0].edge_samples <= pair[1].edge_samples);
            assert!(pair[0].shadow_rays <= pair[1].shadow_rays);
            assert!(pair[0].max_solid_angle >= pair[1].max_solid_angle);
            assert!(pair[0].patch_surfels >= pair[1].patch_surfels);
            pair[1].check().unwrap();
        }
    }
}

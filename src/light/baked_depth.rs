//! Optical depth of a volume towards a sun as bakes need it: light counts, not depth. Where next to
//! none gets, rays that are kept tell so; elsewhere a ray is exact as far as they are not near
//! enough.

use super::checks::{Checks, Levels};
use super::coarse::CoarseVolume;
use super::kept_rays::{KeptRays, lattice};
use crate::Result;
use crate::math::Ray;
use crate::math::exp::exp_neg;
use crate::scene::Volume;
use crate::trace::Cells;
use glam::Vec3;

/// The depth of one volume towards one sun.
#[derive(Debug)]
pub struct BakedDepth<'a> {
    volume: &'a Volume,
    /// Unit direction to the sun, scene space.
    to_sun: Vec3,
    /// None of an empty volume.
    kept: Option<KeptRays>,
    /// Distance from a point up to which its ray is exact.
    exact: f32,
    /// Kept depth beyond which no light gets.
    dark: f32,
}

impl<'a> BakedDepth<'a> {
    /// Depth behind which there is no light worth a cell: a millionth is left.
    pub const NO_LIGHT: f32 = 14.0;
    /// Layers of cells that are passed exactly before kept rays take over, if fewer are not enough.
    const EXACT_LAYERS: [f32; 2] = [6.0, 12.0];
    /// Kept depths beyond which there may be no light.
    const DARK: [f32; 3] = [8.0, 12.0, 16.0];
    /// Share of all light that may be lost there, and of a sun at one point.
    const LOST: [f32; 2] = [1e-4, 2e-3];

    /// Finds by exact rays what is to be kept, the cheapest that is near enough.
    ///
    /// # Errors
    /// That of `go_on`, or no room for rays.
    pub fn new(
        volume: &'a Volume,
        to_sun: Vec3,
        levels: &Levels,
        checks: &Checks,
        go_on: &impl Fn() -> Result<()>,
    ) -> Result<Self> {
        let mut depth = Self {
            volume,
            to_sun,
            kept: None,
            exact: 0.0,
            dark: f32::INFINITY,
        };
        let mut between = 0.0;
        for level in levels.coarse_to_fine() {
            go_on()?;
            let (rays, layer) = Self::rays(level, to_sun)?;
            (depth.kept, between) = (Some(rays), layer);
            if depth.is_near(checks) {
                return Ok(depth);
            }
        }
        depth.dark = depth.darkness(checks);
        for layers in Self::EXACT_LAYERS {
            go_on()?;
            depth.exact = layers * between;
            if depth.is_near(checks) {
                return Ok(depth);
            }
        }
        depth.exact = f32::INFINITY;
        Ok(depth)
    }

    fn rays(level: &CoarseVolume, to_sun: Vec3) -> Result<(KeptRays, f32)> {
        let lattice = lattice(level, to_sun);
        let rays = KeptRays::new(level, &level.layers(lattice.axes), lattice)?;
        Ok((rays, lattice.between))
    }

    fn is_near(&self, checks: &Checks) -> bool {
        checks.are_met(Checks::MAX_ERROR, |point| exp_neg(self.at(point)))
    }

    /// The least kept depth beyond which exact rays found no light.
    fn darkness(&self, checks: &Checks) -> f32 {
        let all: f32 = checks.0.iter().map(|(_, share)| share).sum();
        let is_dark = |dark: f32| {
            let shares = checks.0.iter().filter(|(p, _)| self.is_beyond(*p, dark));
            let (sum, most) = shares.fold((0.0, 0.0_f32), |(sum, most), (_, share)| {
                (sum + share, most.max(*share))
            });
            sum <= Self::LOST[0] * all && most <= Self::LOST[1]
        };
        let found = Self::DARK.into_iter().find(|&dark| is_dark(dark));
        found.map_or(f32::INFINITY, |dark| dark / self.volume.clearest())
    }

    fn is_beyond(&self, point: Vec3, depth: f32) -> bool {
        self.kept
            .as_ref()
            .is_some_and(|k| k.is_beyond(point, depth))
    }

    /// Whether no light of the sun gets to a point.
    #[must_use]
    pub fn is_dark(&self, point: Vec3) -> bool {
        self.dark < f32::INFINITY && self.is_beyond(point, self.dark)
    }

    /// Optical depth from a point to the sun; where next to no light gets, any that is about as
    /// deep.
    #[must_use]
    pub fn at(&self, point: Vec3) -> f32 {
        let Some(kept) = &self.kept else {
            return 0.0;
        };
        if self.exact == 0.0 || self.is_dark(point) {
            return kept.depth(point);
        }
        let ray = Ray::new(point, self.to_sun, self.exact);
        let mut near = 0.0;
        let no_light = Self::NO_LIGHT / self.volume.clearest();
        if let Some(cells) = Cells::new(self.volume, &ray) {
            cells.each(|cell| {
                near += cell.tau;
                near < no_light
            });
        }
        if self.exact == f32::INFINITY || near >= no_light {
            near
        } else {
            near + kept.depth(point + self.to_sun * self.exact)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::sampling;
    use crate::scene::Grid;
    use glam::DAffine3;

    fn volume(sigma_t: impl Fn([usize; 3]) -> f32 + Sync) -> Volume {
        let grid = Grid::from_fn([48; 3], sigma_t);
        Volume::new("test".into(), grid, [0.5; 3], DAffine3::IDENTITY)
    }

    /// The depth, and by how much shares of light differ in the mean and in the root mean square.
    fn depth(volume: &Volume, to_sun: Vec3, most: usize) -> (BakedDepth<'_>, f64, f64) {
        let levels = Levels::new(volume, most);
        let checks = Checks::new(volume, 1024, &[to_sun]);
        let depth = BakedDepth::new(volume, to_sun, &levels, &checks, &|| Ok(())).unwrap();
        let others = Checks::new(volume, 3000, &[to_sun]).0;
        let (mut bias, mut squares, mut sum) = (0.0, 0.0, 0.0);
        for &(point, share) in &others[1024..] {
            let difference = f64::from(exp_neg(depth.at(point)) - share);
            bias += difference;
            squares += difference * difference / 1976.0;
            sum += f64::from(share);
        }
        (depth, bias / sum, squares.sqrt())
    }

    #[test]
    fn dense_media_are_dark_but_for_their_skin() {
        // Deep within a ball, with holes that light falls through.
        let ball = volume(|v| {
            let p = Vec3::from(v.map(|i| i as f32 - 23.5));
            let is_hole = v[0] % 16 < 3 && v[2] % 16 < 3;
            let grain = sampling::unit(sampling::hash(&v.map(|i| i as u64)));
            if p.length() > 21.0 || is_hole {
                0.0
            } else {
                1.0 + grain
            }
        });
        for to_sun in [Vec3::Y, Vec3::new(0.3, -0.9, 0.2).normalize()] {
            let (depth, bias, rms) = depth(&ball, to_sun, 24 * 24 * 24);
            assert!(depth.dark <= 16.0 && depth.exact > 0.0);
            assert!(bias.abs() < 0.01 && rms < 0.015, "{bias} {rms}");
            let checks = Checks::new(&ball, 1000, &[to_sun]).0;
            let dark = checks.iter().filter(|(p, _)| depth.is_dark(*p)).count();
            assert!(dark > 300, "{dark}");
        }
    }

    #[test]
    fn few_exact_layers_are_enough_before_rays_that_nearly_are() {
        let waves = volume(|v| {
            let wave = |i: usize| libm::sinf(i as f32 * 0.9);
            0.25 * (1.0 + wave(v[0]) * wave(v[1]) * wave(v[2]))
        });
        let (depth, bias, rms) = depth(&waves, Vec3::new(0.4, 0.9, 0.2).normalize(), 24 * 24 * 24);
        assert!(depth.exact.is_finite(), "{}", depth.exact);
        assert!(bias.abs() < 0.01 && rms < 0.015, "{bias} {rms}");
    }
}

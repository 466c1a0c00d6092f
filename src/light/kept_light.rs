//! Light of suns and of a constant sky in media from rays that are kept: marched once, as far as a
//! few hundred exact rays say that this is near enough.

use super::baked_depth::BakedDepth;
use super::checks::{Checks, Levels};
use super::coarse::CoarseVolume;
use super::kept_rays::{KeptRays, lattice};
use super::lights::Lights;
use super::open_sky::OpenSky;
use super::shadow_rays::ShadowRays;
use super::shadows::{ShadowMedia, Shadows};
use super::sun_depths::SunDepths;
use crate::Result;
use crate::math::{Ray, Rgb, Spectrum, sampling, unflatten};
use crate::run::List;
use crate::scene::grid::BRICK_CELLS;
use crate::scene::{Scene, Volume};
use crate::trace::Tracer;
use glam::{Affine3A, Vec3};
use rayon::prelude::*;

/// Light in media that comes along kept rays.
#[derive(Debug)]
pub struct KeptLight<'a> {
    suns: SunDepths<'a>,
    sky: Option<Sky>,
}

impl<'a> KeptLight<'a> {
    /// Cells that the rays of all suns pass in all volumes, at most: half as many as voxels that
    /// are not empty, between these.
    const CELLS: [usize; 2] = [1 << 22, 1 << 24];
    /// Points of all volumes together at which the depths towards all suns are checked.
    const SUN_CHECKS: usize = 1024;
    /// Points at which the light of the sky is checked: of that each takes many rays.
    const SKY_CHECKS: usize = 192;

    /// Keeps what it can of the light in a scene's media. `go_on` is asked at each level.
    ///
    /// # Errors
    /// That of `go_on`, or no room for rays.
    pub fn new(tracer: &Tracer<'a>, go_on: impl Fn() -> Result<()>) -> Result<Self> {
        let scene = tracer.scene;
        let has_sky = Self::may_keep_sky(scene);
        let mut kept = Self {
            suns: SunDepths::none(scene),
            sky: None,
        };
        if scene.volumes.is_empty() || !(has_sky || Self::suns(scene) > 0) {
            return Ok(kept);
        }
        let share = |n: usize| Self::share(scene, n);
        let levels = |volume: &'a Volume| {
            let grid = &volume.sigma_t;
            let bricks = grid.bricks().filter(|b| grid.brick(*b).is_some()).count();
            Levels::new(volume, share(Self::cells(bricks)))
        };
        let volumes: Vec<_> = scene.volumes.iter().map(levels).collect();
        kept.suns = SunDepths::baked(scene, |v, to_sun| {
            let volume = &scene.volumes[v];
            let checks = Checks::new(volume, share(Self::SUN_CHECKS), &[to_sun]);
            BakedDepth::new(volume, to_sun, &volumes[v], &checks, &go_on)
        })?;
        if let Some(levels) = volumes.first().filter(|_| has_sky) {
            let volume = &scene.volumes[0];
            let has_surfaces = !scene.mesh.triangles.is_empty();
            let directions = match has_surfaces {
                false => Sky::directions(),
                true => Sky::directions_in_pairs(),
            };
            let is_open = |point: Vec3, to_sky: Vec3| {
                !(has_surfaces && tracer.is_occluded(&Ray::endless(point, to_sky)))
            };
            let checks = Checks::where_lit(volume, Self::SKY_CHECKS, &directions, is_open);
            let near = Checks::MAX_ERROR;
            let open = has_surfaces.then(|| OpenSky::new(volume, &directions, is_open));
            let sky = |coarse: &CoarseVolume| Sky::new(coarse, &directions, open.as_ref());
            kept.sky = checks.coarsest(near, levels, &go_on, sky, Sky::share)?;
        }
        Ok(kept)
    }

    /// Bytes that it takes while it is made, about.
    #[must_use]
    pub fn bytes_for(scene: &Scene) -> u64 {
        const CELL: usize = Levels::CELL_BYTES;
        const RAYS: usize = KeptRays::CELL_BYTES;
        /// For the sky, shares at corners of cells, and sums of these.
        const SHARES: usize = 8;
        let suns = Self::suns(scene);
        let sky = usize::from(Self::may_keep_sky(scene));
        if suns + sky == 0 {
            return 0;
        }
        let cells = |volume: &Volume| {
            let most = Self::cells(volume.sigma_t.stored_bricks());
            Levels::cells(volume, Self::share(scene, most))
        };
        let channels = if scene.volumes.iter().all(Volume::is_grey) {
            1
        } else {
            3
        };
        let cells: usize = scene.volumes.iter().map(cells).sum();
        (cells * (CELL + suns * RAYS + sky * (RAYS + channels * SHARES))) as u64
    }

    /// What is known of a sun, by the light's index.
    pub(super) fn sun<K: Spectrum>(&self, light: usize) -> Option<&dyn ShadowMedia<K>> {
        self.suns.of(light)
    }

    /// Whether all light of the environment is known.
    #[must_use]
    pub fn knows_sky<S: Shadows>(&self, lights: &Lights<S>) -> bool {
        self.sky.is_some() || lights.environment().is_black()
    }

    /// Mean over the sphere of the light of a sky that is kept; none of one that is not.
    pub(super) fn sky_at<S: Shadows>(&self, lights: &Lights<S>, point: Vec3) -> Rgb {
        (self.sky.as_ref()).map_or(Rgb::BLACK, |sky| sky.of(lights.even_environment(), point))
    }

    fn cells(bricks: usize) -> usize {
        let [least, most] = Self::CELLS;
        (bricks * BRICK_CELLS.pow(3) / 2).clamp(least, most)
    }

    fn suns(scene: &Scene) -> usize {
        scene.lights.iter().filter_map(SunDepths::direction).count()
    }

    /// Other volumes may hide any part of the sky from any point, and surfaces as well: where the
    /// volume is so large that rays of its own for each lvoxel would take long, that is kept, too.
    fn may_keep_sky(scene: &Scene) -> bool {
        /// Bricks.
        const LARGE: usize = 1 << 12;
        let [volume] = &scene.volumes[..] else {
            return false;
        };
        // A sky that is kept travels all ways alike, which half a sky does not.
        let is_worth_it = || volume.sigma_t.stored_bricks() >= LARGE && volume.phase.is_isotropic();
        scene.environment().0 != Rgb::BLACK.0
            && scene.environment_image.is_none()
            && (scene.mesh.triangles.is_empty() || is_worth_it())
    }

    /// What each volume has for each sun of so many.
    fn share(scene: &Scene, n: usize) -> usize {
        (n / (scene.volumes.len() * Self::suns(scene).max(1))).max(16)
    }
}

impl<S: Shadows> Lights<'_, S> {
    /// Mean over the sphere of the direct radiance at a point of a medium, that of a constant
    /// environment included, by `rays` and by as many `all_round`. Kept light counts where there is
    /// any.
    #[must_use]
    pub fn mean_radiance_by_kept(
        &self,
        point: Vec3,
        rays: ShadowRays,
        all_round: ShadowRays,
        kept: &KeptLight,
    ) -> Rgb {
        let direct = self.mean_radiance_through(point, rays, Some(&kept.suns));
        direct.light()
            + match &kept.sky {
                None => self.environment_mean_radiance(point, all_round),
                Some(_) => kept.sky_at(self, point),
            }
    }
}

impl<S: Shadows> Lights<'_, S> {
    /// The same light, with the sum over it of its mean channel times the direction in which it
    /// travels; light of a kept sky travels all ways alike.
    #[must_use]
    pub fn directed_by_kept(
        &self,
        point: Vec3,
        rays: ShadowRays,
        all_round: ShadowRays,
        kept: &KeptLight,
    ) -> (Rgb, Vec3) {
        let (light, way) = self.directed_through(point, rays, Some(&kept.suns));
        let (sky, sky_way) = match &kept.sky {
            Some(sky) => (sky.of(self.even_environment(), point), Vec3::ZERO),
            None => self.directed_environment(point, all_round),
        };
        (light + sky, way + sky_way)
    }
}

/// The share of a constant sky's light that gets through one volume to its points.
#[derive(Debug)]
struct Sky {
    index_from_scene: Affine3A,
    /// Cells per voxel.
    per_voxel: f32,
    /// Cells along x, y and z.
    dims: [usize; 3],
    /// At the corners of cells, x fastest: of all channels, or of red, green and blue one after the
    /// other in a medium of colour.
    shares: Vec<List<f32>>,
    /// Which of them is of the channel that is stopped most.
    most: usize,
}

impl Sky {
    /// Directions that stand for the whole sky: on a spiral (Fibonacci's), each for as much of it.
    const DIRECTIONS: u32 = 64;

    fn directions() -> Vec<Vec3> {
        let turn = 0.618_034;
        let direction = |i: u32| {
            let height = (i as f32 + 0.5) / Self::DIRECTIONS as f32;
            sampling::sphere([height, (i as f32 * turn).fract()])
        };
        (0..Self::DIRECTIONS).map(direction).collect()
    }

    /// As many directions, and those opposite to them: of a horizon of any slant half are above it.
    fn directions_in_pairs() -> Vec<Vec3> {
        let half = Self::directions().into_iter();
        half.flat_map(|d| [d, -d]).collect()
    }

    /// The sky in some directions through a volume, and where surfaces leave it open.
    fn new(coarse: &CoarseVolume, directions: &[Vec3], open: Option<&OpenSky>) -> Result<Self> {
        let dims = coarse.dims;
        let corners = dims.map(|n| n + 1);
        let lattices: Vec<_> = directions.iter().map(|d| lattice(coarse, *d)).collect();
        let color = coarse.volume.extinction_color;
        let colors = match coarse.volume.is_grey() {
            true => &color[..1],
            false => &color[..],
        };
        let none = || {
            let lists = coarse.volume.sigma_t.lists();
            lists.zeros("light of the sky in media", corners.iter().product())
        };
        let of_colors = || colors.iter().map(|_| none()).collect::<Result<Vec<_>>>();
        let mut shares: Vec<List<f32>> = of_colors()?;
        let mut depths = KeptRays::depths_for(coarse, &lattices)?;
        for main in 0..3 {
            let axes = [main, (main + 1) % 3, (main + 2) % 3];
            let of_axis = lattices.iter().enumerate().filter(|(_, l)| l.axes == axes);
            let of_axis: Vec<_> = of_axis.collect();
            if of_axis.is_empty() {
                continue;
            }
            let layers = coarse.layers(axes);
            let mut sums: Vec<List<f32>> = of_colors()?;
            for (direction, lattice) in of_axis {
                let rays = KeptRays::in_place(depths, coarse, &layers, *lattice);
                let across = [dims[axes[1]], dims[axes[2]]];
                for (&color, sums) in colors.iter().zip(&mut sums) {
                    match open {
                        None => rays.add_to_corners(across, color, sums, |_| 1.0),
                        Some(open) => rays.add_to_corners(across, color, sums, |[plane, y, x]| {
                            let mut corner = [0.0; 3];
                            for (axis, at) in axes.into_iter().zip([plane, x, y]) {
                                corner[axis] = at as f32 * coarse.edge;
                            }
                            open.share(direction, corner)
                        }),
                    }
                }
                depths = rays.into_depths();
            }
            let [_, width, height] = axes.map(|a| corners[a]);
            for (shares, sums) in shares.iter_mut().zip(&sums) {
                shares.par_iter_mut().enumerate().for_each(|(i, share)| {
                    let at = unflatten(i, corners);
                    let [plane, x, y] = axes.map(|a| at[a]);
                    *share += sums[(plane * height + y) * width + x];
                });
            }
        }
        let per_direction = 1.0 / directions.len() as f32;
        for shares in &mut shares {
            shares.par_iter_mut().for_each(|s| *s *= per_direction);
        }
        Ok(Self {
            index_from_scene: coarse.volume.index_from_scene,
            per_voxel: 1.0 / coarse.edge,
            dims,
            shares,
            most: colors.iter().position(|c| *c == 1.0).unwrap_or(0),
        })
    }

    /// What gets of the light of a sky to a point of the scene in the volume.
    fn of(&self, light: Rgb, point: Vec3) -> Rgb {
        match &self.shares[..] {
            [red, green, blue] => {
                light * Rgb([red, green, blue].map(|shares| self.between(shares, point)))
            }
            _ => light * self.share(point),
        }
    }

    /// The share of the channel that is stopped most which gets to a point.
    fn share(&self, point: Vec3) -> f32 {
        self.between(&self.shares[self.most], point)
    }

    /// A value between those at the corners of cells.
    fn between(&self, shares: &[f32], point: Vec3) -> f32 {
        let p = self.index_from_scene.transform_point3(point) * self.per_voxel;
        let p = p.clamp(Vec3::ZERO, Vec3::from(self.dims.map(|n| n as f32)));
        let at = p.to_array();
        let cell: [usize; 3] =
            std::array::from_fn(|a| (at[a] as usize).min(self.dims[a].saturating_sub(1)));
        let f: [f32; 3] = std::array::from_fn(|a| at[a] - cell[a] as f32);
        let [width, height] = [self.dims[0] + 1, self.dims[1] + 1];
        let row = |y: usize, z: usize| {
            let first = ((cell[2] + z) * height + cell[1] + y) * width + cell[0];
            shares[first] * (1.0 - f[0]) + shares[first + 1] * f[0]
        };
        let face = |z: usize| row(0, z) * (1.0 - f[1]) + row(1, z) * f[1];
        face(0) * (1.0 - f[2]) + face(1) * f[2]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::exp::exp_neg;
    use crate::scene::{Grid, LightInput, MeshInput, SceneBuilder, VolumeInput};
    use glam::{DAffine3, DQuat, DVec3};

    const RADIANCE: [f32; 3] = [0.2, 0.3, 0.5];

    fn scene(
        dims: [usize; 3],
        sigma_t: impl Fn([usize; 3]) -> f32 + Sync,
        direction: [f64; 3],
        floor: Option<MeshInput>,
    ) -> Scene {
        let place = DAffine3::from_scale_rotation_translation(
            DVec3::new(0.05, 0.07, 0.04),
            DQuat::from_rotation_y(0.3) * DQuat::from_rotation_x(-0.2),
            DVec3::new(1.0, -2.0, 0.5),
        );
        let volume = VolumeInput::new("cloud", Grid::from_fn(dims, sigma_t), [0.9; 3], place);
        let sun = LightInput::sun(direction, [5.0; 3], 0.0).unwrap();
        let scene = SceneBuilder::new("test").volume(volume).light(sun);
        let scene = scene.light(LightInput::environment(RADIANCE));
        let scene = floor.into_iter().fold(scene, SceneBuilder::mesh);
        scene.build().unwrap()
    }

    /// A cloud of waves of so many voxels, with holes, and empty at its borders.
    fn cloud(period: f32) -> impl Fn([usize; 3]) -> f32 + Sync {
        move |v| {
            let from_centre = Vec3::from(v.map(|i| i as f32)) / 32.0 - 1.0;
            let wave = |i: usize| libm::sinf(std::f32::consts::TAU * i as f32 / period);
            let [x, y, z] = v.map(wave);
            let holes = (0.6 + x * y + y * z + z * x).clamp(0.0, 1.0);
            8.0 * holes * (1.0 - from_centre.length()).clamp(0.0, 0.3)
        }
    }

    fn checks(scene: &Scene, directions: &[Vec3]) -> Checks {
        Checks::new(&scene.volumes[0], 400, directions)
    }

    #[test]
    fn kept_suns_agree_with_rays_of_their_own_along_any_direction() {
        for direction in [
            [0.0, -1.0, 0.0],
            [1.0, 1.0, -1.0],
            [-0.3, -0.9, 0.2],
            [0.999, 0.02, 0.01],
        ] {
            for period in [10.0, 40.0] {
                let scene = scene([64; 3], cloud(period), direction, None);
                let to_sun = SunDepths::direction(&scene.lights[0]).unwrap();
                let tracer = Tracer::new(&scene);
                let kept = KeptLight::new(&tracer, || Ok(())).unwrap();
                let sun = kept.suns.of::<f32>(0).unwrap();
                assert!(
                    !format!("{sun:?}").contains("exact: inf"),
                    "{direction:?} {period}"
                );
                // Points that did not choose the level.
                let exact = checks(&scene, &[to_sun]);
                let (mut squares, mut bias, mut sum) = (0.0, 0.0, 0.0);
                for &(point, share) in &exact.0 {
                    let ray = Ray::endless(point, to_sun);
                    let found = exp_neg(sun.optical_depth(&tracer, &ray));
                    squares += (found - share).powi(2) / exact.0.len() as f32;
                    bias += found - share;
                    sum += share;
                }
                let rms = squares.sqrt();
                assert!(
                    rms < 0.015 && bias.abs() < 0.006 * sum,
                    "{rms} {}",
                    bias / sum
                );
            }
        }
    }

    #[test]
    fn a_kept_sky_is_that_of_many_directions() {
        let scene = scene([64; 3], cloud(20.0), [0.0, -1.0, 0.0], None);
        let kept = KeptLight::new(&Tracer::new(&scene), || Ok(())).unwrap();
        let sky = kept.sky.unwrap();
        let many: Vec<_> = (0..1000)
            .map(|i| sampling::sphere(sampling::r2(i, [0.3; 2])))
            .collect();
        let exact = checks(&scene, &many);
        let (mut squares, mut bias, mut sum) = (0.0, 0.0, 0.0);
        for &(point, share) in &exact.0 {
            let difference = sky.share(point) - share;
            squares += difference * difference / exact.0.len() as f32;
            bias += difference;
            sum += share;
        }
        assert!(
            squares.sqrt() < 0.012 && bias.abs() < 0.005 * sum,
            "{} {}",
            squares.sqrt(),
            bias / sum
        );
    }

    #[test]
    fn a_kept_sky_behind_a_medium_of_colour_is_that_of_grey_ones() {
        const COLOR: [f32; 3] = [0.2, 1.0, 0.5];
        let direction = [0.0, -1.0, 0.0];
        let mut scene = scene([64; 3], cloud(20.0), direction, None);
        let grey = scene.volumes.remove(0);
        let place = grey.scene_from_index;
        scene.volumes.push(grey.with_extinction_color(COLOR));
        let kept = KeptLight::new(&Tracer::new(&scene), || Ok(())).unwrap();
        let sky = kept.sky.unwrap();
        let many: Vec<_> = (0..300)
            .map(|i| sampling::sphere(sampling::r2(i, [0.3; 2])))
            .collect();
        for (c, share) in COLOR.into_iter().enumerate() {
            let of = cloud(20.0);
            let scale = scene.volumes[0].sigma_t.max() / Grid::from_fn([64; 3], &of).max();
            let grid = Grid::from_fn([64; 3], |v| share * scale * of(v));
            let grey = Volume::new("grey".into(), grid, [0.9; 3], place);
            let exact = Checks::new(&grey, 300, &many).0;
            let (mut squares, mut bias, mut sum) = (0.0, 0.0, 0.0);
            for &(point, share) in &exact {
                let difference = sky.of(Rgb::splat(1.0), point).0[c] - share;
                squares += difference * difference / exact.len() as f32;
                bias += difference;
                sum += share;
            }
            let (rms, bias) = (squares.sqrt(), bias / sum);
            assert!(rms < 0.012 && bias.abs() < 0.006, "{c}: {rms} {bias}");
        }
    }

    #[test]
    fn a_kept_sky_is_hidden_by_a_floor_below_a_volume() {
        let corners = [
            [-60.0, -4.5, -60.0],
            [-60.0, -4.5, 60.0],
            [60.0, -4.5, -60.0],
        ];
        let floor = MeshInput::new("floor", corners, vec![[0, 1, 2]]);
        let scene = scene([64; 3], cloud(20.0), [0.0, -1.0, 0.0], Some(floor));
        // So few lvoxels pay for rays of their own.
        assert!(!KeptLight::may_keep_sky(&scene));
        let (volume, tracer) = (&scene.volumes[0], Tracer::new(&scene));
        let is_open = |point: Vec3, to_sky: Vec3| !tracer.is_occluded(&Ray::endless(point, to_sky));
        let directions = Sky::directions_in_pairs();
        let open = OpenSky::new(volume, &directions, is_open);
        let levels = Levels::new(volume, 1 << 20);
        let sky = |open: Option<&OpenSky>| {
            Sky::new(levels.coarse_to_fine().last().unwrap(), &directions, open)
        };
        let many: Vec<_> = (0..500)
            .map(|i| sampling::sphere(sampling::r2(i, [0.3; 2])))
            .flat_map(|d| [d, -d])
            .collect();
        let exact = Checks::where_lit(volume, 400, &many, is_open).0;
        let differs = |sky: &Sky| {
            let (mut squares, mut bias, mut sum) = (0.0, 0.0, 0.0);
            for &(point, share) in &exact {
                let difference = sky.share(point) - share;
                squares += difference * difference / exact.len() as f32;
                bias += difference;
                sum += share;
            }
            [squares.sqrt(), bias / sum]
        };
        let [rms, bias] = differs(&sky(Some(&open)).unwrap());
        assert!(rms < 0.02 && bias.abs() < 0.02, "{rms} {bias}");
        let [rms, bias] = differs(&sky(None).unwrap());
        assert!(rms > 0.05 && bias > 0.2, "{rms} {bias}");
    }

    #[test]
    fn what_coarse_rays_cannot_tell_is_left_to_exact_ones() {
        // Each second voxel is opaque, and a floor hides half of the sky.
        let speckled = |[i, j, k]: [usize; 3]| if (i + j + k) % 2 == 0 { 80.0 } else { 0.0 };
        let corners = [[-9.0, -9.0, -9.0], [-9.0, -9.0, 9.0], [9.0, -9.0, 9.0]];
        let floor = MeshInput::new("floor", corners, vec![[0, 1, 2]]);
        let scene = scene([24; 3], speckled, [0.4, -1.0, 0.2], Some(floor));
        let tracer = Tracer::new(&scene);
        let kept = KeptLight::new(&tracer, || Ok(())).unwrap();
        assert!(kept.sky.is_none());
        let sun = kept.suns.of::<f32>(0).unwrap();
        let to_sun = SunDepths::direction(&scene.lights[0]).unwrap();
        let exact = checks(&scene, &[to_sun]).0;
        let squared = |&(point, share): &(Vec3, f32)| {
            let found = sun.optical_depth(&tracer, &Ray::endless(point, to_sun));
            (exp_neg(found) - share).powi(2)
        };
        let rms = (exact.iter().map(squared).sum::<f32>() / exact.len() as f32).sqrt();
        assert!(rms < 0.012, "{rms}");
    }

    #[test]
    fn threads_do_not_change_what_is_kept() {
        let scene = scene([48, 40, 64], cloud(16.0), [0.3, -0.8, 0.4], None);
        let on = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
            let kept = || KeptLight::new(&Tracer::new(&scene), || Ok(())).unwrap();
            format!("{:?}", pool.build().unwrap().install(kept))
        };
        assert!(on(1) == on(5));
    }
}

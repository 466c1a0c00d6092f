//! In-scattered light inside media, interpolated from vertices on the volume's own grid.
//!
//! A vertex is evaluated when a ray first needs it and depends on its coordinates alone, so it does
//! not matter which tile or thread asks; those that were lit beforehand are not lit again. Each
//! brick of a volume has the spacing that its own density asks for: vertices of direct light stand
//! at most an optical depth apart, those of indirect light 1.4 where it is swept, in thin bricks,
//! and two where it is not. Where vertices of a dense brick still differ much, at its rim, finer
//! ones are asked; near a point light, and where a voxel is deep, the ray's own points. Vertices in empty
//! space around the medium are evaluated like any other: leaving them dark would darken its rim.

mod beforehand;

use super::density::Densities;
use super::direct::{LEVELS, Parts, Spread, Vertex, has_edge};
use super::far_field::FarField;
use super::stiff;
use super::stored::Lit;
use super::sweep::{self, Scope, Sweep};
use super::vertices::{Cube, Vertices, are_alike, blend, extremes, inside};
use crate::Result;
use crate::gather::{Gatherer, Medium, SampleRange};
use crate::light::{Lights, MediumLight, ShadowRays, SunDepths};
use crate::math::exp::{exp_neg, mean_reach, one_minus_exp_neg};
use crate::math::{Rgb, sampling};
use crate::run::Job;
use crate::scene::Volume;
use crate::shade::view::{Seen, View};
use crate::tree::Pages;
use glam::Vec3;
use lvox_formats::{MappedFile, Scatter};
use wide::f32x4;

/// In-scattered light of one volume: a lattice for each spacing, of which each brick of the volume
/// uses one.
#[derive(Debug)]
struct Lattices<'a> {
    /// By log2 of the voxels between vertices.
    direct: [Vertices<Vertex>; LEVELS],
    /// Those that were lit beforehand.
    lit: Option<Lit<'a>>,
    indirect: [Vertices<Rgb>; sweep::LEVELS],
    far_field: FarField,
    sweep: Option<Sweep>,
    densities: Densities,
    /// Longest edge of a voxel, scene units.
    voxel: f32,
}

/// Indirect light that is not swept stands at twice the spacing of direct light.
const _: () = assert!(sweep::LEVELS > LEVELS);

/// In-scattered light of all volumes of a scene.
pub struct InScatter<'a, P, M> {
    volumes: &'a [Volume],
    lights: &'a Lights<'a>,
    /// The same lights, whose shadows are those of the scene's own media.
    sharp_lights: Lights<'a>,
    /// Whether direct light has no noise of shadow rays.
    rest_is_exact: bool,
    /// Whether shadows may have sharp edges.
    any_is_sharp: bool,
    gatherer: Option<&'a Gatherer<'a, P, M>>,
    lattices: Vec<Lattices<'a>>,
    suns: SunDepths<'a>,
    view: View<'a>,
    /// Shadow rays of a vertex to each light with an extent.
    vertex_rays: u32,
}

/// What lights media.
#[derive(Debug)]
pub struct Light<'a, P, M> {
    /// Direct light.
    pub lights: &'a Lights<'a>,
    /// Light that is gathered, if any is.
    pub gatherer: Option<&'a Gatherer<'a, P, M>>,
    /// Light that is known already.
    pub beforehand: Option<&'a Scatter<MappedFile>>,
}

impl<'a, P: Pages, M: Medium> InScatter<'a, P, M> {
    /// Optical depth between vertices of the direct lattice, at most.
    const SPACING: f32 = 1.0;
    /// Cells deeper than this are lit at their own point.
    const DEPTH: f32 = 0.7;
    /// In cells deeper than this light of other surfaces and media is looked for at their own
    /// point, too: rays end within a few of them.
    const STIFF: f32 = 2.0;
    /// Vertices nearer than this in optical depth are not compared.
    const FLAT: f32 = 0.35;
    /// Where direct light at the vertices around a point differs by more than this factor, a finer
    /// lattice is asked.
    const ALIKE: f32 = 2.0;
    /// The same for light without the noise of shadow rays; a ray's own point is asked where no
    /// lattice is finer.
    const ALIKE_EXACT: f32 = 1.3;
    /// The same for gathered light, which has the noise of few rays.
    const ALIKE_GATHERED: f32 = 3.0;
    /// In thin bricks, where noise is all else that differs, only such a factor tells of a wall
    /// between vertices.
    const LEAK: f32 = 8.0;
    /// Spacings of vertices around a point light in which its light is looked for on the ray itself.
    const NEAR: f32 = 2.0;
    /// Vertices of scattered light may be so much further apart, as an optical depth in all media
    /// of a place together, than they are in one medium.
    const SHARED: f32 = 0.7;
    /// Vertices in thin media that are further apart than so many pixels are compared, for walls
    /// and edges of shadows that are between them.
    const WIDE: f32 = 4.0;
    /// Where shadows may have sharp edges, vertices in thin media are no further apart than so many
    /// pixels or a voxel: of what is between them nothing tells.
    const FARTHEST: f32 = 16.0;
    /// Shadow rays of a vertex or point to each light with an extent.
    const SHADOW_RAYS: u32 = 4;
    /// Rays to an environment that no gather sees.
    const ENVIRONMENT_RAYS: u32 = 16;

    /// Lattices that are still empty but for what is swept, or was lit beforehand, where that may
    /// matter. Without a gatherer there is direct light only.
    ///
    /// # Errors
    /// If cancelled, if a sweep takes more than the memory limit by itself, or for damage to what
    /// was lit beforehand.
    pub fn new(view: &View<'a>, seen: Seen, light: &Light<'a, P, M>, job: &Job) -> Result<Self> {
        let &Light {
            lights,
            gatherer,
            beforehand,
        } = light;
        let volumes = &view.tracer.scene.volumes;
        let mut lattices = Vec::with_capacity(volumes.len());
        for (index, volume) in volumes.iter().enumerate() {
            let volume_samples = gatherer.map_or(1, |g| g.settings.samples);
            let dims = volume.sigma_t.dims();
            // Where volumes overlap, or are alike, their probes must not have the same noise.
            let seed = match index {
                0 => view.seed,
                _ => sampling::hash(&[view.seed, index as u64]),
            };
            let far_field = FarField::new(volume, volume_samples, seed);
            let voxel = volume.longest_voxel_edge();
            let densities = Densities::new(volumes, index);
            let depth_of = |brick, own| {
                let all = densities.of_all(brick, own);
                densities.of(brick).max(Self::SHARED * all) * voxel
            };
            let sweeper = gatherer.filter(|g| g.settings.max_dist.is_infinite());
            let (lit, sweep) = match (beforehand, sweeper) {
                (Some(scatter), _) => {
                    let lit = Lit::open(scatter, index, view, seen, job)?;
                    (
                        Some(lit),
                        sweeper.map(|_| Sweep::made_beforehand(volume, depth_of)),
                    )
                }
                (None, Some(gatherer)) => {
                    let scope = Scope {
                        view,
                        seen,
                        gatherer,
                        volume,
                        far_field: &far_field,
                        job,
                    };
                    (None, Some(Sweep::new(&scope, depth_of)?))
                }
                (None, None) => Default::default(),
            };
            lattices.push(Lattices {
                direct: std::array::from_fn(|level| Vertices::new(dims, 1 << level)),
                lit,
                indirect: std::array::from_fn(|level| Vertices::new(dims, 1 << level)),
                far_field,
                sweep,
                densities,
                voxel,
            });
        }
        Ok(Self {
            volumes,
            lights,
            sharp_lights: lights.with_sharp_shadows(),
            rest_is_exact: lights.rest_is_exact()
                && (gatherer.is_some() || lights.environment().is_black()),
            any_is_sharp: lights.has_sharp_shadows(),
            gatherer,
            lattices,
            suns: SunDepths::new(view.tracer.scene),
            view: *view,
            vertex_rays: Self::SHADOW_RAYS,
        })
    }

    /// An error if any of the light that was made beforehand could not be read so far.
    ///
    /// # Errors
    /// Damage.
    pub fn check(&self) -> Result<()> {
        let mut lit = self.lattices.iter().filter_map(|l| l.lit.as_ref());
        lit.try_for_each(Lit::check)
    }

    /// With so many shadow rays of a vertex to each light with an extent.
    #[must_use]
    pub fn with_vertex_rays(self, vertex_rays: u32) -> Self {
        Self {
            vertex_rays,
            ..self
        }
    }

    /// Which lattices serve a brick whose densest voxel has this optical depth: thin parts of a
    /// volume are lit from few vertices, whatever its densest part needs.
    fn level(densest: f32) -> usize {
        (0..LEVELS)
            .rev()
            .find(|&l| densest * (1 << l) as f32 <= Self::SPACING)
            .unwrap_or(0)
    }

    /// Source function of a volume along a stretch of a ray, given its ends in scene space and its
    /// optical depth, and what is known from stretches before it.
    #[must_use]
    pub fn source(&self, volume: usize, ends: [Vec3; 2], depth: f32, known: &mut Known) -> Rgb {
        let medium = &self.volumes[volume];
        let voxel = self.lattices[volume].voxel;
        let [from, to] = ends;
        // Where its light comes from on average: near its front if it is dense.
        let point = from + (to - from) * mean_reach(depth);
        let at = medium.index_from_scene.transform_point3(point);
        let densest = self.lattices[volume].densities.at(at) * voxel;
        let level = Self::level(densest);
        let place = Place {
            volume,
            ends,
            depth,
            point,
            at,
            densest,
            is_thin: densest <= Self::DEPTH,
            level,
            voxel_depth: depth * voxel / (to - from).length(),
        };
        Rgb(medium.albedo) * (self.direct(&place, known) + self.indirect(&place, known))
    }

    fn direct(&self, place: &Place, known: &mut Known) -> Rgb {
        let (lattices, [from, to]) = (&self.lattices[place.volume], place.ends);
        let spacing = lattices.voxel * (1 << place.level) as f32;
        // What arrives of a point light has a cusp at the light.
        let near = self
            .lights
            .point_source_near(from, to, Self::NEAR * spacing);
        if let Some(median) = near.filter(|_| place.depth > 0.0) {
            let point = from + (to - from) * median;
            let rays = Self::rays(Self::SHADOW_RAYS, self.seed_of(point));
            let light = self.lit(&self.sharp_lights, point, rays, None);
            // The camera sees that point, and not the stretch as a whole, through what is before
            // it.
            let mean_through = one_minus_exp_neg(place.depth) / place.depth;
            let through = exp_neg(place.depth * median) / mean_through;
            return light.share * self.lights.unshadowed_along(from, to) * through + light.rest;
        }
        let vertex = |level: usize, v: [usize; 3]| {
            let lit = lattices.lit.as_ref().and_then(|lit| lit.direct(level, v));
            *lit.unwrap_or_else(|| {
                lattices.direct[level].get(v, &|p, v| self.vertex(place.volume, level, p, v))
            })
        };
        if place.is_thin || place.voxel_depth <= Self::DEPTH {
            for level in (0..=self.first_level(place)).rev() {
                let around = lattices.direct[level].around(place.at);
                let weights = &around.weights;
                let values = known.direct[level]
                    .values(place.volume, &around, |v| Parts::of(&vertex(level, v)));
                let between = place.densest * (1 << level) as f32;
                let is_finest = level == 0 || between <= Self::FLAT;
                if is_finest && (between <= Self::FLAT || place.is_thin && !self.rest_is_exact) {
                    if self.may_show_edges(place, level) && has_edge(values, weights) {
                        continue;
                    }
                    let light = blend(values, weights, |v| v.light);
                    return Parts::share(light) * self.lights.unshadowed_along(from, to)
                        + Parts::rest(light);
                }
                let light = blend(values, weights, |v| v.light);
                let spread = Spread::of(values, weights, light);
                if is_finest || !self.differs(spread) {
                    let [share, rest] = spread;
                    let depth = place.voxel_depth * (1 << level) as f32;
                    let fall = |spread: Spread, part: usize| {
                        spread.fall(depth, || blend(values, weights, |v| v.ln[part]))
                    };
                    let share = Parts::share(light)
                        * self.lights.unshadowed_along(from, to)
                        * fall(share, 0);
                    return share + Parts::rest(light) * fall(rest, 1);
                }
            }
        }
        if place.densest <= Self::FLAT {
            // Many such cells are in a row, and one point of each tells enough.
            let seed = self.seed_of(place.point);
            let point = place.at_share(sampling::unit(seed));
            let light = self.lit(self.lights, point, Self::rays(1, seed), Some(&self.suns));
            return light.share * self.lights.unshadowed_along(from, to) + light.rest;
        }
        // Two points (Gauss-Legendre) of what the camera sees: light is not linear along a dense
        // stretch.
        let mut sum = Rgb::BLACK;
        for share in [0.211_324_87, 0.788_675_1] {
            let point = place.at_share(share);
            let rays = Self::rays(Self::SHADOW_RAYS / 2, self.seed_of(point));
            let light = self.lit(&self.sharp_lights, point, rays, None);
            sum += (light.share * self.lights.unshadowed_along(point, point) + light.rest) * 0.5;
        }
        sum
    }

    /// Whether both parts of direct light differ so much between vertices that finer ones tell
    /// more.
    fn differs(&self, [share, rest]: [Spread; 2]) -> bool {
        if self.rest_is_exact {
            // Where light has no noise, smaller differences tell.
            share.ratio.max(rest.ratio) > Self::ALIKE_EXACT
        } else {
            // Finer vertices have the same noise.
            share.ratio > Self::ALIKE
        }
    }

    /// Direct light at a vertex.
    fn vertex(&self, volume: usize, level: usize, point_in_index: Vec3, v: [usize; 3]) -> Vertex {
        let rays = Self::rays(self.vertex_rays, self.key(volume, level, v));
        let point = self.to_scene(volume, point_in_index);
        Vertex::new(self.lit(self.lights, point, rays, Some(&self.suns)))
    }

    /// Gathered light at a point of a volume's index space: what a vertex has that is not swept.
    fn gathered(&self, volume: usize, at: Vec3, point: Vec3, seed: u64) -> Rgb {
        let Some(gatherer) = self.gatherer else {
            return Rgb::BLACK;
        };
        let far_field = &self.lattices[volume].far_field;
        far_field
            .mean_radiance(&self.volumes[volume], gatherer, at, point, seed)
            .unwrap_or_else(|| {
                gatherer
                    .mean_radiance(point, SampleRange::first(seed))
                    .light
            })
    }

    fn indirect(&self, place: &Place, known: &mut Known) -> Rgb {
        let Some(gatherer) = self.gatherer else {
            return Rgb::BLACK;
        };
        let lattices = &self.lattices[place.volume];
        if !place.is_thin && place.voxel_depth > Self::STIFF {
            let surfaces = gatherer.without_media();
            // Any point of the stretch, as often as the camera sees it: light is not linear along
            // it.
            let seed = self.seed_of(place.point);
            let point = place.at_share(sampling::unit(seed));
            return stiff::mean_radiance(self.volumes, &self.sharp_lights, &surfaces, point, seed);
        }
        let vertex = |level: usize, v: [usize; 3]| {
            *lattices.indirect[level].get(v, &|p, v| {
                let key = self.key(place.volume, level, v);
                self.gathered(place.volume, p, self.to_scene(place.volume, p), key)
            })
        };
        let sweep = lattices.sweep.as_ref();
        let swept_level = sweep.and_then(|sweep| sweep.level_at(place.at));
        // An environment lights media directly, through what is before them.
        let smooth = if self.lights.environment().is_black() {
            2.0 * Self::DEPTH
        } else {
            Self::FLAT
        };
        let first = swept_level.unwrap_or(place.level + 1);
        for level in (0..=first).rev() {
            let is_swept = swept_level == Some(level);
            let swept = |v| {
                let sweep = sweep.filter(|_| is_swept)?;
                let lit = lattices.lit.as_ref();
                lit.map_or_else(|| sweep.get(level, v), |lit| lit.indirect(level, v))
            };
            let around = lattices.indirect[level].around(place.at);
            let cube = &mut known.indirect[level];
            let values = cube.values((place.volume, is_swept), &around, |v| {
                with_luminance(swept(v).unwrap_or_else(|| vertex(level, v)))
            });
            let is_finest = place.densest * (1 << level) as f32 <= smooth;
            let alike = if is_finest {
                Self::LEAK
            } else {
                Self::ALIKE_GATHERED
            };
            let (least, most) = extremes(values, &around.weights, |v| *v);
            let is_alike = are_alike(least.to_array()[3], most.to_array()[3], alike);
            if is_alike || is_finest && self.pixels(place, level) <= Self::WIDE {
                return rgb(blend(values, &around.weights, |v| *v));
            }
            if is_finest {
                let is_hidden = |v: [usize; 3]| {
                    let vertex = Vec3::from(v.map(|c| c as f32)) * (1 << level) as f32;
                    let vertex = self.to_scene(place.volume, vertex);
                    self.view.tracer.is_between(place.point, vertex)
                };
                let seen = cube.unhidden(&around, is_hidden);
                return rgb(blend(cube.last(), &seen.unwrap_or(around.weights), |v| *v));
            }
        }
        self.gathered(
            place.volume,
            place.at,
            place.point,
            self.seed_of(place.point),
        )
    }

    /// How many pixels of the camera are between vertices of a lattice.
    fn pixels(&self, place: &Place, level: usize) -> f32 {
        let spacing = self.lattices[place.volume].voxel * (1 << level) as f32;
        let distance = place.point.distance(self.view.camera.origin());
        spacing / (self.view.pixel_angle * distance)
    }

    /// The coarsest lattice of direct light that is asked.
    fn first_level(&self, place: &Place) -> usize {
        if !(self.any_is_sharp && place.is_thin) {
            return place.level;
        }
        let levels = (1..=place.level).rev();
        let mut near = levels.filter(|&l| self.pixels(place, l) <= Self::FARTHEST);
        near.next().unwrap_or(0)
    }

    /// Whether the camera may see edges of shadows between vertices of a lattice.
    fn may_show_edges(&self, place: &Place, level: usize) -> bool {
        self.any_is_sharp && self.pixels(place, level) > Self::WIDE
    }

    fn to_scene(&self, volume: usize, p: Vec3) -> Vec3 {
        inside(&self.volumes[volume], p)
    }

    fn key(&self, volume: usize, level: usize, v: [usize; 3]) -> u64 {
        let [x, y, z] = v.map(|c| c as u64);
        sampling::hash(&[self.view.seed, volume as u64, level as u64, x, y, z])
    }

    /// Direct light at a point. Where nothing is gathered, that of the environment, too, which
    /// gathers bring else.
    fn lit(
        &self,
        lights: &Lights,
        point: Vec3,
        rays: ShadowRays,
        suns: Option<&SunDepths>,
    ) -> MediumLight {
        let mut light = lights.in_medium(point, rays, suns);
        if self.gatherer.is_none() && !lights.environment().is_black() {
            let seed = self.seed_of(point);
            let rays = Self::rays(Self::ENVIRONMENT_RAYS, seed);
            light.rest += lights.environment_mean_radiance(point, rays);
        }
        light
    }

    fn rays(per_light: u32, seed: u64) -> ShadowRays {
        ShadowRays::Sequence {
            per_light,
            first: 0,
            seed,
        }
    }

    fn seed_of(&self, point: Vec3) -> u64 {
        let [x, y, z] = point.to_array().map(|c| u64::from(c.to_bits()));
        sampling::hash(&[self.view.seed, x, y, z])
    }
}

impl Place {
    /// The point before which this share of the light comes from that the camera sees of the
    /// stretch.
    fn at_share(&self, share: f32) -> Vec3 {
        let reach = if self.depth > 0.0 {
            -libm::log1pf(-share * one_minus_exp_neg(self.depth)) / self.depth
        } else {
            share
        };
        let [from, to] = self.ends;
        from + (to - from) * reach.min(1.0)
    }
}

/// What one ray found at vertices last, by lattice.
#[derive(Debug, Default)]
pub struct Known {
    /// By volume.
    direct: [Cube<usize, Parts>; LEVELS],
    /// By volume, and whether they are swept.
    indirect: [Cube<(usize, bool), f32x4>; sweep::LEVELS],
}

/// A stretch of a ray in a volume.
struct Place {
    volume: usize,
    ends: [Vec3; 2],
    depth: f32,
    /// What stands for it, in scene space and in the volume's index space.
    point: Vec3,
    at: Vec3,
    /// Depth of a voxel of the densest medium in the brick, and of one as dense as on the stretch.
    densest: f32,
    voxel_depth: f32,
    /// Whether light between the vertices of the brick is as good as linear.
    is_thin: bool,
    /// The coarsest lattice that its brick allows.
    level: usize,
}

fn with_luminance(light: Rgb) -> f32x4 {
    let [r, g, b] = light.0;
    f32x4::new([r, g, b, light.luminance()])
}

fn rgb(light: f32x4) -> Rgb {
    let [r, g, b, _] = light.to_array();
    Rgb([r, g, b])
}

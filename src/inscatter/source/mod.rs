//! In-scattered light inside media, interpolated from vertices on the volume's own grid.
//!
//! A vertex is evaluated when a ray first needs it and depends on its coordinates alone, so it does
//! not matter which tile or thread asks; those that were lit beforehand are not lit again. Each
//! brick of a volume has the spacing that its own density asks for: vertices of direct light stand
//! at most an optical depth apart, those of indirect light 1.4 where it is swept, in thin bricks,
//! and two where it is not; a camera whose pixels are wider asks for wider ones. Where vertices of
//! a dense brick still differ much, at its rim, and near emitters finer ones are asked; beside
//! lights, and where a voxel is deep, the ray's own points. Vertices in empty space around the
//! medium are evaluated like any other: leaving them dark would darken its rim.

mod bends;
mod every_vertex;
mod front;
mod lattices;
mod memo;
mod segment;

pub use every_vertex::VolumeLight;
pub use lattices::MediaLights;
pub use memo::RayMemo;

use super::bricks::brick_around;
use super::counts::{self, Counters, MediaCounts};
use super::dense;
use super::direct::{LightVectors, NEAR_LEVELS, Spread, Vertex, has_edge};
use super::far_field::AskedPoint;
use super::gatherer::GatherInMedia;
use super::scattered::ScatteredLight;
use super::seen_channels::SeenChannels;
use super::sweep::Sweep;
use super::vertices::{are_alike, blend, extremes, inside};
use crate::Result;
use crate::gather::SampleRange;
use crate::light::{Lights, MediaBeforeSuns, MediumLight, SceneMedia, ShadowRays, SunDepths};
use crate::math::exp::{exp_neg, mean_reach, one_minus_exp_neg};
use crate::math::{Rgb, SeenPhase, Spectrum, sampling};
use crate::run::Job;
use crate::run::walked::note_asked;
use crate::scene::Volume;
use crate::view::{View, VisibleMedia};
use glam::Vec3;
use lattices::VolumeLattices;
use segment::RaySegment;
use wide::f32x4;

/// In-scattered light of all volumes of a scene.
pub struct InScatter<'a, G: GatherInMedia> {
    volumes: &'a [Volume],
    lights: &'a Lights<'a, SceneMedia<'a, G::Share>>,
    /// The same lights, whose shadows are those of the scene's own media.
    sharp_lights: Lights<'a, SceneMedia<'a, G::Share>>,
    /// Whether direct light has no noise of shadow rays.
    rest_is_exact: bool,
    /// Whether shadows may have sharp edges.
    any_is_sharp: bool,
    gatherer: Option<&'a G>,
    lattices: Vec<VolumeLattices<'a>>,
    suns: SunDepths<'a>,
    pub(super) view: View<'a>,
    /// Shadow rays of a vertex to each light with an extent.
    vertex_rays: u32,
    pub(super) counters: Counters,
}

impl<'a, G: GatherInMedia> InScatter<'a, G> {
    /// Optical depth between vertices of the direct lattice, at most.
    const MAX_VERTEX_DEPTH: f32 = 1.0;
    /// Cells deeper than this are lit at their own point.
    const MAX_CELL_DEPTH: f32 = 0.7;
    /// In cells deeper than this light of other surfaces and media is looked for at their own
    /// point, too: rays end within a few of them.
    const DENSE_CELL_DEPTH: f32 = 2.0;
    /// Vertices nearer than this in optical depth are not compared.
    const FLAT_DEPTH: f32 = 0.35;
    /// Where direct light at the vertices around a point differs by more than this factor, a finer
    /// lattice is asked.
    const MAX_DIRECT_RATIO: f32 = 2.0;
    /// The factor for light without the noise of shadow rays; a ray's own point is asked where no
    /// lattice is finer.
    const MAX_EXACT_RATIO: f32 = 1.3;
    /// The factor for gathered light, which has the noise of few rays.
    const MAX_GATHERED_RATIO: f32 = 3.0;
    /// In thin bricks, where noise is all else that differs, only such a factor tells of a wall
    /// between vertices.
    const MAX_THIN_RATIO: f32 = 8.0;
    /// Spacings of vertices around a point light in which its light is looked for on the ray
    /// itself.
    const NEAR_LIGHT_SPACINGS: f32 = 2.0;
    /// Vertices in thin media that are further apart than so many pixels are compared, for walls
    /// and edges of shadows that are between them.
    const WIDE_SPACING_PIXELS: f32 = 4.0;
    /// Vertices that are swept are never too far apart if that is so few pixels: between them is
    /// what a camera can hardly tell, and their light has no noise.
    const SWEPT_SPACING_PIXELS: f32 = 6.0;
    /// The same for those that were swept layer by layer, whatever is in the medium.
    const LAYERED_SPACING_PIXELS: f32 = 12.0;
    /// Of a lone medium whose voxels no pixel tells, thin cells in so many pixels in a row are lit
    /// as one.
    const STRETCH_PIXELS: f32 = 5.0;
    /// Where shadows may have sharp edges, vertices in thin media are no further apart than so many
    /// pixels or a voxel: of what is between them nothing tells.
    const MAX_SHARP_SPACING_PIXELS: f32 = 16.0;
    /// Shadow rays of a vertex or point to each light with an extent.
    const SHADOW_RAYS: u32 = 4;
    /// Rays to an environment that no gather sees.
    const ENVIRONMENT_RAYS: u32 = 16;

    /// Prepares the lattices of all volumes, empty but for what is swept or was lit beforehand
    /// where that may be visible. Without a gatherer there is direct light only.
    ///
    /// # Errors
    /// If cancelled, if a sweep takes more than the memory limit by itself, or for damage to what
    /// was lit beforehand.
    pub fn new(
        view: &View<'a>,
        visible: VisibleMedia,
        light: &MediaLights<'a, G>,
        job: &Job,
    ) -> Result<Self> {
        let volumes = view.tracer.volumes;
        let counters = Counters::default();
        let lattices = (0..volumes.len())
            .map(|index| VolumeLattices::new(index, view, visible, light, &counters, job))
            .collect::<Result<Vec<_>>>()?;
        let &MediaLights {
            lights, gatherer, ..
        } = light;
        let suns = SunDepths::new(view.tracer, |v| {
            light.scattered.is_none() && view.shows_no_voxels(visible, v)
        });
        // Shadows fall on surfaces where no medium is in sight, too.
        let has_surfaces = view.tracer.scene.mesh.triangle_count() > 0;
        let may_matter = |v: &Volume| view.may_matter(visible, Sweep::MARGIN_PIXELS, v.corners());
        if has_surfaces || volumes.iter().any(may_matter) {
            suns.make_in_cells(&|| job.cancel.check())?;
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
            suns,
            view: *view,
            vertex_rays: Self::SHADOW_RAYS,
            counters,
        })
    }

    /// The depth of media before suns, for shadows on surfaces, where coarse cells tell it.
    #[must_use]
    pub fn before_suns(&self) -> &dyn MediaBeforeSuns<G::Share> {
        &self.suns
    }

    /// An error if any of the light that was made beforehand could not be read so far.
    ///
    /// # Errors
    /// Damage.
    pub fn check(&self) -> Result<()> {
        let mut lit = self.lattices.iter().filter_map(|l| l.scattered.as_ref());
        lit.try_for_each(ScatteredLight::check)
    }

    /// What was done so far.
    #[must_use]
    pub fn counts(&self) -> MediaCounts {
        self.counters.counts()
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
        (0..NEAR_LEVELS)
            .rev()
            .find(|&l| densest * (1 << l) as f32 <= Self::MAX_VERTEX_DEPTH)
            .unwrap_or(0)
    }

    /// Source function of a volume along a segment of a ray, given its ends in scene space, its
    /// optical depth, the share of light from there that the ray lets through, and what is known
    /// from segments before it.
    #[must_use]
    pub fn source(
        &self,
        volume: usize,
        ends: [Vec3; 2],
        depth: f32,
        through: G::Share,
        memo: &mut RayMemo,
    ) -> Rgb {
        let medium = &self.volumes[volume];
        let channels = SeenChannels::new(through, &medium.extinction_color);
        let lattices = &self.lattices[volume];
        let voxel = lattices.voxel;
        let [from, to] = ends;
        // Where its light comes from on average: near its front if it is dense.
        let seen_depth = depth * channels.extinction;
        let point = from + (to - from) * mean_reach(seen_depth);
        let at = medium.index_from_scene.transform_point3(point);
        let brick = brick_around(at, medium.sigma_t.brick_dims());
        let densest = lattices.densities.of(brick) * voxel;
        let level = Self::level(densest);
        let least = lattices.least_direct.of(brick);
        let is_made = lattices.scattered.is_some();
        let level = if is_made { level } else { level.max(least) };
        let densest = densest * channels.extinction;
        let segment = RaySegment {
            volume,
            ends,
            depth,
            seen_depth,
            channels: channels.weights,
            point,
            at,
            densest,
            is_thin: densest <= Self::MAX_CELL_DEPTH,
            level,
            finest: least.min(level),
            finest_indirect: lattices.least_indirect.of(brick),
            voxel_depth: seen_depth * voxel / (to - from).length(),
            front: lattices.fronts.of(brick),
            levels: lattices.emitters.levels(at),
            seen: self.seen(volume, point),
        };
        memo.between = [0.0; 2];
        let light = self.direct(&segment, memo) + self.indirect(&segment, memo);
        if medium.albedo_grid.is_some() {
            memo.between = [0.0; 2];
        }
        medium.albedo_at(at) * light
    }

    fn direct(&self, segment: &RaySegment<G::Share>, memo: &mut RayMemo) -> Rgb {
        let (lattices, [from, to]) = (&self.lattices[segment.volume], segment.ends);
        let spacing = lattices.voxel * (1 << segment.level) as f32;
        let unshadowed = |from, to| self.unshadowed([from, to], segment);
        // What arrives of a point light has a cusp at the light.
        let near = self
            .lights
            .point_source_near(from, to, Self::NEAR_LIGHT_SPACINGS * spacing);
        if let Some(median) = near.filter(|_| segment.depth > 0.0) {
            let point = from + (to - from) * median;
            let rays = Self::rays(Self::SHADOW_RAYS, self.seed_of(point));
            let light = self.lit(&self.sharp_lights, point, rays, None, segment.seen);
            // The camera sees that point, and not the segment as a whole, through what is before
            // it.
            let color = &self.volumes[segment.volume].extinction_color;
            let depth = G::Share::tinted(segment.depth, color);
            let through = depth.each(|depth| {
                let mean_through =
                    one_minus_exp_neg(depth.max(f32::MIN_POSITIVE)) / depth.max(f32::MIN_POSITIVE);
                exp_neg(depth * median) / mean_through
            });
            return through.filter(light.share * unshadowed(from, to)) + light.rest;
        }
        if segment.front > 0 {
            let rays = Self::SHADOW_RAYS / 2;
            return self.direct_of_points(segment, self.lights, Some(&self.suns), rays);
        }
        let vertex = |level: usize, v: [usize; 3]| {
            let lit = lattices
                .scattered
                .as_ref()
                .and_then(|lit| lit.direct(level, v));
            *lit.unwrap_or_else(|| {
                note_asked(false);
                lattices.direct[level].get(v, &|p, v| self.vertex(segment.volume, level, p, v))
            })
        };
        if segment.is_thin || segment.voxel_depth <= Self::MAX_CELL_DEPTH {
            let first = segment.levels.min(self.first_level(segment) + 1);
            for level in (segment.finest..first).rev() {
                let around = lattices.direct[level].around(segment.at);
                if self.bends(segment.volume, segment.levels, level, around.vertex(0)) {
                    continue;
                }
                let weights = &around.weights;
                let values = memo.direct[level].values(segment.volume, &around, |v| {
                    LightVectors::of(&vertex(level, v))
                });
                let between = segment.densest * (1 << level) as f32;
                let is_finest = level == segment.finest || between <= Self::FLAT_DEPTH;
                memo.between[0] = lattices.voxel * (1 << level) as f32;
                if is_finest
                    && (between <= Self::FLAT_DEPTH || segment.is_thin && !self.rest_is_exact)
                {
                    if self.may_show_edges(segment, level) && has_edge(values, weights) {
                        continue;
                    }
                    let light = blend(values, weights, |v| v.light);
                    return LightVectors::share(light) * unshadowed(from, to)
                        + LightVectors::rest(light);
                }
                let light = blend(values, weights, |v| v.light);
                let spread = Spread::weighted(values, weights, light, segment.channels);
                if is_finest || !self.differs(spread) {
                    let [share, rest] = spread;
                    let depth = segment.voxel_depth * (1 << level) as f32;
                    let fall = |spread: Spread, part: usize| {
                        spread.fall(depth, || blend(values, weights, |v| v.ln[part]))
                    };
                    let share = LightVectors::share(light) * unshadowed(from, to) * fall(share, 0);
                    return share + LightVectors::rest(light) * fall(rest, 1);
                }
            }
        }
        memo.between[0] = 0.0;
        if segment.is_thin && segment.levels <= segment.finest {
            // What hides a lamp is seldom so near to it.
            return self.direct_of_points(segment, self.lights, Some(&self.suns), 1);
        }
        if segment.densest <= Self::FLAT_DEPTH {
            // Many such cells are in a row, and one point of each tells enough.
            let seed = self.seed_of(segment.point);
            let point = segment.at_share(sampling::unit(seed));
            let (rays, seen) = (Self::rays(1, seed), segment.seen);
            let light = self.lit(self.lights, point, rays, Some(&self.suns), seen);
            return light.share * unshadowed(from, to) + light.rest;
        }
        self.direct_of_points(segment, &self.sharp_lights, None, Self::SHADOW_RAYS / 2)
    }

    /// Whether both parts of direct light differ so much between vertices that finer ones tell
    /// more.
    fn differs(&self, [share, rest]: [Spread; 2]) -> bool {
        if self.rest_is_exact {
            // Where light has no noise, smaller differences tell.
            share.ratio.max(rest.ratio) > Self::MAX_EXACT_RATIO
        } else {
            // Finer vertices have the same noise.
            share.ratio > Self::MAX_DIRECT_RATIO
        }
    }

    /// Direct light at a vertex.
    fn vertex(&self, volume: usize, level: usize, point_in_index: Vec3, v: [usize; 3]) -> Vertex {
        let rays = Self::rays(self.vertex_rays, self.key(volume, level, v));
        let point = self.to_scene(volume, point_in_index);
        let seen = self.seen(volume, point);
        Vertex::new(self.lit(self.lights, point, rays, Some(&self.suns), seen))
    }

    /// How the camera sees the phase function of a volume at a point, if that is not isotropic.
    pub(super) fn seen(&self, volume: usize, point: Vec3) -> Option<SeenPhase> {
        self.view.seen(self.volumes[volume].phase, point)
    }

    /// Gathered light at a point of a volume's index space: what a vertex has that is not swept.
    fn gathered(&self, volume: usize, at: Vec3, point: Vec3, seed: u64) -> Rgb {
        let Some(gatherer) = self.gatherer else {
            return Rgb::BLACK;
        };
        counts::add(&self.counters.gathered, 1);
        let far_field = &self.lattices[volume].far_field;
        let seen = self.seen(volume, point);
        let asked = AskedPoint {
            in_index: at,
            in_scene: point,
            seen,
            seed,
        };
        far_field
            .scattered(&self.volumes[volume], gatherer, asked, &self.counters)
            .unwrap_or_else(|| {
                gatherer
                    .scattered(point, SampleRange::first(seed), seen)
                    .light
            })
    }

    fn indirect(&self, segment: &RaySegment<G::Share>, memo: &mut RayMemo) -> Rgb {
        let Some(gatherer) = self.gatherer else {
            memo.between[1] = f32::INFINITY;
            return Rgb::BLACK;
        };
        let lattices = &self.lattices[segment.volume];
        let is_front = segment.front > 0 && lattices.lvoxels.is_none();
        if !(segment.is_thin || is_front) && segment.voxel_depth > Self::DENSE_CELL_DEPTH {
            // Any point of the segment, as often as the camera sees it: light is not linear along
            // it.
            let seed = self.seed_of(segment.point);
            let point = segment.at_share(sampling::unit(seed));
            counts::add(&self.counters.gathered, 1);
            let lights = &self.sharp_lights;
            return dense::mean_radiance(self.volumes, lights, gatherer, point, segment.seen, seed);
        }
        let (of_lvoxels, between) = match &lattices.lvoxels {
            Some(lvoxels) => lvoxels.at(segment.point, &mut memo.lvoxels),
            None => (Rgb::BLACK, f32::INFINITY),
        };
        if lattices.lvoxels_tell_all {
            memo.between[1] = between;
            return of_lvoxels;
        }
        let gathered = self.gathered_between(segment, memo);
        memo.between[1] = memo.between[1].min(between);
        of_lvoxels + gathered
    }

    /// Gathered light, interpolated where its vertices allow that.
    fn gathered_between(&self, segment: &RaySegment<G::Share>, memo: &mut RayMemo) -> Rgb {
        if let Some(light) = self.front(segment, memo) {
            return light;
        }
        let lattices = &self.lattices[segment.volume];
        let vertex = |level, v| self.indirect_vertex(segment.volume, level, v);
        let sweep = lattices.sweep.as_ref();
        let swept_level = sweep.and_then(|sweep| sweep.level_at(segment.at));
        // An environment lights media directly, through what is before them.
        let smooth = if self.lights.environment().is_black() {
            2.0 * Self::MAX_CELL_DEPTH
        } else {
            Self::FLAT_DEPTH
        };
        let first = swept_level.unwrap_or(segment.level + 1);
        let finest = segment.finest_indirect.min(first);
        for level in (finest..=first).rev() {
            let is_swept = swept_level == Some(level);
            let swept = |v| {
                let sweep = sweep.filter(|_| is_swept)?;
                let lit = lattices.scattered.as_ref();
                lit.map_or_else(|| sweep.get(level, v), |lit| lit.indirect(level, v))
            };
            let around = lattices.indirect[level].around(segment.at);
            let cube = &mut memo.indirect[level];
            let values = cube.values((segment.volume, is_swept), &around, |v| {
                with_luminance(swept(v).unwrap_or_else(|| vertex(level, v)))
            });
            let is_finest =
                level == finest && finest > 0 || segment.densest * (1 << level) as f32 <= smooth;
            let alike = if is_finest {
                Self::MAX_THIN_RATIO
            } else {
                Self::MAX_GATHERED_RATIO
            };
            let (least, most) = extremes(values, &around.weights, |v| *v);
            let is_alike = are_alike(least.to_array()[3], most.to_array()[3], alike);
            let pixels = self.pixels(segment, level);
            let swept_pixels = match sweep {
                Some(sweep) if sweep.in_layers => Self::LAYERED_SPACING_PIXELS,
                _ => Self::SWEPT_SPACING_PIXELS,
            };
            let is_close = is_swept && pixels <= swept_pixels
                || is_finest && pixels <= Self::WIDE_SPACING_PIXELS;
            memo.between[1] = lattices.voxel * (1 << level) as f32;
            let may_bend = is_finest && level > finest && pixels > Self::BENDING_SPACING_PIXELS;
            let at = |v| swept(v).unwrap_or_else(|| vertex(level, v));
            if may_bend && self.indirect_bends(segment.volume, level, around.vertex(0), at) {
                continue;
            }
            if is_alike || is_close {
                return rgb(blend(values, &around.weights, |v| *v));
            }
            if is_finest {
                let is_hidden = |v: [usize; 3]| {
                    let vertex = Vec3::from(v.map(|c| c as f32)) * (1 << level) as f32;
                    let vertex = self.to_scene(segment.volume, vertex);
                    self.view.tracer.is_between(segment.point, vertex)
                };
                let seen = cube.unhidden(&around, is_hidden);
                return rgb(blend(cube.last(), &seen.unwrap_or(around.weights), |v| *v));
            }
        }
        memo.between[1] = 0.0;
        self.gathered(
            segment.volume,
            segment.at,
            segment.point,
            self.seed_of(segment.point),
        )
    }

    /// How many pixels of the camera are between vertices of a lattice.
    fn pixels(&self, segment: &RaySegment<G::Share>, level: usize) -> f32 {
        let spacing = self.lattices[segment.volume].voxel * (1 << level) as f32;
        let distance = segment.point.distance(self.view.camera.origin());
        spacing / (self.view.pixel_angle * distance)
    }

    /// The coarsest lattice of direct light that is asked.
    fn first_level(&self, segment: &RaySegment<G::Share>) -> usize {
        if !(self.any_is_sharp && segment.is_thin) {
            return segment.level;
        }
        let levels = (segment.finest + 1..=segment.level).rev();
        let mut near =
            levels.filter(|&l| self.pixels(segment, l) <= Self::MAX_SHARP_SPACING_PIXELS);
        near.next().unwrap_or(segment.finest)
    }

    /// Whether the camera may see edges of shadows between vertices of a lattice.
    fn may_show_edges(&self, segment: &RaySegment<G::Share>, level: usize) -> bool {
        self.any_is_sharp && self.pixels(segment, level) > Self::WIDE_SPACING_PIXELS
    }

    /// Scene units along a ray that a camera needs no light between: those that vertices around a
    /// point are apart at least, or more where there is nothing but a medium.
    pub(super) fn least_spacing(&self, volume: usize, point: Vec3) -> f32 {
        let lattices = &self.lattices[volume];
        let at = self.volumes[volume]
            .index_from_scene
            .transform_point3(point);
        let spacing = match lattices.least_direct.at(at) {
            0 => 0.0,
            level => lattices.voxel * (1 << level) as f32,
        };
        if !lattices.shows_light_alone {
            return spacing;
        }
        let pixel = self.view.pixel_angle * point.distance(self.view.camera.origin());
        spacing.max(Self::STRETCH_PIXELS * pixel)
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
        lights: &Lights<SceneMedia<G::Share>>,
        point: Vec3,
        rays: ShadowRays,
        suns: Option<&SunDepths>,
        seen: Option<SeenPhase>,
    ) -> MediumLight {
        counts::add(&self.counters.lit, 1);
        let mut light = lights.in_medium(point, rays, suns, seen);
        if self.gatherer.is_none() && !lights.environment().is_black() {
            let seed = self.seed_of(point);
            let rays = Self::rays(Self::ENVIRONMENT_RAYS, seed);
            light.rest += lights.scattered_environment(point, rays, seen);
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

fn with_luminance(light: Rgb) -> f32x4 {
    let [r, g, b] = light.0;
    f32x4::new([r, g, b, light.luminance()])
}

fn rgb(light: f32x4) -> Rgb {
    let [r, g, b, _] = light.to_array();
    Rgb([r, g, b])
}

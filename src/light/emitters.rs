//! The emissive triangles of a scene, with a texture in parts: their unshadowed light at a point,
//! and shadow rays chosen by that. Few are all looked at; a tree stands for many.

use super::direct::DirectLight;
use super::emitter::Emitter;
use super::emitter_parts;
use super::shading_point::{Arrival, Receiver, ShadingPoint, SurfaceReceiver};
use super::shadows::Shadows;
use super::tree::{LightCut, LightTree};
use crate::math::{Rgb, Spectrum};
use crate::scene::Scene;
use glam::Vec3;
use smallvec::SmallVec;

/// The emissive triangles of a scene.
#[derive(Debug)]
pub struct Emitters {
    all: Vec<Emitter>,
    /// A tree over many.
    tree: Option<LightTree>,
}

impl Emitters {
    /// Up to this many are all looked at; a tree stands for more.
    const MAX_FEW: usize = 64;

    /// Finds the emitters of a scene.
    pub fn new(scene: &Scene) -> Self {
        Self::of(emitter_parts::emitters(scene))
    }

    /// Takes emitters that are made already, and builds a tree over them if they are many.
    pub fn of(all: Vec<Emitter>) -> Self {
        let tree = if all.len() > Self::MAX_FEW {
            LightTree::new(&all)
        } else {
            None
        };
        Self { all, tree }
    }

    /// How exactly light has to be known: the parts of few surfaces send what so many triangles
    /// would, of which neighbours differ little.
    fn tolerance(&self, asked: CutTolerance) -> CutTolerance {
        let surfaces = self.all.last().map_or(0, |e| e.surface as usize + 1);
        match asked.estimator {
            Estimator::Ratio if surfaces <= Self::MAX_FEW => CutTolerance::SHADING_PARTS,
            _ => asked,
        }
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.all.is_empty()
    }

    /// The corners of those that send any light.
    pub fn corners(&self) -> impl Iterator<Item = [Vec3; 3]> {
        let bright = self.all.iter().filter(|e| e.radiance.max() > 0.0);
        bright.map(|e| e.corners)
    }

    fn get(&self, index: u32) -> &Emitter {
        &self.all[index as usize]
    }

    /// The emitters that shine towards a point, with their indices: of [`Self::MAX_FEW`] at most.
    fn facing(&self, point: Vec3) -> impl Iterator<Item = (u32, &Emitter)> {
        let few = self.all.iter().take(Self::MAX_FEW).enumerate();
        few.filter(move |(_, e)| e.faces(point))
            .map(|(i, e)| (i as u32, e))
    }
}

/// How exactly the light of many emitters is known, and what rays to them are for.
#[derive(Clone, Copy, Debug)]
pub struct CutTolerance {
    /// Share of all light by which one group of emitters may be wrong.
    tolerance: f32,
    estimator: Estimator,
    /// Rays among many emitters for one to a few.
    rays: u32,
}

/// What shadow rays to many emitters tell.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Estimator {
    /// The share that arrives of the groups' light, which has no noise and a little bias.
    Ratio,
    /// All light, without bias.
    Rays,
}

impl CutTolerance {
    /// Whether rays are to tell all light of a point.
    pub fn by_rays_alone(self) -> bool {
        self.estimator == Estimator::Rays
    }

    /// For points that pictures show.
    pub const SHADING: Self = Self {
        tolerance: 0.03,
        estimator: Estimator::Ratio,
        rays: 4,
    };
    /// The same of a few triangles that have textures: as exact a picture in three quarters of the
    /// time.
    pub const SHADING_PARTS: Self = Self {
        tolerance: 0.1,
        estimator: Estimator::Ratio,
        rays: 2,
    };
    /// For gathers, of which pictures show means, too: without bias as these do not go far.
    pub const GATHERING: Self = Self {
        tolerance: 0.1,
        estimator: Estimator::Rays,
        rays: 1,
    };
    /// For points of which pictures show means of many.
    pub const BAKING: Self = Self {
        tolerance: 0.2,
        estimator: Estimator::Rays,
        rays: 1,
    };
}

/// Unshadowed light of all emitters at a point, and the chances of each to get a ray. It serves
/// points beside that one as well: chances need not fit exactly.
#[derive(Debug)]
pub struct Unshadowed<'a, R = SurfaceReceiver> {
    /// Irradiance of a surface, or the integral of radiance over the sphere in a medium; black
    /// where rays are to tell.
    pub light: Rgb,
    emitters: &'a Emitters,
    choice: Choice<'a, R>,
}

/// What chooses an emitter for a ray.
#[derive(Debug)]
enum Choice<'a, R> {
    OfFew(Candidates),
    OfMany(LightCut<'a, R>, CutTolerance),
}

impl<'a, R: Receiver> Unshadowed<'a, R> {
    /// Sums unshadowed light at `origin`.
    pub(super) fn new(
        emitters: &'a Emitters,
        tolerance: CutTolerance,
        origin: Vec3,
        receiver: R,
    ) -> Self {
        let (light, choice) = match &emitters.tree {
            None => {
                let candidates = Candidates::new(emitters, origin, receiver);
                (candidates.light, Choice::OfFew(candidates))
            }
            Some(tree) => {
                let tolerance = emitters.tolerance(tolerance);
                let cut = LightCut::new(tree, &emitters.all, origin, receiver, tolerance.tolerance);
                let light = match tolerance.estimator {
                    Estimator::Ratio => cut.light(),
                    Estimator::Rays => Rgb::BLACK,
                };
                (light, Choice::OfMany(cut, tolerance))
            }
        };
        Self {
            light,
            emitters,
            choice,
        }
    }

    /// Adds what the shadow rays of this point, or of one beside it, find.
    pub(super) fn trace(&self, total: &mut DirectLight, at: &ShadingPoint<impl Shadows, R>) {
        match &self.choice {
            Choice::OfFew(candidates) => candidates.trace(total, self.emitters, at),
            Choice::OfMany(cut, tolerance) => {
                trace_to_many(total, self.emitters, cut, *tolerance, at);
            }
        }
    }
}

/// Those of a few emitters that send light to a point, with the shares of its rays that they get.
#[derive(Clone, Debug, Default)]
struct Candidates {
    /// Unshadowed light of all.
    light: Rgb,
    all: SmallVec<[Candidate; 16]>,
}

/// An emitter that rays of a point may go to.
#[derive(Clone, Copy, Debug)]
struct Candidate {
    index: u32,
    /// Light of this and all candidates before it, mean channel.
    cumulative: f32,
    /// Closed form of the receiver's response to the emitter, per unit radiance.
    response: f32,
}

impl Candidates {
    fn new(emitters: &Emitters, origin: Vec3, receiver: impl Receiver) -> Self {
        let mut found = Self::default();
        let mut sum = 0.0;
        for (index, emitter) in emitters.facing(origin) {
            let response = receiver.response_to_triangle(emitter.corners.map(|c| c - origin));
            let light = emitter.radiance * response;
            let power = light.mean();
            if power > 0.0 {
                found.light += light;
                sum += power;
                found.all.push(Candidate {
                    index,
                    cumulative: sum,
                    response,
                });
            }
        }
        found
    }

    /// Adds what rays find. They share the emitters out by what each would send; each ray counts
    /// by what its point would send.
    fn trace(
        &self,
        total: &mut DirectLight,
        emitters: &Emitters,
        at: &ShadingPoint<impl Shadows, impl Receiver>,
    ) {
        let rays = at.rays;
        let Some(last) = self.all.last() else {
            return;
        };
        let sum = last.cumulative;
        for i in 0..rays.count() {
            let [u, v] = rays.point(i, 63);
            let (chosen, within) = self.choose(u * sum);
            let emitter = emitters.get(chosen.index);
            // What this point sends over what its emitter was expected to: near 1.
            if let Some(ray) = at.ray_to(emitter, [within, v], chosen.response) {
                let light = emitter.radiance * (ray.weight * sum / emitter.radiance.mean());
                let arriving = ray.transmittance.mean_of(light);
                at.receiver.note(ray.direction, arriving, Arrival::Ray);
                // Emitters of one surface are told apart no further than sharing a bit with
                // another.
                total.note_ray(emitter.surface as usize, light, ray.transmittance);
            }
        }
    }

    /// The candidate whose share of the light a part of all light falls into, and where in it, in
    /// [0,1].
    fn choose(&self, target: f32) -> (Candidate, f32) {
        let all = &self.all;
        let k = all
            .iter()
            .position(|c| target < c.cumulative)
            .unwrap_or(all.len() - 1);
        let below = if k == 0 { 0.0 } else { all[k - 1].cumulative };
        let within = (target - below) / (all[k].cumulative - below);
        (all[k], within.clamp(0.0, 1.0))
    }
}

/// Adds what rays to many emitters find and, where the rays tell it, their unshadowed light.
fn trace_to_many<R: Receiver>(
    total: &mut DirectLight,
    emitters: &Emitters,
    cut: &LightCut<R>,
    tolerance: CutTolerance,
    at: &ShadingPoint<impl Shadows, R>,
) {
    let rays = at.rays;
    let count = rays.count() * tolerance.rays;
    let per_ray = 1.0 / tolerance.rays as f32;
    let mut sent = Rgb::BLACK;
    for i in 0..count {
        let [u, v] = rays.point_of_many(i, tolerance.rays);
        let Some(chosen) = cut.choose(u) else {
            continue;
        };
        let emitter = emitters.get(chosen.emitter);
        if let Some(ray) = at.ray_to(emitter, [chosen.within, v], chosen.chance) {
            let light = emitter.radiance * ray.weight;
            // As much of the light as a ray to any other light with an extent brings of its own.
            let own = light * per_ray;
            let arriving = ray.transmittance.mean_of(own);
            at.receiver.note(ray.direction, arriving, Arrival::Ray);
            total.note_ray(emitter.surface as usize, own, ray.transmittance);
            sent += light;
        }
    }
    if tolerance.estimator == Estimator::Rays {
        total.unshadowed += sent * (1.0 / count.max(1) as f32);
    }
}

#[cfg(test)]
impl Emitters {
    /// All of them.
    pub fn all(&self) -> &[Emitter] {
        &self.all
    }

    /// The tree over many; `None` over few.
    pub fn tree(&self) -> Option<&LightTree> {
        self.tree.as_ref()
    }
}

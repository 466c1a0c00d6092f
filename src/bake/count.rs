//! How many surfels a scene asks for.

use super::surfels::{AreaSampler, SurfelMaker};
use crate::Result;
use crate::light::Shadows;
use crate::math::{Ray, Rgb, sampling};
use crate::run::Job;
use glam::Vec3;
use lvox_formats::record::Surfel;
use rayon::prelude::*;

/// Surfels of a scene whose light is even.
const FEW: u64 = 125_000;
/// Surfels of any other.
const MANY: u64 = 500_000;
/// Variance of neighbours, over the square of the mean, up to which light is even. Means of few
/// surfels then have as little noise as those of many have elsewhere.
const EVEN: f64 = 0.05;
/// Pairs of neighbours that are compared.
const PAIRS: u64 = 4096;

/// Few surfels where the direct light of neighbours differs little, else many. Light differs at
/// edges of shadows, by shadow rays in penumbrae, and where the surface ends.
///
/// # Errors
/// A stop on request.
pub(super) fn surfels_for<S: Shadows>(maker: &SurfelMaker<S>, job: &Job) -> Result<u64> {
    let sampler = AreaSampler::new(maker.tracer, PAIRS, maker.seed);
    let pairs: Vec<Option<Pair>> = (0..sampler.count())
        .into_par_iter()
        .map(|i| {
            job.cancel.check()?;
            let (triangle, uv) = sampler.sample(i);
            let is_there = !maker.tracer.is_clear(triangle, uv);
            Ok(is_there.then(|| Pair::new(maker, &sampler, i)))
        })
        .collect::<Result<_>>()?;
    let pairs: Vec<Pair> = pairs.into_iter().flatten().collect();
    maker.tracer.scene.release_mesh();
    let over = |value: fn(&Pair) -> f64| pairs.iter().map(|p| p.area * value(p)).sum::<f64>();
    let (area, mean) = (over(|_| 1.0), over(|p| p.mean));
    let is_even = over(|p| p.variance) * area <= EVEN * mean * mean;
    Ok(if is_even { FEW } else { MANY })
}

/// What two neighbours send.
struct Pair {
    /// That the first stands for, scene units squared.
    area: f64,
    /// Of both sides of the first.
    mean: f64,
    /// Of the two, both sides added up.
    variance: f64,
}

impl Pair {
    fn new<S: Shadows>(maker: &SurfelMaker<S>, sampler: &AreaSampler, i: u64) -> Self {
        let (triangle, uv) = sampler.sample(i);
        let area = sampler.area_per_sample(triangle);
        let scale = PAIRS as f32 / FEW as f32;
        let first = maker.make(triangle, uv, area * scale, 1.0, i);
        let [front, back] = luminance(&first);
        let [other_front, other_back] = Self::neighbour(maker, &first, i).unwrap_or([0.0; 2]);
        Self {
            area: f64::from(area),
            mean: front + back,
            variance: 0.5 * ((front - other_front).powi(2) + (back - other_back).powi(2)),
        }
    }

    /// What a point at most two radii away sends, seen from the front and from the back of a
    /// surfel; none where the surface ends.
    fn neighbour<S: Shadows>(maker: &SurfelMaker<S>, first: &Surfel, i: u64) -> Option<[f64; 2]> {
        let key = PAIRS + i;
        let [u, v] = sampling::disk(sampling::unit2(sampling::hash(&[maker.seed, key])));
        let (reach, normal) = (2.0 * first.radius, Vec3::from_array(first.normal));
        let (x, y) = sampling::tangents(normal);
        let beside = Vec3::from_array(first.position) + reach * (u * x + v * y);
        let down = Ray::new(beside + 0.5 * reach * normal, -normal, reach);
        let hit = maker.tracer.closest(&down)?;
        let second = maker.make(hit.triangle, hit.uv, first.area, 1.0, key);
        let [front, back] = luminance(&second);
        let is_turned = Vec3::from_array(second.normal).dot(normal) < 0.0;
        Some(if is_turned {
            [back, front]
        } else {
            [front, back]
        })
    }
}

/// Of the front and of the back.
fn luminance(surfel: &Surfel) -> [f64; 2] {
    [surfel.front, surfel.back].map(|side| f64::from(Rgb(side).luminance()))
}

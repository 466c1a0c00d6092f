//! What a bake takes, told before the work.

use super::cover::Cover;
use super::{BATCH_SURFELS, Settings, SurfelSampling};
use crate::Result;
use crate::light::KeptLight;
use crate::run::{Budget, Job};
use crate::scene::Scene;
use crate::trace::Tracer;
use lvox_formats::record::Surfel;

/// Refuses a bake that takes more than the job's limit. Returns what it takes: that does not grow
/// with the cloud.
///
/// # Errors
/// [`crate::Kind::Input`] with both sizes.
pub fn check(scene: &Scene, settings: &Settings, job: &Job) -> Result<Budget> {
    /// Bytes of a triangle while creases are found: its neighbours, and what they are found by.
    const CREASES: u64 = 20;
    /// Of chunks of lvoxels, and of light that is kept in their bricks.
    const LVOXELS: u64 = 24 << 20;
    /// Of a triangle of an instance: sums of areas, one for sixteen, in two lists.
    const AREAS: u64 = 1;
    let triangles = scene.mesh.triangles.len() as u64;
    let placed = (scene.mesh.triangle_count() - scene.mesh.flat_count()) as u64;
    let grids: usize = scene.volumes.iter().map(|v| v.sigma_t.bytes()).sum();
    let cover = match scene.volumes.iter().any(Cover::is_worth_it) {
        true => Cover::BYTES,
        false => 0,
    };
    let kept = grids as u64 / 2 + KeptLight::bytes_for(scene) + cover;
    let lvoxels = match scene.volumes.is_empty() {
        true => 0,
        false => LVOXELS,
    };
    let budget = (scene.budget(scene.bytes_of_grids() + kept, job))
        .with("what rays need of it", Tracer::bytes_for(scene))
        .with("creases of surfaces", triangles * CREASES)
        .with("areas of instances", placed * AREAS)
        .with("lvoxels", lvoxels)
        .with("surfels", of_surfels(scene, settings));
    budget.within("this bake", job.memory_limit, "raise `memory_limit`")?;
    Ok(budget)
}

/// Bytes of a batch of surfels: the records, their columns, and these compressed.
pub fn of_surfels(scene: &Scene, settings: &Settings) -> u64 {
    const BATCHES: u64 = 3;
    if scene.mesh.triangle_count() == 0 {
        return 0;
    }
    let samples = match &settings.surfels {
        SurfelSampling::Area { count } => (*count).min(BATCH_SURFELS),
        SurfelSampling::ByLight | SurfelSampling::Camera { .. } => BATCH_SURFELS,
    };
    BATCHES * samples * size_of::<Surfel>() as u64
}

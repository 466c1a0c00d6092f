//! What sweeps and the light of all vertices take, told before they are made.

use crate::Result;
use crate::light::SunDepths;
use crate::run::{Job, memory, size};
use crate::scene::{Scene, Volume};
use crate::view::VisibleMedia;

/// Bytes that rays which are kept to suns and vertices that are lit take, about: those of sweeps
/// are told for themselves. `shows_no_voxels` says of a volume whether its single voxels are too
/// small to matter.
pub fn bytes_for(scene: &Scene, shows_no_voxels: impl Fn(&Volume) -> bool) -> u64 {
    SunDepths::bytes_for(scene, shows_no_voxels)
}

/// Refuses a sweep of a volume that takes more than a limit leaves beside what a stage holds, and
/// has caches make room for one that does not, until the job is told that it is over.
///
/// # Errors
/// Says what it takes, and how to do with less.
pub fn check_sweep(
    volume: &Volume,
    visible: VisibleMedia,
    vertices: u64,
    needed: u64,
    job: &Job,
) -> Result<()> {
    let what = format_args!(
        "sweeping light to {vertices} vertices of volume {:?}",
        volume.name
    );
    let needed = needed.saturating_add(job.held_bytes());
    job.held.set_for_now(needed);
    size::within(what, needed, job.memory_limit).map_err(|e| {
        e.hint(match visible {
            VisibleMedia::ThroughRegions(_) => {
                "raise `memory_limit`, shade a part that sees less of the volume: \
                 `region` X0 Y0 X1 Y1 or `tile` I/N, or do without \
                 sweeps: any `max_dist`, such as 1e9"
            }
            VisibleMedia::All => "raise `memory_limit`",
        })
    })
}

/// Refuses light that a volume scatters, to be made beforehand, if it takes more than a limit
/// leaves beside what a stage holds.
///
/// # Errors
/// Says what it takes, and how to do with less.
pub fn check_scattered(volume: &Volume, vertices: u64, needed: u64, job: &Job) -> Result<()> {
    let what = || {
        format!(
            "scattering light at {vertices} vertices of volume {:?}",
            volume.name
        )
    };
    let beside = needed.saturating_add(job.held_bytes());
    let is_within = size::within(what(), beside, job.memory_limit);
    is_within.map_err(|e| e.hint("raise `memory_limit`"))?;
    memory::check(what(), needed)
}

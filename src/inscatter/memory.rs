//! What sweeps and the light of all vertices take, told before they are made.

use crate::Result;
use crate::run::{memory, size};
use crate::scene::Volume;
use crate::view::VisibleMedia;

/// Refuses a sweep of a volume that takes more than a limit by itself.
///
/// # Errors
/// Says what it takes, and how to do with less.
pub fn check_sweep(
    volume: &Volume,
    visible: VisibleMedia,
    vertices: u64,
    needed: u64,
    limit: Option<u64>,
) -> Result<()> {
    let what = format_args!(
        "sweeping light to {vertices} vertices of volume {:?}",
        volume.name
    );
    size::within(what, needed, limit).map_err(|e| {
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

/// Refuses light that a volume scatters, to be made beforehand, if it takes more than a limit by
/// itself.
///
/// # Errors
/// Says what it takes, and how to do with less.
pub fn check_scattered(
    volume: &Volume,
    vertices: u64,
    needed: u64,
    limit: Option<u64>,
) -> Result<()> {
    let what = || {
        format!(
            "scattering light at {vertices} vertices of volume {:?}",
            volume.name
        )
    };
    size::within(what(), needed, limit).map_err(|e| e.hint("raise `memory_limit`"))?;
    memory::check(what(), needed)
}

//! The hierarchy of two children a node that the one which rays walk is made of.

use crate::run::Cancel;
use crate::{Error, Result};
use obvhs::BvhBuildParams;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::builder::build_bvh2_from_tris;
use obvhs::triangle::Triangle;
use std::sync::mpsc::{self, RecvTimeoutError};
use std::thread;
use std::time::Duration;

/// Number of triangles from which on a hierarchy takes long enough for a stop to be heard
/// meanwhile.
pub const MANY: usize = 1 << 17;
/// Time between two looks at whether to stop.
const PATIENCE: Duration = Duration::from_millis(50);

/// Builds it.
pub fn two_wide(triangles: &[Triangle]) -> Bvh2 {
    build_bvh2_from_tris(
        triangles,
        BvhBuildParams::medium_build(),
        &mut Default::default(),
    )
}

/// Builds it unless a stop is heard before it is done. The crate does not stop once it has begun,
/// so a thread of its own is left behind with it.
///
/// # Errors
/// If cancelled, or if no thread can be had.
pub fn two_wide_until(triangles: Vec<Triangle>, cancel: &Cancel) -> Result<Bvh2> {
    // A worker that waits for the thread below may be one that this waits for.
    if triangles.len() < MANY || rayon::current_thread_index().is_some() {
        cancel.check()?;
        return Ok(two_wide(&triangles));
    }
    let (done, result) = mpsc::channel();
    let build = move || {
        // Nobody is left to have it after a stop.
        let _ = done.send(two_wide(&triangles));
    };
    thread::Builder::new()
        .spawn(build)
        .map_err(|e| Error::failed(format!("cannot start a thread: {e}")))?;
    loop {
        match result.recv_timeout(PATIENCE) {
            Ok(built) => return Ok(built),
            Err(RecvTimeoutError::Timeout) => cancel.check()?,
            Err(RecvTimeoutError::Disconnected) => {
                return Err(Error::failed("the hierarchy of triangles was not finished"));
            }
        }
    }
}

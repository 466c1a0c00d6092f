//! Files that were made from another scene than the one at hand.

use crate::run::Job;
use crate::scene::Scene;
use std::path::Path;

/// Warns of a file that was made from another scene, of which it has the hash and, among its
/// settings, digests of the parts.
pub fn warn_if_out_of_date(
    scene: &Scene,
    origin: (&[u8; 32], &[(String, String)]),
    path: &Path,
    job: &Job,
) {
    if let Some(warning) = out_of_date(scene, origin) {
        job.progress.warn(&format!("{}: {warning}", path.display()));
    }
}

fn out_of_date(
    scene: &Scene,
    (hash, settings): (&[u8; 32], &[(String, String)]),
) -> Option<String> {
    if *hash == scene.hash {
        return None;
    }
    let Some(parts) = scene.parts_that_differ(settings) else {
        return Some(
            "baked from another version of the scene's files; unless only cameras and film have changed, its indirect \
             light is out of date"
                .into(),
        );
    };
    let (last, rest) = parts.split_last()?;
    let other = match rest {
        [] => last.clone(),
        _ => format!("{} and {last}", rest.join(", ")),
    };
    Some(format!(
        "baked from a scene of other {other}; its indirect light is not that of this scene. Bake and build it again"
    ))
}

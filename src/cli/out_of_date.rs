//! Files that were made from another scene than the one at hand.

use super::options::Context;
use crate::formats::one_line;
use crate::scene::Scene;
use crate::{Error, Result};
use std::path::Path;

/// Warns, once, of a file that was made from another scene, of which it has the hash and, among its
/// settings, digests of the parts.
///
/// # Errors
/// Such a file, where the scene has to be the same.
pub fn warn_if_out_of_date(
    scene: &Scene,
    origin: (&[u8; 32], &[(String, String)]),
    path: &Path,
    context: &Context,
) -> Result<()> {
    let Some(warning) = out_of_date(scene, origin) else {
        return Ok(());
    };
    let warning = format!("{}: {warning}", path.display());
    if context.same_scene {
        return Err(Error::input(warning).hint("give each job a folder of its own"));
    }
    // A packed scene holds both a tree and its scattered light, and each frame looks at them.
    if !context
        .job
        .progress
        .warnings()
        .contains(&one_line(&warning))
    {
        context.job.progress.warn(&warning);
    }
    Ok(())
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
            "baked from another version of the scene's files; unless only cameras and film have \
             changed, its indirect light is out of date"
                .into(),
        );
    };
    let (last, rest) = parts.split_last()?;
    let other = match rest {
        [] => last.clone(),
        _ => format!("{} and {last}", rest.join(", ")),
    };
    Some(format!(
        "baked from a scene of other {other}; its indirect light is not that of this scene. Bake \
         and build it again"
    ))
}

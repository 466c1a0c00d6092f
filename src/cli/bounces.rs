//! How often light bounces where a verb goes all the way from a scene to an image.

use crate::Result;
use crate::bounce::{self, Bounces, Settings};
use crate::run::Job;
use crate::scene::Scene;

/// The bounces that were asked for, or else `usual`: but the first alone, which is told, where the
/// light of more cannot be solved.
///
/// # Errors
/// More bounces that were asked for and cannot be solved.
pub fn of_scene(
    asked: Option<Bounces>,
    usual: Bounces,
    scene: &Scene,
    job: &Job,
) -> Result<Bounces> {
    let bounces = asked.unwrap_or(usual);
    let settings = Settings {
        bounces,
        ..Settings::default()
    };
    match bounce::check_scene(scene, &settings) {
        Ok(()) => Ok(bounces),
        Err(error) if asked.is_some() => Err(error),
        Err(error) => {
            let what = format!("bounces but the first are left out: {error}");
            job.progress.warn(&what);
            Ok(Bounces::Count(1))
        }
    }
}

//! Picks shading settings for an error.
//!
//! A scene, its tree and an error enter, a [`Choice`] leaves: `ladder` orders settings from coarse
//! to fine, `pilot` measures the error of a rung on a few blocks of the frame against traced paths,
//! and `search` finds the coarsest rung that will do from few measurements.
//!
//! A pilot shades small blocks, spread over the whole frame whatever part of it is asked for, at a
//! few rungs of a ladder of settings, and measures their error against paths traced at pixels of
//! those blocks. So the choice depends on the scene, the tree, the seed and the target alone, and
//! is the same in every tile and process.

mod ladder;
mod pilot;
mod search;

pub use ladder::{FINEST, rung};
pub use search::Outcome;

use crate::run::Job;
use crate::scene::Scene;
use crate::shade::Settings;
use crate::tree::OpenTree;
use crate::{Error, Result};
use pilot::Pilot;

/// What was picked, and why.
#[derive(Clone, Debug)]
pub struct Choice {
    /// What to shade with.
    pub settings: Settings,
    /// Its place on the ladder, 0 to `FINEST`.
    pub rung: f64,
    /// The error that the pilot lets expect: trimmed relMSE against the truth.
    pub expected: f64,
    /// Whether that is the target.
    pub outcome: Outcome,
    /// Rungs that the pilot shaded and the errors it found, coarse to fine.
    pub tried: Vec<(f64, f64)>,
}

/// Refuses targets that are no trimmed relMSE.
///
/// # Errors
/// If the target is not a number above 0 and below 1.
pub fn check(target: f64) -> Result<()> {
    if target > 0.0 && target < 1.0 {
        Ok(())
    } else {
        Err(Error::input(format!(
            "`target_error` must be more than 0 and less than 1, found {target}"
        ))
        .hint(
            "it is a trimmed relMSE as `lvox compare` prints it: 1e-2 is coarse, 1e-3 fair, \
             1e-4 fine",
        ))
    }
}

/// Picks the cheapest settings whose trimmed relMSE over the frame is about `target`. `adapt` puts
/// what is fixed, such as the camera and the seed, into the settings of a rung.
///
/// # Errors
/// A target or settings out of range, an unknown camera, a page that cannot be read, or a stop on
/// request.
pub fn choose(
    scene: &Scene,
    store: &OpenTree,
    target: f64,
    adapt: impl Fn(Settings) -> Settings,
    job: &Job,
) -> Result<Choice> {
    check(target)?;
    job.watched_stage("pilot", store.fitter(job), |counts| {
        let mut pilot = Pilot::new(scene, store, &adapt(rung(0.0)), job)?;
        let found = search::search(target, FINEST, |t| {
            pilot.error(store, &adapt(rung(t)), target, job)
        })?;
        let settings = adapt(rung(found.rung));
        if pilot.lost() > 0 {
            job.progress.warn(&format!(
                "the pilot of `target_error` left out {} of {} paths whose light is \
                 infinite or not a number",
                pilot.lost(),
                pilot.paths()
            ));
        }
        for (name, value) in [
            ("target_error", target),
            ("expected_error", found.expected),
            ("rung", found.rung),
            ("rungs_tried", found.tried.len() as f64),
            ("pixels", pilot.pixels() as f64),
            ("paths", pilot.paths() as f64),
            ("paths_lost", pilot.lost() as f64),
        ] {
            counts.insert(name.into(), value);
        }
        Ok(Choice {
            settings,
            rung: found.rung,
            expected: found.expected,
            outcome: found.outcome,
            tried: found.tried,
        })
    })
}

//! Finds the place on a ladder where an error is met, from few measurements, of which fine ones
//! cost the most.

use crate::Result;
use libm::{exp, log};

/// How a choice relates to its target.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// The target is expected to be met.
    Met,
    /// The coarsest settings already do better.
    Better,
    /// No settings come down to the target: what is left is bias, or noise of the finest rung.
    OutOfReach,
}

/// What a search found.
#[derive(Clone, Debug)]
pub struct Found {
    /// Place on the ladder.
    pub rung: f64,
    /// Trimmed relMSE expected there.
    pub expected: f64,
    /// Whether that is the target.
    pub outcome: Outcome,
    /// Places measured and their errors, coarse to fine.
    pub tried: Vec<(f64, f64)>,
}

/// Where the search begins: cheap, and often within reach of the target by one more step.
const FIRST: f64 = 2.0;
/// Logarithm of the factor by which noise falls from rung to rung, for a first guess.
const FALL: f64 = 0.85;
/// The least it has been seen to be: what falls more slowly is taken for bias.
const SLOW: f64 = 0.5;
/// Rungs below this do not tell that a target is out of reach: there, noise hides how fast the rest
/// falls.
const PROOF: f64 = 4.5;
/// A measured error this close to the target is taken, as a logarithm.
const CLOSE: f64 = 0.12;
/// The longest step up, in rungs.
const MAX_RUNGS_A_STEP: f64 = 1.75;
/// Rungs beyond the finest measurement that the model is trusted for.
const TRUST: f64 = 0.8;
/// Rungs that a measurement stays below the guess: the last stretch is cheaper to trust than to
/// measure.
const SHORT: f64 = 0.4;
/// Most measurements.
const MAX_TRIES: usize = 5;
/// Share of bias that noise may add where bias alone is too much.
const BESIDE_BIAS: f64 = 0.5;

enum Next {
    Measure(f64),
    Take(f64, f64, Outcome),
}

/// Searches places 0 to `finest` for the coarsest whose error is `target`; `measure` gives the
/// error at a place.
pub fn search(
    target: f64,
    finest: f64,
    mut measure: impl FnMut(f64) -> Result<f64>,
) -> Result<Found> {
    let mut tried: Vec<(f64, f64)> = Vec::with_capacity(MAX_TRIES);
    let mut place = FIRST.min(finest);
    loop {
        let error = measure(place)?;
        let at = tried.partition_point(|&(t, _)| t < place);
        tried.insert(at, (place, error));
        match next(&tried, target, finest) {
            Next::Measure(t) => place = t,
            Next::Take(rung, expected, outcome) => {
                return Ok(Found {
                    rung,
                    expected,
                    outcome,
                    tried,
                });
            }
        }
    }
}

fn next(tried: &[(f64, f64)], target: f64, finest: f64) -> Next {
    if let Some(&(t, e)) = tried.iter().find(|(_, e)| log(e / target).abs() < CLOSE) {
        return Next::Take(t, e, Outcome::Met);
    }
    let above = tried.iter().rev().find(|(_, e)| *e > target);
    match (above, tried.iter().find(|(_, e)| *e <= target)) {
        (Some(&(t, e)), Some(&(fine_t, fine_e))) if fine_t > t => {
            let f = log(e / target) / log(e / fine_e);
            Next::Take(t + f * (fine_t - t), target, Outcome::Met)
        }
        (_, Some(&(t, e))) => {
            // All that was measured is better than need be, or errors do not fall: go by the
            // coarsest.
            if t <= 0.0 {
                Next::Take(t, e, Outcome::Better)
            } else if tried.len() >= MAX_TRIES {
                Next::Take(t, e, Outcome::Met)
            } else {
                Next::Measure((t - log(target / e) / FALL).max(0.0))
            }
        }
        (_, None) => up(tried, target, finest),
    }
}

/// Where to go when all that was measured is too coarse, by a model of noise that falls and bias
/// that stays.
fn up(tried: &[(f64, f64)], target: f64, finest: f64) -> Next {
    let (t, e) = tried[tried.len() - 1];
    let Some((t0, e0)) = tried.len().checked_sub(2).map(|i| tried[i]) else {
        let place = t + log(e / target) / FALL;
        return Next::Measure(place.max(t + 1.0).min(t + MAX_RUNGS_A_STEP).min(finest));
    };
    let left = exp(-SLOW * (t - t0));
    let noise = (e0 - e) * left / (1.0 - left);
    let (noise, fall) = if noise < e {
        (noise.max(0.0), SLOW)
    } else {
        (e, log(e0 / e) / (t - t0))
    };
    let bias = e - noise;
    if bias > target && t < PROOF.min(finest) && tried.len() < MAX_TRIES {
        return Next::Measure(PROOF.min(finest));
    }
    let goal = (target - bias).max(BESIDE_BIAS * bias);
    let place = (t + log(noise / goal) / fall).clamp(t, finest);
    if place - t > TRUST && tried.len() < MAX_TRIES {
        return Next::Measure((place - SHORT).min(t + MAX_RUNGS_A_STEP));
    }
    let place = place.min(t + TRUST);
    let expected = bias + noise * exp(fall * (t - place));
    let outcome = if log(expected / target) < CLOSE {
        Outcome::Met
    } else {
        Outcome::OutOfReach
    };
    Next::Take(place, expected, outcome)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Noise that falls by a factor a rung, and bias.
    fn found(target: f64, first: f64, fall: f64, bias: f64) -> Found {
        search(target, 7.0, |t| Ok(first * fall.powf(-t) + bias)).unwrap()
    }

    #[test]
    fn targets_are_met_whatever_the_slope() {
        for (first, fall, bias) in [(1e-2, 2.0, 0.0), (1e-2, 3.0, 2e-5), (3e-3, 1.6, 1e-4)] {
            for target in [2e-3, 1e-3, 3e-4] {
                let f = found(target, first, fall, bias);
                let error = first * fall.powf(-f.rung) + bias;
                assert_eq!(f.outcome, Outcome::Met, "{first} {fall} {target}");
                assert!((error / target).ln().abs() < 0.25, "{error} for {target}");
                assert!(f.tried.len() <= MAX_TRIES);
            }
        }
    }

    #[test]
    fn bias_above_the_target_is_out_of_reach_and_costs_little() {
        let f = found(1e-4, 1e-2, 2.3, 5e-4);
        assert_eq!(f.outcome, Outcome::OutOfReach);
        assert!(f.rung < 6.5, "{f:?}");
        assert!(f.expected > 5e-4 && f.expected < 8e-4, "{f:?}");
    }

    #[test]
    fn the_coarsest_rung_may_be_better_than_asked_for() {
        let f = found(3e-2, 1e-2, 2.3, 0.0);
        assert_eq!((f.rung, f.outcome), (0.0, Outcome::Better));
    }

    #[test]
    fn noise_of_the_finest_rung_may_be_too_much() {
        let f = found(1e-6, 1e-2, 2.3, 0.0);
        assert_eq!((f.rung, f.outcome), (7.0, Outcome::OutOfReach));
        assert!((f.expected / (1e-2 * 2.3f64.powi(-7))).ln().abs() < 0.1);
    }

    #[test]
    fn errors_that_rise_end_the_search() {
        for target in [1e-4, 1e-3, 1e-2] {
            let curves: [fn(f64) -> f64; 4] = [
                |t| 1e-3 * (1.0 + t),
                |t| 0.8e-3 * (1.0 + 0.01 * t),
                |_| f64::MIN_POSITIVE,
                |_| 0.5,
            ];
            for curve in curves {
                let f = search(target, 7.0, |t| Ok(curve(t))).unwrap();
                assert!(
                    f.tried.len() <= MAX_TRIES && (0.0..=7.0).contains(&f.rung),
                    "{f:?}"
                );
                assert!(f.expected.is_finite());
            }
        }
    }
}

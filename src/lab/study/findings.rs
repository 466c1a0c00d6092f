//! What the numbers of a study say: how fast errors fall, how long Monte Carlo takes for the same,
//! and which runs no other beats.

use super::method::Method;
use super::record::{Errors, Findings, Run, Slope, Study, Versus};
use super::sweep::Sweep;
use std::collections::BTreeSet;

/// How many times the longest run of Monte Carlo its curve is followed: beyond that two runs say
/// nothing.
pub const FARTHEST: f64 = 10.0;

/// What Monte Carlo is compared by.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Metric {
    /// Falls as one over the samples, down to the noise of the reference. The run with most samples
    /// that is well above that noise gives the factor.
    RelMse,
    /// Falls faster than any law: a straight line in logarithms between neighbouring runs, and
    /// beyond the last by the line through the last two.
    Pdiff,
    /// As pdiff.
    Flip,
}

impl Metric {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::RelMse, Self::Pdiff, Self::Flip];

    /// As in `study.json`.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::RelMse => "relmse",
            Self::Pdiff => "pdiff",
            Self::Flip => "flip",
        }
    }

    /// Its value among those of a run.
    #[must_use]
    pub fn of(self, errors: &Errors) -> Option<f64> {
        match self {
            Self::RelMse => errors.relmse,
            Self::Pdiff => errors.pdiff,
            Self::Flip => errors.flip,
        }
    }
}

/// Error of Monte Carlo over its CPU seconds.
struct Curve {
    metric: Metric,
    /// Seconds and error of the runs, fastest first.
    points: Vec<(f64, f64)>,
    /// What no number of samples takes away.
    floor: f64,
    /// Below this errors are the same: half a pixel's worth.
    least: f64,
}

impl Curve {
    fn new(study: &Study, metric: Metric) -> Option<Self> {
        let [width, height] = study.film.map(f64::from);
        let least = match metric {
            Metric::Pdiff => 0.5 / (width * height).max(1.0),
            Metric::RelMse | Metric::Flip => f64::MIN_POSITIVE,
        };
        let runs = study.runs.iter().filter(|r| r.method == Method::MonteCarlo);
        let mut points: Vec<(f64, f64)> = runs
            .filter_map(|r| Some((r.time().cpu_secs, metric.of(&r.errors)?.max(least))))
            .filter(|p| p.0 > 0.0)
            .collect();
        points.sort_by(|a, b| a.0.total_cmp(&b.0));
        let floor = match metric {
            Metric::RelMse => study.reference.relmse.unwrap_or(0.0),
            Metric::Pdiff | Metric::Flip => 0.0,
        };
        (points.len() >= 2).then_some(Self {
            metric,
            points,
            floor,
            least,
        })
    }

    /// relMSE above the floor, times seconds.
    fn factor(&self) -> f64 {
        let above = |p: &&(f64, f64)| p.1 >= 2.0 * self.floor;
        let (secs, error) = *self.points.iter().rfind(above).unwrap_or(&self.points[0]);
        secs * (error - self.floor).max(f64::MIN_POSITIVE)
    }

    /// The two runs between or beyond which a value lies, by `key`, which rises or falls along the
    /// runs.
    fn neighbours(&self, is_before: impl Fn(&(f64, f64)) -> bool) -> [(f64, f64); 2] {
        let i = self.points.partition_point(is_before);
        let i = i.clamp(1, self.points.len() - 1);
        [self.points[i - 1], self.points[i]]
    }

    fn secs(&self, error: f64) -> Option<f64> {
        if self.metric == Metric::RelMse {
            return (error > self.floor).then(|| self.factor() / (error - self.floor));
        }
        let error = error.max(self.least);
        let [a, b] = self.neighbours(|p| p.1 > error);
        let slope = (b.0 / a.0).ln() / (b.1 / a.1).ln();
        let secs = (a.0.ln() + slope * (error / a.1).ln()).exp();
        (secs.is_finite() && slope < 0.0).then_some(secs)
    }

    fn error(&self, secs: f64) -> Option<f64> {
        if self.metric == Metric::RelMse {
            return Some(self.factor() / secs + self.floor);
        }
        let [a, b] = self.neighbours(|p| p.0 < secs);
        let slope = (b.1 / a.1).ln() / (b.0 / a.0).ln();
        let error = (a.1.ln() + slope * (secs / a.0).ln()).exp();
        error.is_finite().then_some(error.min(1.0))
    }

    fn farthest(&self) -> f64 {
        FARTHEST * self.points[self.points.len() - 1].0
    }

    fn covers(&self, secs: f64) -> bool {
        let last = self.points.len() - 1;
        (self.points[0].0..=self.points[last].0).contains(&secs)
    }
}

impl Study {
    /// Works out the findings anew.
    pub fn find(&mut self) {
        self.findings = Findings {
            slopes: self.slopes(),
            pareto: self.pareto(),
            versus: self.versus(),
        };
    }

    fn slopes(&self) -> Vec<Slope> {
        let mut slopes = Vec::new();
        for method in Method::ALL {
            let runs: Vec<&Run> = self.runs.iter().filter(|r| r.method == method).collect();
            let mut sweeps: BTreeSet<Sweep> = runs.iter().map(|r| r.sweep).collect();
            if sweeps.contains(&Sweep::Surfels) {
                sweeps.insert(Sweep::SurfelRadius);
            }
            for sweep in sweeps.into_iter().filter(|s| !s.is_alone()) {
                slopes.extend(slope(method, sweep, self.sweep(method, sweep)));
            }
        }
        slopes
    }

    /// Values of a setting and relMSE of the runs that vary it, and of the base.
    #[must_use]
    pub fn sweep(&self, method: Method, setting: Sweep) -> Vec<(f64, f64)> {
        let runs = self.sweep_runs(method, setting).into_iter();
        runs.filter_map(|(value, run)| Some((value, run.errors.relmse?)))
            .collect()
    }

    /// Values of a setting, and the runs that vary it, and the base.
    #[must_use]
    pub fn sweep_runs(&self, method: Method, setting: Sweep) -> Vec<(f64, &Run)> {
        let of_clouds = setting == Sweep::SurfelRadius;
        let sweep = if of_clouds { Sweep::Surfels } else { setting };
        self.runs
            .iter()
            .filter(|r| r.method == method && (r.sweep == sweep || r.sweep == Sweep::Base))
            .filter_map(|r| {
                let value = if of_clouds {
                    self.cloud_of(r)?.surfel_radius
                } else {
                    *r.values.get(&sweep)?
                };
                Some((value, r))
            })
            .collect()
    }

    fn pareto(&self) -> Vec<String> {
        let mut order: Vec<(f64, f64, &str)> = self
            .runs
            .iter()
            .filter_map(|r| Some((r.time().cpu_secs, r.errors.relmse?, r.name.as_str())))
            .collect();
        order.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
        let mut least = f64::INFINITY;
        let mut pareto = Vec::new();
        for (_, error, name) in order {
            if error < least {
                least = error;
                pareto.push(name.to_owned());
            }
        }
        pareto
    }

    fn versus(&self) -> Vec<Versus> {
        let mut all = Vec::new();
        for metric in Metric::ALL {
            let Some(curve) = Curve::new(self, metric) else {
                continue;
            };
            for run in self.runs.iter().filter(|r| r.method != Method::MonteCarlo) {
                let secs = run.time().cpu_secs;
                let Some(error) = metric.of(&run.errors).filter(|_| secs > 0.0) else {
                    continue;
                };
                let found = curve.secs(error);
                let equal = found.map(|t| t.min(curve.farthest()));
                all.push(Versus {
                    run: run.name.clone(),
                    metric: metric.name().into(),
                    equal_error_secs: equal,
                    speed_up: equal.map(|t| t / secs),
                    total_speed_up: equal.map(|t| t / self.total_secs(run)),
                    equal_time_error: curve.error(secs),
                    extrapolated: equal.is_some_and(|t| !curve.covers(t)),
                    capped: found.is_some_and(|t| t > curve.farthest()),
                    time_extrapolated: !curve.covers(secs),
                });
            }
        }
        all
    }

    /// A run beside Monte Carlo, if there is anything to compare.
    #[must_use]
    pub fn versus_of(&self, run: &Run, metric: Metric) -> Option<&Versus> {
        let of = |v: &&Versus| v.run == run.name && v.metric == metric.name();
        self.findings.versus.iter().find(of)
    }
}

fn slope(method: Method, setting: Sweep, mut points: Vec<(f64, f64)>) -> Option<Slope> {
    points.retain(|(x, y)| *x > 0.0 && *y > 0.0);
    points.sort_by(|a, b| a.0.total_cmp(&b.0));
    if !setting.rises() {
        points.reverse();
    }
    let [coarsest, .., finest] = points[..] else {
        return None;
    };
    Some(Slope {
        method,
        setting,
        exponent: fit(&points)?,
        coarse_exponent: fit(&points[..2])?,
        runs: points.len(),
        coarsest: coarsest.into(),
        finest: finest.into(),
        floor: points.iter().map(|p| p.1).fold(f64::INFINITY, f64::min),
    })
}

/// Exponent of the line through points in logarithms; `None` without two different ones.
fn fit(points: &[(f64, f64)]) -> Option<f64> {
    let logs: Vec<(f64, f64)> = points.iter().map(|(x, y)| (x.ln(), y.ln())).collect();
    let n = logs.len() as f64;
    let mean_x = logs.iter().map(|p| p.0).sum::<f64>() / n;
    let mean_y = logs.iter().map(|p| p.1).sum::<f64>() / n;
    let xx: f64 = logs.iter().map(|p| (p.0 - mean_x).powi(2)).sum();
    let xy: f64 = logs.iter().map(|p| (p.0 - mean_x) * (p.1 - mean_y)).sum();
    (xx > 0.0).then(|| xy / xx)
}

#[cfg(test)]
mod tests {
    use super::super::record::{Cloud, Reference, Timing};
    use super::*;

    fn run(method: Method, sweep: Sweep, value: f64, secs: f64, relmse: f64, pdiff: f64) -> Run {
        let round = |f: f64| Timing {
            wall_secs: secs * f,
            cpu_secs: secs * f,
        };
        Run {
            name: format!("{method}-{sweep}-{value}"),
            method,
            sweep,
            values: [(sweep, value)].into(),
            rounds: vec![round(9.0), round(1.0), round(0.5)],
            errors: Errors {
                relmse: Some(relmse),
                pdiff: Some(pdiff),
                ..Errors::default()
            },
            ..Run::default()
        }
    }

    fn study() -> Study {
        let mut study = Study {
            film: [100, 50],
            reference: Reference {
                relmse: Some(0.001),
                ..Reference::default()
            },
            runs: vec![
                run(Method::MonteCarlo, Sweep::Spp, 1.0, 1.0, 1.001, 0.4),
                run(Method::MonteCarlo, Sweep::Spp, 4.0, 4.0, 0.251, 0.2),
                run(Method::MonteCarlo, Sweep::Spp, 16.0, 16.0, 0.0635, 0.02),
                run(Method::Extended, Sweep::Base, 0.0, 2.0, 0.011, 0.1),
                run(Method::Extended, Sweep::Samples, 4.0, 1.0, 0.2, 0.0),
                run(Method::Extended, Sweep::Samples, 8.0, 1.5, 0.05, 0.3),
                run(Method::Extended, Sweep::Samples, 16.0, 2.5, 0.025, 0.001),
            ],
            ..Study::default()
        };
        study.find();
        study
    }

    #[test]
    fn slopes_say_where_they_begin_and_end() {
        let study = study();
        let [mc, samples] = &study.findings.slopes[..] else {
            panic!("{:?}", study.findings.slopes);
        };
        assert!((mc.exponent + 1.0).abs() < 0.01 && mc.runs == 3);
        assert_eq!(samples.setting, Sweep::Samples);
        assert!((samples.coarse_exponent + 2.0).abs() < 1e-9);
        assert!((samples.exponent + 1.5).abs() < 1e-9, "{samples:?}");
        assert_eq!(samples.coarsest, [4.0, 0.2]);
        assert_eq!(samples.finest, [16.0, 0.025]);
        assert_eq!(samples.floor, 0.025);
    }

    #[test]
    fn radius_is_fitted_from_the_clouds_and_falls_towards_zero() {
        let mut study = Study::default();
        for (name, radius, error) in [("a", 0.4, 0.16), ("b", 0.2, 0.04), ("c", 0.1, 0.01)] {
            let mut run = run(
                Method::Extended,
                Sweep::Surfels,
                1.0 / radius,
                1.0,
                error,
                0.1,
            );
            run.cloud = Some(name.into());
            study.runs.push(run);
            study.clouds.push(Cloud {
                name: name.into(),
                surfel_radius: radius,
                ..Cloud::default()
            });
        }
        study.find();
        let slope = &study.findings.slopes[1];
        assert_eq!(slope.setting, Sweep::SurfelRadius);
        assert!((slope.exponent - 2.0).abs() < 1e-9);
        assert_eq!(slope.coarsest, [0.4, 0.16]);
    }

    #[test]
    fn monte_carlo_is_held_to_the_same_error_and_the_same_time() {
        let study = study();
        let of = |name: &str, metric| {
            let run = study.runs.iter().find(|r| r.name == name).unwrap();
            study.versus_of(run, metric).unwrap()
        };
        let base = of("extended-base-0", Metric::RelMse);
        // 0.01 above the floor takes 100 s, the run took 2.
        assert!((base.equal_error_secs.unwrap() - 100.0).abs() < 1e-6);
        assert!((base.speed_up.unwrap() - 50.0).abs() < 1e-6);
        assert_eq!(base.total_speed_up, base.speed_up);
        assert!((base.equal_time_error.unwrap() - 0.501).abs() < 1e-6);
        assert!(base.extrapolated && !base.capped && !base.time_extrapolated);
        let pdiff = of("extended-base-0", Metric::Pdiff);
        let expected = (4.0_f64.ln() + 4.0_f64.ln() * 2.0_f64.ln() / 10.0_f64.ln()).exp();
        assert!((pdiff.equal_error_secs.unwrap() - expected).abs() < 1e-6);
        assert!(!pdiff.extrapolated);
        // None at all counts as half a pixel, which the line through the last two runs reaches
        // after 388 s: too far.
        let none = of("extended-samples-4", Metric::Pdiff);
        assert_eq!(none.equal_error_secs, Some(160.0));
        assert!(none.extrapolated && none.capped);
        let near = of("extended-samples-16", Metric::Pdiff);
        let secs = (16.0_f64.ln() + 4.0_f64.ln() * (0.02_f64 / 1e-3).ln() / 10.0_f64.ln()).exp();
        assert!((near.equal_error_secs.unwrap() - secs).abs() < 1e-6);
        assert!(near.extrapolated && !near.capped);
    }

    #[test]
    fn what_was_not_measured_stands_in_brackets_and_what_is_far_is_a_bound() {
        let mut study = study();
        // Faster than any run of Monte Carlo, and almost as good as the reference.
        let mut fast = run(Method::Extended, Sweep::Paper, 0.0, 0.5, 0.0011, 0.0);
        fast.rounds.truncate(2);
        fast.rounds[0] = fast.rounds[1];
        study.runs.push(fast);
        study.find();
        let table = super::super::table::summary(&study);
        let row = |name: &str| {
            let found = table.rows.iter().find(|r| r[0] == name).unwrap();
            found.clone()
        };
        let at = |column: &str| table.head.iter().position(|h| *h == column).unwrap();
        let fast = row("extended-paper-0");
        for column in ["equal pdiff", "equal relMSE"] {
            let at = at(&format!("rendering faster at {column}"));
            assert_eq!(fast[at], "(> 320 x)", "{column}");
        }
        // Both metrics have a column of that name.
        let time_errors = table.head.iter().enumerate();
        let time_errors = time_errors.filter(|(_, h)| **h == "Monte Carlo's in that time");
        for (at, _) in time_errors {
            assert!(fast[at].starts_with('(') && fast[at].ends_with(')'));
            assert!(!row("extended-base-0")[at].starts_with('('));
        }
    }

    #[test]
    fn baking_and_building_count_for_one_image() {
        let mut study = study();
        study.runs[3].cloud = Some("c".into());
        let secs = |cpu_secs| Timing {
            cpu_secs,
            ..Timing::default()
        };
        study.clouds.push(Cloud {
            name: "c".into(),
            bake: secs(5.0),
            build: secs(1.0),
            ..Cloud::default()
        });
        study.find();
        let base = study.versus_of(&study.runs[3], Metric::RelMse).unwrap();
        // 100 s of Monte Carlo over 2 of rendering, and over those with 6 of baking and building.
        assert!((base.speed_up.unwrap() - 50.0).abs() < 1e-6);
        assert!((base.total_speed_up.unwrap() - 12.5).abs() < 1e-6);
        let table = super::super::table::summary(&study);
        let row = table
            .rows
            .iter()
            .find(|r| r[0] == "extended-base-0")
            .unwrap();
        for (column, cell) in [
            ("rendering faster at equal relMSE", "(50.0 x)"),
            ("with bake and build, equal relMSE", "(12.5 x)"),
        ] {
            let at = table.head.iter().position(|h| *h == column).unwrap();
            assert_eq!(row[at], cell);
        }
    }

    #[test]
    fn nothing_beats_the_front() {
        let names = [
            "extended-samples-4",
            "extended-samples-8",
            "extended-base-0",
        ];
        let study = study();
        assert_eq!(study.findings.pareto, names);
        assert_eq!(study.runs[3].time().cpu_secs, 2.0);
    }
}

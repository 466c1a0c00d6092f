//! The curves of a study, both axes logarithmic. Errors are less the noise of the reference, where
//! that is known, and means over seeds.

use super::chart::{Mark, Series, draw, has_place};
use super::method::Method;
use super::record::{Run, Study};
use super::sweep::Sweep;
use crate::{Error, Result};
use plotters::style::RGBColor;

/// A picture by name.
pub struct Plot {
    /// Name, fit for a file.
    pub name: &'static str,
    /// What it shows.
    pub title: &'static str,
    /// The SVG.
    pub svg: String,
}

const COLORS: [(Method, RGBColor); 3] = [
    (Method::MonteCarlo, RGBColor(86, 86, 86)),
    (Method::Traditional, RGBColor(213, 94, 0)),
    (Method::Extended, RGBColor(0, 114, 178)),
];
const GREEN: RGBColor = RGBColor(0, 158, 115);
const PINK: RGBColor = RGBColor(204, 121, 167);

/// Of other renderers, in the order in which they are named.
const PEER_COLORS: [RGBColor; 6] = [
    GREEN,
    PINK,
    RGBColor(230, 159, 0),
    RGBColor(86, 180, 233),
    RGBColor(117, 76, 36),
    RGBColor(120, 94, 240),
];

/// Names of all plots that there can be.
pub const NAMES: [&str; 6] = [
    "error-over-render-time",
    "error-over-total-time",
    "error-over-surfels",
    "time-over-surfels",
    "error-over-settings",
    "pareto",
];

/// Plots of what changes along the sweep of a setting.
const SWEEPS: [&str; 3] = [
    "error-over-surfels",
    "time-over-surfels",
    "error-over-settings",
];

/// All plots that there are numbers for.
///
/// # Errors
/// If one cannot be drawn.
pub fn all(study: &Study) -> Result<Vec<Plot>> {
    let mut plots = Vec::new();
    let mut add = |name: &'static str,
                   title,
                   axes: [&str; 2],
                   mut series: Vec<Series>,
                   noise: Option<f64>| {
        debug_assert!(NAMES.contains(&name));
        // Along a sweep one point says nothing.
        if SWEEPS.contains(&name) {
            series.retain(|s| s.marks.len() > 1);
        }
        if series.iter().any(|s| !s.marks.is_empty()) {
            let svg = draw(axes, &series, noise)
                .map_err(|e| Error::failed(format!("cannot draw {name}: {e}")))?;
            plots.push(Plot { name, title, svg });
        }
        Ok::<(), Error>(())
    };
    let noise = study.noise();
    let error = match noise {
        Some(_) => "relMSE less the noise of the reference",
        None => "relMSE",
    };
    let with_peers = |mut series: Vec<Series>| {
        series.extend(peers(study));
        series
    };
    add(
        "error-over-render-time",
        "Error over the time of rendering",
        ["render, CPU s", error],
        with_peers(by_method(study, &|r| Some(r.time().cpu_secs))),
        noise,
    )?;
    add(
        "error-over-total-time",
        "Error over the time of baking, building and rendering",
        ["bake, build and render, CPU s", error],
        with_peers(by_method(study, &|r| Some(study.total_secs(r)))),
        noise,
    )?;
    let surfels = |r: &Run| Some(study.cloud_of(r)?.surfels as f64);
    let over_surfels = COLORS[1..].iter().map(|&(method, color)| {
        let runs = cloud_sweep(study, method);
        let marks = runs.filter_map(|r| mark(study, surfels(r)?, r));
        joined(method.to_string(), color, marks.collect())
    });
    add(
        "error-over-surfels",
        "Error over the size of the cloud",
        ["surfels", error],
        over_surfels.collect(),
        noise,
    )?;
    add(
        "time-over-surfels",
        "Time over the size of the cloud",
        ["surfels", "CPU s"],
        time_over_surfels(study),
        None,
    )?;
    add(
        "error-over-settings",
        "Error over each setting of the extended method",
        ["setting, times coarser than the finest", error],
        error_over_settings(study),
        noise,
    )?;
    add(
        "pareto",
        "Runs that no other beats in both time and error",
        ["render, CPU s", error],
        front(study),
        noise,
    )?;
    Ok(plots)
}

/// The point of a run: its error over something.
fn mark(study: &Study, x: f64, run: &Run) -> Option<Mark> {
    let relmse = run.relmse_over_seeds()?;
    let (y, is_bound) = study.less_noise(relmse.mean);
    let bar =
        (relmse.seeds > 1).then(|| [relmse.least, relmse.most].map(|v| study.less_noise(v).0));
    Some(Mark {
        x,
        y,
        bar: bar.filter(|ends| ends.iter().all(|&v| has_place(v))),
        is_bound,
    })
}

/// A point without any spread.
fn plain(x: f64, y: f64) -> Mark {
    Mark {
        x,
        y,
        bar: None,
        is_bound: false,
    }
}

/// Those that have a place, by the first axis.
fn sorted(mut marks: Vec<Mark>) -> Vec<Mark> {
    marks.retain(|m| has_place(m.x) && has_place(m.y));
    marks.sort_by(|a, b| a.x.total_cmp(&b.x));
    marks
}

fn joined(label: String, color: RGBColor, marks: Vec<Mark>) -> Series {
    Series {
        label,
        color,
        marks: sorted(marks),
        joined: true,
        is_foreign: false,
        names: Vec::new(),
    }
}

fn by_method(study: &Study, secs: &dyn Fn(&Run) -> Option<f64>) -> Vec<Series> {
    let of_method = |&(method, color): &(Method, RGBColor)| {
        let runs = study.runs.iter().filter(|r| r.method == method);
        let marks = runs.filter_map(|r| mark(study, secs(r)?, r));
        Series {
            joined: method == Method::MonteCarlo,
            ..joined(method.to_string(), color, marks.collect())
        }
    };
    COLORS.iter().map(of_method).collect()
}

/// Points of other renderers, those of one name in one series.
fn peers(study: &Study) -> Vec<Series> {
    let mut names: Vec<&str> = Vec::new();
    for peer in &study.peers {
        if !names.contains(&peer.name.as_str()) {
            names.push(&peer.name);
        }
    }
    let of_name = |(name, color): (&str, &RGBColor)| {
        let own = study.peers.iter().filter(|p| p.name == name);
        let marks = own.filter_map(|p| {
            let (y, is_bound) = study.less_noise(p.errors.relmse?);
            Some(Mark {
                is_bound,
                ..plain(p.cpu_secs, y)
            })
        });
        Series {
            is_foreign: true,
            ..joined(name.to_owned(), *color, marks.collect())
        }
    };
    let colors = PEER_COLORS.iter().cycle();
    names.into_iter().zip(colors).map(of_name).collect()
}

fn cloud_sweep(study: &Study, method: Method) -> impl Iterator<Item = &Run> {
    study
        .runs
        .iter()
        .filter(move |r| r.method == method && [Sweep::Surfels, Sweep::Base].contains(&r.sweep))
}

/// The sweeps that the slopes are fitted to.
fn error_over_settings(study: &Study) -> Vec<Series> {
    const SETTINGS: [(Sweep, RGBColor); 5] = [
        (Sweep::Samples, COLORS[2].1),
        (Sweep::MaxSolidAngle, COLORS[1].1),
        (Sweep::SurfelRadius, GREEN),
        (Sweep::BlockDepth, PINK),
        (Sweep::BlockVoxels, COLORS[0].1),
    ];
    let of_setting = |&(setting, color): &(Sweep, RGBColor)| {
        let found = study.sweep_runs(Method::Extended, setting);
        // All settings are coarser upwards once those that are finer upwards are turned over.
        let coarse = |v: f64| if setting.rises() { 1.0 / v } else { v };
        let values = found.iter().map(|p| coarse(p.0)).filter(|&v| has_place(v));
        let finest = values.fold(f64::INFINITY, f64::min);
        let marks = found
            .iter()
            .filter_map(|&(v, run)| mark(study, coarse(v) / finest, run));
        joined(setting.to_string(), color, marks.collect())
    };
    SETTINGS.iter().map(of_setting).collect()
}

fn time_over_surfels(study: &Study) -> Vec<Series> {
    let series = |label: &str, color, pick: &dyn Fn(&Run) -> Option<f64>| {
        let marks = cloud_sweep(study, Method::Extended)
            .filter_map(|r| Some(plain(study.cloud_of(r)?.surfels as f64, pick(r)?)));
        joined(label.into(), color, marks.collect())
    };
    vec![
        series("bake", GREEN, &|r| Some(study.cloud_of(r)?.bake.cpu_secs)),
        series("build", PINK, &|r| Some(study.cloud_of(r)?.build.cpu_secs)),
        series("render", COLORS[2].1, &|r| Some(r.time().cpu_secs)),
    ]
}

fn front(study: &Study) -> Vec<Series> {
    let names = study.findings.pareto.iter();
    let runs = names.filter_map(|name| study.runs.iter().find(|r| r.name == *name));
    let points = runs.filter_map(|r| Some((mark(study, r.time().cpu_secs, r)?, r.name.clone())));
    let (marks, names) = points
        .filter(|(m, _)| has_place(m.x) && has_place(m.y))
        .unzip();
    vec![Series {
        label: "Pareto front".into(),
        color: RGBColor(0, 0, 0),
        marks,
        joined: true,
        is_foreign: false,
        names,
    }]
}

#[cfg(test)]
mod tests {
    use super::super::record::{Errors, Peer, Reference, Timing};
    use super::*;

    /// A run of a second.
    fn run(name: &str, sweep: Sweep, relmse: f64) -> Run {
        Run {
            name: name.into(),
            method: Method::Extended,
            sweep,
            rounds: vec![Timing {
                wall_secs: 1.0,
                cpu_secs: 1.0,
            }],
            errors: Errors {
                relmse: Some(relmse),
                ..Errors::default()
            },
            ..Run::default()
        }
    }

    #[test]
    fn errors_of_nothing_are_left_out() {
        let mut study = Study {
            reference: Reference {
                relmse: Some(0.0),
                ..Reference::default()
            },
            runs: vec![run("exact", Sweep::Base, 0.0)],
            ..Study::default()
        };
        study.find();
        assert!(all(&study).unwrap().is_empty());
        study.runs.push(run("near", Sweep::Base, 0.1));
        study.runs[0].rounds[0].cpu_secs = 2.0;
        study.find();
        let front = all(&study).unwrap().pop().unwrap();
        assert!(front.svg.contains("near") && !front.svg.contains("exact"));
    }

    #[test]
    fn a_sweep_of_one_point_is_not_drawn() {
        let of = |sweep: Sweep, samples: f64| {
            let mut run = run("", sweep, 1.0 / samples);
            run.values.insert(Sweep::Samples, samples);
            run.rounds[0].cpu_secs = samples;
            run
        };
        let mut study = Study {
            runs: vec![of(Sweep::Base, 8.0)],
            ..Study::default()
        };
        let names = |study: &Study| -> Vec<&str> {
            let plots = all(study).unwrap();
            plots.iter().map(|p| p.name).collect()
        };
        let found = names(&study);
        assert!(!found.contains(&"error-over-settings"), "{found:?}");
        assert!(found.contains(&"error-over-render-time"), "{found:?}");
        study.runs.push(of(Sweep::Samples, 16.0));
        let found = names(&study);
        assert!(found.contains(&"error-over-settings"), "{found:?}");
    }

    #[test]
    fn settings_of_zero_and_errors_without_end_leave_the_other_points() {
        let of = |name: &str, solid_angle: f64, relmse: f64| {
            let mut run = run(name, Sweep::MaxSolidAngle, relmse);
            run.values.insert(Sweep::MaxSolidAngle, solid_angle);
            run
        };
        let mut study = Study {
            reference: Reference {
                relmse: Some(f64::INFINITY),
                ..Reference::default()
            },
            runs: vec![
                of("all", 0.0, 0.1),
                of("fine", 0.01, 0.2),
                of("coarse", 0.02, 0.3),
                of("broken", 0.04, f64::INFINITY),
                of("lost", 0.08, f64::NAN),
            ],
            ..Study::default()
        };
        study.find();
        let marks = &error_over_settings(&study)[1].marks;
        let points: Vec<_> = marks.iter().map(|m| (m.x, m.y)).collect();
        assert_eq!(points[..], [(1.0, 0.2), (2.0, 0.3)]);
        let plots = all(&study).unwrap();
        assert!(plots.iter().any(|p| p.name == "error-over-settings"));
        for plot in plots {
            let numbers = ["NaN", "inf"];
            assert!(
                numbers.iter().all(|n| !plot.svg.contains(n)),
                "{}",
                plot.name
            );
        }
    }

    #[test]
    fn the_noise_of_the_reference_is_subtracted_and_what_is_lost_in_it_is_a_bound() {
        let of = |relmse| run("", Sweep::Base, relmse);
        let mut study = Study {
            reference: Reference {
                relmse: Some(0.01),
                ..Reference::default()
            },
            ..Study::default()
        };
        for (relmse, expected) in [
            (0.05, (0.04, false)),
            (0.0105, (0.001, true)),
            (0.002, (0.001, true)),
        ] {
            let mark = mark(&study, 1.0, &of(relmse)).unwrap();
            assert!((mark.y - expected.0).abs() < 1e-9, "{relmse}: {mark:?}");
            assert_eq!((mark.is_bound, mark.bar), (expected.1, None));
        }
        study.reference.relmse = None;
        assert_eq!(mark(&study, 1.0, &of(0.002)), Some(plain(1.0, 0.002)));
    }

    #[test]
    fn bars_reach_from_the_least_to_the_largest_of_the_seeds() {
        let mut of_three = run("", Sweep::Base, 0.2);
        for (seed, relmse) in [(1, 0.1), (2, 0.6)] {
            let errors = Errors {
                relmse: Some(relmse),
                ..Errors::default()
            };
            of_three.seeds.insert(seed, errors);
        }
        let found = mark(&Study::default(), 1.0, &of_three).unwrap();
        assert!((found.y - 0.3).abs() < 1e-9, "{found:?}");
        assert_eq!(found.bar, Some([0.1, 0.6]));
    }

    #[test]
    fn other_renderers_have_a_series_for_each_name() {
        let peer = |name: &str, cpu_secs, relmse| Peer {
            name: name.into(),
            cpu_secs,
            errors: Errors {
                relmse: Some(relmse),
                ..Errors::default()
            },
            source: "t.csv".into(),
        };
        let study = Study {
            runs: vec![run("own", Sweep::Base, 0.2)],
            peers: vec![
                peer("<b>", 2.0, 0.1),
                peer("pt", 1.0, 0.1),
                peer("<b>", 1.0, 0.3),
            ],
            ..Study::default()
        };
        let found = peers(&study);
        let points = |i: usize| {
            found[i]
                .marks
                .iter()
                .map(|m| (m.x, m.y))
                .collect::<Vec<_>>()
        };
        assert_eq!(points(0), [(1.0, 0.3), (2.0, 0.1)]);
        assert_eq!(points(1), [(1.0, 0.1)]);
        let plots = all(&study).unwrap();
        let names: Vec<_> = plots.iter().map(|p| p.name).collect();
        assert_eq!(names, ["error-over-render-time", "error-over-total-time"]);
        assert!(
            plots
                .iter()
                .all(|p| p.svg.contains("&lt;b&gt;") && !p.svg.contains("<b>"))
        );
    }
}

//! The curves of a study as SVG, both axes logarithmic.

use super::method::Method;
use super::record::{Run, Study};
use super::sweep::Sweep;
use crate::{Error, Result};
use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use std::ops::Range;

/// A picture by name.
pub struct Plot {
    /// Name, fit for a file.
    pub name: &'static str,
    /// What it shows.
    pub title: &'static str,
    /// The SVG.
    pub svg: String,
}

/// Points of one colour.
struct Series {
    label: String,
    color: RGBColor,
    points: Vec<(f64, f64)>,
    /// Whether a line joins them.
    joined: bool,
    /// Name of each point, told in the legend by its number; empty for none.
    names: Vec<String>,
}

const COLORS: [(Method, RGBColor); 3] = [
    (Method::MonteCarlo, RGBColor(86, 86, 86)),
    (Method::Traditional, RGBColor(213, 94, 0)),
    (Method::Extended, RGBColor(0, 114, 178)),
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
                   floor: Option<f64>| {
        debug_assert!(NAMES.contains(&name));
        // Along a sweep one point says nothing.
        if SWEEPS.contains(&name) {
            series.retain(|s| s.points.len() > 1);
        }
        if series.iter().any(|s| !s.points.is_empty()) {
            // Errors fall from the upper left, times rise to the upper right.
            let legend = match floor {
                _ if ["time-over-surfels", "error-over-settings"].contains(&name) => {
                    SeriesLabelPosition::UpperLeft
                }
                _ => SeriesLabelPosition::UpperRight,
            };
            let svg = draw(axes, &series, floor, legend)
                .map_err(|e| Error::failed(format!("cannot draw {name}: {e}")))?;
            plots.push(Plot { name, title, svg });
        }
        Ok::<(), Error>(())
    };
    let noise = study.reference.relmse.filter(|&v| has_place(v));
    let shade = |r: &Run| Some((r.time().cpu_secs, r.errors.relmse?));
    let total = |r: &Run| Some((study.total_secs(r), r.errors.relmse?));
    add(
        "error-over-render-time",
        "Error over the time of rendering",
        ["render, CPU s", "relMSE"],
        by_method(study, &shade),
        noise,
    )?;
    add(
        "error-over-total-time",
        "Error over the time of baking, building and rendering",
        ["bake, build and render, CPU s", "relMSE"],
        by_method(study, &total),
        noise,
    )?;
    add(
        "error-over-surfels",
        "Error over the size of the cloud",
        ["surfels", "relMSE"],
        error_over_surfels(study),
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
        ["setting, times coarser than the finest", "relMSE"],
        error_over_settings(study),
        noise,
    )?;
    add(
        "pareto",
        "Runs that no other beats in both time and error",
        ["render, CPU s", "relMSE"],
        front(study),
        noise,
    )?;
    Ok(plots)
}

fn by_method(study: &Study, point: &dyn Fn(&Run) -> Option<(f64, f64)>) -> Vec<Series> {
    COLORS
        .iter()
        .map(|&(method, color)| {
            let runs = study.runs.iter().filter(|r| r.method == method);
            Series {
                label: method.to_string(),
                color,
                points: sorted(runs.filter_map(point).collect()),
                joined: method == Method::MonteCarlo,
                names: Vec::new(),
            }
        })
        .collect()
}

/// Whether a value has a place on an axis of logarithms.
fn has_place(value: f64) -> bool {
    value.is_finite() && value > 0.0
}

fn sorted(mut points: Vec<(f64, f64)>) -> Vec<(f64, f64)> {
    points.retain(|p| has_place(p.0) && has_place(p.1));
    points.sort_by(|a, b| a.0.total_cmp(&b.0));
    points
}

fn cloud_sweep(study: &Study, method: Method) -> impl Iterator<Item = &Run> {
    study
        .runs
        .iter()
        .filter(move |r| r.method == method && [Sweep::Surfels, Sweep::Base].contains(&r.sweep))
}

fn error_over_surfels(study: &Study) -> Vec<Series> {
    COLORS[1..]
        .iter()
        .map(|&(method, color)| {
            let points = cloud_sweep(study, method)
                .filter_map(|r| Some((study.cloud_of(r)?.surfels as f64, r.errors.relmse?)));
            Series {
                label: method.to_string(),
                color,
                points: sorted(points.collect()),
                joined: true,
                names: Vec::new(),
            }
        })
        .collect()
}

/// The sweeps that the slopes are fitted to.
fn error_over_settings(study: &Study) -> Vec<Series> {
    const SETTINGS: [(Sweep, RGBColor); 5] = [
        (Sweep::Samples, COLORS[2].1),
        (Sweep::MaxSolidAngle, COLORS[1].1),
        (Sweep::SurfelRadius, RGBColor(0, 158, 115)),
        (Sweep::BlockDepth, RGBColor(204, 121, 167)),
        (Sweep::BlockVoxels, COLORS[0].1),
    ];
    SETTINGS
        .iter()
        .map(|&(setting, color)| {
            let found = study.sweep(Method::Extended, setting);
            // All settings are coarser upwards once those that are finer upwards are turned over.
            let coarse = |v: f64| if setting.rises() { 1.0 / v } else { v };
            let finest = found
                .iter()
                .map(|p| coarse(p.0))
                .filter(|&v| has_place(v))
                .fold(f64::INFINITY, f64::min);
            Series {
                label: setting.to_string(),
                color,
                points: sorted(found.iter().map(|p| (coarse(p.0) / finest, p.1)).collect()),
                joined: true,
                names: Vec::new(),
            }
        })
        .collect()
}

fn time_over_surfels(study: &Study) -> Vec<Series> {
    let series = |label: &str, color, pick: &dyn Fn(&Run) -> Option<f64>| {
        let points = cloud_sweep(study, Method::Extended)
            .filter_map(|r| Some((study.cloud_of(r)?.surfels as f64, pick(r)?)));
        Series {
            label: label.into(),
            color,
            points: sorted(points.collect()),
            joined: true,
            names: Vec::new(),
        }
    };
    vec![
        series("bake", RGBColor(0, 158, 115), &|r| {
            Some(study.cloud_of(r)?.bake.cpu_secs)
        }),
        series("build", RGBColor(204, 121, 167), &|r| {
            Some(study.cloud_of(r)?.build.cpu_secs)
        }),
        series("render", COLORS[2].1, &|r| Some(r.time().cpu_secs)),
    ]
}

fn front(study: &Study) -> Vec<Series> {
    let (points, names) = study
        .findings
        .pareto
        .iter()
        .filter_map(|name| study.runs.iter().find(|r| r.name == *name))
        .filter_map(|r| Some(((r.time().cpu_secs, r.errors.relmse?), r.name.clone())))
        .filter(|((secs, error), _)| has_place(*secs) && has_place(*error))
        .unzip();
    vec![Series {
        label: "Pareto front".into(),
        color: RGBColor(0, 0, 0),
        points,
        joined: true,
        names,
    }]
}

/// All values that have a place on an axis, with some room around them; around 1 if none has.
fn range(values: impl Iterator<Item = f64>) -> Range<f64> {
    let ends = values.filter(|&v| has_place(v)).fold(None, |ends, v| {
        let (low, high) = ends.unwrap_or((v, v));
        Some((v.min(low), v.max(high)))
    });
    let (low, high) = ends.unwrap_or((1.0, 1.0));
    // Neither end may leave what a number can hold.
    (low * 0.7).max(f64::MIN_POSITIVE)..(high * 1.4).min(f64::MAX)
}

/// Round values inside a range and their names, few enough to stand beside each other.
fn ticks(range: &Range<f64>) -> Vec<(f64, String)> {
    let decades = range.start.log10().floor() as i32..=range.end.log10().floor() as i32;
    let among = |digits: &[u8]| -> Vec<(f64, String)> {
        let all = decades.clone().flat_map(|k| {
            digits.iter().filter_map(move |digit| {
                let name = format!("{digit}e{k}");
                let value: f64 = name.parse().ok()?;
                let plain = (-3..=6).contains(&k);
                Some((value, if plain { value.to_string() } else { name }))
            })
        });
        all.filter(|t| range.contains(&t.0)).collect()
    };
    let (wide, middle) = (among(&[1]), among(&[1, 2, 5]));
    if wide.len() > 3 {
        wide
    } else if middle.len() > 2 {
        middle
    } else {
        among(&[1, 2, 3, 4, 5, 6, 7, 8, 9])
    }
}

fn grid(ends: [(i32, i32); 2]) -> PathElement<(i32, i32)> {
    PathElement::new(ends.to_vec(), RGBColor(228, 228, 228))
}

fn mark(name: String, at: (i32, i32), h: HPos, v: VPos) -> Text<'static, (i32, i32), String> {
    let style = ("sans-serif", 14).into_font().color(&BLACK);
    Text::new(name, at, style.pos(Pos::new(h, v)))
}

type Failure = Box<dyn std::error::Error>;
type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;
type Chart<'a> = ChartContext<'a, SVGBackend<'a>, Cartesian2d<LogCoord<f64>, LogCoord<f64>>>;

const GREY: RGBColor = RGBColor(170, 170, 170);

fn draw(
    axes: [&str; 2],
    series: &[Series],
    floor: Option<f64>,
    legend: SeriesLabelPosition,
) -> std::result::Result<String, Failure> {
    let points = series.iter().flat_map(|s| &s.points);
    let x = range(points.clone().map(|p| p.0));
    let y = range(points.map(|p| p.1).chain(floor));
    let mut svg = String::new();
    {
        let area = SVGBackend::with_string(&mut svg, (760, 460)).into_drawing_area();
        area.fill(&WHITE)?;
        let mut chart = ChartBuilder::on(&area)
            .margin(14)
            .x_label_area_size(44)
            .y_label_area_size(72)
            .build_cartesian_2d(x.clone().log_scale(), y.clone().log_scale())?;
        chart
            .configure_mesh()
            .disable_mesh()
            .set_all_tick_mark_size(0)
            .x_label_formatter(&|_| String::new())
            .y_label_formatter(&|_| String::new())
            .x_desc(axes[0])
            .y_desc(axes[1])
            .label_style(("sans-serif", 14))
            .draw()?;
        draw_grid(&area, &chart, &x, &y)?;
        if let Some(level) = floor {
            let line = PathElement::new(vec![(x.start, level), (x.end, level)], GREY);
            chart
                .draw_series([line])?
                .label("noise of the reference")
                .legend(|(x, y)| PathElement::new(vec![(x, y), (x + 16, y)], GREY));
        }
        for s in series.iter().filter(|s| !s.points.is_empty()) {
            draw_series(&mut chart, s)?;
        }
        chart
            .configure_series_labels()
            .position(legend)
            .background_style(WHITE.mix(0.85))
            .border_style(RGBColor(200, 200, 200))
            .label_font(("sans-serif", 14))
            .draw()?;
        area.present()?;
    }
    Ok(svg)
}

/// Draws lines at round values across the plot, and the values beside the axes.
fn draw_grid(
    area: &Area<'_>,
    chart: &Chart<'_>,
    x: &Range<f64>,
    y: &Range<f64>,
) -> std::result::Result<(), Failure> {
    let (across, down) = chart.plotting_area().get_pixel_range();
    for (value, name) in ticks(x) {
        let (at, _) = chart.plotting_area().map_coordinate(&(value, y.start));
        area.draw(&grid([(at, down.start), (at, down.end)]))?;
        let below = (at, down.end + 6);
        area.draw(&mark(name, below, HPos::Center, VPos::Top))?;
    }
    for (value, name) in ticks(y) {
        let (_, at) = chart.plotting_area().map_coordinate(&(x.start, value));
        area.draw(&grid([(across.start, at), (across.end, at)]))?;
        let beside = (across.start - 6, at);
        area.draw(&mark(name, beside, HPos::Right, VPos::Center))?;
    }
    Ok(())
}

/// Draws a series with its entry in the legend. Points that have names are numbered, and the legend
/// tells the names.
fn draw_series(chart: &mut Chart<'_>, series: &Series) -> std::result::Result<(), Failure> {
    let color = series.color;
    let points = &series.points;
    if series.joined {
        chart.draw_series([PathElement::new(points.clone(), color.stroke_width(2))])?;
    }
    chart
        .draw_series(points.iter().map(|&p| Circle::new(p, 4, color.filled())))?
        .label(series.label.as_str())
        .legend(move |(x, y)| Circle::new((x + 8, y), 4, color.filled()));
    for (i, (point, name)) in points.iter().zip(&series.names).enumerate() {
        let number = move |x: i32, y: i32| {
            let style = ("sans-serif", 13).into_font().color(&color);
            Text::new((i + 1).to_string(), (x, y), style)
        };
        let beside = EmptyElement::at(*point) + number(6, -16);
        chart
            .draw_series([beside])?
            .label(name.as_str())
            .legend(move |(x, y)| EmptyElement::at((x, y)) + number(2, -7));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::record::{Errors, Reference, Timing};
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
    fn ranges_are_of_what_has_a_place_on_an_axis() {
        let none = [0.0, -1.0, f64::NAN, f64::INFINITY, f64::NEG_INFINITY];
        let of = |values: &[f64]| range(values.iter().copied());
        assert_eq!(of(&[2.0, 10.0]), 1.4..14.0);
        for odd in none {
            assert_eq!(of(&[2.0, odd, 10.0]), 1.4..14.0, "{odd}");
        }
        assert_eq!(of(&none), 0.7..1.4);
        assert_eq!(of(&[]), 0.7..1.4);
        let widest = of(&[f64::MIN_POSITIVE, f64::MAX]);
        assert!(widest.start > 0.0 && widest.end.is_finite());
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
        let points = &error_over_settings(&study)[1].points;
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
    fn axes_have_a_few_round_marks() {
        let names = |range| -> Vec<String> { ticks(&range).into_iter().map(|t| t.1).collect() };
        assert_eq!(names(0.03..4.0), ["0.05", "0.1", "0.2", "0.5", "1", "2"]);
        assert_eq!(names(5e-6..0.2), ["1e-5", "1e-4", "0.001", "0.01", "0.1"]);
        assert_eq!(names(0.91..1.9), ["1"]);
        assert_eq!(names(2.1..4.5), ["3", "4"]);
        assert_eq!(names(1e5..2e6), ["100000", "200000", "500000", "1000000"]);
    }
}

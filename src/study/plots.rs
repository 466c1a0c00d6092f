//! The curves of a study as SVG, both axes logarithmic.

use super::record::{Run, Study};
use crate::{Error, Result};
use plotters::prelude::*;

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
    /// Written beside each point; empty for none.
    names: Vec<String>,
}

const COLORS: [(&str, RGBColor); 3] = [
    ("monte carlo", RGBColor(86, 86, 86)),
    ("traditional", RGBColor(213, 94, 0)),
    ("extended", RGBColor(0, 114, 178)),
];

/// All plots that there are numbers for.
///
/// # Errors
/// If one cannot be drawn.
pub fn all(study: &Study) -> Result<Vec<Plot>> {
    let mut plots = Vec::new();
    let mut add = |name, title, axes: [&str; 2], series: Vec<Series>, floor: Option<f64>| {
        if series.iter().any(|s| !s.points.is_empty()) {
            let svg = draw(axes, &series, floor)
                .map_err(|e| Error::failed(format!("cannot draw {name}: {e}")))?;
            plots.push(Plot { name, title, svg });
        }
        Ok::<(), Error>(())
    };
    let noise = study.reference.relmse;
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
                label: method.into(),
                color,
                points: sorted(runs.filter_map(point).collect()),
                joined: method == "monte carlo",
                names: Vec::new(),
            }
        })
        .collect()
}

fn sorted(mut points: Vec<(f64, f64)>) -> Vec<(f64, f64)> {
    points.retain(|p| p.0 > 0.0 && p.1 > 0.0);
    points.sort_by(|a, b| a.0.total_cmp(&b.0));
    points
}

fn cloud_sweep<'a>(study: &'a Study, method: &'a str) -> impl Iterator<Item = &'a Run> {
    study
        .runs
        .iter()
        .filter(move |r| r.method == method && (r.sweep == "surfels" || r.sweep == "base"))
}

fn error_over_surfels(study: &Study) -> Vec<Series> {
    COLORS[1..]
        .iter()
        .map(|&(method, color)| {
            let points = cloud_sweep(study, method)
                .filter_map(|r| Some((study.cloud_of(r)?.surfels as f64, r.errors.relmse?)));
            Series {
                label: method.into(),
                color,
                points: sorted(points.collect()),
                joined: true,
                names: Vec::new(),
            }
        })
        .collect()
}

fn time_over_surfels(study: &Study) -> Vec<Series> {
    let series = |label: &str, color, pick: &dyn Fn(&Run) -> Option<f64>| {
        let points = cloud_sweep(study, "extended")
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
    let runs: Vec<&Run> = study
        .findings
        .pareto
        .iter()
        .filter_map(|name| study.runs.iter().find(|r| r.name == *name))
        .collect();
    vec![Series {
        label: "Pareto front".into(),
        color: RGBColor(0, 0, 0),
        points: runs
            .iter()
            .filter_map(|r| Some((r.time().cpu_secs, r.errors.relmse?)))
            .collect(),
        joined: true,
        names: runs.iter().map(|r| r.name.clone()).collect(),
    }]
}

/// The decades around all values, so that log axes have marks.
fn range(values: impl Iterator<Item = f64> + Clone) -> std::ops::Range<f64> {
    let low = values.clone().fold(f64::INFINITY, f64::min) * 0.7;
    let high = values.fold(0.0, f64::max) * 1.4;
    low..high
}

fn draw(
    axes: [&str; 2],
    series: &[Series],
    floor: Option<f64>,
) -> std::result::Result<String, Box<dyn std::error::Error>> {
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
            .build_cartesian_2d(x.clone().log_scale(), y.log_scale())?;
        chart
            .configure_mesh()
            .light_line_style(RGBColor(236, 236, 236))
            .x_desc(axes[0])
            .y_desc(axes[1])
            .x_label_formatter(&|v| super::table::figure(*v))
            .y_label_formatter(&|v| super::table::figure(*v))
            .label_style(("sans-serif", 14))
            .draw()?;
        if let Some(level) = floor {
            let line = PathElement::new(
                vec![(x.start, level), (x.end, level)],
                RGBColor(170, 170, 170),
            );
            chart
                .draw_series([line])?
                .label("noise of the reference")
                .legend(|(x, y)| {
                    PathElement::new(vec![(x, y), (x + 16, y)], RGBColor(170, 170, 170))
                });
        }
        for s in series.iter().filter(|s| !s.points.is_empty()) {
            let color = s.color;
            if s.joined {
                chart.draw_series([PathElement::new(s.points.clone(), color.stroke_width(2))])?;
            }
            chart
                .draw_series(s.points.iter().map(|&p| Circle::new(p, 4, color.filled())))?
                .label(s.label.as_str())
                .legend(move |(x, y)| Circle::new((x + 8, y), 4, color.filled()));
            let names = s.points.iter().zip(&s.names);
            chart.draw_series(names.map(|(&p, name)| {
                let style = ("sans-serif", 13).into_font().color(&color);
                EmptyElement::at(p) + Text::new(name.clone(), (7, -14), style)
            }))?;
        }
        chart
            .configure_series_labels()
            .position(SeriesLabelPosition::LowerLeft)
            .background_style(WHITE.mix(0.85))
            .border_style(RGBColor(200, 200, 200))
            .label_font(("sans-serif", 14))
            .draw()?;
        area.present()?;
    }
    Ok(svg)
}

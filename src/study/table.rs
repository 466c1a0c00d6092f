//! The numbers of a study as text: a table in the form of the paper's Table 1 in Markdown, and all runs as CSV.

use super::record::{Run, Study};
use std::fmt::Write;

/// A header and rows of cells.
pub struct Table {
    /// Names of the columns.
    pub head: Vec<&'static str>,
    /// As many cells each.
    pub rows: Vec<Vec<String>>,
}

/// Three digits that mean something.
pub fn figure(value: f64) -> String {
    let size = value.abs();
    if value == 0.0 {
        "0".into()
    } else if size >= 100.0 {
        format!("{value:.0}")
    } else if size >= 10.0 {
        format!("{value:.1}")
    } else if size >= 1.0 {
        format!("{value:.2}")
    } else if size >= 1e-3 {
        let decimals = 2 - size.log10().floor() as i32;
        format!("{value:.*}", decimals.max(0) as usize)
    } else {
        format!("{value:.2e}")
    }
}

fn optional(value: Option<f64>) -> String {
    value.map_or("–".into(), figure)
}

fn megabytes(bytes: u64) -> String {
    figure(bytes as f64 / 1e6)
}

/// Time, difference and memory of the runs that matter most: all Monte Carlo runs and the base settings of the others.
pub fn summary(study: &Study) -> Table {
    let mut chosen: Vec<&Run> = study
        .runs
        .iter()
        .filter(|r| r.sweep == "spp" || r.sweep == "base")
        .collect();
    chosen.sort_by_key(|r| r.sweep == "base");
    let rows = chosen
        .iter()
        .map(|run| {
            let cloud = study.cloud_of(run);
            let secs = run.time().cpu_secs;
            let equal = run.errors.relmse.and_then(|e| study.monte_carlo_secs(e));
            let traditional = run.method == "traditional";
            vec![
                run.name.clone(),
                cloud.map_or("–".into(), |c| figure(c.bake.cpu_secs)),
                cloud.map_or("–".into(), |c| figure(c.build.cpu_secs)),
                figure(secs),
                cloud.map_or("–".into(), |_| optional(equal.map(|t| t / secs))),
                optional(run.errors.pdiff.map(|p| 100.0 * p)),
                optional(run.errors.relmse),
                optional(run.errors.flip),
                cloud.map_or("–".into(), |c| {
                    let left_out = if traditional { c.lvoxel_bytes } else { 0 };
                    megabytes(c.tree_bytes - left_out)
                }),
                match cloud {
                    Some(c) if !traditional => format!(
                        "{} ({} %)",
                        megabytes(c.lvoxel_bytes),
                        figure(100.0 * c.lvoxel_bytes as f64 / c.tree_bytes.max(1) as f64)
                    ),
                    _ => "–".into(),
                },
            ]
        })
        .collect();
    Table {
        head: vec![
            "run",
            "bake s",
            "build s",
            "render s",
            "faster than Monte Carlo at equal relMSE",
            "pdiff %",
            "relMSE",
            "FLIP",
            "tree MB",
            "of it lvoxels MB",
        ],
        rows,
    }
}

/// How the error goes with each setting.
pub fn slopes(study: &Study) -> Table {
    let rows = study.findings.slopes.iter();
    Table {
        head: vec!["method", "setting", "relMSE goes as its power", "runs"],
        rows: rows
            .map(|s| {
                vec![
                    s.method.clone(),
                    s.sweep.clone(),
                    format!("{:.2}", s.exponent),
                    s.runs.to_string(),
                ]
            })
            .collect(),
    }
}

/// The runs that no other beats in both time and error.
pub fn pareto(study: &Study) -> Table {
    let runs = study.findings.pareto.iter();
    Table {
        head: vec!["run", "render s", "relMSE", "pdiff %"],
        rows: runs
            .filter_map(|name| study.runs.iter().find(|r| r.name == *name))
            .map(|r| {
                vec![
                    r.name.clone(),
                    figure(r.time().cpu_secs),
                    optional(r.errors.relmse),
                    optional(r.errors.pdiff.map(|p| 100.0 * p)),
                ]
            })
            .collect(),
    }
}

/// What was measured and on what, in a few sentences.
pub fn caption(study: &Study) -> String {
    let [w, h] = study.film;
    let noise = study.reference.relmse.map_or(String::new(), |v| {
        format!(", of relMSE {} against the truth", figure(v))
    });
    format!(
        "{} at {w}x{h} pixels, against {}{noise}. Times are CPU seconds of all threads, medians of {} rounds in which the \
         methods take turns; loading is left out. Monte Carlo's time at equal error is that of a line through its runs in \
         logarithms. lvox {} on {} ({}), {} threads.",
        study.scene,
        study.reference.source,
        study.runs.iter().map(|r| r.rounds.len()).max().unwrap_or(0),
        study.version,
        study.machine.processor,
        study.machine.system,
        study.machine.threads,
    )
}

impl Table {
    /// As a Markdown table.
    pub fn markdown(&self) -> String {
        let line = |cells: &[String]| format!("| {} |\n", cells.join(" | "));
        let head: Vec<String> = self.head.iter().map(|&h| h.into()).collect();
        let rules: Vec<String> = self.head.iter().map(|_| "---".into()).collect();
        let mut text = line(&head) + &line(&rules);
        for row in &self.rows {
            text += &line(row);
        }
        text
    }
}

/// The whole study in Markdown.
pub fn markdown(study: &Study) -> String {
    format!(
        "# {}\n\n{}\n\n{}\n## Error against settings\n\n{}\n## Pareto front\n\n{}",
        study.scene,
        caption(study),
        summary(study).markdown(),
        slopes(study).markdown(),
        pareto(study).markdown(),
    )
}

/// All runs, one a line.
pub fn csv(study: &Study) -> String {
    let mut text = String::from(
        "name,method,sweep,value,cloud,surfels,lvoxels,tree_bytes,lvoxel_bytes,bake_cpu_secs,build_cpu_secs,\
         render_wall_secs,render_cpu_secs,total_cpu_secs,relmse,relmse_trimmed,flip,ssim,pdiff,bias\n",
    );
    for run in &study.runs {
        let time = run.time();
        let e = &run.errors;
        let _ = write!(
            text,
            "{},{},{},{},",
            run.name,
            run.method,
            run.sweep,
            run.values
                .get(&run.sweep)
                .map_or(String::new(), f64::to_string)
        );
        let _ = match study.cloud_of(run) {
            None => write!(text, ",,,,,,,"),
            Some(c) => write!(
                text,
                "{},{},{},{},{},{},{},",
                c.name,
                c.surfels,
                c.lvoxels,
                c.tree_bytes,
                c.lvoxel_bytes,
                c.bake.cpu_secs,
                c.build.cpu_secs
            ),
        };
        let _ = write!(
            text,
            "{},{},{}",
            time.wall_secs,
            time.cpu_secs,
            study.total_secs(run)
        );
        for value in [e.relmse, e.relmse_trimmed, e.flip, e.ssim, e.pdiff, e.bias] {
            let _ = write!(text, ",{}", value.map_or(String::new(), |v| v.to_string()));
        }
        text.push('\n');
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_have_three_digits() {
        for (value, text) in [
            (0.0, "0"),
            (1234.5, "1234"),
            (36.27, "36.3"),
            (1.0, "1.00"),
            (0.0213, "0.0213"),
            (0.00034, "3.40e-4"),
            (-0.5, "-0.500"),
        ] {
            assert_eq!(figure(value), text);
        }
    }

    #[test]
    fn every_line_of_the_csv_has_every_column() {
        let study = Study {
            runs: vec![Run::default(), Run::default()],
            ..Study::default()
        };
        let text = csv(&study);
        let columns: Vec<usize> = text.lines().map(|l| l.split(',').count()).collect();
        assert_eq!(columns, [20; 3]);
    }
}

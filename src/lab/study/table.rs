//! The numbers of a study as text: a table in the form of the paper's Table 1 in Markdown, and all
//! runs as CSV.

use super::findings::{FARTHEST, Metric};
use super::method::Method;
use super::record::{Cloud, NoiseSource, Run, Study, Versus};
use super::sweep::Sweep;
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

/// A power to two decimals, of which a zero has no sign.
fn power(value: f64) -> String {
    format!("{:.2}", (100.0 * value).round() / 100.0 + 0.0)
}

fn optional(value: Option<f64>) -> String {
    value.map_or("–".into(), figure)
}

fn megabytes(bytes: u64) -> String {
    figure(bytes as f64 / 1e6)
}

/// Whether a run belongs to the short table and to the images: all of Monte Carlo, and what no
/// sweep varies.
pub fn is_chief(run: &Run) -> bool {
    run.sweep == Sweep::Spp || run.sweep.is_alone()
}

/// Time, difference and memory of the runs that matter most.
pub fn summary(study: &Study) -> Table {
    let mut chosen: Vec<&Run> = study.runs.iter().filter(|r| is_chief(r)).collect();
    chosen.sort_by_key(|r| r.sweep != Sweep::Spp);
    let rows = chosen.iter().map(|run| {
        let cloud = study.cloud_of(run);
        let versus = |metric| study.versus_of(run, metric);
        let percent = |v: Option<f64>| optional(v.map(|v| 100.0 * v));
        vec![
            run.name.clone(),
            cloud.map_or("–".into(), |c| figure(c.bake.cpu_secs)),
            cloud.map_or("–".into(), |c| figure(c.build.cpu_secs)),
            figure(run.time().cpu_secs),
            percent(run.errors.pdiff),
            equal_time(versus(Metric::Pdiff), 100.0),
            times(versus(Metric::Pdiff), |v| v.speed_up),
            times(versus(Metric::Pdiff), |v| v.total_speed_up),
            optional(run.errors.relmse),
            equal_time(versus(Metric::RelMse), 1.0),
            times(versus(Metric::RelMse), |v| v.speed_up),
            times(versus(Metric::RelMse), |v| v.total_speed_up),
            optional(run.errors.flip),
            tree_memory(cloud, run),
            lvoxel_memory(cloud, run),
            run.peak_memory_bytes.map_or("–".into(), megabytes),
        ]
    });
    Table {
        head: vec![
            "run",
            "bake s",
            "build s",
            "render s",
            "pdiff %",
            "Monte Carlo's in that time",
            "rendering faster at equal pdiff",
            "with bake and build, equal pdiff",
            "relMSE",
            "Monte Carlo's in that time",
            "rendering faster at equal relMSE",
            "with bake and build, equal relMSE",
            "FLIP",
            "file of the tree MB",
            "of it lvoxels MB (over the surfels alone)",
            "resident MB",
        ],
        rows: rows.collect(),
    }
}

/// A speed-up; in brackets where it needs a time that was not measured, and no more than a bound
/// where that is far.
fn times(versus: Option<&Versus>, factor: fn(&Versus) -> Option<f64>) -> String {
    let Some((v, factor)) = versus.and_then(|v| Some((v, factor(v)?))) else {
        return "–".into();
    };
    let factor = figure(factor);
    match (v.extrapolated, v.capped) {
        (_, true) => format!("(> {factor} x)"),
        (true, false) => format!("({factor} x)"),
        (false, false) => format!("{factor} x"),
    }
}

/// What Monte Carlo reaches in the time of a run, in a unit; in brackets where that time was not
/// measured.
fn equal_time(versus: Option<&Versus>, per_unit: f64) -> String {
    let Some((v, error)) = versus.and_then(|v| Some((v, v.equal_time_error?))) else {
        return "–".into();
    };
    let error = figure(per_unit * error);
    if v.time_extrapolated {
        format!("({error})")
    } else {
        error
    }
}

/// What a method keeps: surfels alone need no lvoxels.
fn tree_memory(cloud: Option<&Cloud>, run: &Run) -> String {
    cloud.map_or("–".into(), |c| {
        let left_out = if run.method == Method::Traditional {
            c.lvoxel_bytes
        } else {
            0
        };
        megabytes(c.tree_bytes.saturating_sub(left_out))
    })
}

fn lvoxel_memory(cloud: Option<&Cloud>, run: &Run) -> String {
    match cloud {
        Some(c) if run.method != Method::Traditional => format!(
            "{} ({} %)",
            megabytes(c.lvoxel_bytes),
            figure(100.0 * c.lvoxel_share())
        ),
        _ => "–".into(),
    }
}

/// The columns of [`summary`] in tables that fit a page, each with its title.
pub fn summaries(study: &Study) -> [(&'static str, Table); 3] {
    let whole = summary(study);
    let of = |columns: &[usize]| {
        let pick = |row: &Vec<String>| columns.iter().map(|&c| row[c].clone()).collect();
        Table {
            head: columns.iter().map(|&c| whole.head[c]).collect(),
            rows: whole.rows.iter().map(pick).collect(),
        }
    };
    [
        ("Time and relMSE", of(&[0, 1, 2, 3, 8, 9, 10, 11])),
        ("What viewers tell apart", of(&[0, 3, 4, 5, 6, 7, 12])),
        ("Memory", of(&[0, 13, 14, 15])),
    ]
}

/// relMSE over seeds, of the runs that have several; no rows without any.
pub fn seeds(study: &Study) -> Table {
    let row = |run: &Run| {
        let found = run.relmse_over_seeds().filter(|o| o.seeds > 1)?;
        Some(vec![
            run.name.clone(),
            found.seeds.to_string(),
            figure(found.mean),
            figure(found.least),
            figure(found.most),
        ])
    };
    Table {
        head: vec!["run", "seeds", "mean relMSE", "least", "largest"],
        rows: study.runs.iter().filter_map(row).collect(),
    }
}

/// Points of other renderers; no rows without any.
pub fn peers(study: &Study) -> Table {
    let less_noise = |relmse: f64| match study.less_noise(relmse) {
        (least, true) => format!("< {}", figure(least)),
        (rest, false) => figure(rest),
    };
    let rows = study.peers.iter().map(|p| {
        vec![
            p.name.clone(),
            figure(p.cpu_secs),
            optional(p.errors.relmse),
            p.errors.relmse.map_or("–".into(), less_noise),
            optional(p.errors.pdiff.map(|v| 100.0 * v)),
            optional(p.errors.flip),
            p.source.clone(),
        ]
    });
    Table {
        head: vec![
            "renderer",
            "CPU s",
            "relMSE",
            "less the reference's noise",
            "pdiff %",
            "FLIP",
            "told by",
        ],
        rows: rows.collect(),
    }
}

/// How the error goes with each setting.
pub fn slopes(study: &Study) -> Table {
    let rows = study.findings.slopes.iter();
    let at = |[setting, error]: [f64; 2]| format!("{} at {}", figure(error), figure(setting));
    Table {
        head: vec![
            "method",
            "setting",
            "relMSE goes as its power",
            "between the coarsest two",
            "coarsest relMSE",
            "finest relMSE",
            "least relMSE (floor)",
            "runs",
        ],
        rows: rows
            .map(|s| {
                vec![
                    s.method.to_string(),
                    s.setting.to_string(),
                    power(s.exponent),
                    power(s.coarse_exponent),
                    at(s.coarsest),
                    at(s.finest),
                    figure(s.floor),
                    s.runs.to_string(),
                ]
            })
            .collect(),
    }
}

/// How to read [`slopes`].
pub const SLOPES: &str = "Fitted in logarithms to every run of a sweep. Nothing is subtracted: the \
    noise of the reference and what the settings that stay the same leave over are in, so a power \
    flattens where the error nears its floor.";

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
        let told = match study.reference.noise {
            NoiseSource::Variance => "by its variance",
            NoiseSource::Image => "by a second image",
            NoiseSource::Given => "as it is given",
        };
        format!(
            ", of relMSE {} against the truth {told}, which plots subtract: \
             hollow points are bounds",
            figure(v)
        )
    });
    let seeds = study
        .runs
        .iter()
        .filter_map(|r| Some(r.relmse_over_seeds()?.seeds));
    let seeds = match seeds.max().unwrap_or(1) {
        1 => String::new(),
        n => format!(
            " Bars reach from the least to the largest relMSE of up to {n} seeds, \
             points are their means."
        ),
    };
    let media = if study.has_media {
        "The traditional method is given clouds with lvoxels, which it takes no notice of: their \
         baking and building is in its times, their memory is not."
    } else {
        "The scene has no media: the traditional method is the extended one then, and is left out."
    };
    let rounds = match study.runs.iter().map(|r| r.rounds.len()).max().unwrap_or(0) {
        0 | 1 => "each timed once".to_owned(),
        n => format!(
            "medians of up to {n} rounds in which the methods take turns and clouds are \
             baked and built anew"
        ),
    };
    format!(
        "{} at {w}x{h} pixels, against {}{noise}.{seeds} Times are CPU seconds of all threads, \
         {rounds}; loading the scene is left out. {media} Resident memory is the peak of the \
         process while it renders, with the scene, the reference and what earlier runs leave. \
         Monte Carlo's relMSE falls to the reference's noise as one over its time; its pdiff is \
         read off straight lines in logarithms between its runs; in brackets where that is outside \
         of what was measured, and no farther than {FARTHEST} times its longest run. lvox {} on {} \
         ({}), {} threads.",
        study.scene,
        study.reference.source,
        study.version,
        study.machine.processor,
        study.machine.system,
        study.machine.threads,
    )
}

impl Table {
    /// As a Markdown table.
    pub fn markdown(&self) -> String {
        let cell = |text: &String| text.replace('|', "\\|");
        let line = |cells: &[String]| {
            let cells: Vec<String> = cells.iter().map(cell).collect();
            format!("| {} |\n", cells.join(" | "))
        };
        let head: Vec<String> = self.head.iter().map(|&h| h.into()).collect();
        let rules: Vec<String> = self.head.iter().map(|_| "---".into()).collect();
        let mut text = line(&head) + &line(&rules);
        for row in &self.rows {
            text += &line(row);
        }
        text
    }
}

/// Title of the table of slopes.
pub const SETTINGS: &str = "Error against settings";

/// All tables that have rows, with their titles.
pub fn tables(study: &Study) -> Vec<(&'static str, Table)> {
    let all = summaries(study).into_iter().chain([
        ("Several seeds", seeds(study)),
        ("Other renderers", peers(study)),
        (SETTINGS, slopes(study)),
        ("Pareto front", pareto(study)),
    ]);
    all.filter(|(_, table)| !table.rows.is_empty()).collect()
}

/// The whole study in Markdown.
pub fn markdown(study: &Study) -> String {
    let mut text = format!("# {}\n\n{}\n", study.scene, caption(study));
    for (title, table) in tables(study) {
        let note = if title == SETTINGS { SLOPES } else { "" };
        let _ = write!(
            text,
            "\n## {title}\n\n{note}{}{}",
            if note.is_empty() { "" } else { "\n\n" },
            table.markdown()
        );
    }
    text
}

/// All runs, one a line.
pub fn csv(study: &Study) -> String {
    let mut text = String::from(
        "name,method,sweep,value,cloud,surfels,surfel_radius,lvoxels,tree_bytes,lvoxel_bytes,\
         bake_cpu_secs,build_cpu_secs,render_wall_secs,render_cpu_secs,total_cpu_secs,relmse,\
         relmse_trimmed,flip,ssim,pdiff,bias,lvoxel_share,peak_memory_bytes,relmse_less_noise,\
         seeds,relmse_mean,relmse_least,relmse_most\n",
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
            None => write!(text, ",,,,,,,,"),
            Some(c) => write!(
                text,
                "{},{},{},{},{},{},{},{},",
                c.name,
                c.surfels,
                c.surfel_radius,
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
        let share = study.cloud_of(run).map(|c| c.lvoxel_share().to_string());
        let peak = run.peak_memory_bytes.map(|b| b.to_string());
        for value in [share, peak] {
            let _ = write!(text, ",{}", value.unwrap_or_default());
        }
        let rest = e.relmse.map(|v| v - study.noise().unwrap_or(0.0));
        let _ = write!(text, ",{}", rest.map_or(String::new(), |v| v.to_string()));
        let _ = match run.relmse_over_seeds() {
            Some(o) => write!(text, ",{},{},{},{}", o.seeds, o.mean, o.least, o.most),
            None => write!(text, ",{},,,", 1 + run.seeds.len()),
        };
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
        assert_eq!([-0.004, 0.0, -1.096].map(power), ["0.00", "0.00", "-1.10"]);
    }

    #[test]
    fn every_line_of_the_csv_has_every_column() {
        let with_cloud = Run {
            cloud: Some("c".into()),
            ..Run::default()
        };
        let study = Study {
            clouds: vec![Cloud {
                name: "c".into(),
                ..Cloud::default()
            }],
            runs: vec![Run::default(), with_cloud],
            ..Study::default()
        };
        let text = csv(&study);
        let columns: Vec<usize> = text.lines().map(|l| l.split(',').count()).collect();
        assert_eq!(columns, [28; 3]);
    }
}

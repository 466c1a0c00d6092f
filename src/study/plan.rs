//! What a study runs: one setting varied at a time, around the defaults.

use crate::shade::{self, Method};
use crate::{Error, Result};
use std::collections::BTreeMap;
use std::path::PathBuf;

/// What to study.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Settings {
    /// Name of the camera; the scene's first if `None`.
    pub camera: Option<String>,
    /// Longest paths of Monte Carlo and of the reference, see [`crate::reference::Settings`]. 3 is what is computed from
    /// a tree without bounces.
    pub max_depth: u32,
    /// Samples per pixel of the Monte Carlo runs.
    pub spp: Vec<u32>,
    /// Surfels of the clouds; the last belongs to the base settings.
    pub surfels: Vec<u64>,
    /// Optical depth across an lvoxel; the first belongs to the base settings.
    pub block_depth: Vec<f32>,
    /// Rays of a gather on a surface, beside the base settings.
    pub samples: Vec<u32>,
    /// Largest solid angle of a node, steradians, beside the base settings.
    pub max_solid_angle: Vec<f32>,
    /// Times that every run is timed; the median counts.
    pub rounds: u32,
    /// A converged image; one is rendered if `None`.
    pub reference: Option<PathBuf>,
    /// Samples per pixel of that one.
    pub reference_spp: u32,
    /// Key of all random choices.
    pub seed: u64,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            camera: None,
            max_depth: 3,
            spp: vec![1, 4, 16, 64],
            surfels: vec![31_250, 125_000, 500_000],
            block_depth: vec![0.7, 0.35, 1.4, 2.8],
            samples: vec![8, 16, 32, 128, 256],
            max_solid_angle: vec![0.0025, 0.005, 0.02, 0.04, 0.08],
            rounds: 3,
            reference: None,
            reference_spp: 1024,
            seed: 0,
        }
    }
}

impl Settings {
    /// Few and short runs, to see that all works.
    #[must_use]
    pub fn quick() -> Self {
        Self {
            spp: vec![1, 4, 16],
            surfels: vec![50_000, 200_000],
            block_depth: vec![0.7, 1.4],
            samples: vec![16],
            max_solid_angle: vec![0.04],
            rounds: 1,
            reference_spp: 128,
            ..Self::default()
        }
    }

    /// Refuses settings that make no sense.
    ///
    /// # Errors
    /// Names the setting and what it may be.
    pub fn check(&self) -> Result<()> {
        let counts = [
            ("--spp", self.spp.iter().all(|&n| n > 0)),
            ("--surfels", self.surfels.iter().all(|&n| n > 0)),
            ("--samples", self.samples.iter().all(|&n| n > 0)),
            ("--rounds", self.rounds > 0),
            ("--reference-spp", self.reference_spp > 0),
        ];
        if let Some((name, _)) = counts.iter().find(|(_, good)| !good) {
            return Err(Error::input(format!("{name} must be at least 1")));
        }
        if self.spp.is_empty() || self.surfels.is_empty() || self.block_depth.is_empty() {
            return Err(Error::input(
                "--spp, --surfels and --block-depth need one value at least",
            ));
        }
        for variant in self.variants() {
            if let How::Points(points) = variant.how {
                points.shade.check()?;
            }
        }
        Ok(())
    }

    /// All runs, one method after the other in turn, so that whatever else the machine does hits all alike.
    #[must_use]
    pub fn variants(&self) -> Vec<Variant> {
        let mut columns = vec![self.monte_carlo()];
        for method in [Method::Traditional, Method::Extended] {
            columns.push(self.points(method));
        }
        let longest = columns.iter().map(Vec::len).max().unwrap_or(0);
        (0..longest)
            .flat_map(|i| columns.iter().filter_map(move |c| c.get(i).cloned()))
            .collect()
    }

    fn monte_carlo(&self) -> Vec<Variant> {
        self.spp
            .iter()
            .map(|&spp| Variant {
                name: format!("monte-carlo-{spp}"),
                method: "monte carlo",
                sweep: "spp",
                how: How::MonteCarlo { spp },
            })
            .collect()
    }

    fn points(&self, method: Method) -> Vec<Variant> {
        let label = match method {
            Method::Extended => "extended",
            Method::Traditional => "traditional",
        };
        let base = Points {
            surfels: self.surfels.last().copied().unwrap_or(1),
            block_depth: self.block_depth.first().copied().unwrap_or(0.7),
            shade: shade::Settings {
                camera: self.camera.clone(),
                method,
                seed: self.seed,
                ..shade::Settings::default()
            },
        };
        let mut variants = Vec::new();
        let mut add = |sweep: &'static str, value: String, points: Points| {
            if sweep == "base" || points != base {
                variants.push(Variant {
                    name: match sweep {
                        "base" => format!("{label}-base"),
                        _ => format!("{label}-{sweep}-{value}"),
                    },
                    method: label,
                    sweep,
                    how: How::Points(points),
                });
            }
        };
        add("base", "0".into(), base.clone());
        for &surfels in &self.surfels {
            let points = Points {
                surfels,
                ..base.clone()
            };
            add("surfels", surfels.to_string(), points);
        }
        for &samples in &self.samples {
            let mut points = base.clone();
            points.shade.samples = samples;
            add("samples", samples.to_string(), points);
        }
        for &max_solid_angle in &self.max_solid_angle {
            let mut points = base.clone();
            points.shade.max_solid_angle = max_solid_angle;
            add("max-solid-angle", max_solid_angle.to_string(), points);
        }
        if method == Method::Extended {
            for &block_depth in &self.block_depth {
                let points = Points {
                    block_depth,
                    ..base.clone()
                };
                add("block-depth", block_depth.to_string(), points);
            }
        }
        variants
    }
}

/// One run of a study.
#[derive(Clone, Debug, PartialEq)]
pub struct Variant {
    /// Unique name, fit for a file.
    pub name: String,
    /// `monte carlo`, `traditional` or `extended`.
    pub method: &'static str,
    /// The setting that is varied; `base` for none.
    pub sweep: &'static str,
    /// What to do.
    pub how: How,
}

impl Variant {
    /// All settings that any run varies, by the names of their sweeps.
    #[must_use]
    pub fn values(&self) -> BTreeMap<String, f64> {
        let values = match &self.how {
            How::MonteCarlo { spp } => vec![("spp", f64::from(*spp))],
            How::Points(points) => vec![
                ("surfels", points.surfels as f64),
                ("block-depth", f64::from(points.block_depth)),
                ("samples", f64::from(points.shade.samples)),
                ("max-solid-angle", f64::from(points.shade.max_solid_angle)),
            ],
        };
        values.into_iter().map(|(n, v)| (n.into(), v)).collect()
    }
}

/// What a run does.
#[derive(Clone, Debug, PartialEq)]
pub enum How {
    /// Path tracing.
    MonteCarlo {
        /// Samples per pixel.
        spp: u32,
    },
    /// Bake, build, shade.
    Points(Points),
}

/// Settings of a point-based run.
#[derive(Clone, Debug, PartialEq)]
pub struct Points {
    /// Surfels to bake, about.
    pub surfels: u64,
    /// Optical depth across an lvoxel.
    pub block_depth: f32,
    /// How to shade.
    pub shade: shade::Settings,
}

impl Points {
    /// Name of the cloud, shared by all runs that need the same one.
    #[must_use]
    pub fn cloud(&self) -> String {
        format!("surfels-{}-depth-{}", self.surfels, self.block_depth)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn names_are_unique_and_methods_take_turns() {
        for settings in [Settings::default(), Settings::quick()] {
            settings.check().unwrap();
            let variants = settings.variants();
            let names: BTreeSet<_> = variants.iter().map(|v| &v.name).collect();
            assert_eq!(names.len(), variants.len());
            let first: Vec<_> = variants[..3].iter().map(|v| v.method).collect();
            assert_eq!(first, ["monte carlo", "traditional", "extended"]);
            assert_eq!(variants.iter().filter(|v| v.sweep == "base").count(), 2);
        }
    }

    #[test]
    fn impossible_settings_are_named() {
        let settings = Settings {
            samples: vec![0],
            ..Settings::default()
        };
        assert!(
            settings
                .check()
                .unwrap_err()
                .to_string()
                .contains("--samples")
        );
    }
}

//! What a study runs: one setting varied at a time, around the defaults.

use super::method::Method;
use super::others::{MAX_PEERS, Noise, PeerImage};
use super::sweep::Sweep;
use crate::bake::BlockSize;
use crate::bake::{self, SurfelSampling};
use crate::shade;
use crate::{Error, Result};
use std::collections::BTreeMap;
use std::path::PathBuf;

/// What to study.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Settings {
    /// Name of the camera; the scene's first if `None`.
    pub camera: Option<String>,
    /// Longest paths of Monte Carlo and of the reference, see [`crate::lab::reference::Settings`].
    /// 3 is what is computed from a tree without bounces.
    pub max_depth: u32,
    /// Samples per pixel of the Monte Carlo runs.
    pub spp: Vec<u32>,
    /// Surfels of the clouds; the last belongs to the base settings.
    pub surfels: Vec<u64>,
    /// Optical depth across an lvoxel; the first belongs to the base settings.
    pub block_depth: Vec<f32>,
    /// Voxels a side of lvoxels of one size (1, 2, 4 or 8), beside the base settings.
    pub block_voxels: Vec<u8>,
    /// Rays of a gather on a surface, beside the base settings.
    pub samples: Vec<u32>,
    /// Largest solid angle of a node, steradians, beside the base settings.
    pub max_solid_angle: Vec<f32>,
    /// Voxels a side of the lvoxels (1, 2, 4 or 8) of a cloud like the paper's to run on as well,
    /// see `Points::of_the_paper`.
    pub paper_cloud: Option<u8>,
    /// Whether light of media is made beforehand, with each tree, for the runs that gather it.
    pub scatter: bool,
    /// The base settings of shading; camera, method and seed are those of the study.
    pub shade: shade::Settings,
    /// Times that every run is timed; the median counts.
    pub rounds: u32,
    /// A run that takes longer than this is timed only once, wall-clock seconds.
    pub long_secs: f64,
    /// A converged image; one is rendered if `None`.
    pub reference: Option<PathBuf>,
    /// Samples per pixel of that one.
    pub reference_spp: u32,
    /// What tells the noise of the reference, if not its variance.
    pub reference_noise: Option<Noise>,
    /// Seeds by which each run is made, the first of which is timed: `seed` and those that follow.
    pub seeds: u32,
    /// Images of other renderers.
    pub peer_images: Vec<PeerImage>,
    /// Tables of points of other renderers.
    pub peer_tables: Vec<PathBuf>,
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
            block_voxels: vec![2, 4, 8],
            samples: vec![8, 16, 64, 128, 256],
            max_solid_angle: vec![0.0025, 0.005, 0.01, 0.04, 0.08],
            paper_cloud: None,
            scatter: false,
            shade: shade::Settings::default(),
            rounds: 3,
            long_secs: 30.0,
            reference: None,
            reference_spp: 1024,
            reference_noise: None,
            seeds: 1,
            peer_images: Vec::new(),
            peer_tables: Vec::new(),
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
            block_depth: vec![0.7],
            block_voxels: vec![8],
            samples: vec![16],
            max_solid_angle: vec![0.04],
            rounds: 1,
            reference_spp: 128,
            ..Self::default()
        }
    }

    /// The same without sweeps: only Monte Carlo and the base settings.
    #[must_use]
    pub fn base_only(self) -> Self {
        let last = |v: &[u64]| v.last().copied().into_iter().collect();
        Self {
            surfels: last(&self.surfels),
            block_depth: self.block_depth.into_iter().take(1).collect(),
            block_voxels: Vec::new(),
            samples: Vec::new(),
            max_solid_angle: Vec::new(),
            ..self
        }
    }

    /// Refuses settings that make no sense.
    ///
    /// # Errors
    /// Names the setting and what it may be.
    pub fn check(&self) -> Result<()> {
        let counts = [
            ("`spp`", self.spp.iter().all(|&n| n > 0)),
            ("`surfels`", self.surfels.iter().all(|&n| n > 0)),
            ("`samples`", self.samples.iter().all(|&n| n > 0)),
            ("`rounds`", self.rounds > 0),
            ("`reference_spp`", self.reference_spp > 0),
            ("`seeds`", self.seeds > 0),
        ];
        if let Some((name, _)) = counts.iter().find(|(_, good)| !good) {
            return Err(Error::input(format!("{name} must be at least 1")));
        }
        if self.peer_images.len() > MAX_PEERS {
            let what = format!("expected at most {MAX_PEERS} images of other renderers");
            return Err(Error::input(what));
        }
        if self.spp.is_empty() || self.surfels.is_empty() || self.block_depth.is_empty() {
            return Err(Error::input(
                "`spp`, `surfels` and `block_depth` need one value at least",
            ));
        }
        if self.long_secs.is_nan() || self.long_secs < 0.0 {
            return Err(Error::input(format!(
                "`long` must not be negative, found {}",
                self.long_secs
            )));
        }
        let sides = self.block_voxels.iter().map(|n| ("`block_voxels`", n));
        for (name, n) in sides.chain(self.paper_cloud.iter().map(|n| ("`paper_cloud`", n))) {
            if ![1, 2, 4, 8].contains(n) {
                return Err(Error::input(format!(
                    "{name} has to be 1, 2, 4 or 8, found {n}"
                )));
            }
        }
        for variant in self.variants(true) {
            if let How::Points(points) = variant.how {
                points.bake(self.seed).check()?;
                points.shade.check()?;
            }
        }
        Ok(())
    }

    /// All runs, one method after the other in turn, so that whatever else the machine does hits
    /// all alike. Without media the traditional method is the extended one, and lvoxels of any size
    /// are none: they are left out.
    #[must_use]
    pub fn variants(&self, has_media: bool) -> Vec<Variant> {
        let mut columns = vec![self.monte_carlo()];
        if has_media {
            columns.push(self.points(shade::Method::Traditional, true));
        }
        columns.push(self.points(shade::Method::Extended, has_media));
        let longest = columns.iter().map(Vec::len).max().unwrap_or(0);
        (0..longest)
            .flat_map(|i| columns.iter().filter_map(move |c| c.get(i).cloned()))
            .collect()
    }

    /// The same for further seeds, after that of the runs which are timed.
    pub fn of_further_seeds(&self) -> impl Iterator<Item = Self> {
        (1..u64::from(self.seeds)).map(|i| Self {
            seed: self.seed.wrapping_add(i),
            ..self.clone()
        })
    }

    fn monte_carlo(&self) -> Vec<Variant> {
        self.spp
            .iter()
            .map(|&spp| Variant {
                name: format!("monte-carlo-{spp}"),
                method: Method::MonteCarlo,
                sweep: Sweep::Spp,
                how: How::MonteCarlo { spp },
            })
            .collect()
    }

    fn points(&self, method: shade::Method, has_media: bool) -> Vec<Variant> {
        let label = Method::from(method);
        let base = Points {
            surfels: self.surfels.last().copied().unwrap_or(1),
            blocks: BlockSize::OpticalDepth(self.block_depth.first().copied().unwrap_or(0.7)),
            shade: shade::Settings {
                camera: self.camera.clone(),
                method,
                seed: self.seed,
                ..self.shade.clone()
            },
        };
        let mut variants = Vec::new();
        let mut add = |sweep: Sweep, value: String, points: Points| {
            if sweep.is_alone() || points != base {
                variants.push(Variant {
                    name: if sweep.is_alone() {
                        format!("{label}-{sweep}")
                    } else {
                        format!("{label}-{sweep}-{value}")
                    },
                    method: label,
                    sweep,
                    how: How::Points(points),
                });
            }
        };
        add(Sweep::Base, String::new(), base.clone());
        if let (Some(voxels), Method::Extended) = (self.paper_cloud, label) {
            add(Sweep::Paper, String::new(), base.of_the_paper(voxels));
        }
        for &surfels in &self.surfels {
            let points = Points {
                surfels,
                ..base.clone()
            };
            add(Sweep::Surfels, surfels.to_string(), points);
        }
        for &samples in &self.samples {
            let mut points = base.clone();
            points.shade.samples = samples;
            add(Sweep::Samples, samples.to_string(), points);
        }
        for &max_solid_angle in &self.max_solid_angle {
            let mut points = base.clone();
            points.shade.max_solid_angle = max_solid_angle;
            add(Sweep::MaxSolidAngle, max_solid_angle.to_string(), points);
        }
        if label == Method::Extended && has_media {
            for &block_depth in &self.block_depth {
                let points = Points {
                    blocks: BlockSize::OpticalDepth(block_depth),
                    ..base.clone()
                };
                add(Sweep::BlockDepth, block_depth.to_string(), points);
            }
            for &voxels in &self.block_voxels {
                let points = Points {
                    blocks: fixed(voxels),
                    ..base.clone()
                };
                add(Sweep::BlockVoxels, voxels.to_string(), points);
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
    /// How it renders.
    pub method: Method,
    /// The setting that is varied.
    pub sweep: Sweep,
    /// What to do.
    pub how: How,
}

impl Variant {
    /// Digest of all that the run depends on beside what it has in common with all runs of a study.
    #[must_use]
    pub fn key(&self, settings: &Settings) -> String {
        let seed = settings.seed;
        let text = match &self.how {
            How::MonteCarlo { spp } => format!("{spp} {} {seed}", settings.max_depth),
            How::Points(points) => {
                // The camera is common to all, whether it was named or not.
                let shade = shade::Settings {
                    camera: None,
                    ..points.shade.clone()
                };
                format!("{:?} {shade:?}", points.bake(seed))
            }
        };
        blake3::hash(text.as_bytes()).to_hex().to_string()
    }

    /// All settings that any run varies.
    #[must_use]
    pub fn values(&self) -> BTreeMap<Sweep, f64> {
        let values = match &self.how {
            How::MonteCarlo { spp } => vec![(Sweep::Spp, f64::from(*spp))],
            How::Points(points) => vec![
                (Sweep::Surfels, points.surfels as f64),
                match points.blocks {
                    BlockSize::OpticalDepth(tau) => (Sweep::BlockDepth, as_typed(tau)),
                    BlockSize::Fixed { level, .. } => {
                        (Sweep::BlockVoxels, f64::from(1_u32 << level))
                    }
                },
                (Sweep::Samples, f64::from(points.shade.samples)),
                (Sweep::MaxSolidAngle, as_typed(points.shade.max_solid_angle)),
            ],
        };
        values.into_iter().collect()
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
    /// Size of lvoxels.
    pub blocks: BlockSize,
    /// How to shade.
    pub shade: shade::Settings,
}

impl Points {
    /// Name of the cloud, shared by all runs that need the same one.
    #[must_use]
    pub fn cloud(&self) -> String {
        let blocks = match self.blocks {
            BlockSize::OpticalDepth(tau) => format!("depth-{tau}"),
            BlockSize::Fixed { level, .. } => format!("voxels-{}", 1_u32 << level),
        };
        format!("surfels-{}-{blocks}", self.surfels)
    }

    /// How to bake that cloud.
    #[must_use]
    pub fn bake(&self, seed: u64) -> bake::Settings {
        bake::Settings {
            surfels: SurfelSampling::Area {
                count: self.surfels,
            },
            blocks: self.blocks,
            seed,
            ..bake::Settings::default()
        }
    }

    /// The same on a cloud in the proportions of the paper's Table 1 (Gibson & Wood 2011): 2.5
    /// million surfels, and lvoxels of some voxels a side, each from 16 coefficient samples.
    #[must_use]
    pub fn of_the_paper(&self, voxels: u8) -> Self {
        Self {
            surfels: 2_500_000,
            blocks: fixed(voxels),
            shade: self.shade.clone(),
        }
    }
}

/// The number that a person means by the nearest f32: 0.04, not 0.03999999910593033.
fn as_typed(value: f32) -> f64 {
    value.to_string().parse().unwrap_or(f64::from(value))
}

/// Lvoxels of so many voxels a side, with the most samples of the paper.
fn fixed(voxels: u8) -> BlockSize {
    BlockSize::Fixed {
        level: voxels.max(1).ilog2() as u8,
        samples: 16,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn names_are_unique_and_methods_take_turns() {
        let paper = Settings {
            paper_cloud: Some(4),
            ..Settings::default()
        };
        for settings in [
            Settings::default(),
            Settings::quick(),
            Settings::quick().base_only(),
            paper,
        ] {
            settings.check().unwrap();
            let variants = settings.variants(true);
            let names: BTreeSet<_> = variants.iter().map(|v| &v.name).collect();
            assert_eq!(names.len(), variants.len());
            let first: Vec<_> = variants[..3].iter().map(|v| v.method).collect();
            assert_eq!(first, Method::ALL);
            assert_eq!(
                variants.iter().filter(|v| v.sweep == Sweep::Base).count(),
                2
            );
        }
    }

    #[test]
    fn without_sweeps_there_is_one_run_of_each_method_beside_monte_carlo() {
        let settings = Settings::default().base_only();
        let variants = settings.variants(true);
        assert_eq!(variants.len(), settings.spp.len() + 2);
        let How::Points(points) = &variants[1].how else {
            panic!("traditional has no points");
        };
        assert_eq!(points.surfels, 500_000);
    }

    #[test]
    fn without_media_nothing_is_run_that_only_media_tell_apart() {
        let settings = Settings::default();
        let names = |has_media| -> BTreeSet<String> {
            let variants = settings.variants(has_media);
            variants.into_iter().map(|v| v.name).collect()
        };
        let (with, without) = (names(true), names(false));
        let left_out: Vec<_> = with.difference(&without).collect();
        assert!(
            left_out
                .iter()
                .all(|n| n.starts_with("traditional") || n.contains("-block-"))
        );
        // The base, 2 clouds, 5 numbers of samples and 5 solid angles; 3 depths and 3 sides of
        // lvoxels.
        assert_eq!(left_out.len(), 13 + 3 + 3);
        assert_eq!(without.len(), 4 + 13);
    }

    fn variant(settings: &Settings, name: &str) -> Variant {
        let mut variants = settings.variants(true).into_iter();
        variants.find(|v| v.name == name).unwrap()
    }

    #[test]
    fn keys_know_what_a_run_depends_on_and_no_more() {
        let base = Settings::default();
        let key = |settings: &Settings, name: &str| variant(settings, name).key(settings);
        let more = Settings {
            rounds: 7,
            long_secs: 1.0,
            spp: vec![1, 2],
            samples: vec![8, 9],
            camera: Some("front".into()),
            ..base.clone()
        };
        let seeded = Settings {
            seed: 5,
            ..base.clone()
        };
        for name in ["monte-carlo-1", "extended-base", "traditional-samples-8"] {
            assert_eq!(key(&more, name), key(&base, name), "{name}");
            assert_ne!(key(&seeded, name), key(&base, name), "{name}");
        }
        let deeper = Settings {
            max_depth: 4,
            ..base.clone()
        };
        assert_ne!(key(&deeper, "monte-carlo-1"), key(&base, "monte-carlo-1"));
        assert_eq!(key(&deeper, "extended-base"), key(&base, "extended-base"));
    }

    #[test]
    fn values_are_as_they_were_typed() {
        let settings = Settings::default();
        let of = |name: &str, setting: Sweep| variant(&settings, name).values()[&setting];
        let angle = of("extended-max-solid-angle-0.04", Sweep::MaxSolidAngle);
        assert_eq!(angle.to_string(), "0.04");
        assert_eq!(of("extended-block-depth-0.35", Sweep::BlockDepth), 0.35);
        assert_eq!(as_typed(0.1_f32), 0.1);
    }

    #[test]
    fn impossible_settings_are_named() {
        let voxels = Settings {
            block_voxels: vec![3],
            ..Settings::default()
        };
        let message = voxels.check().unwrap_err().to_string();
        assert!(message.contains("`block_voxels`"), "{message}");
        let settings = Settings {
            samples: vec![0],
            ..Settings::default()
        };
        assert!(
            settings
                .check()
                .unwrap_err()
                .to_string()
                .contains("`samples`")
        );
    }
}

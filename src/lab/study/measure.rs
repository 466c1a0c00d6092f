//! One run of a study: what it takes and what comes out.

use super::plan::{How, Points, Settings, Variant};
use super::record::{Cloud, Errors, Making, Timing};
use crate::formats::Overwrite;
use crate::image::metrics::{self, Comparison};
use crate::image::{Frame, Picture, Region};
use crate::lab::reference;
use crate::math::sampling;
use crate::run::{Job, usage};
use crate::scatter;
use crate::scene::Scene;
use crate::shade::Method;
use crate::tree::OpenTree;
use crate::{Result, shade};
use crate::{bake, build};
use std::f64::consts::PI;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// The fixed parts of a study.
pub struct Bench<'a> {
    /// The scene.
    pub scene: &'a Scene,
    /// What is studied.
    pub settings: &'a Settings,
    /// Where trees are kept.
    pub trees: PathBuf,
    /// Progress goes to the study's own task; the rest is that of the caller.
    pub job: Job,
}

/// Seed of the Monte Carlo runs of a study: references have small seeds that people type, often
/// that of the study, and noise that is shared with a reference would not count as an error.
fn monte_carlo_seed(seed: u64) -> u64 {
    const DOMAIN: u64 = u64::from_le_bytes(*b"lv study");
    sampling::hash(&[DOMAIN, seed])
}

/// Runs and times it.
fn timed<T>(run: impl FnOnce() -> Result<T>) -> Result<(T, Timing)> {
    let (started, cpu) = (Instant::now(), usage::cpu_secs());
    let result = run()?;
    let timing = Timing {
        wall_secs: started.elapsed().as_secs_f64(),
        cpu_secs: usage::cpu_secs() - cpu,
    };
    Ok((result, timing))
}

impl<'a> Bench<'a> {
    /// Takes limits and cancellation from a job.
    pub fn new(scene: &'a Scene, settings: &'a Settings, trees: PathBuf, job: &Job) -> Self {
        Self {
            scene,
            settings,
            trees,
            job: Job {
                cancel: job.cancel.clone(),
                memory_limit: job.memory_limit,
                temp_dir: job.temp_dir.clone(),
                ..Job::default()
            },
        }
    }

    /// The whole frame.
    pub fn region(&self) -> Region {
        Region::full(self.scene.film.width, self.scene.film.height)
    }

    fn tree(&self, cloud: &str) -> PathBuf {
        self.trees.join(format!("{cloud}.lvt"))
    }

    /// Light of media of that tree, if it is made beforehand.
    fn scatter(&self, cloud: &str) -> Option<PathBuf> {
        let is_made = self.settings.scatter && !self.scene.volumes.is_empty();
        is_made.then(|| self.trees.join(format!("{cloud}.lvs")))
    }

    /// Opens the tree of a cloud, with that light.
    fn open(&self, cloud: &str) -> Result<OpenTree> {
        let store = OpenTree::open(&self.tree(cloud), self.job.memory_limit)?;
        match self.scatter(cloud) {
            Some(scatter) => store.with_scatter(&scatter),
            None => Ok(store),
        }
    }

    /// Whether what is made of a cloud is there and whole, as far as headers and tables tell.
    pub fn has_tree(&self, cloud: &str) -> bool {
        self.open(cloud).is_ok()
    }

    /// Bakes, builds and makes light of media: a cloud of one round. The files are the same in
    /// every round.
    pub fn prepare(&self, points: &Points) -> Result<Cloud> {
        let name = points.cloud();
        let cloud = self.trees.join(format!("{name}.lvc"));
        let tree = self.tree(&name);
        let settings = points.bake(self.settings.seed);
        let (_, bake) =
            timed(|| bake::run(self.scene, &settings, &cloud, Overwrite::Replace, &self.job))?;
        let built = timed(|| {
            build::run(
                &cloud,
                &tree,
                &build::Settings::default(),
                Overwrite::Replace,
                &self.job,
            )
        });
        // The tree holds all that is needed from here on; after a stop the cloud is baked anew.
        let _ = std::fs::remove_file(&cloud);
        let (outcome, mut build) = built?;
        let store = OpenTree::open(&tree, self.job.memory_limit)?;
        if let Some(output) = self.scatter(&name) {
            let settings = scatter::Settings {
                seed: self.settings.seed,
                ..scatter::Settings::default()
            };
            let run = || {
                scatter::run(
                    self.scene,
                    &store,
                    &output,
                    &settings,
                    Overwrite::Replace,
                    &self.job,
                )
            };
            build += timed(run)?.1;
        }
        let blocks = store.tree().lvoxel_blocks();
        let sums = &outcome.summary.sums;
        let disk = sums.area / (PI * sums.surfels.max(1) as f64);
        let mut cloud = Cloud {
            name,
            surfels: sums.surfels,
            surfel_radius: f64::from(settings.overlap) * disk.sqrt(),
            lvoxels: sums.lvoxels(),
            tree_bytes: file_bytes(&tree),
            lvoxel_bytes: blocks.iter().map(|b| u64::from(b.stored_bytes)).sum(),
            ..Cloud::default()
        };
        cloud.add(Making { bake, build });
        Ok(cloud)
    }

    /// Renders, and tells the time and the largest resident memory.
    pub fn render(&self, variant: &Variant) -> Result<(Picture, Timing, Option<u64>)> {
        let (rendered, peak) = usage::with_peak_memory(|| self.frame(variant));
        let (frame, timing) = rendered?;
        Ok((frame.picture("", &self.region())?, timing, peak))
    }

    fn frame(&self, variant: &Variant) -> Result<(Frame, Timing)> {
        let region = self.region();
        match &variant.how {
            How::MonteCarlo { spp } => {
                let settings = reference::Settings {
                    camera: self.settings.camera.clone(),
                    max_depth: self.settings.max_depth,
                    spp: Some(*spp),
                    secs: None,
                    // The least noise: nobody asks these for their variance.
                    strands: 1,
                    seed: monte_carlo_seed(self.settings.seed),
                };
                timed(|| {
                    let mut sums = reference::begin(self.scene, &settings, region, &self.job)?;
                    let nothing = &mut |_: &reference::Sums| Ok(());
                    reference::accumulate(self.scene, &settings, &mut sums, &self.job, nothing)?;
                    Ok(reference::frame(self.scene, &sums))
                })
            }
            How::Points(points) => timed(|| {
                let store = match points.shade.method {
                    Method::Extended => self.open(&points.cloud())?,
                    Method::Traditional => {
                        OpenTree::open(&self.tree(&points.cloud()), self.job.memory_limit)?
                    }
                };
                shade::run(self.scene, &store, &points.shade, region, &[], &self.job)
            }),
        }
    }

    /// Errors of a picture by all metrics, and those of its pixels.
    pub fn judge(
        &self,
        picture: &Picture,
        reference: &Picture,
        exposure: f32,
    ) -> Result<(Errors, Comparison)> {
        let found = metrics::compare_until(picture, reference, exposure, &self.job.cancel)?;
        let s = &found.scores;
        let value = |v: f64| v.is_finite().then_some(v);
        let errors = Errors {
            relmse: value(s.relmse),
            relmse_trimmed: value(s.relmse_trimmed),
            flip: value(s.flip),
            ssim: value(s.ssim),
            pdiff: value(s.pdiff),
            bias: value(s.bias),
        };
        Ok((errors, found))
    }
}

fn file_bytes(path: &Path) -> u64 {
    std::fs::metadata(path).map_or(0, |m| m.len())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn monte_carlo_never_has_the_samples_of_a_reference() {
        let mut scene = Scene::demo().unwrap();
        (scene.film.width, scene.film.height) = (16, 12);
        let region = Region::full(16, 12);
        for seed in 0..4 {
            let settings = Settings {
                seed,
                ..Settings::quick()
            };
            let job = Job::default();
            let bench = Bench::new(&scene, &settings, PathBuf::new(), &job);
            let variant = settings.variants(true).swap_remove(0);
            assert_eq!(variant.how, How::MonteCarlo { spp: 1 });
            let (frame, _) = bench.frame(&variant).unwrap();
            let picture = frame.picture("", &region).unwrap();
            for seed in (0..4).chain([u64::MAX]) {
                let settings = reference::Settings {
                    max_depth: 3,
                    spp: Some(1),
                    strands: 1,
                    seed,
                    ..reference::Settings::default()
                };
                let mut sums = reference::begin(&scene, &settings, region, &job).unwrap();
                let nothing = &mut |_: &reference::Sums| Ok(());
                reference::accumulate(&scene, &settings, &mut sums, &job, nothing).unwrap();
                let target = reference::frame(&scene, &sums).picture("", &region);
                let (errors, _) = bench.judge(&picture, &target.unwrap(), 1.0).unwrap();
                assert!(errors.relmse.unwrap() > 1e-3, "{seed}: {errors:?}");
            }
        }
    }
}

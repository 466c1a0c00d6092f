//! Measures the error of settings on small blocks of the frame, against paths traced at pixels of
//! those blocks.

use crate::image::Region;
use crate::image::metrics::linear::{self, RELATIVE_FLOOR};
use crate::lab::reference::{PathTracer, Sampler, camera_ray};
use crate::math::{Rgb, sampling};
use crate::run::Job;
use crate::scene::{Camera, Film, Scene};
use crate::shade::{self, Settings, ShadedPixel};
use crate::tree::OpenTree;
use crate::{Error, Result};
use rayon::prelude::*;

/// Most blocks.
const BLOCKS: usize = 100;
/// Pixels along the edge of a block.
const BLOCK_EDGE: u32 = 12;
/// Pixels of a block whose truth is traced, one in each cell of this size.
const CELL: [u32; 2] = [4, 2];
/// Sequences of paths at each pixel, independent of each other. Fewer leave a noisy scale to
/// relative errors; more leave sequences too short to be well spread.
const STRANDS: u32 = 8;
/// Paths of each pixel at first, and at most.
const PATHS: [u32; 2] = [64, 256];
/// Noise of a measured error that is good enough, over the target.
const NOISE: f64 = 0.2;

/// Blocks of a frame and what is known of their truth.
pub struct Pilot<'a> {
    scene: &'a Scene,
    camera: &'a Camera,
    paths: PathTracer<'a>,
    seed: u64,
    blocks: Vec<Region>,
    points: Vec<Point>,
    /// Paths of each point so far.
    count: u32,
}

/// A pixel whose truth is traced.
struct Point {
    x: u32,
    y: u32,
    /// Its block, and its place there.
    block: usize,
    index: usize,
    /// Sums of the paths of each sequence, without those whose light is infinite or not a number.
    sums: [[f64; 3]; STRANDS as usize],
    /// How many of each are in its sum.
    counts: [u32; STRANDS as usize],
}

impl<'a> Pilot<'a> {
    /// Places the blocks; nothing is traced yet.
    pub fn new(scene: &'a Scene, tree: &OpenTree, settings: &Settings, job: &Job) -> Result<Self> {
        let camera = scene.camera(settings.camera.as_deref())?;
        job.cancel.check()?;
        let blocks = blocks(&scene.film, settings.seed);
        let points = blocks
            .iter()
            .enumerate()
            .flat_map(|(i, &block)| points(i, block, settings.seed))
            .collect();
        Ok(Self {
            scene,
            camera,
            paths: PathTracer::new(scene, tree.segments(), &job.cancel)?,
            seed: settings.seed,
            blocks,
            points,
            count: 0,
        })
    }

    /// Pixels that are shaded for each measurement.
    pub fn pixels(&self) -> usize {
        self.blocks.iter().map(Region::pixels).sum()
    }

    /// Paths traced so far.
    pub fn paths(&self) -> u64 {
        self.points.len() as u64 * u64::from(self.count)
    }

    /// The trimmed relMSE of settings, good enough to tell whether it is near the target.
    pub fn error(
        &mut self,
        store: &OpenTree,
        settings: &Settings,
        target: f64,
        job: &Job,
    ) -> Result<f64> {
        let quiet = Job {
            cancel: job.cancel.clone(),
            memory_limit: job.memory_limit,
            temp_dir: job.temp_dir.clone(),
            ..Job::default()
        };
        let shaded = shade::pixels(self.scene, store, settings, &self.blocks, &quiet)?;
        if self.count == 0 {
            self.trace(PATHS[0], job)?;
        }
        loop {
            let found = self.compare(&shaded);
            if !found.error.is_finite() {
                return Err(Error::failed(
                    "the pilot of `target_error` shaded pixels, or traced paths, \
                     that are infinite or not a number",
                )
                .hint(
                    "look for emission, intensities or sizes at the limits of floats, or give \
                     settings instead",
                ));
            }
            // An error above the target need not be known as well as one at the target; but one far
            // above may be that of few paths, which miss what is bright and rare.
            let enough = NOISE * found.error.clamp(target, 4.0 * target);
            if found.noise <= enough || self.count >= PATHS[1] {
                return Ok(found.error.max(found.noise));
            }
            // Noise falls about as one over the number of paths.
            let more = f64::from(self.count) * (found.noise / enough - 1.0).clamp(0.25, 3.0);
            let room = PATHS[1] - self.count;
            self.trace((more as u32).next_multiple_of(STRANDS).min(room), job)?;
        }
    }

    /// Paths traced so far whose light is infinite or not a number, which are left out.
    pub fn lost(&self) -> u64 {
        let kept = |p: &Point| p.counts.iter().map(|&n| u64::from(n)).sum::<u64>();
        self.paths() - self.points.iter().map(kept).sum::<u64>()
    }

    /// Traces so many more paths at each point.
    fn trace(&mut self, more: u32, job: &Job) -> Result<()> {
        let Self {
            scene,
            camera,
            paths,
            points,
            count,
            seed,
            ..
        } = self;
        let from = *count;
        points.par_iter_mut().try_for_each(|point| {
            job.cancel.check()?;
            for i in from..from + more {
                let strand = i % STRANDS;
                let key = sampling::seeded(*seed, &[point.x, point.y, strand].map(u64::from));
                let mut sampler = Sampler::new(key, i / STRANDS);
                let at = [point.x as f32, point.y as f32];
                let ray = camera_ray(camera, &scene.film, at, &mut sampler);
                let light = paths.radiance(ray.origin, ray.direction, &mut sampler);
                point.add(strand, light);
            }
            Ok::<(), Error>(())
        })?;
        *count += more;
        Ok(())
    }

    fn compare(&self, shaded: &[Vec<ShadedPixel>]) -> Measured {
        let known = |p: &Point| shaded[p.block][p.index];
        let has_others = self.points.iter().any(|p| !known(p).has_emitter_border);
        // At the border of an emitter shading is exact, and paths that miss it look as if they
        // had no noise.
        let mut terms: Vec<(f64, f64)> = self
            .points
            .iter()
            .filter(|p| !(has_others && known(p).has_emitter_border))
            .filter_map(|p| p.compare(known(p).radiance))
            .collect();
        // By size of the error: as likely to drop what noise made too small as what it made too
        // large.
        terms.sort_unstable_by(|a, b| a.0.abs().total_cmp(&b.0.abs()));
        // With nothing to go by the error is not a number, which the caller refuses.
        let kept = linear::kept(terms.len());
        let terms = &terms[..kept];
        let count = kept as f64;
        Measured {
            error: terms.iter().map(|t| t.0).sum::<f64>() / count,
            noise: terms.iter().map(|t| t.1).sum::<f64>().sqrt() / count,
        }
    }
}

/// An error, and the standard deviation that the noise of paths gives it.
struct Measured {
    error: f64,
    noise: f64,
}

impl Point {
    /// Adds a path to one of the sequences.
    fn add(&mut self, strand: u32, Rgb(light): Rgb) {
        if light.iter().all(|v| v.is_finite()) {
            let sum = &mut self.sums[strand as usize];
            *sum = [0, 1, 2].map(|c| sum[c] + f64::from(light[c]));
            self.counts[strand as usize] += 1;
        }
    }

    /// Estimate of the squared relative error of a value, to which the noise of paths adds nothing
    /// on average, and the variance of it; `None` if a sequence has no path.
    ///
    /// Two sequences give the square and the others what it is divided by, all pairs in turn: were
    /// it divided by the mean of all, then noise that makes the truth look darker would count for
    /// more than noise that makes it look brighter.
    fn compare(&self, Rgb(shaded): Rgb) -> Option<(f64, f64)> {
        const COUNT: usize = STRANDS as usize;
        if self.counts.contains(&0) {
            return None;
        }
        let (mut error, mut variance) = (0.0, 0.0);
        for (c, shaded) in shaded.into_iter().enumerate() {
            let shaded = f64::from(shaded);
            let means: [f64; COUNT] =
                std::array::from_fn(|i| self.sums[i][c] / f64::from(self.counts[i]));
            let sum: f64 = means.iter().sum();
            let mut products = 0.0;
            for (i, a) in means.iter().enumerate() {
                for b in &means[..i] {
                    let others = (sum - a - b) / (COUNT - 2) as f64;
                    products += (shaded - a) * (shaded - b) / (others * others + RELATIVE_FLOOR);
                }
            }
            error += products / (COUNT * (COUNT - 1) / 2) as f64 / 3.0;
            let truth = sum / COUNT as f64;
            let spread: f64 = means.iter().map(|m| (m - truth) * (m - truth)).sum();
            let noise = spread / (COUNT * (COUNT - 1)) as f64;
            let scale = 1.0 / (truth * truth + RELATIVE_FLOOR);
            let signal = ((shaded - truth).powi(2) - noise).max(0.0);
            // Channels move together: the mean of their variances, not a third of it.
            variance += scale * scale * (2.0 * noise * noise + 4.0 * signal * noise) / 3.0;
        }
        Some((error, variance))
    }
}

/// Blocks spread over a film: one in each stretch of a path that winds through all.
fn blocks(film: &Film, seed: u64) -> Vec<Region> {
    let all = Region::full(film.width, film.height).blocks([BLOCK_EDGE; 2]);
    let columns = film.width.div_ceil(BLOCK_EDGE) as usize;
    let rows = all.len() / columns;
    // Back and forth through strips of a few rows, so that a stretch is about as high as wide.
    let strip = ((all.len() as f64 / BLOCKS as f64).sqrt().round() as usize).max(1);
    let mut winding = Vec::with_capacity(all.len());
    for (i, top) in (0..rows).step_by(strip).enumerate() {
        for c in 0..columns {
            let column = if i % 2 == 0 { c } else { columns - 1 - c };
            let rows = top..rows.min(top + strip);
            winding.extend(rows.map(|row| all[row * columns + column]));
        }
    }
    let count = winding.len().min(BLOCKS);
    (0..count)
        .map(|i| {
            let cut = |i: usize| i * winding.len() / count;
            let within = (cut(i + 1) - cut(i)) as f32;
            let chosen = (sampling::unit(sampling::seeded(seed, &[i as u64])) * within) as usize;
            winding[cut(i) + chosen]
        })
        .collect()
}

/// The pixels of a block whose truth is traced: one in each cell.
fn points(block: usize, region: Region, seed: u64) -> Vec<Point> {
    let mut points = Vec::new();
    for top in (region.y0..region.y1).step_by(CELL[1] as usize) {
        for left in (region.x0..region.x1).step_by(CELL[0] as usize) {
            let [u, v] = sampling::unit2(sampling::seeded(seed, &[left, top].map(u64::from)));
            let within = |from: u32, to: u32, cell: u32, u: f32| {
                let size = cell.min(to - from);
                from + ((u * size as f32) as u32).min(size - 1)
            };
            let x = within(left, region.x1, CELL[0], u);
            let y = within(top, region.y1, CELL[1], v);
            let index =
                (y - region.y0) as usize * region.width() as usize + (x - region.x0) as usize;
            points.push(Point {
                x,
                y,
                block,
                index,
                sums: [[0.0; 3]; STRANDS as usize],
                counts: [0; STRANDS as usize],
            });
        }
    }
    points
}

#[cfg(test)]
mod tests {
    use super::*;

    fn film(width: u32, height: u32) -> Film {
        Film {
            width,
            height,
            exposure: 1.0,
        }
    }

    #[test]
    fn blocks_are_inside_apart_and_in_all_quarters() {
        for (width, height) in [(1, 1), (7, 90), (64, 48), (512, 384), (1920, 1080)] {
            let film = film(width, height);
            let blocks = blocks(&film, 3);
            assert!(!blocks.is_empty() && blocks.len() <= BLOCKS);
            for (i, a) in blocks.iter().enumerate() {
                a.check(width, height).unwrap();
                assert!(!blocks[..i].contains(a));
            }
            if width >= 512 {
                for (right, low) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
                    let count = blocks
                        .iter()
                        .filter(|b| (2 * b.x0 / width, 2 * b.y0 / height) == (right, low))
                        .count();
                    assert!((16..=34).contains(&count), "{count} in {right} {low}");
                }
            }
        }
    }

    #[test]
    fn paths_that_are_not_finite_are_left_out_of_the_mean_and_counted() {
        let region = Region::full(1, 1);
        let mut points = points(0, region, 0);
        let point = &mut points[0];
        for i in 0..4 * STRANDS {
            let light = if i < 2 * STRANDS { f32::NAN } else { 2.0 };
            point.add(i % STRANDS, Rgb([light; 3]));
        }
        assert_eq!(point.counts, [2; STRANDS as usize]);
        let (error, _) = point.compare(Rgb([2.0; 3])).unwrap();
        assert_eq!(error, 0.0);
        point.counts[1] = 0;
        assert!(point.compare(Rgb([2.0; 3])).is_none());
    }

    #[test]
    fn noise_of_paths_is_not_taken_for_error() {
        // Light of a skewed distribution with mean 1.
        let path = |key: &[u64]| 4.0 * sampling::unit(sampling::hash(key)).powi(3);
        for (shaded, expected) in [(1.0, 0.0), (1.2, 0.04), (0.8, 0.04)] {
            let count = 20_000;
            let errors = (0..count).map(|i| {
                let mut points = points(0, Region::full(1, 1), 0);
                for k in 0..PATHS[0] {
                    points[0].add(k % STRANDS, Rgb([path(&[i, k.into()]); 3]));
                }
                points[0].compare(Rgb([shaded; 3])).unwrap().0
            });
            let mean = errors.sum::<f64>() / count as f64;
            assert!((mean - expected).abs() < 0.03, "{shaded}: {mean}");
        }
    }

    #[test]
    fn the_seed_chooses_blocks_and_points() {
        let film = film(512, 384);
        assert_eq!(blocks(&film, 0), blocks(&film, 0));
        assert_ne!(blocks(&film, 0), blocks(&film, 1));
        let places = |seed| -> Vec<(u32, u32)> {
            let points = points(0, Region::full(16, 16), seed);
            points.iter().map(|p| (p.x, p.y)).collect()
        };
        assert_ne!(places(0), places(1));
    }

    #[test]
    fn points_lie_in_their_blocks_once() {
        let region = Region {
            x0: 3,
            y0: 5,
            x1: 16,
            y1: 12,
        };
        let points = points(0, region, 3);
        for p in &points {
            assert!((region.x0..region.x1).contains(&p.x) && (region.y0..region.y1).contains(&p.y));
            assert_eq!(
                p.index,
                ((p.y - region.y0) * region.width() + p.x - region.x0) as usize
            );
        }
        assert_eq!(points.len(), 4 * 4);
    }
}

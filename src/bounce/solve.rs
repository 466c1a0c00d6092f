//! The light of all bounces: at receivers, which pass it on to each other, and in media.

use super::light::Share;
use super::links::Links;
use super::media::{ScatteringVolume, at_receivers};
use super::receivers::{Met, Receiver};
use super::settings::Bounces;
use super::walls::WallLight;
use crate::math::Rgb;
use crate::run::Cancel;
use crate::{Error, Result};
use rayon::prelude::*;

/// Surfaces and media that light each other.
pub struct Exchange<'a, K> {
    /// Places on surfaces.
    pub receivers: &'a [Receiver],
    /// By receiver: the surfaces that its rays met, in the order of rays; the others met none.
    pub met: &'a [Vec<Met<K>>],
    /// How light goes between them.
    pub links: &'a Links,
    /// Media.
    pub volumes: Vec<ScatteringVolume<'a, K>>,
    /// For a stop on request.
    pub cancel: &'a Cancel,
}

/// The light of all bounces on surfaces.
#[derive(Debug, Default)]
pub struct Solution {
    /// By receiver: irradiance over pi.
    pub light: Vec<Rgb>,
    /// Passes over all links.
    pub passes: u32,
    /// Share of all light that the bounces which were left out would add, at most.
    pub residual: f64,
    /// Share of the light of a bounce that the next one has, at last; 0 where a number of them was
    /// asked for.
    pub kept: f64,
}

/// Light that is left once so little of all of it is still to come counts as none.
const TOLERANCE: f64 = 1e-4;
/// Bounces after which light that still does not fade is taken to stay for ever.
const MOST: u32 = 10_000;
/// Bounces from which on those that are left are told together, once each is a fixed part of the
/// one before: to this share of what they fade by.
const STEADY_FROM: u32 = 200;
const STEADY: f64 = 1e-3;
/// Residual of media over what their light is made of.
const MEDIA_TOLERANCE: f64 = 1e-3;
/// Share of all light that surfaces and media may still have to tell each other.
const ROUND_TOLERANCE: f64 = 1e-3;
/// Most times that surfaces and media light each other.
const MOST_ROUNDS: u32 = 16;

impl<K: Share> Exchange<'_, K> {
    /// Finds the light of so many bounces.
    ///
    /// # Errors
    /// Light that does not fade, if all bounces are asked for; a stop on request.
    pub fn solve(&mut self, bounces: Bounces) -> Result<Solution> {
        match bounces {
            Bounces::All => self.all(),
            Bounces::Count(n) => self.some(n),
        }
    }

    /// One bounce after another, of which a frame gathers the last.
    fn some(&mut self, bounces: u32) -> Result<Solution> {
        let mut light = vec![Rgb::BLACK; self.receivers.len()];
        for _ in 1..bounces {
            let next = self.passed_on(&light)?;
            let from_media = at_receivers(self.receivers, self.met, &self.volumes);
            let walls = WallLight {
                sends_tree: true,
                light: &light,
            };
            for volume in &mut self.volumes {
                volume.scatter_once(&walls, self.cancel)?;
            }
            light = self.gathered(from_media);
            light.iter_mut().zip(next).for_each(|(l, n)| *l += n);
        }
        Ok(Solution {
            light,
            passes: bounces - 1,
            residual: 0.0,
            kept: 0.0,
        })
    }

    /// Surfaces and media in turn, until neither has news for the other.
    fn all(&mut self) -> Result<Solution> {
        let mut solution = self.between_surfaces(self.gathered(Vec::new()))?;
        if self.volumes.is_empty() {
            return Ok(solution);
        }
        // Without surfaces nothing is left to tell once media are solved.
        let mut share: f64 = if self.receivers.is_empty() { 0.0 } else { 1.0 };
        for _ in 0..MOST_ROUNDS {
            // No more exactly than what comes from surfaces is known.
            let tolerance = (0.1 * share).clamp(MEDIA_TOLERANCE, 1e-2);
            let walls = WallLight {
                sends_tree: true,
                light: &solution.light,
            };
            for volume in &mut self.volumes {
                volume.solve(&walls, tolerance, self.cancel)?;
            }
            let gathered = self.gathered(at_receivers(self.receivers, self.met, &self.volumes));
            let next = self.between_surfaces(gathered)?;
            let news = next.light.iter().zip(&solution.light);
            let news: Vec<Rgb> = news
                .map(|(a, b)| Rgb(std::array::from_fn(|c| (a.0[c] - b.0[c]).abs())))
                .collect();
            share = self.power(&news) / self.power(&next.light).max(f64::MIN_POSITIVE);
            solution = Solution {
                passes: solution.passes + next.passes,
                ..next
            };
            if share < ROUND_TOLERANCE && tolerance == MEDIA_TOLERANCE {
                break;
            }
        }
        let walls = WallLight {
            sends_tree: true,
            light: &solution.light,
        };
        for volume in &mut self.volumes {
            volume.find_arriving(&walls, self.cancel)?;
        }
        Ok(solution)
    }

    /// What arrives at receivers of what the tree sends, and of what media send beyond that.
    fn gathered(&self, from_media: Vec<Rgb>) -> Vec<Rgb> {
        let direct = self.receivers.iter().zip(&self.links.direct);
        let mut light: Vec<Rgb> = direct.map(|(r, of_runs)| r.from_media + *of_runs).collect();
        light.iter_mut().zip(from_media).for_each(|(l, m)| *l += m);
        light
    }

    /// What arrives at each receiver over its links.
    fn passed_on(&self, light: &[Rgb]) -> Result<Vec<Rgb>> {
        self.cancel.check()?;
        let next = (0..light.len()).into_par_iter();
        Ok(next.map(|i| self.links.arriving(i, light)).collect())
    }

    fn power(&self, light: &[Rgb]) -> f64 {
        let of = |(r, l): (&Receiver, &Rgb)| f64::from(r.area) * f64::from(l.mean());
        self.receivers.iter().zip(light).map(of).sum()
    }

    /// All bounces between surfaces of what arrives at receivers.
    fn between_surfaces(&self, gathered: Vec<Rgb>) -> Result<Solution> {
        // Each order of bounces by itself: sums of what is positive, of which no difference is
        // taken.
        let mut order = gathered.clone();
        let mut solution = Solution {
            light: gathered,
            ..Solution::default()
        };
        let mut last = self.power(&order);
        let mut all = last;
        let mut last_rate = 0.0;
        while last > 0.0 {
            order = self.passed_on(&order)?;
            for (sum, more) in solution.light.iter_mut().zip(&order) {
                *sum += *more;
            }
            let power = self.power(&order);
            all += power;
            solution.passes += 1;
            // What follows is a geometric series, once the first orders are past.
            let rate = power / last;
            solution.kept = rate;
            solution.residual = match rate < 1.0 {
                true => rate / (1.0 - rate) * power / all,
                false => 1.0,
            };
            last = power;
            if solution.residual < TOLERANCE && solution.passes >= 3 {
                break;
            }
            // Of the orders that are left each is a fixed part of the one before.
            let is_steady = rate < 1.0 && (rate - last_rate).abs() < STEADY * (1.0 - rate);
            last_rate = rate;
            if is_steady && solution.passes >= STEADY_FROM {
                let tail = (rate / (1.0 - rate)) as f32;
                for (sum, more) in solution.light.iter_mut().zip(&order) {
                    *sum += *more * tail;
                }
                solution.residual *= STEADY;
                break;
            }
            if solution.passes >= MOST {
                return Err(Error::input(format!(
                    "after {MOST} bounces the next one still has {:.1e} of all light: expected \
                     surfaces that take some of it, or let it out",
                    last / all
                ))
                .hint("lower albedos of 1 in closed rooms, or give a number of `bounces`"));
            }
        }
        Ok(solution)
    }
}

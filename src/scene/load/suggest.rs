//! What to write into a scene for a volume whose values are of any unit: a window, and a scale.

use super::layers::{Voxels, layers};
use crate::Result;
use crate::run::Cancel;
use crate::scene::grid::VoxelBox;

/// Optical depth of what a suggestion makes of a volume, through a cube of its own size: light gets
/// in, and a picture shows it as a body.
const DEPTH: f64 = 16.0;
/// Bins in which values are counted.
const BINS: usize = 1024;
/// Share of the voxels from which on values of 0 are a background, and others are densities.
const BACKGROUND: f64 = 0.4;
/// Share of the values on either side that may be odd ones.
const ODD: f64 = 5e-4;
/// Share of the values in the medium that are at most the upper end of the window.
const BELOW_TOP: f64 = 0.995;

/// A window for the values of a volume file, and what is then of its voxels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SuggestedWindow {
    /// The values that become 0 and 1.
    pub window: [f64; 2],
    /// Voxels above the lower one.
    pub voxels: f64,
    /// The mean density of these.
    pub density: f64,
}

impl SuggestedWindow {
    /// The scale of extinction for voxels of such an edge, in world units.
    #[must_use]
    pub fn sigma_t_scale(&self, edge: f64) -> f64 {
        sigma_t_scale(self.voxels, self.density, edge)
    }
}

/// The factor that makes so many voxels of an extinction, and an edge, neither thin nor black.
pub(super) fn sigma_t_scale(voxels: f64, sigma_t: f64, edge: f64) -> f64 {
    rounded(DEPTH / (sigma_t * libm::cbrt(voxels) * edge), 2)
}

/// A number to so many digits.
fn rounded(number: f64, digits: i32) -> f64 {
    let text = format!("{number:.*e}", (digits - 1) as usize);
    text.parse().unwrap_or(number)
}

/// Counts of values between two.
struct Counts {
    from: f64,
    to: f64,
    counts: Vec<u64>,
}

impl Counts {
    fn of<F: Fn(&VoxelBox, &mut [f32]) -> Result<()> + Sync>(
        voxels: &Voxels<F>,
        [from, to]: [f64; 2],
        cancel: &Cancel,
    ) -> Result<Self> {
        let scale = BINS as f64 / (to - from);
        let count = |counts: &mut Vec<u64>, row: &[f32]| {
            for &value in row {
                let value = f64::from(value);
                if (from..=to).contains(&value) {
                    counts[(((value - from) * scale) as usize).min(BINS - 1)] += 1;
                }
            }
        };
        let mut counts = vec![0; BINS];
        for layer in layers(voxels, cancel, &vec![0_u64; BINS], count)? {
            counts.iter_mut().zip(layer).for_each(|(sum, n)| *sum += n);
        }
        Ok(Self { from, to, counts })
    }

    fn width(&self) -> f64 {
        (self.to - self.from) / BINS as f64
    }

    /// The end of the first bin at which a share of the values from `first` on is reached.
    fn quantile(&self, share: f64, first: usize) -> usize {
        let total: u64 = self.counts[first..].iter().sum();
        let mut sum = 0;
        for (i, n) in self.counts.iter().enumerate().skip(first) {
            sum += n;
            if sum as f64 >= share * total as f64 {
                return i + 1;
            }
        }
        BINS
    }

    /// The bin from which on values are those of the brighter of two kinds (Otsu 1979).
    fn threshold(&self) -> usize {
        let total: f64 = self.counts.iter().map(|n| *n as f64).sum();
        let moment = |(i, n): (usize, &u64)| (i as f64 + 0.5) * *n as f64;
        let all: f64 = self.counts.iter().enumerate().map(moment).sum();
        let (mut best, mut at) = (-1.0, 0);
        let (mut below, mut sum) = (0.0, 0.0);
        for (i, n) in self.counts.iter().enumerate() {
            below += *n as f64;
            sum += moment((i, n));
            let above = total - below;
            if below == 0.0 || above == 0.0 {
                continue;
            }
            let between = sum / below - (all - sum) / above;
            let variance = below * above * between * between;
            if variance > best {
                (best, at) = (variance, i + 1);
            }
        }
        at
    }

    fn value(&self, bin: usize) -> f64 {
        self.from + self.width() * bin as f64
    }
}

/// A window for values between these ends, of which so many voxels are not 0; `None` if all are the
/// same.
pub(super) fn window<F: Fn(&VoxelBox, &mut [f32]) -> Result<()> + Sync>(
    voxels: &Voxels<F>,
    [min, max]: [f32; 2],
    share_of_zeros: f64,
    cancel: &Cancel,
) -> Result<Option<SuggestedWindow>> {
    let is_density = min >= 0.0 && share_of_zeros >= BACKGROUND;
    let (min, max) = (f64::from(min), f64::from(max));
    if !(max - min).is_normal() || max <= min {
        return Ok(None);
    }
    let counts = Counts::of(voxels, [min, max], cancel)?;
    // A few values far away would leave all others in a bin or two.
    let first = counts.quantile(ODD, 0).saturating_sub(1);
    let last = counts.quantile(1.0 - ODD, 0);
    let ends = [counts.value(first), counts.value(last)];
    let counts = match last - first < BINS / 2 && !is_density {
        true => Counts::of(voxels, ends, cancel)?,
        false => counts,
    };
    let low = if is_density { 0 } else { counts.threshold() };
    // Of densities all that is not 0 counts, which the first bin has.
    let mut medium = counts.counts.clone();
    if is_density {
        let all: u64 = medium.iter().sum();
        let zeros = (share_of_zeros * all as f64).round() as u64;
        medium[0] = medium[0].saturating_sub(zeros);
    }
    let of_medium = Counts {
        counts: medium,
        ..counts
    };
    let high = of_medium.quantile(BELOW_TOP, low);
    let step = libm::pow(
        10.0,
        (libm::log10(of_medium.to - of_medium.from) - 2.5).floor(),
    );
    let round = |value: f64| rounded((value / step).round() * step, 12);
    let low_value = if is_density {
        0.0
    } else {
        round(of_medium.value(low))
    };
    let high_value = round(of_medium.value(high)).min(max);
    if high_value <= low_value {
        return Ok(None);
    }
    let (mut voxels, mut sum) = (0.0, 0.0);
    for (i, n) in of_medium.counts.iter().enumerate().skip(low) {
        let middle = of_medium.value(i) + 0.5 * of_medium.width();
        let density = ((middle - low_value) / (high_value - low_value)).clamp(0.0, 1.0);
        voxels += *n as f64;
        sum += density * *n as f64;
    }
    Ok((sum > 0.0).then(|| SuggestedWindow {
        window: [low_value, high_value],
        voxels,
        density: sum / voxels,
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn suggested(values: &[f32], dims: [usize; 3]) -> Option<SuggestedWindow> {
        let voxels = Voxels {
            dims,
            first: [0; 3],
            padding: 0,
            read: |part: &VoxelBox, out: &mut [f32]| {
                for ([x, y, z], at) in part.rows() {
                    let from = (z * dims[1] + y) * dims[0] + x;
                    out[at..at + part.dims[0]].copy_from_slice(&values[from..from + part.dims[0]]);
                }
                Ok(())
            },
        };
        let ends = values
            .iter()
            .fold([f32::INFINITY, f32::NEG_INFINITY], |e, v| {
                [e[0].min(*v), e[1].max(*v)]
            });
        let zeros = values.iter().filter(|v| **v == 0.0).count();
        let share = zeros as f64 / values.len() as f64;
        window(&voxels, ends, share, &Cancel::default()).unwrap()
    }

    #[test]
    fn air_is_told_from_tissue() {
        // As CT has it: air at -1000 with noise, tissue around 40, some bone, one streak of metal.
        let values: Vec<f32> = (0..40 * 40 * 40)
            .map(|i| {
                let noise = (i * 7919 % 61) as f32;
                match i % 40 {
                    _ if i == 777 => 30_000.0,
                    0..=19 => -1000.0 + noise,
                    20..=36 => 10.0 + noise,
                    _ => 900.0 + 10.0 * noise,
                }
            })
            .collect();
        let found = suggested(&values, [40; 3]).unwrap();
        let [low, high] = found.window;
        assert!((-940.0..=10.0).contains(&low), "{low}");
        assert!((1300.0..=1600.0).contains(&high), "{high}");
        assert!((found.voxels - 32_000.0).abs() < 100.0, "{}", found.voxels);
        // A cube of them of 2^(1/3) less than 40 voxels is deep, and no more.
        let depth = found.sigma_t_scale(0.5) * found.density * 0.5 * 32_000_f64.cbrt();
        assert!((depth / DEPTH - 1.0).abs() < 0.06, "{depth}");
    }

    #[test]
    fn densities_begin_at_0() {
        let values: Vec<f32> = (0..20 * 20 * 20)
            .map(|i| {
                if i % 4 == 0 {
                    (i % 200) as f32 / 100.0
                } else {
                    0.0
                }
            })
            .collect();
        let found = suggested(&values, [20; 3]).unwrap();
        assert_eq!(found.window[0], 0.0);
        assert!((1.9..=2.0).contains(&found.window[1]), "{:?}", found.window);
        assert_eq!(suggested(&[3.0; 8], [2; 3]), None);
    }
}

//! Sums of samples for every pixel, and the file that keeps them so that a later run goes on.
//!
//! Samples of a pixel go in turn to a few strands, each a sequence with a scramble of its own. How
//! far the means of the strands lie apart tells the variance without bias, which the spread of
//! samples inside one low-discrepancy sequence would not: those are better spread than chance.

use crate::image::samples::{self, Head, Origin, Row, Rows, Unreadable};
use crate::image::{Frame, Layer, Region};
use crate::run::Output;
use crate::{Error, Result};
use std::fs::File;
use std::io::BufReader;
use std::path::Path;

/// Samples of a region, summed.
#[derive(Clone, Debug, PartialEq)]
pub struct Sums {
    /// The part of the frame whose pixels have samples.
    pub region: Region,
    /// Independent sequences in each pixel.
    pub strands: u32,
    /// What the samples were made from: sums of different origins do not mix.
    pub origin: Origin,
    /// From the region's top.
    pub rows: Vec<Row>,
}

/// Mean and variance of the mean of one channel over the strands; the variance is infinite while
/// only one has samples.
fn estimate(count: u32, strands: u32, sums: impl Iterator<Item = f64> + Clone) -> (f64, f64) {
    if count == 0 {
        return (0.0, f64::INFINITY);
    }
    let n = f64::from(count);
    let mean = sums.clone().sum::<f64>() / n;
    let used = count.min(strands);
    if used < 2 {
        return (mean, f64::INFINITY);
    }
    let spread: f64 = sums
        .zip(0..used)
        .map(|(sum, strand)| {
            let own = f64::from((count - strand).div_ceil(strands));
            own * (sum / own - mean).powi(2)
        })
        .sum();
    (mean, spread / (f64::from(used - 1) * n))
}

impl Sums {
    /// No samples yet.
    #[must_use]
    pub fn new(region: Region, strands: u32, origin: Origin) -> Self {
        let pixels = region.width() as usize * strands as usize;
        let rows = (region.y0..region.y1)
            .map(|y| Row {
                y,
                count: 0,
                not_finite: 0,
                sums: vec![[0.0; 3]; pixels],
            })
            .collect();
        Self {
            region,
            strands,
            origin,
            rows,
        }
    }

    /// Bytes that the sums of a region take.
    #[must_use]
    pub fn bytes(region: &Region, strands: u32) -> u64 {
        samples::sum_bytes(region.pixels() as u64, strands)
    }

    /// Fewest and most samples of a pixel.
    #[must_use]
    pub fn counts(&self) -> (u32, u32) {
        samples::count_range(self.rows.iter().map(|r| r.count))
    }

    /// Samples of all pixels together.
    #[must_use]
    pub fn samples(&self) -> u64 {
        let width = u64::from(self.region.width());
        self.rows.iter().map(|r| width * u64::from(r.count)).sum()
    }

    /// Samples that were infinite or not a number, and count as black.
    #[must_use]
    pub fn not_finite(&self) -> u64 {
        let counts = self.rows.iter().map(|r| r.not_finite);
        counts.fold(0, u64::saturating_add)
    }

    /// Mean and variance of the mean, pixel by pixel; pixels without samples are black and of
    /// infinite variance.
    #[must_use]
    pub fn estimates(&self) -> (Vec<[f32; 3]>, Vec<[f32; 3]>) {
        let mut means = Vec::with_capacity(self.region.pixels());
        let mut variances = Vec::with_capacity(self.region.pixels());
        for row in &self.rows {
            for pixel in row.sums.chunks_exact(self.strands as usize) {
                let channels = [0, 1, 2]
                    .map(|c| estimate(row.count, self.strands, pixel.iter().map(|s| s[c])));
                means.push(channels.map(|(mean, _)| mean as f32));
                variances.push(channels.map(|(_, variance)| variance as f32));
            }
        }
        (means, variances)
    }

    /// The beauty, and the variance of its pixels in the layer `variance`.
    #[must_use]
    pub fn frame(&self, width: u32, height: u32) -> Frame {
        let (means, variances) = self.estimates();
        let mut frame = Frame::new(width, height, self.region);
        frame.layers.push(Layer::rgb("", &means));
        frame.layers.push(Layer::rgb("variance", &variances));
        frame
    }

    /// Writes all sums, to go on from.
    ///
    /// # Errors
    /// If the file cannot be written; one that is there stays as it was then.
    pub fn write(&self, path: &Path) -> Result<()> {
        let mut output = Output::create(path)?;
        samples::write(&mut output, &self.head(), &self.rows).map_err(|e| output.failed(&e))?;
        output.commit()
    }

    /// Reads what [`Sums::write`] wrote of sums like `like`: of the same region, strands and
    /// origin. `None` if there is no such file.
    ///
    /// # Errors
    /// [`crate::Kind::Input`] if the file is damaged or holds samples of something else; the
    /// message says of what.
    pub fn read(path: &Path, like: &Self) -> Result<Option<Self>> {
        let io_failed = |e: std::io::Error| Error::io("read", path, &e);
        let file = match File::open(path) {
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            other => other.map_err(io_failed)?,
        };
        let refused = |what: &str| {
            Error::input(format!("{} {what}", path.display())).hint(
                "choose another output, or begin anew with `overwrite`: \
                 the samples in that file are lost then",
            )
        };
        let failed = |e: Unreadable| match e {
            Unreadable::Io(e) => io_failed(e),
            other => refused(&other.to_string()),
        };
        let length = file.metadata().map_err(io_failed)?.len();
        let mut kept = Rows::open(BufReader::new(file), length).map_err(failed)?;
        if let Some(what_else) = like.what_else(kept.head()) {
            return Err(refused(&what_else));
        }
        let mut sums = Self::new(like.region, like.strands, like.origin.clone());
        for row in &mut sums.rows {
            *row = kept
                .next_row()
                .map_err(failed)?
                .ok_or_else(|| failed(Unreadable::Cut))?;
        }
        kept.finish().map_err(failed)?;
        Ok(Some(sums))
    }

    fn head(&self) -> Head {
        Head {
            strands: self.strands,
            region: self.region,
            origin: self.origin.clone(),
        }
    }

    /// What a file of this head keeps, if that is not samples of these sums.
    fn what_else(&self, there: &Head) -> Option<String> {
        let mut found = there.origin.differences(&self.origin);
        if there.region != self.region {
            let (there, here) = (there.region, self.region);
            found.push(format!("another region ({there}, here {here})"));
        }
        if there.strands != self.strands {
            found.push(format!("{} strands, here {}", there.strands, self.strands));
        }
        (!found.is_empty()).then(|| format!("keeps samples of {}", found.join(", ")))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::sampling;

    const REGION: Region = Region {
        x0: 3,
        y0: 5,
        x1: 7,
        y1: 8,
    };

    fn origin(max_depth: u32) -> Origin {
        Origin {
            code: "c".into(),
            scene: "s".into(),
            film: [20, 10],
            settings: [("max_depth".to_owned(), max_depth.into())].into(),
        }
    }

    #[test]
    fn the_variance_has_no_bias_for_any_count() {
        for count in [2_u32, 3, 4, 5, 7, 8, 30] {
            let trials = 20_000_u64;
            let (mut variance, mut squares) = (0.0, 0.0);
            for trial in 0..trials {
                let mut strands = [0.0; 4];
                for i in 0..count {
                    let u = sampling::unit(sampling::hash(&[trial, u64::from(i)]));
                    strands[(i % 4) as usize] += f64::from(u);
                }
                let (mean, v) = estimate(count, 4, strands.iter().copied());
                variance += v;
                squares += (mean - 0.5).powi(2);
            }
            let n = trials as f64;
            let truth = 1.0 / 12.0 / f64::from(count);
            assert!((squares / n / truth - 1.0).abs() < 0.05);
            assert!(
                (variance / n / truth - 1.0).abs() < 0.05,
                "{count}: {}",
                variance / n / truth
            );
        }
        assert_eq!(estimate(1, 4, [0.25].into_iter()), (0.25, f64::INFINITY));
        assert_eq!(estimate(0, 4, [0.0].into_iter()), (0.0, f64::INFINITY));
    }

    #[test]
    fn sums_survive_a_round_trip_and_do_not_mix() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.sums");
        let mut sums = Sums::new(REGION, 4, origin(1));
        assert!(Sums::read(&path, &sums).unwrap().is_none());
        sums.rows[1].count = 7;
        sums.rows[1].not_finite = 9;
        sums.rows[1].sums[5] = [0.1, 1e30, -2.0];
        sums.write(&path).unwrap();
        assert_eq!(Sums::read(&path, &sums).unwrap().unwrap(), sums);
        let other = Region { x0: 2, ..REGION };
        let change = |change: fn(&mut Origin)| {
            let mut other = origin(1);
            change(&mut other);
            Sums::new(REGION, 4, other)
        };
        for (like, part) in [
            (Sums::new(REGION, 4, origin(2)), "max_depth 1, here 2"),
            (Sums::new(other, 4, origin(1)), "here 2 5 7 8"),
            (Sums::new(REGION, 3, origin(1)), "4 strands, here 3"),
            (change(|o| o.scene.push('x')), "another scene"),
            (change(|o| o.code.push('x')), "other sources"),
            (change(|o| o.film[1] = 11), "20x10 pixels, here 20x11"),
        ] {
            let error = Sums::read(&path, &like).unwrap_err();
            assert_eq!(error.kind(), crate::Kind::Input);
            assert!(error.to_string().contains(part), "{error}");
            assert!(error.hint_text().unwrap().contains("`overwrite`"));
        }
    }

    #[test]
    fn damaged_files_are_refused() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.sums");
        let sums = Sums::new(REGION, 4, origin(1));
        sums.write(&path).unwrap();
        let whole = std::fs::read(&path).unwrap();
        for at in (0..whole.len()).step_by(7) {
            let mut bytes = whole.clone();
            bytes[at] ^= 4;
            std::fs::write(&path, &bytes).unwrap();
            assert!(Sums::read(&path, &sums).is_err(), "{at}");
            std::fs::write(&path, &whole[..at]).unwrap();
            assert!(Sums::read(&path, &sums).is_err(), "cut at {at}");
        }
    }
}

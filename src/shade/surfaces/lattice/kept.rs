//! Gathers of a frame's lattice that its tiles keep for each other, in a file.
//!
//! A tile gathers around its border, too, where its neighbours do. What is kept has all bits of
//! what is gathered, so that pictures are the same.

use super::LatticeSite;
use super::area::Area;
use crate::Result;
use crate::gather::Gathered;
use crate::image::Region;
use crate::math::{Rgb, sampling};
use crate::run::words::{AtomicLines, Line};
use glam::Vec3;
use std::path::Path;
use std::sync::atomic::Ordering;

/// Gathers by place of a frame's lattice.
#[derive(Debug)]
pub struct KeptGathers {
    /// One a place, then one a middle of a cell: two numbers in each word but the last, which says
    /// whether they belong together.
    lines: AtomicLines,
    /// All of the lattice.
    area: Area,
}

/// Words that hold numbers.
const WORDS: usize = 5;

impl KeptGathers {
    /// Gathers of a lattice over a film, so many pixels apart, in a file that processes share;
    /// `identity` says what they depend on.
    ///
    /// # Errors
    /// As [`AtomicLines::in_file`].
    pub fn in_file(path: &Path, identity: [u8; 32], film: [u32; 2], step: u32) -> Result<Self> {
        let area = Area::around(Region::full(film[0], film[1]), step, 0, film);
        let lines = AtomicLines::in_file(path, identity, 2 * area.len())?;
        Ok(Self { lines, area })
    }

    /// The line of a place, and its number.
    fn line(&self, at: [u32; 2], site: LatticeSite) -> Option<(&Line, u64)> {
        let place = self.area.index(at)?;
        let index = match site {
            LatticeSite::Place => place,
            LatticeSite::Middle => self.area.len() + place,
        };
        Some((self.lines.lines().get(index)?, index as u64))
    }

    /// What was gathered at a place, if it is there and whole.
    pub(super) fn get(&self, at: [u32; 2], site: LatticeSite) -> Option<Gathered> {
        let (line, index) = self.line(at, site)?;
        let words: [u64; WORDS] = std::array::from_fn(|i| line[i].load(Ordering::Relaxed));
        (line[WORDS].load(Ordering::Relaxed) == seal(words, index)).then(|| unpack(words))
    }

    /// Keeps what was gathered at a place.
    pub(super) fn put(&self, at: [u32; 2], site: LatticeSite, gathered: &Gathered) {
        if let Some((line, index)) = self.line(at, site) {
            let words = pack(gathered);
            for (to, word) in line.iter().zip(words) {
                to.store(word, Ordering::Relaxed);
            }
            line[WORDS].store(seal(words, index), Ordering::Relaxed);
        }
    }
}

/// What says that the words of a place belong together: never that of zeros, which a new file has.
fn seal([a, b, c, d, e]: [u64; WORDS], index: u64) -> u64 {
    sampling::hash(&[index, a, b, c, d, e]) | 1
}

fn pack(gathered: &Gathered) -> [u64; WORDS] {
    let [r, g, b] = gathered.light.0;
    let [x, y, z] = gathered.environment.0;
    let pair = |a: f32, b: f32| u64::from(a.to_bits()) << 32 | u64::from(b.to_bits());
    let distance = gathered.harmonic_distance;
    let near = gathered.toward;
    let [near_to, last] = [pair(distance, near.x), pair(near.y, near.z)];
    [pair(r, g), pair(b, x), pair(y, z), near_to, last]
}

fn unpack(words: [u64; WORDS]) -> Gathered {
    let [[r, g], [b, x], [y, z], [distance, near_x], [near_y, near_z]] =
        words.map(|w| [w >> 32, w].map(|half| f32::from_bits(half as u32)));
    Gathered {
        light: Rgb([r, g, b]),
        environment: Rgb([x, y, z]),
        harmonic_distance: distance,
        toward: Vec3::new(near_x, near_y, near_z),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_and_middles_keep_their_own_to_the_bit_and_nothing_damaged() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.gathers");
        let open = || KeptGathers::in_file(&path, [3; 32], [50, 31], 4).unwrap();
        let (one, two) = (open(), open());
        let gathered = |n: u32| Gathered {
            light: Rgb([1.0 / n as f32, f32::from_bits(n), 1e30]),
            environment: Rgb([0.0, 1.0 / 3.0, n as f32]),
            harmonic_distance: 1.0 / (n as f32 + 0.1),
            toward: Vec3::new(0.1, n as f32, 0.3),
        };
        let sites = [LatticeSite::Place, LatticeSite::Middle];
        let all = || {
            let places = one.area.places();
            places
                .flat_map(|at| sites.map(|site| (at, site)))
                .zip(1_u32..)
        };
        for ((at, site), n) in all() {
            assert!(two.get(at, site).is_none(), "{at:?} {site:?}");
            one.put(at, site, &gathered(n));
        }
        for ((at, site), n) in all() {
            assert_eq!(two.get(at, site), Some(gathered(n)), "{at:?} {site:?}");
        }
        // A new line of zeros is none, whatever its number.
        assert!((0..1000).all(|i| seal([0; WORDS], i) != 0));
        let (line, _) = one.line([2, 3], LatticeSite::Place).unwrap();
        line[1].fetch_xor(1 << 40, Ordering::Relaxed);
        assert!(two.get([2, 3], LatticeSite::Place).is_none());
        assert!(two.get([99, 3], LatticeSite::Place).is_none());
        two.put([99, 3], LatticeSite::Place, &gathered(1));
    }
}

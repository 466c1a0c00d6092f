//! Emission and absorption along a ray, front to back.

use super::{Rgb, Spectrum};
use std::cmp::Reverse;
use std::collections::{BTreeSet, BinaryHeap};

/// A part of a ray inside one medium, of constant extinction and source function.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Segment<K = f32> {
    /// Where it begins, scene units along the ray.
    pub near: f32,
    /// Where it ends, scene units along the ray; not before `near`.
    pub far: f32,
    /// Optical depth from `near` to `far`.
    pub tau: K,
    /// Source function: radiance per unit optical depth.
    pub source: Rgb,
}

/// Light gathered so far along a ray, and what share of the light from further on still comes
/// through.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Composite<K = f32> {
    /// Radiance that arrives at the ray's origin.
    pub radiance: Rgb,
    /// Share of the light from further on that comes through, 0 to 1.
    pub transmittance: K,
}

impl<K: Spectrum> Default for Composite<K> {
    fn default() -> Self {
        Self {
            radiance: Rgb::BLACK,
            transmittance: K::splat(1.0),
        }
    }
}

impl<K: Spectrum> Composite<K> {
    /// Below this transmittance what follows is left out: it could add no more than this share of
    /// its radiance.
    pub const OPAQUE: f32 = 1e-4;
    /// Below this transmittance no light that a scene may hold comes through.
    pub const NOTHING: f32 = 1e-30;

    /// Passes a medium of optical depth `tau` and source function `source`: scatter-out and
    /// scatter-in with the same tau, so that energy is conserved whatever its size.
    #[inline]
    pub fn medium(&mut self, tau: K, source: Rgb) {
        let (through, taken) = tau.exp_neg_and_rest();
        self.radiance += self.transmittance.times(taken).filter(source);
        self.transmittance = self.transmittance.times(through);
    }

    /// Passes a surface that covers `opacity` of the ray's footprint and sends `radiance` back.
    #[inline]
    pub fn surface(&mut self, opacity: f32, radiance: Rgb) {
        self.radiance += (self.transmittance * opacity).filter(radiance);
        self.transmittance = self.transmittance * (1.0 - opacity);
    }

    /// Whether anything further on still matters.
    #[must_use]
    #[inline]
    pub fn is_opaque(&self) -> bool {
        self.transmittance.most() < Self::OPAQUE
    }
}

/// A part of a ray in one medium, before its source function is known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Interval<T, K = f32> {
    /// Where it begins, scene units along the ray.
    pub near: f32,
    /// Where it ends, scene units along the ray; not before `near`.
    pub far: f32,
    /// Optical depth from `near` to `far`.
    pub tau: K,
    /// The value that tells its source function.
    pub of: T,
}

/// A walk through one medium and the interval that it has come to, with the source function once
/// that is known.
struct Head<T, K, W> {
    walk: W,
    stretch: Option<(Interval<T, K>, Option<Rgb>)>,
}

impl<T, K: Spectrum, W: Iterator<Item = Interval<T, K>>> Head<T, K, W> {
    /// Goes on to the first stretch that ends behind `at`.
    fn advance(&mut self, at: f32) {
        while self.stretch.as_ref().is_none_or(|(s, _)| s.far <= at) {
            let next = self.walk.find(|s| s.far > s.near && s.tau.most() > 0.0);
            self.stretch = next.map(|s| (s, None));
            if self.stretch.is_none() {
                return;
            }
        }
    }
}

/// Walks up to which each cut looks at all of them.
const MAX_FEW_WALKS: usize = 16;

/// Merges walks of one ray through media that may overlap, each front to back: what comes out is in
/// order and cut at the ends of all, so that it does not overlap. There depths add and sources are
/// weighted by depth. Walks are taken no further than `emit` lets them, and `source` is asked once
/// for each stretch that is reached. Returns whether `emit` always said yes.
pub fn flatten_overlaps<T: Copy, K: Spectrum>(
    walks: impl IntoIterator<Item: Iterator<Item = Interval<T, K>>>,
    source: impl Fn(T) -> Rgb,
    emit: impl FnMut(Segment<K>) -> bool,
) -> bool {
    let mut heads: Vec<_> = walks
        .into_iter()
        .map(|walk| Head {
            walk,
            stretch: None,
        })
        .collect();
    if heads.len() > MAX_FEW_WALKS {
        flatten_many(heads, source, emit)
    } else {
        flatten_few(&mut heads, source, emit)
    }
}

/// As [`flatten_overlaps`], looking at all walks at each cut.
fn flatten_few<T: Copy, K: Spectrum, W: Iterator<Item = Interval<T, K>>>(
    heads: &mut Vec<Head<T, K, W>>,
    source: impl Fn(T) -> Rgb,
    mut emit: impl FnMut(Segment<K>) -> bool,
) -> bool {
    let mut at = f32::NEG_INFINITY;
    loop {
        heads.iter_mut().for_each(|h| h.advance(at));
        heads.retain(|h| h.stretch.is_some());
        let stretches = || heads.iter().filter_map(|h| h.stretch.as_ref());
        let first = stretches()
            .map(|(s, _)| s.near)
            .fold(f32::INFINITY, f32::min);
        if heads.is_empty() {
            return true;
        }
        at = at.max(first);
        let end = stretches()
            .map(|(s, _)| if s.near > at { s.near } else { s.far })
            .fold(f32::INFINITY, f32::min);
        let (mut tau, mut sum) = (K::default(), Rgb::BLACK);
        for (s, sent) in heads.iter_mut().filter_map(|h| h.stretch.as_mut()) {
            if s.near <= at {
                let part = s.tau * ((end - at) / (s.far - s.near));
                tau += part;
                sum += part.filter(*sent.get_or_insert_with(|| source(s.of)));
            }
        }
        let out = Segment {
            near: at,
            far: end,
            tau,
            source: match tau.most() > 0.0 {
                true => K::splat(1.0).over(tau).filter(sum),
                false => sum,
            },
        };
        if !emit(out) {
            return false;
        }
        at = end;
    }
}

/// Where the stretch of a walk begins or ends; ends before beginnings at the same place.
#[derive(PartialEq, Eq, PartialOrd, Ord)]
struct Cut {
    /// Bits of a distance, in the order of distances.
    at: u32,
    is_start: bool,
    walk: u32,
}

impl Cut {
    fn new(at: f32, is_start: bool, walk: usize) -> Reverse<Self> {
        let bits = at.to_bits();
        let sign = 1 << 31;
        Reverse(Self {
            at: if bits & sign == 0 { bits | sign } else { !bits },
            is_start,
            walk: walk as u32,
        })
    }
}

/// What is in a stretch: extinction, and source function times that.
#[derive(Clone, Copy, Default)]
struct Density {
    sigma_t: [f64; 3],
    source: [f64; 3],
}

impl Density {
    fn add(&mut self, other: Self, sign: f64) {
        for c in 0..3 {
            self.sigma_t[c] += sign * other.sigma_t[c];
            self.source[c] += sign * other.source[c];
        }
    }
}

/// As [`flatten_overlaps`], from cut to cut: each costs the logarithm of the number of walks.
fn flatten_many<T: Copy, K: Spectrum, W: Iterator<Item = Interval<T, K>>>(
    mut heads: Vec<Head<T, K, W>>,
    source: impl Fn(T) -> Rgb,
    mut emit: impl FnMut(Segment<K>) -> bool,
) -> bool {
    let mut cuts = BinaryHeap::with_capacity(heads.len());
    let mut densities = vec![Density::default(); heads.len()];
    for (i, head) in heads.iter_mut().enumerate() {
        head.advance(f32::NEG_INFINITY);
        cuts.extend(
            head.stretch
                .as_ref()
                .map(|(s, _)| Cut::new(s.near, true, i)),
        );
    }
    // Walks that are in a stretch.
    let mut inside = BTreeSet::new();
    let mut sum = Density::default();
    let mut at = f32::NEG_INFINITY;
    while let Some(Reverse(Cut { is_start, walk, .. })) = cuts.pop() {
        let i = walk as usize;
        let Some((stretch, _)) = &heads[i].stretch else {
            continue;
        };
        let (next, stretch) = match is_start {
            true => (stretch.near.max(at), *stretch),
            false => (stretch.far, *stretch),
        };
        if !inside.is_empty() && next > at {
            if inside.len() <= MAX_FEW_WALKS {
                // Nothing is left of the rounding of what was larger.
                sum = Density::default();
                inside
                    .iter()
                    .for_each(|&i: &usize| sum.add(densities[i], 1.0));
            }
            let out = Segment {
                near: at,
                far: next,
                tau: K::of_channels(sum.sigma_t.map(|s| (s * f64::from(next - at)) as f32)),
                source: Rgb(std::array::from_fn(|c| {
                    (sum.source[c] / sum.sigma_t[c]).max(0.0) as f32
                })),
            };
            if !emit(out) {
                return false;
            }
        }
        at = at.max(next);
        if is_start {
            let length = f64::from(stretch.far - stretch.near);
            let sigma_t = stretch.tau.channels().map(|t| f64::from(t) / length);
            let sent = source(stretch.of).0;
            densities[i] = Density {
                sigma_t,
                source: std::array::from_fn(|c| sigma_t[c] * f64::from(sent[c])),
            };
            sum.add(densities[i], 1.0);
            inside.insert(i);
            cuts.push(Cut::new(stretch.far, false, i));
        } else {
            sum.add(densities[i], -1.0);
            inside.remove(&i);
            let head = &mut heads[i];
            head.advance(stretch.far);
            cuts.extend(
                head.stretch
                    .as_ref()
                    .map(|(s, _)| Cut::new(s.near, true, i)),
            );
        }
    }
    true
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stretch(near: f32, far: f32, tau: f32, s: f32) -> Interval<f32> {
        Interval {
            near,
            far,
            tau,
            of: s,
        }
    }

    #[test]
    fn overlapping_media_add_up() {
        let seg = |near, far, tau, s| Segment {
            near,
            far,
            tau,
            source: Rgb::splat(s),
        };
        let walks = [
            vec![stretch(2.0, 6.0, 4.0, 1.0), stretch(9.0, 9.0, 5.0, 1.0)],
            vec![stretch(0.0, 4.0, 8.0, 3.0), stretch(8.0, 9.0, 1.0, 2.0)],
        ];
        let mut out = Vec::new();
        let walks = walks.into_iter().map(Vec::into_iter);
        assert!(flatten_overlaps(walks, Rgb::splat, |s| {
            out.push(s);
            true
        }));
        let expected = [
            seg(0.0, 2.0, 4.0, 3.0),
            seg(2.0, 4.0, 6.0, (2.0 + 4.0 * 3.0) / 6.0),
            seg(4.0, 6.0, 2.0, 1.0),
            seg(8.0, 9.0, 1.0, 2.0),
        ];
        assert_eq!(out.len(), 4);
        for (o, e) in out.iter().zip(&expected) {
            assert!(
                (o.near - e.near).abs() + (o.far - e.far).abs() + (o.tau - e.tau).abs() < 1e-5,
                "{o:?}"
            );
            assert!((o.source.0[0] - e.source.0[0]).abs() < 1e-5);
        }
    }

    #[test]
    fn many_walks_are_merged_as_few_are() {
        use crate::math::sampling::{hash, unit};
        for count in [1, 3, 40] {
            let walks = |_| {
                (0..count).map(|w: u64| {
                    let number = move |i: u64, k: u64| unit(hash(&[w, i, k]));
                    // With gaps and without, thin and dense, and some that share their ends.
                    let mut at = if w.is_multiple_of(5) {
                        1.0
                    } else {
                        number(0, 0)
                    };
                    (1..60_u64).map(move |i| {
                        let near = if i.is_multiple_of(3) {
                            at
                        } else {
                            at + 0.1 * number(i, 1)
                        };
                        let far = near
                            + if w.is_multiple_of(7) {
                                0.125
                            } else {
                                number(i, 2)
                            };
                        at = far;
                        let tau = libm::expf(20.0 * number(i, 3) - 15.0);
                        stretch(near, far, tau, number(i, 4))
                    })
                })
            };
            let heads = || -> Vec<_> {
                let head = |walk| Head {
                    walk,
                    stretch: None,
                };
                walks(()).map(head).collect()
            };
            let (mut few, mut many) = (Vec::new(), Vec::new());
            assert!(flatten_few(&mut heads(), Rgb::splat, |s| {
                few.push(s);
                true
            }));
            assert!(flatten_many(heads(), Rgb::splat, |s| {
                many.push(s);
                true
            }));
            // The first gives stretches of nothing between others, too.
            few.retain(|s| s.tau > 0.0);
            assert_eq!(few.len(), many.len());
            for (a, b) in few.iter().zip(&many) {
                assert_eq!((a.near, a.far), (b.near, b.far));
                assert!((a.tau - b.tau).abs() <= 1e-5 * a.tau, "{a:?} {b:?}");
                let apart = (a.source.0[0] - b.source.0[0]).abs();
                assert!(apart <= 1e-5 * a.source.0[0] + 1e-6, "{a:?} {b:?}");
            }
        }
    }

    #[test]
    fn what_is_not_reached_is_neither_walked_nor_lit() {
        use std::cell::Cell;
        let (walked, lit) = (Cell::new(0), Cell::new(0));
        let walks = [0.0, 0.5].map(|from| {
            let walked = &walked;
            (0..1000).map(move |i| {
                walked.set(walked.get() + 1);
                stretch(from + i as f32, from + i as f32 + 1.0, 1.0, 1.0)
            })
        });
        let source = |s| {
            lit.set(lit.get() + 1);
            Rgb::splat(s)
        };
        let mut left = 5;
        let complete = flatten_overlaps(walks, source, |_| {
            left -= 1;
            left > 0
        });
        assert!(!complete);
        assert!(walked.get() <= 6 && lit.get() <= 6, "{walked:?} {lit:?}");
    }

    #[test]
    fn halving_a_segment_changes_nothing() {
        let mut whole = Composite::default();
        whole.medium(3.0, Rgb::splat(2.0));
        let mut halves = Composite::default();
        halves.medium(1.5, Rgb::splat(2.0));
        halves.medium(1.5, Rgb::splat(2.0));
        assert!((whole.radiance.0[0] - halves.radiance.0[0]).abs() < 1e-6);
        assert!((whole.transmittance - halves.transmittance).abs() < 1e-7);
    }
}

//! Emission and absorption along a ray, front to back.

use super::Rgb;
use super::exp::exp_neg_and_rest;

/// A stretch of a ray inside one medium, of constant extinction and source function.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Segment {
    /// Where it begins, scene units along the ray.
    pub near: f32,
    /// Where it ends.
    pub far: f32,
    /// Optical depth from `near` to `far`.
    pub tau: f32,
    /// Source function: radiance per unit optical depth.
    pub source: Rgb,
}

/// Light gathered so far along a ray, and what share of the light from further on still comes through.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Composite {
    /// Radiance.
    pub radiance: Rgb,
    /// Transmittance.
    pub transmittance: f32,
}

impl Default for Composite {
    fn default() -> Self {
        Self {
            radiance: Rgb::BLACK,
            transmittance: 1.0,
        }
    }
}

impl Composite {
    /// Below this transmittance what follows is left out: it could add no more than this share of its radiance.
    pub const OPAQUE: f32 = 1e-4;
    /// Below this transmittance no light that a scene may hold comes through.
    pub const NOTHING: f32 = 1e-30;

    /// Passes a medium of optical depth `tau` and source function `source`: scatter-out and scatter-in with the same
    /// tau, so that energy is conserved whatever its size.
    #[inline]
    pub fn medium(&mut self, tau: f32, source: Rgb) {
        let (through, taken) = exp_neg_and_rest(tau);
        self.radiance += source * (self.transmittance * taken);
        self.transmittance *= through;
    }

    /// Passes a surface that covers `opacity` of the ray's footprint and sends `radiance` back.
    #[inline]
    pub fn surface(&mut self, opacity: f32, radiance: Rgb) {
        self.radiance += radiance * (self.transmittance * opacity);
        self.transmittance *= 1.0 - opacity;
    }

    /// Whether anything further on still matters.
    #[must_use]
    #[inline]
    pub fn is_opaque(&self) -> bool {
        self.transmittance < Self::OPAQUE
    }
}

/// Cuts segments of overlapping media at each other's ends, so that what comes out is in order and does not overlap:
/// where media overlap, depths add and sources are weighted by depth.
pub fn flatten_overlaps(segments: &mut Vec<Segment>, mut emit: impl FnMut(Segment) -> bool) {
    segments.retain(|s| s.far > s.near && s.tau > 0.0);
    segments.sort_by(|a, b| a.near.total_cmp(&b.near));
    let mut active: Vec<Segment> = Vec::with_capacity(8);
    let mut next = 0;
    let mut at = f32::NEG_INFINITY;
    loop {
        active.retain(|s| s.far > at);
        if active.is_empty() {
            match segments.get(next) {
                None => return,
                Some(s) => at = s.near,
            }
        }
        while let Some(s) = segments.get(next).filter(|s| s.near <= at) {
            active.push(*s);
            next += 1;
        }
        let end = active.iter().map(|s| s.far).fold(f32::INFINITY, f32::min);
        let end = segments.get(next).map_or(end, |s| end.min(s.near));
        let (mut tau, mut source) = (0.0, Rgb::BLACK);
        for s in &active {
            let part = s.tau * ((end - at) / (s.far - s.near));
            tau += part;
            source += s.source * part;
        }
        let out = Segment {
            near: at,
            far: end,
            tau,
            source: if tau > 0.0 {
                source * (1.0 / tau)
            } else {
                source
            },
        };
        if !emit(out) {
            return;
        }
        at = end;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn overlapping_media_add_up() {
        let seg = |near, far, tau, s| Segment {
            near,
            far,
            tau,
            source: Rgb::splat(s),
        };
        let mut list = vec![
            seg(2.0, 6.0, 4.0, 1.0),
            seg(0.0, 4.0, 8.0, 3.0),
            seg(9.0, 9.0, 5.0, 1.0),
        ];
        let mut out = Vec::new();
        flatten_overlaps(&mut list, |s| {
            out.push(s);
            true
        });
        let expected = [
            seg(0.0, 2.0, 4.0, 3.0),
            seg(2.0, 4.0, 6.0, (2.0 + 4.0 * 3.0) / 6.0),
            seg(4.0, 6.0, 2.0, 1.0),
        ];
        assert_eq!(out.len(), 3);
        for (o, e) in out.iter().zip(&expected) {
            assert!(
                (o.near - e.near).abs() + (o.far - e.far).abs() + (o.tau - e.tau).abs() < 1e-5,
                "{o:?}"
            );
            assert!((o.source.0[0] - e.source.0[0]).abs() < 1e-5);
        }
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

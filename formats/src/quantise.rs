//! How values become fewer bits and back. `SPEC.md` states each rule and its bound; the decoders
//! use only exact or correctly rounded operations, so that every machine decodes the same numbers.
//! Encoders take sines and the like from `libm`, for the same reason.

use crate::record::{ClipEdge, Clips, tangent_frame};
use crate::{FormatError, Result};
use std::f64::consts::TAU;

/// Largest value of one component of an encoded normal.
pub const NORMAL_MAX: u16 = 65534;
const NORMAL_ZERO: i32 = 32767;

/// Octahedral map of a direction to two 16-bit numbers. The axes are exact; the worst error is
/// below 0.005 degree.
#[must_use]
pub fn encode_normal(n: [f32; 3]) -> [u16; 2] {
    let [x, y, z] = n.map(f64::from);
    let sum = x.abs() + y.abs() + z.abs();
    if !(sum > 0.0 && sum.is_finite()) {
        return [NORMAL_ZERO as u16; 2];
    }
    let sign = |v: f64| if v < 0.0 { -1.0 } else { 1.0 };
    let (mut u, mut v) = (x / sum, y / sum);
    if z < 0.0 {
        (u, v) = ((1.0 - v.abs()) * sign(u), (1.0 - u.abs()) * sign(v));
    }
    let mut code = [u, v].map(|c| (c * f64::from(NORMAL_ZERO)).round() as i32);
    // On the border of the map two codes mean the same direction: one of them is chosen.
    let fold = code[0].abs() + code[1].abs() - NORMAL_ZERO;
    for c in &mut code {
        if fold > 0 && c.abs() == fold {
            *c = fold;
        }
    }
    code.map(|c| (c + NORMAL_ZERO) as u16)
}

/// The unit normal of a code; components above [`NORMAL_MAX`] are taken as that.
#[must_use]
pub fn decode_normal(code: [u16; 2]) -> [f32; 3] {
    // In integers up to the division, so that the fold is exact and encoding again gives the same
    // code.
    let [u, v] = code.map(|c| i32::from(c.min(NORMAL_MAX)) - NORMAL_ZERO);
    let z = NORMAL_ZERO - u.abs() - v.abs();
    let fold = (-z).max(0);
    let toward_zero = |c: i32| if c < 0 { c + fold } else { c - fold };
    let [x, y, z] = [toward_zero(u), toward_zero(v), z].map(f64::from);
    let scale = 1.0 / (x * x + y * y + z * z).sqrt();
    [x * scale, y * scale, z * scale].map(|c| c as f32)
}

/// A line `steps` wide from `min` to `max`, cut into 65535 equal steps.
#[derive(Clone, Copy, Debug)]
pub struct Span {
    min: f32,
    max: f32,
    step: f64,
}

impl Span {
    /// Both ends must be finite and in order.
    #[must_use]
    pub fn new(min: f32, max: f32) -> Self {
        Self {
            min,
            max,
            step: (f64::from(max) - f64::from(min)) / 65535.0,
        }
    }

    /// Length of a step.
    #[must_use]
    pub fn step(&self) -> f64 {
        self.step
    }

    /// The value of a code; the ends are exact.
    #[must_use]
    pub fn decode(&self, code: u16) -> f32 {
        if code == u16::MAX {
            self.max
        } else {
            (f64::from(self.min) + f64::from(code) * self.step) as f32
        }
    }

    fn position(&self, value: f32) -> f64 {
        if self.step > 0.0 {
            (f64::from(value) - f64::from(self.min)) / self.step
        } else {
            0.0
        }
    }

    /// The code whose decoded value is nearest.
    #[must_use]
    pub fn nearest(&self, value: f32) -> u16 {
        self.position(value).round() as u16
    }

    /// The largest code whose value is not above `value`, or 0.
    #[must_use]
    pub fn below(&self, value: f32) -> u16 {
        let mut code = self.position(value).floor() as u16;
        while code > 0 && self.decode(code) > value {
            code -= 1;
        }
        code
    }

    /// The smallest code whose value is not below `value`, or 65535.
    #[must_use]
    pub fn above(&self, value: f32) -> u16 {
        let mut code = self.position(value).ceil() as u16;
        while code < u16::MAX && self.decode(code) < value {
            code += 1;
        }
        code
    }
}

/// Positive numbers as 16-bit steps in the bit patterns of f32, which are nearly logarithmic: code
/// c stands for the f32 whose bits are `base + (c << shift)`. Equal values, and narrow ranges, are
/// exact.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Steps {
    /// Bits of the smallest value.
    pub base: u32,
    /// Log2 of the step, at most [`Steps::MAX_SHIFT`].
    pub shift: u8,
}

impl Steps {
    /// Coarser steps would break the bound: relative error at most 2^-11.
    pub const MAX_SHIFT: u8 = 13;

    /// Steps that cover all values; `None` if a value is not a positive normal number, or the range
    /// is too great.
    #[must_use]
    pub fn fit(values: impl Iterator<Item = f32>) -> Option<Self> {
        let (mut min, mut max) = (f32::INFINITY, 0.0f32);
        for value in values {
            if !(value.is_normal() && value > 0.0) {
                return None;
            }
            min = min.min(value);
            max = max.max(value);
        }
        if max == 0.0 {
            return Some(Self { base: 0, shift: 0 });
        }
        let range = max.to_bits() - min.to_bits();
        (0..=Self::MAX_SHIFT)
            .find(|shift| range >> shift < 65535)
            .map(|shift| Self {
                base: min.to_bits(),
                shift,
            })
    }

    /// The code whose decoded value is nearest.
    #[must_use]
    pub fn encode(&self, value: f32) -> u16 {
        let above = value.to_bits().saturating_sub(self.base);
        let half = (1u32 << self.shift) >> 1;
        ((above + half) >> self.shift).min(65535) as u16
    }

    /// The value of a code; not finite if `base` is hostile.
    #[must_use]
    pub fn decode(&self, code: u16) -> f32 {
        f32::from_bits(
            self.base
                .saturating_add(u32::from(code) << self.shift.min(Self::MAX_SHIFT)),
        )
    }
}

/// Colours with three 9-bit mantissas and a shared 5-bit exponent above a base: `m * 2^(e + base)`.
/// The error of a channel is at most 2^-9 of the largest channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SharedExponent {
    /// Exponent of code 0.
    pub base: i16,
}

/// Exponent x such that `value` is in [256, 512) times 2^x.
fn exponent(value: f32) -> i16 {
    ((value.to_bits() >> 23) as i16) - 127 - 8
}

fn power_of_two(exponent: i16) -> f64 {
    f64::from_bits(((i64::from(exponent) + 1023) as u64) << 52)
}

impl SharedExponent {
    /// Bases that a reader accepts.
    pub const BASES: std::ops::RangeInclusive<i16> = -166..=88;

    /// The coding with a base that was read.
    ///
    /// # Errors
    /// [`FormatError::Invalid`] for a base outside [`Self::BASES`].
    pub fn checked(base: i16) -> Result<Self> {
        if Self::BASES.contains(&base) {
            return Ok(Self { base });
        }
        Err(FormatError::invalid(
            "exponent of the page",
            format!("{:?}", Self::BASES),
            base,
        ))
    }

    /// A base that serves all colours; `None` if they span more than 32 octaves or are subnormal.
    #[must_use]
    pub fn fit(colours: impl Iterator<Item = [f32; 3]>) -> Option<Self> {
        let (mut min, mut max) = (f32::INFINITY, 0.0f32);
        for colour in colours {
            let value = colour[0].max(colour[1]).max(colour[2]);
            if value == 0.0 {
                continue;
            }
            if !value.is_normal() {
                return None;
            }
            min = min.min(value);
            max = max.max(value);
        }
        if max == 0.0 {
            return Some(Self { base: 0 });
        }
        let base = exponent(max) - 31;
        (Self::BASES.contains(&base) && exponent(min) >= base).then_some(Self { base })
    }

    /// Packs a colour: exponent in the top five bits, then blue, green, red.
    #[must_use]
    pub fn encode(&self, colour: [f32; 3]) -> u32 {
        let value = colour[0].max(colour[1]).max(colour[2]);
        if value <= 0.0 {
            return 0;
        }
        let e = exponent(value).max(self.base);
        let scale = power_of_two(-e);
        // What would round up to 512 becomes 511: less of an error than twice the step for all
        // channels.
        let [r, g, b] = colour.map(|c| ((f64::from(c) * scale).round() as u32).min(511));
        r | g << 9 | b << 18 | ((e - self.base) as u32).min(31) << 27
    }

    /// The inverse of [`Self::encode`].
    #[must_use]
    pub fn decode(&self, code: u32) -> [f32; 3] {
        let scale = power_of_two((code >> 27) as i16 + self.base);
        [code, code >> 9, code >> 18].map(|m| (f64::from(m & 511) * scale) as f32)
    }

    /// One channel for all three: 9-bit mantissa, exponent above it.
    #[must_use]
    pub fn encode_grey(&self, value: f32) -> u16 {
        let code = self.encode([value; 3]);
        (code & 511) as u16 | ((code >> 27) << 9) as u16
    }

    /// The inverse of [`Self::encode_grey`].
    #[must_use]
    pub fn decode_grey(&self, code: u16) -> [f32; 3] {
        let scale = power_of_two((code >> 9 & 31) as i16 + self.base);
        [(f64::from(code & 511) * scale) as f32; 3]
    }
}

/// The area that a surfel stands for, from its radius: `pi (r / k)^2`.
#[must_use]
pub fn area_of_disk(radius: f32, overlap: f32) -> f32 {
    let r = f64::from(radius) / f64::from(overlap);
    (std::f64::consts::PI * r * r) as f32
}

/// Whether `area` is what [`area_of_disk`] gives, but for rounding.
#[must_use]
pub fn is_area_of_disk(area: f32, radius: f32, overlap: f32) -> bool {
    overlap > 0.0 && area.is_normal() && {
        let derived = f64::from(area_of_disk(radius, overlap));
        (derived - f64::from(area)).abs() <= 1e-6 * f64::from(area)
    }
}

const OFFSET_STEPS: f64 = 255.0;

/// The bytes of a clip edge: direction in 256ths of a turn, offset in 255ths of the radius.
///
/// The disk that is left contains the one that was meant: the offset is widened by what the
/// direction's rounding would cut away (at most 1.7 % of the radius, with its own rounding). Codes
/// of decoded edges are stable.
#[must_use]
pub fn encode_edge(edge: ClipEdge, given_normal: [f32; 3], decoded_normal: [f32; 3]) -> [u8; 2] {
    let mut angle = f64::from(edge.angle);
    if given_normal != decoded_normal {
        // The frame may jump where the normal crosses the equator, so the line is carried over in
        // space.
        let (t, b) = tangent_frame(given_normal);
        let (sin, cos) = libm::sincos(angle);
        let d: [f64; 3] = std::array::from_fn(|i| cos * f64::from(t[i]) + sin * f64::from(b[i]));
        let (t, b) = tangent_frame(decoded_normal);
        let dot = |a: [f32; 3]| (0..3).map(|i| f64::from(a[i]) * d[i]).sum::<f64>();
        angle = libm::atan2(dot(b), dot(t));
    }
    let turns = (angle / TAU).rem_euclid(1.0) * 256.0;
    let code = turns.round();
    let off_by = (turns - code).abs() * TAU / 256.0;
    let line = libm::acos(f64::from(edge.offset).clamp(0.0, 1.0));
    let offset = libm::cos((line - off_by).max(0.0));
    // The slack keeps an edge that was decoded from these bytes where it is.
    let offset = (offset * OFFSET_STEPS - 1e-3)
        .ceil()
        .clamp(0.0, OFFSET_STEPS);
    [(code as u32 & 255) as u8, offset as u8]
}

/// The inverse of [`encode_edge`], in the frame of the decoded normal.
#[must_use]
pub fn decode_edge(code: [u8; 2]) -> ClipEdge {
    ClipEdge {
        angle: (f64::from(code[0]) * (TAU / 256.0)) as f32,
        offset: (f64::from(code[1]) / OFFSET_STEPS) as f32,
    }
}

/// Decodes up to three edges.
#[must_use]
pub fn decode_clips(codes: &[[u8; 2]]) -> Clips {
    let mut clips = Clips::default();
    for (edge, code) in clips.edges.iter_mut().zip(codes) {
        *edge = decode_edge(*code);
        clips.count += 1;
    }
    clips
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn unit(x: f32, y: f32, z: f32) -> Option<[f32; 3]> {
        let n = [x, y, z].map(f64::from);
        let len = n.iter().map(|c| c * c).sum::<f64>().sqrt();
        (len > 1e-3).then(|| n.map(|c| (c / len) as f32))
    }

    fn degrees_between(a: [f32; 3], b: [f32; 3]) -> f64 {
        let d = (0..3)
            .map(|i| (f64::from(a[i]) - f64::from(b[i])).powi(2))
            .sum::<f64>();
        (d.sqrt() / 2.0).asin().to_degrees() * 2.0
    }

    #[test]
    fn axes_are_exact() {
        for axis in 0..3 {
            for sign in [1.0, -1.0] {
                let mut n = [0.0; 3];
                n[axis] = sign;
                assert_eq!(decode_normal(encode_normal(n)), n);
            }
        }
    }

    #[test]
    fn decoded_normals_are_part_of_the_format() {
        assert_eq!(decode_normal([32767, 32767]), [0.0, 0.0, 1.0]);
        assert_eq!(decode_normal([65534, 32767]), [1.0, 0.0, 0.0]);
        assert_eq!(decode_normal([32767, 0]), [0.0, -1.0, 0.0]);
        assert_eq!(decode_normal([65534, 65534]), [0.0, 0.0, -1.0]);
    }

    proptest! {
        #![proptest_config(ProptestConfig {
            failure_persistence: None,
            ..ProptestConfig::with_cases(2000)
        })]

        #[test]
        fn normals(x in -1f32..1.0, y in -1f32..1.0, z in -1f32..1.0, flat in 0..4) {
            let z = if flat == 0 { z * 1e-6 } else { z };
            let Some(n) = unit(x, y, z) else { return Ok(()) };
            let code = encode_normal(n);
            let decoded = decode_normal(code);
            prop_assert!(degrees_between(n, decoded) < 0.005);
            prop_assert_eq!(encode_normal(decoded), code);
        }

        #[test]
        fn any_code_decodes_to_a_stable_unit_normal(u: u16, v: u16) {
            let n = decode_normal([u, v]);
            let len = n.iter().map(|c| f64::from(*c).powi(2)).sum::<f64>();
            prop_assert!((len - 1.0).abs() < 1e-6);
            prop_assert_eq!(decode_normal(encode_normal(n)), n);
        }

        #[test]
        fn spans(a in -1e6f32..1e6, b in -1e6f32..1e6, t in 0f32..=1.0) {
            let (min, max) = (a.min(b), a.max(b));
            let span = Span::new(min, max);
            let value = (min + t * (max - min)).clamp(min, max);
            let ulp = f64::from(a.abs().max(b.abs())) * 1.2e-7;
            let off = (f64::from(span.decode(span.nearest(value))) - f64::from(value)).abs();
            prop_assert!(off <= span.step() * 0.5 + ulp);
            prop_assert!(span.decode(span.below(value)) <= value);
            prop_assert!(span.decode(span.above(value)) >= value);
            let below = f64::from(span.decode(span.below(value)));
            prop_assert!(f64::from(value) - below <= span.step() + 2.0 * ulp);
            prop_assert_eq!(span.decode(0), min);
            prop_assert_eq!(span.decode(65535), max);
        }

        #[test]
        fn steps(
            e in -30f32..30.0,
            range in 0f32..15.0,
            t in prop::collection::vec(0f32..=1.0, 1..50),
        ) {
            let power = |t: &f32| 10f32.powf((e + t * range).min(38.0));
            let values: Vec<f32> = t.iter().map(power).collect();
            let steps = Steps::fit(values.iter().copied()).unwrap();
            for v in values {
                let off = (f64::from(steps.decode(steps.encode(v))) / f64::from(v) - 1.0).abs();
                prop_assert!(off <= 5e-4, "{v} off by {off}");
            }
        }

        #[test]
        fn colours(
            e in -36f32..30.0,
            range in 0f32..8.0,
            c in prop::collection::vec(prop::array::uniform3(0f32..=1.0), 1..50),
        ) {
            let colours: Vec<[f32; 3]> = c
                .iter()
                .enumerate()
                .map(|(i, c)| c.map(|v| v * 10f32.powf(e + range * (i as f32 / 50.0))))
                .collect();
            let Some(code) = SharedExponent::fit(colours.iter().copied()) else { return Ok(()) };
            for c in colours {
                let max = f64::from(c[0].max(c[1]).max(c[2]));
                let decoded = code.decode(code.encode(c));
                for i in 0..3 {
                    prop_assert!((f64::from(decoded[i]) - f64::from(c[i])).abs() <= max / 512.0);
                }
                let grey = code.decode_grey(code.encode_grey(c[0]));
                prop_assert_eq!(grey, code.decode(code.encode([c[0]; 3])));
            }
        }

        #[test]
        fn edges_cut_away_no_more_than_meant(
            angle in 0f32..6.25,
            offset in 0f32..=1.0,
            x in -1f32..1.0,
            y in -1f32..1.0,
            z in -1f32..1.0,
            phi in 0f64..6.25,
            rho in 0f64..=1.0,
        ) {
            let Some(n) = unit(x, y, z) else { return Ok(()) };
            let decoded_n = decode_normal(encode_normal(n));
            let code = encode_edge(ClipEdge { angle, offset }, n, decoded_n);
            let edge = decode_edge(code);
            prop_assert_eq!(encode_edge(edge, decoded_n, decoded_n), code);
            // A point of the disk that the given edge keeps is kept by the stored one.
            let (t, b) = tangent_frame(n);
            let p: [f64; 3] = std::array::from_fn(|i| {
                rho * (phi.cos() * f64::from(t[i]) + phi.sin() * f64::from(b[i]))
            });
            let along = |a: [f32; 3], e: ClipEdge, n: [f32; 3]| {
                let (t, b) = tangent_frame(n);
                let dot = |v: [f32; 3]| (0..3).map(|i| f64::from(v[i]) * a[i] as f64).sum::<f64>();
                f64::from(e.angle).cos() * dot(t) + f64::from(e.angle).sin() * dot(b)
            };
            let p32 = p.map(|c| c as f32);
            let given = along(p32, ClipEdge { angle, offset }, n);
            let stored = along(p32, edge, decoded_n);
            if given <= f64::from(offset) - 1e-6 {
                prop_assert!(stored <= f64::from(edge.offset) + 3e-4, "{stored} > {}", edge.offset);
            }
            if given >= f64::from(offset) + 0.035 {
                prop_assert!(stored > f64::from(edge.offset));
            }
        }
    }

    #[test]
    fn the_bound_holds_where_mantissas_end() {
        for i in 0..=10_000 {
            let max = 511.0 + i as f32 / 10_000.0;
            let c = [max, 100.3, 255.7];
            let code = SharedExponent::fit([c].into_iter()).unwrap();
            let decoded = code.decode(code.encode(c));
            for (a, b) in c.iter().zip(decoded) {
                assert!((a - b).abs() <= max / 512.0, "{a} {b}");
            }
        }
    }

    #[test]
    fn colours_of_any_size_survive() {
        for e in -30..=30 {
            let c = [10f32.powi(e), 3.0 * 10f32.powi(e), 0.0];
            let code = SharedExponent::fit([c].into_iter()).unwrap();
            let d = code.decode(code.encode(c));
            assert!((d[1] / c[1] - 1.0).abs() <= 1.0 / 512.0);
            assert!((d[0] - c[0]).abs() <= c[1] / 512.0);
            assert_eq!(d[2], 0.0);
        }
        assert!(SharedExponent::fit([[1e-30; 3], [1e30; 3]].into_iter()).is_none());
    }
}

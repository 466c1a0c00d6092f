//! What every record must be, when it is written and when it is read.

use crate::record::{Lvoxel, MAX_LEVEL, Surfel, VolumeInfo};
use crate::{FormatError, Result};

fn wrong(
    place: &dyn Fn() -> String,
    field: &str,
    expected: &str,
    found: impl std::fmt::Debug,
) -> FormatError {
    FormatError::invalid(
        format!("{field} of {}", place()),
        expected,
        format!("{found:?}"),
    )
}

fn is_radiance(c: [f32; 3]) -> bool {
    c.iter().all(|v| v.is_finite() && *v >= 0.0)
}

/// Bits of numbers that are neither negative nor infinite are below this, in the order of the
/// numbers.
const INFINITY: u32 = f32::INFINITY.to_bits();

/// Checks a surfel; `place` names it in the error.
#[inline]
pub fn surfel(s: &Surfel, place: &dyn Fn() -> String) -> Result<()> {
    // Readers ask this of every surfel: without a branch for each number.
    let most = |numbers: &[f32]| numbers.iter().map(|v| v.to_bits()).fold(0, u32::max);
    let at_least_0 = most(&s.front)
        .max(most(&s.back))
        .max(most(&[s.area, s.radius]));
    let size = most(&s.position.map(f32::abs));
    let [x, y, z] = s.normal;
    let is_unit = (0.99..=1.01).contains(&(x * x + y * y + z * z));
    let in_range = (at_least_0 < INFINITY) & (size < INFINITY) & (s.radius > 0.0) & is_unit;
    if in_range && s.clips.count == 0 {
        Ok(())
    } else {
        rare_surfel(s, place)
    }
}

/// Checks a surfel that is clipped, or has something wrong or a negative zero.
fn rare_surfel(s: &Surfel, place: &dyn Fn() -> String) -> Result<()> {
    if !s.position.iter().all(|v| v.is_finite()) {
        return Err(wrong(place, "position", "finite numbers", s.position));
    }
    let len2: f32 = s.normal.iter().map(|c| c * c).sum();
    if !(0.99..=1.01).contains(&len2) {
        return Err(wrong(place, "normal", "a unit vector", s.normal));
    }
    if !(s.radius.is_finite() && s.radius > 0.0) {
        return Err(wrong(place, "radius", "a positive number", s.radius));
    }
    if !(s.area.is_finite() && s.area >= 0.0) {
        return Err(wrong(place, "area", "a number of at least 0", s.area));
    }
    for (name, c) in [("front radiance", s.front), ("back radiance", s.back)] {
        if !is_radiance(c) {
            return Err(wrong(place, name, "numbers of at least 0", c));
        }
    }
    if s.clips.count > 3 {
        return Err(wrong(place, "clip count", "at most 3", s.clips.count));
    }
    for edge in &s.clips.edges[..usize::from(s.clips.count)] {
        if !(edge.angle.is_finite() && (0.0..=1.0).contains(&edge.offset)) {
            return Err(wrong(
                place,
                "clip edge",
                "a finite angle and an offset in [0, 1]",
                edge,
            ));
        }
    }
    Ok(())
}

/// Checks an lvoxel; `place` names it in the error.
#[inline]
pub fn lvoxel(v: &Lvoxel, volumes: &[VolumeInfo], place: &dyn Fn() -> String) -> Result<()> {
    // Readers ask this of every lvoxel: without a branch for each number.
    let is_minus_0 = |c: f32| c.to_bits() == (-0.0_f32).to_bits();
    if let Some(volume) = volumes.get(usize::from(v.volume))
        && v.level <= MAX_LEVEL
    {
        let inside = |axis: usize| u32::from(v.block[axis]) << v.level < volume.dims[axis];
        let numbers = [v.sigma_t, v.source[0], v.source[1], v.source[2]];
        let most = numbers.map(f32::to_bits).into_iter().fold(0, u32::max);
        let in_range = most < INFINITY
            || numbers
                .iter()
                .all(|c| c.to_bits() < INFINITY || is_minus_0(*c));
        if inside(0) & inside(1) & inside(2) & in_range {
            return Ok(());
        }
    }
    Err(wrong_lvoxel(v, volumes, place))
}

/// What is wrong with an lvoxel, of which something is.
#[cold]
fn wrong_lvoxel(v: &Lvoxel, volumes: &[VolumeInfo], place: &dyn Fn() -> String) -> FormatError {
    let Some(volume) = volumes.get(usize::from(v.volume)) else {
        let expected = format!("below {}", volumes.len());
        return wrong(place, "volume", &expected, v.volume);
    };
    if v.level > MAX_LEVEL {
        return wrong(place, "level", &format!("at most {MAX_LEVEL}"), v.level);
    }
    if (0..3).any(|axis| u32::from(v.block[axis]) << v.level >= volume.dims[axis]) {
        let expected = format!("a first voxel inside {:?}", volume.dims);
        return wrong(place, "block", &expected, v.block);
    }
    if !(v.sigma_t.is_finite() && v.sigma_t >= 0.0) {
        return wrong(place, "sigma_t", "a number of at least 0", v.sigma_t);
    }
    wrong(place, "source", "numbers of at least 0", v.source)
}

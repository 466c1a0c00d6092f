//! What values a packed scene may have.

use crate::packed::column::MAX_COORDINATE;
use crate::{FormatError, Result};

/// Emission, intensity and irradiance are not beyond this.
pub const MAX_EMISSION: f32 = 1e30;
/// Pixels along a side of the largest film, and texels along one of the largest sky.
pub const MAX_SIDE: u32 = 65_536;

pub fn wrong(what: impl Into<String>, expected: &str, found: impl std::fmt::Debug) -> FormatError {
    FormatError::invalid(what, expected, format!("{found:?}"))
}

pub fn check(
    is_right: bool,
    what: &dyn Fn() -> String,
    expected: &str,
    found: impl std::fmt::Debug,
) -> Result<()> {
    if is_right {
        Ok(())
    } else {
        Err(wrong(what(), expected, found))
    }
}

pub fn is_light(color: [f32; 3]) -> bool {
    color.iter().all(|v| (0.0..=MAX_EMISSION).contains(v))
}

pub fn is_share(number: f32) -> bool {
    (0.0..=1.0).contains(&number)
}

pub fn are_shares(color: [f32; 3]) -> bool {
    color.into_iter().all(is_share)
}

pub fn is_near(position: [f32; 3]) -> bool {
    position.iter().all(|v| v.abs() <= MAX_COORDINATE)
}

pub fn is_unit(direction: [f32; 3]) -> bool {
    (0.999..=1.001).contains(&dot(direction, direction))
}

pub fn dot<T>(a: [T; 3], b: [T; 3]) -> T
where
    T: Copy + std::ops::Mul<Output = T> + std::iter::Sum,
{
    a.into_iter().zip(b).map(|(a, b)| a * b).sum()
}

pub fn cross<T>(a: [T; 3], b: [T; 3]) -> [T; 3]
where
    T: Copy + std::ops::Mul<Output = T> + std::ops::Sub<Output = T>,
{
    [1, 2, 0].map(|i| {
        let j = (i + 1) % 3;
        a[i] * b[j] - a[j] * b[i]
    })
}

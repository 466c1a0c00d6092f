//! Placement: affine maps in f64 from the keys of a scene file.

use super::table::Table;
use crate::Result;
use glam::{DAffine3, DMat3, DQuat, DVec3};

/// Keys that [`from_keys`] reads.
pub(super) const KEYS: [&str; 4] = ["transform", "translate", "rotate_deg", "scale"];

/// The map of `transform`, or of `scale`, then `rotate_deg` about x, y and z, then `translate`.
pub(super) fn from_keys(table: &Table<'_>) -> Result<DAffine3> {
    if let Some(item) = table.get("transform") {
        for key in &KEYS[1..] {
            table.exclusive(&["transform", key])?;
        }
        return item.affine();
    }
    let mut scale = DVec3::ONE;
    if let Some(item) = table.get("scale") {
        scale = match item.number() {
            Ok(factor) => DVec3::splat(factor),
            Err(_) => item.vector()?,
        };
        if scale.cmpeq(DVec3::ZERO).any() {
            return Err(item.error("a scale of zero flattens space"));
        }
    }
    let mut rotation = DQuat::IDENTITY;
    if let Some(item) = table.get("rotate_deg") {
        let angle = item.vector()?;
        rotation = rotation_deg(angle);
    }
    let translation = match table.get("translate") {
        Some(item) => item.vector()?,
        None => DVec3::ZERO,
    };
    Ok(DAffine3 {
        matrix3: DMat3::from_quat(rotation) * DMat3::from_diagonal(scale),
        translation,
    })
}

/// A turn about an axis of unit length. By hand: glam's sines are the platform's, and pixels must
/// not depend on that.
pub(super) fn about(axis: DVec3, degrees: f64) -> DQuat {
    let (sin, cos) = libm::sincos(0.5 * degrees.to_radians());
    DQuat::from_vec4((axis * sin).extend(cos))
}

/// About x, then y, then z.
fn rotation_deg(angle: DVec3) -> DQuat {
    about(DVec3::Z, angle.z) * about(DVec3::Y, angle.y) * about(DVec3::X, angle.x)
}

#[cfg(test)]
mod tests {
    use super::super::table::Document;
    use super::*;
    use std::path::Path;

    fn map(text: &str) -> Result<DAffine3> {
        let document = Document::new(Path::new("s.toml"), text);
        let parsed = document.parse()?;
        from_keys(&document.root(&parsed, &KEYS)?)
    }

    #[test]
    fn scale_comes_before_rotation_and_that_before_translation() {
        let m = map("scale = [2, 1, 1]\nrotate_deg = [0, 0, 90]\ntranslate = [0, 0, 5]").unwrap();
        let p = m.transform_point3(DVec3::X);
        assert!((p - DVec3::new(0.0, 2.0, 5.0)).length() < 1e-12, "{p}");
        let m = map("rotate_deg = [90, 90, 0]").unwrap();
        let p = m.transform_vector3(DVec3::Y);
        assert!((p - DVec3::X).length() < 1e-12, "x first, then y: {p}");
    }

    #[test]
    fn two_ways_of_saying_it_are_refused() {
        let e = map("scale = 1\ntransform = [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]");
        assert!(e.unwrap_err().to_string().contains("exclude each other"));
        assert!(map("scale = 0").unwrap_err().to_string().contains("zero"));
    }
}

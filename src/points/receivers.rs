//! The points of a file as they gather: checked, in scene space.

use super::file::PointFile;
use crate::trace::offset;
use crate::{Error, Result};
use glam::{DVec3, Vec3};

/// Coordinates that are this far away have no square in single precision that leaves room for
/// more.
pub(super) const MAX_COORDINATE: f64 = 1e15;
/// Surfels stand where their places were rounded to, some of them before the wall that the point is
/// on: gathers start so many times further off it than rays to triangles need.
const ROUNDING: f32 = 16.0;

/// A point that gathers.
#[derive(Clone, Copy, Debug)]
pub(super) struct Receiver {
    /// Off its own surface, if it has a normal.
    pub position: Vec3,
    /// Zero for none.
    pub normal: Vec3,
}

/// A vector at length 1, however long it was; `None` for one without a length.
pub(super) fn unit(vector: DVec3) -> Option<Vec3> {
    // The largest component becomes 1 first.
    let scaled = vector / vector.abs().max_element();
    let is_one = vector.is_finite() && scaled.is_finite();
    is_one.then(|| scaled.normalize().as_vec3())
}

/// Makes receivers of the rows of a file.
pub(super) struct Receivers<'a> {
    points: &'a PointFile,
    position: [usize; 3],
    normal: Option<[usize; 3]>,
    world_from_scene: DVec3,
    bias: f32,
}

impl<'a> Receivers<'a> {
    pub(super) fn new(points: &'a PointFile, world_from_scene: DVec3, bias: f32) -> Result<Self> {
        let position = points.triple(["x", "y", "z"])?;
        Ok(Self {
            points,
            position: position.ok_or_else(|| Error::input("expected `x`, `y` and `z`"))?,
            normal: points.triple(["nx", "ny", "nz"])?,
            world_from_scene,
            bias,
        })
    }

    /// The receiver of a row, which is that of a point of the file.
    ///
    /// # Errors
    /// Names the point whose position or normal is none.
    pub(super) fn receiver(&self, row: &[f64], point: u64) -> Result<Receiver> {
        let three = |columns: [usize; 3]| DVec3::from(columns.map(|c| row[c]));
        let wrong = |what: &str, found: DVec3| {
            let [x, y, z] = found.to_array();
            let message = format!("expected {what}, found [{x}, {y}, {z}]");
            self.points.at(point, Error::input(message))
        };
        let position = three(self.position);
        // NaN is not below either.
        if !position
            .to_array()
            .iter()
            .all(|v| v.abs() <= MAX_COORDINATE)
        {
            return Err(wrong("a position within 1e15 of the origin", position));
        }
        let place = (position - self.world_from_scene).as_vec3();
        let Some(columns) = self.normal else {
            return Ok(Receiver {
                position: place,
                normal: Vec3::ZERO,
            });
        };
        let normal = three(columns);
        let normal = unit(normal).ok_or_else(|| wrong("a normal of a length", normal))?;
        Ok(Receiver {
            position: place + normal * (ROUNDING * offset(place) + self.bias),
            normal,
        })
    }
}

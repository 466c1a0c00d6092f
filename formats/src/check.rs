//! What every record must be, when it is written and when it is read: one function for each kind of
//! record, which readers, writers and the complete check of a file share. Clusters of scattered
//! light have theirs beside their coding.

use crate::record::{Bounds, Lvoxel, MAX_LEVEL, MAX_VOXELS_ALONG, Node, Surfel, VolumeInfo};
use crate::summary::Sums;
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

/// Whether a colour is one that light can have.
pub fn is_radiance(c: [f32; 3]) -> bool {
    c.iter().all(|v| v.is_finite() && *v >= 0.0)
}

/// Whether this is a sample of extinction: finite, and not below 0, nor its negative.
#[inline]
pub fn is_extinction(v: f32) -> bool {
    v.to_bits() < INFINITY
}

/// Bits of numbers that are neither negative nor infinite are below this, in the order of the
/// numbers.
pub const INFINITY: u32 = f32::INFINITY.to_bits();

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
        let [r, g, b] = v.incident.map(f32::to_bits);
        let has_shape = Lvoxel::is_lobe(v.lobe) & Lvoxel::is_lobe(v.single.lobe);
        let in_range = in_range & has_shape & (r.max(g).max(b) < INFINITY);
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
    if !Lvoxel::is_lobe(v.lobe) {
        return wrong(place, "lobe", "a length of at most 126", v.lobe);
    }
    if !Lvoxel::is_lobe(v.single.lobe) {
        return wrong(
            place,
            "single",
            "a lobe of a length of at most 126",
            v.single,
        );
    }
    if !v.incident.iter().all(|c| c.to_bits() < INFINITY) {
        return wrong(place, "incident", "numbers of at least 0", v.incident);
    }
    wrong(place, "source", "numbers of at least 0", v.source)
}

/// Checks a box; `what` names it in the error.
pub fn bounds(b: &Bounds, what: &dyn Fn() -> String) -> Result<()> {
    let is_ordered =
        (0..3).all(|k| b.min[k].is_finite() && b.max[k].is_finite() && b.min[k] <= b.max[k]);
    if is_ordered {
        Ok(())
    } else {
        Err(FormatError::invalid(
            what(),
            "a finite box",
            format!("{b:?}"),
        ))
    }
}

/// Checks a node of a tree, all but the radiance of its aggregate, which is checked by columns;
/// `place` names it in the error.
#[inline]
pub fn node(n: &Node, place: &dyn Fn() -> String) -> Result<()> {
    // Readers ask this of every node: without a branch for each number.
    let a = &n.aggregate;
    let most = |numbers: &[f32]| numbers.iter().map(|v| v.to_bits()).fold(0, u32::max);
    let size = |numbers: &[f32]| numbers.iter().map(|v| v.abs().to_bits()).fold(0, u32::max);
    let size = size(&n.bounds.min)
        .max(size(&n.bounds.max))
        .max(size(&a.centre))
        .max(size(&a.normal_sum))
        .max(size(&a.second_moment));
    let is_ordered = (0..3).all(|k| n.bounds.min[k] <= n.bounds.max[k]);
    let is_area = a.area.to_bits() < INFINITY;
    let is_seen = most(&a.axis_area) <= most_axis_area(a.area).to_bits();
    if (size < INFINITY) & is_ordered & is_area & is_seen {
        Ok(())
    } else {
        rare_node(n, place)
    }
}

/// Most area that a node may show to an axis: with room for rounding, and for normals that are not
/// quite of unit length. Finite.
fn most_axis_area(area: f32) -> f32 {
    (area * 1.01).min(f32::MAX)
}

/// Checks a node that has something wrong or a negative zero.
#[cold]
fn rare_node(n: &Node, place: &dyn Fn() -> String) -> Result<()> {
    let a = &n.aggregate;
    bounds(&n.bounds, &|| format!("box of {}", place()))?;
    if !(a.area.is_finite() && a.area >= 0.0) {
        return Err(wrong(place, "area", "a number of at least 0", a.area));
    }
    for (name, values) in [
        ("centre", &a.centre[..]),
        ("normal sum", &a.normal_sum),
        ("second moment", &a.second_moment),
    ] {
        if !values.iter().all(|v| v.is_finite()) {
            return Err(wrong(place, name, "finite numbers", values));
        }
    }
    let most = most_axis_area(a.area);
    if !a.axis_area.iter().all(|v| (0.0..=most).contains(v)) {
        let expected = "numbers from 0 to its area";
        return Err(wrong(place, "axis areas", expected, a.axis_area));
    }
    Ok(())
}

/// Checks a volume of the metadata.
pub fn volume(v: &VolumeInfo) -> Result<()> {
    let place = || format!("volume {:?}", v.name);
    if !(v.dims.iter()).all(|n| (1..=MAX_VOXELS_ALONG).contains(n)) {
        let expected = format!("1 to {MAX_VOXELS_ALONG} voxels along each axis");
        return Err(wrong(&place, "size", &expected, v.dims));
    }
    let [x, y, z, _] = v.index_from_scene;
    let cross = [1, 2, 0].map(|i| {
        let j = (i + 1) % 3;
        y[i] * z[j] - y[j] * z[i]
    });
    // By x's own order: the cross product's first number goes with x's first.
    let determinant = x[0] * cross[0] + x[1] * cross[1] + x[2] * cross[2];
    let fits = |v: &f64| v.abs() <= f64::from(f32::MAX);
    let is_map = v.index_from_scene.as_flattened().iter().all(fits)
        && determinant.is_finite()
        && determinant != 0.0;
    if !is_map {
        let expected = "a map of finite numbers that can be inverted";
        return Err(wrong(&place, "place", expected, v.index_from_scene));
    }
    if !v.albedo.iter().all(|c| (0.0..=1.0).contains(c)) {
        return Err(wrong(&place, "albedo", "numbers from 0 to 1", v.albedo));
    }
    extinction_color(v.extinction_color, &place)
}

/// Checks the extinction of a volume over that of the channel that has most.
pub fn extinction_color(color: [f32; 3], place: &dyn Fn() -> String) -> Result<()> {
    let is_right = color.iter().all(|c| (0.0..=1.0).contains(c)) && color.contains(&1.0);
    match is_right {
        true => Ok(()),
        false => {
            let expected = "numbers from 0 to 1, the largest 1";
            Err(wrong(place, "extinction colour", expected, color))
        }
    }
}

/// Checks the sums of a summary, of so many volumes.
pub fn sums(s: &Sums, volumes: usize) -> Result<()> {
    if s.volumes.len() != volumes {
        let what = "volumes in the summary";
        return Err(FormatError::invalid(
            what,
            volumes.to_string(),
            s.volumes.len(),
        ));
    }
    let of_volumes = s.volumes.iter().map(|v| v.extinction);
    let mut all = [s.area].into_iter().chain(s.flux).chain(of_volumes);
    match all.find(|v| !(v.is_finite() && *v >= 0.0)) {
        Some(v) => Err(FormatError::invalid(
            "sums in the summary",
            "numbers of at least 0",
            v,
        )),
        None => Ok(()),
    }
}

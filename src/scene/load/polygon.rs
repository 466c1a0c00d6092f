//! Polygons cut into triangles.

use super::left_out::LeftOut;
use crate::run::Cancel;
use crate::run::memory;
use crate::scene::builder::MESH;
use crate::{Error, Result};
use glam::DVec3;
use spade::{ConstrainedDelaunayTriangulation, Point2, Triangulation};
use std::collections::{HashMap, HashSet};

/// Corners of the largest polygon that is cut in its plane: that takes some 500 bytes and ten
/// microseconds for each.
const MAX_CORNERS: usize = 1 << 20;

/// Corners from which on cutting takes so long that a stop is to be heard meanwhile.
const MANY_CORNERS: usize = 1 << 13;

/// Corners up to which a corner is looked for from which the whole polygon is seen.
const FEW_CORNERS: usize = 16;

/// Share of a polygon's area by which a triangle may turn the wrong way and yet count as flat:
/// what rounding makes of corners in one line.
const FLAT: f64 = 1e-12;

/// Share of its area by which a polygon and its triangles may differ.
const SAME_AREA: f64 = 1e-6;

/// Cuts polygons, one after the other, with lists that it keeps.
#[derive(Default)]
pub(super) struct Cutter {
    corners: Vec<DVec3>,
    /// Triangles of the last polygon, as numbers of its corners.
    triangles: Vec<[u32; 3]>,
    /// Polygons so far that cross themselves.
    crossed: u64,
    cancel: Cancel,
}

impl Cutter {
    /// Nothing is cut yet.
    pub(super) fn until(cancel: &Cancel) -> Self {
        Self {
            cancel: cancel.clone(),
            ..Self::default()
        }
    }

    /// Triangles of the polygon with the vertices `polygon` that face as it does, none if it has
    /// less than three; `position` is that of a vertex, if there is such a vertex.
    ///
    /// Where all of the polygon is seen from its first corner, they are a fan around that. Others
    /// are cut in the plane that fits best, in n log n for n corners. A polygon of no area, or that
    /// crosses itself, or with a corner that is no point, becomes a fan.
    ///
    /// # Errors
    /// No memory for them, far too many corners, or a stop on request.
    pub(super) fn cut(
        &mut self,
        polygon: &[u32],
        position: impl Fn(u32) -> Option<DVec3>,
    ) -> Result<impl ExactSizeIterator<Item = [u32; 3]>> {
        self.triangles.clear();
        if polygon.len() == 3 {
            self.triangles.push([0, 1, 2]);
        } else if polygon.len() > 3 {
            let first_of_fan = self.cut_in_plane(polygon, position)?;
            if let Some(first) = first_of_fan {
                self.fan(first, polygon.len())?;
            }
        }
        let triangles = self.triangles.iter();
        Ok(triangles.map(|t| t.map(|corner| polygon[corner as usize])))
    }

    /// Notes how many polygons crossed themselves.
    pub(super) fn note_crossed(&self, left_out: &mut LeftOut) {
        if self.crossed > 0 {
            let what = "faces that cross themselves are filled from their first corner";
            left_out.note(what, format_args!("{} of them", self.crossed));
        }
    }

    fn fan(&mut self, first: usize, count: usize) -> Result<()> {
        memory::grow(MESH, &mut self.triangles, count - 2)?;
        let corner = |i: usize| ((first + i) % count) as u32;
        let fan = (2..count).map(|i| [corner(0), corner(i - 1), corner(i)]);
        self.triangles.extend(fan);
        Ok(())
    }

    /// Cuts the polygon, or finds the corner around which a fan is as good, or no worse.
    fn cut_in_plane(
        &mut self,
        polygon: &[u32],
        position: impl Fn(u32) -> Option<DVec3>,
    ) -> Result<Option<usize>> {
        let count = polygon.len();
        let Some(first) = position(polygon[0]) else {
            return Ok(Some(0));
        };
        self.corners.clear();
        memory::grow(MESH, &mut self.corners, count)?;
        for &vertex in polygon {
            match position(vertex) {
                // From the first on: what is far from the origin keeps its digits.
                Some(p) => self.corners.push(p - first),
                None => return Ok(Some(0)),
            }
        }
        let corners = &self.corners;
        let area_vectors = |first: usize| {
            let side = move |i: usize| corners[(first + i) % count] - corners[first];
            (2..count).map(move |i| side(i - 1).cross(side(i)))
        };
        let sum: DVec3 = area_vectors(0).sum();
        let area = sum.length();
        let Some(normal) = sum.try_normalize().filter(|n| n.is_finite()) else {
            return Ok(Some(0));
        };
        let sees_all = |&first: &usize| {
            let mut turns = area_vectors(first).map(|a| a.dot(normal));
            turns.all(|a| a >= -FLAT * area)
        };
        let tried = if count <= FEW_CORNERS { count } else { 1 };
        if let Some(first) = (0..tried).find(sees_all) {
            return Ok(Some(first));
        }
        if count > MAX_CORNERS {
            return Err(Error::input(format!(
                "a face that is not convex has {count} corners, \
                 more than the {MAX_CORNERS} that it may have"
            ))
            .hint("cut it into triangles"));
        }
        let x = normal.any_orthonormal_vector();
        let y = normal.cross(x);
        let largest = corners.iter().map(|p| p.abs().max_element());
        let scale = 1.0 / largest.fold(0.0, f64::max);
        let flat = corners
            .iter()
            .map(|p| [p.dot(x), p.dot(y)].map(|c| tidy(c * scale)));
        let area = 0.5 * area * scale * scale;
        let triangles = if count < MANY_CORNERS {
            inside(flat, count, area)
        } else {
            let flat: Vec<[f64; 2]> = memory::listed(MESH, flat)?;
            let inside = move || inside(flat.into_iter(), count, area);
            self.cancel.while_busy("cut-polygon", inside)?
        };
        if triangles.is_none() {
            self.crossed += 1;
        }
        Ok(match triangles {
            Some(triangles) => {
                self.triangles = triangles;
                None
            }
            None => Some(0),
        })
    }
}

/// A coordinate without what is too small to be told from zero, and without its sign.
fn tidy(x: f64) -> f64 {
    if x.abs() < 1e-40 { 0.0 } else { x }
}

/// Triangles of a polygon in a plane that runs counter-clockwise, by a Delaunay triangulation that
/// has its edges: what is on the inner side of an odd number of them is inside. `None` if they
/// cross each other, or if the area comes out otherwise.
fn inside(
    corners: impl Iterator<Item = [f64; 2]>,
    count: usize,
    area: f64,
) -> Option<Vec<[u32; 3]>> {
    // Corners at one place are one point.
    let mut point_at: HashMap<[u64; 2], usize> = HashMap::with_capacity(count);
    let (mut points, mut corner_of_point) = (Vec::new(), Vec::new());
    let mut point_of_corner = Vec::with_capacity(count);
    for (corner, [x, y]) in corners.enumerate() {
        let point = *point_at.entry([x, y].map(f64::to_bits)).or_insert_with(|| {
            points.push(Point2::new(x, y));
            corner_of_point.push(corner as u32);
            points.len() - 1
        });
        point_of_corner.push(point);
    }
    // An edge that comes twice, as a bridge to a hole does, is no border.
    let mut edges = HashSet::with_capacity(count);
    let mut in_order = Vec::with_capacity(count);
    for (i, &a) in point_of_corner.iter().enumerate() {
        let b = point_of_corner[(i + 1) % count];
        let edge = [a.min(b), a.max(b)];
        if a != b && !edges.remove(&edge) {
            edges.insert(edge);
            in_order.push(edge);
        }
    }
    in_order.retain(|edge| edges.remove(edge));
    let mut crosses = false;
    let made = ConstrainedDelaunayTriangulation::<Point2<f64>>::try_bulk_load_cdt(
        points,
        in_order,
        |_| crosses = true,
    );
    let made = made
        .ok()
        .filter(|made| !crosses && made.num_vertices() == corner_of_point.len())?;

    // From the outside inwards; face 0 is the outside.
    let mut is_inside: Vec<Option<bool>> = vec![None; made.num_all_faces()];
    is_inside[0] = Some(false);
    let mut stack = Vec::new();
    let borders = |edge| made.is_constraint_edge(edge);
    for edge in made.directed_edges().filter(|e| e.is_outer_edge()) {
        let inner = edge.rev().face().fix();
        if is_inside[inner.index()].is_none() {
            is_inside[inner.index()] = Some(borders(edge.as_undirected().fix()));
            stack.push(inner);
        }
    }
    while let Some(face) = stack.pop() {
        let own = is_inside[face.index()] == Some(true);
        let face = made.face(face).as_inner()?;
        for edge in face.adjacent_edges() {
            let next = edge.rev().face().fix();
            if is_inside[next.index()].is_none() {
                is_inside[next.index()] = Some(own != borders(edge.as_undirected().fix()));
                stack.push(next);
            }
        }
    }
    let mut triangles = Vec::with_capacity(count);
    let mut sum = 0.0;
    for face in made.inner_faces() {
        if is_inside[face.fix().index()] == Some(true) {
            sum += face.area();
            triangles.push(face.vertices().map(|v| corner_of_point[v.fix().index()]));
        }
    }
    ((sum - area).abs() <= SAME_AREA * area).then_some(triangles)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The sum of the triangles' area vectors, and that of their areas.
    fn areas(points: &[DVec3]) -> (DVec3, f64) {
        let polygon: Vec<u32> = (0..points.len() as u32).collect();
        let mut cutter = Cutter::default();
        let position = |v: u32| points.get(v as usize).copied();
        let triangles = cutter.cut(&polygon, position).unwrap();
        let area_vector = |t: [u32; 3]| {
            let [a, b, c] = t.map(|i| points[i as usize]);
            0.5 * (b - a).cross(c - a)
        };
        triangles.fold((DVec3::ZERO, 0.0), |(sum, area), t| {
            (sum + area_vector(t), area + area_vector(t).length())
        })
    }

    fn flat(points: &[[f64; 2]]) -> Vec<DVec3> {
        points.iter().map(|p| DVec3::new(p[0], p[1], 0.0)).collect()
    }

    /// Checks the area of a polygon in a plane from each corner, in both directions, tilted, and
    /// far away.
    fn check(points: &[[f64; 2]], area: f64) {
        let turn = glam::DQuat::from_xyzw(0.1, 0.5, -0.3, 0.7).normalize();
        for offset in [DVec3::ZERO, DVec3::new(1e6, -3e6, 2e5)] {
            for first in 0..points.len() {
                let mut points = points.to_vec();
                points.rotate_left(first);
                for facing in [1.0, -1.0] {
                    let placed: Vec<DVec3> =
                        flat(&points).iter().map(|p| turn * *p + offset).collect();
                    let (sum, total) = areas(&placed);
                    let expected = turn * DVec3::Z * area * facing;
                    assert!((sum - expected).length() < 1e-6 * area, "{points:?}: {sum}");
                    assert!((total - area).abs() < 1e-6 * area, "{points:?}: {total}");
                    points.reverse();
                }
            }
        }
    }

    #[test]
    fn polygons_keep_their_area_whatever_their_shape() {
        let c: [[f64; 2]; 8] = [
            [0., 0.],
            [3., 0.],
            [3., 1.],
            [1., 1.],
            [1., 2.],
            [3., 2.],
            [3., 3.],
            [0., 3.],
        ];
        check(&c, 7.0);
        // A dart; a corner in the middle of an edge; corners twice at one place.
        check(&[[0., 0.], [2., 1.], [0., 2.], [1., 1.]], 1.0);
        check(
            &[[0., 0.], [1., 0.], [2., 0.], [2., 2.], [1., 2.], [0., 2.]],
            4.0,
        );
        check(
            &[[0., 0.], [0., 0.], [2., 0.], [1., 0.5], [1., 0.5], [0., 2.]],
            1.5,
        );
        // A square with a square hole, bridged by vertices that come twice.
        let hole: [[f64; 2]; 10] = [
            [0., 0.],
            [4., 0.],
            [4., 4.],
            [0., 4.],
            [0., 0.],
            [1., 1.],
            [1., 3.],
            [3., 3.],
            [3., 1.],
            [1., 1.],
        ];
        check(&hole, 12.0);
        // A comb, with more corners than are searched one by one.
        let mut comb: Vec<[f64; 2]> = vec![[200.0, -1.0], [200.0, 0.0]];
        for i in (0..200).rev() {
            comb.extend([[f64::from(i) + 0.5, 10.0], [f64::from(i), 0.0]]);
        }
        comb.push([0.0, -1.0]);
        check(&comb, 200.0 + 200.0 * 5.0);
    }

    #[test]
    fn polygons_of_no_plane_stay_on_their_corners() {
        // A saddle with a notch: seen from above its area is that of the flat one.
        let c = [
            [0., 0.],
            [3., 0.],
            [3., 1.],
            [1., 1.],
            [1., 2.],
            [3., 2.],
            [3., 3.],
            [0., 3.],
        ];
        let saddle: Vec<DVec3> = flat(&c)
            .iter()
            .map(|p| DVec3::new(p.x, p.y, 0.1 * (p.x - 1.5) * (p.y - 1.5)))
            .collect();
        let (sum, _) = areas(&saddle);
        assert!((sum.z - 7.0).abs() < 1e-9, "{sum}");
    }

    #[test]
    fn convex_polygons_are_fans_and_what_is_none_is_not_lost() {
        let fan = |points: &[DVec3]| -> Vec<[u32; 3]> {
            let polygon: Vec<u32> = (0..5).collect();
            let mut cutter = Cutter::default();
            let triangles = cutter.cut(&polygon, |v| points.get(v as usize).copied());
            triangles.unwrap().collect()
        };
        let expected = [[0, 1, 2], [0, 2, 3], [0, 3, 4]];
        let house = flat(&[[0., 0.], [2., 0.], [2., 1.], [1., 2.], [0., 1.]]);
        assert_eq!(fan(&house), expected);
        assert_eq!(fan(&[DVec3::ONE; 5]), expected);
        assert_eq!(fan(&[DVec3::NAN; 5]), expected);
        assert_eq!(fan(&house[..4]), expected);
        let mut cutter = Cutter::default();
        assert_eq!(cutter.cut(&[0, 1], |_| None).unwrap().len(), 0);
        // A pentagram is seen from none of its corners, and crosses itself.
        let star = flat(&[[0., 3.], [-2., -3.], [3., 1.], [-3., 1.], [2., -3.]]);
        assert_eq!(fan(&star), expected);
    }

    #[test]
    fn a_polygon_of_too_many_corners_is_refused_unless_it_is_convex() {
        let polygon: Vec<u32> = (0..=MAX_CORNERS as u32).collect();
        let cut = |dent: f64| {
            let position = |i: u32| {
                let turn = std::f64::consts::TAU * f64::from(i) / polygon.len() as f64;
                let r = if i.is_multiple_of(2) { 1.0 } else { dent };
                Some(DVec3::new(r * turn.cos(), r * turn.sin(), 0.0))
            };
            let mut cutter = Cutter::default();
            let triangles = cutter.cut(&polygon, position).map(|t| t.len());
            triangles.map_err(|e| e.to_string())
        };
        assert_eq!(cut(1.0), Ok(MAX_CORNERS - 1));
        let error = cut(0.9).unwrap_err();
        assert!(
            error.contains("1048577 corners, more than the 1048576"),
            "{error}"
        );
    }

    #[test]
    fn a_polygon_of_many_corners_is_cut() {
        // What grows with the square of the corners would take a hundred times as long.
        // A gear: half of its corners are dents, and no triangle is in shape.
        let n = 100_000;
        let gear = (0..n).map(|i| {
            let (sin, cos) = (std::f64::consts::TAU * f64::from(i) / f64::from(n)).sin_cos();
            let r = if i % 2 == 0 { 1.0 } else { 0.99 };
            DVec3::new(r * cos, r * sin, 0.0)
        });
        let points: Vec<DVec3> = gear.collect();
        let (sum, total) = areas(&points);
        assert!(
            (sum.z - total).abs() < 1e-6 && (total - 3.11).abs() < 0.01,
            "{total}"
        );
    }
}

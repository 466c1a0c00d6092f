//! Walks a ray through the non-empty cells of a volume, with the exact optical depth of each.
//!
//! Along a ray through one cell a trilinear field is a cubic, which two Gauss points integrate
//! exactly. Empty bricks are passed in one step, so there is no step size to choose.

use crate::math::Ray;
use crate::math::dda::{Line, Passage, Steps};
use crate::run::walked::note_cells;
use crate::scene::Volume;
use crate::scene::grid::{BRICK_CELLS, Brick};
use glam::Vec3A;

/// The part of a ray inside one cell of a volume.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RayInVolume {
    /// Where it begins, scene units from the ray's origin.
    pub near: f32,
    /// Where it ends, scene units from the ray's origin.
    pub far: f32,
    /// Optical depth from `near` to `far`.
    pub tau: f32,
}

impl RayInVolume {
    /// Optical depth of the first piece of a dense stretch; each further one is twice as deep.
    const PIECE: f32 = 0.5;
    /// A stretch up to this depth is one piece.
    const THIN: f32 = 0.7;

    /// The parts before and behind a place, scene units from the ray's origin; all of it if that is
    /// not inside.
    #[must_use]
    pub fn cut(self, at: f32) -> (Self, Option<Self>) {
        let is_inside = at > self.near && at < self.far;
        if !is_inside {
            return (self, None);
        }
        let tau = self.tau * ((at - self.near) / (self.far - self.near));
        let first = Self {
            far: at,
            tau,
            ..self
        };
        let rest = Self {
            near: at,
            tau: self.tau - tau,
            ..self
        };
        (first, Some(rest))
    }

    /// The stretch in pieces, front to back: light changes over about one optical depth, so a dense
    /// stretch starts with thin pieces. The last holds what is too deep to be seen.
    pub fn pieces(self) -> impl Iterator<Item = Self> {
        let mut done = 0.0;
        let mut depth = if self.tau > Self::THIN {
            Self::PIECE
        } else {
            f32::INFINITY
        };
        let at = move |tau: f32| self.near + (self.far - self.near) * (tau / self.tau);
        std::iter::from_fn(move || {
            if done >= self.tau {
                return None;
            }
            let from = done;
            let is_last = depth > 8.0 || from + 1.5 * depth >= self.tau;
            done = if is_last { self.tau } else { from + depth };
            depth *= 2.0;
            Some(Self {
                near: if from == 0.0 { self.near } else { at(from) },
                far: if is_last { self.far } else { at(done) },
                tau: done - from,
            })
        })
    }
}

/// The non-empty cells that a ray meets, front to back.
pub struct Cells<'a> {
    volume: &'a Volume,
    line: Line,
    /// Distance from the ray's origin to where `line` starts: keeps cell coordinates exact for
    /// far-away origins.
    start: f32,
    end: f32,
    bricks: Steps,
    /// Where the walk is along `line`.
    t: f32,
    done: bool,
    inside: Option<InBrick<'a>>,
}

/// A ray in a stored brick.
struct InBrick<'a> {
    brick: Brick<'a>,
    /// Where its cells begin, cell coordinates.
    base: Vec3A,
    /// Edge of its cells in voxels, and one over that.
    edge: [f32; 2],
    cells: Steps,
    /// Where on the line the ray leaves it.
    leave: f32,
    done: bool,
    passed: u64,
}

impl Drop for InBrick<'_> {
    fn drop(&mut self) {
        note_cells(self.passed);
    }
}

impl<'a> Cells<'a> {
    /// Optical depth along an edge of a cell that may be as deep as in its middle, at most.
    const MAX_DEPTH_OF_MIDDLE: f32 = 0.25;

    /// The walk of a ray; `None` if it misses the volume's box.
    #[must_use]
    pub fn new(volume: &'a Volume, ray: &Ray) -> Option<Self> {
        let map = (&volume.index_from_scene, &volume.index_from_scene_f64);
        let size = volume.sigma_t.size();
        let Passage { line, start, end } = Passage::new(map, size, ray)?.in_cells();
        let limit = volume.sigma_t.brick_dims().map(|n| n as i32);
        let bricks = Steps::new(&line, 0.0, [0; 3], BRICK_CELLS as f32, limit);
        Some(Self {
            volume,
            line,
            start,
            end,
            bricks,
            t: 0.0,
            done: false,
            inside: None,
        })
    }

    /// Optical depth of all cells that are left: in double, since they are many.
    #[must_use]
    pub fn optical_depth(self) -> f64 {
        let mut tau = 0.0;
        self.each(|cell| {
            tau += f64::from(cell.tau);
            true
        });
        tau
    }

    /// Gives the cells that are left to `add` until that says no: the same as [`Self::next_cell`],
    /// faster.
    #[inline]
    pub fn each(self, add: impl FnMut(RayInVolume) -> bool) {
        self.each_by_middle(|_, _| true, add);
    }

    /// The same for those who do not tell what is in which cell: each is as deep as in its middle,
    /// where it is thin and `tells_cells` says no of its edge in voxels, at a distance from the
    /// ray's origin.
    #[inline]
    pub fn each_by_middle(
        mut self,
        tells_cells: impl Fn(f32, f32) -> bool,
        mut add: impl FnMut(RayInVolume) -> bool,
    ) {
        let thin = Self::MAX_DEPTH_OF_MIDDLE / self.volume.longest_voxel_edge();
        while let Some(mut inside) = self.inside.take().or_else(|| self.enter_brick()) {
            let [edge, _] = inside.edge;
            let is_exact = tells_cells(edge, self.start + self.t) || inside.brick.max * edge > thin;
            loop {
                let (line, start, t) = (&self.line, self.start, &mut self.t);
                let cell = match (is_exact, inside.brick.level) {
                    (true, 0) => inside.next_with::<false, true>(line, start, t),
                    (true, _) => inside.next_with::<false, false>(line, start, t),
                    (false, 0) => inside.next_with::<true, true>(line, start, t),
                    (false, _) => inside.next_with::<true, false>(line, start, t),
                };
                match cell {
                    None => break,
                    Some(cell) if add(cell) => {}
                    Some(_) => return,
                }
            }
        }
    }

    /// The next non-empty cell.
    #[inline]
    pub fn next_cell(&mut self) -> Option<RayInVolume> {
        loop {
            if self.inside.is_none() {
                self.inside = self.enter_brick();
            }
            let cell = self
                .inside
                .as_mut()?
                .next(&self.line, self.start, &mut self.t);
            if cell.is_some() {
                return cell;
            }
            self.inside = None;
        }
    }

    /// Moves on to the next stored brick.
    #[inline]
    fn enter_brick(&mut self) -> Option<InBrick<'a>> {
        while !self.done {
            let b = self.bricks.at();
            let leave = self.bricks.leave().min(self.end);
            let entry = self.t;
            let brick = self.volume.sigma_t.brick(b.map(|v| v as usize));
            self.done = !self.bricks.advance() | (leave >= self.end);
            if let Some(brick) = brick.filter(|_| leave > entry) {
                let base = b.map(|v| v * BRICK_CELLS as i32);
                let edge = (1 << brick.level) as f32;
                let limit = [(BRICK_CELLS >> brick.level) as i32; 3];
                return Some(InBrick {
                    brick,
                    base: Vec3A::from_array(base.map(|v| v as f32)),
                    edge: [edge, 1.0 / edge],
                    cells: Steps::new(&self.line, entry, base, edge, limit),
                    leave,
                    done: false,
                    passed: 0,
                });
            }
            self.t = self.t.max(leave);
        }
        None
    }
}

impl InBrick<'_> {
    /// The next non-empty cell behind `t` of a line that begins `start` behind its ray's origin.
    #[inline]
    fn next(&mut self, line: &Line, start: f32, t: &mut f32) -> Option<RayInVolume> {
        match self.brick.level {
            0 => self.next_with::<false, true>(line, start, t),
            _ => self.next_with::<false, false>(line, start, t),
        }
    }

    /// The same, as deep as in its middle if that is asked; faster for who knows that cells are
    /// voxels wide.
    #[inline]
    fn next_with<const BY_MIDDLE: bool, const ON_VOXELS: bool>(
        &mut self,
        line: &Line,
        start: f32,
        t: &mut f32,
    ) -> Option<RayInVolume> {
        let [edge, per_edge] = match ON_VOXELS {
            true => [1.0; 2],
            false => self.edge,
        };
        while !self.done {
            let near = *t;
            let far = self.cells.leave().min(self.leave);
            let (at, corner) = (self.cells.at(), self.base + self.cells.corner() * edge);
            self.done = !self.cells.advance() | (far >= self.leave);
            let far = if self.done { self.leave } else { near.max(far) };
            *t = far;
            if far <= near {
                continue;
            }
            self.passed += 1;
            let cell = self.brick.cell::<ON_VOXELS>(at.map(|v| v as usize));
            if !cell.is_empty() {
                let value = |t: f32| {
                    let p = (line.origin + line.direction * t - corner) * per_edge;
                    cell.value(p.clamp(Vec3A::ZERO, Vec3A::ONE))
                };
                let mean = match BY_MIDDLE {
                    true => value(0.5 * (near + far)),
                    false => mean(near, far, value),
                };
                return Some(RayInVolume {
                    near: start + near,
                    far: start + far,
                    tau: mean * (far - near),
                });
            }
        }
        None
    }
}

/// Mean over a stretch by two points (Gauss-Legendre), exact for cubics.
#[inline]
fn mean(near: f32, far: f32, value: impl Fn(f32) -> f32) -> f32 {
    const OFFSET: f32 = 0.288_675_13; // 1 / (2 sqrt 3)
    let (middle, half) = (0.5 * (near + far), OFFSET * (far - near));
    0.5 * (value(middle - half) + value(middle + half))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::sampling;
    use crate::scene::Grid;
    use crate::scene::grid::Allowed;
    use glam::{DAffine3, DQuat, DVec3, Vec3};

    fn volume(grid: Grid, scene_from_index: DAffine3) -> Volume {
        Volume::new("test".into(), grid, [0.5; 3], scene_from_index)
    }

    #[test]
    fn a_cut_keeps_all_of_a_part() {
        let part = RayInVolume {
            near: 2.0,
            far: 6.0,
            tau: 0.5,
        };
        let (first, rest) = part.cut(3.0);
        let rest = rest.unwrap();
        assert_eq!((first.near, first.far, first.tau), (2.0, 3.0, 0.125));
        assert_eq!((rest.near, rest.far, rest.tau), (3.0, 6.0, 0.375));
        for outside in [1.0, 2.0, 6.0, 7.0, f32::NAN] {
            assert_eq!(part.cut(outside), (part, None));
        }
    }

    fn tau(v: &Volume, o: Vec3, d: Vec3, t_max: f32) -> f64 {
        let mut sum = 0.0;
        let mut last = 0.0;
        if let Some(mut cells) = Cells::new(v, &Ray::new(o, d, t_max)) {
            while let Some(c) = cells.next_cell() {
                assert!(
                    c.near >= last && c.far > c.near && c.far <= t_max,
                    "{c:?} after {last}"
                );
                last = c.far;
                sum += f64::from(c.tau);
            }
        }
        sum
    }

    #[test]
    fn optical_depth_agrees_with_fine_steps_under_any_placement() {
        let grid = Grid::from_fn([37, 19, 23], |[i, j, k]| {
            let v = sampling::unit(sampling::hash(&[i as u64, j as u64, k as u64]));
            if v < 0.5 || (8..16).contains(&i) {
                0.0
            } else {
                30.0 * v
            }
        });
        let placement = DAffine3::from_scale_rotation_translation(
            DVec3::new(0.05, 0.08, 0.03),
            DQuat::from_rotation_y(0.7) * DQuat::from_rotation_x(-0.4),
            DVec3::new(3.0, -1.0, 2.0),
        );
        check_depths(&volume(grid, placement), placement);
    }

    #[test]
    fn optical_depth_agrees_with_fine_steps_where_bricks_are_coarse() {
        let grid = Grid::from_fn([37, 19, 23], |[i, j, k]| {
            10.0 + 8.0 * (0.3 * i as f32).sin() * (0.2 * (j + k) as f32).cos()
        });
        let placement = DAffine3::from_scale_rotation_translation(
            DVec3::new(0.05, 0.08, 0.03),
            DQuat::from_rotation_y(0.4),
            DVec3::new(3.0, -1.0, 2.0),
        );
        let allowed = |b: [usize; 3]| Allowed {
            unseen: b[0],
            depth: f32::INFINITY,
            error: 0.0,
        };
        let v = volume(grid, placement).adapted(allowed).unwrap().unwrap();
        let levels = v.sigma_t.bricks().filter_map(|b| v.sigma_t.brick(b));
        let levels: std::collections::BTreeSet<usize> = levels.map(|b| b.level).collect();
        assert_eq!(levels.len(), 4);
        check_depths(&v, placement);
    }

    fn check_depths(v: &Volume, placement: DAffine3) {
        let centre = placement
            .transform_point3(DVec3::new(18.0, 9.0, 11.0))
            .as_vec3();
        for i in 0..200 {
            let o = centre
                + sampling::sphere(sampling::r2(i, [0.1; 2])) * if i % 3 == 0 { 0.3 } else { 4.0 };
            let target = centre + sampling::sphere(sampling::r2(i, [0.6; 2])) * 0.4;
            let d = (target - o).normalize();
            let t_max = if i % 2 == 0 {
                20.0
            } else {
                (target - o).length()
            };
            let steps = 100_000;
            let dt = f64::from(t_max) / f64::from(steps);
            let expected: f64 = (0..steps)
                .map(|s| {
                    let p = o + d * ((f64::from(s) + 0.5) * dt) as f32;
                    f64::from(v.sigma_t.sample(v.index_from_scene.transform_point3(p))) * dt
                })
                .sum();
            let got = tau(v, o, d, t_max);
            assert!(
                (got - expected).abs() < 3e-3 + 3e-4 * expected,
                "ray {i}: {got} against {expected}"
            );
        }
    }

    #[test]
    fn thin_cells_are_about_as_deep_as_in_their_middle() {
        let hill = |[i, j, k]: [usize; 3]| {
            let p = Vec3::new(i as f32, j as f32, k as f32);
            (1.0 - p.distance(Vec3::new(18.0, 9.0, 30.0)) / 14.0).max(0.0)
        };
        let noise = |v: [usize; 3]| sampling::unit(sampling::hash(&v.map(|i| i as u64)));
        let sheet = |[.., k]: [usize; 3]| f32::from(u8::from(k == 30));
        check_middles(&|v| 0.1 * hill(v), 2e-3);
        check_middles(&|v| 0.2 * noise(v), 0.04);
        check_middles(&|v| 0.2 * sheet(v), 0.03);
        // Cells of that depth are exact.
        check_middles(&|v| 0.9 * noise(v), 1e-5);
    }

    /// Compares depths along rays by middles of cells with exact ones, from which they may differ
    /// by this share.
    fn check_middles(sigma_t: &(dyn Fn([usize; 3]) -> f32 + Sync), tolerance: f32) {
        let place = DAffine3::from_quat(DQuat::from_rotation_y(0.7));
        let middle = place.transform_point3(DVec3::new(18.0, 9.0, 30.0));
        let v = volume(Grid::from_fn([37, 19, 61], sigma_t), place);
        for i in 0..200 {
            let o = middle.as_vec3() + sampling::sphere(sampling::r2(i, [0.1; 2])) * 60.0;
            let around = sampling::sphere(sampling::r2(i, [0.6; 2])) * 8.0;
            let direction = (middle.as_vec3() + around - o).normalize();
            let cells = || Cells::new(&v, &Ray::new(o, direction, 1e3)).unwrap();
            let depth = |tells_cells: bool| {
                let mut sum = 0.0;
                cells().each_by_middle(
                    |_, _| tells_cells,
                    |cell| {
                        sum += cell.tau;
                        true
                    },
                );
                sum
            };
            let exact = cells().optical_depth() as f32;
            for (found, tolerance) in [(depth(false), tolerance), (depth(true), 1e-5)] {
                assert!(
                    (found - exact).abs() <= tolerance * exact.max(0.1),
                    "ray {i}: {found}, not {exact}"
                );
            }
        }
    }

    #[test]
    fn pieces_add_up() {
        for tau in [1e-9_f32, 0.7, 0.71, 3.0, 1e4, 1e30] {
            let whole = RayInVolume {
                near: 2.0,
                far: 3.0,
                tau,
            };
            let pieces: Vec<_> = whole.pieces().collect();
            assert_eq!((pieces[0].near, pieces[pieces.len() - 1].far), (2.0, 3.0));
            assert!(pieces.windows(2).all(|p| p[0].far == p[1].near));
            let sum: f32 = pieces.iter().map(|p| p.tau).sum();
            assert!(
                (sum / tau - 1.0).abs() < 1e-6 && pieces.len() < 8,
                "{pieces:?}"
            );
            assert_eq!(pieces.len() > 1, tau > 0.75);
        }
    }

    #[test]
    fn a_constant_box_has_its_length_times_density_whatever_the_direction() {
        let v = volume(
            Grid::from_fn([1, 1, 1], |_| 7.0),
            DAffine3::from_scale(DVec3::new(2.0, 3.0, 4.0)),
        );
        for (o, d, length) in [
            (Vec3::new(-5.0, 1.0, 1.0), Vec3::X, 2.0),
            (Vec3::new(1.0, 9.0, 1.0), Vec3::new(-0.0, -1.0, -0.0), 3.0),
            (Vec3::new(1.0, 1.0, 1.0), Vec3::Z, 3.0),
            (Vec3::new(0.0, 0.0, 0.0), Vec3::Z, 4.0),
        ] {
            assert!((tau(&v, o, d, 100.0) - 7.0 * length).abs() < 1e-4);
        }
        assert_eq!(tau(&v, Vec3::new(-1.0, 1.0, 1.0), -Vec3::X, 100.0), 0.0);
    }
}

//! Volumes as they are handed to a builder.

use super::{MAX_COORDINATE, check_near, is_singular};
use crate::scene::grid::BRICK_CELLS;
use crate::scene::{AlbedoGrid, Grid, PhaseFunction, Volume};
use crate::{Error, Result};
use glam::{DAffine3, DVec3};

/// Layers of voxels thinner than this are taken for a mistake: what a ray passes per unit would
/// leave the range of f32.
const MIN_VOXEL_EDGE: f64 = 1.0 / MAX_COORDINATE;

/// A participating medium in world space.
#[derive(Debug)]
pub struct VolumeInput {
    pub(in crate::scene) name: String,
    /// Extinction per world unit of the channel that has most.
    pub(in crate::scene) sigma_t: Grid,
    /// Extinction of red, green and blue over that, one of them 1.
    pub(in crate::scene) extinction_color: [f32; 3],
    /// Single-scattering albedo.
    pub(in crate::scene) albedo: [f32; 3],
    /// The albedo of each voxel in its place, if that varies.
    pub(in crate::scene) albedo_grid: Option<AlbedoGrid>,
    pub(in crate::scene) phase: PhaseFunction,
    /// Maps the box `0..dims` of the grid into the world.
    pub(in crate::scene) world_from_grid: DAffine3,
}

impl VolumeInput {
    /// Longest edge of a voxel over its shortest up to which voxels are near enough to cubes.
    const NEARLY_CUBES: f64 = 2.5;
    /// Optical depth of the longest edge of a voxel up to which its form does not matter.
    const THIN: f64 = 0.7;
    /// Most voxels that are made of those of a file: of each, or of all if these are more.
    const MOST_OF_EACH: usize = 16;
    const MOST_OF_ALL: usize = 1 << 24;

    /// The same medium on voxels that are nearly cubes, if it is dense: layers are put between
    /// those of scans in thick slices. Blocks of voxels are as deep as they are long, and what is
    /// deep is divided into single ones, whatever their width.
    ///
    /// By odd numbers, so that each voxel keeps its value and the light sees the same medium. Media
    /// on one grid stay so. Notes what was divided.
    pub(super) fn on_even_voxels(all: Vec<Self>, notes: &mut Vec<String>) -> Vec<Self> {
        let parts: Vec<_> = all.iter().map(Self::parts_of_voxels).collect();
        let of_grid = |of: &Self| {
            let alike = all.iter().zip(&parts).filter(|(other, _)| {
                other.sigma_t.dims() == of.sigma_t.dims()
                    && other.world_from_grid == of.world_from_grid
            });
            alike.fold([1; 3], |most, (_, parts)| {
                std::array::from_fn(|a| parts[a].max(most[a]))
            })
        };
        let parts: Vec<[usize; 3]> = all.iter().map(of_grid).collect();
        let all = all.into_iter().zip(parts);
        all.map(|(volume, parts)| volume.in_parts(parts, notes))
            .collect()
    }

    /// The same medium, each voxel divided along each axis.
    fn in_parts(self, parts: [usize; 3], notes: &mut Vec<String>) -> Self {
        if parts == [1; 3] {
            return self;
        }
        let [x, y, z] = parts;
        notes.push(format!(
            "volume `{}`: its voxels are divided by {x}, {y} and {z} along their axes, as they are \
             deep and far from cubes",
            self.name
        ));
        let dims: [usize; 3] = std::array::from_fn(|a| self.sigma_t.dims()[a] * parts[a]);
        let finer = |grid: &Grid| {
            Grid::from_fn(dims, |at| {
                let middle = |a: usize| (at[a] as f32 + 0.5) / parts[a] as f32;
                grid.sample([middle(0), middle(1), middle(2)].into())
            })
        };
        let albedo_grid = self.albedo_grid.as_ref().map(|grid| {
            let channels = grid.channels().each_ref();
            AlbedoGrid::new(channels.map(|channel| finer(channel).into()))
        });
        let smaller = DAffine3::from_scale(DVec3::from(parts.map(|n| 1.0 / n as f64)));
        Self {
            sigma_t: finer(&self.sigma_t),
            albedo_grid,
            world_from_grid: self.world_from_grid * smaller,
            ..self
        }
    }

    /// Into how many each voxel is divided along each axis.
    fn parts_of_voxels(&self) -> [usize; 3] {
        let m = self.world_from_grid.matrix3;
        let edges = [m.x_axis, m.y_axis, m.z_axis].map(DVec3::length);
        let shortest = edges.into_iter().fold(f64::INFINITY, f64::min);
        let densest = f64::from(self.sigma_t.max());
        let mut parts = edges.map(|edge| {
            let longer = edge / shortest;
            match longer > Self::NEARLY_CUBES && edge * densest > Self::THIN {
                // The nearest odd number.
                true => 2 * (0.5 * longer).min(1e6) as usize + 1,
                false => 1,
            }
        });
        let dims = self.sigma_t.dims();
        // As a grid holds them, brick by brick.
        let voxels = |parts: &[usize; 3]| {
            let along = dims.iter().zip(parts);
            along.fold(1_usize, |all, (n, p)| {
                all.saturating_mul((n * p).next_multiple_of(BRICK_CELLS))
            })
        };
        let most = Self::MOST_OF_ALL.max(voxels(&[1; 3]).saturating_mul(Self::MOST_OF_EACH));
        while voxels(&parts) > most && parts != [1; 3] {
            parts = parts.map(|n| (n / 2) & !1 | 1);
        }
        parts
    }

    /// The medium, in the space of a scene.
    pub(super) fn in_scene(self, scene_from_world: DAffine3) -> Volume {
        let scene_from_index = scene_from_world * self.world_from_grid;
        let albedo = match &self.albedo_grid {
            None => self.albedo,
            Some(grid) => grid.mean(&self.sigma_t).0,
        };
        let volume = Volume::new(self.name, self.sigma_t, albedo, scene_from_index);
        let volume = volume.with_albedo_grid(self.albedo_grid);
        let volume = volume.with_extinction_color(self.extinction_color);
        let mut volume = volume.with_phase(self.phase);
        volume.limit_extinction();
        volume
    }

    /// A medium with the extinction `sigma_t` per world unit and the single-scattering albedo
    /// `albedo`, each channel in `[0,1]`. `world_from_grid` maps the box `0..dims` of the grid, in
    /// which voxel (i,j,k) is the cube from (i,j,k) to (i+1,j+1,k+1), into the world.
    #[must_use]
    pub fn new(
        name: impl Into<String>,
        sigma_t: Grid,
        albedo: [f32; 3],
        world_from_grid: DAffine3,
    ) -> Self {
        Self {
            name: name.into(),
            sigma_t,
            extinction_color: [1.0; 3],
            albedo,
            albedo_grid: None,
            phase: PhaseFunction::ISOTROPIC,
            world_from_grid,
        }
    }

    /// The same medium with an extinction of its own for red, green and blue: so many times
    /// `sigma_t` each, in `[0,1]` and one of them 1.
    #[must_use]
    pub fn extinction_color(self, extinction_color: [f32; 3]) -> Self {
        Self {
            extinction_color,
            ..self
        }
    }

    /// The same medium with a single-scattering albedo of its own for each voxel, red, green and
    /// blue, each in `[0,1]`: on grids of as many voxels as that of the extinction. They matter
    /// where that is not 0, and between such voxels and their neighbours.
    #[must_use]
    pub fn albedo_grid(self, channels: [Grid; 3]) -> Self {
        let albedo_grid = AlbedoGrid::new(channels.map(Into::into));
        Self {
            albedo_grid: Some(albedo_grid),
            ..self
        }
    }

    /// The same medium with a phase function that is not isotropic.
    #[must_use]
    pub fn phase(self, phase: PhaseFunction) -> Self {
        Self { phase, ..self }
    }

    /// Corners of its box in the world.
    pub(super) fn corners(&self) -> [DVec3; 8] {
        let size = self.sigma_t.dims().map(|n| n as f64);
        std::array::from_fn(|corner| {
            let at = |a: usize| if corner >> a & 1 == 1 { size[a] } else { 0.0 };
            let p = DVec3::new(at(0), at(1), at(2));
            self.world_from_grid.transform_point3(p)
        })
    }

    /// Refuses a volume of a size or at a place that f32 cannot hold.
    pub(super) fn check_place(&self) -> Result<()> {
        let what = || format!("the volume \"{}\"", self.name);
        for corner in self.corners() {
            check_near(|| format!("{}: a corner of its box", what()), corner)?;
        }
        // Rows of the inverse stand on the layers of voxels, and are as long as these are thin.
        let m = self.world_from_grid.matrix3.inverse().transpose();
        let steepest = [m.x_axis, m.y_axis, m.z_axis].map(DVec3::length);
        let thinnest = 1.0 / steepest.into_iter().fold(0.0, f64::max);
        // Not the other way round: there may be no number at all.
        if !(steepest.iter().all(|v| v.is_finite()) && thinnest >= MIN_VOXEL_EDGE) {
            return Err(Error::input(format!(
                "{}: expected voxels of at least {MIN_VOXEL_EDGE:e} units in each direction, \
                 found {thinnest:e}",
                what()
            ))
            .hint("enlarge the volume by `scale`, or by the matrix that places it"));
        }
        Ok(())
    }

    /// Refuses values and maps that readers of files refuse before they make a volume.
    pub(super) fn check_values(&self) -> Result<()> {
        let wrong = |what: String| Err(Error::input(format!("volume `{}`: {what}", self.name)));
        if !self.albedo.iter().all(|x| (0.0..=1.0).contains(x)) {
            return wrong(format!("the albedo {:?} is not in [0,1]", self.albedo));
        }
        let most = self.extinction_color.into_iter().fold(0.0, f32::max);
        if most != 1.0
            || !self
                .extinction_color
                .iter()
                .all(|c| (0.0..=1.0).contains(c))
        {
            return wrong(format!(
                "the extinction colour {:?} is not in [0,1] with a largest channel of 1",
                self.extinction_color
            ));
        }
        if let Some(grid) = &self.albedo_grid
            && let Err(error) = grid.check(&self.sigma_t)
        {
            return wrong(error.to_string());
        }
        if !self.phase.is_valid() {
            return wrong(format!(
                "the phase function has lobes of {:?} and a mix of {}: expected mean cosines from \
                 -{max} to {max}, and a mix from 0 to 1",
                self.phase.lobes(),
                self.phase.mix(),
                max = PhaseFunction::MAX_G,
            ));
        }
        if is_singular(&self.world_from_grid) {
            return wrong("its placement is singular: it flattens space".into());
        }
        match self.sigma_t.first_invalid() {
            Some(value) => wrong(format!(
                "an extinction of {value}: expected finite numbers of at least 0"
            )),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::sampling;
    use glam::Vec3;

    fn of(dims: [usize; 3], edges: [f64; 3], scale: f32) -> VolumeInput {
        let grid = Grid::from_fn(dims, |at| {
            scale * sampling::unit(sampling::hash(&at.map(|i| i as u64)))
        });
        let placement = DAffine3::from_scale(edges.into());
        VolumeInput::new("slices", grid, [0.5; 3], placement)
    }

    #[test]
    fn thick_slices_are_the_same_medium_on_more_voxels() {
        let grid = |v: &VolumeInput| v.sigma_t.clone();
        let colors = [0.2, 0.5, 0.9].map(|a| Grid::from_fn([9, 7, 4], move |_| a));
        let thick = of([9, 7, 4], [0.5, 0.5, 4.6], 3.0).albedo_grid(colors);
        let (before, place) = (grid(&thick), thick.world_from_grid);
        let mut notes = Vec::new();
        let thin = VolumeInput::new("thin", Grid::from_fn([9, 7, 4], |_| 0.01), [0.5; 3], place);
        let both = VolumeInput::on_even_voxels(vec![thick, thin], &mut notes);
        let [even, thin] = <[VolumeInput; 2]>::try_from(both).unwrap();
        assert_eq!(thin.sigma_t.dims(), [9, 7, 36]);
        assert_eq!(notes.len(), 2);
        assert_eq!(even.sigma_t.dims(), [9, 7, 36]);
        for i in 0..500 {
            let [x, y] = sampling::r2(i, [0.3, 0.8]);
            let z = sampling::unit(sampling::hash(&[i]));
            let at = DVec3::new(f64::from(x) * 9.0, f64::from(y) * 7.0, f64::from(z) * 4.0);
            let world = place.transform_point3(at);
            let finer = even.world_from_grid.inverse().transform_point3(world);
            let [a, b] = [
                before.sample(at.as_vec3()),
                even.sigma_t.sample(finer.as_vec3()),
            ];
            assert!((a - b).abs() < 1e-4, "{at}: {a} {b}");
        }
        let albedo = even.albedo_grid.unwrap().at(Vec3::new(4.0, 3.0, 20.0));
        assert_eq!(albedo.0, [0.2, 0.5, 0.9]);
    }

    #[test]
    fn other_voxels_stay() {
        for (dims, edges, scale) in [
            ([9, 7, 4], [0.5, 0.5, 1.2], 3.0),
            ([9, 7, 4], [0.5, 0.5, 4.6], 0.1),
            ([9, 7, 4], [2.0; 3], 9.0),
        ] {
            assert_eq!(of(dims, edges, scale).parts_of_voxels(), [1; 3]);
        }
        // No more than memory is meant to hold.
        let [x, y, z] = of([1, 1, 2000], [2000.0, 2000.0, 1.0], 1.0).parts_of_voxels();
        assert!(
            z == 1 && x == y && x > 40 && x * y * 2000 <= VolumeInput::MOST_OF_ALL,
            "{x}"
        );
    }
}

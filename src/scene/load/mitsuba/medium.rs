//! Media of a Mitsuba file: those in cubes and spheres, as volumes.

use super::element::Element;
use super::{Reader, plugins};
use crate::Result;
use crate::scene::builder::VolumeInput;
use crate::scene::load::scale::Scale;
use crate::scene::load::values::GridValues;
use crate::scene::load::vol::Vol;
use crate::scene::{Grid, PhaseFunction};
use glam::{DAffine3, DVec3};
use std::path::PathBuf;

/// Voxels of a homogeneous medium along the longest edge of its box.
const UNIFORM_VOXELS: f64 = 32.0;
/// Extinction beyond this is a mistake.
const MAX_EXTINCTION: f32 = 1e30;

/// What a medium has of a quantity.
enum Quantity {
    Uniform([f32; 3]),
    /// A file of a grid, where it is, and the grid.
    Grid(PathBuf, DAffine3, Box<Vol>),
}

impl Reader<'_> {
    /// Takes the medium in a shape.
    pub(super) fn medium(
        &mut self,
        medium: &Element<'_>,
        shape: &Element<'_>,
        to_world: &DAffine3,
    ) -> Result<()> {
        medium.take();
        if let Some(error) = plugins::unknown(medium) {
            return Err(error);
        }
        medium.ignore(&[
            "has_spectral_extinction",
            "sample_emitters",
            "method",
            "strategy",
        ])?;
        let phase = self.phase(medium)?;
        let scale = medium.number_within("scale", 0.0, 1e30)?.unwrap_or(1.0);
        let (extinction, albedo) = self.quantities(medium)?;
        let albedo = self.one_color(medium, albedo)?;
        let name = medium.id().map_or_else(|| medium.line(), str::to_owned);
        match extinction {
            Quantity::Uniform(sigma_t) => {
                let (most, color) = most_and_color(sigma_t);
                let sigma_t = most * scale as f32;
                let own = match shape.kind() {
                    "cube" => DAffine3::IDENTITY,
                    "sphere" => {
                        let center = shape.vector("center")?.unwrap_or(DVec3::ZERO);
                        let radius = shape.number_within("radius", 1e-15, 1e15)?.unwrap_or(1.0);
                        DAffine3::from_translation(center)
                            * DAffine3::from_scale(DVec3::splat(radius))
                    }
                    kind => {
                        let what = format!(
                            "homogeneous media in shapes of the type `{kind}` are left out"
                        );
                        self.left_out.note(&what, shape.line());
                        return Ok(());
                    }
                };
                let is_ball = shape.kind() == "sphere";
                let (grid, world_from_grid) = uniform(sigma_t, &(*to_world * own), is_ball);
                if let Some(values) = &mut self.files.values {
                    let file = self.files.paths.first().cloned().unwrap_or_default();
                    values.push(GridValues::of_made(file, &grid));
                }
                let volume = VolumeInput::new(name, grid, albedo, world_from_grid);
                let volume = volume.extinction_color(color).phase(phase);
                self.builder.volumes.push(volume);
            }
            Quantity::Grid(path, world_from_unitcube, vol) => {
                // Of a cube from -1 to 1.
                let box_from_unitcube = *to_world
                    * DAffine3::from_translation(DVec3::splat(-1.0))
                    * DAffine3::from_scale(DVec3::splat(2.0));
                if shape.kind() != "cube" || !are_alike(&box_from_unitcube, &world_from_unitcube) {
                    let what = "media are drawn in the whole box of their grid, \
                                which is not that of their shape";
                    self.left_out.note(what, shape.line());
                }
                let (most_over_mean, color) = self.channels(medium, &vol);
                let scale = Scale::plain(scale * vol.scale() * most_over_mean);
                let field = vol.into_field().map_err(|e| e.at(path.display()))?;
                field
                    .note_values(&path, self.files)
                    .map_err(|e| e.at(path.display()))?;
                let world_from_grid = world_from_unitcube * field.unitcube_from_grid();
                let grid = field.grid(&scale, &path, self.files);
                let grid = grid.map_err(|e| e.at(path.display()))?;
                let volume = VolumeInput::new(name, grid, albedo, world_from_grid);
                let volume = volume.extinction_color(color).phase(phase);
                self.builder.volumes.push(volume);
            }
        }
        Ok(())
    }

    /// Extinction and albedo, however the medium states them.
    fn quantities(&mut self, medium: &Element<'_>) -> Result<(Quantity, Quantity)> {
        let scattering = medium.get("sigma_s")?;
        let absorption = medium.get("sigma_a")?;
        if scattering.is_some() || absorption.is_some() {
            let s = self.color(medium, "sigma_s", [0.0; 3], MAX_EXTINCTION)?;
            let a = self.color(medium, "sigma_a", [0.0; 3], MAX_EXTINCTION)?;
            let t: [f32; 3] = std::array::from_fn(|i| s[i] + a[i]);
            let albedo = std::array::from_fn(|i| if t[i] > 0.0 { s[i] / t[i] } else { 0.0 });
            return Ok((Quantity::Uniform(t), Quantity::Uniform(albedo)));
        }
        if let Some(material) = medium.get("material")? {
            let what = "media by the name of a material take an extinction of 1";
            self.left_out.note(what, material.line());
        }
        // 0.6 calls it density.
        let key = match medium.get("density")? {
            Some(_) => "density",
            None => "sigma_t",
        };
        let extinction = self.quantity(medium, key, 1.0, MAX_EXTINCTION)?;
        let albedo = self.quantity(medium, "albedo", 0.75, 1.0)?;
        Ok((extinction, albedo))
    }

    fn quantity(
        &mut self,
        medium: &Element<'_>,
        key: &str,
        default: f32,
        most: f32,
    ) -> Result<Quantity> {
        let Some(value) = medium.get(key)? else {
            return Ok(Quantity::Uniform([default; 3]));
        };
        if value.tag() != "volume" {
            return Ok(Quantity::Uniform(self.color(
                medium,
                key,
                [default; 3],
                most,
            )?));
        }
        match value.kind() {
            "constvolume" => Ok(Quantity::Uniform(
                self.color(&value, "value", [1.0; 3], most)?,
            )),
            "gridvolume" => {
                value.ignore(&["wrap_mode", "raw", "accel", "max_value", "send_data"])?;
                let name = value.require_text("filename")?;
                let filter = value.text("filter_type")?;
                if filter.is_some_and(|filter| filter == "nearest") {
                    self.left_out
                        .note("volumes without a filter are interpolated", value.line());
                }
                let to_world = value.transform("to_world")?;
                let path = value.tree.find(value.node().place, name);
                let content = self
                    .files
                    .read("volume", &path)
                    .map_err(|e| value.locate(e))?;
                let vol = Vol::read(content).map_err(|e| e.at(path.display()))?;
                let own = match value.flag("use_grid_bbox", false)? {
                    true => vol
                        .box_from_unitcube()
                        .ok_or_else(|| value.error("`use_grid_bbox`: the file states no box"))?,
                    false => DAffine3::IDENTITY,
                };
                Ok(Quantity::Grid(path, to_world * own, Box::new(vol)))
            }
            kind => match plugins::unknown(&value) {
                Some(error) => Err(error),
                None => Err(value.error(format_args!(
                    "volumes of the type `{kind}` are not supported"
                ))),
            },
        }
    }

    /// The colour of an albedo; a grid stands for its mean.
    fn one_color(&mut self, medium: &Element<'_>, albedo: Quantity) -> Result<[f32; 3]> {
        match albedo {
            Quantity::Uniform(color) => Ok(color),
            Quantity::Grid(path, _, vol) => {
                let what = "albedos of grids are taken as their mean";
                self.left_out.note(what, medium.line());
                let means = vol.means();
                match means.iter().all(|v| (0.0..=1.0).contains(v)) {
                    true => Ok(means),
                    false => Err(medium.error(format_args!(
                        "{}: expected an albedo from 0 to 1, found {means:?}",
                        path.display()
                    ))),
                }
            }
        }
    }

    /// The largest channel of an extinction over the mean of all, and all over the largest, the
    /// same in all voxels.
    fn channels(&mut self, medium: &Element<'_>, vol: &Vol) -> (f64, [f32; 3]) {
        const GREY: (f64, [f32; 3]) = (1.0, [1.0; 3]);
        let mut told = |what: &str| self.left_out.note(what, medium.line());
        match vol.channels() {
            1 => return GREY,
            3 => {}
            _ => {
                told("extinctions of two channels, or more than three, are taken as their mean");
                return GREY;
            }
        }
        let means = vol.means();
        let (most, color) = most_and_color(means);
        // Values that are no extinctions are told where the grid is made.
        if most <= 0.0
            || !means
                .iter()
                .all(|mean| (0.0..=MAX_EXTINCTION).contains(mean))
        {
            return GREY;
        }
        if !vol.is_of_one_color() {
            told("extinctions that change their colour take that of their mean");
        }
        let mean = means.iter().map(|mean| f64::from(*mean)).sum::<f64>() / 3.0;
        (f64::from(most) / mean, color)
    }

    fn phase(&mut self, medium: &Element<'_>) -> Result<PhaseFunction> {
        let Some(phase) = medium.object("phase")? else {
            return Ok(PhaseFunction::ISOTROPIC);
        };
        const MAX_G: f64 = 0.99;
        match phase.kind() {
            "isotropic" => Ok(PhaseFunction::ISOTROPIC),
            "hg" => {
                let g = phase.number_within("g", -1.0, 1.0)?.unwrap_or(0.8);
                if g.abs() > MAX_G {
                    let what = "phase functions beyond a `g` of 0.99 are taken as of that";
                    self.left_out.note(what, phase.line());
                }
                let g = g.clamp(-MAX_G, MAX_G);
                Ok(PhaseFunction::henyey_greenstein(g as f32))
            }
            kind => {
                if let Some(error) = plugins::unknown(&phase) {
                    return Err(error);
                }
                let what = format!("phase functions of the type `{kind}` are taken as isotropic");
                self.left_out.note(&what, phase.line());
                for &child in &phase.node().children {
                    phase.tree.nodes[child].used.set(true);
                }
                Ok(PhaseFunction::ISOTROPIC)
            }
        }
    }
}

/// The largest channel of an extinction, and all over that.
fn most_and_color(sigma_t: [f32; 3]) -> (f32, [f32; 3]) {
    let most = sigma_t.into_iter().fold(0.0, f32::max);
    match most > 0.0 {
        true => (most, sigma_t.map(|channel| channel / most)),
        false => (most, [1.0; 3]),
    }
}

/// A grid of one value in a cube from -1 to 1, or in the ball in it, and its map to the world.
fn uniform(sigma_t: f32, world_from_cube: &DAffine3, is_ball: bool) -> (Grid, DAffine3) {
    let m = world_from_cube.matrix3;
    let edges = [m.x_axis, m.y_axis, m.z_axis].map(DVec3::length);
    let longest = edges.into_iter().fold(0.0, f64::max);
    let dims = edges.map(|edge| {
        (UNIFORM_VOXELS * edge / longest)
            .ceil()
            .clamp(2.0, UNIFORM_VOXELS)
    });
    let size = DVec3::from(dims);
    let value = |voxel: [usize; 3]| {
        if !is_ball {
            return sigma_t;
        }
        let p = (DVec3::from(voxel.map(|i| i as f64)) + 0.5) / size * 2.0 - 1.0;
        // A border as wide as a voxel.
        let depth = (1.0 - p.length()) * 0.5 * UNIFORM_VOXELS + 0.5;
        sigma_t * depth.clamp(0.0, 1.0) as f32
    };
    let grid = Grid::from_fn(dims.map(|n| n as usize), value);
    let cube_from_grid =
        DAffine3::from_translation(DVec3::splat(-1.0)) * DAffine3::from_scale(2.0 / size);
    (grid, *world_from_cube * cube_from_grid)
}

/// Whether two maps of the unit cube are the same box, up to rounding.
fn are_alike(a: &DAffine3, b: &DAffine3) -> bool {
    let corners = |map: &DAffine3| -> Vec<DVec3> {
        let corner = |i: u32| DVec3::new((i & 1).into(), (i >> 1 & 1).into(), (i >> 2).into());
        (0..8).map(|i| map.transform_point3(corner(i))).collect()
    };
    let (of_a, of_b) = (corners(a), corners(b));
    let size = (of_a[7] - of_a[0]).length();
    // The box alone: its grid may be turned in it.
    of_a.iter()
        .all(|p| of_b.iter().any(|q| (*p - *q).length() <= 1e-4 * size))
}

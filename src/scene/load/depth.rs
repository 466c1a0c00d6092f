//! Warns of media in which no light gets anywhere, as values of an unknown unit make them.

use super::field::Field;
use super::files::Files;
use super::scale::{Density, Scale};
use super::suggest::sigma_t_scale;
use crate::Result;
use crate::scene::grid::Grid;
use glam::DAffine3;
use std::path::Path;

/// Mean optical depth of the voxels of a medium beyond which it is taken for a mistake.
const ABSURD: f64 = 50.0;
/// Share of the voxels that are medium where the whole box is.
const WHOLE: f64 = 0.99;
/// Optical depth from side to side of such a box that is worth a warning.
const DEEP: f64 = 16.0;

/// Warns where voxels are absurdly deep, or where a box is full of a medium of which nobody said
/// which values it has.
pub(super) fn check(
    field: &Field,
    scale: &Scale,
    grid: &Grid,
    world_from_grid: &DAffine3,
    path: &Path,
    files: &mut Files,
) -> Result<()> {
    let axes = world_from_grid.matrix3;
    let edges = [axes.x_axis, axes.y_axis, axes.z_axis].map(|a| a.length());
    let edge = libm::cbrt(axes.determinant().abs());
    let longest = edges.into_iter().fold(0.0, f64::max);
    let most = f64::from(grid.max());
    let is_unsaid = scale.density == Density::Value;
    // Before anything is counted: nearly all scenes have neither.
    let may_be_absurd = most * longest > ABSURD;
    let may_be_whole = is_unsaid
        && most * edge * libm::cbrt(grid.dims().iter().map(|n| *n as f64).product()) > DEEP
        && grid.bricks().all(|b| grid.brick(b).is_some());
    if !may_be_absurd && !may_be_whole {
        return Ok(());
    }
    let medium = field.values(Some(scale), path, &files.cancel)?;
    let voxels: f64 = medium.dims.iter().map(|n| *n as f64).product();
    let active = medium.active as f64;
    let mean = medium.active_mean;
    let across = mean * edge * libm::cbrt(voxels);
    let varies = medium.max > 1.5 * medium.min;
    let is_absurd = mean * longest > ABSURD;
    let is_whole = may_be_whole && varies && active >= WHOLE * voxels && across > DEEP;
    if !is_absurd && !is_whole {
        return Ok(());
    }
    let what = match is_whole {
        true => format!(
            "{:.0} % of the box is medium, of an optical depth of {} from side to side",
            100.0 * active / voxels,
            brief(across)
        ),
        false => format!(
            "the medium has a mean optical depth of {} in each voxel: no light gets in",
            brief(mean * longest)
        ),
    };
    let suggested = match is_unsaid {
        true => field.values(None, path, &files.cancel)?.suggested,
        false => None,
    };
    let cure = match suggested {
        Some(suggested) => {
            let [low, high] = suggested.window;
            let factor = suggested.sigma_t_scale(edge);
            format!("`window = [{low}, {high}]` and `sigma_t_scale = {factor}`")
        }
        None => {
            let factor = sigma_t_scale(active, mean / scale.sigma_t, edge);
            format!("`sigma_t_scale = {factor}`")
        }
    };
    files.warn(format!("{}: {what}; try {cure}", path.display()));
    Ok(())
}

/// A number in three digits.
fn brief(number: f64) -> f64 {
    format!("{number:.2e}").parse().unwrap_or(number)
}

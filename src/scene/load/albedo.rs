//! Grids of albedos, from the colours beside a density in a volume file, on the voxels of that.

use super::field::Field;
use super::files::Files;
use super::vdb::ColorFields;
use crate::run::memory;
use crate::scene::grid::{Grid, Region, VoxelBox};
use crate::{Error, Result};
use glam::{DAffine3, DMat3, DVec3};
use std::path::Path;

/// Voxels of colours that are read at a time, at most; more are of voxels far smaller than those of
/// the density.
const MOST_VOXELS: usize = 1 << 26;

/// Values of a channel that were found, and those that were clamped to 0 and 1.
#[derive(Clone, Copy, Debug, Default)]
struct Found {
    clamped: u64,
    extremes: Option<[f32; 2]>,
}

impl Found {
    fn and(self, other: Self) -> Self {
        let both = self.extremes.zip(other.extremes);
        let both = both.map(|(a, b)| [a[0].min(b[0]), a[1].max(b[1])]);
        Self {
            clamped: self.clamped + other.clamped,
            extremes: both.or(self.extremes).or(other.extremes),
        }
    }
}

impl ColorFields {
    /// The colours times an albedo, clamped to `[0,1]`, in the bricks of the extinction that a
    /// density has become; what is clamped is told. Between their own voxels colours are trilinear.
    pub(super) fn albedos(
        &self,
        (density, sigma_t): (&Field, &Grid),
        albedo: [f32; 3],
        path: &Path,
        files: &mut Files,
    ) -> Result<[Grid; 3]> {
        let bytes = sigma_t.bytes() as u64;
        memory::check("the albedo grid of a volume", bytes.saturating_mul(3))?;
        let own_from_voxel = self.own_from_voxel(density)?;
        let mut all = Found::default();
        let mut channel = |c: usize| {
            let (field, outside) = (&self.channels[c], self.background[c]);
            let read = |region: &Region, out: &mut [f32]| {
                files.cancel.check()?;
                resample(field, outside, &own_from_voxel, &region.voxels, out)?;
                to_albedos(region, albedo[c], out)
            };
            let (grid, found) = sigma_t.on_its_bricks(read)?;
            all = found.into_iter().fold(all, Found::and);
            Ok::<_, Error>(grid)
        };
        let grids = [channel(0)?, channel(1)?, channel(2)?];
        if let Some([low, high]) = all.extremes.filter(|_| all.clamped > 0) {
            let name = self.channels[0].name.as_deref().unwrap_or_default();
            files.warn(format!(
                "{}: {} albedos of the grid `{name}` are clamped to 0 and 1: they are from {low} \
                 to {high}",
                path.display(),
                all.clamped
            ));
        }
        Ok(grids)
    }

    /// The map from voxels of a density to those of the colours, both counted from their first;
    /// whole voxels where it is nothing else.
    fn own_from_voxel(&self, density: &Field) -> Result<DAffine3> {
        let own = &self.channels[0];
        let (Some(world_from_own), Some(world_from_density)) =
            (own.world_from_file, density.world_from_file)
        else {
            return Err(Error::input("a grid of colours without a place"));
        };
        let first =
            |field: &Field| DAffine3::from_translation(DVec3::from(field.first.map(|i| i as f64)));
        let map =
            first(own).inverse() * world_from_own.inverse() * world_from_density * first(density);
        let whole = DAffine3 {
            matrix3: DMat3::IDENTITY,
            translation: map.translation.round(),
        };
        let is_whole = (0..8).all(|i| {
            /// In voxels.
            const ROUNDING: f64 = 1e-3;
            let dims = density.dims;
            let corner =
                std::array::from_fn(|a| if i >> a & 1 == 1 { dims[a] as f64 } else { 0.0 });
            let off = map.transform_point3(DVec3::from(corner))
                - whole.transform_point3(DVec3::from(corner));
            off.abs().max_element() < ROUNDING
        });
        Ok(if is_whole { whole } else { map })
    }
}

/// The colours of a channel at the centres of a box of voxels.
fn resample(
    field: &Field,
    outside: f32,
    own_from_voxel: &DAffine3,
    voxels: &VoxelBox,
    out: &mut [f32],
) -> Result<()> {
    let at =
        |voxel: [usize; 3]| own_from_voxel.transform_point3(DVec3::from(voxel.map(|i| i as f64)));
    let corners = (0..8).map(|i| {
        at(std::array::from_fn(|a| {
            voxels.first[a] + (i >> a & 1) * (voxels.dims[a] - 1)
        }))
    });
    let (low, high) = corners.fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), p| {
        (low.min(p), high.max(p))
    });
    let end = DVec3::from(field.dims.map(|n| n as f64)) - 1.0;
    let (low, high) = (low.floor().max(DVec3::ZERO), high.ceil().min(end));
    if !low.cmple(high).all() {
        out.fill(outside);
        return Ok(());
    }
    let whole = |p: DVec3| p.to_array().map(|v| v as usize);
    let first = whole(low);
    let own = VoxelBox {
        first,
        dims: whole(high - low + 1.0),
    };
    if own.count() > MOST_VOXELS {
        return Err(
            Error::input("its voxels are far smaller than those of the density")
                .hint("resample it to the voxels of the density"),
        );
    }
    let mut colors = vec![0.0; own.count()];
    field.read(&own, &mut colors)?;
    let color = |voxel: [i64; 3]| {
        let local: [i64; 3] = std::array::from_fn(|a| voxel[a] - first[a] as i64);
        let is_there = (0..3).all(|a| (0..own.dims[a] as i64).contains(&local[a]));
        let [x, y, z] = local.map(|v| v as usize);
        match is_there {
            true => colors[(z * own.dims[1] + y) * own.dims[0] + x],
            false => outside,
        }
    };
    for (sample, voxel) in out.iter_mut().zip(voxels.voxels()) {
        let p = at(voxel);
        let (base, f) = (p.floor(), (p - p.floor()).as_vec3());
        let base = base.to_array().map(|v| v as i64);
        let corner = |i: usize| color(std::array::from_fn(|a| base[a] + (i >> a & 1) as i64));
        *sample = match f == glam::Vec3::ZERO {
            true => color(base),
            false => (0..8)
                .map(|i| {
                    let weight = |a: usize| if i >> a & 1 == 1 { f[a] } else { 1.0 - f[a] };
                    corner(i) * (weight(0) * weight(1) * weight(2))
                })
                .sum(),
        };
    }
    Ok(())
}

/// Makes albedos of the colours of a region.
fn to_albedos(region: &Region, albedo: f32, colors: &mut [f32]) -> Result<Found> {
    let mut found = Found::default();
    for (value, voxel) in colors.iter_mut().zip(region.voxels.voxels()) {
        let product = *value * albedo;
        if !product.is_finite() {
            return Err(Error::input(format!(
                "expected colours that are finite, found {value}"
            )));
        }
        *value = product.clamp(0.0, 1.0);
        let is_own = (0..3).all(|a| voxel[a] < region.voxels.first[a] + region.own[a]);
        if *value != product && is_own {
            found.clamped += 1;
            let [low, high] = found.extremes.unwrap_or([product; 2]);
            found.extremes = Some([low.min(product), high.max(product)]);
        }
    }
    Ok(found)
}

//! Surfels where the rays of a camera meet surfaces, in a frustum a little
//! wider than the image.
//!
//! What the camera does not see does not bleed. Area sampling serves better; this is for
//! comparison.

use super::surfels::SurfelMaker;
use super::{BATCH_SURFELS, Settings, check_surfels, share};
use crate::Result;
use crate::light::Shadows;
use crate::math::Ray;
use crate::math::magnitude::to_unit;
use crate::run::Job;
use crate::scene::{Camera, Film};
use glam::Vec3;
use lvox_formats::CloudWriter;
use lvox_formats::record::Surfel;
use rayon::prelude::*;
use std::ops::Range;

/// A ray that grazes a surface this flatly stands for no more area than one at this cosine.
const MIN_COS: f32 = 0.05;

/// Bakes one surfel for each ray that hits.
pub fn bake<S: Shadows>(
    maker: &SurfelMaker<S>,
    camera: &Camera,
    rate: f32,
    overscan: f32,
    settings: &Settings,
    writer: &mut CloudWriter,
    job: &Job,
) -> Result<()> {
    let film = maker.tracer.scene.film;
    let size = |n: u32| (n as f32 * rate * overscan).ceil().max(1.0) as u32;
    let wide = Film {
        width: size(film.width),
        height: size(film.height),
        ..film
    };
    let camera = Camera {
        fov_x_rad: 2.0 * libm::atanf(libm::tanf(0.5 * camera.fov_x_rad) * overscan),
        ..camera.clone()
    };
    let axis = camera.scene_from_camera.transform_vector3(-Vec3::Z);
    let pixel = 2.0 * libm::tanf(0.5 * camera.fov_x_rad) / wide.width as f32;
    let count = u64::from(wide.width) * u64::from(wide.height);
    let Range { start, end } = share(count, settings.part);
    let task = job.progress.task("surfels", end - start, "rays");
    let mut from = start;
    while from < end {
        job.cancel.check()?;
        let to = (from + BATCH_SURFELS).min(end);
        let batch: Vec<Option<Surfel>> = (from..to)
            .into_par_iter()
            .map(|i| {
                job.cancel.check()?;
                let (x, y) = (
                    (i % u64::from(wide.width)) as f32,
                    (i / u64::from(wide.width)) as f32,
                );
                let direction = camera.direction(&wide, x + 0.5, y + 0.5);
                let hit = maker
                    .tracer
                    .closest_seen(&Ray::endless(camera.origin(), direction));
                let Some(hit) = hit else {
                    return Ok(None);
                };
                let mesh = &maker.tracer.scene.mesh;
                let across = mesh.area_vector(hit.triangle as usize);
                // Its square may leave the range of f32.
                let normal = (across * to_unit(across.abs().max_element())).normalize_or_zero();
                // The pixel's square on the image plane, cast onto the surface.
                let cos = normal.dot(direction).abs().max(MIN_COS);
                let depth_cos = axis.dot(direction);
                let area = hit.t * hit.t * pixel * pixel * depth_cos.powi(3) / cos;
                let surfel = maker.make(hit.triangle, hit.uv, area, settings.overlap, i);
                Ok(Some(surfel))
            })
            .collect::<Result<_>>()?;
        let batch: Vec<Surfel> = batch.into_iter().flatten().collect();
        check_surfels(&batch)?;
        writer.push_surfels(&batch)?;
        task.add(to - from);
        from = to;
    }
    Ok(())
}

//! scene → cloud: samples surfaces into surfels and media into lvoxels, each with its direct light.
//!
//! In: a scene and [`Settings`]. Out: a cloud file.
//!
//! - `surfels`: where surfels are on all surfaces, and the light that leaves them; `count`: how
//!   many a scene asks for; `camera`: where the rays of a camera meet surfaces, instead.
//! - `creases`: where the disks of surfels end.
//! - `lvoxels`: blocks of media, their extinction and their light; `brick`: the field that they are
//!   means of; `cover`: how deep they lie in media.
//! - `memory`: what a bake holds, told before the work; `plan`: what it writes and takes, by a
//!   pilot.
//! - `prepared`: what points are made with.
//!
//! Points are made in batches, in a fixed order, each from its own number alone, and go straight to
//! the file: memory does not grow with the cloud, and the bytes do not depend on threads.

mod brick;
mod camera;
mod count;
mod cover;
mod creases;
mod lvoxels;
mod memory;
mod plan;
mod prepared;
mod surfels;

use crate::math::{Rgb, Spectrum, unflatten};
pub use crate::run::Part;
use crate::run::{Job, Walked};
use crate::scene::{GROUP_SETTING, Scene, Volume};
use crate::{Error, Result};
use glam::DAffine3;
use lvox_formats::record::{Lvoxel, MAX_VOLUMES, Surfel, VolumeInfo};
use lvox_formats::{Cloud, CloudMeta, CloudSummary, CloudWriter, Overwrite};
pub use lvoxels::BlockSize;
use lvoxels::LvoxelMaker;
pub use plan::{Plan, plan};
use prepared::Prepared;
use rayon::prelude::*;
use std::ops::Range;
use std::path::Path;
use surfels::SurfelSource;

/// Settings of a bake.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// Sampling of surfaces.
    pub surfels: SurfelSampling,
    /// Disk radius over that of a disk of the surfel's area: more overlap leaves fewer holes and
    /// blurs more.
    pub overlap: f32,
    /// Facets that meet at more than this end each other's disks, degrees.
    pub crease_deg: f32,
    /// Voxels a side of lvoxels: everywhere the same, or by optical depth.
    pub blocks: BlockSize,
    /// Shadow rays to each area light, at each point and side.
    pub shadow_rays: u32,
    /// Key of all random choices.
    pub seed: u64,
    /// The part of the bake that is made.
    pub part: Part,
}

/// The sampling of surfaces by surfels.
#[derive(Clone, Debug, PartialEq)]
pub enum SurfelSampling {
    /// Spread over the area of all surfaces: 500,000, or 125,000 where the direct light of
    /// neighbours differs little.
    ByLight,
    /// About `count` surfels, spread over the area of all surfaces.
    Area {
        /// Number of surfels. A piece so large that it would take nearly all leaves a tenth for the
        /// others.
        count: u64,
    },
    /// One where each ray of a camera meets a surface: what the camera does not see does not bleed.
    Camera {
        /// Name of the camera; the scene's first if `None`.
        name: Option<String>,
        /// Rays per pixel along each axis.
        rate: f32,
        /// Frustum width over the image's.
        overscan: f32,
    },
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            surfels: SurfelSampling::ByLight,
            overlap: 1.8,
            crease_deg: 8.0,
            blocks: BlockSize::OpticalDepth(0.7),
            shadow_rays: 1,
            seed: 0,
            part: Part::WHOLE,
        }
    }
}

/// Bricks whose lvoxels are made between two writes.
const BATCH_BRICKS: usize = 1024;
/// Surfels that are made between two writes.
const BATCH_SURFELS: u64 = 65_536;

/// Refuses a bake that takes more than the job's limit. Returns the bytes that it holds, which do
/// not grow with the cloud.
///
/// # Errors
/// [`crate::Kind::Input`] with both sizes.
pub fn check_memory(scene: &Scene, settings: &Settings, job: &Job) -> Result<u64> {
    Ok(memory::check(scene, settings, job)?.bytes())
}

/// Bakes a scene into a cloud file.
///
/// # Errors
/// A setting out of range, a memory limit below what the scene and a batch of points take, more
/// volumes or blocks than a cloud can number, an output that cannot be written, a disk that cannot
/// hold a large cloud, or a stop on request; then no file is left.
pub fn run(
    scene: &Scene,
    settings: &Settings,
    cloud: &Path,
    overwrite: Overwrite,
    job: &Job,
) -> Result<CloudSummary> {
    check_input(scene, settings)?;
    job.hold(&memory::check(scene, settings, job)?);
    match scene.volumes.iter().all(Volume::is_grey) {
        true => bake_among::<f32>(scene, settings, cloud, overwrite, job),
        false => bake_among::<Rgb>(scene, settings, cloud, overwrite, job),
    }
}

fn check_input(scene: &Scene, settings: &Settings) -> Result<()> {
    settings.check()?;
    check_volume_count(scene.volumes.len())?;
    let mut volumes = scene.volumes.iter();
    volumes.try_for_each(|volume| settings.blocks.check(volume))
}

/// Bakes a scene of media that are grey, or of such as have colour.
fn bake_among<K: Spectrum>(
    scene: &Scene,
    settings: &Settings,
    cloud: &Path,
    overwrite: Overwrite,
    job: &Job,
) -> Result<CloudSummary> {
    job.stage("bake", |counts| {
        let mut writer = CloudWriter::create(cloud, origin(scene, settings)?, overwrite)?;
        let (of_surfels, of_lvoxels) =
            Prepared::<K>::with(scene, settings, job, |prepared, kept| {
                let mut before = Walked::default();
                prepared.with_surfels(|source| {
                    plan::check_room(prepared, source, cloud)?;
                    before = Walked::so_far();
                    bake_surfels(source, settings.part, &mut writer, job)
                })?;
                let between = Walked::so_far();
                for maker in prepared.lvoxel_makers() {
                    bake_volume(&maker, settings.part, &mut writer, job)?;
                }
                let of_lvoxels = Walked::so_far() - between;
                Ok((between - before, of_lvoxels + kept))
            })?;
        scene.check_file()?;
        let summary = writer.finish()?;
        counts.insert("surfels".into(), summary.sums.surfels as f64);
        counts.insert("lvoxels".into(), summary.sums.lvoxels() as f64);
        for (name, count) in [
            ("rays_of_surfels", of_surfels.rays),
            ("cells_of_surfels", of_surfels.cells),
            ("rays_of_lvoxels", of_lvoxels.rays),
            ("cells_of_lvoxels", of_lvoxels.cells),
        ] {
            counts.insert(name.into(), count as f64);
        }
        Ok(summary)
    })
}

fn check_volume_count(count: usize) -> Result<()> {
    if count > MAX_VOLUMES {
        return Err(Error::input(format!(
            "the scene has {count} volumes, more than the {MAX_VOLUMES} that a cloud can number"
        ))
        .hint("join volumes, or bake the scene in parts"));
    }
    Ok(())
}

fn bake_surfels(
    source: &SurfelSource,
    part: Part,
    writer: &mut CloudWriter,
    job: &Job,
) -> Result<()> {
    let Range { start, end } = share(source.samples, part);
    let task = job.progress.task("surfels", end - start, source.unit);
    let mut from = start;
    while from < end {
        job.cancel.check()?;
        let to = (from + BATCH_SURFELS).min(end);
        let batch = source.batch(from..to, &job.cancel)?;
        writer.push_surfels(&batch)?;
        task.add(to - from);
        from = to;
    }
    Ok(())
}

/// The samples of a part, in whole batches.
fn share(samples: u64, part: Part) -> Range<u64> {
    let batches = part.of(samples.div_ceil(BATCH_SURFELS));
    let sample = |batch: u64| (batch * BATCH_SURFELS).min(samples);
    sample(batches.start)..sample(batches.end)
}

/// Refuses surfels that 32-bit floats cannot hold: no file is at fault, least of all the cloud.
fn check_surfels(surfels: &[Surfel]) -> Result<()> {
    for s in surfels {
        let place = || format!("the surfel at {:?}", s.position);
        if s.radius == 0.0 {
            return Err(Error::input(format!(
                "{}: expected an area that 32-bit floats hold, found {:e}",
                place(),
                s.area
            ))
            .hint("enlarge the meshes by `scale`, or bake fewer `surfels`"));
        }
        if !s.front.iter().chain(&s.back).all(|v| v.is_finite()) {
            return Err(too_bright(&place()));
        }
    }
    Ok(())
}

fn check_lvoxels(lvoxels: &[Lvoxel], volume: &str) -> Result<()> {
    let is_held = |v: &Lvoxel| v.source.iter().all(|c| c.is_finite());
    match lvoxels.iter().find(|v| !is_held(v)) {
        None => Ok(()),
        Some(v) => Err(too_bright(&format!(
            "the volume {volume:?}: the lvoxel at {:?}",
            v.block
        ))),
    }
}

fn too_bright(place: &str) -> Error {
    Error::input(format!(
        "{place}: the light that reaches it is more than 32-bit floats hold"
    ))
    .hint("make lights darker, or move them away")
}

fn bake_volume<K: Spectrum>(
    maker: &LvoxelMaker<K>,
    part: Part,
    writer: &mut CloudWriter,
    job: &Job,
) -> Result<()> {
    let bricks = maker.bricks();
    let own = part.of((bricks[0] * bricks[1] * bricks[2]) as u64);
    let (start, end) = (own.start as usize, own.end as usize);
    let task = job.progress.task("lvoxels", (end - start) as u64, "bricks");
    for from in (start..end).step_by(BATCH_BRICKS) {
        job.cancel.check()?;
        let to = (from + BATCH_BRICKS).min(end);
        let batch: Vec<Vec<Lvoxel>> = (from..to)
            .into_par_iter()
            .map(|b| maker.make(unflatten(b, bricks), &job.cancel))
            .collect::<Result<_>>()?;
        for lvoxels in batch {
            check_lvoxels(&lvoxels, &maker.volume.name)?;
            writer.push_lvoxels(&lvoxels)?;
        }
        task.add((to - from) as u64);
    }
    Ok(())
}

/// Whether a cloud was baked with these settings from a scene that is this one in all that matters
/// to a bake: cameras, film and names may be others.
///
/// # Errors
/// A file that is no whole cloud, or an unknown camera.
pub fn has_made(cloud: &Path, scene: &Scene, settings: &Settings) -> Result<bool> {
    let found = Cloud::open_path(cloud)?;
    let expected = origin(scene, settings)?;
    let found = CloudMeta {
        scene_hash: expected.scene_hash,
        scene_name: expected.scene_name.clone(),
        ..found.meta().clone()
    };
    Ok(found == expected)
}

/// What the cloud of a scene says of its origin.
///
/// # Errors
/// An unknown camera.
pub fn origin(scene: &Scene, settings: &Settings) -> Result<CloudMeta> {
    let columns = |m: DAffine3| {
        [
            m.matrix3.x_axis,
            m.matrix3.y_axis,
            m.matrix3.z_axis,
            m.translation,
        ]
        .map(|c| c.to_array())
    };
    let (surfels_from, disk_overlap) = match &settings.surfels {
        SurfelSampling::ByLight | SurfelSampling::Area { .. } => (None, settings.overlap),
        SurfelSampling::Camera { name, .. } => (Some(scene.camera(name.as_deref())?), 0.0),
    };
    let mut listed = settings.listed();
    // A packed scene does not say which of its lights it has.
    listed.extend(
        scene
            .group
            .clone()
            .map(|group| (GROUP_SETTING.into(), group)),
    );
    listed.extend(scene.parts(surfels_from));
    Ok(CloudMeta {
        scene_hash: scene.hash,
        scene_name: scene.name.clone(),
        world_from_scene: scene.world_from_scene.to_array(),
        volumes: scene
            .volumes
            .iter()
            .map(|v| VolumeInfo {
                name: v.name.clone(),
                dims: v.sigma_t.dims().map(|n| n as u32),
                index_from_scene: columns(v.scene_from_index.inverse()),
                albedo: v.albedo,
                extinction_color: v.extinction_color,
            })
            .collect(),
        settings: listed,
        disk_overlap,
    })
}

impl Settings {
    /// Names and values, as they are kept in the cloud.
    #[must_use]
    pub fn listed(&self) -> Vec<(String, String)> {
        let mut list = Vec::new();
        let mut add = |name: &str, value: String| list.push((name.to_owned(), value));
        match &self.surfels {
            SurfelSampling::ByLight => add("surfels", "by light".into()),
            SurfelSampling::Area { count } => add("surfels", count.to_string()),
            SurfelSampling::Camera {
                name,
                rate,
                overscan,
            } => {
                add("surfels-from-camera", name.clone().unwrap_or_default());
                add("camera-rate", rate.to_string());
                add("overscan", overscan.to_string());
            }
        }
        add("overlap", self.overlap.to_string());
        add("crease-deg", self.crease_deg.to_string());
        match self.blocks {
            BlockSize::OpticalDepth(tau) => add("block-depth", tau.to_string()),
            BlockSize::Fixed { level, samples } => {
                add("block-voxels", (1 << level).to_string());
                add("block-samples", samples.to_string());
            }
        }
        add("shadow-rays", self.shadow_rays.to_string());
        add("seed", self.seed.to_string());
        if self.part != Part::WHOLE {
            add("part", self.part.to_string());
        }
        list
    }

    /// Refuses settings that make no sense.
    ///
    /// # Errors
    /// Names the setting, what it may be and what it was.
    pub fn check(&self) -> Result<()> {
        let within = |name: &str, value: f64, low: f64, high: f64| {
            if value >= low && value <= high {
                Ok(())
            } else {
                Err(Error::input(format!(
                    "{name} must be {low} to {high}, found {value}"
                )))
            }
        };
        match self.surfels {
            SurfelSampling::ByLight => {}
            SurfelSampling::Area { count } => within("`surfels`", count as f64, 1.0, 1e12)?,
            SurfelSampling::Camera { rate, overscan, .. } => {
                // As it was typed: the nearest f32 to 0.01 is below it.
                let typed = (f64::from(rate) * 1e6).round() / 1e6;
                within("`camera_rate`", typed, 0.01, 64.0)?;
                within("`overscan`", f64::from(overscan), 1.0, 4.0)?;
            }
        }
        within("`overlap`", f64::from(self.overlap), 0.1, 10.0)?;
        within("`crease_deg`", f64::from(self.crease_deg), 0.0, 180.0)?;
        within(
            "`bake_shadow_rays`",
            f64::from(self.shadow_rays),
            1.0,
            4096.0,
        )?;
        match self.blocks {
            BlockSize::OpticalDepth(tau) => within("`block_depth`", f64::from(tau), 1e-3, 1e6),
            BlockSize::Fixed { samples, .. } => {
                within("`block_samples`", f64::from(samples), 1.0, 4096.0)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn as_many_volumes_are_baked_as_a_cloud_can_hold() {
        for (count, is_baked) in [(MAX_VOLUMES, true), (MAX_VOLUMES + 1, false)] {
            let volume = VolumeInfo {
                name: String::new(),
                dims: [1; 3],
                index_from_scene: glam::DAffine3::IDENTITY.to_cols_array_2d(),
                albedo: [0.0; 3],
                extinction_color: [1.0; 3],
            };
            let meta = CloudMeta {
                volumes: vec![volume; count],
                ..CloudMeta::default()
            };
            let dir = tempfile::tempdir().unwrap();
            let writer = CloudWriter::create(&dir.path().join("a.lvc"), meta, Overwrite::Refuse);
            assert_eq!(writer.is_ok(), is_baked, "{count}");
            assert_eq!(check_volume_count(count).is_ok(), is_baked, "{count}");
        }
    }
}

//! tree + scene → scattered light: what arrives at vertices inside media, for all cameras, so that
//! no frame and no tile has to find it again.

use super::media::{self, InScatter, Made};
use super::settings::Settings as ShadeSettings;
use super::shot::{self, Request, Shot, Work};
use super::view::Seen;
use super::{Method, Quality};
use crate::gather::{Medium, NoMedia};
use crate::run::Job;
use crate::scene::{Scene, Volume};
use crate::tree::{OpenTree, Pages};
use crate::{Error, Result};
use glam::{DAffine3, DVec3};
use lvox_formats::record::VolumeInfo;
use lvox_formats::{MappedFile, Overwrite, Scatter, ScatterMeta, ScatterSummary, ScatterWriter};
use std::path::Path;

/// How to light media.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Settings {
    /// Gather rays at each vertex; four directions of sweeps for each.
    pub volume_samples: u32,
    /// A node seen under less than this, steradians, may stand for all below it, four times that
    /// for rays of media.
    pub max_solid_angle: f32,
    /// Shadow rays of each vertex to each light with an extent.
    pub shadow_rays: u32,
    /// Key of all random choices.
    pub seed: u64,
}

impl Default for Settings {
    fn default() -> Self {
        let best = ShadeSettings::of(Quality::Best);
        Self {
            volume_samples: best.volume_samples,
            max_solid_angle: best.max_solid_angle,
            shadow_rays: 16,
            seed: best.seed,
        }
    }
}

impl Settings {
    /// Refuses settings that make no sense.
    ///
    /// # Errors
    /// Names the setting, what it may be and what it was.
    pub fn check(&self) -> Result<()> {
        self.of_gathers().check()
    }

    /// What gathers see of them.
    pub(super) fn of_gathers(&self) -> ShadeSettings {
        ShadeSettings {
            volume_samples: self.volume_samples,
            max_solid_angle: self.max_solid_angle,
            shadow_rays: self.shadow_rays,
            // Which places are bright depends on what a camera sees.
            bright_patches: false,
            seed: self.seed,
            ..ShadeSettings::of(Quality::Good)
        }
    }

    /// Names and values, as they are kept in the file.
    fn listed(&self) -> Vec<(String, String)> {
        let entry = |name: &str, value: String| (name.to_owned(), value);
        vec![
            entry("volume-samples", self.volume_samples.to_string()),
            entry("max-solid-angle", self.max_solid_angle.to_string()),
            entry("shadow-rays", self.shadow_rays.to_string()),
            entry("seed", self.seed.to_string()),
        ]
    }
}

/// Lights the media of a scene from its tree, and writes their light to a file.
///
/// # Errors
/// A scene without media, a setting out of range, a tree in another frame than the scene
/// ([`Scene::in_frame`]), more vertices than the memory limit allows, a page that cannot be read, a
/// file that cannot be written, or a stop on request.
pub fn run(
    scene: &Scene,
    store: &OpenTree,
    output: &Path,
    settings: &Settings,
    overwrite: Overwrite,
    job: &Job,
) -> Result<ScatterSummary> {
    settings.check()?;
    if scene.volumes.is_empty() {
        return Err(Error::input("the scene has no volumes to light")
            .hint("shade it from its tree: there is nothing to scatter"));
    }
    let of_tree = &store.tree().meta().cloud.volumes;
    check_volumes(of_tree, scene).map_err(|e| e.hint("bake the scene and build its tree again"))?;
    job.report.stage("scatter", |counts| {
        let mut listed = settings.listed();
        listed.extend(scene.parts(None));
        let meta = ScatterMeta {
            scene_hash: scene.hash,
            scene_name: scene.name.clone(),
            volumes: of_tree.clone(),
            tree_hash: store.tree().content_hash(),
            settings: listed,
        };
        let mut writer = ScatterWriter::create(output, meta, overwrite)?;
        let request = Request {
            settings: &settings.of_gathers(),
            regions: &[],
            parts: &[],
            job,
        };
        let (lit, _) = shot::work(scene, store, &request, &Lighting { settings })?;
        for (volume, lit) in lit.iter().enumerate() {
            media::pack(lit, volume, &mut writer)?;
        }
        let blocks = writer.vertices();
        let summary = writer.finish()?;
        counts.insert("vertices".into(), blocks as f64);
        Ok(summary)
    })
}

/// Lighting of media for any camera.
struct Lighting<'a> {
    settings: &'a Settings,
}

impl Work for Lighting<'_> {
    /// By volume.
    type Made = Vec<Made>;

    fn in_vacuum<P: Pages>(&self, _: &Shot<P, NoMedia>) -> Result<Self::Made> {
        Ok(Vec::new())
    }

    fn in_media<P: Pages, M: Medium>(&self, shot: &Shot<P, M>) -> Result<Self::Made> {
        let (gatherer, job) = (shot.volume_gatherer(), shot.request.job);
        let light = media::Light {
            lights: shot.lights,
            gatherer: Some(&gatherer),
            beforehand: None,
        };
        let in_scatter = InScatter::new(&shot.view, Seen::All, &light, job)?
            .with_vertex_rays(self.settings.shadow_rays);
        let lit = in_scatter.light_all(job)?;
        shot.gatherer.pages.check()?;
        Ok(lit)
    }
}

/// Refuses light that does not fit a scene, or settings that it does not fit.
///
/// # Errors
/// Says what was expected and what to do.
pub fn check(scatter: &Scatter<MappedFile>, scene: &Scene, settings: &ShadeSettings) -> Result<()> {
    if settings.method != Method::Extended || settings.max_dist.is_some_and(f32::is_finite) {
        return Err(Error::input(
            "scattered light is that of all surfaces and media, however far: it does not go with --method traditional and \
             --max-dist",
        )
        .hint("leave out --scatter, or those"));
    }
    check_volumes(&scatter.meta().volumes, scene)
        .map_err(|e| e.hint("make the scattered light again: lvox scatter"))
}

/// Vertices stand on the grids of volumes.
fn check_volumes(found: &[VolumeInfo], scene: &Scene) -> Result<()> {
    let volumes = &scene.volumes;
    if volumes.len() == found.len()
        && volumes
            .iter()
            .zip(found)
            .all(|(v, info)| is_grid_of(info, v))
    {
        return Ok(());
    }
    let list = |volumes: Vec<String>| match volumes[..] {
        [] => "none".to_owned(),
        _ => volumes.join(", "),
    };
    let text = |name: &str, dims: &dyn std::fmt::Debug| format!("{name:?} of {dims:?} voxels");
    let expected = volumes.iter().map(|v| text(&v.name, &v.sigma_t.dims()));
    let found = found.iter().map(|v| text(&v.name, &v.dims));
    Err(Error::input(format!(
        "expected the light of the scene's volumes at their places ({}), found that of others ({})",
        list(expected.collect()),
        list(found.collect())
    )))
}

/// Whether a volume is a grid of as many voxels in the same place, but for the rounding of a scene
/// whose frame was another.
fn is_grid_of(info: &VolumeInfo, volume: &Volume) -> bool {
    /// In voxels.
    const ROUNDING: f64 = 1e-3;
    let dims = volume.sigma_t.dims().map(|n| n as u32);
    let index_from_scene = DAffine3::from_cols_array_2d(&info.index_from_scene);
    let difference = index_from_scene * volume.scene_from_index;
    let is_kept = |i: u32| {
        let corner = DVec3::from(std::array::from_fn(|a| f64::from((i >> a & 1) * dims[a])));
        let off = difference.transform_point3(corner) - corner;
        off.abs().max_element() < ROUNDING
    };
    info.dims == dims && (0..8).all(is_kept)
}

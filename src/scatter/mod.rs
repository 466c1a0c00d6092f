//! tree + scene → scattered light: what arrives at vertices inside media, for all cameras, so
//! that no frame and no tile has to find it again.
//!
//! A scene with volumes and the open tree of its cloud enter; a file of scattered light leaves,
//! which `shade` reads. `settings` says how, `pack` turns the light of vertices into parts of the
//! file; how media are lit is for `inscatter`.

mod pack;
mod settings;

use crate::gather::{self, Gatherer, Medium, PatchRadiance, RayKernel, TreeTask};
use crate::inscatter::{self, InScatter, MediaLights, VolumeLight};
use crate::light::{Lights, SceneMedia, SoftShadowMedia};
use crate::run::Job;
use crate::scene::Scene;
use crate::trace::Tracer;
use crate::tree::{OpenTree, SurfelStore};
use crate::view::{self, View, VisibleMedia};
use crate::{Error, Result};
use lvox_formats::{Overwrite, Scatter, ScatterMeta, ScatterSummary, ScatterWriter};
use std::path::Path;

pub use settings::Settings;

/// Refuses scattering that would take more than the job's limit whatever the caches of the tree
/// do. Returns the bytes that it holds beside the tree, for [`OpenTree::beside`].
///
/// # Errors
/// [`crate::Kind::Input`] with both sizes.
pub fn check_memory(scene: &Scene, job: &Job) -> Result<u64> {
    let media = view::bytes_of_media(&scene.volumes, None)
        + scene.bytes_of_other_grids()
        + inscatter::bytes_for(scene, |v| View::is_of_small_voxels(v, None));
    let budget = (scene.budget(media, job))
        .with("what rays need of it", Tracer::bytes_for(scene))
        .with(
            "light of surfaces",
            PatchRadiance::bytes_for(scene.mesh.triangles.len(), 0),
        );
    let what = "scattering light in this scene";
    budget.within(what, job.memory_limit, "raise `memory_limit`")?;
    job.hold(&budget);
    Ok(budget.bytes())
}

/// Lights the media of a scene from its tree, and writes their light to a file. Of a scene without
/// media that names empty volumes, or is at a frame, it is a file without light, as it is of media
/// alone whose light differs with the camera: others of its frames may have light.
///
/// # Errors
/// A scene without media otherwise, a setting out of range, a tree in another frame than the scene
/// ([`Scene::in_frame`]), more vertices than the memory limit allows, a page that cannot be read, a
/// file that cannot be written, or a stop on request.
pub fn run(
    scene: &Scene,
    tree: &OpenTree,
    output: &Path,
    settings: &Settings,
    overwrite: Overwrite,
    job: &Job,
) -> Result<ScatterSummary> {
    settings.check()?;
    let is_lit = has_lit_media(scene, job)?;
    let of_tree = &tree.tree().meta().cloud.volumes;
    inscatter::check_volumes(of_tree, scene)
        .map_err(|e| e.hint("bake the scene and build its tree again"))?;
    view::check_frame(scene, tree.tree().meta().cloud.world_from_scene)?;
    inscatter::check_colors(of_tree, scene)?;
    if !is_lit {
        let meta = meta(scene, tree, settings);
        return Ok(ScatterWriter::create(output, meta, overwrite)?.finish()?);
    }
    check_memory(scene, job)?;
    job.watched_stage("scatter", tree.fitter(job), |counts| {
        let meta = meta(scene, tree, settings);
        let mut writer = ScatterWriter::create(output, meta, overwrite)?;
        let lighting = Lighting {
            scene,
            tree,
            settings,
            job,
        };
        let lit = gather::with_tree(tree, lighting)?;
        for (volume, light) in lit.iter().enumerate() {
            pack::pack(light, volume, &mut writer)?;
        }
        let vertices = writer.vertices();
        let summary = writer.finish()?;
        counts.insert("vertices".into(), vertices as f64);
        Ok(summary)
    })
}

/// What scattered light says of its origin.
fn meta(scene: &Scene, tree: &OpenTree, settings: &Settings) -> ScatterMeta {
    let mut listed = settings.listed();
    listed.extend(scene.parts(None));
    ScatterMeta {
        scene_hash: scene.hash,
        scene_name: scene.name.clone(),
        volumes: tree.tree().meta().cloud.volumes.clone(),
        tree_hash: tree.tree().content_hash(),
        settings: listed,
    }
}

/// Whether a file has the light that media of this scene scatter, made with these settings from
/// this tree; cameras, film and names of the scene may be others.
///
/// # Errors
/// A file that is no whole file of scattered light.
pub fn has_made(
    output: &Path,
    scene: &Scene,
    tree: &OpenTree,
    settings: &Settings,
) -> Result<bool> {
    let found = Scatter::open_path(output)?;
    let expected = meta(scene, tree, settings);
    let found = ScatterMeta {
        scene_hash: expected.scene_hash,
        scene_name: expected.scene_name.clone(),
        ..found.meta().clone()
    };
    Ok(found == expected)
}

/// Whether there are volumes whose light is the same for all cameras. Tells of others, and refuses
/// a scene of such alone, or of none, unless it names volumes that are empty or is at a frame, as
/// others of its frames may have them.
fn has_lit_media(scene: &Scene, job: &Job) -> Result<bool> {
    let others_may = scene.frame.is_some() || scene.has_empty_volumes;
    let is_none = |error: Error| match others_may {
        true => {
            job.progress.say(&format!("nothing to scatter: {error}"));
            Ok(false)
        }
        false => Err(error),
    };
    if scene.volumes.is_empty() {
        return is_none(
            Error::input("the scene has no volumes to light")
                .hint("shade it from its tree: there is nothing to scatter"),
        );
    }
    let differ = scene.volumes.iter().filter(|v| !v.phase.is_isotropic());
    let differ: Vec<&str> = differ.map(|v| v.name.as_str()).collect();
    if differ.is_empty() {
        return Ok(true);
    }
    if differ.len() == scene.volumes.len() {
        return is_none(
            Error::input(
                "what the volumes of this scene scatter differs with the camera: \
                 they have phase functions",
            )
            .hint("shade it from its tree: there is nothing to scatter for all cameras"),
        );
    }
    job.progress.warn(&format!(
        "left out, as what they scatter differs with the camera: {}",
        differ.join(", ")
    ));
    Ok(true)
}

/// Lighting of the media of a scene for any camera.
struct Lighting<'a> {
    scene: &'a Scene,
    tree: &'a OpenTree,
    settings: &'a Settings,
    job: &'a Job,
}

impl TreeTask for Lighting<'_> {
    /// By volume.
    type Output = Result<Vec<VolumeLight>>;

    fn run<M: Medium>(self, pages: &SurfelStore, media: M) -> Self::Output {
        let Self {
            scene,
            tree,
            settings,
            job,
        } = self;
        let adapted = view::media_of_all_cameras(&scene.volumes)?;
        let volumes = adapted.as_deref().unwrap_or(&scene.volumes);
        let tracer = Tracer::with_volumes(scene, volumes, &job.cancel)?;
        let shadows = SoftShadowMedia::new(scene, volumes)?;
        let lights = Lights::<SceneMedia<M::Share>>::new(&tracer);
        let lights = lights.with_soft_shadows(shadows.as_ref());
        let patches = PatchRadiance::of_tree(&tracer, tree, 0)?;
        let on_surfaces = gather::RaySettings {
            samples: settings.volume_samples,
            max_solid_angle: settings.max_solid_angle,
            max_dist: f32::INFINITY,
            kernel: RayKernel::Traced(&patches),
            environment: lights.environment(),
            // Which patches are bright depends on what a camera sees.
            leave_out_bright: false,
        };
        let (media, incident) =
            inscatter::known_incident(&media, &scene.volumes, on_surfaces.max_dist);
        let gatherer = Gatherer {
            pages,
            media,
            settings: inscatter::gather_settings(on_surfaces, settings.volume_samples),
        };
        let light = MediaLights {
            lights: &lights,
            gatherer: Some(&gatherer),
            scattered: None,
            incident,
        };
        // Any camera will do: all media count as visible.
        let view = View::new(&tracer, scene.camera(None)?, scene.film, settings.seed);
        let in_scatter = InScatter::new(&view, VisibleMedia::All, &light, job)?
            .with_vertex_rays(settings.shadow_rays);
        let lit = in_scatter.light_all(job)?;
        pages.check()?;
        scene.check_file()?;
        Ok(lit)
    }
}

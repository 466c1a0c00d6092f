//! What a scene, a mesh or a volume file holds, as rendering reads it: `description` has what is
//! told, `text` prints it.

mod description;
mod text;

use crate::Result;
use crate::run::{Job, hex};
use crate::scene::load::{Contents, ContentsKind, GridValues, Settings, contents, has_contents};
use crate::scene::{
    Camera, EmissiveBlock, EmissiveVolume, EnvironmentImage, Light, Mesh, Scene, Texture, Volume,
};
pub use description::{
    CameraDescription, LensDescription, LightDescription, MaskDescription, MaterialDescription,
    MeshDescription, ReadFile, SceneDescription, Suggestion, TextureDescription, ValueHistogram,
    VolumeDescription, WorldBox,
};
use glam::{DVec3, Vec3};
use std::path::Path;

/// Reads a scene, mesh or volume file as rendering does by these settings, and describes it; `None`
/// if the name of the file is that of another kind. Warnings are in it; those before an error go to
/// the job's progress.
///
/// # Errors
/// As [`Scene::load`]: a file that could not be rendered.
pub fn scene(path: &Path, settings: &Settings, job: &Job) -> Result<Option<SceneDescription>> {
    if !has_contents(path) {
        return Ok(None);
    }
    let Contents {
        kind,
        scene,
        values,
    } = contents(path, settings, job)?;
    let origin = scene.world_from_scene;
    let is_whole = kind == ContentsKind::Scene;
    let textures = textures(&scene.textures);
    let mesh = mesh(&scene.mesh, origin);
    let volumes = scene.volumes.iter().zip(values);
    let volumes: Vec<_> = volumes
        .map(|(v, values)| volume(v, values, origin, kind))
        .collect();
    let packed = scene.packed_path().map(|p| p.display().to_string());
    let made_bytes = mesh.memory_bytes
        + textures.iter().map(|t| t.memory_bytes).sum::<u64>()
        + volumes.iter().map(|v| v.memory_bytes).sum::<u64>()
        + scene
            .environment_image
            .iter()
            .map(|i| i.bytes())
            .sum::<u64>();
    let lights = scene.lights.iter().map(|l| light(l, &scene));
    let lights = lights.chain(
        scene
            .environment_image
            .iter()
            .map(|i| environment_image(i, &scene)),
    );
    let emissive = scene.emissive.iter();
    let lights = lights.chain(emissive.filter_map(|e| emissive_volume(e, &scene)));
    let lights = lights.filter(|_| is_whole);
    let cameras = scene.cameras.iter().filter(|_| is_whole);
    Ok(Some(SceneDescription {
        file: path.display().to_string(),
        kind: match kind {
            ContentsKind::Scene => "scene",
            ContentsKind::Mesh => "mesh",
            ContentsKind::Volume => "volume",
        },
        name: scene.name.clone(),
        scene_hash: hex(&scene.hash),
        files: scene.files.iter().map(|p| read_file(p)).collect(),
        materials: materials(&scene),
        lights: lights.collect(),
        cameras: cameras.map(|c| camera(c, origin)).collect(),
        film: is_whole.then_some([scene.film.width, scene.film.height]),
        mesh,
        textures,
        volumes,
        memory_bytes: packed.as_ref().map_or(made_bytes, |_| scene.bytes()),
        packed,
        warnings: scene.warnings,
    }))
}

fn read_file(path: &Path) -> ReadFile {
    ReadFile {
        path: path.display().to_string(),
        bytes: std::fs::metadata(path).map_or(0, |m| m.len()),
    }
}

fn in_world(p: Vec3, origin: DVec3) -> [f64; 3] {
    (p.as_dvec3() + origin).to_array()
}

fn world_box(points: impl IntoIterator<Item = Vec3>, origin: DVec3) -> Option<WorldBox> {
    let points = points.into_iter().map(|p| (p, p));
    let ends = points.reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)));
    ends.map(|(min, max)| WorldBox {
        min: in_world(min, origin),
        max: in_world(max, origin),
    })
}

fn mesh(mesh: &Mesh, origin: DVec3) -> MeshDescription {
    let vertices = mesh.triangles[..mesh.flat_count()].iter().flatten();
    let vertices = vertices.map(|&v| mesh.positions[v as usize]);
    let instances = mesh.instances.list();
    let boxes = instances.iter().flat_map(|i| [i.bounds.min, i.bounds.max]);
    MeshDescription {
        triangles: mesh.triangle_count() as u64,
        stored_triangles: (!instances.is_empty()).then_some(mesh.triangles.len() as u64),
        instances: instances.len() as u64,
        degenerate_triangles: mesh.degenerate,
        vertices: mesh.positions.len() as u64,
        area: (0..mesh.flat_count())
            .map(|t| f64::from(mesh.area(t)))
            .chain(mesh.areas_of_instances().map(|(_, (_, area))| area))
            .sum(),
        bounds: world_box(vertices.chain(boxes), origin),
        has_normals: !mesh.normals.is_empty(),
        has_colors: !mesh.colors.is_empty(),
        has_uvs: !mesh.uvs.is_empty(),
        memory_bytes: mesh.bytes(),
    }
}

fn materials(scene: &Scene) -> Vec<MaterialDescription> {
    let mut found: Vec<_> = (scene.materials.iter())
        .map(|m| MaterialDescription {
            name: m.name.clone(),
            albedo: m.albedo,
            emission: m.emission,
            unseen: !m.is_seen,
            texture: m.texture,
            emission_texture: m.emission_texture,
            mask: m.mask.map(|mask| MaskDescription {
                opacity: mask.opacity,
                texture: mask.texture,
                cutoff: mask.cutoff,
            }),
            triangles: 0,
            area: 0.0,
        })
        .collect();
    for t in 0..scene.mesh.flat_count() {
        let material = &mut found[scene.mesh.material_of(t) as usize];
        material.triangles += 1;
        material.area += f64::from(scene.mesh.area(t));
    }
    for (material, (triangles, area)) in scene.mesh.areas_of_instances() {
        let material = &mut found[material as usize];
        material.triangles += triangles;
        material.area += area;
    }
    found
}

fn textures(textures: &[Texture]) -> Vec<TextureDescription> {
    let describe = |(i, t): (usize, &Texture)| {
        let first = textures[..i]
            .iter()
            .position(|other| t.shares_texels(other));
        TextureDescription {
            width: t.width,
            height: t.height,
            bits: t.bits(),
            shared_with: first.map(|i| i as u32),
            memory_bytes: if first.is_some() { 0 } else { t.bytes() },
        }
    };
    textures.iter().enumerate().map(describe).collect()
}

fn light(light: &Light, scene: &Scene) -> LightDescription {
    let origin = scene.world_from_scene;
    let (kind, position, direction, color) = match *light {
        Light::Point {
            position,
            intensity,
        } => ("point", Some(position), None, intensity),
        Light::Spot {
            position,
            direction,
            intensity,
            ..
        } => ("spot", Some(position), Some(direction), intensity),
        Light::Directional {
            direction,
            irradiance,
            ..
        } => ("directional", None, Some(direction), irradiance),
        Light::Environment { radiance } => ("environment", None, None, radiance),
    };
    LightDescription {
        kind,
        position: position.map(|p| in_world(p, origin)),
        direction: direction.map(|d| d.to_array()),
        color,
        unseen: !scene.is_environment_seen && matches!(light, Light::Environment { .. }),
    }
}

/// An emissive volume as the point that sends as much.
fn emissive_volume(volume: &EmissiveVolume, scene: &Scene) -> Option<LightDescription> {
    let whole = EmissiveBlock::joined(volume.blocks().iter())?;
    Some(LightDescription {
        kind: "emissive volume",
        position: Some(in_world(whole.centre, scene.world_from_scene)),
        direction: None,
        color: whole.intensity.0,
        unseen: false,
    })
}

fn environment_image(image: &EnvironmentImage, scene: &Scene) -> LightDescription {
    LightDescription {
        kind: "environment image",
        position: None,
        direction: None,
        color: image.mean().0,
        unseen: !scene.is_environment_seen,
    }
}

fn camera(camera: &Camera, origin: DVec3) -> CameraDescription {
    CameraDescription {
        name: camera.name.clone(),
        position: in_world(camera.origin(), origin),
        direction: (camera.scene_from_camera.transform_vector3(Vec3::NEG_Z)).to_array(),
        fov_x_deg: camera.fov_x_rad.to_degrees(),
        lens: camera.lens.map(|lens| LensDescription {
            aperture: lens.aperture,
            focus_distance: lens.focus_distance,
        }),
        shutter: camera.shutter,
    }
}

fn volume(
    volume: &Volume,
    values: GridValues,
    origin: DVec3,
    kind: ContentsKind,
) -> VolumeDescription {
    let grid = &volume.sigma_t;
    let axes = volume.scene_from_index.matrix3;
    let voxel_edges = [axes.x_axis, axes.y_axis, axes.z_axis].map(DVec3::length);
    let [width, _, _] = grid.dims();
    // Rows first: a sum of all voxels in f32 would lose the small ones.
    let rows = grid.means([width, 1, 1]);
    let row_mean = rows.iter().map(|m| f64::from(*m)).sum::<f64>() / rows.len().max(1) as f64;
    let voxels: u64 = values.dims.iter().map(|&n| n as u64).product();
    let in_grid: f64 = grid.dims().iter().map(|&n| n as f64).product();
    let edge = voxel_edges.into_iter().fold(0.0, f64::max);
    let sigma_t_sum = row_mean * in_grid;
    let padding = (grid.dims()[0] - values.dims[0]) / 2;
    VolumeDescription {
        name: volume.name.clone(),
        file: values.file.display().to_string(),
        grid: values.grid,
        patient_space: values.patient_space,
        dims: values.dims,
        first: values.first,
        voxels,
        active_voxels: values.active,
        negative_voxels: values.negative,
        min: values.min,
        max: values.max,
        active_mean: values.active_mean,
        histogram: ValueHistogram {
            from: values.histogram.from,
            to: values.histogram.to,
            counts: values.histogram.counts,
        },
        bounds: world_box(corners(volume, padding), origin).expect("a box has corners"),
        voxel_edges,
        albedo: volume.albedo,
        albedo_varies: volume.albedo_grid.is_some(),
        extinction_color: (!volume.is_grey()).then_some(volume.extinction_color),
        phase_g: match (volume.phase.is_isotropic(), volume.phase.mix()) {
            (true, _) => Vec::new(),
            (false, 1.0) => vec![volume.phase.lobes()[0]],
            _ => volume.phase.lobes().to_vec(),
        },
        phase_mix: volume.phase.mix(),
        sigma_t_max: grid.max(),
        sigma_t_mean: sigma_t_sum / voxels.max(1) as f64,
        voxel_depth_max: f64::from(grid.max()) * edge,
        voxel_depth_mean: sigma_t_sum / values.active.max(1) as f64 * edge,
        suggested: (values.suggested)
            .filter(|_| kind == ContentsKind::Volume)
            .map(|suggested| Suggestion {
                window: suggested.window,
                sigma_t_scale: suggested.sigma_t_scale(libm::cbrt(axes.determinant().abs())),
            }),
        memory_bytes: grid.bytes() as u64,
    }
}

/// Corners of the box of a volume without so many empty voxels on each side.
fn corners(volume: &Volume, padding: usize) -> [Vec3; 8] {
    let dims = volume.sigma_t.dims();
    std::array::from_fn(|i| {
        let ends = |a: usize| [padding, dims[a] - padding][i >> a & 1] as f64;
        let corner = DVec3::new(ends(0), ends(1), ends(2));
        volume.scene_from_index.transform_point3(corner).as_vec3()
    })
}

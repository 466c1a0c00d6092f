//! What a scene, a mesh or a volume file holds, as rendering reads it.

use super::text::{Table, bytes, count};
use crate::Result;
use crate::run::{Job, hex, one_line};
use crate::scene::load::{Contents, ContentsKind, GridValues, Settings, contents, has_contents};
use crate::scene::{
    Camera, EmissiveBlock, EmissiveVolume, EnvironmentImage, Light, Mesh, Scene, Texture, Volume,
};
use glam::{DVec3, Vec3};
use std::fmt;
use std::path::Path;

/// Description of a scene, mesh or volume file. The keys of its JSON do not change within a
/// version; positions are in world space, lengths in world units.
#[derive(Clone, Debug, serde::Serialize)]
pub struct SceneDescription {
    /// Path of the file, as given.
    pub file: String,
    /// `scene`, `mesh` or `volume`.
    pub kind: &'static str,
    /// Name of the scene.
    pub name: String,
    /// Identity of the scene: of the content of all files.
    pub scene_hash: String,
    /// The files that were read, that of the scene first.
    pub files: Vec<ReadFile>,
    /// All triangles.
    pub mesh: MeshDescription,
    /// Materials that triangles have.
    pub materials: Vec<MaterialDescription>,
    /// Textures, in the order that materials refer to.
    pub textures: Vec<TextureDescription>,
    /// Lights but emissive materials.
    pub lights: Vec<LightDescription>,
    /// Cameras, the default first; none of a mesh or volume file.
    pub cameras: Vec<CameraDescription>,
    /// Pixels across and down of a frame; none of a mesh or volume file.
    pub film: Option<[u32; 2]>,
    /// Volumes, one for each grid that was read.
    pub volumes: Vec<VolumeDescription>,
    /// Bytes of memory that triangles, textures and grids take.
    pub memory_bytes: u64,
    /// What was left out, and what was taken otherwise than the files say.
    pub warnings: Vec<String>,
}

/// A file that was read.
#[derive(Clone, Debug, serde::Serialize)]
pub struct ReadFile {
    /// Its path.
    pub path: String,
    /// Its length.
    pub bytes: u64,
}

/// A box along the axes of world space.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct WorldBox {
    /// Its least corner.
    pub min: [f64; 3],
    /// Its greatest corner.
    pub max: [f64; 3],
}

/// The triangles of a scene.
#[derive(Clone, Debug, serde::Serialize)]
pub struct MeshDescription {
    /// Triangles that have an area.
    pub triangles: u64,
    /// Triangles without area, which are left out.
    pub degenerate_triangles: u64,
    /// Vertices.
    pub vertices: u64,
    /// Sum of all areas.
    pub area: f64,
    /// Box around all triangles, if there are any.
    pub bounds: Option<WorldBox>,
    /// Whether vertices have normals, colours, texture coordinates.
    pub has_normals: bool,
    /// Whether any vertex has a colour.
    pub has_colors: bool,
    /// Whether any vertex has texture coordinates that a material uses.
    pub has_uvs: bool,
    /// Bytes of memory.
    pub memory_bytes: u64,
}

/// A material.
#[derive(Clone, Debug, serde::Serialize)]
pub struct MaterialDescription {
    /// Its name; may be empty.
    pub name: String,
    /// Diffuse albedo, a factor on the texture if there is one.
    pub albedo: [f32; 3],
    /// Emitted radiance, a factor on the texture if there is one.
    pub emission: [f32; 3],
    /// Number of its texture.
    pub texture: Option<u32>,
    /// Number of the texture of its emission.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub emission_texture: Option<u32>,
    /// Where it is there.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mask: Option<MaskDescription>,
    /// Triangles that have it.
    pub triangles: u64,
    /// The area of these.
    pub area: f64,
    /// Whether cameras do not see it.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub unseen: bool,
}

/// Where a material is there.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct MaskDescription {
    /// Opacity, a factor on the texture if there is one.
    pub opacity: f32,
    /// Number of that texture.
    pub texture: Option<u32>,
    /// The opacity from which on it is there; `None` for a share.
    pub cutoff: Option<f32>,
}

/// A texture.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct TextureDescription {
    /// Texels across.
    pub width: u32,
    /// Texels down.
    pub height: u32,
    /// Bits of each channel in memory.
    pub bits: u32,
    /// Index of the texture before it whose texels it has, if there is one.
    pub shared_with: Option<u32>,
    /// Bytes of memory; 0 if they are those of another texture.
    pub memory_bytes: u64,
}

/// A light.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct LightDescription {
    /// `point`, `spot`, `directional`, `environment` or `environment image`.
    #[serde(rename = "type")]
    pub kind: &'static str,
    /// Where it is, of a point or a spot.
    pub position: Option<[f64; 3]>,
    /// The way its light travels, of a spot or a sun.
    pub direction: Option<[f32; 3]>,
    /// Intensity of points and spots, irradiance of suns, radiance of environments, of images the
    /// mean over all directions.
    pub color: [f32; 3],
    /// Whether it is an environment that cameras do not see.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub unseen: bool,
}

/// A camera.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct CameraDescription {
    /// Its name.
    pub name: String,
    /// Where it is.
    pub position: [f64; 3],
    /// The way it looks.
    pub direction: [f32; 3],
    /// Full horizontal field of view in degrees.
    pub fov_x_deg: f32,
    /// Radius of the opening of its lens, and the distance of what is sharp; none of a pinhole.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lens: Option<LensDescription>,
    /// When its shutter opens and closes, in frames from that of the picture; none for a moment.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub shutter: Option<[f64; 2]>,
}

/// The lens of a camera.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct LensDescription {
    /// Radius of its opening.
    pub aperture: f32,
    /// Distance along the camera's axis of what is sharp.
    pub focus_distance: f32,
}

/// A volume: what is rendered, and the values in the file that it comes from.
#[derive(Clone, Debug, serde::Serialize)]
pub struct VolumeDescription {
    /// Its name.
    pub name: String,
    /// The file; `builtin:` shapes have their name.
    pub file: String,
    /// Name of the grid in a file of several.
    pub grid: Option<String>,
    /// The axes of a patient along which the file has its place, as `RAS`, if it says so.
    pub patient_space: Option<&'static str>,
    /// Voxels along each axis of the box that is read.
    pub dims: [usize; 3],
    /// Index in the file of the first voxel of the box.
    pub first: [i64; 3],
    /// Voxels of the box.
    pub voxels: u64,
    /// Voxels whose value is a number other than 0.
    pub active_voxels: u64,
    /// Voxels whose value is below 0.
    pub negative_voxels: u64,
    /// The least value in the file.
    pub min: f32,
    /// The greatest value in the file.
    pub max: f32,
    /// The mean of the values other than 0.
    pub active_mean: f64,
    /// Counts of the values other than 0 in bins of equal width.
    pub histogram: ValueHistogram,
    /// Box around it.
    pub bounds: WorldBox,
    /// Edges of a voxel.
    pub voxel_edges: [f64; 3],
    /// Single-scattering albedo.
    pub albedo: [f32; 3],
    /// Mean cosines of the lobes of the phase function; none if it is isotropic.
    pub phase_g: Vec<f32>,
    /// Weight of the first of two lobes, or 1.
    pub phase_mix: f32,
    /// The greatest extinction.
    pub sigma_t_max: f32,
    /// The mean extinction over the whole box.
    pub sigma_t_mean: f64,
    /// Optical depth of a voxel along its longest edge: greatest, and mean over the active ones.
    pub voxel_depth_max: f64,
    /// The mean of that over the active voxels.
    pub voxel_depth_mean: f64,
    /// What to write into a scene, of a volume file by itself.
    pub suggested: Option<Suggestion>,
    /// Bytes of memory.
    pub memory_bytes: u64,
}

/// Values of keys with which a volume can be seen into.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Suggestion {
    /// The values that are densities of 0 and 1.
    pub window: [f64; 2],
    /// Extinction per world unit where the density is 1.
    pub sigma_t_scale: f64,
}

/// Counts of values.
#[derive(Clone, Debug, serde::Serialize)]
pub struct ValueHistogram {
    /// Lower end of the first bin.
    pub from: f32,
    /// Upper end of the last bin.
    pub to: f32,
    /// Values in each bin.
    pub counts: Vec<u64>,
}

/// Reads a scene, mesh or volume file as rendering does by these settings, and describes it; `None` if the name of
/// the file is that of another kind. Warnings are in it; those before an error go to the job's
/// progress.
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
    let memory_bytes = mesh.memory_bytes
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
        memory_bytes,
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
    let vertices = mesh.triangles.iter().flatten();
    MeshDescription {
        triangles: mesh.triangles.len() as u64,
        degenerate_triangles: mesh.degenerate,
        vertices: mesh.positions.len() as u64,
        area: (0..mesh.triangles.len())
            .map(|t| f64::from(mesh.area(t)))
            .sum(),
        bounds: world_box(vertices.map(|&v| mesh.positions[v as usize]), origin),
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
    for (t, &material) in scene.mesh.material.iter().enumerate() {
        let material = &mut found[material as usize];
        material.triangles += 1;
        material.area += f64::from(scene.mesh.area(t));
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

/// A few digits of numbers, with spaces between.
fn brief<T: fmt::LowerExp + fmt::Display + Copy + Into<f64>>(numbers: &[T]) -> String {
    let number = |n: &T| {
        let value: f64 = (*n).into();
        match value.abs() {
            size if size != 0.0 && !(1e-3..1e7).contains(&size) => format!("{value:.4e}"),
            _ => {
                let text = format!("{value:.4}");
                text.trim_end_matches('0').trim_end_matches('.').to_owned()
            }
        }
    };
    numbers.iter().map(number).collect::<Vec<_>>().join(" ")
}

impl ValueHistogram {
    /// A bar for each bin, as high as the logarithm of its count.
    fn bars(&self) -> String {
        const BARS: [char; 9] = [' ', '▁', '▂', '▃', '▄', '▅', '▆', '▇', '█'];
        let most = self.counts.iter().copied().max().unwrap_or(0);
        let height = |n: u64| ((n as f64 + 1.0).ln() / (most as f64 + 1.0).ln() * 8.0).ceil();
        let bar = |n: &u64| BARS[(height(*n) as usize).min(8)];
        self.counts.iter().map(bar).collect()
    }
}

impl fmt::Display for WorldBox {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} to {}", brief(&self.min), brief(&self.max))
    }
}

impl fmt::Display for MaskDescription {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", brief(&[self.opacity]))?;
        if let Some(texture) = self.texture {
            write!(f, " of texture {texture}")?;
        }
        match self.cutoff {
            Some(cutoff) => write!(f, ", cut off below {}", brief(&[cutoff])),
            None => Ok(()),
        }
    }
}

impl fmt::Display for SceneDescription {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let memory = bytes(self.memory_bytes);
        writeln!(
            f,
            "{}: {}, {memory} in memory",
            one_line(&self.file),
            self.kind
        )?;
        writeln!(f, "scene '{}', {}", one_line(&self.name), self.scene_hash)?;
        let m = &self.mesh;
        write!(
            f,
            "{} triangles, {} vertices",
            count(m.triangles),
            count(m.vertices)
        )?;
        if m.degenerate_triangles > 0 {
            let left_out = count(m.degenerate_triangles);
            write!(f, ", {left_out} triangles without area are left out")?;
        }
        writeln!(f, ", {}", bytes(m.memory_bytes))?;
        if let Some(bounds) = &m.bounds {
            writeln!(f, "area {}, bounds {bounds}", brief(&[m.area]))?;
        }
        if let Some([width, height]) = self.film {
            writeln!(f, "film {width} x {height}")?;
        }
        self.fmt_tables(f)?;
        self.volumes.iter().try_for_each(|v| v.fmt(f))?;
        self.warnings
            .iter()
            .try_for_each(|w| writeln!(f, "warning: {w}"))
    }
}

impl SceneDescription {
    fn fmt_tables(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut files = Table::new(&["file", "bytes"]);
        for file in &self.files {
            files.row(vec![file.path.clone(), count(file.bytes)]);
        }
        let mut columns = vec![
            "material",
            "triangles",
            "area",
            "albedo",
            "emission",
            "texture",
        ];
        let has_masks = self.materials.iter().any(|m| m.mask.is_some());
        columns.extend(has_masks.then_some("opacity"));
        let mut materials = Table::new(&columns);
        for m in &self.materials {
            let texture = m.texture.map_or("-".into(), |t| t.to_string());
            let mut row = vec![
                format!("'{}'{}", m.name, unseen(m.unseen)),
                count(m.triangles),
                brief(&[m.area]),
                brief(&m.albedo),
                match m.emission_texture {
                    Some(t) => format!("{} x texture {t}", brief(&m.emission)),
                    None => brief(&m.emission),
                },
                texture,
            ];
            row.extend(has_masks.then(|| m.mask.map_or("-".into(), |mask| mask.to_string())));
            materials.row(row);
        }
        let mut textures = Table::new(&["texture", "texels", "bits", "bytes"]);
        for (i, t) in self.textures.iter().enumerate() {
            let texels = format!("{} x {}", t.width, t.height);
            textures.row(vec![
                i.to_string(),
                texels,
                t.bits.to_string(),
                match t.shared_with {
                    Some(other) => format!("those of {other}"),
                    None => count(t.memory_bytes),
                },
            ]);
        }
        let mut lights = Table::new(&["light", "colour", "position", "direction"]);
        for l in &self.lights {
            let position = l.position.map_or("-".into(), |p| brief(&p));
            let direction = l.direction.map_or("-".into(), |d| brief(&d));
            let kind = format!("{}{}", l.kind, unseen(l.unseen));
            lights.row(vec![kind, brief(&l.color), position, direction]);
        }
        let mut cameras = Table::new(&["camera", "position", "direction", "degrees across"]);
        for c in &self.cameras {
            cameras.row(vec![
                format!("'{}'", c.name),
                brief(&c.position),
                brief(&c.direction),
                brief(&[c.fov_x_deg]),
            ]);
        }
        for table in [files, materials, textures, lights, cameras] {
            if !table.is_empty() {
                write!(f, "{table}")?;
            }
        }
        Ok(())
    }
}

/// What follows the name of something that cameras do not see.
fn unseen(is_unseen: bool) -> &'static str {
    match is_unseen {
        true => " (unseen)",
        false => "",
    }
}

impl fmt::Display for VolumeDescription {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let grid = self
            .grid
            .as_ref()
            .map_or(String::new(), |g| format!(", grid '{}'", one_line(g)));
        let memory = bytes(self.memory_bytes);
        let (name, file) = (one_line(&self.name), one_line(&self.file));
        writeln!(f, "volume '{name}' of {file}{grid}, {memory}")?;
        let dims = self.dims.map(|n| n.to_string()).join(" x ");
        let share = 100.0 * self.active_voxels as f64 / self.voxels.max(1) as f64;
        let active = count(self.active_voxels);
        let first = self.first.map(|i| i.to_string()).join(" ");
        writeln!(
            f,
            "  voxels      {dims} from {first}, {active} active ({share:.1} %)"
        )?;
        writeln!(f, "  voxel edges {}", brief(&self.voxel_edges))?;
        if let Some(space) = self.patient_space {
            writeln!(
                f,
                "  patient     {space} in the file; unless the scene says otherwise left is x, superior y, anterior z"
            )?;
        }
        writeln!(f, "  bounds      {}", self.bounds)?;
        let (ends, mean) = (brief(&[self.min, self.max]), brief(&[self.active_mean]));
        let ends = ends.replace(' ', " to ");
        write!(f, "  values      {ends}, mean of the active {mean}")?;
        match self.negative_voxels {
            0 => writeln!(f)?,
            n => writeln!(f, ", {} below 0", count(n))?,
        }
        let h = &self.histogram;
        if !h.counts.is_empty() {
            let (from, to) = (brief(&[h.from]), brief(&[h.to]));
            writeln!(f, "  histogram   {from} |{}| {to}, logarithmic", h.bars())?;
        }
        let (most, mean) = (brief(&[self.sigma_t_max]), brief(&[self.sigma_t_mean]));
        let albedo = brief(&self.albedo);
        writeln!(
            f,
            "  sigma_t     at most {most}, mean of the box {mean}, albedo {albedo}"
        )?;
        match self.phase_g[..] {
            [] => {}
            [g] => writeln!(f, "  phase       mean cosine {g}")?,
            _ => writeln!(
                f,
                "  phase       mean cosines {}, mix {}",
                brief(&self.phase_g),
                self.phase_mix
            )?,
        }
        let (most, mean) = (
            brief(&[self.voxel_depth_max]),
            brief(&[self.voxel_depth_mean]),
        );
        writeln!(f, "  voxel depth at most {most}, mean of the active {mean}")?;
        match &self.suggested {
            None => Ok(()),
            Some(Suggestion {
                window: [low, high],
                sigma_t_scale,
            }) => writeln!(
                f,
                "  try         window = [{low}, {high}], sigma_t_scale = {sigma_t_scale}"
            ),
        }
    }
}

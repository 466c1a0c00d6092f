//! The scene file: from TOML tables to a [`SceneBuilder`]. `docs/scene.md` describes the schema.

use super::colors::ColorEncoding;
use super::field::{Field, Scale};
use super::files::{Files, beside, extension};
use super::samples::Number;
use super::table::{Document, Table};
use super::texture::Decoding;
use super::{builtin, environment, gltf, normals, nrrd, obj, ply, raw, texture, transform, vdb};
use crate::Result;
use crate::run::Cancel;
use crate::scene::builder::{
    CameraInput, DEFAULT_FILM, EnvironmentInput, LightInput, MAX_EMISSION, MeshInput, SceneBuilder,
    VolumeInput, is_singular,
};
use crate::scene::{Film, Light, PhaseFunction};
use glam::{DAffine3, DVec3};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

const FILM: [&str; 3] = ["width", "height", "exposure"];
const CAMERA: [&str; 6] = [
    "name",
    "position",
    "target",
    "up",
    "camera_to_world",
    "fov_x_deg",
];
const MESH: [&str; 14] = [
    "file",
    "name",
    "transform",
    "translate",
    "rotate_deg",
    "scale",
    "albedo",
    "texture",
    "palette",
    "color_encoding",
    "emission",
    "emits_both_sides",
    "normals",
    "import",
];
const LIGHT: [&str; 13] = [
    "type",
    "position",
    "direction",
    "target",
    "intensity",
    "inner_deg",
    "outer_deg",
    "irradiance",
    "angular_radius_deg",
    "radiance",
    "image",
    "rotate_deg",
    "sun",
];
/// The types of lights.
const LIGHT_TYPES: [&str; 4] = ["point", "spot", "directional", "environment"];
/// Those of [`LIGHT`] that a spot light has.
const SPOT: [&str; 6] = [
    "position",
    "direction",
    "target",
    "intensity",
    "inner_deg",
    "outer_deg",
];
const VOLUME: [&str; 18] = [
    "file",
    "name",
    "dims",
    "dtype",
    "endian",
    "grid",
    "sigma_t_scale",
    "value_scale",
    "window",
    "albedo",
    "g",
    "mix",
    "unitcube_to_world",
    "world_from_index",
    "transform",
    "translate",
    "rotate_deg",
    "scale",
];

/// Reads the scene file `path` with the content `text`, and all files that it names.
pub(super) fn read(text: &str, path: &Path, files: &mut Files) -> Result<SceneBuilder> {
    let document = Document::new(path, text);
    let parsed = document.parse()?;
    let root = document.root(
        &parsed,
        &["name", "film", "camera", "mesh", "light", "volume"],
    )?;
    let stem = path.file_stem().unwrap_or_default();
    let mut builder = SceneBuilder {
        name: match root.get("name") {
            Some(name) => name.text()?.into(),
            None => stem.to_string_lossy().into_owned(),
        },
        film: film(&root)?,
        ..SceneBuilder::default()
    };
    let mut names = BTreeSet::new();
    for table in root.tables("camera", &CAMERA)? {
        let camera = camera(&table, builder.cameras.len())?;
        if !names.insert(camera.name.clone()) {
            return Err(table.error(format_args!(
                "another camera has the name \"{}\" too",
                camera.name
            )));
        }
        builder.cameras.push(camera);
    }
    // The tables are checked before the first large file is read.
    let lights = root.tables("light", &LIGHT)?;
    let volumes = root.tables("volume", &VOLUME)?;
    for table in lights {
        match environment_image(&table, path, files)? {
            None => builder.lights.push(light(&table)?),
            Some(_) if builder.environment_image.is_some() => {
                return Err(table.error("another environment has an image, too"));
            }
            image => builder.environment_image = image,
        }
    }
    for table in root.tables("mesh", &MESH)? {
        let mesh = mesh(&table, path, &mut builder, files)?;
        builder.meshes.push(mesh);
    }
    for table in volumes {
        builder.volumes.extend(self::volumes(&table, path, files)?);
    }
    Ok(builder)
}

fn film(root: &Table<'_>) -> Result<Option<Film>> {
    let Some(item) = root.get("film") else {
        return Ok(None);
    };
    let table = item.table("[film]", &FILM)?;
    let side = |key: &str| -> Result<u32> {
        Ok(table.require(key)?.whole(1, Film::MAX_SIDE.into())? as u32)
    };
    Ok(Some(Film {
        width: side("width")?,
        height: side("height")?,
        exposure: match table.get("exposure") {
            Some(item) => {
                let (low, high) = (Film::EXPOSURES.start(), Film::EXPOSURES.end());
                item.number_within(*low, *high)? as f32
            }
            None => 1.0,
        },
    }))
}

fn camera(table: &Table<'_>, index: usize) -> Result<CameraInput> {
    for key in ["position", "target", "up"] {
        table.exclusive(&["camera_to_world", key])?;
    }
    let name = match table.get("name") {
        Some(name) => name.text()?.into(),
        None => format!("camera {}", index + 1),
    };
    let fov_x_deg = match table.get("fov_x_deg") {
        Some(item) => item.number_within(0.01, 179.0)?,
        None => 45.0,
    };
    let fov_x_rad = fov_x_deg.to_radians();
    if let Some(item) = table.get("camera_to_world") {
        return CameraInput::placed(name, item.affine()?, fov_x_rad).map_err(|e| item.error(e));
    }
    let position = table.require("position")?.vector()?;
    let target = table.require("target")?.vector()?;
    let up = match table.get("up") {
        Some(up) => up.vector()?,
        None => DVec3::Y,
    };
    CameraInput::look_at(name, position, target, up, fov_x_rad).map_err(|e| table.error(e))
}

/// Refuses keys of lights that one of this type does not have.
fn only(table: &Table<'_>, keys: &[&str]) -> Result<()> {
    for key in LIGHT {
        if key != "type" && !keys.contains(&key) && table.get(key).is_some() {
            return Err(table
                .error(format_args!("this type of light has no `{key}`"))
                .hint(format!("its keys are {}", keys.join(", "))));
        }
    }
    Ok(())
}

/// The image of an environment; `None` for lights without one.
fn environment_image(
    table: &Table<'_>,
    scene: &Path,
    files: &mut Files,
) -> Result<Option<EnvironmentInput>> {
    let kind = table.require("type")?.choice(&LIGHT_TYPES)?;
    let Some(image) = table
        .get("image")
        .filter(|_| LIGHT_TYPES[kind] == "environment")
    else {
        return Ok(None);
    };
    only(table, &["image", "radiance", "rotate_deg", "sun"])?;
    let scale = match table.get("radiance") {
        Some(item) => item.color(MAX_EMISSION)?,
        None => [1.0; 3],
    };
    let rotation_deg = match table.get("rotate_deg") {
        Some(item) => item.number_within(-360.0, 360.0)?,
        None => 0.0,
    };
    let keeps_suns = match table.get("sun") {
        Some(item) => item.choice(&["extract", "keep"])? == 1,
        None => false,
    };
    let path = beside(scene, image.text()?);
    let image = environment::load(&path, files).map_err(|e| table.locate(e))?;
    let image = image
        .scaled(scale)
        .rotated(rotation_deg.to_radians() as f32);
    let input = EnvironmentInput::new(image);
    Ok(Some(match keeps_suns {
        true => input.keeping_suns(),
        false => input,
    }))
}

fn light(table: &Table<'_>) -> Result<LightInput> {
    let color = |key: &str| table.require(key)?.color(MAX_EMISSION);
    let only = |keys: &[&str]| only(table, keys);
    let kind = table.require("type")?.choice(&LIGHT_TYPES)?;
    match LIGHT_TYPES[kind] {
        "point" => {
            only(&["position", "intensity"])?;
            let position = table.require("position")?.vector()?;
            Ok(LightInput::point(position, color("intensity")?))
        }
        "spot" => {
            only(&SPOT)?;
            spot(table)
        }
        "directional" => {
            only(&["direction", "irradiance", "angular_radius_deg"])?;
            let radius_deg = match table.get("angular_radius_deg") {
                Some(item) => item.number_within(0.0, 89.0)?,
                None => 0.0,
            };
            let direction = table.require("direction")?.direction()?;
            LightInput::sun(direction, color("irradiance")?, radius_deg.to_radians())
                .map_err(|e| table.error(e))
        }
        _ => {
            only(&["radiance", "image"])?;
            Ok(LightInput::environment(color("radiance")?))
        }
    }
}

fn spot(table: &Table<'_>) -> Result<LightInput> {
    table.exclusive(&["direction", "target"])?;
    let position = table.require("position")?.vector()?;
    let direction = match table.get("target") {
        Some(target) => (target.vector()? - position)
            .try_normalize()
            .ok_or_else(|| target.error("the light is at its own target"))?,
        None => table.require("direction")?.direction()?,
    };
    let outer = table.require("outer_deg")?;
    let outer_deg = outer.number_within(0.01, 180.0)?;
    let inner_deg = match table.get("inner_deg") {
        Some(inner) => inner.number_within(0.0, 180.0)?,
        None => 0.0,
    };
    let intensity = table.require("intensity")?.color(MAX_EMISSION)?;
    let (inner_rad, outer_rad) = (inner_deg.to_radians(), outer_deg.to_radians());
    LightInput::spot(position, direction, intensity, inner_rad, outer_rad).map_err(|_| {
        outer.error(format_args!(
            "expected more than the {inner_deg} of `inner_deg`, found {outer_deg}"
        ))
    })
}

/// The text of `file`, and its path unless it is built in.
fn named<'a>(table: &Table<'a>, scene: &Path) -> Result<(&'a str, PathBuf)> {
    let name = table.require("file")?.text()?;
    Ok((name, beside(scene, name)))
}

fn mesh(
    table: &Table<'_>,
    scene: &Path,
    builder: &mut SceneBuilder,
    files: &mut Files,
) -> Result<MeshInput> {
    let world_from_mesh = transform::from_keys(table)?;
    let (name, path) = named(table, scene)?;
    let mut mesh = match name.strip_prefix("builtin:") {
        Some(shape) => {
            file_keys(table, "")?;
            builtin::mesh(shape).map_err(|e| table.locate(e))?
        }
        None => mesh_file(table, &path, &world_from_mesh, builder, files)?,
    };
    files.cancel.check()?;
    mesh.check().map_err(|e| e.at(path.display()))?;
    mesh.place(&world_from_mesh);
    surface(table, scene, &mut mesh, files)?;
    files.cancel.check()?;
    shading_normals(table, &mut mesh, &files.cancel)?;
    files.cancel.check()?;
    // Placement can take finite positions out of range.
    mesh.check().map_err(|e| table.locate(e))?;
    Ok(mesh)
}

/// Keys that only some kinds of mesh files have.
struct FileKeys {
    /// Albedo of each `material_index` of a PLY.
    palette: Option<Vec<[f32; 3]>>,
    /// How colours of an OBJ or PLY are encoded.
    encoding: ColorEncoding,
    /// What to take from a glTF beside its meshes.
    imports: Vec<usize>,
}

fn file_keys(table: &Table<'_>, kind: &str) -> Result<FileKeys> {
    let palette = match table.get("palette") {
        Some(item) if kind != "ply" => {
            return Err(item.error("only .ply files have this key"));
        }
        Some(item) => Some(item.colors(1.0)?),
        None => None,
    };
    let encoding = match table.get("color_encoding") {
        Some(item) if !["obj", "ply"].contains(&kind) => {
            return Err(item.error("only .obj and .ply files have this key"));
        }
        Some(item) => ColorEncoding::ALL[item.choice(&ColorEncoding::NAMES)?],
        None => ColorEncoding::default(),
    };
    Ok(FileKeys {
        palette,
        encoding,
        imports: imports(table, kind)?,
    })
}

/// Reads the file of a mesh; cameras and lights of a glTF go to the builder if the scene file wants
/// them.
fn mesh_file(
    table: &Table<'_>,
    path: &Path,
    world_from_mesh: &DAffine3,
    builder: &mut SceneBuilder,
    files: &mut Files,
) -> Result<MeshInput> {
    let kind = extension(path);
    let keys = file_keys(table, &kind)?;
    if !["obj", "ply", "gltf", "glb"].contains(&kind.as_str()) {
        return Err(table
            .error(format_args!(
                "a mesh with the extension \"{kind}\" is not supported"
            ))
            .hint("meshes are .obj, .ply, .gltf or .glb files"));
    }
    files.enter(path);
    let content = files.read("mesh", path).map_err(|e| table.locate(e))?;
    let mesh = match kind.as_str() {
        "ply" => {
            let coloring = ply::Coloring {
                palette: keys.palette.as_deref(),
                encoding: keys.encoding,
            };
            ply::read(&content, path, &coloring, files)
        }
        "obj" => obj::read(&content, path, keys.encoding, files),
        _ => gltf::read(&content, path, files)
            .and_then(|import| take(import, &keys.imports, world_from_mesh, builder)),
    };
    let mesh = mesh.map_err(|e| e.at(path.display()))?;
    // A glTF file may hold nothing but cameras, lights or a volume.
    if mesh.triangles.is_empty() && ["obj", "ply"].contains(&kind.as_str()) {
        files.warn(format!(
            "{}: no faces were found; it is left out",
            path.display()
        ));
    }
    Ok(mesh)
}

/// Applies the keys that say what the surface of a mesh looks like.
fn surface(table: &Table<'_>, scene: &Path, mesh: &mut MeshInput, files: &mut Files) -> Result<()> {
    if let Some(item) = table.get("albedo") {
        let albedo = item.color(1.0)?;
        mesh.colors.clear();
        for material in &mut mesh.materials {
            material.albedo = albedo;
            material.texture = None;
        }
    }
    if let Some(item) = table.get("texture") {
        if mesh.uvs.is_empty() {
            return Err(item.error("the mesh has no texture coordinates"));
        }
        let path = beside(scene, item.text()?);
        let content = files.read("texture", &path).map_err(|e| table.locate(e))?;
        let image = texture::decode(&content, &path, Decoding::default(), files)?;
        let image = image.map_err(|e| e.at(path.display()))?;
        mesh.textures = vec![image];
        for material in &mut mesh.materials {
            material.texture = Some(0);
            if table.get("albedo").is_none() {
                material.albedo = [1.0; 3];
            }
        }
    }
    let materials = &mut mesh.materials;
    if let Some(item) = table.get("emission") {
        let emission = item.color(MAX_EMISSION)?;
        materials.iter_mut().for_each(|m| m.emission = emission);
    }
    if let Some(item) = table.get("emits_both_sides") {
        let both = item.flag()?;
        materials.iter_mut().for_each(|m| m.emits_both_sides = both);
    }
    if let Some(item) = table.get("name") {
        let name = item.text()?;
        materials.iter_mut().for_each(|m| m.name = name.into());
    }
    Ok(())
}

/// What to take from a glTF beside its meshes: 0 for cameras, 1 for lights.
fn imports(table: &Table<'_>, kind: &str) -> Result<Vec<usize>> {
    let Some(item) = table.get("import") else {
        return Ok(Vec::new());
    };
    if !["gltf", "glb"].contains(&kind) {
        return Err(item.error("only .gltf and .glb files have this key"));
    }
    item.choices(&["cameras", "lights"])
}

/// Moves cameras and lights of a glTF into place and into the builder; the meshes are returned as
/// they are.
fn take(
    import: gltf::Import,
    imports: &[usize],
    world_from_file: &DAffine3,
    builder: &mut SceneBuilder,
) -> Result<MeshInput> {
    if imports.contains(&0) {
        let film = builder.film.unwrap_or(DEFAULT_FILM);
        let cameras = import.cameras.into_iter().map(|mut camera| {
            let moved = *world_from_file * camera.world_from_camera;
            camera.world_from_camera = gltf::without_scale(&moved);
            camera.for_film(&film)
        });
        builder.add_cameras(cameras.collect::<Result<_>>()?);
    }
    if imports.contains(&1) {
        for mut light in import.lights {
            light.position = world_from_file.transform_point3(light.position);
            if let Light::Spot { direction, .. } | Light::Directional { direction, .. } =
                &mut light.light
            {
                let moved = world_from_file.transform_vector3(direction.as_dvec3());
                *direction = moved.normalize().as_vec3();
            }
            builder.lights.push(light);
        }
    }
    Ok(import.mesh)
}

fn shading_normals(table: &Table<'_>, mesh: &mut MeshInput, cancel: &Cancel) -> Result<()> {
    let Some(item) = table.get("normals") else {
        return Ok(());
    };
    if item.is_table() {
        let inner = item.table("`normals`", &["crease_deg"])?;
        let angle = inner.require("crease_deg")?.number_within(0.0, 180.0)?;
        return normals::crease(mesh, angle.to_radians(), cancel);
    }
    match item.choice(&["face", "given"])? {
        0 => mesh.normals.clear(),
        _ if mesh.normals.is_empty() => {
            return Err(item
                .error("the file has no normals")
                .hint("use \"face\" or { crease_deg = 40 }"));
        }
        _ => {}
    }
    Ok(())
}

/// The volumes of a table: a file may have several grids of the name, or none with anything in it.
fn volumes(table: &Table<'_>, scene: &Path, files: &mut Files) -> Result<Vec<VolumeInput>> {
    let (name, path) = named(table, scene)?;
    table.exclusive(&["window", "value_scale"])?;
    table.exclusive(&["unitcube_to_world", "world_from_index"])?;
    let factor = |key: &str| -> Result<Option<f64>> {
        let item = table.get(key);
        item.map(|i| i.number_within(0.0, 1e30)).transpose()
    };
    let sigma_t_scale = table.require("sigma_t_scale")?.number_within(0.0, 1e30)?;
    let window = match table.get("window") {
        Some(item) => {
            let [low, high] = item.numbers::<2>()?;
            if high <= low {
                return Err(item.error(format_args!(
                    "expected the low end first, then a higher one, found {low} and {high}"
                )));
            }
            Some([low, high])
        }
        None => None,
    };
    let scale = Scale {
        sigma_t: sigma_t_scale * factor("value_scale")?.unwrap_or(1.0),
        window,
    };
    let albedo = table.require("albedo")?.color(1.0)?;
    let phase = phase(table)?;
    let fields = fields(table, name, &path, files)?;
    if fields.is_empty() {
        let path = path.display();
        files.warn(format!(
            "{path}: no voxel is active; the volume is left out"
        ));
    }
    let of_one = ["unitcube_to_world", "world_from_index"];
    if fields.len() > 1
        && let Some(item) = of_one.iter().find_map(|key| table.get(key))
    {
        let names: Vec<&str> = fields.iter().filter_map(|f| f.name.as_deref()).collect();
        return Err(item
            .error(format_args!(
                "the file has several such grids: {}",
                names.join(", ")
            ))
            .hint("choose one with `grid`, or leave their places to the file"));
    }
    let plain = match table.get("name") {
        Some(item) => item.text()?.into(),
        None => path.file_stem().unwrap_or_default().to_string_lossy(),
    };
    let volume = |(i, field): (usize, Field)| {
        let noted = field.note_values(&path, files);
        noted.map_err(|e| e.at(path.display()))?;
        let world_from_grid = placement(table, &field)?;
        let sigma_t = field.into_grid(scale, &path, files);
        Ok(VolumeInput {
            name: match i {
                0 => plain.to_string(),
                _ => format!("{plain} {}", i + 1),
            },
            sigma_t: sigma_t.map_err(|e| e.at(path.display()))?,
            albedo,
            phase,
            world_from_grid,
        })
    };
    fields.into_iter().enumerate().map(volume).collect()
}

/// The phase function: a mean cosine, or two and the weight of the first.
fn phase(table: &Table<'_>) -> Result<PhaseFunction> {
    let mix = table.get("mix");
    let Some(item) = table.get("g") else {
        return match mix {
            Some(mix) => Err(mix.error("there is no `g` that it could weigh")),
            None => Ok(PhaseFunction::ISOTROPIC),
        };
    };
    /// As decimals say it.
    const MAX_G: f64 = 0.99;
    if !item.is_list() {
        if let Some(mix) = mix {
            return Err(mix.error("expected two lobes to weigh, as in g = [0.9, -0.2]"));
        }
        let g = item.number_within(-MAX_G, MAX_G)?;
        return Ok(PhaseFunction::henyey_greenstein(g as f32));
    }
    let lobes = item.numbers::<2>()?;
    if let Some(g) = lobes.iter().find(|g| g.abs() > MAX_G) {
        return Err(item.error(format_args!(
            "expected two numbers from -{MAX_G} to {MAX_G}, found {g}"
        )));
    }
    let mix = table.require("mix")?.number_within(0.0, 1.0)?;
    let lobes = lobes.map(|g| g as f32);
    Ok(PhaseFunction::two_lobes(lobes, mix as f32))
}

/// The map from the space of the grid to the world, by the table or else by the file.
fn placement(table: &Table<'_>, field: &Field) -> Result<DAffine3> {
    let placed = if let Some(item) = table.get("unitcube_to_world") {
        item.affine()? * field.unitcube_from_grid()
    } else if let Some(item) = table.get("world_from_index") {
        item.affine()? * field.file_from_grid()
    } else if let Some(world_from_file) = field.world_from_file {
        world_from_file * field.file_from_grid()
    } else {
        return Err(table
            .error("the file does not say where the volume is")
            .hint("give `unitcube_to_world` or `world_from_index`"));
    };
    let world_from_grid: DAffine3 = transform::from_keys(table)? * placed;
    match is_singular(&world_from_grid) {
        false => Ok(world_from_grid),
        true => Err(table.error("the placement of the volume is singular: it flattens space")),
    }
}

/// The samples of the grids of a volume file; none if it has no active voxel.
fn fields(table: &Table<'_>, name: &str, path: &Path, files: &mut Files) -> Result<Vec<Field>> {
    let kind = extension(path);
    let keys: [(&str, &[&str]); 2] = [("raw", &["dims", "dtype", "endian"]), ("vdb", &["grid"])];
    for (extension, keys) in keys {
        for key in keys {
            if kind != extension
                && let Some(item) = table.get(key)
            {
                return Err(item.error(format_args!("only .{extension} files have this key")));
            }
        }
    }
    if let Some(shape) = name.strip_prefix("builtin:") {
        let one = |field| vec![field];
        return builtin::volume(shape).map(one).map_err(|e| table.locate(e));
    }
    // The layout is checked before the file is read.
    let layout = match kind.as_str() {
        "raw" => {
            let dims = table.require("dims")?.dims()?;
            let number = Number::ALL[table.require("dtype")?.choice(&Number::NAMES)?];
            let big_endian = match table.get("endian") {
                Some(item) => item.choice(&["little", "big"])? == 1,
                None => false,
            };
            Some((dims, number, big_endian))
        }
        "nrrd" | "nhdr" | "vdb" => None,
        other => {
            return Err(table
                .error(format_args!(
                    "a volume with the extension \"{other}\" is not supported"
                ))
                .hint("volumes are .vdb, .nrrd, .nhdr or .raw files"));
        }
    };
    let grid = table.get("grid").map(|i| i.text()).transpose()?;
    files.enter(path);
    let one = |field| vec![field];
    if kind == "vdb" {
        let content = files.map("volume", path).map_err(|e| table.locate(e))?;
        let fields = vdb::read(content, path, grid.into(), files);
        return fields.map_err(|e| e.at(path.display()));
    }
    let content = files.read("volume", path).map_err(|e| table.locate(e))?;
    let fields = match layout {
        Some((dims, number, big_endian)) => raw::read(content, dims, number, big_endian).map(one),
        None => nrrd::read(content, path, files).map(one),
    };
    fields.map_err(|e| e.at(path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The example in the documentation.
    fn example() -> String {
        let source = include_str!("../../../docs/scene.md");
        let lines = source
            .lines()
            .skip_while(|l| !l.contains("```toml"))
            .skip(1);
        lines
            .take_while(|l| !l.contains("```"))
            .map(|l| l.to_string() + "\n")
            .collect()
    }

    #[test]
    fn the_documented_example_has_every_key_and_no_other() {
        let text = example();
        let document = Document::new(Path::new("example"), &text);
        let parsed = document.parse().unwrap();
        let known = ["name", "film", "camera", "mesh", "light", "volume"];
        let root = document.root(&parsed, &known).unwrap();
        root.require("film")
            .unwrap()
            .table("[film]", &FILM)
            .unwrap();
        for (table, keys) in [
            ("camera", CAMERA.as_slice()),
            ("mesh", &MESH),
            ("light", &LIGHT),
            ("volume", &VOLUME),
        ] {
            assert!(!root.tables(table, keys).unwrap().is_empty());
            let section: String = (text.split("\n[["))
                .filter(|s| s.starts_with(table))
                .collect();
            for key in keys {
                assert!(section.contains(key), "{key} of [[{table}]]");
            }
        }
        for table in root.tables("light", &LIGHT).unwrap() {
            // There is no file of that name.
            if table.get("image").is_none() {
                light(&table).unwrap();
            }
        }
    }
}

//! The scene file: from TOML tables to a [`Draft`]. `docs/scene.md` describes the schema.

use super::super::{Film, Light};
use super::draft::{DEFAULT_FILM, Draft, DraftCamera, DraftLight, DraftVolume, look_at};
use super::field::{Field, Number, Scale};
use super::files::{Files, beside, extension};
use super::part::Part;
use super::table::{Document, Table};
use super::{
    BRIGHTEST, builtin, gltf, is_singular, normals, nrrd, obj, place, ply, raw, texture, vdb,
};
use crate::run::Cancel;
use crate::{Error, Result};
use glam::{DAffine3, DVec3};
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
const MESH: [&str; 13] = [
    "file",
    "name",
    "transform",
    "translate",
    "rotate_deg",
    "scale",
    "albedo",
    "texture",
    "palette",
    "emission",
    "emits_both_sides",
    "normals",
    "import",
];
const LIGHT: [&str; 10] = [
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
];
const VOLUME: [&str; 16] = [
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
    "unitcube_to_world",
    "world_from_index",
    "transform",
    "translate",
    "rotate_deg",
    "scale",
];

/// Reads the scene file `path` with the content `text`, and all files that it names.
pub(super) fn read(text: &str, path: &Path, files: &mut Files) -> Result<Draft> {
    let document = Document::new(path, text);
    let parsed = document.parse()?;
    let root = document.root(
        &parsed,
        &["name", "film", "camera", "mesh", "light", "volume"],
    )?;
    let stem = path.file_stem().unwrap_or_default();
    let mut draft = Draft {
        name: match root.get("name") {
            Some(name) => name.text()?.into(),
            None => stem.to_string_lossy().into_owned(),
        },
        film: film(&root)?,
        ..Draft::default()
    };
    for table in root.tables("camera", &CAMERA)? {
        let camera = camera(&table, draft.cameras.len())?;
        if draft.cameras.iter().any(|c| c.name == camera.name) {
            return Err(table.error(format_args!(
                "another camera has the name \"{}\" too",
                camera.name
            )));
        }
        draft.cameras.push(camera);
    }
    // The tables are checked before the first large file is read.
    let lights = root.tables("light", &LIGHT)?;
    let volumes = root.tables("volume", &VOLUME)?;
    for table in lights {
        draft.lights.push(light(&table)?);
    }
    for table in root.tables("mesh", &MESH)? {
        let part = mesh(&table, path, &mut draft, files)?;
        draft.parts.push(part);
    }
    for table in volumes {
        draft.volumes.push(volume(&table, path, files)?);
    }
    Ok(draft)
}

fn film(root: &Table<'_>) -> Result<Option<Film>> {
    let Some(item) = root.get("film") else {
        return Ok(None);
    };
    let table = item.table("[film]", &FILM)?;
    let side = |key: &str| -> Result<u32> { Ok(table.require(key)?.whole(1, 65536)? as u32) };
    Ok(Some(Film {
        width: side("width")?,
        height: side("height")?,
        exposure: match table.get("exposure") {
            Some(item) => item.number_within(1e-30, 1e30)? as f32,
            None => 1.0,
        },
    }))
}

fn camera(table: &Table<'_>, index: usize) -> Result<DraftCamera> {
    for key in ["position", "target", "up"] {
        table.exclusive(&["camera_to_world", key])?;
    }
    let world_from_camera = if let Some(item) = table.get("camera_to_world") {
        let mut map = item.affine()?;
        let (x, y, z) = (map.matrix3.x_axis, map.matrix3.y_axis, map.matrix3.z_axis);
        let lengths = [x, y, z].map(|a| (a.length() - 1.0).abs());
        let angles = [x.dot(y), y.dot(z), z.dot(x)].map(f64::abs);
        let turns = x.cross(y).dot(z) > 0.0;
        if !turns || lengths.iter().chain(&angles).any(|e| *e > 1e-4) {
            return Err(
                item.error("expected a rotation and a position, without scale, shear or mirror")
            );
        }
        // Straightened, so that what six digits in a file leave of a rotation is a rotation to f32.
        map.matrix3.z_axis = z.normalize();
        map.matrix3.x_axis = y.cross(map.matrix3.z_axis).normalize();
        map.matrix3.y_axis = map.matrix3.z_axis.cross(map.matrix3.x_axis);
        map
    } else {
        let position = table.require("position")?.vector()?;
        let target = table.require("target")?.vector()?;
        let up = match table.get("up") {
            Some(up) => up.vector()?,
            None => DVec3::Y,
        };
        look_at(position, target, up).ok_or_else(|| {
            table.error("the camera is at its own target, or looks along its `up`")
        })?
    };
    let fov_x_deg = match table.get("fov_x_deg") {
        Some(item) => item.number_within(0.01, 179.0)?,
        None => 45.0,
    };
    Ok(DraftCamera {
        name: match table.get("name") {
            Some(name) => name.text()?.into(),
            None => format!("camera {}", index + 1),
        },
        world_from_camera,
        fov_x_rad: fov_x_deg.to_radians(),
    })
}

fn light(table: &Table<'_>) -> Result<DraftLight> {
    let color = |key: &str| table.require(key)?.color(BRIGHTEST);
    let position = || table.require("position")?.vector();
    let only = |keys: &[&str]| -> Result<()> {
        for key in LIGHT {
            if key != "type" && !keys.contains(&key) && table.get(key).is_some() {
                return Err(table
                    .error(format_args!("this type of light has no `{key}`"))
                    .hint(format!("its keys are {}", keys.join(", "))));
            }
        }
        Ok(())
    };
    let kinds = ["point", "spot", "directional", "environment"];
    let kind = table.require("type")?.choice(&kinds)?;
    let (light, position) = match kinds[kind] {
        "point" => {
            only(&["position", "intensity"])?;
            let light = Light::Point {
                position: glam::Vec3::ZERO,
                intensity: color("intensity")?,
            };
            (light, position()?)
        }
        "spot" => {
            only(&[
                "position",
                "direction",
                "target",
                "intensity",
                "inner_deg",
                "outer_deg",
            ])?;
            table.exclusive(&["direction", "target"])?;
            let at = position()?;
            let direction = match table.get("target") {
                Some(target) => (target.vector()? - at)
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
            let cos = |degrees: f64| libm::cos(degrees.to_radians()) as f32;
            if cos(inner_deg) <= cos(outer_deg) {
                return Err(outer.error(format_args!(
                    "expected more than the {inner_deg} of `inner_deg`, found {outer_deg}"
                )));
            }
            let light = Light::Spot {
                position: glam::Vec3::ZERO,
                direction: direction.as_vec3(),
                intensity: color("intensity")?,
                cos_inner: cos(inner_deg),
                cos_outer: cos(outer_deg),
            };
            (light, at)
        }
        "directional" => {
            only(&["direction", "irradiance", "angular_radius_deg"])?;
            let radius_deg = match table.get("angular_radius_deg") {
                Some(item) => item.number_within(0.0, 89.0)?,
                None => 0.0,
            };
            let light = Light::Directional {
                direction: table.require("direction")?.direction()?.as_vec3(),
                irradiance: color("irradiance")?,
                angular_radius_rad: radius_deg.to_radians() as f32,
            };
            (light, DVec3::ZERO)
        }
        _ => {
            only(&["radiance"])?;
            let radiance = color("radiance")?;
            (Light::Environment { radiance }, DVec3::ZERO)
        }
    };
    Ok(DraftLight { light, position })
}

/// The text of `file`, and its path unless it is built in.
fn named<'a>(table: &Table<'a>, scene: &Path) -> Result<(&'a str, PathBuf)> {
    let name = table.require("file")?.text()?;
    Ok((name, beside(scene, name)))
}

fn mesh(table: &Table<'_>, scene: &Path, draft: &mut Draft, files: &mut Files) -> Result<Part> {
    let world_from_part = place::from_keys(table)?;
    let (name, path) = named(table, scene)?;
    let kind = extension(&path);
    let palette = match table.get("palette") {
        Some(item) if kind != "ply" => {
            return Err(item.error("only .ply files have this key"));
        }
        Some(item) => Some(item.colors(1.0)?),
        None => None,
    };
    let imports = imports(table, &kind)?;
    let mut part = match name.strip_prefix("builtin:") {
        Some(shape) => builtin::mesh(shape).map_err(|e| table.locate(e))?,
        None => {
            if !["obj", "ply", "gltf", "glb"].contains(&kind.as_str()) {
                return Err(table
                    .error(format_args!(
                        "a mesh with the extension \"{kind}\" is not supported"
                    ))
                    .hint("meshes are .obj, .ply, .gltf or .glb files"));
            }
            let content = files.read("mesh", &path).map_err(|e| table.locate(e))?;
            let part = match kind.as_str() {
                "ply" => ply::read(&content, palette.as_deref(), &files.cancel),
                "obj" => obj::read(&content, &path, files),
                _ => gltf::read(&content, &path, files)
                    .and_then(|import| take(import, &imports, &world_from_part, draft)),
            };
            let part = part.map_err(|e| e.at(path.display()))?;
            // A glTF file may hold nothing but cameras, lights or a volume.
            if part.triangles.is_empty() && ["obj", "ply"].contains(&kind.as_str()) {
                return Err(Error::input("no faces were found").at(path.display()));
            }
            part
        }
    };
    files.cancel.check()?;
    part.check().map_err(|e| e.at(path.display()))?;
    part.transform(&world_from_part);
    if let Some(item) = table.get("albedo") {
        let albedo = item.color(1.0)?;
        part.colors.clear();
        for material in &mut part.materials {
            material.albedo = albedo;
            material.texture = None;
        }
    }
    if let Some(item) = table.get("texture") {
        if part.uvs.is_empty() {
            return Err(item.error("the mesh has no texture coordinates"));
        }
        let path = beside(scene, item.text()?);
        let content = files.read("texture", &path).map_err(|e| table.locate(e))?;
        let image = texture::decode(&content).map_err(|e| e.at(path.display()))?;
        part.textures = vec![image];
        for material in &mut part.materials {
            material.texture = Some(0);
            if table.get("albedo").is_none() {
                material.albedo = [1.0; 3];
            }
        }
    }
    if let Some(item) = table.get("emission") {
        let emission = item.color(BRIGHTEST)?;
        part.materials
            .iter_mut()
            .for_each(|m| m.emission = emission);
    }
    if let Some(item) = table.get("emits_both_sides") {
        let both = item.flag()?;
        (part.materials.iter_mut()).for_each(|m| m.emits_both_sides = both);
    }
    if let Some(item) = table.get("name") {
        let name = item.text()?;
        part.materials.iter_mut().for_each(|m| m.name = name.into());
    }
    files.cancel.check()?;
    shading_normals(table, &mut part, &files.cancel)?;
    files.cancel.check()?;
    // Placement can take finite positions out of range.
    part.check().map_err(|e| table.locate(e))?;
    Ok(part)
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

/// Moves cameras and lights of a glTF into place and into the draft; the meshes are returned as
/// they are.
fn take(
    import: gltf::Import,
    imports: &[usize],
    world_from_file: &DAffine3,
    draft: &mut Draft,
) -> Result<Part> {
    if imports.contains(&0) {
        let film = draft.film.unwrap_or(DEFAULT_FILM);
        for mut camera in import.cameras {
            let moved = *world_from_file * camera.world_from_camera;
            camera.world_from_camera = gltf::without_scale(&moved);
            let camera = camera.for_film(&film)?;
            draft.add_camera(camera);
        }
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
            draft.lights.push(light);
        }
    }
    Ok(import.part)
}

fn shading_normals(table: &Table<'_>, part: &mut Part, cancel: &Cancel) -> Result<()> {
    let Some(item) = table.get("normals") else {
        return Ok(());
    };
    if item.is_table() {
        let inner = item.table("`normals`", &["crease_deg"])?;
        let angle = inner.require("crease_deg")?.number_within(0.0, 180.0)?;
        return normals::crease(part, angle.to_radians(), cancel);
    }
    match item.choice(&["face", "given"])? {
        0 => part.normals.clear(),
        _ if part.normals.is_empty() => {
            return Err(item
                .error("the file has no normals")
                .hint("use \"face\" or { crease_deg = 40 }"));
        }
        _ => {}
    }
    Ok(())
}

fn volume(table: &Table<'_>, scene: &Path, files: &mut Files) -> Result<DraftVolume> {
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
    let field = field(table, name, &path, files)?;

    let world_from_index = if let Some(item) = table.get("unitcube_to_world") {
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
    let world_from_index: DAffine3 = place::from_keys(table)? * world_from_index;
    if is_singular(&world_from_index) {
        return Err(table.error("the placement of the volume is singular: it flattens space"));
    }
    Ok(DraftVolume {
        name: match table.get("name") {
            Some(item) => item.text()?.into(),
            None => path
                .file_stem()
                .unwrap_or_default()
                .to_string_lossy()
                .into(),
        },
        sigma_t: field
            .into_grid(scale, &files.cancel)
            .map_err(|e| e.at(path.display()))?,
        albedo,
        world_from_index,
    })
}

fn field(table: &Table<'_>, name: &str, path: &Path, files: &mut Files) -> Result<Field> {
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
        return builtin::volume(shape).map_err(|e| table.locate(e));
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
    let content = files.read("volume", path).map_err(|e| table.locate(e))?;
    let field = match layout {
        Some((dims, number, big_endian)) => raw::read(content, dims, number, big_endian),
        None if kind == "vdb" => vdb::read(&content, grid, files),
        None => nrrd::read(content, path, files),
    };
    field.map_err(|e| e.at(path.display()))
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
            light(&table).unwrap();
        }
    }
}

//! The scene file: from TOML tables to a [`SceneBuilder`]. `docs/scene.md` describes the schema.

mod camera;
mod emission;
mod light;
mod packed;
mod volume;

use self::camera::{CAMERA, camera};
use self::emission::EmissionTable;
use self::light::{LIGHT, environment_image, light};
pub(super) use self::packed::packed_file;
use self::volume::{Kept, VOLUME, volumes};
use super::colors::ColorEncoding;
use super::files::{Files, beside, extension};
use super::groups::Groups;
use super::table::{Document, Item, Table};
use super::texture::Decoding;
use super::{builtin, changes, gltf, normals, obj, ply, stl, texture, transform};
use crate::Result;
use crate::run::Cancel;
use crate::scene::builder::{DEFAULT_FILM, EmissiveInput, MAX_EMISSION, MeshInput, SceneBuilder};
use crate::scene::{Film, Light, Mask, Material, Texture};
use glam::DAffine3;
use std::borrow::Cow;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

const ROOT: [&str; 7] = [
    "name", "packed", "film", "camera", "mesh", "light", "volume",
];
const FILM: [&str; 3] = ["width", "height", "exposure"];
const MESH: [&str; 20] = [
    "file",
    "name",
    "transform",
    "translate",
    "rotate_deg",
    "scale",
    "albedo",
    "texture",
    "opacity",
    "opacity_cutoff",
    "palette",
    "color_encoding",
    "emission",
    "emission_texture",
    "emits_both_sides",
    "group",
    "visible",
    "normals",
    "import",
    "light_scale",
];
/// Reads the scene file `path` with the content `text`, and all files that it names.
pub(super) fn read(text: &str, path: &Path, files: &mut Files) -> Result<SceneBuilder> {
    let changes = files.settings.changes.clone();
    let (all, changed) = changes::append(text, &changes);
    let document = Document::changed(path, &all, text.len(), &changes, changed);
    let parsed = document.parse()?;
    let root = document.root(&parsed, &ROOT)?;
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
    let volume_tables = root.tables("volume", &VOLUME)?;
    builder.is_environment_unseen = light::are_environments_unseen(&lights)?;
    let wanted = files.settings.group.clone();
    builder.is_lit_in_part = wanted.is_some();
    let mut groups = Groups::new(wanted.as_deref());
    for table in lights {
        match groups.add(&table)? {
            true => add_light(&table, path, &mut builder, files)?,
            false => light::check(&table)?,
        }
    }
    if let Some(item) = root.get("packed") {
        builder.packed = Some(packed::read(&item, &root, path, &mut groups, files)?);
    }
    for table in root.tables("mesh", &MESH)? {
        let lights = builder.lights.len();
        let mesh = mesh(&table, path, &mut builder, files)?;
        let is_light = mesh.emits() || builder.lights.len() > lights;
        if !is_light && let Some(item) = table.get("group") {
            files.warn(
                item.error("the mesh sends no light that could be in a group")
                    .to_string(),
            );
        }
        if is_light && !groups.add(&table)? {
            builder.lights.truncate(lights);
            builder.dark_meshes.push(builder.meshes.len());
        }
        builder.meshes.push(mesh);
    }
    let mut kept = Kept::of(&volume_tables);
    for table in volume_tables {
        let emission = EmissionTable::of(&table)?;
        let (media, fields) = volumes(&table, path, files, &mut kept)?;
        builder.volumes.extend(media);
        if let Some(emission) = emission {
            let is_wanted = groups.add(emission.table())?;
            let mut emissive = emission.read(&table, path, fields, files)?;
            if !is_wanted {
                emissive.iter_mut().for_each(EmissiveInput::darken);
            }
            builder.emissive.extend(emissive);
        }
    }
    builder.groups = groups.finish().map_err(|e| e.at(path.display()))?;
    Ok(builder)
}

fn add_light(
    table: &Table<'_>,
    scene: &Path,
    builder: &mut SceneBuilder,
    files: &mut Files,
) -> Result<()> {
    match environment_image(table, scene, files)? {
        None => builder.lights.push(light(table)?),
        Some(_) if builder.environment_image.is_some() => {
            return Err(table.error("another environment has an image, too"));
        }
        image => builder.environment_image = image,
    }
    Ok(())
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

/// The text of `file`, and its path unless it is built in.
fn named<'a>(
    table: &Table<'a>,
    scene: &Path,
    files: &mut Files,
) -> Result<(Cow<'a, str>, PathBuf)> {
    let name = files.at_frame(table.require("file")?.text()?);
    let name = name.map_err(|e| table.locate(e))?;
    let path = beside(scene, &name);
    Ok((name, path))
}

fn mesh(
    table: &Table<'_>,
    scene: &Path,
    builder: &mut SceneBuilder,
    files: &mut Files,
) -> Result<MeshInput> {
    let world_from_mesh = transform::from_keys(table)?;
    let (name, path) = named(table, scene, files)?;
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
    let of_vertices = ["texture", "emission_texture", "opacity"];
    if of_vertices.iter().any(|key| table.get(key).is_some()) {
        mesh.lay_flat()?;
    }
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
    /// Factor on the lights that are taken.
    light_scale: f32,
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
        light_scale: light_scale(table)?,
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
    if !["obj", "ply", "stl", "gltf", "glb"].contains(&kind.as_str()) {
        return Err(table
            .error(format_args!(
                "a mesh with the extension \"{kind}\" is not supported"
            ))
            .hint("meshes are .obj, .ply, .stl, .gltf or .glb files"));
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
        "stl" => stl::read(&content, path, files),
        _ => gltf::read(&content, path, files).and_then(|import| {
            if keys.imports.contains(&1) && keys.light_scale == 1.0 {
                import.tell_photometric(path, files);
            }
            take(import, &keys, world_from_mesh, builder)
        }),
    };
    let mesh = mesh.map_err(|e| e.at(path.display()))?;
    // A glTF file may hold nothing but cameras, lights or a volume.
    if mesh.is_empty() && ["obj", "ply", "stl"].contains(&kind.as_str()) {
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
        (mesh.copies.iter_mut()).for_each(|c| c.mesh.colors.clear());
        for material in &mut mesh.materials {
            material.albedo = albedo;
            material.texture = None;
        }
    }
    if let Some(item) = table.get("texture") {
        if mesh.uvs.is_empty() {
            return Err(item.error("the mesh has no texture coordinates"));
        }
        let image = image(table, &item, scene, files)?;
        let is_needed = |m: &Material| m.mask.is_some() || m.emission_texture.is_some();
        if !mesh.materials.iter().any(is_needed) {
            mesh.textures.clear();
        }
        let index = mesh.textures.len() as u32;
        mesh.textures.push(image);
        for material in &mut mesh.materials {
            material.texture = Some(index);
            if table.get("albedo").is_none() {
                material.albedo = [1.0; 3];
            }
        }
    }
    masks(table, scene, mesh, files)?;
    emission(table, scene, mesh, files)?;
    let materials = &mut mesh.materials;
    if let Some(item) = table.get("emits_both_sides") {
        let both = item.flag()?;
        materials.iter_mut().for_each(|m| m.emits_both_sides = both);
    }
    if let Some(item) = table.get("visible") {
        let is_seen = item.flag()?;
        materials.iter_mut().for_each(|m| m.is_seen = is_seen);
    }
    if let Some(item) = table.get("name") {
        let name = item.text()?;
        materials.iter_mut().for_each(|m| m.name = name.into());
    }
    Ok(())
}

/// The image that a key of a mesh names.
fn image(table: &Table<'_>, item: &Item<'_>, scene: &Path, files: &mut Files) -> Result<Texture> {
    let name = files.at_frame(item.text()?);
    let path = beside(scene, &name.map_err(|e| table.locate(e))?);
    let content = files.read("texture", &path).map_err(|e| table.locate(e))?;
    let image = texture::decode(&content, &path, Decoding::default(), files)?;
    image.map_err(|e| e.at(path.display()))
}

/// Applies the keys that say what a mesh emits.
fn emission(
    table: &Table<'_>,
    scene: &Path,
    mesh: &mut MeshInput,
    files: &mut Files,
) -> Result<()> {
    let factor = table.get("emission").map(|item| item.color(MAX_EMISSION));
    let factor = factor.transpose()?;
    if let Some(emission) = factor {
        for material in &mut mesh.materials {
            material.emission = emission;
            material.emission_texture = None;
        }
    }
    let Some(item) = table.get("emission_texture") else {
        return Ok(());
    };
    if mesh.uvs.is_empty() {
        return Err(item.error("the mesh has no texture coordinates"));
    }
    let index = mesh.textures.len() as u32;
    mesh.textures.push(image(table, &item, scene, files)?);
    for material in &mut mesh.materials {
        material.emission_texture = Some(index);
        if factor.is_none() {
            material.emission = [1.0; 3];
        }
    }
    Ok(())
}

/// Applies the keys that say where the surface of a mesh is there.
fn masks(table: &Table<'_>, scene: &Path, mesh: &mut MeshInput, files: &mut Files) -> Result<()> {
    if let Some(item) = table.get("opacity") {
        let mut mask = Mask {
            opacity: 1.0,
            texture: None,
            cutoff: None,
        };
        match item.is_text() {
            false => mask.opacity = item.number_within(0.0, 1.0)? as f32,
            true if mesh.uvs.is_empty() => {
                return Err(item.error("the mesh has no texture coordinates"));
            }
            true => {
                let name = files.at_frame(item.text()?);
                let path = beside(scene, &name.map_err(|e| table.locate(e))?);
                let content = files.read("texture", &path).map_err(|e| table.locate(e))?;
                let image = texture::decode_opacity(&content, &path, Decoding::default(), files)?;
                mask.texture = Some(mesh.textures.len() as u32);
                mesh.textures.push(image.map_err(|e| e.at(path.display()))?);
            }
        }
        mesh.opacities.clear();
        for material in &mut mesh.materials {
            material.mask = Some(mask);
        }
    }
    if let Some(item) = table.get("opacity_cutoff") {
        let cutoff = item.number_within(0.0, 1.0)? as f32;
        let masks = mesh.materials.iter_mut().filter_map(|m| m.mask.as_mut());
        let mut masks = masks.peekable();
        if masks.peek().is_none() {
            return Err(item.error(
                "there is no `opacity`, and the file has none, of which it could be the cut-off",
            ));
        }
        masks.for_each(|mask| mask.cutoff = Some(cutoff));
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

/// The factor on the lights of a glTF.
fn light_scale(table: &Table<'_>) -> Result<f32> {
    let Some(item) = table.get("light_scale") else {
        return Ok(1.0);
    };
    let imports = table
        .get("import")
        .map(|i| i.choices(&["cameras", "lights"]));
    if !imports
        .transpose()?
        .is_some_and(|imports| imports.contains(&1))
    {
        return Err(
            item.error("there is no `import = [\"lights\"]` of which it could be the factor")
        );
    }
    Ok(item.number_within(0.0, 1e6)? as f32)
}

/// Moves cameras and lights of a glTF into place and into the builder; the meshes are returned as
/// they are.
fn take(
    import: gltf::Import,
    keys: &FileKeys,
    world_from_file: &DAffine3,
    builder: &mut SceneBuilder,
) -> Result<MeshInput> {
    if keys.imports.contains(&0) {
        let film = builder.film.unwrap_or(DEFAULT_FILM);
        let cameras = import.cameras.into_iter().map(|mut camera| {
            let moved = *world_from_file * camera.world_from_camera;
            camera.world_from_camera = gltf::without_scale(&moved);
            camera.for_film(&film)
        });
        builder.add_cameras(cameras.collect::<Result<_>>()?);
    }
    if keys.imports.contains(&1) {
        for mut light in import.lights {
            light.position = world_from_file.transform_point3(light.position);
            light.light.scale(keys.light_scale);
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
    let copies = || mesh.copies.iter().map(|c| &c.mesh);
    let has_none = mesh.normals.is_empty() && copies().all(|c| c.normals.is_empty());
    match item.choice(&["face", "given"])? {
        0 => {
            mesh.normals.clear();
            (mesh.copies.iter_mut()).for_each(|c| c.mesh.normals.clear());
        }
        _ if has_none => {
            return Err(item
                .error("the file has no normals")
                .hint("use \"face\" or { crease_deg = 40 }"));
        }
        _ => {}
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The example in the documentation.
    fn example() -> String {
        let source = include_str!("../../../../docs/scene.md");
        let lines = source.lines().skip_while(|l| !l.starts_with("name = "));
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
        let root = document.root(&parsed, &ROOT).unwrap();
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
        let cameras = root.tables("camera", &CAMERA).unwrap().into_iter();
        for (i, table) in cameras.enumerate() {
            camera(&table, i).unwrap();
        }
        let moving = text.split("[[camera.key]]").skip(1).collect::<String>();
        for key in camera::CAMERA_KEY.iter().filter(|key| **key != "up") {
            assert!(moving.contains(key), "{key} of [[camera.key]]");
        }
        for table in root.tables("light", &LIGHT).unwrap() {
            // There is no file of that name.
            if table.get("image").is_none() {
                light(&table).unwrap();
            }
        }
    }
}

//! The volumes of a scene file.

use super::named;
use crate::Result;
use crate::scene::PhaseFunction;
use crate::scene::builder::{VolumeInput, is_singular};
use crate::scene::load::field::{Field, Scale};
use crate::scene::load::files::{Files, extension};
use crate::scene::load::samples::Number;
use crate::scene::load::table::Table;
use crate::scene::load::{builtin, nrrd, raw, transform, vdb, vol};
use glam::DAffine3;
use std::path::Path;

/// Keys of volumes.
pub const VOLUME: [&str; 18] = [
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

/// The volumes of a table: a file may have several grids of the name, or none with anything in it.
pub fn volumes(table: &Table<'_>, scene: &Path, files: &mut Files) -> Result<Vec<VolumeInput>> {
    let (name, path) = named(table, scene, files)?;
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
    let fields = fields(table, &name, &path, files)?;
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
        "nrrd" | "nhdr" | "vdb" | "vol" => None,
        other => {
            return Err(table
                .error(format_args!(
                    "a volume with the extension \"{other}\" is not supported"
                ))
                .hint("volumes are .vdb, .nrrd, .nhdr, .vol or .raw files"));
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
        None if kind == "vol" => (vol::Vol::read(content))
            .and_then(vol::Vol::into_field)
            .map(one),
        None => nrrd::read(content, path, files).map(one),
    };
    fields.map_err(|e| e.at(path.display()))
}

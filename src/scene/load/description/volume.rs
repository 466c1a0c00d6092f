//! The volumes of a scene file.

use super::named;
use crate::scene::builder::{VolumeInput, is_singular};
use crate::scene::load::field::Field;
use crate::scene::load::files::{Files, beside, extension};
use crate::scene::load::samples::Number;
use crate::scene::load::scale::{Density, Scale};
use crate::scene::load::table::{Item, Table};
use crate::scene::load::transfer::Transfer;
use crate::scene::load::vdb::ColorFields;
use crate::scene::load::{FIELD_FILES, builtin, depth, raw, read_field, transform, vdb};
use crate::scene::{AlbedoGrid, PhaseFunction};
use crate::{Error, Result};
use glam::{DAffine3, DVec3};
use std::collections::HashMap;
use std::path::{Path, PathBuf};

/// Keys of volumes.
pub const VOLUME: [&str; 24] = [
    "file",
    "name",
    "dims",
    "dtype",
    "endian",
    "grid",
    "sigma_t_scale",
    "value_scale",
    "window",
    "curve",
    "transfer",
    "albedo",
    "albedo_grid",
    "g",
    "mix",
    "emission",
    "unitcube_to_world",
    "world_from_index",
    "up",
    "crop",
    "transform",
    "translate",
    "rotate_deg",
    "scale",
];

/// Keys that say what is read of which file.
pub const FILE_KEYS: [&str; 5] = ["file", "grid", "dims", "dtype", "endian"];

/// Keys that say what is read of it, and what else is wanted.
const KEPT_KEYS: [&str; 6] = ["file", "grid", "dims", "dtype", "endian", "albedo_grid"];

/// Fields that several tables name: they are read once, and go with the last that does.
pub struct Kept<'a> {
    uses: HashMap<Vec<Option<&'a str>>, usize>,
    fields: HashMap<Vec<Option<&'a str>>, Vec<Field>>,
}

impl<'a> Kept<'a> {
    /// None yet, of these tables.
    pub fn of(tables: &[Table<'a>]) -> Self {
        let mut uses = HashMap::new();
        for table in tables {
            *uses.entry(table.texts(&KEPT_KEYS)).or_default() += 1;
        }
        Self {
            uses,
            fields: HashMap::new(),
        }
    }

    /// The fields of a table, which are read if they are not kept.
    fn fields(
        &mut self,
        table: &Table<'a>,
        read: impl FnOnce() -> Result<Vec<Field>>,
    ) -> Result<Vec<Field>> {
        let key = table.texts(&KEPT_KEYS);
        let left = self.uses.get_mut(&key);
        let left = left.map_or(0, |left| {
            *left = left.saturating_sub(1);
            *left
        });
        let fields = match self.fields.remove(&key) {
            Some(fields) => fields,
            None => read()?,
        };
        if left > 0 {
            self.fields.insert(key, fields.clone());
        }
        Ok(fields)
    }
}

/// The media of a table, and the file and the fields that they were read from.
pub type Volumes = (Vec<VolumeInput>, (PathBuf, Vec<Field>));

/// The volumes of a table: a file may have several grids of the name, or none with anything in it;
/// a preset makes several of each.
pub fn volumes<'a>(
    table: &Table<'a>,
    scene: &Path,
    files: &mut Files,
    kept: &mut Kept<'a>,
) -> Result<Volumes> {
    let (name, path) = named(table, scene, files)?;
    table.exclusive(&["window", "value_scale", "curve", "transfer"])?;
    table.exclusive(&["albedo", "transfer"])?;
    table.exclusive(&["albedo_grid", "transfer"])?;
    table.exclusive(&["unitcube_to_world", "world_from_index", "up"])?;
    let looks = looks(table, scene, files)?;
    let phase = phase(table)?;
    let crop = crop(table)?;
    let emits = table.get("emission").is_some();
    let fields = kept.fields(table, || fields(table, &name, &path, files))?;
    let colors = colors(table, &path, files)?;
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
    let mut volumes = Vec::new();
    for whole in &fields {
        let (field, world_from_grid) = cropped(table, whole, crop.as_ref())?;
        for (scale, albedo) in looks.of(&field, &world_from_grid) {
            let sigma_t = field.grid(&scale, &path, files);
            let sigma_t = sigma_t.map_err(|e| e.at(path.display()))?;
            // A flame without smoke takes no light.
            if emits && sigma_t.max() == 0.0 {
                continue;
            }
            if !name.starts_with("builtin:") {
                depth::check(&field, &scale, &sigma_t, &world_from_grid, &path, files)?;
            }
            let noted = field.note_values(&path, files);
            noted.map_err(|e| e.at(path.display()))?;
            let albedo_grid = colors.as_ref().map(|colors| {
                let grids = colors.albedos((&field, &sigma_t), albedo, &path, files);
                let grids = grids.map_err(|e| e.at("albedo_grid").at(path.display()))?;
                Ok::<_, Error>(AlbedoGrid::new(grids.map(Into::into)))
            });
            let albedo_grid = albedo_grid.transpose()?;
            let number = volumes.len() + 1;
            volumes.push(VolumeInput {
                name: match number {
                    1 => plain.to_string(),
                    _ => format!("{plain} {number}"),
                },
                sigma_t,
                extinction_color: looks.extinction_color(),
                albedo,
                albedo_grid,
                phase,
                world_from_grid,
            });
        }
    }
    files.has_empty_volumes |= volumes.is_empty();
    Ok((volumes, (path, fields)))
}

/// What values look like.
enum Looks {
    /// How values become extinction, the albedo, and extinction over that by channel.
    One(Scale, [f32; 3], [f32; 3]),
    /// A factor on the extinctions of a preset.
    Preset(Transfer, f64),
}

impl Looks {
    /// Extinction by channel over that of the largest.
    fn extinction_color(&self) -> [f32; 3] {
        match self {
            Self::One(_, _, color) => *color,
            Self::Preset(..) => [1.0; 3],
        }
    }

    /// The scale and the albedo of each medium that a field becomes.
    fn of(&self, field: &Field, world_from_grid: &DAffine3) -> Vec<(Scale, [f32; 3])> {
        match self {
            Self::One(scale, albedo, _) => vec![(scale.clone(), *albedo)],
            Self::Preset(transfer, factor) => {
                // The distances of a preset are in the unit of the file.
                let size = |map: &DAffine3| map.matrix3.determinant().abs();
                let own = field.placed(None).map_or(1.0, |own| size(&own));
                let unit = libm::cbrt(size(world_from_grid) / own);
                transfer.bands(factor / unit)
            }
        }
    }
}

/// Extinction per unit of density by its largest channel, and that of all channels over it.
fn sigma_t_scale(item: &Item<'_>) -> Result<(f64, [f32; 3])> {
    const MOST: f64 = 1e30;
    if !item.is_list() {
        return Ok((item.number_within(0.0, MOST)?, [1.0; 3]));
    }
    let channels = item.numbers::<3>()?;
    if let Some(channel) = channels.iter().find(|c| !(0.0..=MOST).contains(*c)) {
        return Err(item.error(format_args!(
            "expected numbers from 0 to {MOST:e}, found {channel}"
        )));
    }
    let most = channels.into_iter().fold(0.0, f64::max);
    let over_most = |channel: f64| if most > 0.0 { channel / most } else { 1.0 };
    Ok((most, channels.map(|c| over_most(c) as f32)))
}

/// Scale and albedo by the table, or by the preset that it names.
fn looks(table: &Table<'_>, scene: &Path, files: &mut Files) -> Result<Looks> {
    let factor = |key: &str| -> Result<Option<f64>> {
        let item = table.get(key);
        item.map(|i| i.number_within(0.0, 1e30)).transpose()
    };
    if let Some(item) = table.get("transfer") {
        let name = files.at_frame(item.text()?);
        let path = beside(scene, &name.map_err(|e| table.locate(e))?);
        let content = files.read("transfer", &path).map_err(|e| table.locate(e))?;
        let transfer = Transfer::read(&content, &path, files).map_err(|e| e.at(path.display()))?;
        return Ok(Looks::Preset(
            transfer,
            factor("sigma_t_scale")?.unwrap_or(1.0),
        ));
    }
    let (sigma_t_scale, extinction_color) = sigma_t_scale(&table.require("sigma_t_scale")?)?;
    let density = if let Some(item) = table.get("window") {
        let [low, high] = item.numbers::<2>()?;
        if high <= low {
            return Err(item.error(format_args!(
                "expected the low end first, then a higher one, found {low} and {high}"
            )));
        }
        Density::Window([low, high])
    } else if let Some(item) = table.get("curve") {
        Density::Curve(curve(&item)?)
    } else {
        Density::Value
    };
    let scale = Scale {
        sigma_t: sigma_t_scale * factor("value_scale")?.unwrap_or(1.0),
        density,
    };
    let albedo = match table.get("albedo") {
        // What is not there scatters nothing, as of a flame alone.
        None if sigma_t_scale == 0.0 => [0.0; 3],
        _ => table.require("albedo")?.color(1.0)?,
    };
    Ok(Looks::One(scale, albedo, extinction_color))
}

/// Points of value and density.
pub fn curve(item: &Item<'_>) -> Result<Vec<[f64; 2]>> {
    let points = item.rows::<2>("points, as [[value, density], [value, density]]")?;
    if points.len() < 2 {
        return Err(item.error(format_args!(
            "expected two points of value and density or more, found {}",
            points.len()
        )));
    }
    if let Some(pair) = points.windows(2).find(|pair| pair[1][0] < pair[0][0]) {
        return Err(item.error(format_args!(
            "expected values that rise, found {} after {}",
            pair[1][0], pair[0][0]
        )));
    }
    if let Some([_, density]) = points.iter().find(|[_, d]| !(0.0..=1e30).contains(d)) {
        return Err(item.error(format_args!(
            "expected densities from 0 to 1e30, found {density}"
        )));
    }
    Ok(points)
}

/// The key, and the least and the greatest corner of the box.
type Crop<'a> = (Item<'a>, [f64; 3], [f64; 3]);

/// What is left of a field, and its placement.
fn cropped(table: &Table, whole: &Field, crop: Option<&Crop>) -> Result<(Field, DAffine3)> {
    let Some((item, min, max)) = crop else {
        return Ok((whole.clone(), placement(table, whole)?));
    };
    let field = whole.cropped(*min, *max);
    let field = field.ok_or_else(|| item.error("no centre of a voxel is in the box"))?;
    let moved = std::array::from_fn(|a| (field.start[a] - whole.start[a]) as f64);
    let moved = DAffine3::from_translation(DVec3::from_array(moved));
    Ok((field, placement(table, whole)? * moved))
}

/// A box of which each end is a share of the file's box along its own axes.
fn crop<'a>(table: &Table<'a>) -> Result<Option<Crop<'a>>> {
    let Some(item) = table.get("crop") else {
        return Ok(None);
    };
    let inner = item.table("`crop`", &["min", "max"])?;
    let end = |key: &str, plain: f64| match inner.get(key) {
        Some(item) => item.numbers::<3>(),
        None => Ok([plain; 3]),
    };
    let (min, max) = (end("min", 0.0)?, end("max", 1.0)?);
    if let Some(a) = (0..3).find(|&a| !(0.0 <= min[a] && min[a] < max[a] && max[a] <= 1.0)) {
        return Err(item.error(format_args!(
            "expected shares of the box with 0 <= min < max <= 1 along each axis, found {} and {}",
            min[a], max[a]
        )));
    }
    Ok(Some((item, min, max)))
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

/// Whether the file's z is up, if the table says.
fn has_z_up(table: &Table<'_>) -> Result<Option<bool>> {
    let up = table.get("up").map(|item| item.choice(&["y", "z"]));
    Ok(up.transpose()?.map(|choice| choice == 1))
}

/// The map from the space of the grid to the world, by the table or else by the file.
pub fn placement(table: &Table<'_>, field: &Field) -> Result<DAffine3> {
    let placed = if let Some(item) = table.get("unitcube_to_world") {
        item.affine()? * field.unitcube_from_grid()
    } else if let Some(item) = table.get("world_from_index") {
        item.affine()? * field.file_from_grid()
    } else if let Some(placed) = field.placed(has_z_up(table)?) {
        placed
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

/// The colours of a volume's albedo, if they are in its file.
fn colors(table: &Table<'_>, path: &Path, files: &mut Files) -> Result<Option<ColorFields>> {
    let Some(item) = table.get("albedo_grid") else {
        return Ok(None);
    };
    let name = item.text()?;
    let content = files.map("volume", path).map_err(|e| table.locate(e))?;
    let colors = vdb::read_colors(content, name, files);
    Ok(Some(colors.map_err(|e| e.at(path.display()))?))
}

/// The samples of the grids of a volume file; none if it has no active voxel.
pub fn fields(table: &Table<'_>, name: &str, path: &Path, files: &mut Files) -> Result<Vec<Field>> {
    let kind = extension(path);
    let keys: [(&str, &[&str]); 2] = [
        ("raw", &["dims", "dtype", "endian"]),
        ("vdb", &["grid", "albedo_grid"]),
    ];
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
        "vdb" => None,
        kind if FIELD_FILES.contains(&kind) => None,
        other => {
            return Err(table
                .error(format_args!(
                    "a volume with the extension \"{other}\" is not supported"
                ))
                .hint(match other {
                    "dcm" | "" | "ima" => {
                        "turn a DICOM folder into NIfTI first, for example with \
                         `dcm2niix -z y FOLDER`"
                    }
                    _ => {
                        "volumes are .vdb, .nrrd, .nhdr, .nii, .nii.gz, .mhd, .mha, \
                         .vol or .raw files"
                    }
                }));
        }
    };
    let grid = table.get("grid").map(|i| i.text()).transpose()?;
    files.enter(path);
    let one = |field| vec![field];
    if kind == "vdb" {
        let content = files.map("volume", path).map_err(|e| table.locate(e))?;
        let colors = table.get("albedo_grid").map(|i| i.text()).transpose()?;
        let fields = vdb::read(content, path, grid.into(), colors, files);
        return fields.map_err(|e| e.at(path.display()));
    }
    let fields = match layout {
        Some((dims, number, big_endian)) => {
            let content = files.map("volume", path).map_err(|e| table.locate(e))?;
            raw::read(content, dims, number, big_endian).map(one)
        }
        None => {
            let content = files.read("volume", path).map_err(|e| table.locate(e))?;
            read_field(&kind, content, path, files).map(one)
        }
    };
    fields.map_err(|e| e.at(path.display()))
}

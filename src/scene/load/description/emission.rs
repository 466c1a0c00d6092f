//! What the volumes of a scene file send out by themselves.

use super::named;
use super::volume::{FILE_KEYS, curve, fields, placement};
use crate::Result;
use crate::scene::Emission;
use crate::scene::builder::{EmissiveInput, MAX_EMISSION};
use crate::scene::load::field::Field;
use crate::scene::load::files::Files;
use crate::scene::load::scale::{Density, Scale};
use crate::scene::load::table::Table;
use std::path::{Path, PathBuf};

/// Keys of an emission.
const EMISSION: [&str; 10] = [
    "file", "grid", "dims", "dtype", "endian", "scale", "color", "kelvin", "curve", "group",
];

/// The `emission` of a volume.
pub struct EmissionTable<'a> {
    table: Table<'a>,
    emission: Emission,
    /// From what is in the file to the values of the emission.
    values: Scale,
}

impl<'a> EmissionTable<'a> {
    /// That of the table of a volume, if it has one.
    pub fn of(volume: &Table<'a>) -> Result<Option<Self>> {
        let Some(item) = volume.get("emission") else {
            return Ok(None);
        };
        volume.exclusive(&["emission", "crop"])?;
        let table = item.table("`emission`", &EMISSION)?;
        table.exclusive(&["color", "kelvin"])?;
        let within = |key: &str| -> Result<Option<f64>> {
            let item = table.get(key);
            item.map(|i| i.number_within(0.0, 1e30)).transpose()
        };
        let (scale, kelvin) = (within("scale")?, within("kelvin")?);
        let color = table.get("color").map(|i| i.color(MAX_EMISSION));
        let color = color.transpose()?.unwrap_or([1.0; 3]);
        let (emission, factor) = match (kelvin, scale) {
            (Some(kelvin), scale) => {
                let scale = scale.unwrap_or(1.0) as f32;
                (Emission::Blackbody { scale }, kelvin)
            }
            (None, Some(scale)) => {
                let radiance = color.map(|c| c * scale as f32);
                (Emission::Proportional { radiance }, 1.0)
            }
            (None, None) => {
                let expected = "expected `scale`, the radiance per unit of length where a value is \
                     1, or `kelvin`, the temperature there";
                return Err(table.error(expected));
            }
        };
        let density = match table.get("curve") {
            Some(item) => Density::Curve(curve(&item)?),
            None => Density::Value,
        };
        Ok(Some(Self {
            emission,
            values: Scale {
                sigma_t: factor,
                density,
            },
            table,
        }))
    }

    /// The table itself.
    pub fn table(&self) -> &Table<'a> {
        &self.table
    }

    /// The volumes that light comes from: of a file or a grid of its own, or of the `known` fields
    /// of the volume.
    pub fn read(
        &self,
        volume: &Table<'a>,
        scene: &Path,
        known: (PathBuf, Vec<Field>),
        files: &mut Files,
    ) -> Result<Vec<EmissiveInput>> {
        let has_own = FILE_KEYS.iter().any(|key| self.table.get(key).is_some());
        let (path, fields) = match has_own {
            false => known,
            true => {
                let of = match self.table.get("file") {
                    Some(_) => &self.table,
                    None => volume,
                };
                let (name, path) = named(of, scene, files)?;
                let fields = fields(&self.table, &name, &path, files)?;
                (path, fields)
            }
        };
        let mut emissive = Vec::new();
        for field in &fields {
            let world_from_grid = placement(volume, field)?;
            let values = field.grid(&self.values, &path, files);
            let values = values.map_err(|e| e.at(path.display()))?;
            if values.max() > 0.0 {
                let name = path.file_stem().unwrap_or_default().to_string_lossy();
                let emission = self.emission;
                emissive.push(EmissiveInput::new(name, values, emission, world_from_grid));
            }
        }
        if emissive.is_empty() {
            let path = path.display();
            files.warn(format!(
                "{path}: no value of its emission is above 0; nothing comes from it"
            ));
        }
        Ok(emissive)
    }
}

//! The lights of a scene file.

use crate::Result;
use crate::scene::builder::{EnvironmentInput, LightInput, MAX_EMISSION};
use crate::scene::load::environment;
use crate::scene::load::files::{Files, beside};
use crate::scene::load::table::Table;
use std::path::Path;

/// Keys of lights.
pub const LIGHT: [&str; 15] = [
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
    "visible",
    "group",
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
/// Those that an environment of an image has.
const IMAGE: [&str; 5] = ["image", "radiance", "rotate_deg", "sun", "visible"];
/// Refuses keys of lights that one of this type does not have.
fn only(table: &Table<'_>, keys: &[&str]) -> Result<()> {
    for key in LIGHT {
        if !["type", "group"].contains(&key) && !keys.contains(&key) && table.get(key).is_some() {
            return Err(table
                .error(format_args!("this type of light has no `{key}`"))
                .hint(format!("its keys are {}", keys.join(", "))));
        }
    }
    Ok(())
}

/// Whether `visible = false` hides environments from cameras. It hides all of them or none: a
/// picture has one background.
pub fn are_environments_unseen(lights: &[Table<'_>]) -> Result<bool> {
    let mut first: Option<bool> = None;
    for table in lights {
        if LIGHT_TYPES[table.require("type")?.choice(&LIGHT_TYPES)?] != "environment" {
            continue;
        }
        let item = table.get("visible");
        let is_seen = item.as_ref().map_or(Ok(true), |item| item.flag())?;
        if *first.get_or_insert(is_seen) != is_seen {
            return Err(table
                .error("expected `visible` to be the same for all environments, found both")
                .hint("add `visible = false` to each of them, or to none"));
        }
    }
    Ok(first == Some(false))
}

/// The image of an environment; `None` for lights without one.
pub fn environment_image(
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
    only(table, &IMAGE)?;
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
    let name = files.at_frame(image.text()?);
    let path = beside(scene, &name.map_err(|e| table.locate(e))?);
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

/// Refuses what is wrong with a light that is not wanted.
pub fn check(table: &Table<'_>) -> Result<()> {
    match table.get("image") {
        None => light(table).map(drop),
        Some(_) => only(table, &IMAGE),
    }
}

/// A light of another kind.
pub fn light(table: &Table<'_>) -> Result<LightInput> {
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
            only(&["radiance", "image", "visible"])?;
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

//! The cameras of a scene file.

use crate::Result;
use crate::scene::builder::CameraInput;
use crate::scene::load::table::Table;
use crate::scene::{CameraKey, Lens};
use glam::DVec3;

/// Keys of cameras.
pub const CAMERA: [&str; 10] = [
    "name",
    "position",
    "target",
    "up",
    "camera_to_world",
    "fov_x_deg",
    "aperture",
    "focus_distance",
    "shutter",
    "key",
];
/// Keys of where a camera is at a frame.
pub const CAMERA_KEY: [&str; 8] = [
    "frame",
    "position",
    "target",
    "up",
    "camera_to_world",
    "fov_x_deg",
    "aperture",
    "focus_distance",
];

/// The camera of a table, the first of them being number 0.
pub fn camera(table: &Table<'_>, index: usize) -> Result<CameraInput> {
    let lens = lens(table, [None; 2])?;
    let camera = place(table, index)?;
    let camera = match lens {
        // Keys have theirs.
        Some(lens) if table.get("key").is_none() => camera.lens(lens.aperture, lens.focus_distance),
        _ => camera,
    };
    let Some(item) = table.get("shutter") else {
        return Ok(camera);
    };
    let [open, close] = item.numbers()?;
    if open >= close {
        return Err(item.error(format_args!(
            "expected when the shutter opens and, later, closes, in frames, \
             found {open} and {close}"
        )));
    }
    Ok(camera.shutter(open, close))
}

/// The aperture and the focus distance of a table, or those that its keys have if they have none.
fn lengths(table: &Table<'_>, default: [Option<f64>; 2]) -> Result<[Option<f64>; 2]> {
    let given = |key: &str, low: f64| {
        let item = table.get(key);
        item.map(|i| i.number_within(low, 1e15)).transpose()
    };
    let [aperture, focus_distance] = default;
    Ok([
        given("aperture", 0.0)?.or(aperture),
        given("focus_distance", 1e-15)?.or(focus_distance),
    ])
}

/// The lens of a table; `None` for a pinhole.
fn lens(table: &Table<'_>, default: [Option<f64>; 2]) -> Result<Option<Lens>> {
    match lengths(table, default)? {
        [Some(aperture), Some(focus)] => Ok(Lens::new(aperture as f32, focus as f32)),
        [Some(aperture), None] if aperture > 0.0 && table.get("key").is_none() => {
            Err(table.error("`aperture` needs a `focus_distance`, at which things are sharp"))
        }
        _ => Ok(None),
    }
}

fn place(table: &Table<'_>, index: usize) -> Result<CameraInput> {
    for key in ["position", "target", "up"] {
        table.exclusive(&["camera_to_world", key])?;
    }
    let name = match table.get("name") {
        Some(name) => name.text()?.into(),
        None => format!("camera {}", index + 1),
    };
    let fov_x_rad = fov(table, 45_f64.to_radians())?;
    if table.get("key").is_some() {
        return moving_camera(table, name, fov_x_rad);
    }
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

fn fov(table: &Table<'_>, default_rad: f64) -> Result<f64> {
    let given = table.get("fov_x_deg");
    let given = given.map(|item| item.number_within(0.01, 179.0));
    Ok(given.transpose()?.map_or(default_rad, f64::to_radians))
}

/// A camera by its keys; its own `up` and field of view are those of keys that have none.
fn moving_camera(table: &Table<'_>, name: String, fov_x_rad: f64) -> Result<CameraInput> {
    for key in ["position", "target", "camera_to_world"] {
        table.exclusive(&["key", key])?;
    }
    let up = table.get("up").map(|up| up.vector()).transpose()?;
    let own = lengths(table, [None; 2])?;
    let keys = table.tables("key", &CAMERA_KEY)?.into_iter().map(|key| {
        let lens = lens(&key, own)?;
        let fov_x_rad = fov(&key, fov_x_rad)?;
        let frame = key.require("frame")?.frame()?;
        for other in ["position", "target", "up"] {
            key.exclusive(&["camera_to_world", other])?;
        }
        if let Some(item) = key.get("camera_to_world") {
            let placed = CameraInput::placed("", item.affine()?, fov_x_rad);
            let placed = placed.map_err(|e| item.error(e))?.as_key(frame);
            return Ok(CameraKey { lens, ..placed });
        }
        let position = key.require("position")?.vector()?;
        let target = key.require("target")?.vector()?;
        let own_up = key.get("up").map(|up| up.vector()).transpose()?;
        let up = own_up.or(up).unwrap_or(DVec3::Y);
        CameraInput::look_at("", position, target, up, fov_x_rad).map_err(|e| key.error(e))?;
        Ok(CameraKey {
            frame,
            position,
            target,
            up,
            fov_x_rad,
            lens,
        })
    });
    let keys = keys.collect::<Result<Vec<_>>>()?;
    CameraInput::moving(name, keys).map_err(|e| table.error(e))
}

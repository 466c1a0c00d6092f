//! Cameras of a Mitsuba file.

use super::clip::ClipPlanes;
use super::element::Element;
use super::{Reader, plugins};
use crate::Result;
use crate::scene::Film;
use crate::scene::builder::CameraInput;
use glam::{DAffine3, DVec3};

/// Keys of cameras and films that make no difference here.
const SENSOR: [&str; 5] = [
    "shutter_open",
    "shutter_close",
    "principal_point_offset_x",
    "principal_point_offset_y",
    "srf",
];
const LENS: [&str; 2] = ["focus_distance", "aperture_radius"];
const FILM: [&str; 12] = [
    "file_format",
    "pixel_format",
    "component_format",
    "banner",
    "sample_border",
    "high_quality_edges",
    "compensate",
    "gamma",
    "tonemap_method",
    "attach_log",
    "crop_width",
    "crop_height",
];

impl Reader<'_> {
    /// Takes a camera; the film of the first is that of the scene.
    pub(super) fn sensor(&mut self, sensor: &Element<'_>) -> Result<()> {
        sensor.take();
        match sensor.kind() {
            "perspective" => sensor.ignore(&LENS)?,
            "thinlens" => {}
            kind => {
                if let Some(error) = plugins::unknown(sensor) {
                    return Err(error);
                }
                let what = format!("cameras of the type `{kind}` are left out");
                self.left_out.note(&what, sensor.line());
                return Ok(());
            }
        }
        for key in ["principal_point_offset_x", "principal_point_offset_y"] {
            if sensor.number(key)?.is_some_and(|offset| offset != 0.0) {
                let what = "cameras that are not in the middle of their picture are put there";
                self.left_out.note(what, sensor.line());
            }
        }
        sensor.ignore(&SENSOR)?;
        for tag in ["sampler", "medium", "rfilter"] {
            sensor.object(tag)?;
        }
        let film = self.film(sensor)?;
        let fov_x_rad = fov(sensor, &film)?;
        let world_from_camera = self.placed(sensor)?;
        let number = self.builder.cameras.len() + 1;
        let name = sensor
            .id()
            .map_or_else(|| format!("camera {number}"), str::to_owned);
        self.clip(sensor, &film, fov_x_rad, &world_from_camera)?;
        let camera = CameraInput::placed(name, world_from_camera, fov_x_rad);
        let camera = camera.map_err(|e| sensor.locate(e))?;
        let camera = match sensor.kind() {
            "thinlens" => with_lens(sensor, camera)?,
            _ => camera,
        };
        match self.builder.film {
            None => self.builder.film = Some(film),
            Some(first) if (first.width, first.height) != (film.width, film.height) => {
                let what = "films of another size than that of the first camera are taken as that";
                self.left_out.note(what, sensor.line());
            }
            Some(_) => {}
        }
        self.builder.add_cameras(vec![camera]);
        Ok(())
    }

    /// Keeps its clip planes, if it states some, until there are surfaces that they may cut.
    fn clip(
        &mut self,
        sensor: &Element<'_>,
        film: &Film,
        fov_x_rad: f64,
        world_from_camera: &DAffine3,
    ) -> Result<()> {
        let near = sensor.number("near_clip")?.unwrap_or(ClipPlanes::NEAR);
        let far = sensor.number("far_clip")?.unwrap_or(ClipPlanes::FAR);
        if near > ClipPlanes::NEAR || far < ClipPlanes::FAR {
            let tan_x = libm::tan(0.5 * fov_x_rad);
            let tan_y = tan_x * f64::from(film.height) / f64::from(film.width);
            self.clip_planes.push(ClipPlanes {
                camera_from_world: world_from_camera.inverse(),
                tan: [tan_x, tan_y],
                near,
                far,
                line: sensor.line(),
            });
        }
        Ok(())
    }

    /// Its map from a space in which it looks along -z with +x to the right.
    fn placed(&mut self, sensor: &Element<'_>) -> Result<DAffine3> {
        let map = sensor.transform("to_world")?;
        let m = map.matrix3;
        let [mut x, y, z] =
            [-m.x_axis, m.y_axis, -m.z_axis].map(|v| v.try_normalize().unwrap_or(v));
        if x.cross(y).dot(z) < 0.0 {
            let what = "cameras that mirror their picture do not";
            self.left_out.note(what, sensor.line());
            x = -x;
        }
        Ok(DAffine3 {
            matrix3: glam::DMat3::from_cols(x, y, z),
            translation: map.translation,
        })
    }

    fn film(&mut self, sensor: &Element<'_>) -> Result<Film> {
        let (mut width, mut height) = (768, 576);
        if let Some(film) = sensor.object("film")? {
            if let Some(error) = plugins::unknown(&film) {
                return Err(error);
            }
            let most = i64::from(Film::MAX_SIDE);
            width = film.whole("width", 1, most)?.unwrap_or(width);
            height = film.whole("height", 1, most)?.unwrap_or(height);
            let [left, top] =
                ["crop_offset_x", "crop_offset_y"].map(|key| film.whole(key, 0, most));
            let (left, top) = (left?.unwrap_or(0), top?.unwrap_or(0));
            let across = film.whole("crop_width", 1, most)?.unwrap_or(width);
            let down = film.whole("crop_height", 1, most)?.unwrap_or(height);
            if (left, top, across, down) != (0, 0, width, height) {
                let (right, bottom) = ((left + across).min(width), (top + down).min(height));
                let what = "crops of films are left out";
                let region = format_args!(
                    "{} (shade them by `region` {left} {top} {right} {bottom})",
                    film.line()
                );
                self.left_out.note(what, region);
            }
            film.ignore(&FILM)?;
            film.object("rfilter")?;
            if film
                .number("exposure")?
                .is_some_and(|exposure| exposure != 0.0)
            {
                self.left_out
                    .note("exposures of films are left out", film.line());
            }
        }
        Ok(Film {
            width: width as u32,
            height: height as u32,
            exposure: 1.0,
        })
    }
}

/// A camera with the lens of a `thinlens`.
fn with_lens(sensor: &Element<'_>, camera: CameraInput) -> Result<CameraInput> {
    let aperture = sensor.number_within("aperture_radius", 0.0, 1e15)?;
    let aperture = aperture.ok_or_else(|| sensor.error("expected an `aperture_radius`"))?;
    let focus_distance = sensor.number_within("focus_distance", 1e-15, 1e15)?;
    let far_clip = sensor.number_within("far_clip", 1e-15, 1e15)?;
    // As Mitsuba has it: without one the background is sharp.
    let focus_distance = focus_distance.or(far_clip).unwrap_or(1e4);
    Ok(camera.lens(aperture as f32, focus_distance as f32))
}

/// The horizontal field of view.
fn fov(sensor: &Element<'_>, film: &Film) -> Result<f64> {
    let aspect = f64::from(film.width) / f64::from(film.height);
    let axis = sensor.text("fov_axis")?.unwrap_or("x").to_ascii_lowercase();
    let given = sensor.number_within("fov", 1e-3, 179.99)?;
    let (tan, axis) = match (given, sensor.text("focal_length")?) {
        (Some(_), Some(_)) => {
            return Err(sensor.error("`fov` and `focal_length` exclude each other"));
        }
        (Some(degrees), None) => (libm::tan(0.5 * degrees.to_radians()), axis),
        // In millimetres, for the diagonal of a film of 36 by 24.
        (None, length) => {
            let text = length.unwrap_or("50mm");
            let number = text.trim_end_matches("mm").trim().parse::<f64>().ok();
            let length = number
                .filter(|n| n.is_finite() && *n > 0.0)
                .ok_or_else(|| {
                    sensor.error(format_args!(
                        "`focal_length`: expected one as 50mm, found {text}"
                    ))
                })?;
            (
                DVec3::new(36.0, 24.0, 0.0).length() / (2.0 * length),
                "diagonal".into(),
            )
        }
    };
    let tan_x = match axis.as_str() {
        "x" => tan,
        "y" => tan * aspect,
        "smaller" if aspect > 1.0 => tan * aspect,
        "larger" if aspect <= 1.0 => tan * aspect,
        "smaller" | "larger" => tan,
        "diagonal" => tan / (1.0 + 1.0 / (aspect * aspect)).sqrt(),
        other => {
            let what = "expected x, y, diagonal, smaller or larger";
            return Err(sensor.error(format_args!("`fov_axis`: {what}, found {other}")));
        }
    };
    Ok(2.0 * libm::atan(tan_x))
}

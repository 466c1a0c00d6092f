//! Lights of a Mitsuba file that are no shapes.

use super::element::Element;
use super::{Reader, plugins};
use crate::Result;
use crate::scene::EnvironmentImage;
use crate::scene::builder::{EnvironmentInput, LightInput, MAX_EMISSION};
use crate::scene::load::environment;
use glam::{DAffine3, DMat3, DVec3, Vec3};

impl Reader<'_> {
    /// Takes a light.
    pub(super) fn emitter(&mut self, emitter: &Element<'_>) -> Result<()> {
        emitter.take();
        emitter.ignore(&["sampling_weight", "mis_compensation"])?;
        let light = match emitter.kind() {
            "point" => {
                let intensity = self.light(emitter, "intensity")?;
                let position = match emitter.vector("position")? {
                    Some(position) => position,
                    None => emitter.transform("to_world")?.translation,
                };
                LightInput::point(position, intensity)
            }
            "spot" => self.spot(emitter)?,
            "directional" => {
                let irradiance = self.light(emitter, "irradiance")?;
                let direction = match emitter.vector("direction")? {
                    Some(direction) => direction,
                    None => emitter.transform("to_world")?.transform_vector3(DVec3::Z),
                };
                LightInput::sun(direction, irradiance, 0.0).map_err(|e| emitter.locate(e))?
            }
            "constant" => LightInput::environment(self.light(emitter, "radiance")?),
            "envmap" => return self.envmap(emitter),
            kind => {
                if let Some(error) = plugins::unknown(emitter) {
                    return Err(error);
                }
                let what = format!("lights of the type `{kind}` are left out");
                self.left_out.note(&what, emitter.line());
                for &child in &emitter.node().children {
                    emitter.tree.nodes[child].used.set(true);
                }
                return Ok(());
            }
        };
        self.builder.lights.push(light);
        Ok(())
    }

    fn spot(&mut self, emitter: &Element<'_>) -> Result<LightInput> {
        let intensity = self.light(emitter, "intensity")?;
        let to_world = emitter.transform("to_world")?;
        let cutoff = emitter
            .number_within("cutoff_angle", 0.01, 180.0)?
            .unwrap_or(20.0);
        let beam = emitter
            .number_within("beam_width", 0.0, 180.0)?
            .unwrap_or(0.75 * cutoff);
        if emitter.get("texture")?.is_some() {
            self.left_out
                .note("textures of spot lights are left out", emitter.line());
        }
        // A sharp border is one of a thousandth of the angle.
        let beam = beam.min(0.999 * cutoff);
        let direction = to_world.transform_vector3(DVec3::Z);
        let light = LightInput::spot(
            to_world.translation,
            direction,
            intensity,
            beam.to_radians(),
            cutoff.to_radians(),
        );
        light.map_err(|e| emitter.locate(e))
    }

    fn envmap(&mut self, emitter: &Element<'_>) -> Result<()> {
        if self.builder.environment_image.is_some() {
            return Err(emitter.error("another environment has an image, too"));
        }
        let name = emitter.require_text("filename")?;
        let scale = emitter
            .number_within("scale", 0.0, MAX_EMISSION.into())?
            .unwrap_or(1.0);
        let to_world = emitter.transform("to_world")?;
        let path = emitter.tree.find(emitter.node().place, name);
        let image = environment::load(&path, self.files).map_err(|e| emitter.locate(e))?;
        let image = image.scaled([scale as f32; 3]);
        let image = match turn_about_y(&to_world) {
            Some(angle) => image.rotated(angle as f32),
            None => turned(&image, &rotation(&to_world)).map_err(|e| emitter.locate(e))?,
        };
        self.builder.environment_image = Some(EnvironmentInput::new(image));
        Ok(())
    }
}

/// The turn and mirror of a map, without its scale.
fn rotation(map: &DAffine3) -> DMat3 {
    let m = map.matrix3;
    let unit = |v: DVec3| v.try_normalize().unwrap_or(v);
    DMat3::from_cols(unit(m.x_axis), unit(m.y_axis), unit(m.z_axis))
}

/// The angle from +z towards +x, if the map does no more than turn about y.
fn turn_about_y(map: &DAffine3) -> Option<f64> {
    let m = rotation(map);
    let [x, z] = [m.x_axis, m.z_axis];
    let is_plain = (m.y_axis - DVec3::Y).length() < 1e-9 && (z.cross(DVec3::Y) + x).length() < 1e-9;
    is_plain.then(|| libm::atan2(z.x, z.z))
}

/// The image as it is in a frame that is turned any other way: each texel the mean of sixteen.
fn turned(image: &EnvironmentImage, world_from_image: &DMat3) -> Result<EnvironmentImage> {
    const ALONG: usize = 4;
    let [width, height] = image.size();
    let image_from_world = world_from_image.transpose().as_mat3();
    let at = |i: u32, k: usize, n: u32| (i as f32 + (k as f32 + 0.5) / ALONG as f32) / n as f32;
    let mut texels = Vec::with_capacity(image.texels().len());
    for row in 0..height {
        for column in 0..width {
            let mut sum = Vec3::ZERO;
            for k in 0..ALONG * ALONG {
                let place = [at(column, k % ALONG, width), at(row, k / ALONG, height)];
                let direction = image_from_world * image.direction(place);
                sum += Vec3::from(image.seen(direction).0);
            }
            texels.push((sum / (ALONG * ALONG) as f32).to_array());
        }
    }
    EnvironmentImage::new(width, height, texels)
}

//! Colours and textures of a Mitsuba file, as linear Rec.709.

use super::element::{Element, words};
use super::{Reader, plugins};
use crate::math::observer;
use crate::scene::Texture;
use crate::scene::Wrap;
use crate::scene::builder::MAX_EMISSION;
use crate::scene::load::colors::{ColorEncoding, linear_from_srgb};
use crate::scene::load::texture::{self, Decoding};
use crate::{Error, Result};
use glam::DAffine2;

/// What colours a surface.
#[derive(Clone, Debug)]
pub(super) struct Paint {
    pub(super) color: [f32; 3],
    /// A factor on the colour, and the map of texture coordinates to it.
    pub(super) texture: Option<(Texture, DAffine2)>,
    /// Whether colours of vertices are a factor on it.
    pub(super) is_of_vertices: bool,
    /// How much of the surface is there, by luminance.
    pub(super) opacity: Option<Box<Paint>>,
}

impl Paint {
    pub(super) fn plain(color: [f32; 3]) -> Self {
        Self {
            color,
            texture: None,
            is_of_vertices: false,
            opacity: None,
        }
    }

    /// One colour in its place.
    pub(super) fn mean(&self) -> [f32; 3] {
        let mean = self
            .texture
            .as_ref()
            .map(|(texture, _)| texture::mean(texture));
        let mean = mean.unwrap_or([1.0; 3]);
        std::array::from_fn(|i| self.color[i] * mean[i])
    }
}

/// What a spectrum is of: even ones are the white E as light, that of Rec.709 of what is lit.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Role {
    Light,
    Lit,
}

impl Reader<'_> {
    /// The colour of a key of `element`; textures are told, and stand for their mean.
    pub(super) fn color(
        &mut self,
        element: &Element<'_>,
        key: &str,
        default: [f32; 3],
        most: f32,
    ) -> Result<[f32; 3]> {
        match element.get(key)? {
            Some(value) => self.even_color(element, key, (&value, Role::Lit), most),
            None => Ok(default),
        }
    }

    /// The colour of a key of a light, or 1.
    pub(super) fn light(&mut self, emitter: &Element<'_>, key: &str) -> Result<[f32; 3]> {
        match emitter.get(key)? {
            Some(value) => self.even_color(emitter, key, (&value, Role::Light), MAX_EMISSION),
            None => Ok([1.0; 3]),
        }
    }

    fn even_color(
        &mut self,
        element: &Element<'_>,
        key: &str,
        (value, role): (&Element<'_>, Role),
        most: f32,
    ) -> Result<[f32; 3]> {
        let paint = self.paint_of(value, role)?;
        if paint.texture.is_some() || paint.is_of_vertices {
            let what = format!(
                "`{key}` of {} takes one colour, the mean of its texture",
                element.kind()
            );
            self.left_out.note(&what, value.line());
        }
        checked(value, paint.mean(), most)
    }

    /// The colour or texture of a key of a surface.
    pub(super) fn paint(
        &mut self,
        element: &Element<'_>,
        key: &str,
        default: f32,
    ) -> Result<Paint> {
        let Some(value) = element.get(key)? else {
            return Ok(Paint::plain([default; 3]));
        };
        let mut paint = self.paint_of(&value, Role::Lit)?;
        if paint.color.iter().any(|c| *c > 1.0) {
            self.left_out
                .note("reflectances above 1 are taken as 1", value.line());
            paint.color = paint.color.map(|c| c.min(1.0));
        }
        paint.color = checked(&value, paint.color, 1.0)?;
        Ok(paint)
    }

    /// The radiance of a key of a light on a shape, or 1, and its texture.
    pub(super) fn radiance(&mut self, element: &Element<'_>, key: &str) -> Result<Paint> {
        let Some(value) = element.get(key)? else {
            return Ok(Paint::plain([1.0; 3]));
        };
        let mut paint = self.paint_of(&value, Role::Light)?;
        if paint.is_of_vertices {
            let what = "radiances of vertices are taken as 1";
            self.left_out.note(what, value.line());
            paint.is_of_vertices = false;
        }
        paint.color = checked(&value, paint.color, MAX_EMISSION)?;
        Ok(paint)
    }

    fn paint_of(&mut self, value: &Element<'_>, role: Role) -> Result<Paint> {
        let text = value.node().get("value").unwrap_or_default();
        match (value.tag(), value.kind()) {
            ("float" | "integer", _) => Ok(Paint::plain([value.as_number()? as f32; 3])),
            ("rgb", _) => Ok(Paint::plain(rgb(value, text, false)?)),
            ("srgb", _) => Ok(Paint::plain(rgb(value, text, true)?)),
            ("spectrum", "") => self.spectrum(value, text, role).map(Paint::plain),
            ("texture" | "spectrum", kind) => self.texture(value, kind, role),
            ("blackbody", _) => {
                self.left_out
                    .note("spectra of black bodies are taken as white", value.line());
                Ok(Paint::plain([1.0; 3]))
            }
            (other, _) => Err(value.error(format_args!(
                "`{}`: expected a colour or a texture, found <{other}>",
                value.name()
            ))),
        }
    }

    /// A number, or pairs of a wavelength and a value, as Mitsuba's modes of RGB take them.
    fn spectrum(&mut self, value: &Element<'_>, text: &str, role: Role) -> Result<[f32; 3]> {
        if text.is_empty() {
            self.left_out
                .note("spectra from files are taken as 1/2", value.line());
            return Ok([0.5; 3]);
        }
        if !text.contains(':') {
            let color = rgb(value, text, false)?;
            // In 0.6 even spectra are grey everywhere.
            if role == Role::Lit || words(text).nth(1).is_some() || value.tree.is_of_version_0() {
                return Ok(color);
            }
            let white = observer::color_of_light(|_| 1.0);
            return Ok(std::array::from_fn(|i| color[i] * white[i] as f32));
        }
        let mut samples: Vec<[f64; 2]> = Vec::new();
        for word in words(text) {
            let pair = word
                .split_once(':')
                .map(|(a, b)| value.list("value", &format!("{a} {b}")));
            match pair.transpose()?.as_deref() {
                Some(&[wavelength, v]) => samples.push([wavelength, v]),
                _ => return Err(value.error("expected pairs, as in 400:0.2, 700:0.4")),
            }
        }
        let increase = samples.windows(2).all(|pair| pair[0][0] < pair[1][0]);
        if samples.len() < 2 || !increase {
            return Err(value.error("expected two wavelengths at least, each above the last"));
        }
        let at = |nm: f64| interpolated(&samples, nm);
        let color = match role {
            Role::Light => observer::color_of_light(at),
            Role::Lit => observer::color_in_daylight(at),
        };
        let most = match role {
            Role::Light => f64::INFINITY,
            // Channels of saturated colours may be above 1 where no share of light is.
            Role::Lit => samples.iter().map(|s| s[1]).fold(1.0, f64::max),
        };
        Ok(color.map(|c| c.max(0.0).min(most) as f32))
    }

    fn texture(&mut self, element: &Element<'_>, kind: &str, role: Role) -> Result<Paint> {
        match kind {
            "bitmap" => self.bitmap(element),
            "uniform" | "rawconstant" => {
                let value = self.color(element, "value", [1.0; 3], f32::MAX)?;
                Ok(Paint::plain(value))
            }
            "srgb" => Ok(Paint::plain(self.color(
                element,
                "color",
                [1.0; 3],
                f32::MAX,
            )?)),
            "d65" => {
                let scale = element.number("scale")?.unwrap_or(1.0) as f32;
                let color = self.color(element, "color", [1.0; 3], f32::MAX)?;
                Ok(Paint::plain(color.map(|c| c * scale)))
            }
            // Of 0.6: a texture times a factor.
            "scale" => {
                let scale = self.color(element, "scale", [1.0; 3], f32::MAX)?;
                let inner = element.object("texture")?;
                let inner = inner.ok_or_else(|| element.error("there is no texture in it"))?;
                self.enter(element)?;
                let mut paint = self.paint_of(&inner, role)?;
                self.leave();
                paint.color = std::array::from_fn(|i| paint.color[i] * scale[i]);
                Ok(paint)
            }
            "mesh_attribute" | "vertexcolors" => {
                let name = element.text("name")?;
                if name.is_some_and(|name| name != "vertex_color") {
                    let what = "attributes of meshes other than `vertex_color` are taken as white";
                    self.left_out.note(what, element.line());
                    return Ok(Paint::plain([1.0; 3]));
                }
                Ok(Paint {
                    is_of_vertices: true,
                    ..Paint::plain([1.0; 3])
                })
            }
            "checkerboard" => {
                let first = self.color(element, "color0", [0.4; 3], 1.0)?;
                let second = self.color(element, "color1", [0.2; 3], 1.0)?;
                element.ignore(&["to_uv"])?;
                let what = "checkerboards are taken as the mean of their colours";
                self.left_out.note(what, element.line());
                Ok(Paint::plain(std::array::from_fn(|i| {
                    0.5 * (first[i] + second[i])
                })))
            }
            _ => {
                if let Some(error) = plugins::unknown(element) {
                    return Err(error);
                }
                let what = format!("textures of the type `{kind}` are taken as 1/2");
                self.left_out.note(&what, element.line());
                Ok(Paint::plain([0.5; 3]))
            }
        }
    }

    fn bitmap(&mut self, element: &Element<'_>) -> Result<Paint> {
        let name = element.require_text("filename")?;
        element.ignore(&[
            "format",
            "accel",
            "gamma",
            "channel",
            "cache",
            "max_anisotropy",
        ])?;
        let is_linear = element.flag("raw", false)?;
        let wrap = match element.text("wrap_mode")?.unwrap_or("repeat") {
            "repeat" => Wrap::Repeat,
            "mirror" => Wrap::Mirror,
            "clamp" => Wrap::Clamp,
            other => {
                return Err(element.error(format_args!(
                    "`wrap_mode`: expected repeat, mirror or clamp, found {other}"
                )));
            }
        };
        if element.text("filter_type")?.is_some_and(|f| f == "nearest") {
            self.left_out
                .note("textures without a filter are interpolated", element.line());
        }
        let uv = self.uv_map(element)?;
        let decoding = Decoding {
            encoding: match is_linear {
                true => ColorEncoding::Linear,
                false => ColorEncoding::Srgb,
            },
            ..Decoding::default()
        };
        let path = element.tree.find(element.node().place, name);
        let content = self
            .files
            .read("texture", &path)
            .map_err(|e| element.locate(e))?;
        let image = texture::decode(&content, &path, decoding, self.files)?;
        let mut image = match image {
            Ok(image) => image,
            // Such as EXR, of which surfaces have none.
            Err(e) => {
                let what = "textures that cannot be read are taken as 1/2";
                self.left_out
                    .note(what, format_args!("{} ({e})", element.line()));
                return Ok(Paint::plain([0.5; 3]));
            }
        };
        image.wrap = [wrap; 2];
        Ok(Paint {
            texture: Some((image, uv)),
            ..Paint::plain([1.0; 3])
        })
    }

    /// The map of texture coordinates, of version 3 or of 0.6.
    fn uv_map(&mut self, element: &Element<'_>) -> Result<DAffine2> {
        let m = element.transform("to_uv")?;
        let of = |key: &str, default: f64| -> Result<f64> {
            Ok(element.number(key)?.unwrap_or(default))
        };
        let offset = glam::DVec2::new(of("uoffset", 0.0)?, of("voffset", 0.0)?);
        let scale = glam::DVec2::new(of("uscale", 1.0)?, of("vscale", 1.0)?);
        let own = DAffine2 {
            matrix2: glam::DMat2::from_cols(
                m.matrix3.x_axis.truncate(),
                m.matrix3.y_axis.truncate(),
            ),
            translation: m.translation.truncate(),
        };
        Ok(own * DAffine2::from_scale(scale) * DAffine2::from_translation(offset))
    }
}

/// One, three or, in hexadecimal, six digits.
fn rgb(element: &Element<'_>, text: &str, is_encoded: bool) -> Result<[f32; 3]> {
    let (values, is_encoded) = match text.trim().strip_prefix('#') {
        Some(digits) if digits.len() == 6 && digits.is_ascii() => {
            let channel = |i: usize| u8::from_str_radix(&digits[2 * i..2 * i + 2], 16).ok();
            let channels = [channel(0), channel(1), channel(2)];
            let values = channels.iter().flatten().map(|c| f64::from(*c) / 255.0);
            (values.collect(), true)
        }
        _ => (element.list("value", text)?, is_encoded),
    };
    let color = match values[..] {
        [v] => [v; 3],
        [r, g, b] => [r, g, b],
        _ => {
            return Err(element.error(format_args!(
                "`{}`: expected one number or three, found \"{text}\"",
                element.name()
            )));
        }
    };
    let color = color.map(|c| c as f32);
    Ok(match is_encoded {
        true => color.map(linear_from_srgb),
        false => color,
    })
}

/// The value of a spectrum at a wavelength; 0 where it says nothing.
fn interpolated(samples: &[[f64; 2]], nm: f64) -> f64 {
    let after = samples.partition_point(|s| s[0] < nm);
    match (after.checked_sub(1).map(|i| samples[i]), samples.get(after)) {
        (_, Some(&[at, value])) if at == nm => value,
        (Some([a, low]), Some(&[b, high])) => low + (high - low) * (nm - a) / (b - a),
        _ => 0.0,
    }
}

fn checked(element: &Element<'_>, color: [f32; 3], most: f32) -> Result<[f32; 3]> {
    match color.iter().find(|c| !(0.0..=most).contains(*c)) {
        None => Ok(color),
        Some(c) => {
            let what = format_args!(
                "`{}`: expected numbers from 0 to {most:e}, found {c}",
                element.name()
            );
            Err(Error::input(what.to_string())).map_err(|e| element.locate(e))
        }
    }
}

//! A rendered frame or a tile of one: named layers of float channels over a region.

use super::{Picture, Region};
use crate::{Error, Result};
use std::collections::BTreeMap;
use std::fmt;

/// A frame, or the part of it that a tile covers.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame {
    /// Pixels across of the whole frame (the display window).
    pub width: u32,
    /// Pixels down of the whole frame.
    pub height: u32,
    /// The pixels that are here (the data window).
    pub region: Region,
    /// Layers, the beauty first.
    pub layers: Vec<Layer>,
    /// Text attributes that say what the pixels were made from, such as `lvox/tree`. Nothing that
    /// differs between tiles of one frame belongs here: a merged frame must be the same file as one
    /// rendered whole.
    pub attributes: BTreeMap<String, String>,
    /// Where the whole frame was taken from, if that is known.
    pub camera: Option<CameraMatrices>,
}

/// Where a frame was taken from, as the standard attributes of OpenEXR tell it: matrices that stand
/// behind points as rows, p' = p M, row by row.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraMatrices {
    /// From world space to the camera's: x to the right, y up, z into the picture.
    pub world_to_camera: [f32; 16],
    /// From world space to the picture, divided by the fourth coordinate: (0, 0) is the top left
    /// corner of the whole frame and (1, 1) the lower right one.
    pub world_to_ndc: [f32; 16],
}

/// The attribute that tells what colours are, of the Color Interop Forum and OpenEXR 3.4, and that
/// they are linear radiance with the primaries of Rec.709.
pub const COLOR_SPACE: [&str; 2] = ["colorInteropID", "lin_rec709_scene"];

/// Depth where a pixel shows no surface: finite, as compositors want it, and the one of Blender.
pub const BACKGROUND_DEPTH: f32 = 1e10;

/// Name of the attribute that holds the film's exposure: the factor on radiance that a picture is
/// meant to be looked at with.
pub const EXPOSURE: &str = "lvox/exposure";

/// Channels that belong together.
#[derive(Clone, Debug, PartialEq)]
pub struct Layer {
    /// Name: `""` for the beauty, else `direct`, `environment`, `indirect`, `volume`, `depth`,
    /// `distance`, `normal`, `position`, `albedo`, `variance`.
    pub name: String,
    /// Name of each channel (`R`, `G`, `B`, in the beauty perhaps `A`; `Z`; or `X`, `Y`, `Z`) and
    /// its samples, row by row inside the region.
    pub channels: Vec<(String, Vec<f32>)>,
}

impl Layer {
    /// Makes a colour layer from pixels that lie row by row.
    #[must_use]
    pub fn rgb(name: &str, pixels: &[[f32; 3]]) -> Self {
        Self::from_triples(name, ["R", "G", "B"], pixels)
    }

    /// Makes a vector layer (normals) from pixels that lie row by row.
    #[must_use]
    pub fn xyz(name: &str, pixels: &[[f32; 3]]) -> Self {
        Self::from_triples(name, ["X", "Y", "Z"], pixels)
    }

    /// Makes a layer of one channel.
    #[must_use]
    pub fn single(name: &str, channel: &str, samples: Vec<f32>) -> Self {
        Self {
            name: name.into(),
            channels: vec![(channel.into(), samples)],
        }
    }

    fn from_triples(name: &str, channels: [&str; 3], pixels: &[[f32; 3]]) -> Self {
        let channels = channels
            .iter()
            .enumerate()
            .map(|(i, c)| ((*c).into(), pixels.iter().map(|p| p[i]).collect()))
            .collect();
        Self {
            name: name.into(),
            channels,
        }
    }

    /// Samples of a channel.
    #[must_use]
    pub fn channel(&self, name: &str) -> Option<&[f32]> {
        let (_, samples) = self.channels.iter().find(|(n, _)| n == name)?;
        Some(samples)
    }
}

/// The pixels of a frame that are infinite or not a number.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NotFinite {
    /// How many they are.
    pub pixels: usize,
    /// The first of them, from the top: its column and row in the whole frame.
    pub first: [u32; 2],
    /// Full names of the channels that have any.
    pub channels: Vec<String>,
}

impl fmt::Display for NotFinite {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (are, plural) = match self.pixels {
            1 => ("is", ""),
            _ => ("are", "s"),
        };
        let [x, y] = self.first;
        write!(
            f,
            "{} pixel{plural} {are} infinite or not a number, the first at ({x}, {y}), in the \
             channels {}",
            self.pixels,
            self.channels.join(", ")
        )
    }
}

/// Layers that are infinite by meaning: where a ray meets nothing, and of too few samples.
const MAY_BE_INFINITE: [&str; 2] = ["depth", "variance"];

impl Frame {
    /// Makes an empty frame, without layers.
    #[must_use]
    pub fn new(width: u32, height: u32, region: Region) -> Self {
        Self {
            width,
            height,
            region,
            layers: Vec::new(),
            attributes: BTreeMap::new(),
            camera: None,
        }
    }

    /// The layer of this name; `""` is the beauty.
    #[must_use]
    pub fn layer(&self, name: &str) -> Option<&Layer> {
        self.layers.iter().find(|l| l.name == name)
    }

    /// Checks that the region lies inside the frame, that names are unique, and that every channel
    /// has a sample for every pixel of the region.
    ///
    /// # Errors
    /// [`crate::Kind::Input`] naming the layer and channel.
    pub fn check(&self) -> Result<()> {
        self.region.check(self.width, self.height)?;
        let mut names = std::collections::BTreeSet::new();
        for layer in &self.layers {
            for (channel, samples) in &layer.channels {
                let full_name = channel_name(&layer.name, channel);
                if samples.len() != self.region.pixels() {
                    return Err(Error::input(format!(
                        "channel {full_name} has {} samples, its region has {} pixels",
                        samples.len(),
                        self.region.pixels()
                    )));
                }
                if !names.insert(full_name.clone()) {
                    return Err(Error::input(format!("channel {full_name} is there twice")));
                }
            }
        }
        if names.is_empty() {
            return Err(Error::input("an image needs at least one channel"));
        }
        Ok(())
    }

    /// Finds the pixels that no picture can show: those of which a channel is infinite or not a
    /// number. Depth and variance may be infinite.
    #[must_use]
    pub fn not_finite(&self) -> Option<NotFinite> {
        let (mut found, mut channels) = (Vec::new(), Vec::new());
        for layer in &self.layers {
            let may_be_infinite = MAY_BE_INFINITE.contains(&&*layer.name);
            let is_wrong = |v: f32| !(v.is_finite() || may_be_infinite && v == f32::INFINITY);
            for (channel, samples) in &layer.channels {
                let before = found.len();
                let wrong = samples.iter().enumerate().filter(|(_, v)| is_wrong(**v));
                found.extend(wrong.map(|(i, _)| i));
                if found.len() > before {
                    channels.push(channel_name(&layer.name, channel));
                }
            }
        }
        found.sort_unstable();
        found.dedup();
        let (first, width) = (*found.first()?, self.region.width() as usize);
        Some(NotFinite {
            pixels: found.len(),
            first: [
                self.region.x0 + (first % width) as u32,
                self.region.y0 + (first / width) as u32,
            ],
            channels,
        })
    }

    /// Copies the linear RGB of a layer inside `region`.
    ///
    /// # Errors
    /// [`crate::Kind::Input`] if the layer or one of R, G, B is not there, or the frame does not
    /// cover the region.
    pub fn picture(&self, layer: &str, region: &Region) -> Result<Picture> {
        let missing = || {
            let have: Vec<String> = self
                .layers
                .iter()
                .flat_map(|l| l.channels.iter().map(|(c, _)| channel_name(&l.name, c)))
                .collect();
            Error::input(format!(
                "no colour channels {}; the image has {}",
                ["R", "G", "B"].map(|c| channel_name(layer, c)).join(" "),
                have.join(" ")
            ))
        };
        let source = self.layer(layer).ok_or_else(missing)?;
        let [r, g, b] = ["R", "G", "B"].map(|name| source.channel(name));
        let (Some(r), Some(g), Some(b)) = (r, g, b) else {
            return Err(missing());
        };
        region.check(self.width, self.height)?;
        if !self.region.contains(region) {
            return Err(Error::input(format!(
                "the image covers only the region {} of its {}x{} pixels",
                self.region, self.width, self.height
            ))
            .hint(format!("compare that part alone: `region` {}", self.region)));
        }
        let mut pixels = Vec::with_capacity(region.pixels());
        for y in region.y0..region.y1 {
            let row = (y - self.region.y0) as usize * self.region.width() as usize;
            let start = row + (region.x0 - self.region.x0) as usize;
            for i in start..start + region.width() as usize {
                pixels.push([r[i], g[i], b[i]]);
            }
        }
        Ok(Picture {
            width: region.width() as usize,
            height: region.height() as usize,
            pixels,
        })
    }
}

/// Name of a channel in the file: `R` in the beauty, `direct.R` elsewhere.
pub(super) fn channel_name(layer: &str, channel: &str) -> String {
    if layer.is_empty() {
        channel.into()
    } else {
        format!("{layer}.{channel}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn check_names_the_short_channel() {
        let mut frame = Frame::new(4, 4, Region::full(4, 4));
        assert!(frame.check().is_err());
        frame.layers.push(Layer::rgb("", &[[0.0; 3]; 16]));
        frame.check().unwrap();
        frame
            .layers
            .push(Layer::single("depth", "Z", vec![0.0; 15]));
        assert!(frame.check().unwrap_err().to_string().contains("depth.Z"));
        frame.layers[1] = Layer::rgb("", &[[0.0; 3]; 16]);
        assert!(frame.check().unwrap_err().to_string().contains("twice"));
    }

    #[test]
    fn pixels_that_are_not_finite_are_counted_once_each() {
        let region = Region {
            x0: 2,
            y0: 1,
            x1: 5,
            y1: 3,
        };
        let mut frame = Frame::new(8, 8, region);
        let mut pixels = [[1.0; 3]; 6];
        frame.layers.push(Layer::rgb("", &pixels));
        let depths = vec![f32::INFINITY; 6];
        frame.layers.push(Layer::single("depth", "Z", depths));
        assert_eq!(frame.not_finite(), None);
        pixels[4] = [f32::NAN, 1.0, f32::INFINITY];
        pixels[5][0] = f32::NEG_INFINITY;
        frame.layers[0] = Layer::rgb("", &pixels);
        let found = frame.not_finite().unwrap();
        assert_eq!((found.pixels, found.first), (2, [3, 2]));
        assert_eq!(found.channels, ["R", "B"]);
        assert_eq!(
            found.to_string(),
            "2 pixels are infinite or not a number, the first at (3, 2), in the channels R, B"
        );
        frame.layers[1].channels[0].1[0] = f32::NAN;
        let found = frame.not_finite().unwrap();
        assert_eq!((found.pixels, found.first), (3, [2, 1]));
        assert_eq!(found.channels, ["R", "B", "depth.Z"]);
    }

    #[test]
    fn picture_cuts_a_region_out() {
        let region = Region {
            x0: 2,
            y0: 1,
            x1: 6,
            y1: 4,
        };
        let pixels: Vec<[f32; 3]> = (1..4u8)
            .flat_map(|y| (2..6u8).map(move |x| [f32::from(x), f32::from(y), 0.0]))
            .collect();
        let mut frame = Frame::new(8, 8, region);
        frame.layers.push(Layer::rgb("", &pixels));
        let cut = Region {
            x0: 4,
            y0: 2,
            x1: 6,
            y1: 3,
        };
        let picture = frame.picture("", &cut).unwrap();
        assert_eq!((picture.width, picture.height), (2, 1));
        assert_eq!(picture.pixels, [[4.0, 2.0, 0.0], [5.0, 2.0, 0.0]]);
        let error = frame.picture("", &Region::full(8, 8)).unwrap_err();
        assert_eq!(
            error.hint_text(),
            Some("compare that part alone: `region` 2 1 6 4")
        );
        assert!(
            frame
                .picture("direct", &cut)
                .unwrap_err()
                .to_string()
                .contains("direct.R")
        );
    }
}

//! OpenEXR files: written as scan lines with ZIP over 16 lines; read from any flat RGB file.
//!
//! The same frame gives the same bytes, whatever the number of threads.

use super::frame::{CameraMatrices, Frame, Layer, channel_name};
use super::{Region, header};
use crate::run::{Output, memory};
use crate::{Error, Result};
use exr::prelude::traits::*;
use exr::prelude::{
    AnyChannel, AnyChannels, AttributeValue, Compression, Encoding, FlatSamples, Image,
    ImageAttributes, IntegerBounds, LayerAttributes, LineOrder, MetaData, Text, Vec2, f16,
};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufReader, Cursor, Write};
use std::path::Path;

/// How colour and normals are stored. Depths, distances, positions and variance are always 32-bit
/// floats: halves are too coarse for them, or too short.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Precision {
    /// 16-bit floats. Finite values beyond the largest half are stored as that, so a bright light
    /// does not turn into infinity; [`clamped`] counts them.
    #[default]
    Half,
    /// 32-bit floats: every bit of what was computed.
    Float,
}

impl Precision {
    /// Bits of a sample.
    #[must_use]
    pub fn bits(self) -> u32 {
        match self {
            Self::Half => 16,
            Self::Float => 32,
        }
    }
}

/// Bytes of pixels that any file may claim to hold, however short it is.
const ALLOWED_BYTES: u64 = 256 << 20;

/// The header of an OpenEXR file: what it says about itself before its pixels are read.
#[derive(Clone, Debug, PartialEq)]
pub struct Info {
    /// Pixels across of the whole frame.
    pub width: u32,
    /// Pixels down of the whole frame.
    pub height: u32,
    /// The part of the frame that the file holds.
    pub region: Region,
    /// Names of all channels, and how each is stored; integers count as 32 bits.
    pub channels: BTreeMap<String, Precision>,
    /// Attributes of text, by name; those of lvox begin with `lvox/`.
    pub attributes: BTreeMap<String, String>,
    /// Where the frame was taken from.
    pub camera: Option<CameraMatrices>,
}

impl Info {
    /// Tells the precision that [`write()`] was given, as far as the channels show it.
    #[must_use]
    pub fn precision(&self) -> Precision {
        let is_half = |(name, &stored): (&String, &Precision)| {
            stored == Precision::Half && !always_float(name)
        };
        if self.channels.iter().any(is_half) {
            Precision::Half
        } else {
            Precision::Float
        }
    }
}

/// The samples of a frame that do not fit 16-bit floats.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Clamped {
    /// Samples that are stored as the largest half.
    pub samples: u64,
    /// Full names of the channels that have any.
    pub channels: Vec<String>,
}

/// Counts what [`write()`] stores as less than it is: finite values beyond the largest half.
#[must_use]
pub fn clamped(frame: &Frame, precision: Precision) -> Clamped {
    let mut found = Clamped::default();
    for layer in &frame.layers {
        for (channel, samples) in &layer.channels {
            let name = channel_name(&layer.name, channel);
            if !stored_as_half(&name, precision) {
                continue;
            }
            let beyond = |v: &&f32| v.is_finite() && v.abs() > f16::MAX.to_f32();
            let count = samples.iter().filter(beyond).count() as u64;
            if count > 0 {
                found.samples += count;
                found.channels.push(name);
            }
        }
    }
    found
}

/// Writes a frame or a tile; it appears under its name when it is complete. An image that is there
/// is replaced.
///
/// # Errors
/// [`crate::Kind::Input`] for a frame that fails [`Frame::check`] or an output that cannot be
/// written; on failure nothing is left behind.
pub fn write(path: &Path, frame: &Frame, precision: Precision) -> Result<()> {
    let bytes = encode(frame, precision).map_err(|e| e.at(path.display()))?;
    let mut output = Output::create(path)?;
    output.write_all(&bytes).map_err(|e| output.failed(&e))?;
    output.commit()
}

/// The channels that a frame is written to, and how each is stored.
#[must_use]
pub fn channels(frame: &Frame, precision: Precision) -> BTreeMap<String, Precision> {
    let names = frame.layers.iter().flat_map(|layer| {
        let channels = layer.channels.iter();
        channels.map(|(channel, _)| channel_name(&layer.name, channel))
    });
    let stored = |name: String| match stored_as_half(&name, precision) {
        true => (name, Precision::Half),
        false => (name, Precision::Float),
    };
    names.map(stored).collect()
}

/// Encodes a frame or a tile as the bytes of an OpenEXR file, those that [`write()`] writes.
///
/// # Errors
/// As [`write()`].
pub fn encode(frame: &Frame, precision: Precision) -> Result<Vec<u8>> {
    frame.check()?;
    let side = |v: u32| i32::try_from(v).ok().filter(|&v| v < i32::MAX / 2);
    if side(frame.width).is_none() || side(frame.height).is_none() {
        return Err(Error::input(format!(
            "{}x{} pixels are more than OpenEXR can hold",
            frame.width, frame.height
        )));
    }
    let mut channels: Vec<AnyChannel<FlatSamples>> = Vec::new();
    for layer in &frame.layers {
        for (channel, samples) in &layer.channels {
            let name = channel_name(&layer.name, channel);
            let what = "a channel of the file";
            let samples = if stored_as_half(&name, precision) {
                let mut halves = memory::room(what, samples.len())?;
                halves.extend(samples.iter().map(|&v| to_half(v)));
                FlatSamples::F16(halves)
            } else {
                let mut floats = memory::room(what, samples.len())?;
                floats.extend_from_slice(samples);
                FlatSamples::F32(floats)
            };
            channels.push(AnyChannel::new(text(&name)?, samples));
        }
    }
    // OpenEXR wants channels in this order.
    channels.sort_by(|a, b| a.name.as_slice().cmp(b.name.as_slice()));

    // Below i32::MAX: the region lies inside the frame.
    let corner = Vec2(frame.region.x0 as i32, frame.region.y0 as i32);
    let mut attributes = LayerAttributes {
        layer_position: corner,
        world_to_camera: frame.camera.map(|c| c.world_to_camera),
        world_to_normalized_device: frame.camera.map(|c| c.world_to_ndc),
        ..LayerAttributes::default()
    };
    for (name, value) in &frame.attributes {
        let value = AttributeValue::Text(Text::from_slice_unchecked(value.as_bytes()));
        attributes.other.insert(text(name)?, value);
    }
    let size = Vec2(
        frame.region.width() as usize,
        frame.region.height() as usize,
    );
    let encoding = Encoding {
        compression: Compression::ZIP16,
        blocks: exr::image::Blocks::ScanLines,
        line_order: LineOrder::Increasing,
    };
    let channels = AnyChannels::sort(channels.into());
    let layer = exr::image::Layer::new(size, attributes, encoding, channels);
    let window = IntegerBounds::new((0, 0), (frame.width as usize, frame.height as usize));
    let image = Image::new(ImageAttributes::new(window), layer);
    let mut bytes = Cursor::new(Vec::new());
    image
        .write()
        .to_buffered(&mut bytes)
        .map_err(|e| Error::input(format!("cannot encode the image: {e}")))?;
    let mut bytes = bytes.into_inner();
    header::sort_attributes(&mut bytes);
    Ok(bytes)
}

/// Reads the header of an OpenEXR file alone.
///
/// # Errors
/// [`crate::Kind::Input`] if the file is not there, is no OpenEXR file, or holds no flat image.
pub fn info(path: &Path) -> Result<Info> {
    let file = File::open(path).map_err(|e| Error::io("read", path, &e))?;
    let length = file
        .metadata()
        .map_err(|e| Error::io("read", path, &e))?
        .len();
    let meta =
        MetaData::read_from_buffered(BufReader::new(file), false).map_err(|e| refused(path, &e))?;
    let input = |message: String| Error::input(message).at(path.display());
    let header = meta
        .headers
        .iter()
        .find(|h| !h.deep)
        .ok_or_else(|| input("deep images are not supported".into()))?;
    // A header of a few bytes can claim any size. Deflate shrinks at most 1032 times; the codecs
    // that can beat that do so on flat pictures only, for which the allowance is large enough.
    let data = header.data_window();
    let pixels = data.size.0 as u128 * data.size.1 as u128;
    let sizes = header.channels.list.iter();
    let claimed: u128 = sizes
        .map(|c| c.sample_type.bytes_per_sample() as u128 * pixels)
        .sum();
    if claimed > u128::from(length) * 1032 + u128::from(ALLOWED_BYTES) {
        return Err(input(format!(
            "{claimed} bytes of pixels cannot come out of {length}: the file is damaged or cut"
        )));
    }
    let display = header.shared_attributes.display_window;
    let (width, height) = (
        u32::try_from(display.size.0).unwrap_or(u32::MAX),
        u32::try_from(display.size.1).unwrap_or(u32::MAX),
    );
    let region = visible(display, data).ok_or_else(|| {
        input("the data window lies outside the display window: no pixel can be seen".into())
    })?;
    let mut attributes = BTreeMap::new();
    let others = header.own_attributes.other.iter();
    for (name, value) in others.chain(&header.shared_attributes.other) {
        if let AttributeValue::Text(value) = value {
            attributes.insert(string(name), string(value));
        }
    }
    let channels = header
        .channels
        .list
        .iter()
        .map(|c| {
            let stored = match c.sample_type {
                exr::prelude::SampleType::F16 => Precision::Half,
                _ => Precision::Float,
            };
            (string(&c.name), stored)
        })
        .collect();
    let own = &header.own_attributes;
    let matrices = own.world_to_camera.zip(own.world_to_normalized_device);
    Ok(Info {
        width,
        height,
        region,
        channels,
        attributes,
        camera: matrices.map(|(world_to_camera, world_to_ndc)| CameraMatrices {
            world_to_camera,
            world_to_ndc,
        }),
    })
}

/// Reads an OpenEXR image of any flat layout and precision. Of a file of several parts the first is
/// read; pixels outside the display window are dropped, and coordinates start at its corner.
///
/// # Errors
/// [`crate::Kind::Input`] if the file is not there, is no OpenEXR file, is damaged, or holds no
/// flat image.
pub fn read(path: &Path) -> Result<Frame> {
    let info = info(path)?;
    let file = File::open(path).map_err(|e| Error::io("read", path, &e))?;
    let image = exr::prelude::read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .first_valid_layer()
        .all_attributes()
        .from_buffered(BufReader::new(file))
        .map_err(|e| refused(path, &e))?;
    let layer = image.layer_data;
    let display = image.attributes.display_window;
    let corner = layer.attributes.layer_position - display.position;
    // Where the region starts inside the data window.
    let skip_x = (i64::from(info.region.x0) - i64::from(corner.0)).max(0) as usize;
    let skip_y = (i64::from(info.region.y0) - i64::from(corner.1)).max(0) as usize;
    let (data_width, data_height) = (layer.size.0, layer.size.1);
    let (width, height) = (info.region.width() as usize, info.region.height() as usize);
    if skip_x + width > data_width || skip_y + height > data_height {
        return Err(
            Error::input("the windows of the image contradict each other").at(path.display()),
        );
    }

    let mut layers: Vec<Layer> = Vec::new();
    for channel in layer.channel_data.list {
        let full_name = string(&channel.name);
        if channel.sampling != Vec2(1, 1) || channel.sample_data.len() != data_width * data_height {
            return Err(Error::input(format!(
                "channel {full_name} is subsampled, which is not supported"
            ))
            .hint("convert it: oiiotool in.exr --ch R,G,B -o out.exr")
            .at(path.display()));
        }
        let mut samples = Vec::with_capacity(width * height);
        for y in 0..height {
            let start = (skip_y + y) * data_width + skip_x;
            let row = start..start + width;
            match &channel.sample_data {
                FlatSamples::F16(v) => samples.extend(v[row].iter().map(|v| v.to_f32())),
                FlatSamples::F32(v) => samples.extend_from_slice(&v[row]),
                FlatSamples::U32(v) => samples.extend(v[row].iter().map(|&v| v as f32)),
            }
        }
        let (layer_name, name) = full_name.rsplit_once('.').unwrap_or(("", &full_name));
        match layers.iter_mut().find(|l| l.name == layer_name) {
            Some(layer) => layer.channels.push((name.into(), samples)),
            None => layers.push(Layer::single(layer_name, name, samples)),
        }
    }
    // The file has channels by name; here colours come as R, G, B and the beauty first.
    for layer in &mut layers {
        layer.channels.sort_by_key(|(name, _)| {
            let known = ["R", "G", "B", "A"].iter().position(|n| n == name);
            (known.unwrap_or(usize::MAX), name.clone())
        });
    }
    layers.sort_by(|a, b| a.name.cmp(&b.name));
    let frame = Frame {
        width: info.width,
        height: info.height,
        region: info.region,
        layers,
        attributes: info.attributes,
        camera: info.camera,
    };
    frame.check().map_err(|e| e.at(path.display()))?;
    Ok(frame)
}

/// The part of the data window inside the display window, in coordinates from the display window's
/// corner.
fn visible(display: IntegerBounds, data: IntegerBounds) -> Option<Region> {
    let along = |display_at: i32, display_size: usize, data_at: i32, data_size: usize| {
        let size = i64::try_from(display_size).ok()?;
        let from = i64::from(data_at) - i64::from(display_at);
        let to = from.checked_add(i64::try_from(data_size).ok()?)?;
        let (from, to) = (from.clamp(0, size), to.clamp(0, size));
        (from < to).then_some((u32::try_from(from).ok()?, u32::try_from(to).ok()?))
    };
    let (x0, x1) = along(
        display.position.0,
        display.size.0,
        data.position.0,
        data.size.0,
    )?;
    let (y0, y1) = along(
        display.position.1,
        display.size.1,
        data.position.1,
        data.size.1,
    )?;
    Some(Region { x0, y0, x1, y1 })
}

fn always_float(channel: &str) -> bool {
    ["depth.", "distance.", "position.", "variance."]
        .iter()
        .any(|layer| channel.starts_with(layer))
}

fn stored_as_half(channel: &str, precision: Precision) -> bool {
    precision == Precision::Half && !always_float(channel)
}

fn to_half(value: f32) -> f16 {
    let largest = f16::MAX.to_f32();
    if value.is_finite() {
        f16::from_f32(value.clamp(-largest, largest))
    } else {
        f16::from_f32(value)
    }
}

/// Names end with a zero in the file.
fn text(name: &str) -> Result<Text> {
    if name.is_empty() || name.len() > 255 || name.contains('\0') {
        return Err(Error::input(format!(
            "{name:?} cannot be a name in an OpenEXR file"
        )));
    }
    Ok(Text::from_slice_unchecked(name.as_bytes()))
}

fn string(text: &Text) -> String {
    String::from_utf8_lossy(text.as_slice()).into_owned()
}

fn refused(path: &Path, error: &exr::error::Error) -> Error {
    match error {
        exr::error::Error::Io(e) => Error::io("read", path, e),
        exr::error::Error::NotSupported(what) => Error::input(format!(
            "cannot read {}: not supported: {what}",
            path.display()
        )),
        _ => Error::input(format!(
            "cannot read {} as OpenEXR: it is another kind of file, damaged or cut ({error})",
            path.display()
        )),
    }
}

#[cfg(test)]
mod tests;

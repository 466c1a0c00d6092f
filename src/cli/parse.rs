//! Values on the command line.

use crate::bounce::Bounces;
use crate::image::mix::GroupScale;
use crate::image::{Exposure, Region};
use crate::lab::study::others::{Noise, PeerImage};
use crate::run::{Frames, size};
use crate::scene::load::Change;
use clap::builder::{PossibleValuesParser, TypedValueParser};

/// A size of memory, in bytes.
pub fn size(text: &str) -> Result<u64, String> {
    told(size::parse(text))
}

/// One of a table's values, by the name beside it.
pub fn one_of<T: Copy + Send + Sync>(
    table: &'static [(&'static str, T)],
) -> impl TypedValueParser<Value = T> {
    let names = PossibleValuesParser::new(table.iter().map(|row| row.0));
    names.try_map(move |found| {
        let row = table.iter().find(|row| row.0 == found);
        row.map(|row| row.1).ok_or("it has to be one of the names")
    })
}

/// An exit code that says neither that all is done nor that a retry is in vain.
pub fn retry_code(text: &str) -> Result<u8, String> {
    match text.parse() {
        Ok(code) if code != 0 && code != 2 => Ok(code),
        _ => Err("it has to be 1, or 3 to 255: 2 says that a retry is in vain".into()),
    }
}

/// Numbers of frames.
pub fn frames(text: &str) -> Result<Frames, String> {
    told(text.parse())
}

/// A value for a key of a scene.
pub fn change(text: &str) -> Result<Change, String> {
    told(text.parse())
}

/// A factor on a group of lights.
pub fn group_scale(text: &str) -> Result<GroupScale, String> {
    told(text.parse())
}

/// The message and the hint of an error in one.
fn told<T>(value: crate::Result<T>) -> Result<T, String> {
    value.map_err(|e| match e.hint_text() {
        Some(hint) => format!("{e}: {hint}"),
        None => e.to_string(),
    })
}

/// An image of another renderer, with its seconds.
pub fn peer(text: &str) -> Result<PeerImage, String> {
    told(text.parse())
}

/// The noise of a reference.
pub fn noise(text: &str) -> Result<Noise, String> {
    told(text.parse())
}

/// A factor above zero.
pub fn positive(text: &str) -> Result<f32, String> {
    match text.parse::<f32>() {
        Ok(value) if value.is_finite() && value > 0.0 => Ok(value),
        _ => Err("it has to be a number above zero".into()),
    }
}

/// An exposure, or `auto`.
pub fn exposure(text: &str) -> Result<Exposure, String> {
    match text {
        "auto" => Ok(Exposure::Automatic),
        _ => match positive(text) {
            Ok(value) if (1e-30..=1e30).contains(&value) => Ok(Exposure::Fixed(value)),
            _ => Err("it has to be auto, or a number above zero".into()),
        },
    }
}

/// The four values of `--region`, which clap has counted.
pub fn region(values: &[u32]) -> Option<Region> {
    let &[x0, y0, x1, y1] = values else {
        return None;
    };
    Some(Region { x0, y0, x1, y1 })
}

/// `WxH`: the size of an image in pixels.
pub fn resolution(text: &str) -> Result<(u32, u32), String> {
    const MOST: u32 = 65_536;
    text.split_once('x')
        .and_then(|(w, h)| Some((w.parse().ok()?, h.parse().ok()?)))
        .filter(|&(w, h)| (1..=MOST).contains(&w) && (1..=MOST).contains(&h))
        .ok_or_else(|| {
            format!("it has to be a width and a height of 1 to {MOST} pixels, as 1920x1080")
        })
}

/// `all`, or a number of bounces.
pub fn bounces(text: &str) -> Result<Bounces, String> {
    if text == "all" {
        return Ok(Bounces::All);
    }
    text.parse()
        .ok()
        .filter(|n| (1..=10_000).contains(n))
        .map(Bounces::Count)
        .ok_or_else(|| "it has to be a number from 1 to 10000, or all".into())
}

/// `I/N`: a tile and how many there are.
pub fn tile(text: &str) -> Result<(u32, u32), String> {
    let parsed = text
        .split_once('/')
        .and_then(|(i, n)| Some((i.parse().ok()?, n.parse().ok()?)));
    match parsed {
        Some((i, n)) if i < n => Ok((i, n)),
        Some((_, 0)) => Err("a frame has one tile at least, as 0/1".into()),
        Some((_, n)) => Err(format!("tiles of {n} are counted from 0 to {}", n - 1)),
        None => Err("it has to be a tile and a count, as 0/8".into()),
    }
}

//! Parts of metadata that few files have: each has a number and is there only where it says
//! something, behind all else.

use crate::record::{ExtinctionColor, VolumeInfo};
use bincode::de::Decoder;
use bincode::de::read::Reader;
use bincode::enc::Encoder;
use bincode::error::{DecodeError, EncodeError};
use bincode::{Decode, Encode};

/// Number of the part of clouds, trees and scattered light that has the colours of extinction.
const EXTINCTION_COLORS: u32 = 1;

/// The number of a part that is none of those that the reader knows.
pub const UNKNOWN: DecodeError = DecodeError::Other("a part of an unknown kind");

/// The number of the next part, larger than the last; `None` at the end of the metadata.
pub fn next<C, D: Decoder<Context = C>>(
    decoder: &mut D,
    last: &mut u32,
) -> Result<Option<u32>, DecodeError> {
    if decoder.reader().peek_read(1).is_none() {
        return Ok(None);
    }
    let number = u32::decode(decoder)?;
    if number <= *last {
        return Err(DecodeError::Other("parts out of order"));
    }
    *last = number;
    Ok(Some(number))
}

/// A list that is there because it says something.
pub fn some<C, T: Decode<C>, D: Decoder<Context = C>>(
    decoder: &mut D,
) -> Result<Vec<T>, DecodeError> {
    let list: Vec<T> = Decode::decode(decoder)?;
    match list.is_empty() {
        true => Err(DecodeError::Other("a part that says nothing")),
        false => Ok(list),
    }
}

/// Writes a list as a part, unless it says nothing.
pub fn encode<T: Encode + 'static, E: Encoder>(
    number: u32,
    list: &Vec<T>,
    encoder: &mut E,
) -> Result<(), EncodeError> {
    match list.is_empty() {
        true => Ok(()),
        false => (number, list).encode(encoder),
    }
}

/// Writes what volumes have beyond their entries.
pub fn encode_volumes<E: Encoder>(
    volumes: &[VolumeInfo],
    encoder: &mut E,
) -> Result<(), EncodeError> {
    let colors = (0..).zip(volumes).filter(|(_, v)| !v.is_grey());
    let colors = colors.map(|(volume, v)| ExtinctionColor {
        volume,
        color: v.extinction_color,
    });
    encode(EXTINCTION_COLORS, &colors.collect(), encoder)
}

/// Reads the parts to the end of the metadata, into the volumes.
pub fn decode_volumes<C, D: Decoder<Context = C>>(
    volumes: &mut [VolumeInfo],
    decoder: &mut D,
) -> Result<(), DecodeError> {
    let mut last = 0;
    while let Some(number) = next(decoder, &mut last)? {
        if number != EXTINCTION_COLORS {
            return Err(UNKNOWN);
        }
        let colors: Vec<ExtinctionColor> = some(decoder)?;
        if !colors.is_sorted_by(|a, b| a.volume < b.volume) {
            return Err(DecodeError::Other("extinction colours out of order"));
        }
        for of in colors {
            let volume = volumes.get_mut(of.volume as usize);
            let volume = volume.ok_or(DecodeError::Other("an extinction colour of no volume"))?;
            if of.is_grey() {
                return Err(DecodeError::Other("an extinction colour that is grey"));
            }
            volume.extinction_color = of.color;
        }
    }
    Ok(())
}

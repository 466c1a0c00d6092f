//! The values of a level that has few: those of volumes that were saved in 8 or 16 bits have at
//! most 65,536, whatever was done to them since.

use super::BrickSamples;
use crate::bytes::{self, Cursor};
use crate::{FormatError, Result, check};

/// Values of a palette, at most: their numbers take two bytes.
const MOST_VALUES: usize = 1 << 16;

/// Samples of a level for each of its values, at least; with fewer the list costs more than it
/// brings.
const SAMPLES_A_VALUE: usize = 16;

/// Slots of the table that finds numbers: four for each value, so that few share one.
const SLOTS: usize = 4 * MOST_VALUES;

/// Bits of a slot that is free. No sample has them.
const FREE: u32 = u32::MAX;

/// The values of the samples of a level, ascending.
#[derive(Debug, Default, PartialEq)]
pub struct Palette {
    values: Vec<f32>,
}

/// What finds the numbers of the values of a palette.
#[derive(Debug)]
pub struct PaletteIndex {
    /// Bits of values, by a hash of them.
    bits: Vec<u32>,
    numbers: Vec<u16>,
    count: usize,
}

impl PaletteIndex {
    fn new() -> Self {
        Self {
            bits: vec![FREE; SLOTS],
            numbers: vec![0; SLOTS],
            count: 0,
        }
    }

    /// The slot of a value: its own, or the free one where it would be.
    fn slot(&self, bits: u32) -> usize {
        let mut slot = (bits.wrapping_mul(0x9e37_79b1) >> (32 - SLOTS.ilog2())) as usize;
        while self.bits[slot] != bits && self.bits[slot] != FREE {
            slot = (slot + 1) % SLOTS;
        }
        slot
    }

    /// Whether a value is there, now, or there is no room for it.
    fn add(&mut self, bits: u32) -> bool {
        let slot = self.slot(bits);
        if self.bits[slot] == FREE {
            if self.count == MOST_VALUES {
                return false;
            }
            self.bits[slot] = bits;
            self.count += 1;
        }
        true
    }

    /// The number of a value, if it is one of them.
    pub fn number(&self, value: f32) -> Option<u16> {
        let slot = self.slot(value.to_bits());
        (self.bits[slot] == value.to_bits()).then(|| self.numbers[slot])
    }
}

impl Palette {
    /// Bytes of its values, at most.
    pub(crate) const MOST_BYTES: usize = 4 * MOST_VALUES;

    /// The values of samples, and what finds their numbers; `None` if there are too many for
    /// numbers to be worth their list.
    #[must_use]
    pub fn of(bricks: impl Iterator<Item = BrickSamples>) -> Option<(Self, PaletteIndex)> {
        let mut index = PaletteIndex::new();
        let mut samples = 0;
        let mut last = FREE;
        for brick in bricks {
            samples += brick.len();
            for value in &brick {
                let bits = value.to_bits();
                // Neighbours are often alike.
                if bits != last && !index.add(bits) {
                    return None;
                }
                last = bits;
            }
        }
        if index.count == 0 || index.count * SAMPLES_A_VALUE > samples {
            return None;
        }
        let held = index.bits.iter().filter(|bits| **bits != FREE);
        let mut sorted: Vec<u32> = held.copied().collect();
        // Bits of numbers of at least 0 are in the order of these.
        sorted.sort_unstable();
        for (number, bits) in sorted.iter().enumerate() {
            let slot = index.slot(*bits);
            index.numbers[slot] = number as u16;
        }
        let values = sorted.into_iter().map(f32::from_bits).collect();
        Some((Self { values }, index))
    }

    /// The values, ascending.
    #[must_use]
    pub fn values(&self) -> &[f32] {
        &self.values
    }

    /// The bytes of its values, in planes.
    #[must_use]
    pub(crate) fn encode(&self) -> Vec<u8> {
        let rows = bytes::floats(self.values.iter().map(|v| [*v]));
        let mut planes = Vec::new();
        bytes::to_planes(&rows, 4, &mut planes);
        planes
    }

    /// Reads what [`Self::encode`] wrote: the rest of a cursor.
    pub(crate) fn decode(cursor: &mut Cursor<'_>, count: usize) -> Result<Self> {
        if count > MOST_VALUES {
            let most = format!("at most {MOST_VALUES}");
            return Err(FormatError::invalid("values of a palette", most, count));
        }
        let rows = bytes::from_planes(cursor.take(4 * count)?, 4);
        let values: Vec<f32> = bytes::singles(&rows).collect();
        let is_rising = values.is_sorted_by(|a, b| a.to_bits() < b.to_bits());
        match values.iter().find(|v| !check::is_extinction(**v)) {
            None if is_rising => Ok(Self { values }),
            wrong => Err(FormatError::invalid(
                "values of a palette",
                "rising, finite numbers of at least 0",
                wrong.map_or("some that do not rise".into(), f32::to_string),
            )),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(samples: &[f32]) -> Option<(Palette, PaletteIndex)> {
        let (bricks, rest) = samples.as_chunks();
        assert!(rest.is_empty());
        Palette::of(bricks.iter().copied())
    }

    #[test]
    fn few_values_are_numbered_in_order_and_come_back() {
        let samples: Vec<f32> = (0..4096).map(|i| (i * 37 % 101) as f32 * 0.3).collect();
        let (palette, index) = of(&samples).unwrap();
        assert_eq!(palette.values().len(), 101);
        for value in samples {
            let number = index.number(value).unwrap();
            assert_eq!(palette.values()[usize::from(number)], value);
        }
        assert_eq!(index.number(0.31), None);
        let bytes = palette.encode();
        let decoded = |count| Palette::decode(&mut Cursor::new(&bytes, "palette"), count);
        assert_eq!(decoded(101).unwrap(), palette);
        assert!(decoded(102).is_err() && decoded(MOST_VALUES + 1).is_err());
    }

    #[test]
    fn many_values_have_no_palette() {
        let samples: Vec<f32> = (0..MOST_VALUES * 20).map(|i| i as f32).collect();
        assert!(of(&samples).is_none());
        assert!(of(&samples[..1024]).is_none(), "hardly fewer than samples");
    }

    #[test]
    fn values_that_no_writer_writes_are_refused() {
        for values in [
            [1.0, 0.5],
            [1.0, 1.0],
            [0.0, f32::NAN],
            [-1.0, 1.0],
            [0.0, f32::INFINITY],
        ] {
            let palette = Palette {
                values: values.to_vec(),
            };
            let bytes = palette.encode();
            assert!(Palette::decode(&mut Cursor::new(&bytes, "palette"), 2).is_err());
        }
    }
}

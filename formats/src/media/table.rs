//! The table of the bricks of a level: where they are, and what can be said of each without its
//! samples.

use super::{BRICK_EDGE, BRICK_VOXELS, BrickSamples};
use crate::bytes::{self, Cursor};
use crate::{FormatError, Result, check, morton};

/// Bytes of a brick in the table.
pub const ENTRY_BYTES: usize = 8 + 4 + 1;

/// Bits of [`BrickEntry::ends`].
const ENDS: u8 = 0x7f;

/// A brick that has samples other than 0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BrickEntry {
    /// Its place: that of its first sample, over [`BRICK_EDGE`].
    pub place: [u32; 3],
    /// The largest of its samples; above 0.
    pub max: f32,
    /// Which of its last samples, x, y or z being 7, are other than 0 anywhere: bit `i - 1` stands
    /// for those whose x is 7 if i has bit 0, whose y is 7 if it has bit 1, whose z is 7 if it has
    /// bit 2. Bricks behind this one have these samples at corners of their cells.
    pub ends: u8,
}

impl BrickEntry {
    /// The entry of a brick of samples, some of which are not 0; none if all are 0.
    #[must_use]
    pub fn of(place: [u32; 3], samples: &BrickSamples) -> Option<Self> {
        let (max, ends) = known(samples);
        (max > 0.0).then_some(Self { place, max, ends })
    }

    /// Refuses samples of which the entry says other things than they do.
    pub(crate) fn check(&self, samples: &BrickSamples) -> Result<()> {
        let (max, ends) = known(samples);
        if (max, ends) == (self.max, self.ends) {
            return Ok(());
        }
        Err(FormatError::invalid(
            format!("samples of the brick at {:?}", self.place),
            format!(
                "a maximum of {} and ends {:#x} as in the table",
                self.max, self.ends
            ),
            format!("{max} and {ends:#x}"),
        ))
    }
}

/// The largest of samples, and which of the last are not 0.
fn known(samples: &BrickSamples) -> (f32, u8) {
    const LAST: usize = BRICK_EDGE - 1;
    let max = samples.iter().copied().fold(0.0, f32::max);
    let mut ends = 0;
    let mut note = |x: usize, y: usize, z: usize| {
        if samples[(z * BRICK_EDGE + y) * BRICK_EDGE + x] != 0.0 {
            let which = [x, y, z].map(|i| u8::from(i == LAST));
            let which = which[0] | which[1] << 1 | which[2] << 2;
            // All combinations of these: a corner is on three edges and three faces.
            (1..8_u8)
                .filter(|i| i & !which == 0)
                .for_each(|i| ends |= 1 << (i - 1));
        }
    };
    for a in 0..BRICK_EDGE {
        for b in 0..BRICK_EDGE {
            note(LAST, a, b);
            note(a, LAST, b);
            note(a, b, LAST);
        }
    }
    (max, ends)
}

/// The bricks of a level, in Morton order.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct BrickTable {
    entries: Vec<BrickEntry>,
}

impl BrickTable {
    /// A table of bricks in any order.
    #[must_use]
    pub fn new(mut entries: Vec<BrickEntry>) -> Self {
        entries.sort_unstable_by_key(|e| code(e.place));
        Self { entries }
    }

    /// The bricks, in Morton order.
    #[must_use]
    pub fn entries(&self) -> &[BrickEntry] {
        &self.entries
    }

    /// The bytes of the table, column by column in planes.
    pub(crate) fn encode(&self) -> Vec<u8> {
        let mut last = 0;
        let mut gaps = Vec::with_capacity(8 * self.entries.len());
        for entry in &self.entries {
            let code = code(entry.place);
            gaps.extend(u64::to_le_bytes(code - last));
            last = code;
        }
        let floats =
            |of: fn(&BrickEntry) -> f32| bytes::floats(self.entries.iter().map(|e| [of(e)]));
        let mut planes = Vec::with_capacity(ENTRY_BYTES * self.entries.len());
        bytes::to_planes(&gaps, 8, &mut planes);
        bytes::to_planes(&floats(|e| e.max), 4, &mut planes);
        planes.extend(self.entries.iter().map(|e| e.ends));
        planes
    }

    /// Reads `count` entries of a level of `dims` samples, which the cursor has to hold.
    pub(crate) fn decode(cursor: &mut Cursor<'_>, count: usize, dims: [u32; 3]) -> Result<Self> {
        let wrong = |i: usize, what: &str, expected: &str, found: String| {
            FormatError::invalid(format!("{what} of brick {i}"), expected, found)
        };
        let mut column = |width: usize| {
            let planes = cursor.take(count.saturating_mul(width))?;
            Ok::<_, FormatError>(bytes::from_planes(planes, width))
        };
        let (gaps, maxima, ends) = (column(8)?, column(4)?, column(1)?);
        let (gaps, _) = gaps.as_chunks();
        let columns = gaps.iter().zip(bytes::singles(&maxima));
        let columns = columns.zip(&ends);
        let bricks = dims.map(|n| n / BRICK_EDGE as u32 + 1);
        let mut entries = Vec::with_capacity(count);
        let mut last = 0_u64;
        for (i, ((gap, max), ends)) in columns.enumerate() {
            let gap = u64::from_le_bytes(*gap);
            let code = last.checked_add(gap).filter(|c| *c < 1 << 63);
            let Some(code) = code.filter(|_| i == 0 || gap > 0) else {
                return Err(wrong(
                    i,
                    "place",
                    "one behind that of the last",
                    gap.to_string(),
                ));
            };
            last = code;
            let place = [code >> 2, code >> 1, code].map(|c| morton::gather(c) as u32);
            if (0..3).any(|a| place[a] >= bricks[a]) {
                return Err(wrong(
                    i,
                    "place",
                    &format!("inside {bricks:?}"),
                    format!("{place:?}"),
                ));
            }
            if !check::is_extinction(max) || max == 0.0 {
                return Err(wrong(
                    i,
                    "maximum",
                    "a finite number above 0",
                    max.to_string(),
                ));
            }
            if ends & !ENDS != 0 {
                return Err(wrong(i, "ends", "seven bits", format!("{ends:#x}")));
            }
            entries.push(BrickEntry {
                place,
                max,
                ends: *ends,
            });
        }
        Ok(Self { entries })
    }
}

fn code(place: [u32; 3]) -> u64 {
    morton::interleave(place.map(u64::from))
}

const _: () = assert!(BRICK_VOXELS == 512, "three bits along each axis");

#[cfg(test)]
mod tests {
    use super::*;

    fn entry(place: [u32; 3]) -> BrickEntry {
        let samples = std::array::from_fn(|i| (i % 5) as f32);
        BrickEntry::of(place, &samples).unwrap()
    }

    fn table() -> BrickTable {
        BrickTable::new(
            [[3, 0, 1], [0, 0, 0], [2, 2, 2], [1, 0, 0]]
                .map(entry)
                .to_vec(),
        )
    }

    fn decoded(bytes: &[u8], count: usize, dims: [u32; 3]) -> Result<BrickTable> {
        BrickTable::decode(&mut Cursor::new(bytes, "table"), count, dims)
    }

    #[test]
    fn tables_come_back_in_morton_order() {
        let table = table();
        let places: Vec<_> = table.entries().iter().map(|e| e.place).collect();
        assert_eq!(places, [[0, 0, 0], [1, 0, 0], [3, 0, 1], [2, 2, 2]]);
        let bytes = table.encode();
        assert_eq!(bytes.len(), 4 * ENTRY_BYTES);
        assert_eq!(decoded(&bytes, 4, [24, 16, 16]).unwrap(), table);
    }

    #[test]
    fn tables_that_no_writer_writes_are_refused() {
        let good = table();
        let says = |table: &BrickTable, dims: [u32; 3]| {
            decoded(&table.encode(), table.entries.len(), dims)
                .unwrap_err()
                .to_string()
        };
        assert!(says(&good, [23, 16, 16]).contains("place of brick 2: expected inside [3, 3, 3]"));
        let with = |change: fn(&mut BrickEntry)| {
            let mut wrong = good.clone();
            change(&mut wrong.entries[1]);
            says(&wrong, [24, 16, 16])
        };
        assert!(with(|e| e.max = 0.0).contains("maximum of brick 1"));
        assert!(with(|e| e.max = f32::NAN).contains("maximum of brick 1"));
        assert!(with(|e| e.ends = 0x80).contains("ends of brick 1"));
        assert!(
            with(|e| e.place = [0; 3]).contains("place of brick 1"),
            "twice"
        );
        let bytes = good.encode();
        assert!(decoded(&bytes, 5, [24, 16, 16]).is_err(), "too short");
        assert!(decoded(&bytes, usize::MAX, [24, 16, 16]).is_err());
        let mut far = bytes;
        far[28..32].fill(0xff);
        assert!(
            decoded(&far, 4, [24, 16, 16])
                .unwrap_err()
                .to_string()
                .contains("place")
        );
    }

    #[test]
    fn entries_tell_what_samples_are() {
        assert_eq!(BrickEntry::of([0; 3], &[0.0; BRICK_VOXELS]), None);
        let of = |at: [usize; 3]| {
            let mut samples = [0.0; BRICK_VOXELS];
            samples[(at[2] * 8 + at[1]) * 8 + at[0]] = 2.0;
            let entry = BrickEntry::of([0; 3], &samples).unwrap();
            entry.check(&samples).unwrap();
            samples[0] = 3.0;
            assert!(entry.check(&samples).is_err());
            (entry.max, entry.ends)
        };
        assert_eq!(of([1, 2, 3]), (2.0, 0));
        assert_eq!(of([7, 0, 0]), (2.0, 1 << 0));
        assert_eq!(of([0, 7, 7]), (2.0, 1 << 1 | 1 << 3 | 1 << 5));
        assert_eq!(of([7, 7, 7]), (2.0, ENDS));
    }
}

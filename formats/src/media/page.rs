//! A page: the samples of some bricks, bit for bit.
//!
//! A sample becomes an integer code, by its number in the level's palette or by the bits of its
//! f32 less those at the end that are 0 in all of the page. Codes become residuals, and these
//! planes.

use super::palette::{Palette, PaletteIndex};
use super::residual::{self, Codes};
use super::{BRICK_VOXELS, BrickSamples};
use crate::{FormatError, Result, bytes, check};

/// Bricks of a page, at most.
pub const PAGE_BRICKS: usize = 64;

/// Faster than higher levels, to one per cent more bytes.
const ZSTD_LEVEL: i32 = 1;

/// Bits of f32 that may be left out at its end: those of the fraction.
const MOST_SHIFT: u8 = 23;

/// A page as it goes to a file.
#[derive(Debug)]
pub struct MediaPage {
    /// How its samples are coded.
    pub(crate) coding: Coding,
    /// Bytes before compression.
    pub(crate) raw_bytes: u32,
    /// Bytes of the file.
    pub(crate) stored: Vec<u8>,
    /// How many bricks it has.
    pub(crate) bricks: u32,
}

/// How the samples of a page are coded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Coding {
    /// Whether codes are numbers of the palette.
    by_palette: bool,
    /// Bits of f32 that are left out at the end; 0 with a palette.
    shift: u8,
    /// Bytes of a code.
    width: u8,
}

impl Coding {
    /// As the block table has it: a byte each for palette, shift and width.
    pub fn code(self) -> u32 {
        u32::from_le_bytes([u8::from(self.by_palette), self.shift, self.width, 0])
    }

    /// Reads what [`Self::code`] wrote.
    pub fn read(code: u32) -> Result<Self> {
        let [by_palette, shift, width, zero] = code.to_le_bytes();
        let is_palette = by_palette == 1 && shift == 0 && width <= 2;
        let is_bits = by_palette == 0 && shift <= MOST_SHIFT;
        if !(is_palette || is_bits) || !(1..=4).contains(&width) || zero != 0 {
            return Err(FormatError::invalid(
                "coding of a page",
                "palette or shift, and width",
                format!("{code:#x}"),
            ));
        }
        Ok(Self {
            by_palette: is_palette,
            shift,
            width,
        })
    }

    /// Bytes before compression of a page of so many bricks.
    pub fn raw_bytes(self, bricks: usize) -> usize {
        usize::from(self.width) * bricks * BRICK_VOXELS
    }
}

impl MediaPage {
    /// Codes and compresses the samples of up to [`PAGE_BRICKS`] bricks; all are finite and at
    /// least 0.
    ///
    /// # Errors
    /// [`FormatError::Invalid`] for samples that no reader takes; [`FormatError::Io`] if zstd
    /// fails.
    pub fn encode(bricks: &[BrickSamples], palette: Option<&PaletteIndex>) -> Result<Self> {
        let samples = bricks.as_flattened();
        if !(1..=PAGE_BRICKS).contains(&bricks.len()) {
            let expected = format!("1 to {PAGE_BRICKS}");
            return Err(FormatError::invalid(
                "bricks of a page",
                expected,
                bricks.len(),
            ));
        }
        if let Some(wrong) = samples.iter().find(|v| !check::is_extinction(**v)) {
            let expected = "finite numbers of at least 0";
            return Err(FormatError::invalid("samples of a page", expected, wrong));
        }
        let numbers = palette.and_then(|index| {
            let number = |v: &f32| index.number(*v).map(u32::from);
            samples.iter().map(number).collect::<Option<Vec<u32>>>()
        });
        let by_palette = numbers.is_some();
        let mut codes = numbers.unwrap_or_else(|| samples.iter().map(|v| v.to_bits()).collect());
        let bits = codes.iter().fold(0, |all, code| all | code);
        let shift = match by_palette {
            true => 0,
            false => bits.trailing_zeros().min(MOST_SHIFT.into()),
        };
        let width = residual::width_of(bits >> shift);
        codes.iter_mut().for_each(|code| *code >>= shift);
        let (bricks, _) = codes.as_chunks_mut();
        bricks
            .iter_mut()
            .for_each(|brick| residual::encode(brick, width));
        let mut raw = Vec::with_capacity(width * codes.len());
        for byte in 0..width {
            raw.extend(codes.iter().map(|code| (code >> (8 * byte)) as u8));
        }
        Ok(Self {
            coding: Coding {
                by_palette,
                shift: shift as u8,
                width: width as u8,
            },
            raw_bytes: raw.len() as u32,
            bricks: (samples.len() / BRICK_VOXELS) as u32,
            stored: bytes::compress(&raw, ZSTD_LEVEL)?.unwrap_or(raw),
        })
    }
}

/// Decodes the bricks of a page of `count` from what it was before compression, and gives each to
/// `take` with its number.
pub fn decode(
    raw: &[u8],
    coding: Coding,
    count: usize,
    palette: &Palette,
    mut take: impl FnMut(usize, &BrickSamples) -> Result<()>,
) -> Result<()> {
    let expected = coding.raw_bytes(count);
    if raw.len() != expected || count == 0 {
        let what = "bytes of a page";
        return Err(FormatError::invalid(what, expected.to_string(), raw.len()));
    }
    let width = usize::from(coding.width);
    let mut codes: Codes = [0; BRICK_VOXELS];
    let mut samples: BrickSamples = [0.0; BRICK_VOXELS];
    for brick in 0..count {
        let plane = |byte: usize| &raw[(byte * count + brick) * BRICK_VOXELS..][..BRICK_VOXELS];
        let low = codes.iter_mut().zip(plane(0));
        low.for_each(|(code, byte)| *code = u32::from(*byte));
        for byte in 1..width {
            let more = codes.iter_mut().zip(plane(byte));
            more.for_each(|(code, b)| *code |= u32::from(*b) << (8 * byte));
        }
        residual::decode(&mut codes, width);
        let most = codes.iter().copied().fold(0, u32::max);
        let (limit, what) = match coding.by_palette {
            true => (palette.values().len() as u32, "numbers of the palette"),
            false => (
                check::INFINITY >> coding.shift,
                "finite samples of at least 0",
            ),
        };
        if most >= limit {
            let what = format!("{what} in brick {brick}");
            return Err(FormatError::invalid(what, format!("below {limit}"), most));
        }
        let all = samples.iter_mut().zip(&codes);
        match coding.by_palette {
            true => all.for_each(|(v, code)| *v = palette.values()[*code as usize]),
            false => all.for_each(|(v, code)| *v = f32::from_bits(code << coding.shift)),
        }
        take(brick, &samples)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bricks(count: usize, value: impl Fn(usize) -> f32) -> Vec<BrickSamples> {
        let brick = |b| std::array::from_fn(|i| value(b * BRICK_VOXELS + i));
        (0..count).map(brick).collect()
    }

    fn unpacked(page: &MediaPage) -> Vec<u8> {
        let mut raw = vec![0; page.raw_bytes as usize];
        if page.stored.len() == raw.len() {
            return page.stored.clone();
        }
        bytes::decompress(&page.stored, &mut raw, "page").unwrap();
        raw
    }

    fn decoded(page: &MediaPage, palette: &Palette) -> Result<Vec<BrickSamples>> {
        let mut all = Vec::new();
        let coding = Coding::read(page.coding.code())?;
        decode(
            &unpacked(page),
            coding,
            page.bricks as usize,
            palette,
            |i, brick| {
                assert_eq!(i, all.len());
                all.push(*brick);
                Ok(())
            },
        )?;
        Ok(all)
    }

    #[test]
    fn samples_come_back_bit_for_bit() {
        let noise = |i: usize| ((i * 7919 % 10_007) as f32).sqrt() * 0.137;
        let cases: [(&dyn Fn(usize) -> f32, usize); 6] = [
            (&noise, 4),
            (&|_| f32::MAX, 4),
            (&|i| f32::from_bits(i as u32 % 5), 1),
            (&|i| (i % 64) as f32, 2),
            (&|_| 0.0, 1),
            (
                &|i| f32::from_bits((noise(i).to_bits() + 2048) >> 12 << 12),
                3,
            ),
        ];
        for (n, (value, width)) in cases.into_iter().enumerate() {
            for count in [1, 3, PAGE_BRICKS] {
                let given = bricks(count, value);
                let page = MediaPage::encode(&given, None).unwrap();
                assert!(usize::from(page.coding.width) <= width, "case {n}");
                assert_eq!(page.raw_bytes as usize, page.coding.raw_bytes(count));
                assert_eq!(
                    decoded(&page, &Palette::default()).unwrap(),
                    given,
                    "case {n}"
                );
            }
        }
    }

    #[test]
    fn samples_of_few_values_take_two_bytes_at_most() {
        let value = |i: usize| (i * i % 3001) as f32 * 0.123_456;
        let given = bricks(PAGE_BRICKS * 3, value);
        let (palette, index) = Palette::of(given.iter().copied()).unwrap();
        for page in given.chunks(PAGE_BRICKS) {
            let packed = MediaPage::encode(page, Some(&index)).unwrap();
            assert!(packed.coding.by_palette && packed.coding.width == 2);
            assert_eq!(decoded(&packed, &palette).unwrap(), page);
            let smaller = Palette::of([[0.0; 512]].into_iter()).unwrap().0;
            assert!(
                decoded(&packed, &smaller).is_err(),
                "numbers beyond the palette"
            );
        }
        // Samples that are not of the palette are stored all the same.
        let others = bricks(1, |i| 1.0 + i as f32);
        let packed = MediaPage::encode(&others, Some(&index)).unwrap();
        assert!(!packed.coding.by_palette);
        assert_eq!(decoded(&packed, &palette).unwrap(), others);
    }

    #[test]
    fn samples_that_no_reader_takes_are_refused() {
        for wrong in [f32::NAN, f32::INFINITY, -1.0] {
            assert!(MediaPage::encode(&bricks(1, |_| wrong), None).is_err());
        }
        assert!(MediaPage::encode(&[], None).is_err());
        assert!(MediaPage::encode(&bricks(PAGE_BRICKS + 1, |_| 1.0), None).is_err());
    }

    #[test]
    fn no_bytes_make_samples_that_are_not_finite() {
        let mut state = 7_u32;
        let mut random = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 24) as u8
        };
        let (mut taken, mut refused) = (0, 0);
        for round in 0..400_u32 {
            let (shift, width) = (round % 24, round / 24 % 4 + 1);
            let coding = Coding::read(shift << 8 | width << 16).unwrap();
            let raw: Vec<u8> = (0..coding.raw_bytes(2))
                .map(|_| random() & random())
                .collect();
            let result = decode(&raw, coding, 2, &Palette::default(), |_, brick| {
                assert!(brick.iter().all(|v| v.is_finite() && v.is_sign_positive()));
                taken += 1;
                Ok(())
            });
            refused += u32::from(result.is_err());
            assert!(decode(&raw[1..], coding, 2, &Palette::default(), |_, _| Ok(())).is_err());
        }
        assert!(taken > 20 && refused > 20, "{taken} {refused}");
    }

    #[test]
    fn codings_that_are_none_are_refused() {
        for code in [
            0,
            0x05_0000,
            0x01_1f_00,
            0x03_00_01,
            0x01_01_01,
            0x01_00_02,
            0x0101_0000,
        ] {
            assert!(Coding::read(code).is_err(), "{code:#x}");
        }
    }
}

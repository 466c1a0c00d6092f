//! What follows the head of a file of samples: the rows of pixels, and the checksum of all.

use super::head::{Head, Unreadable};
use std::io::{self, Read, Write};

const CHECKSUM_BYTES: usize = 32;
/// Bytes of the counts that a row begins with.
const COUNT_BYTES: u64 = 4 + 8;

/// A row of pixels.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// Row in the frame.
    pub y: u32,
    /// Samples that each pixel has.
    pub count: u32,
    /// Samples of all its pixels that were infinite or not a number, and count as black.
    pub not_finite: u64,
    /// Sums of each strand of each pixel.
    pub sums: Vec<[f64; 3]>,
}

/// Bytes that the sums of `pixels` pixels take; the largest number if that is beyond all.
#[must_use]
pub fn sum_bytes(pixels: u64, strands: u32) -> u64 {
    let sum = size_of::<[f64; 3]>() as u64;
    pixels.saturating_mul(u64::from(strands).saturating_mul(sum))
}

/// Finds the fewest and the most samples of rows; zeros if there are no rows.
#[must_use]
pub fn count_range(counts: impl Iterator<Item = u32> + Clone) -> (u32, u32) {
    (counts.clone().min().unwrap_or(0), counts.max().unwrap_or(0))
}

/// Writes a whole file of samples.
///
/// # Errors
/// Those of `out`.
pub fn write(out: &mut impl Write, head: &Head, rows: &[Row]) -> io::Result<()> {
    let mut hasher = blake3::Hasher::new();
    let mut put = |bytes: &[u8]| {
        hasher.update(bytes);
        out.write_all(bytes)
    };
    put(&head.bytes())?;
    let mut bytes = Vec::new();
    for row in rows {
        bytes.clear();
        bytes.extend_from_slice(&row.count.to_le_bytes());
        bytes.extend_from_slice(&row.not_finite.to_le_bytes());
        for v in row.sums.iter().flatten() {
            bytes.extend_from_slice(&v.to_le_bytes());
        }
        put(&bytes)?;
    }
    let checksum = *hasher.finalize().as_bytes();
    out.write_all(&checksum)
}

/// Hashes and counts what is read through it.
struct Hashing<R> {
    file: R,
    hasher: blake3::Hasher,
}

impl<R: Read> Read for Hashing<R> {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        let read = self.file.read(bytes)?;
        self.hasher.update(&bytes[..read]);
        Ok(read)
    }
}

/// A file of samples, read row by row. What it says is known to be true once [`Rows::finish`] has
/// found the checksum right.
pub struct Rows<R> {
    file: Hashing<R>,
    head: Head,
    /// Bytes of a row.
    row: Vec<u8>,
    next: u32,
}

impl<R: Read> Rows<R> {
    /// Reads the head of a file of `length` bytes.
    ///
    /// # Errors
    /// As [`Head::read`], and for a length that is not what the head says: so no row takes more
    /// memory than the file has bytes.
    pub fn open(file: R, length: u64) -> Result<Self, Unreadable> {
        let hasher = blake3::Hasher::new();
        let mut file = Hashing { file, hasher };
        let head = Head::read(&mut file)?;
        let (width, height) = (head.region.width(), head.region.height());
        let row = sum_bytes(width.into(), head.strands).saturating_add(COUNT_BYTES);
        let ends = file.hasher.count() + CHECKSUM_BYTES as u64;
        let expected = row.saturating_mul(height.into()).saturating_add(ends);
        if length != expected || row > length {
            return Err(Unreadable::Length);
        }
        Ok(Self {
            row: vec![0; row as usize],
            next: head.region.y0,
            file,
            head,
        })
    }

    /// The head of the file.
    pub fn head(&self) -> &Head {
        &self.head
    }

    /// Reads the next row from the top, if there is one.
    ///
    /// # Errors
    /// [`Unreadable::Sum`], and those of the file.
    pub fn next_row(&mut self) -> Result<Option<Row>, Unreadable> {
        if self.next == self.head.region.y1 {
            return Ok(None);
        }
        self.file.read_exact(&mut self.row)?;
        let (count, rest) = self.row.split_first_chunk().ok_or(Unreadable::Cut)?;
        let (not_finite, sums) = rest.split_first_chunk().ok_or(Unreadable::Cut)?;
        let (values, _) = sums.as_chunks();
        let (sums, _) = values.as_chunks();
        let row = Row {
            y: self.next,
            count: u32::from_le_bytes(*count),
            not_finite: u64::from_le_bytes(*not_finite),
            sums: sums
                .iter()
                .map(|sum: &[[u8; 8]; 3]| sum.map(f64::from_le_bytes))
                .collect(),
        };
        if !row.sums.iter().flatten().all(|v| v.is_finite()) {
            return Err(Unreadable::Sum(row.y));
        }
        self.next += 1;
        Ok(Some(row))
    }

    /// Reads what is left, and checks the checksum.
    ///
    /// # Errors
    /// [`Unreadable::Checksum`], and those of the file.
    pub fn finish(mut self) -> Result<(), Unreadable> {
        while self.next_row()?.is_some() {}
        let mut checksum = [0; CHECKSUM_BYTES];
        self.file.file.read_exact(&mut checksum)?;
        if self.file.hasher.finalize() == checksum {
            Ok(())
        } else {
            Err(Unreadable::Checksum)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::Origin;
    use super::*;
    use crate::image::Region;

    fn read(bytes: &[u8]) -> Result<(Head, Vec<Row>), Unreadable> {
        let mut file = Rows::open(bytes, bytes.len() as u64)?;
        let head = file.head().clone();
        let mut rows = Vec::new();
        while let Some(row) = file.next_row()? {
            rows.push(row);
        }
        file.finish()?;
        Ok((head, rows))
    }

    fn given() -> (Head, Vec<Row>) {
        let head = Head {
            strands: 2,
            region: Region {
                x0: 3,
                y0: 5,
                x1: 6,
                y1: 7,
            },
            origin: Origin {
                film: [20, 10],
                ..Origin::default()
            },
        };
        let row = |y: u32| Row {
            y,
            count: 10 + y,
            not_finite: u64::from(y) << 40,
            sums: (0..6).map(|i| [f64::from(i), 0.1, -1e300]).collect(),
        };
        (head, vec![row(5), row(6)])
    }

    #[test]
    fn rows_survive_a_round_trip() {
        let (head, rows) = given();
        let mut bytes = Vec::new();
        write(&mut bytes, &head, &rows).unwrap();
        assert_eq!(read(&bytes).unwrap(), (head, rows));
        // A look at the head alone checks the rest too.
        Rows::open(bytes.as_slice(), bytes.len() as u64)
            .unwrap()
            .finish()
            .unwrap();
    }

    #[test]
    fn all_damage_is_found() {
        let (head, rows) = given();
        let mut whole = Vec::new();
        write(&mut whole, &head, &rows).unwrap();
        for at in 0..whole.len() {
            let mut bytes = whole.clone();
            bytes[at] ^= 4;
            assert!(read(&bytes).is_err(), "{at}");
            assert!(read(&whole[..at]).is_err(), "cut at {at}");
        }
        let last = whole.len() - 1;
        whole[last] ^= 1;
        assert!(matches!(read(&whole), Err(Unreadable::Checksum)));
        whole.push(0);
        assert!(matches!(read(&whole), Err(Unreadable::Length)));
        // A head that claims more than there is makes no room for it.
        let vast = Head {
            strands: u32::MAX,
            region: Region::full(u32::MAX, u32::MAX),
            origin: Origin {
                film: [u32::MAX; 2],
                ..Origin::default()
            },
        };
        assert!(matches!(read(&vast.bytes()), Err(Unreadable::Length)));
    }

    #[test]
    fn sums_that_are_not_finite_are_refused() {
        for value in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            let (head, mut rows) = given();
            rows[1].sums[5][2] = value;
            let mut bytes = Vec::new();
            write(&mut bytes, &head, &rows).unwrap();
            assert!(matches!(read(&bytes), Err(Unreadable::Sum(6))), "{value}");
        }
    }

    #[test]
    fn counts_are_those_of_rows() {
        assert_eq!(count_range([].into_iter()), (0, 0));
        assert_eq!(count_range([7, 9, 8].into_iter()), (7, 9));
    }
}

//! The columns of a chunk, each compressed on its own behind a directory of them.

use crate::bytes::{self, Column, Cursor, column};
use crate::frame::Block;
use crate::{FormatError, Result};
use xxhash_rust::xxh3::xxh3_64;

/// By bit in the mask of a chunk of surfels.
pub const SURFELS: [Column; 10] = [
    column("position", 12),
    column("normal", 4),
    column("radius", 4),
    column("area", 4),
    column("front", 12),
    column("front_grey", 4),
    column("back", 12),
    column("back_grey", 4),
    column("clip_counts", 1),
    column("clip_edges", 2),
];
pub const POSITION: usize = 0;
pub const NORMAL: usize = 1;
pub const RADIUS: usize = 2;
pub const AREA: usize = 3;
pub const FRONT: usize = 4;
pub const FRONT_GREY: usize = 5;
pub const BACK: usize = 6;
pub const BACK_GREY: usize = 7;
pub const CLIP_COUNTS: usize = 8;
pub const CLIP_EDGES: usize = 9;

/// By bit in the mask of a chunk of lvoxels.
pub const LVOXELS: [Column; 7] = [
    column("volume", 2),
    column("level", 1),
    column("block", 6),
    column("sigma_t", 4),
    column("source", 12),
    column("source_grey", 4),
    column("lobe", 3),
];
pub const VOLUME: usize = 0;
pub const LEVEL: usize = 1;
pub const BLOCK: usize = 2;
pub const SIGMA_T: usize = 3;
pub const SOURCE: usize = 4;
pub const SOURCE_GREY: usize = 5;
pub const LOBE: usize = 6;

pub const ZSTD_LEVEL: i32 = 1;
pub const DIRECTORY_ENTRY: usize = 16;

/// How the bytes of a column are stored.
const RAW: u8 = 0;
const ZSTD: u8 = 1;
const CONSTANT: u8 = 2;

/// A chunk as it goes to the file.
#[derive(Default)]
pub struct Packed {
    pub bytes: Vec<u8>,
    pub raw_bytes: u32,
    pub mask: u32,
    pub checksum: u64,
    /// Column, raw bytes, stored bytes with the directory's entry.
    pub sizes: Vec<(usize, u64, u64)>,
}

/// Packs columns given as (index, rows), in order of index.
pub fn pack(table: &[Column], columns: &[(usize, Vec<u8>)]) -> Result<Packed> {
    let mut packed = Packed::default();
    let mut directory = Vec::new();
    let mut body: Vec<u8> = Vec::new();
    let mut planes = Vec::new();
    for (index, rows) in columns {
        let width = table[*index].width;
        planes.clear();
        let compressed;
        let (codec, stored) = if is_constant(rows, width) {
            (CONSTANT, &rows[..width])
        } else {
            bytes::to_planes(rows, width, &mut planes);
            compressed = bytes::compress(&planes, ZSTD_LEVEL)?;
            match &compressed {
                Some(zstd) => (ZSTD, zstd.as_slice()),
                None => (RAW, planes.as_slice()),
            }
        };
        directory.extend((stored.len() as u32).to_le_bytes());
        directory.extend([codec, 0, 0, 0]);
        directory.extend(xxh3_64(stored).to_le_bytes());
        body.extend(stored);
        packed.mask |= 1 << index;
        packed.raw_bytes += rows.len() as u32;
        packed.sizes.push((
            *index,
            rows.len() as u64,
            (stored.len() + DIRECTORY_ENTRY) as u64,
        ));
    }
    packed.checksum = xxh3_64(&directory);
    packed.bytes = directory;
    packed.bytes.extend(body);
    Ok(packed)
}

pub fn is_constant(rows: &[u8], width: usize) -> bool {
    rows.len() > width && rows.chunks_exact(width).all(|row| row == &rows[..width])
}

/// The directory of a chunk, checked.
pub struct Chunk<'a> {
    table: &'static [Column],
    place: String,
    records: usize,
    raw_bytes: usize,
    /// By column: codec and stored bytes with their checksum.
    columns: [Option<(u8, &'a [u8], u64)>; 10],
}

impl<'a> Chunk<'a> {
    /// Reads the directory of the chunk `bytes`; `place` names it in errors. The number of records
    /// was checked when the file was opened.
    pub fn open(
        bytes: &'a [u8],
        block: &Block,
        table: &'static [Column],
        place: String,
    ) -> Result<Self> {
        let records = block.records as usize;
        if block.columns >> table.len() != 0 {
            return Err(FormatError::invalid(
                format!("columns of {place}"),
                format!("a mask of {} bits", table.len()),
                format!("{:#x}", block.columns),
            ));
        }
        let len = block.columns.count_ones() as usize * DIRECTORY_ENTRY;
        let mut body = Cursor::new(bytes, "column directory");
        let directory = body.take(len)?;
        bytes::check(directory, block.checksum, || {
            format!("the column directory of {place}")
        })?;
        let mut cursor = Cursor::new(directory, "column directory");
        let mut columns = [None; 10];
        for (index, slot) in columns.iter_mut().enumerate().take(table.len()) {
            if block.columns >> index & 1 == 0 {
                continue;
            }
            let stored = cursor.u32()?;
            let codec = cursor.u8()?;
            let padding = cursor.take(3)?;
            if padding != [0; 3] || codec > CONSTANT {
                return Err(FormatError::invalid(
                    format!("coding of column {} in {place}", table[index].name),
                    "0, 1 or 2",
                    format!("{codec} {padding:?}"),
                ));
            }
            *slot = Some((codec, body.take(stored as usize)?, cursor.u64()?));
        }
        body.end()?;
        Ok(Self {
            table,
            place,
            records,
            raw_bytes: block.raw_bytes as usize,
            columns,
        })
    }

    pub fn records(&self) -> usize {
        self.records
    }

    pub fn has(&self, index: usize) -> bool {
        self.columns[index].is_some()
    }

    /// The chunk's place, for errors.
    pub fn place(&self) -> &str {
        &self.place
    }

    /// An error unless the columns' lengths add up to what the block table says.
    pub fn check_raw_bytes(&self, edges: usize) -> Result<()> {
        let sum: usize = (0..self.table.len())
            .filter(|i| self.has(*i))
            .map(|i| {
                let rows = if self.is_edges(i) {
                    edges
                } else {
                    self.records
                };
                rows * self.table[i].width
            })
            .sum();
        if sum == self.raw_bytes {
            Ok(())
        } else {
            Err(FormatError::invalid(
                format!("raw bytes of {}", self.place),
                sum.to_string(),
                self.raw_bytes,
            ))
        }
    }

    fn is_edges(&self, index: usize) -> bool {
        self.table.len() == SURFELS.len() && index == CLIP_EDGES
    }

    /// Rows of a column, or `None` if it is absent. `rows` is at most three times the records of a
    /// chunk.
    pub fn column(&self, index: usize, rows: usize) -> Result<Option<Vec<u8>>> {
        let Some((codec, stored, checksum)) = self.columns[index] else {
            return Ok(None);
        };
        let Column { name, width } = self.table[index];
        bytes::check(stored, checksum, || {
            format!("column {name} in {}", self.place)
        })?;
        let expected = if codec == CONSTANT {
            width
        } else {
            rows * width
        };
        if codec != ZSTD && stored.len() != expected {
            return Err(FormatError::invalid(
                format!("length of column {name} in {}", self.place),
                expected.to_string(),
                stored.len(),
            ));
        }
        Ok(Some(match codec {
            CONSTANT => stored.repeat(rows),
            ZSTD => {
                let mut planes = vec![0; expected];
                bytes::decompress(
                    stored,
                    &mut planes,
                    &format!("column {name} in {}", self.place),
                )?;
                bytes::from_planes(&planes, width)
            }
            _ => bytes::from_planes(stored, width),
        }))
    }

    /// Rows of a column that must be there.
    pub fn required(&self, index: usize) -> Result<Vec<u8>> {
        self.column(index, self.records)?.ok_or_else(|| {
            FormatError::invalid(
                format!("columns of {}", self.place),
                format!("column {}", self.table[index].name),
                "none",
            )
        })
    }
}

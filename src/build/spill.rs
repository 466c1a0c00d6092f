//! Records in a temporary file, dealt out to buckets.

use crate::formats::{ClipEdge, Lvoxel, Surfel};
use crate::{Error, Result};
use std::fs::File;
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::PathBuf;

/// One nameless temporary file, whatever the number of buckets: the system's limit on open files
/// does not matter, and the file is gone when the process is.
pub struct Spill {
    file: File,
    folder: PathBuf,
    len: u64,
}

/// Bytes of whole records in the file.
#[derive(Clone, Copy, Debug)]
pub struct SpillRange {
    offset: u64,
    len: u32,
}

impl Spill {
    pub fn new(folder: Option<&PathBuf>) -> Result<Self> {
        let folder = folder.cloned().unwrap_or_else(std::env::temp_dir);
        let file = tempfile::tempfile_in(&folder).map_err(|e| {
            Error::io("create a temporary file in", &folder, &e)
                .hint("choose another folder for temporary files (`temp_dir`)")
        })?;
        Ok(Self {
            file,
            folder,
            len: 0,
        })
    }

    /// Bytes written.
    pub fn len(&self) -> u64 {
        self.len
    }

    pub fn append(&mut self, bytes: &[u8]) -> Result<SpillRange> {
        let range = SpillRange {
            offset: self.len,
            len: bytes.len() as u32,
        };
        self.file
            .seek(SeekFrom::Start(self.len))
            .and_then(|_| self.file.write_all(bytes))
            .map_err(|e| {
                Error::io("write a temporary file in", &self.folder, &e)
                    .hint("choose a folder with more room for temporary files (`temp_dir`)")
            })?;
        self.len += bytes.len() as u64;
        Ok(range)
    }

    /// Reads an range into `bytes`.
    pub fn read(&mut self, range: SpillRange, bytes: &mut Vec<u8>) -> Result<()> {
        bytes.resize(range.len as usize, 0);
        self.file
            .seek(SeekFrom::Start(range.offset))
            .and_then(|_| self.file.read_exact(bytes))
            .map_err(|e| Error::io("read a temporary file in", &self.folder, &e))
    }
}

/// A record as bytes, exactly: what comes back is what went in.
pub trait Record: Sized {
    /// Bytes of the shortest one.
    const MIN_BYTES: usize;
    /// Bytes of the longest one.
    const MAX_BYTES: usize;

    fn write(&self, out: &mut Vec<u8>);
    /// Takes a record from the front of what [`Self::write`] wrote.
    fn read(bytes: &mut &[u8]) -> Self;
}

fn floats(out: &mut Vec<u8>, values: &[f32]) {
    out.extend(values.iter().flat_map(|v| v.to_le_bytes()));
}

fn take<const N: usize>(bytes: &mut &[u8]) -> [u8; N] {
    let (head, rest) = bytes.split_first_chunk().unwrap_or((&[0; N], &[]));
    *bytes = rest;
    *head
}

fn float(bytes: &mut &[u8]) -> f32 {
    f32::from_le_bytes(take(bytes))
}

fn three(bytes: &mut &[u8]) -> [f32; 3] {
    std::array::from_fn(|_| float(bytes))
}

const HAS_BACK: u8 = 4;

const FLOAT: usize = size_of::<f32>();

impl Record for Surfel {
    /// Flags, position, normal, radius, area and front.
    const MIN_BYTES: usize = 1 + (3 + 3 + 1 + 1 + 3) * FLOAT;
    /// The same, the back, and three edges.
    const MAX_BYTES: usize = Self::MIN_BYTES + (3 + 3 * 2) * FLOAT;

    fn write(&self, out: &mut Vec<u8>) {
        let has_back = self.back != [0.0; 3];
        out.push(self.clips.count | if has_back { HAS_BACK } else { 0 });
        floats(out, &self.position);
        floats(out, &self.normal);
        floats(out, &[self.radius, self.area]);
        floats(out, &self.front);
        if has_back {
            floats(out, &self.back);
        }
        for edge in &self.clips.edges[..usize::from(self.clips.count)] {
            floats(out, &[edge.angle, edge.offset]);
        }
    }

    fn read(bytes: &mut &[u8]) -> Self {
        let [flags] = take(bytes);
        let mut surfel = Surfel {
            position: three(bytes),
            normal: three(bytes),
            radius: float(bytes),
            area: float(bytes),
            front: three(bytes),
            ..Surfel::default()
        };
        if flags & HAS_BACK != 0 {
            surfel.back = three(bytes);
        }
        surfel.clips.count = flags & 3;
        for edge in &mut surfel.clips.edges[..usize::from(flags & 3)] {
            *edge = ClipEdge {
                angle: float(bytes),
                offset: float(bytes),
            };
        }
        surfel
    }
}

impl Record for Lvoxel {
    /// Volume, level, block, extinction and source.
    const MIN_BYTES: usize = 2 + 1 + 3 * 2 + (1 + 3) * FLOAT;
    const MAX_BYTES: usize = Self::MIN_BYTES;

    fn write(&self, out: &mut Vec<u8>) {
        out.extend(self.volume.to_le_bytes());
        out.push(self.level);
        out.extend(self.block.iter().flat_map(|b| b.to_le_bytes()));
        floats(out, &[self.sigma_t]);
        floats(out, &self.source);
    }

    fn read(bytes: &mut &[u8]) -> Self {
        Lvoxel {
            volume: u16::from_le_bytes(take(bytes)),
            level: take::<1>(bytes)[0],
            block: std::array::from_fn(|_| u16::from_le_bytes(take(bytes))),
            sigma_t: float(bytes),
            source: three(bytes),
        }
    }
}

/// Deals records out to buckets through a buffer for each.
pub struct Dealer {
    buffers: Vec<Vec<u8>>,
    ranges: Vec<Vec<SpillRange>>,
    buffer_bytes: usize,
}

impl Dealer {
    /// Buffers of `bytes` in all.
    pub fn new(buckets: usize, bytes: u64) -> Self {
        let share = bytes / buckets.max(1) as u64;
        Self {
            buffers: vec![Vec::new(); buckets],
            ranges: vec![Vec::new(); buckets],
            buffer_bytes: share.clamp(1 << 12, 1 << 18) as usize,
        }
    }

    pub fn push<R: Record>(&mut self, spill: &mut Spill, bucket: usize, record: &R) -> Result<()> {
        let buffer = &mut self.buffers[bucket];
        if buffer.capacity() == 0 {
            buffer.reserve_exact(self.buffer_bytes);
        }
        record.write(buffer);
        // The next record always fits: the buffer never grows.
        if buffer.len() + R::MAX_BYTES > self.buffer_bytes {
            self.ranges[bucket].push(spill.append(buffer)?);
            buffer.clear();
        }
        Ok(())
    }

    /// The ranges of each bucket, in the order of pushing.
    pub fn finish(mut self, spill: &mut Spill) -> Result<Vec<Vec<SpillRange>>> {
        for (buffer, ranges) in self.buffers.iter().zip(&mut self.ranges) {
            if !buffer.is_empty() {
                ranges.push(spill.append(buffer)?);
            }
        }
        Ok(self.ranges)
    }
}

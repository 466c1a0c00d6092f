//! Records in a temporary file, dealt out to buckets.

use crate::formats::{ClipEdge, Lvoxel, Surfel};
use crate::{Error, Result};
use rayon::prelude::*;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom, Write};
use std::marker::PhantomData;
use std::path::PathBuf;

/// zstd's level for runs: they are read once, and soon.
const RUN_ZSTD_LEVEL: i32 = 1;

/// One nameless temporary file, whatever the number of buckets: the system's limit on open files
/// does not matter, and the file is gone when the process is.
pub struct Spill {
    file: File,
    folder: PathBuf,
    len: u64,
}

/// A run of records in the file, packed.
#[derive(Clone, Copy, Debug)]
pub struct SpillRange {
    offset: u64,
    /// Bytes in the file.
    stored: u32,
    /// Bytes before compression.
    raw: u32,
    records: u32,
}

/// A run of records, packed, outside the file.
pub struct Run {
    bytes: Vec<u8>,
    raw: u32,
    records: u32,
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

    fn append(&mut self, run: &Run) -> Result<SpillRange> {
        let range = SpillRange {
            offset: self.len,
            stored: run.bytes.len() as u32,
            raw: run.raw,
            records: run.records,
        };
        self.file
            .seek(SeekFrom::Start(self.len))
            .and_then(|_| self.file.write_all(&run.bytes))
            .map_err(|e| {
                Error::io("write a temporary file in", &self.folder, &e)
                    .hint("choose a folder with more room for temporary files (`temp_dir`)")
            })?;
        self.len += run.bytes.len() as u64;
        Ok(range)
    }

    /// Reads a range as it was packed.
    pub fn read(&mut self, range: SpillRange) -> Result<Run> {
        let mut bytes = vec![0; range.stored as usize];
        self.file
            .seek(SeekFrom::Start(range.offset))
            .and_then(|_| self.file.read_exact(&mut bytes))
            .map_err(|e| Error::io("read a temporary file in", &self.folder, &e))?;
        Ok(Run {
            bytes,
            raw: range.raw,
            records: range.records,
        })
    }
}

impl Run {
    /// Packs records.
    pub fn of<R: Record>(records: &[R]) -> Result<Self> {
        let mut rows = Vec::with_capacity(records.len() * R::MAX_BYTES);
        records.iter().for_each(|r| r.write(&mut rows));
        Self::pack::<R>(&rows)
    }

    /// Bytes in the file.
    pub fn stored_bytes(&self) -> u64 {
        self.bytes.len() as u64
    }

    /// Packs records that stand one behind the other: each byte of their heads, then each byte of
    /// each word, apart. Neighbours share their high bytes, and words of one triangle are the same.
    fn pack<R: Record>(rows: &[u8]) -> Result<Self> {
        let mut starts = Vec::with_capacity(rows.len() / R::MIN_BYTES);
        let mut at = 0;
        while at < rows.len() {
            let words = R::words(&rows[at..at + R::HEAD_BYTES]);
            starts.push((at, words));
            at += R::HEAD_BYTES + words * WORD;
        }
        let mut planes = Vec::with_capacity(rows.len());
        for byte in 0..R::HEAD_BYTES {
            planes.extend(starts.iter().map(|(at, _)| rows[at + byte]));
        }
        let mut column: Vec<u32> = Vec::with_capacity(starts.len());
        for word in 0..R::MAX_WORDS {
            let first = R::HEAD_BYTES + word * WORD;
            let number = |at: &usize| {
                let bytes = &rows[at + first..at + first + WORD];
                bytes.iter().rev().fold(0, |n, b| n << 8 | u32::from(*b))
            };
            column.clear();
            let long = starts.iter().filter(|(_, words)| word < *words);
            column.extend(long.map(|(at, _)| number(at)));
            for shift in [0, 8, 16, 24] {
                planes.extend(column.iter().map(|n| (n >> shift) as u8));
            }
        }
        let bytes = zstd::bulk::compress(&planes, RUN_ZSTD_LEVEL)
            .map_err(|e| Error::failed(format!("cannot compress temporary records: {e}")))?;
        Ok(Self {
            bytes,
            raw: rows.len() as u32,
            records: starts.len() as u32,
        })
    }

    /// The records, in the order in which they were dealt.
    pub fn unpack<R: Record>(&self) -> Result<Vec<R>> {
        let damaged = || Error::failed("the temporary file does not hold what was written to it");
        let planes = zstd::bulk::decompress(&self.bytes, self.raw as usize)
            .ok()
            .filter(|planes| planes.len() == self.raw as usize)
            .ok_or_else(damaged)?;
        let n = self.records as usize;
        let (heads, mut rest) = planes
            .split_at_checked(n * R::HEAD_BYTES)
            .ok_or_else(damaged)?;
        let head = |i: usize| {
            let mut head = R::Head::default();
            for (byte, value) in head.as_mut().iter_mut().enumerate() {
                *value = heads[byte * n + i];
            }
            head
        };
        // How many records have each word.
        let mut longs = vec![0; R::MAX_WORDS + 1];
        (0..n).for_each(|i| longs[R::words(head(i).as_ref())] += 1);
        let mut columns: Vec<Vec<f32>> = Vec::with_capacity(R::MAX_WORDS);
        for word in 0..R::MAX_WORDS {
            let long: usize = longs[word + 1..].iter().sum();
            let (own, others) = rest.split_at_checked(long * WORD).ok_or_else(damaged)?;
            rest = others;
            let (low, high) = own.split_at(2 * long);
            let ((a, b), (c, d)) = (low.split_at(long), high.split_at(long));
            let bytes = a.iter().zip(b).zip(c.iter().zip(d));
            let number = |((a, b), (c, d)): ((&u8, &u8), (&u8, &u8))| {
                f32::from_bits(u32::from_le_bytes([*a, *b, *c, *d]))
            };
            columns.push(bytes.map(number).collect());
        }
        let mut next = vec![0; R::MAX_WORDS];
        let mut words = R::Words::default();
        Ok((0..n)
            .map(|i| {
                let head = head(i);
                let own = words.as_mut()[..R::words(head.as_ref())].iter_mut();
                for ((word, column), next) in own.zip(&columns).zip(&mut next) {
                    *word = column[*next];
                    *next += 1;
                }
                R::new(&head, &words)
            })
            .collect())
    }
}

/// Reads ranges and unpacks them, several at a time.
pub fn read_all<R: Record>(spill: &mut Spill, ranges: &[SpillRange]) -> Result<Vec<Vec<R>>> {
    let runs = ranges
        .iter()
        .map(|range| spill.read(*range))
        .collect::<Result<Vec<_>>>()?;
    runs.par_iter().map(Run::unpack).collect()
}

const WORD: usize = size_of::<f32>();

/// A record as a head of bytes and some 32-bit words, exactly: what comes back is what went in.
pub trait Record: Copy + Send + Sync {
    const HEAD_BYTES: usize;
    /// Words of the longest record.
    const MAX_WORDS: usize;
    /// Bytes of the shortest record.
    const MIN_BYTES: usize;
    /// Bytes of the longest record.
    const MAX_BYTES: usize = Self::HEAD_BYTES + Self::MAX_WORDS * WORD;

    /// [`Self::HEAD_BYTES`] bytes.
    type Head: Default + AsRef<[u8]> + AsMut<[u8]>;
    /// [`Self::MAX_WORDS`] words.
    type Words: Default + AsMut<[f32]>;

    /// How many words stand behind a head.
    fn words(head: &[u8]) -> usize;
    /// Appends the head and its words.
    fn write(&self, out: &mut Vec<u8>);
    fn new(head: &Self::Head, words: &Self::Words) -> Self;
}

fn floats(out: &mut Vec<u8>, values: &[f32]) {
    for value in values {
        out.extend_from_slice(&value.to_le_bytes());
    }
}

fn three(words: &[f32], first: usize) -> [f32; 3] {
    std::array::from_fn(|k| words[first + k])
}

const CLIPS: u8 = 3;
const HAS_BACK: u8 = 4;
/// Words of every surfel: position, normal, radius, area and front.
const SURFEL_WORDS: usize = 11;

impl Record for Surfel {
    const HEAD_BYTES: usize = 1;
    /// Those of every surfel, a back, and three edges.
    const MAX_WORDS: usize = SURFEL_WORDS + 3 + 3 * 2;
    const MIN_BYTES: usize = Self::HEAD_BYTES + SURFEL_WORDS * WORD;

    type Head = [u8; 1];
    type Words = [f32; Self::MAX_WORDS];

    fn words(head: &[u8]) -> usize {
        let back = if head[0] & HAS_BACK != 0 { 3 } else { 0 };
        SURFEL_WORDS + back + 2 * usize::from(head[0] & CLIPS)
    }

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

    fn new([flags]: &[u8; 1], words: &Self::Words) -> Self {
        let mut surfel = Surfel {
            position: three(words, 0),
            normal: three(words, 3),
            radius: words[6],
            area: words[7],
            front: three(words, 8),
            ..Surfel::default()
        };
        let mut edges = SURFEL_WORDS;
        if flags & HAS_BACK != 0 {
            surfel.back = three(words, edges);
            edges += 3;
        }
        surfel.clips.count = flags & CLIPS;
        for (k, edge) in surfel.clips.edges[..usize::from(flags & CLIPS)]
            .iter_mut()
            .enumerate()
        {
            *edge = ClipEdge {
                angle: words[edges + 2 * k],
                offset: words[edges + 2 * k + 1],
            };
        }
        surfel
    }
}

impl Record for Lvoxel {
    /// Volume, level, block and lobe.
    const HEAD_BYTES: usize = 2 + 1 + 3 * 2 + 3;
    /// Extinction and source.
    const MAX_WORDS: usize = 1 + 3;
    const MIN_BYTES: usize = Self::HEAD_BYTES + Self::MAX_WORDS * WORD;

    type Head = [u8; Self::HEAD_BYTES];
    type Words = [f32; Self::MAX_WORDS];

    fn words(_: &[u8]) -> usize {
        Self::MAX_WORDS
    }

    fn write(&self, out: &mut Vec<u8>) {
        out.extend(self.volume.to_le_bytes());
        out.push(self.level);
        out.extend(self.block.iter().flat_map(|b| b.to_le_bytes()));
        out.extend(self.lobe.map(|c| c as u8));
        floats(out, &[self.sigma_t]);
        floats(out, &self.source);
    }

    fn new(head: &Self::Head, words: &Self::Words) -> Self {
        let short = |at: usize| u16::from_le_bytes([head[at], head[at + 1]]);
        Lvoxel {
            incident: [0.0; 3],
            single: Default::default(),
            volume: short(0),
            level: head[2],
            block: [short(3), short(5), short(7)],
            sigma_t: words[0],
            source: three(words, 1),
            lobe: [9, 10, 11].map(|at| head[at] as i8),
        }
    }
}

/// Deals records out to buckets through a buffer for each.
pub struct Dealer<R> {
    buffers: Vec<Vec<u8>>,
    /// Full buffers, with their buckets, until they are packed.
    full: Vec<(usize, Vec<u8>)>,
    ranges: Vec<Vec<SpillRange>>,
    buffer_bytes: usize,
    records: PhantomData<R>,
}

impl<R: Record> Dealer<R> {
    /// Buffers of `bytes` in all.
    pub fn new(buckets: usize, bytes: u64) -> Self {
        let share = bytes / buckets.max(1) as u64;
        Self {
            buffers: vec![Vec::new(); buckets],
            full: Vec::new(),
            ranges: vec![Vec::new(); buckets],
            buffer_bytes: share.clamp(1 << 12, 1 << 18) as usize,
            records: PhantomData,
        }
    }

    pub fn push(&mut self, bucket: usize, record: &R) {
        let buffer = &mut self.buffers[bucket];
        if buffer.capacity() == 0 {
            buffer.reserve_exact(self.buffer_bytes);
        }
        record.write(buffer);
        // The next record always fits: the buffer never grows.
        if buffer.len() + R::MAX_BYTES > self.buffer_bytes {
            self.full.push((bucket, std::mem::take(buffer)));
        }
    }

    /// Packs the buffers that are full, and writes them.
    pub fn flush(&mut self, spill: &mut Spill) -> Result<()> {
        let packed: Vec<Result<Run>> = self
            .full
            .par_iter()
            .map(|(_, rows)| Run::pack::<R>(rows))
            .collect();
        for ((bucket, _), run) in self.full.drain(..).zip(packed) {
            self.ranges[bucket].push(spill.append(&run?)?);
        }
        Ok(())
    }

    /// The ranges of each bucket, in the order of pushing.
    pub fn finish(mut self, spill: &mut Spill) -> Result<Vec<Vec<SpillRange>>> {
        let buffers = std::mem::take(&mut self.buffers);
        let rest = buffers.into_iter().enumerate();
        self.full.extend(rest.filter(|(_, rows)| !rows.is_empty()));
        self.flush(spill)?;
        Ok(self.ranges)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::Clips;

    fn surfel(i: usize) -> Surfel {
        let x = (i as f32 * 0.37).sin();
        let mut clips = Clips {
            count: (i % 4) as u8,
            ..Clips::default()
        };
        for edge in &mut clips.edges[..i % 4] {
            *edge = ClipEdge {
                angle: x,
                offset: -x,
            };
        }
        Surfel {
            position: [x, f32::MIN_POSITIVE / 2.0, -0.0],
            normal: [x, 0.5, 1.0],
            radius: 0.1,
            area: x.abs(),
            front: [x; 3],
            back: if i.is_multiple_of(3) {
                [x, 0.0, 1.0]
            } else {
                [0.0; 3]
            },
            clips,
        }
    }

    fn bits<R: Record>(records: &[R]) -> Vec<u8> {
        let mut bytes = Vec::new();
        records.iter().for_each(|r| r.write(&mut bytes));
        bytes
    }

    #[test]
    fn what_is_dealt_comes_back_in_order_and_to_the_bit() {
        let mut spill = Spill::new(None).unwrap();
        let given: Vec<Surfel> = (0..5000).map(surfel).collect();
        let mut dealer = Dealer::new(3, 3 << 12);
        for (i, s) in given.iter().enumerate() {
            dealer.push(i % 3, s);
            if i % 1000 == 0 {
                dealer.flush(&mut spill).unwrap();
            }
        }
        let ranges = dealer.finish(&mut spill).unwrap();
        assert!(ranges.iter().all(|r| r.len() > 5));
        for (bucket, ranges) in ranges.iter().enumerate() {
            let expected: Vec<Surfel> = given.iter().skip(bucket).step_by(3).copied().collect();
            let found = read_all::<Surfel>(&mut spill, ranges).unwrap().concat();
            assert_eq!(bits(&found), bits(&expected));
        }
        let lvoxels: Vec<Lvoxel> = (0..3000u16)
            .map(|i| Lvoxel {
                incident: [0.0; 3],
                single: Default::default(),
                volume: i % 5,
                level: (i % 4) as u8,
                block: [i, i / 2, u16::MAX - i],
                sigma_t: f32::from(i),
                source: [0.0, 1.0, f32::from(i)],
                lobe: [(i % 100) as i8, -5, 7],
            })
            .collect();
        let mut dealer = Dealer::new(1, 1 << 16);
        lvoxels.iter().for_each(|v| dealer.push(0, v));
        let ranges = dealer.finish(&mut spill).unwrap().concat();
        let found = read_all::<Lvoxel>(&mut spill, &ranges).unwrap().concat();
        assert_eq!(bits(&found), bits(&lvoxels));
    }
}

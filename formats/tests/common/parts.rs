//! Files of ours taken apart, changed and put together again with right checksums: what a hostile
//! writer would make.

use std::ops::Range;
use xxhash_rust::xxh3::xxh3_64;

const HEADER_LEN: usize = 104;
const ENTRY_LEN: usize = 40;
const DIRECTORY_ENTRY: usize = 16;
/// Codings of a column of a cloud.
const ZSTD: u8 = 1;
const CONSTANT: u8 = 2;

/// The parts of a file.
#[derive(Clone)]
pub struct Parts {
    /// Magic, kind and version.
    pub head: Vec<u8>,
    pub blocks: Vec<Part>,
    pub meta: Vec<u8>,
    pub summary: Vec<u8>,
}

/// A block, decompressed.
#[derive(Clone)]
pub struct Part {
    pub kind: u32,
    pub records: u32,
    pub nodes: u32,
    /// Mask of the columns.
    pub columns: u32,
    /// Of a cloud's chunk: decompressed bytes by the block table.
    raw_bytes: u32,
    /// Coding and decompressed bytes of each column of a cloud's chunk; of a page or cluster, all
    /// of it.
    pub data: Vec<(u8, Vec<u8>)>,
}

fn number(bytes: &[u8], at: usize) -> usize {
    let number = u64::from_le_bytes(bytes[at..at + 8].try_into().unwrap());
    usize::try_from(number).unwrap_or(usize::MAX)
}

fn number32(bytes: &[u8], at: usize) -> u32 {
    u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap())
}

fn is_cloud(head: &[u8]) -> bool {
    &head[8..11] == b"LVC"
}

/// Kind of the blocks of a packed scene that fill up pages, before columns.
const PADDING: u32 = 5;
const ALIGNMENT: usize = 4096;

fn is_packed(head: &[u8]) -> bool {
    &head[8..11] == b"LVP"
}

fn unpack(stored: &[u8]) -> Vec<u8> {
    zstd::bulk::decompress(stored, 1 << 21).unwrap()
}

impl Parts {
    /// Takes a whole file apart.
    pub fn of(file: &[u8]) -> Self {
        let section = |at: usize| file[number(file, at)..][..number(file, at + 8)].to_vec();
        let part = |entry: &[u8]| {
            let raw_bytes = number32(entry, 12);
            let mut part = Part {
                kind: number32(entry, 16),
                records: number32(entry, 20),
                nodes: number32(entry, 24),
                columns: number32(entry, 28),
                raw_bytes,
                data: Vec::new(),
            };
            let stored = &file[number(entry, 0)..][..number32(entry, 8) as usize];
            if is_cloud(file) {
                let len = part.columns.count_ones() as usize * DIRECTORY_ENTRY;
                let (directory, mut rest) = stored.split_at(len);
                for column in directory.chunks(DIRECTORY_ENTRY) {
                    let (own, others) = rest.split_at(number32(column, 0) as usize);
                    let raw = if column[4] == ZSTD {
                        unpack(own)
                    } else {
                        own.to_vec()
                    };
                    part.data.push((column[4], raw));
                    rest = others;
                }
            } else if stored.len() == raw_bytes as usize {
                part.data.push((0, stored.to_vec()));
            } else {
                part.data.push((ZSTD, unpack(stored)));
            }
            part
        };
        Self {
            head: file[..16].to_vec(),
            blocks: section(72).chunks(ENTRY_LEN).map(part).collect(),
            meta: section(24),
            summary: section(48),
        }
    }

    /// The file of these parts, with right lengths and checksums.
    pub fn file(&self) -> Vec<u8> {
        let mut file = self.head.clone();
        file.resize(HEADER_LEN, 0);
        let mut table = Vec::new();
        let pack = |raw: &[u8]| zstd::bulk::compress(raw, 1).unwrap();
        for part in &self.blocks {
            let (mut stored, mut raw_bytes) = (Vec::new(), part.raw_bytes as usize);
            let mut sum = None;
            let is_column = is_packed(&self.head) && part.data[0].0 != ZSTD;
            if is_cloud(&self.head) {
                let mut body = Vec::new();
                for (coding, raw) in &part.data {
                    let column = match *coding {
                        ZSTD => pack(raw),
                        _ => raw.clone(),
                    };
                    stored.extend((column.len() as u32).to_le_bytes());
                    stored.extend([*coding, 0, 0, 0]);
                    stored.extend(xxh3_64(&column).to_le_bytes());
                    body.extend(column);
                }
                sum = Some(xxh3_64(&stored));
                stored.extend(body);
            } else {
                let raw = &part.data[0].1;
                let missing = file.len().next_multiple_of(ALIGNMENT) - file.len();
                // Zeros are as many as are missing, after what has changed before them.
                let filled = match is_column && part.kind == PADDING && raw.iter().all(|b| *b == 0)
                {
                    true => vec![0; missing],
                    false => raw.clone(),
                };
                let packed = if is_column { filled.clone() } else { pack(raw) };
                let raw = &filled;
                raw_bytes = raw.len();
                stored = if packed.len() < raw.len() {
                    packed
                } else {
                    raw.clone()
                };
            }
            table.extend((file.len() as u64).to_le_bytes());
            for number in [
                stored.len() as u32,
                raw_bytes as u32,
                part.kind,
                part.records,
                part.nodes,
                part.columns,
            ] {
                table.extend(number.to_le_bytes());
            }
            table.extend(sum.unwrap_or_else(|| xxh3_64(&stored)).to_le_bytes());
            file.extend(stored);
        }
        let mut offset = file.len();
        for (section, at) in [(&self.meta, 24), (&self.summary, 48), (&table, 72)] {
            let numbers = [offset as u64, section.len() as u64, xxh3_64(section)];
            for (number, at) in numbers.iter().zip((at..).step_by(8)) {
                file[at..at + 8].copy_from_slice(&number.to_le_bytes());
            }
            offset += section.len();
            file.extend(section);
        }
        file[16..24].copy_from_slice(&(offset as u64).to_le_bytes());
        let sum = xxh3_64(&file[..HEADER_LEN - 8]);
        file[HEADER_LEN - 8..HEADER_LEN].copy_from_slice(&sum.to_le_bytes());
        file
    }
}

impl Part {
    /// The bytes of a number among planes: of a column that begins at `start` of `data[i]`, has
    /// `rows`, and of these the number that begins at `byte` of `row`. A constant column has its
    /// row as it is.
    pub fn set(&mut self, i: usize, (start, rows): (usize, usize), at: [usize; 2], value: &[u8]) {
        let (coding, data) = &mut self.data[i];
        let [row, byte] = at;
        for (k, v) in value.iter().enumerate() {
            let at = match *coding {
                CONSTANT => byte + k,
                _ => (byte + k) * rows + row,
            };
            data[start + at] = *v;
        }
    }
}

/// Puts the checksums right again after any change, as far as the file still has parts.
pub fn repair(bytes: &mut [u8]) {
    let range = |bytes: &[u8], at: usize, len: usize| {
        (at.checked_add(len)?)
            .le(&bytes.len())
            .then_some(at..at + len)
    };
    let entries = |bytes: &[u8]| -> Option<Range<usize>> {
        range(bytes, number(bytes, 72), number(bytes, 80))
    };
    let is_cloud = is_cloud(bytes);
    // From the inside out: columns, blocks, sections, header.
    for entry in entries(bytes).into_iter().flatten().step_by(ENTRY_LEN) {
        if entry + ENTRY_LEN > bytes.len() {
            break;
        }
        let len = number32(bytes, entry + 8) as usize;
        let columns = number32(bytes, entry + 28).count_ones() as usize;
        let Some(mut block) = range(bytes, number(bytes, entry), len) else {
            continue;
        };
        if is_cloud && columns * DIRECTORY_ENTRY <= block.len() {
            let directory = block.start..block.start + columns * DIRECTORY_ENTRY;
            let mut start = directory.end;
            for column in directory.clone().step_by(DIRECTORY_ENTRY) {
                let len = number32(bytes, column);
                if let Some(stored) = range(bytes, start, len as usize) {
                    start = stored.end;
                    let sum = xxh3_64(&bytes[stored]);
                    bytes[column + 8..column + 16].copy_from_slice(&sum.to_le_bytes());
                }
            }
            block = directory;
        }
        let sum = xxh3_64(&bytes[block]);
        bytes[entry + 32..entry + 40].copy_from_slice(&sum.to_le_bytes());
    }
    for section in [24, 48, 72] {
        if let Some(range) = range(bytes, number(bytes, section), number(bytes, section + 8)) {
            let sum = xxh3_64(&bytes[range]);
            bytes[section + 16..section + 24].copy_from_slice(&sum.to_le_bytes());
        }
    }
    let sum = xxh3_64(&bytes[..HEADER_LEN - 8]);
    bytes[HEADER_LEN - 8..HEADER_LEN].copy_from_slice(&sum.to_le_bytes());
}

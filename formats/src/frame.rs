//! What all files have in common: header, blocks, then metadata, summary and block table, without a
//! gap.

use crate::bytes::{self, Cursor};
use crate::{FormatError, Result, codec};
use std::fs::File;
use std::io::Read;
use std::ops::Range;
use std::path::Path;
use xxhash_rust::xxh3::{xxh3_64, xxh3_128};

/// Version of the four formats, the one that is written and read.
pub const VERSION: u32 = 1;

/// A high-bit byte, letters, CR LF, end-of-file, LF: each of the usual damages of a text transfer
/// changes it.
pub const MAGIC: [u8; 8] = *b"\x89LVX\r\n\x1a\n";

/// Bytes of the header; blocks start here.
pub const HEADER_LEN: usize = 104;
/// Bytes of an entry of the block table.
pub const ENTRY_LEN: usize = 40;

/// The four kinds of file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FileKind {
    /// Unordered points, `.lvc`.
    Cloud,
    /// Paged octree, `.lvt`.
    Tree,
    /// Light that media scatter, `.lvs`.
    Scatter,
    /// All that stages need of a scene, `.lvp`.
    Packed,
}

impl FileKind {
    pub(crate) const ALL: [Self; 4] = [Self::Cloud, Self::Tree, Self::Scatter, Self::Packed];

    fn code(self) -> [u8; 4] {
        match self {
            Self::Cloud => *b"LVC\0",
            Self::Tree => *b"LVT\0",
            Self::Scatter => *b"LVS\0",
            Self::Packed => *b"LVP\0",
        }
    }

    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Cloud => "cloud (.lvc)",
            Self::Tree => "tree (.lvt)",
            Self::Scatter => "file of scattered light (.lvs)",
            Self::Packed => "packed scene (.lvp)",
        }
    }

    /// How to come by one, for hints.
    pub(crate) fn origin(self) -> &'static str {
        match self {
            Self::Cloud => "give the cloud (.lvc) that `lvox bake` wrote",
            Self::Tree => "make a tree from a cloud with `lvox build`",
            Self::Scatter => "make scattered light from a scene and its tree with `lvox scatter`",
            Self::Packed => "make a packed scene from a scene with `lvox pack`",
        }
    }

    /// The kind of the file at a path, by its first bytes.
    ///
    /// # Errors
    /// A file that cannot be read, or of another format.
    pub fn of_file(path: &Path) -> Result<Self> {
        let mut start = Vec::new();
        let file = File::open(path).map_err(FormatError::io("open"))?;
        let read = file.take(HEADER_LEN as u64).read_to_end(&mut start);
        read.map_err(FormatError::io("read"))?;
        Self::of(&start)
    }

    /// Kinds of its blocks.
    fn blocks(self) -> &'static [BlockKind] {
        match self {
            Self::Cloud | Self::Tree => &[BlockKind::Surfels, BlockKind::Lvoxels],
            Self::Scatter => &[BlockKind::Direct, BlockKind::Indirect],
            Self::Packed => &[
                BlockKind::Padding,
                BlockKind::Column,
                BlockKind::MediaTable,
                BlockKind::MediaPage,
            ],
        }
    }

    /// The kind that the first bytes of a file state; nothing else of it is checked.
    ///
    /// # Errors
    /// [`FormatError::NotOurs`], [`FormatError::Truncated`], or [`FormatError::Invalid`] for an
    /// unknown kind.
    pub fn of(data: &[u8]) -> Result<Self> {
        check_magic(data, None)?;
        let Some(code) = data.get(8..12) else {
            return Err(truncated(HEADER_LEN as u64, data));
        };
        Self::ALL
            .into_iter()
            .find(|kind| kind.code() == code)
            .ok_or_else(|| {
                FormatError::invalid(
                    "kind of file",
                    "LVC, LVT, LVS or LVP",
                    format!("'{}'", code.escape_ascii()),
                )
            })
    }
}

/// The content of a block.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BlockKind {
    /// A chunk of surfels in a cloud, a page of surfels and nodes in a tree.
    Surfels,
    /// A chunk or page of lvoxels.
    Lvoxels,
    /// Direct light at vertices of a volume.
    Direct,
    /// Gathered light at vertices of a volume.
    Indirect,
    /// Zeros before a column of a packed scene.
    Padding,
    /// Rows of a column of a packed scene.
    Column,
    /// The table of the bricks of a level of a volume.
    MediaTable,
    /// Samples of bricks of a volume.
    MediaPage,
}

impl BlockKind {
    /// The number of this kind in the block table.
    fn code(self) -> u32 {
        self as u32 + 1
    }
}

/// An entry of the block table: a chunk of a cloud, a page of a tree, or a part of scattered light
/// or of a packed scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Block {
    /// Bytes from the start of the file.
    pub offset: u64,
    /// Bytes in the file.
    pub stored_bytes: u32,
    /// Bytes once decompressed.
    pub raw_bytes: u32,
    /// Content of the block.
    pub kind: BlockKind,
    /// Number of surfels, lvoxels, vertices, rows or bricks.
    pub records: u32,
    /// Number of nodes, in a tree; in a packed scene, of which image, texture or volume it is.
    pub nodes: u32,
    /// Which columns are present, one bit each; in a packed scene, the number of the column.
    pub columns: u32,
    /// xxh3-64 of the stored bytes; in a cloud, of the column directory.
    pub checksum: u64,
}

impl Block {
    fn encode(&self, out: &mut Vec<u8>) {
        out.extend(self.offset.to_le_bytes());
        for value in [
            self.stored_bytes,
            self.raw_bytes,
            self.kind.code(),
            self.records,
            self.nodes,
            self.columns,
        ] {
            out.extend(value.to_le_bytes());
        }
        out.extend(self.checksum.to_le_bytes());
    }

    fn decode(entry: &[u8; ENTRY_LEN], kinds: &[BlockKind]) -> Result<Self> {
        let u32_at = |at: usize| u32::from_le_bytes(std::array::from_fn(|i| entry[at + i]));
        let u64_at = |at: usize| u64::from_le_bytes(std::array::from_fn(|i| entry[at + i]));
        let code = u32_at(16);
        let kind = kinds.iter().find(|k| k.code() == code).ok_or_else(|| {
            let codes: Vec<_> = kinds.iter().map(|k| k.code().to_string()).collect();
            FormatError::invalid("kind of a block", codes.join(" or "), code)
        })?;
        Ok(Self {
            offset: u64_at(0),
            stored_bytes: u32_at(8),
            raw_bytes: u32_at(12),
            kind: *kind,
            records: u32_at(20),
            nodes: u32_at(24),
            columns: u32_at(28),
            checksum: u64_at(32),
        })
    }
}

/// The checked frame of a file. Ranges are inside the file.
pub struct Frame {
    pub version: u32,
    pub blocks: Vec<Block>,
    pub meta: Range<usize>,
    pub summary: Range<usize>,
    pub content_hash: [u8; 16],
}

/// An entry of the header.
struct Section {
    offset: u64,
    len: u64,
    checksum: u64,
}

fn truncated(expected: u64, data: &[u8]) -> FormatError {
    FormatError::Truncated {
        expected,
        found: data.len() as u64,
    }
}

fn check_magic(data: &[u8], wanted: Option<FileKind>) -> Result<()> {
    let head = &data[..data.len().min(MAGIC.len())];
    if head != &MAGIC[..head.len()] || head.is_empty() {
        return Err(FormatError::NotOurs {
            expected: MAGIC,
            found: head.into(),
            wanted,
        });
    }
    if head.len() < MAGIC.len() {
        return Err(truncated(HEADER_LEN as u64, data));
    }
    Ok(())
}

/// The header's numbers. Nothing but its own checksum and the length of the file is checked.
struct Header {
    version: u32,
    /// Metadata, summary and block table.
    sections: [Section; 3],
}

impl Header {
    fn read(data: &[u8], kind: FileKind) -> Result<Self> {
        check_magic(data, Some(kind))?;
        // The version comes before all else: another version may differ in everything that follows.
        let mut cursor = Cursor::new(&data[MAGIC.len()..], "header");
        let short = |_| truncated(HEADER_LEN as u64, data);
        let code = cursor.take(4).map_err(short)?;
        let version = cursor.u32().map_err(short)?;
        if version != VERSION {
            return Err(FormatError::Version {
                found: version,
                supported: VERSION,
            });
        }
        if data.len() < HEADER_LEN {
            return Err(truncated(HEADER_LEN as u64, data));
        }
        let file_len = cursor.u64()?;
        if file_len != data.len() as u64 {
            return Err(truncated(file_len, data));
        }
        let mut section = || {
            Ok::<_, FormatError>(Section {
                offset: cursor.u64()?,
                len: cursor.u64()?,
                checksum: cursor.u64()?,
            })
        };
        let sections = [section()?, section()?, section()?];
        let checksum = cursor.u64()?;
        bytes::check(&data[..HEADER_LEN - 8], checksum, || "the header".into())?;
        if code != kind.code() {
            return Err(FormatError::WrongKind {
                expected: kind.name().into(),
                found: FileKind::of(data)?.name().into(),
            });
        }
        Ok(Self { version, sections })
    }

    /// Where the sections are: they end the file, one after the other. Their checksums are checked.
    fn ranges(&self, data: &[u8]) -> Result<[Range<usize>; 3]> {
        let file_len = data.len() as u64;
        let names = ["metadata", "summary", "block table"];
        let mut end = self.sections[0].offset;
        let mut ranges = [0..0, 0..0, 0..0];
        for ((range, section), name) in ranges.iter_mut().zip(&self.sections).zip(names) {
            if section.offset != end {
                return Err(FormatError::invalid(
                    format!("offset of the {name}"),
                    end.to_string(),
                    section.offset,
                ));
            }
            end = end
                .checked_add(section.len)
                .filter(|end| *end <= file_len)
                .ok_or_else(|| {
                    FormatError::invalid(
                        format!("length of the {name}"),
                        format!("at most {}", file_len.saturating_sub(section.offset)),
                        section.len,
                    )
                })?;
            // Both fit in usize: they are at most the length of the slice.
            *range = section.offset as usize..end as usize;
            bytes::check(&data[range.clone()], section.checksum, || {
                format!("the {name}")
            })?;
        }
        if end != file_len {
            return Err(FormatError::invalid(
                "end of the block table",
                file_len.to_string(),
                end,
            ));
        }
        Ok(ranges)
    }
}

impl Frame {
    /// Reads and checks header, block table and the checksums of both small sections.
    pub fn read(data: &[u8], kind: FileKind) -> Result<Self> {
        let header = Header::read(data, kind)?;
        let [meta, summary, table] = header.ranges(data)?;
        for (range, name) in [(&meta, "metadata"), (&summary, "summary")] {
            if range.len() > codec::MAX_SECTION_BYTES {
                return Err(FormatError::invalid(
                    format!("length of the {name}"),
                    format!("at most {}", codec::MAX_SECTION_BYTES),
                    range.len(),
                ));
            }
        }
        Ok(Self {
            blocks: read_table(&data[table], meta.start as u64, kind.blocks())?,
            meta,
            summary,
            content_hash: content_hash(&data[..HEADER_LEN]),
            version: header.version,
        })
    }
}

/// Blocks must lie one after the other from the header to the metadata.
fn read_table(table: &[u8], blocks_end: u64, kinds: &[BlockKind]) -> Result<Vec<Block>> {
    let (entries, rest) = table.as_chunks::<ENTRY_LEN>();
    let mut blocks = Vec::with_capacity(entries.len());
    let mut end = HEADER_LEN as u64;
    for (i, entry) in entries.iter().enumerate() {
        let block = Block::decode(entry, kinds)?;
        if block.offset != end {
            return Err(FormatError::invalid(
                format!("offset of block {i}"),
                end.to_string(),
                block.offset,
            ));
        }
        end += u64::from(block.stored_bytes);
        blocks.push(block);
    }
    Cursor::new(rest, "block table").end()?;
    if end != blocks_end {
        return Err(FormatError::invalid(
            "end of the last block",
            blocks_end.to_string(),
            end,
        ));
    }
    Ok(blocks)
}

/// The header holds the length and the checksums of all that the blocks' checksums do not cover,
/// and those of the table, which holds the blocks' own: two files with the same header have the
/// same content.
fn content_hash(header: &[u8]) -> [u8; 16] {
    xxh3_128(header).to_le_bytes()
}

/// The block table as it is in the file.
pub fn encode_table(blocks: &[Block]) -> Vec<u8> {
    let mut table = Vec::with_capacity(blocks.len() * ENTRY_LEN);
    for block in blocks {
        block.encode(&mut table);
    }
    table
}

/// The header of a file whose blocks end at `blocks_end`, where the sections follow.
pub fn header(kind: FileKind, blocks_end: u64, sections: [&[u8]; 3]) -> Vec<u8> {
    let mut header = Vec::with_capacity(HEADER_LEN);
    header.extend(MAGIC);
    header.extend(kind.code());
    header.extend(VERSION.to_le_bytes());
    let len = blocks_end + sections.iter().map(|s| s.len() as u64).sum::<u64>();
    header.extend(len.to_le_bytes());
    let mut offset = blocks_end;
    for section in sections {
        header.extend(offset.to_le_bytes());
        header.extend((section.len() as u64).to_le_bytes());
        header.extend(xxh3_64(section).to_le_bytes());
        offset += section.len() as u64;
    }
    header.extend(xxh3_64(&header).to_le_bytes());
    debug_assert_eq!(header.len(), HEADER_LEN);
    header
}

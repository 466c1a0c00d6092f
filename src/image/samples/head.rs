//! The head of a file of samples: which pixels it has samples of, and what they were made from.

use crate::image::Region;
use std::collections::{BTreeMap, BTreeSet};
use std::io::{self, ErrorKind, Read};

const MAGIC: [u8; 8] = *b"\x89lvs\r\n\x1a\n";
/// Version of the format of files of samples.
pub const VERSION: u32 = 1;
/// Numbers in a head: version, strands, four of the region, length of the origin.
const NUMBERS: usize = 7;
/// Bytes of an origin that are read, at most.
const MAX_ORIGIN_BYTES: u32 = 1 << 16;

/// The origin of samples: what they were made from.
#[derive(Clone, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Origin {
    /// Digest of the path tracer's sources.
    pub code: String,
    /// Digest of the scene's files.
    pub scene: String,
    /// Pixels across and down of the frame.
    pub film: [u32; 2],
    /// Settings by name, as JSON.
    pub settings: BTreeMap<String, serde_json::Value>,
}

impl Origin {
    /// The settings as a JSON object.
    #[must_use]
    pub fn settings_json(&self) -> String {
        serde_json::to_string(&self.settings).unwrap_or_default()
    }

    /// Tells in words where an origin differs from that of samples to be made here.
    #[must_use]
    pub fn differences(&self, here: &Self) -> Vec<String> {
        let mut found = Vec::new();
        if self.scene != here.scene {
            found.push("another scene".to_owned());
        }
        if self.film != here.film {
            let size = |[w, h]: [u32; 2]| format!("{w}x{h}");
            let (there, here) = (size(self.film), size(here.film));
            found.push(format!("another frame ({there} pixels, here {here})"));
        }
        let names: BTreeSet<&String> = self.settings.keys().chain(here.settings.keys()).collect();
        for name in names {
            let (there, here) = (self.settings.get(name), here.settings.get(name));
            if there != here {
                let shown = |v: Option<&serde_json::Value>| {
                    v.map_or_else(|| "absent".to_owned(), ToString::to_string)
                };
                let (there, here) = (shown(there), shown(here));
                found.push(format!("another setting ({name} {there}, here {here})"));
            }
        }
        if self.code != here.code {
            found.push("a build whose path tracer has other sources".to_owned());
        }
        found
    }
}

/// The head of a file of samples.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Head {
    /// Independent sequences in each pixel.
    pub strands: u32,
    /// The part of the frame whose pixels have samples.
    pub region: Region,
    /// What the samples were made from.
    pub origin: Origin,
}

/// Why a file of samples cannot be read. The texts follow a file's name.
#[derive(Debug, thiserror::Error)]
pub enum Unreadable {
    /// Another kind of file.
    #[error("is no file of samples")]
    Foreign,
    /// Of another version of the format.
    #[error("is of version {0} of such files, not {VERSION}")]
    Version(u32),
    /// The file ends in its head.
    #[error("is cut")]
    Cut,
    /// The head holds what none would.
    #[error("is damaged: its header cannot be read")]
    Damaged,
    /// Not as long as the head says.
    #[error("is cut or damaged: its length is wrong")]
    Length,
    /// A sum that samples cannot have.
    #[error("is damaged: a sum of row {0} is infinite or not a number")]
    Sum(u32),
    /// Altered since it was written.
    #[error("is damaged: its checksum is wrong")]
    Checksum,
    /// The operating system failed.
    #[error(transparent)]
    Io(io::Error),
}

impl From<io::Error> for Unreadable {
    fn from(error: io::Error) -> Self {
        match error.kind() {
            ErrorKind::UnexpectedEof => Self::Cut,
            _ => Self::Io(error),
        }
    }
}

impl Head {
    /// Encodes the head as it stands in a file.
    #[must_use]
    pub fn bytes(&self) -> Vec<u8> {
        let origin = serde_json::to_vec(&self.origin).unwrap_or_default();
        let length = u32::try_from(origin.len()).unwrap_or(u32::MAX);
        let r = &self.region;
        let numbers = [VERSION, self.strands, r.x0, r.y0, r.x1, r.y1, length];
        let mut bytes = MAGIC.to_vec();
        bytes.extend(numbers.into_iter().flat_map(u32::to_le_bytes));
        bytes.extend(origin);
        bytes
    }

    /// Reads a head, and leaves the reader behind it.
    ///
    /// # Errors
    /// Says what is wrong with the file.
    pub fn read(from: &mut impl Read) -> Result<Self, Unreadable> {
        let mut magic = Vec::new();
        (&mut *from)
            .take(MAGIC.len() as u64)
            .read_to_end(&mut magic)?;
        if magic != MAGIC {
            return Err(Unreadable::Foreign);
        }
        let mut numbers = [0; NUMBERS];
        for n in &mut numbers {
            let mut bytes = [0; 4];
            from.read_exact(&mut bytes)?;
            *n = u32::from_le_bytes(bytes);
        }
        let [version, strands, x0, y0, x1, y1, length] = numbers;
        if version != VERSION {
            return Err(Unreadable::Version(version));
        }
        if strands == 0 || length > MAX_ORIGIN_BYTES || x0 > x1 || y0 > y1 {
            return Err(Unreadable::Damaged);
        }
        let mut origin = vec![0; length as usize];
        from.read_exact(&mut origin)?;
        let origin: Origin = serde_json::from_slice(&origin).map_err(|_| Unreadable::Damaged)?;
        let [width, height] = origin.film;
        if x1 > width || y1 > height {
            return Err(Unreadable::Damaged);
        }
        Ok(Self {
            strands,
            region: Region { x0, y0, x1, y1 },
            origin,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn head() -> Head {
        Head {
            strands: 4,
            region: Region {
                x0: 3,
                y0: 5,
                x1: 7,
                y1: 8,
            },
            origin: Origin {
                code: "c".into(),
                scene: "s".into(),
                film: [20, 10],
                settings: [("max_depth".to_owned(), 3.into())].into(),
            },
        }
    }

    /// Of the file with one number of its head changed, counted from the magic.
    fn with(number: usize, value: u32) -> Result<Head, Unreadable> {
        let mut bytes = head().bytes();
        let at = MAGIC.len() + 4 * number;
        bytes[at..at + 4].copy_from_slice(&value.to_le_bytes());
        Head::read(&mut bytes.as_slice())
    }

    #[test]
    fn heads_survive_a_round_trip() {
        let mut file = head().bytes();
        file.extend(b"rest");
        let mut reader = file.as_slice();
        assert_eq!(Head::read(&mut reader).unwrap(), head());
        assert_eq!(reader, b"rest");
    }

    #[test]
    fn what_is_wrong_is_told() {
        let whole = head().bytes();
        for length in 0..whole.len() {
            let found = Head::read(&mut &whole[..length]).unwrap_err();
            match found {
                Unreadable::Foreign => assert!(length < MAGIC.len(), "{length}"),
                Unreadable::Cut => assert!(length >= MAGIC.len(), "{length}"),
                other => panic!("{length}: {other}"),
            }
        }
        assert!(matches!(with(0, 2), Err(Unreadable::Version(2))));
        // No strands; the region's right before its left, its bottom above its top, or either
        // outside of the film; origins longer than any, and one that ends too soon.
        let region = [(4, 2), (5, 4), (4, 21), (5, 11)];
        for (number, value) in [(1, 0), (6, u32::MAX), (6, 1)].into_iter().chain(region) {
            let found = with(number, value);
            assert!(matches!(found, Err(Unreadable::Damaged)), "{found:?}");
        }
    }
}

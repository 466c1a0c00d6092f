//! The samples that `lvox reference` keeps beside its image: what they are of and how many there are. The layout is that of
//! `reference::Sums::write`.

use crate::{Error, Result};
use serde_json::Value;
use std::collections::BTreeMap;
use std::fmt;
use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::Path;

const MAGIC: [u8; 8] = *b"\x89lvs\r\n\x1a\n";
const VERSION: u32 = 2;
/// Magic and seven numbers, the length of the origin last.
const FIXED: u64 = 8 + 7 * 4;
const LONGEST_ORIGIN: u32 = 1 << 16;
const CHECKSUM: u64 = 32;

/// What a file of samples says of itself.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Samples {
    /// As given.
    pub file: String,
    /// `samples`.
    pub kind: &'static str,
    /// Of the format.
    pub version: u32,
    /// Length of the file.
    pub bytes: u64,
    /// Pixels across of the frame.
    pub width: u32,
    /// Pixels down of the frame.
    pub height: u32,
    /// The part of the frame that has samples: left, top, right and bottom, the last two excluded.
    pub region: [u32; 4],
    /// Independent sequences in each pixel.
    pub strands: u32,
    /// Fewest samples of a pixel.
    pub spp_min: u32,
    /// Most samples of a pixel.
    pub spp_max: u32,
    /// Identity of the scene.
    pub scene_hash: String,
    /// Digest of the path tracer's sources.
    pub path_tracer: String,
    /// What they were made with.
    pub settings: BTreeMap<String, Value>,
}

#[derive(serde::Deserialize)]
struct Origin {
    code: String,
    scene: String,
    film: [u32; 2],
    settings: BTreeMap<String, Value>,
}

/// Reads the header and the counts of a file of samples; `None` if it is another kind of file. The checksum is not looked at.
///
/// # Errors
/// [`crate::Kind::Input`] if the file cannot be read, is of another version, or is damaged or cut.
pub fn samples(path: &Path) -> Result<Option<Samples>> {
    let failed = |e: &std::io::Error| match e.kind() {
        std::io::ErrorKind::UnexpectedEof => refused(path, "is cut"),
        _ => Error::io("read", path, e),
    };
    let mut file = BufReader::new(File::open(path).map_err(|e| failed(&e))?);
    let mut magic = Vec::new();
    (&mut file)
        .take(8)
        .read_to_end(&mut magic)
        .map_err(|e| failed(&e))?;
    if magic != MAGIC {
        return Ok(None);
    }
    let mut number = || -> std::io::Result<u32> {
        let mut bytes = [0; 4];
        file.read_exact(&mut bytes)?;
        Ok(u32::from_le_bytes(bytes))
    };
    let mut numbers = [0; 7];
    for n in &mut numbers {
        *n = number().map_err(|e| failed(&e))?;
    }
    let [version, strands, x0, y0, x1, y1, length] = numbers;
    if version != VERSION {
        let what = format!("is of version {version} of such files, not {VERSION}");
        return Err(refused(path, &what));
    }
    let damaged = || refused(path, "is damaged: its header cannot be read");
    if length > LONGEST_ORIGIN {
        return Err(damaged());
    }
    let mut origin = vec![0; length as usize];
    file.read_exact(&mut origin).map_err(|e| failed(&e))?;
    let origin: Origin = serde_json::from_slice(&origin).map_err(|_| damaged())?;

    let width = u64::from(x1.checked_sub(x0).ok_or_else(damaged)?);
    let height = y1.checked_sub(y0).ok_or_else(damaged)?;
    // A pixel has three sums of eight bytes a strand.
    let pixels = width
        .checked_mul(u64::from(strands))
        .and_then(|n| n.checked_mul(24));
    let row = pixels
        .and_then(|n| i64::try_from(n).ok())
        .ok_or_else(damaged)?;
    let bytes = file.get_ref().metadata().map_err(|e| failed(&e))?.len();
    let expected = u64::from(height)
        .checked_mul(row as u64 + 4)
        .and_then(|rows| rows.checked_add(FIXED + u64::from(length) + CHECKSUM));
    if expected != Some(bytes) {
        return Err(refused(path, "is cut or damaged: its length is wrong"));
    }
    let (mut least, mut most) = (u32::MAX, 0);
    for _ in 0..height {
        let mut count = [0; 4];
        file.read_exact(&mut count).map_err(|e| failed(&e))?;
        let count = u32::from_le_bytes(count);
        (least, most) = (least.min(count), most.max(count));
        file.seek(SeekFrom::Current(row)).map_err(|e| failed(&e))?;
    }
    Ok(Some(Samples {
        file: path.to_string_lossy().into_owned(),
        kind: "samples",
        version,
        bytes,
        width: origin.film[0],
        height: origin.film[1],
        region: [x0, y0, x1, y1],
        strands,
        spp_min: least.min(most),
        spp_max: most,
        scene_hash: origin.scene,
        path_tracer: origin.code,
        settings: origin.settings,
    }))
}

fn refused(path: &Path, what: &str) -> Error {
    Error::input(format!("{} {what}", path.display()))
}

impl fmt::Display for Samples {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut row = |name: &str, value: String| writeln!(f, "{name:<15} {value}");
        row("kind", "samples of a reference, to go on from".into())?;
        row("version", self.version.to_string())?;
        row("frame", format!("{} x {}", self.width, self.height))?;
        let [x0, y0, x1, y1] = self.region;
        row("region", format!("{x0} {y0} to {x1} {y1}"))?;
        let (least, most) = (self.spp_min, self.spp_max);
        let spp = if least == most {
            most.to_string()
        } else {
            format!("{least} to {most}")
        };
        row("spp", format!("{spp}, in {} strands", self.strands))?;
        row("bytes", super::text::count(self.bytes))?;
        row("scene hash", self.scene_hash.clone())?;
        row("path tracer", self.path_tracer.clone())?;
        for (name, value) in self.settings.iter().filter(|(n, _)| *n != "strands") {
            row(name, value.to_string())?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::Region;
    use crate::reference::{Origin, Sums};

    #[test]
    fn what_is_kept_is_described_and_what_is_damaged_refused() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.exr.sums");
        let region = Region {
            x0: 3,
            y0: 5,
            x1: 7,
            y1: 8,
        };
        let origin = Origin {
            code: "c".into(),
            scene: "5ce".into(),
            film: [20, 10],
            settings: [("max_depth".to_owned(), 3.into())].into(),
        };
        let mut sums = Sums::new(region, 4, origin);
        for (row, count) in sums.rows.iter_mut().zip([7, 9, 8]) {
            row.count = count;
            row.sums.fill([1e30, 0.1, -1.0]);
        }
        sums.write(&path).unwrap();
        let found = samples(&path).unwrap().unwrap();
        assert_eq!((found.width, found.height, found.strands), (20, 10, 4));
        assert_eq!((found.spp_min, found.spp_max), (7, 9));
        assert_eq!(found.region, [3, 5, 7, 8]);
        assert_eq!(
            (found.scene_hash.as_str(), &found.settings["max_depth"]),
            ("5ce", &3.into())
        );
        let text = found.to_string();
        for part in ["20 x 10", "7 to 9, in 4 strands", "5ce", "max_depth"] {
            assert!(text.contains(part), "{part}: {text}");
        }
        let whole = std::fs::read(&path).unwrap();
        for length in (8..whole.len()).step_by(11) {
            std::fs::write(&path, &whole[..length]).unwrap();
            assert!(samples(&path).is_err(), "{length}");
        }
        // The header may claim anything.
        for at in 8..36 {
            let mut bytes = whole.clone();
            bytes[at] ^= 0x80;
            std::fs::write(&path, &bytes).unwrap();
            assert!(samples(&path).is_err(), "{at}");
        }
        std::fs::write(&path, &whole[1..]).unwrap();
        assert_eq!(samples(&path).unwrap(), None);
    }
}

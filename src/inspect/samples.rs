//! The samples that `lvox reference` keeps beside its image: what they are of and how many there
//! are.

use crate::image::samples::{Rows, Unreadable, VERSION, count_range};
use crate::{Error, Result};
use serde_json::Value;
use std::collections::BTreeMap;
use std::fmt;
use std::fs::File;
use std::io::BufReader;
use std::path::Path;

/// Description of a file of samples.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Samples {
    /// Path of the file, as given.
    pub file: String,
    /// `samples`.
    pub kind: &'static str,
    /// Version of the format that the file has.
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
    /// Samples of all pixels that were infinite or not a number, and count as black.
    pub not_finite: u64,
    /// Identity of the scene.
    pub scene_hash: String,
    /// Digest of the path tracer's sources.
    pub path_tracer: String,
    /// Settings that the samples were made with.
    pub settings: BTreeMap<String, Value>,
}

/// Reads all of a file of samples, and checks it; `None` if it is another kind of file.
///
/// # Errors
/// [`crate::Kind::Input`] if the file cannot be read, is of another version, or is damaged or cut.
pub fn samples(path: &Path) -> Result<Option<Samples>> {
    let failed = |e: Unreadable| match e {
        Unreadable::Io(e) => Error::io("read", path, &e),
        other => Error::input(format!("{} {other}", path.display()))
            .hint("copy the file again (in binary mode), or make it again"),
    };
    let io_failed = |e: std::io::Error| failed(e.into());
    let file = File::open(path).map_err(io_failed)?;
    let bytes = file.metadata().map_err(io_failed)?.len();
    let mut rows = match Rows::open(BufReader::new(file), bytes) {
        Err(Unreadable::Foreign) => return Ok(None),
        other => other.map_err(failed)?,
    };
    let mut found = Vec::new();
    let mut not_finite = 0_u64;
    while let Some(row) = rows.next_row().map_err(failed)? {
        found.push(row.count);
        not_finite = not_finite.saturating_add(row.not_finite);
    }
    let (least, most) = count_range(found.into_iter());
    let head = rows.head().clone();
    rows.finish().map_err(failed)?;
    let region = head.region;
    Ok(Some(Samples {
        file: path.to_string_lossy().into_owned(),
        kind: "samples",
        version: VERSION,
        bytes,
        width: head.origin.film[0],
        height: head.origin.film[1],
        region: [region.x0, region.y0, region.x1, region.y1],
        strands: head.strands,
        spp_min: least,
        spp_max: most,
        not_finite,
        scene_hash: head.origin.scene,
        path_tracer: head.origin.code,
        settings: head.origin.settings,
    }))
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
        if self.not_finite > 0 {
            row("not finite", super::text::count(self.not_finite))?;
        }
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
    use crate::image::samples::Origin;
    use crate::lab::reference::Sums;

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
        // The header may claim anything, and sums are checked too.
        for at in (8..36).chain([whole.len() - 40, whole.len() - 1]) {
            let mut bytes = whole.clone();
            bytes[at] ^= 0x80;
            std::fs::write(&path, &bytes).unwrap();
            assert!(samples(&path).is_err(), "{at}");
        }
        std::fs::write(&path, &whole[1..]).unwrap();
        assert_eq!(samples(&path).unwrap(), None);
    }
}

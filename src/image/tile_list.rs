//! Tiles of a frame as a file lists them: a line `--region X0 Y0 X1 Y1` for each.

use super::coverage;
use super::region::Region;
use crate::run::one_line;
use crate::{Error, Result};
use std::fmt::Write as _;
use std::fs::File;
use std::io::Read;
use std::path::Path;

/// Characters of a line, at most.
const LINE: u64 = 64;

/// The lines of a list of tiles.
#[must_use]
pub fn to_lines(tiles: &[Region]) -> String {
    let mut lines = String::new();
    for tile in tiles {
        // A string takes all that is written to it.
        let _ = writeln!(lines, "--region {tile}");
    }
    lines
}

/// Reads tile `index` (from 0) of a list of `count` tiles of a film.
///
/// # Errors
/// [`crate::Kind::Input`] if the file cannot be read, has a line that is no tile, has another
/// number of lines, or tiles that do not cover the film exactly once.
pub fn read_one(path: &Path, film: [u32; 2], index: u32, count: u32) -> Result<Region> {
    let text = read(path, count)?;
    one_of(&text, film, index, count).map_err(|e| e.at(path.display()))
}

/// The text of a file, or as much of it as so many lines and one more may have.
fn read(path: &Path, count: u32) -> Result<String> {
    let file = File::open(path).map_err(|e| Error::io("read", path, &e))?;
    let mut bytes = Vec::new();
    let most = (u64::from(count) + 1) * LINE;
    (file.take(most).read_to_end(&mut bytes)).map_err(|e| Error::io("read", path, &e))?;
    Ok(String::from_utf8_lossy(&bytes).into_owned())
}

fn one_of(text: &str, [width, height]: [u32; 2], index: u32, count: u32) -> Result<Region> {
    let mut tiles = Vec::new();
    for (i, line) in text.lines().enumerate() {
        let tile = of_line(line).ok_or_else(|| {
            let start: String = line.chars().take(LINE as usize).collect();
            Error::input(format!(
                "line {}: expected `--region X0 Y0 X1 Y1`, found {:?}",
                i + 1,
                one_line(start)
            ))
            .hint(MAKE_ONE)
        })?;
        (tile.check(width, height)).map_err(|e| e.at(format_args!("line {}", i + 1)))?;
        tiles.push(tile);
    }
    if tiles.len() != count as usize {
        let found = match tiles.len() {
            n if n > count as usize => "more".into(),
            n => n.to_string(),
        };
        return Err(Error::input(format!(
            "expected a line for each of {count} tiles, found {found}"
        ))
        .hint("N of `tile` I/N is the number of lines"));
    }
    let found = coverage::faults(width, height, &tiles);
    let fault = match (found.overlaps.first(), found.missing.first()) {
        (Some((a, b)), _) => format!("the tiles of lines {} and {} overlap", a + 1, b + 1),
        (None, Some(gap)) => format!("no tile has the pixels {gap} of {width}x{height}"),
        (None, None) => {
            let tile = tiles.get(index as usize).copied();
            return tile
                .ok_or_else(|| Error::input(format!("there is no tile {index} of {count}")));
        }
    };
    Err(Error::input(fault).hint(MAKE_ONE))
}

const MAKE_ONE: &str = "make a list for this frame: `lvox tiles`";

fn of_line(line: &str) -> Option<Region> {
    let mut words = line.split_ascii_whitespace();
    if words.next() != Some("--region") {
        return None;
    }
    let mut next = || words.next()?.parse().ok();
    let [x0, y0, x1, y1] = [next()?, next()?, next()?, next()?];
    words.next().is_none().then_some(Region { x0, y0, x1, y1 })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_are_read_as_they_are_written() {
        let tiles: Vec<_> = (0..7)
            .map(|i| Region::tile(30, 20, i, 7).unwrap())
            .collect();
        let text = to_lines(&tiles);
        assert_eq!(text.lines().count(), 7);
        for (i, tile) in (0..).zip(&tiles) {
            assert_eq!(one_of(&text, [30, 20], i, 7).unwrap(), *tile);
        }
        one_of(text.trim_end(), [30, 20], 0, 7).unwrap();
        one_of(&text.replace('\n', "\r\n"), [30, 20], 0, 7).unwrap();
    }

    #[test]
    fn lists_that_are_no_tiling_are_refused_with_the_line() {
        let half = "--region 0 0 15 20\n";
        let other = "--region 15 0 30 20\n";
        for (text, part) in [
            ("", "found 0"),
            (half, "found 1"),
            (&format!("{half}{other}{other}"), "found more"),
            (&format!("{half}{half}"), "lines 1 and 2 overlap"),
            (
                &format!("{half}--region 16 0 30 20"),
                "no tile has the pixels 15 0 16 20",
            ),
            (&format!("{half}--region 15 0 31 20"), "line 2: "),
            (&format!("{half}--region 15 0 15 20"), "line 2: "),
            (
                &format!("{half}\n"),
                "line 2: expected `--region X0 Y0 X1 Y1`, found \"\"",
            ),
            (&format!("{half}--tile 1/2"), "line 2: "),
            (&format!("{half}--region 15 0 30 -20"), "line 2: "),
            (&format!("{half}--region 15 0 30 20 1"), "line 2: "),
            (&format!("{half}--region 15 0 30"), "line 2: "),
        ] {
            let error = one_of(text, [30, 20], 1, 2).unwrap_err();
            assert_eq!(error.kind(), crate::Kind::Input);
            assert!(error.to_string().contains(part), "{error} for {text:?}");
        }
    }
}

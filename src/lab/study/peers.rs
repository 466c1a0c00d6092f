//! Points of other renderers beside those of a study: from a table, or by their images.

use super::others::{MAX_PEERS, is_positive};
use super::record::{Errors, Peer};
use crate::{Error, Result};
use std::path::Path;

/// Bytes of the largest table.
const MAX_BYTES: u64 = 16 << 20;
/// Reads a table with a line for each point, and a header that names `name`, `seconds` and
/// `relmse`; `flip` and `pdiff` may be there, and what else is left out.
///
/// # Errors
/// [`crate::Kind::Input`] with the line of what is missing or no number.
pub fn read(path: &Path) -> Result<Vec<Peer>> {
    let is_small = |m: std::fs::Metadata| m.len() <= MAX_BYTES;
    if std::fs::metadata(path).is_ok_and(|m| !is_small(m)) {
        let what = format!("expected a table of at most {MAX_BYTES} bytes");
        return Err(Error::input(what).at(path.display()));
    }
    let text = std::fs::read(path).map_err(|e| Error::io("read", path, &e))?;
    let text = String::from_utf8(text)
        .map_err(|_| Error::input("expected a table of text, found other bytes"));
    let name = path.file_name().unwrap_or(path.as_os_str());
    let rows = text.and_then(|text| parse(&text, &name.to_string_lossy()));
    rows.map_err(|e| e.at(path.display()))
}

fn parse(text: &str, source: &str) -> Result<Vec<Peer>> {
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    let lines = (1..)
        .zip(text.lines())
        .filter(|(_, line)| !line.trim().is_empty());
    let mut rows = lines.map(|(number, line)| (number, fields(line)));
    let (_, head) = rows
        .next()
        .ok_or_else(|| Error::input("expected a header and rows, found nothing"))?;
    let head: Vec<String> = head.iter().map(|h| h.to_ascii_lowercase()).collect();
    let place = |name: &str| head.iter().position(|h| h == name);
    let needed = |name: &str| {
        place(name).ok_or_else(|| {
            Error::input(format!(
                "line 1: expected the columns name, seconds and relmse, found no `{name}`"
            ))
            .hint(format!("it has {}", head.join(", ")))
        })
    };
    let [named, secs, relmse] = [needed("name")?, needed("seconds")?, needed("relmse")?];
    let mut peers = Vec::new();
    for (number, row) in rows {
        let wrong = |what: String| Error::input(format!("line {number}: {what}"));
        let value = |column: usize| row.get(column).map_or("", String::as_str);
        let number_in = |column: usize| {
            let found = value(column).parse().ok().filter(|v| is_positive(*v));
            found.ok_or_else(|| {
                wrong(format!(
                    "expected a number above 0 as {}, found `{}`",
                    head[column],
                    value(column)
                ))
            })
        };
        let may_be = |name: &str| match place(name).filter(|&i| !value(i).is_empty()) {
            None => Ok(None),
            Some(i) => number_in(i).map(Some),
        };
        if value(named).is_empty() {
            return Err(wrong("expected a name, found none".into()));
        }
        if peers.len() == MAX_PEERS {
            return Err(wrong(format!("expected at most {MAX_PEERS} rows")));
        }
        peers.push(Peer {
            name: value(named).into(),
            cpu_secs: number_in(secs)?,
            errors: Errors {
                relmse: Some(number_in(relmse)?),
                flip: may_be("flip")?,
                pdiff: may_be("pdiff")?,
                ..Errors::default()
            },
            source: source.into(),
        });
    }
    match peers.is_empty() {
        true => Err(Error::input(
            "expected a row for each point, found a header alone",
        )),
        false => Ok(peers),
    }
}

/// The cells of a line: between commas, those with commas inside in quotes.
fn fields(line: &str) -> Vec<String> {
    let mut cells = vec![String::new()];
    let mut is_quoted = false;
    let mut letters = line.chars().peekable();
    while let Some(letter) = letters.next() {
        let last = cells.len() - 1;
        match letter {
            '"' if is_quoted && letters.next_if_eq(&'"').is_some() => cells[last].push('"'),
            '"' => is_quoted = !is_quoted,
            ',' if !is_quoted => cells.push(String::new()),
            letter => cells[last].push(letter),
        }
    }
    cells
        .into_iter()
        .map(|cell| cell.trim().to_owned())
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tables_have_names_seconds_and_errors() {
        let text = "\u{feff}name, spp,Seconds,relmse,flip\r\n\"pt, 2 \"\"fast\"\"\",4,1.5,2e-3,\n\n\
                    b,16,6,5e-4,.1\n";
        let peers = parse(text, "t.csv").unwrap();
        let of = |i: usize| {
            let peer: &Peer = &peers[i];
            (
                peer.name.as_str(),
                peer.cpu_secs,
                peer.errors.relmse,
                peer.errors.flip,
            )
        };
        assert_eq!(of(0), ("pt, 2 \"fast\"", 1.5, Some(2e-3), None));
        assert_eq!(of(1), ("b", 6.0, Some(5e-4), Some(0.1)));
        assert_eq!((peers.len(), peers[0].source.as_str()), (2, "t.csv"));
    }

    #[test]
    fn wrong_tables_say_where() {
        for (text, says) in [
            ("", "found nothing"),
            ("name,seconds,relmse\n", "a header alone"),
            ("name,secs,relmse\na,1,1\n", "found no `seconds`"),
            (
                "name,seconds,relmse\na,1\n",
                "line 2: expected a number above 0 as relmse, found ``",
            ),
            (
                "name,seconds,relmse\na,1,1\n\na,0,1\n",
                "line 4: expected a number above 0 as seconds, found `0`",
            ),
            ("name,seconds,relmse\na,1,nan\n", "found `nan`"),
            ("name,seconds,relmse\n,1,1\n", "line 2: expected a name"),
            ("name,seconds,relmse,flip\na,1,1,x\n", "as flip, found `x`"),
        ] {
            let error = parse(text, "").unwrap_err().to_string();
            assert!(error.contains(says), "{says}: {error}");
        }
    }
}

//! Samples of a NRRD file: lines and bytes skipped, and how they are packed.

use super::super::samples::Number;
use super::super::unpack::{self, Data, Packing};
use super::{Header, Lines};
use crate::run::Cancel;
use crate::{Error, Result};

/// The `expected` bytes of samples of type `number` in a file from `at`.
pub(super) fn data(
    header: &Header,
    content: Vec<u8>,
    at: usize,
    expected: usize,
    number: Number,
    cancel: &Cancel,
) -> Result<Data> {
    let count = |names: &[&str]| -> Result<i64> {
        let Some(text) = header.get(names) else {
            return Ok(0);
        };
        text.parse()
            .map_err(|_| Error::input(format!("expected a number, found `{}: {text}`", names[0])))
    };
    let mut lines = Lines {
        content: &content,
        at,
    };
    for _ in 0..count(&["line skip", "lineskip"])? {
        if lines.next().is_none() {
            return Err(Error::input("`line skip` goes beyond the end of the file"));
        }
    }
    let at = lines.at;
    // -1 means that the samples are at the very end; so does any other negative number.
    let skip = usize::try_from(count(&["byte skip", "byteskip"])?).ok();
    let encoding = header.require("encoding")?.to_lowercase();
    match encoding.as_str() {
        "raw" => {
            let from = skip.map(|skip| at.saturating_add(skip));
            unpack::raw(content, from, at, expected)
        }
        "gzip" | "gz" => Packing::Gzip.unpack(&content[at..], skip, expected, cancel),
        "bzip2" | "bz2" => Packing::Bzip2.unpack(&content[at..], skip, expected, cancel),
        "ascii" | "text" | "txt" => {
            let count = expected / number.size();
            unpack::text(after(&content[at..], skip)?, count, cancel)
        }
        "hex" => unpack::hex(after(&content[at..], skip)?, expected, cancel),
        other => Err(
            Error::input(format!("`encoding: {other}` is not supported"))
                .hint("supported are raw, gzip, bzip2, ascii and hex"),
        ),
    }
}

/// What follows the bytes to skip, of text.
fn after(content: &[u8], skip: Option<usize>) -> Result<&[u8]> {
    let skip = skip.ok_or_else(|| Error::input("`byte skip: -1` says nothing for text"))?;
    content
        .get(skip..)
        .ok_or_else(|| Error::input("`byte skip` goes beyond the end of the file"))
}

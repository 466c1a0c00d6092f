//! The header of NumPy's `.npy`: a table of numbers, row by row.

use super::numbers::Encoding;
use crate::scene::load::ply::header::Scalar;
use crate::{Error, Result};

/// What such a file begins with.
pub(super) const MAGIC: &[u8] = b"\x93NUMPY";

/// What the header of a file says.
#[derive(Debug, PartialEq)]
pub(super) struct Array {
    pub encoding: Encoding,
    pub scalar: Scalar,
    pub rows: u64,
    pub columns: u64,
    /// Where the numbers begin.
    pub start: u64,
}

impl Array {
    /// Reads a header from the start of a file.
    pub(super) fn parse(head: &[u8]) -> Result<Self> {
        let cut = || Error::input("the header is not whole; the file is truncated or damaged");
        let at = MAGIC.len();
        let version = *head.get(at).ok_or_else(cut)?;
        let (length, start) = match version {
            1 => {
                let length = head.get(at + 2..at + 4).ok_or_else(cut)?;
                (usize::from(length[0]) | usize::from(length[1]) << 8, at + 4)
            }
            2 | 3 => {
                let length = head.get(at + 2..at + 6).ok_or_else(cut)?;
                let length = [length[0], length[1], length[2], length[3]];
                (u32::from_le_bytes(length) as usize, at + 6)
            }
            _ => {
                return Err(Error::input(format!(
                    "expected version 1, 2 or 3 of .npy, found {version}"
                )));
            }
        };
        let end = start.checked_add(length).ok_or_else(cut)?;
        let text = head.get(start..end).ok_or_else(cut)?;
        let text = std::str::from_utf8(text)
            .map_err(|_| Error::input("the header is no text; the file is damaged"))?;
        let (encoding, scalar) = Self::numbers(entry(text, "descr")?)?;
        if !entry(text, "fortran_order")?.starts_with("False") {
            return Err(Error::input(
                "expected an array that is stored row by row, found one by columns",
            )
            .hint("store numpy.ascontiguousarray(points)"));
        }
        let (rows, columns) = Self::shape(entry(text, "shape")?)?;
        Ok(Self {
            encoding,
            scalar,
            rows,
            columns,
            start: end as u64,
        })
    }

    fn numbers(text: &str) -> Result<(Encoding, Scalar)> {
        let found = text.trim_start_matches(['\'', '"']);
        for (name, encoding, scalar) in [
            ("<f4", Encoding::LittleEndian, Scalar::F32),
            ("<f8", Encoding::LittleEndian, Scalar::F64),
            (">f4", Encoding::BigEndian, Scalar::F32),
            (">f8", Encoding::BigEndian, Scalar::F64),
        ] {
            let behind = found.strip_prefix(name);
            if behind.is_some_and(|b| b.starts_with(['\'', '"'])) {
                return Ok((encoding, scalar));
            }
        }
        let short: String = text.chars().take(20).collect();
        Err(Error::input(format!(
            "expected numbers of type float32 or float64, found descr {}",
            short.escape_debug()
        ))
        .hint("store points.astype('f4')"))
    }

    fn shape(text: &str) -> Result<(u64, u64)> {
        let inner = text.strip_prefix('(').and_then(|t| t.split_once(')'));
        let inner = inner.map_or("", |(inner, _)| inner);
        let mut sizes = inner.split(',').map(str::trim);
        let mut next = || sizes.next().and_then(|n| n.parse::<u64>().ok());
        let wrong = || {
            Error::input(format!(
                "expected an array of N x 6 or N x 3 numbers, found the shape ({})",
                inner.chars().take(40).collect::<String>().escape_debug()
            ))
        };
        let (rows, columns) = next().zip(next()).ok_or_else(wrong)?;
        if sizes.any(|rest| !rest.is_empty()) {
            return Err(wrong());
        }
        Ok((rows, columns))
    }

    /// The header of an array of 32-bit floats.
    pub(super) fn header(rows: u64, columns: usize) -> Vec<u8> {
        crate::image::npy::header(&[rows, columns as u64])
    }
}

/// What follows a key of the header.
fn entry<'a>(text: &'a str, key: &str) -> Result<&'a str> {
    let quoted = [format!("'{key}'"), format!("\"{key}\"")];
    let behind = quoted.iter().find_map(|q| text.split_once(q.as_str()));
    let value = behind.and_then(|(_, rest)| rest.trim_start().strip_prefix(':'));
    value
        .map(str::trim_start)
        .ok_or_else(|| Error::input(format!("the header has no `{key}`; the file is damaged")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn own_headers_are_read() {
        for (rows, columns) in [(0, 3), (1, 4), (123_456_789, 6)] {
            let header = Array::header(rows, columns);
            assert_eq!(header.len() % 64, 0);
            let array = Array {
                encoding: Encoding::LittleEndian,
                scalar: Scalar::F32,
                rows,
                columns: columns as u64,
                start: header.len() as u64,
            };
            assert_eq!(Array::parse(&header).unwrap(), array);
        }
    }

    #[test]
    fn what_is_wrong_is_said_in_a_line() {
        let of = |text: &str| {
            let mut head = MAGIC.to_vec();
            head.extend([2, 0]);
            head.extend((text.len() as u32).to_le_bytes());
            head.extend(text.bytes());
            Array::parse(&head)
        };
        of("{\"descr\": '>f8', 'fortran_order': False, 'shape': (2, 6)}").unwrap();
        for (text, says) in [
            ("{}", "no `descr`"),
            ("{'descr': '<i4', ", "float32 or float64"),
            ("{'descr': '<f4'}", "no `fortran_order`"),
            ("{'descr': '<f4', 'fortran_order': True, ", "by columns"),
            (
                "{'descr': '<f4', 'fortran_order': False, 'shape': (6,), }",
                "the shape (6,)",
            ),
            (
                "{'descr': '<f4', 'fortran_order': False, 'shape': (6, 2, 3), }",
                "the shape (6, 2, 3)",
            ),
        ] {
            let message = of(text).unwrap_err().to_string();
            assert!(message.contains(says), "{message}");
        }
        assert!(Array::parse(MAGIC).is_err() && Array::parse(b"\x93NUMPY\x09\x00").is_err());
    }
}

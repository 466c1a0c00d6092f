//! The header of a PLY file: what elements there are, in what order, and of what numbers.

use crate::{Error, Result};

/// Bytes of the longest header that is read: what has no end within them is no PLY file.
const MAX_HEADER: usize = 1 << 20;

/// What the header of a file says.
#[derive(Debug)]
pub(crate) struct Header {
    pub(crate) encoding: Encoding,
    pub(crate) elements: Vec<Element>,
    /// File names of textures that comments give, in order.
    pub(crate) textures: Vec<String>,
    /// Where the content begins.
    pub(crate) length: usize,
}

/// How the content is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Encoding {
    Ascii,
    LittleEndian,
    BigEndian,
}

/// A list of things that are alike.
#[derive(Debug)]
pub(crate) struct Element {
    pub(crate) name: String,
    pub(crate) count: usize,
    pub(crate) properties: Vec<Property>,
}

/// A number of each thing, or a list of numbers.
#[derive(Debug)]
pub(crate) struct Property {
    pub(crate) name: String,
    /// Type of the length, for a list.
    pub(crate) length: Option<Scalar>,
    pub(crate) scalar: Scalar,
}

/// A type of numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Scalar {
    fn parse(name: &str) -> Option<Self> {
        Some(match name {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return None,
        })
    }

    /// Bytes of a number.
    pub(crate) fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }
}

impl Header {
    /// Reads a header from the start of a file.
    pub(crate) fn parse(content: &[u8]) -> Result<Self> {
        let mut lines = Lines { content, at: 0 };
        if lines.next().as_deref() != Some("ply") {
            return Err(Error::input(
                "not a PLY file: expected `ply` as its first line",
            ));
        }
        let mut encoding = None;
        let mut header = Self {
            encoding: Encoding::Ascii,
            elements: Vec::new(),
            textures: Vec::new(),
            length: 0,
        };
        for number in 2.. {
            let line = lines.next().ok_or_else(|| {
                Error::input("the header has no `end_header`; the file is truncated or damaged")
            })?;
            let words: Vec<&str> = line.split_whitespace().collect();
            match words[..] {
                [] | ["obj_info", ..] => {}
                ["comment", ..] => header.textures.extend(texture_of(&line)),
                ["end_header"] => break,
                ["format", name, _version] => {
                    let known = [
                        ("ascii", Encoding::Ascii),
                        ("binary_little_endian", Encoding::LittleEndian),
                        ("binary_big_endian", Encoding::BigEndian),
                    ];
                    encoding = known.iter().find(|(n, _)| *n == name).map(|(_, e)| *e);
                    if encoding.is_none() {
                        return Err(wrong(number, "a format of `ascii` or `binary_…`", &line));
                    }
                }
                ["element", name, count] => header.elements.push(Element {
                    name: name.into(),
                    count: count
                        .parse()
                        .map_err(|_| wrong(number, "`element`, a name and a count", &line))?,
                    properties: Vec::new(),
                }),
                ["property", ..] => {
                    let property = property(&words)
                        .ok_or_else(|| wrong(number, "`property`, a type and a name", &line))?;
                    let element = header.elements.last_mut();
                    let element = element
                        .ok_or_else(|| wrong(number, "`element` before `property`", &line))?;
                    element.properties.push(property);
                }
                _ => {
                    let what = "`comment`, `element`, `property` or `end_header`";
                    return Err(wrong(number, what, &line));
                }
            }
        }
        header.encoding = encoding
            .ok_or_else(|| Error::input("the header has no line `format`; the file is damaged"))?;
        header.length = lines.at;
        Ok(header)
    }
}

fn wrong(number: usize, expected: &str, line: &str) -> Error {
    let short: String = line.chars().take(40).collect();
    Error::input(format!(
        "line {number} of the header: expected {expected}, found \"{}\"",
        short.escape_debug()
    ))
}

/// The file name of a comment such as `comment TextureFile a.png`.
fn texture_of(line: &str) -> Option<String> {
    let (_, rest) = line.trim_start().split_once(char::is_whitespace)?;
    let (key, name) = rest.trim_start().split_once(char::is_whitespace)?;
    let is_texture = ["texturefile", "texture_file"].contains(&key.to_lowercase().as_str());
    is_texture.then(|| name.trim().to_owned())
}

fn property(words: &[&str]) -> Option<Property> {
    let (length, scalar, name) = match *words {
        ["property", "list", length, scalar, name] => (Some(Scalar::parse(length)?), scalar, name),
        ["property", scalar, name] => (None, scalar, name),
        _ => return None,
    };
    Some(Property {
        name: name.into(),
        length,
        scalar: Scalar::parse(scalar)?,
    })
}

/// Lines that end with a line feed, a carriage return, or both.
struct Lines<'a> {
    content: &'a [u8],
    at: usize,
}

impl Lines<'_> {
    fn next(&mut self) -> Option<String> {
        let end = self.content.len().min(MAX_HEADER);
        let rest = self.content.get(self.at..end)?;
        let length = rest.iter().position(|b| [b'\n', b'\r'].contains(b))?;
        self.at += length + 1;
        if rest[length] == b'\r' && rest.get(length + 1) == Some(&b'\n') {
            self.at += 1;
        }
        Some(
            String::from_utf8_lossy(&rest[..length])
                .trim_end()
                .to_owned(),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn headers_are_read_whatever_ends_their_lines() {
        for end in ["\n", "\r\n", "\r"] {
            let text = "ply\nformat ascii 1.0\ncomment TextureFile a b.png\nobj_info x\n\
                        element vertex 2\nproperty float32 x\nproperty list uchar int y\n\
                        end_header\n1";
            let content = text.replace('\n', end);
            let header = Header::parse(content.as_bytes()).unwrap();
            assert_eq!(header.textures, ["a b.png"]);
            assert_eq!(&content[header.length..], "1");
            let [vertex] = &header.elements[..] else {
                panic!()
            };
            assert_eq!((vertex.name.as_str(), vertex.count), ("vertex", 2));
            let [x, y] = &vertex.properties[..] else {
                panic!()
            };
            assert_eq!((x.scalar, x.length), (Scalar::F32, None));
            assert_eq!((y.scalar, y.length), (Scalar::I32, Some(Scalar::U8)));
        }
    }

    #[test]
    fn what_is_wrong_is_said_in_a_line() {
        for (lines, says) in [
            ("Ply\n", "expected `ply`"),
            ("ply\nformat ascii 1.0\n", "no `end_header`"),
            ("ply\nend_header\n", "no line `format`"),
            (
                "ply\nformat asci 1.0\n",
                "line 2 of the header: expected a format",
            ),
            ("ply\nMade by \u{1b}[31m\n", "found \"Made by \\u{1b}[31m\""),
            ("ply\nelement vertex -1\n", "a name and a count"),
            ("ply\nproperty float x\n", "`element` before"),
            (
                "ply\nelement a 1\nproperty real x\n",
                "line 3 of the header",
            ),
        ] {
            let message = Header::parse(lines.as_bytes()).unwrap_err().to_string();
            assert!(
                message.contains(says) && !message.contains('\n'),
                "{message}"
            );
        }
    }
}

//! The bytes of a glTF: buffers inside the file, beside it or in its text, and the accessors into
//! them.
//!
//! Every access is checked against the bytes that are there; the crate's own readers trust the
//! file.

use super::super::files::Files;
use crate::run::{Cancel, memory};
use crate::scene::builder::MESH;
use crate::{Error, Result};
use ::gltf::accessor::{Accessor, DataType};
use ::gltf::buffer::{Source, View};
use ::gltf::{Document, Gltf};
use std::path::Path;

/// All buffers of a document.
pub(super) struct Buffers {
    content: Vec<Vec<u8>>,
}

impl Buffers {
    /// Reads the buffers that are not part of the file itself.
    pub(super) fn read(gltf: &mut Gltf, path: &Path, files: &mut Files) -> Result<Self> {
        let mut blob = gltf.blob.take();
        let mut content = Vec::new();
        for buffer in gltf.document.buffers() {
            let place = format!("buffer {}", buffer.index());
            let data = match buffer.source() {
                Source::Bin => blob.take().ok_or_else(|| {
                    Error::input(format!("{place}: the file has no binary chunk"))
                })?,
                Source::Uri(uri) => {
                    read_uri(uri, "buffer", path, files).map_err(|e| e.at(&place))?
                }
            };
            if data.len() < buffer.length() {
                return Err(Error::input(format!(
                    "{place}: expected {} bytes, found {}",
                    buffer.length(),
                    data.len()
                )));
            }
            content.push(data);
        }
        Ok(Self { content })
    }

    /// The bytes of image `index`, read from beside the file if it is there.
    pub(super) fn image(
        &self,
        document: &Document,
        index: usize,
        path: &Path,
        files: &mut Files,
    ) -> Result<Vec<u8>> {
        let image = document.as_json().images.get(index);
        let image = image.ok_or_else(|| Error::input(format!("there is no image {index}")))?;
        if let Some(uri) = &image.uri {
            return read_uri(uri, "texture", path, files);
        }
        let view = image
            .buffer_view
            .and_then(|v| document.views().nth(v.value()));
        let view =
            view.ok_or_else(|| Error::input("it has no source that is read, PNG, JPEG or WebP"))?;
        Ok(self.view(&view)?.to_vec())
    }

    fn view(&self, view: &View<'_>) -> Result<&[u8]> {
        let buffer = &self.content[view.buffer().index()];
        let end = view.offset().checked_add(view.length());
        end.and_then(|end| buffer.get(view.offset()..end))
            .ok_or_else(|| {
                Error::input(format!(
                    "buffer view {}: {} bytes at {} are beyond the {} of its buffer",
                    view.index(),
                    view.length(),
                    view.offset(),
                    buffer.len()
                ))
            })
    }

    /// What is made of each element of `N` floats; integers are brought to [0,1] or [-1,1] if the
    /// accessor is normalised.
    pub(super) fn floats<const N: usize, T: Clone>(
        &self,
        accessor: &Accessor<'_>,
        make: impl Fn([f32; N]) -> T,
    ) -> Result<Vec<T>> {
        self.elements(accessor, N, &|bytes| {
            let size = accessor.data_type().size();
            make(std::array::from_fn(|i| {
                let number = &bytes[i * size..];
                float(number, accessor.data_type(), accessor.normalized())
            }))
        })
    }

    /// Elements of one index.
    pub(super) fn indices(&self, accessor: &Accessor<'_>) -> Result<Vec<u32>> {
        if matches!(accessor.data_type(), DataType::F32) {
            return Err(Error::input(format!(
                "accessor {}: expected integers as indices, found floats",
                accessor.index()
            )));
        }
        self.elements(accessor, 1, &|bytes| {
            whole(bytes, accessor.data_type().size())
        })
    }

    fn elements<T: Clone>(
        &self,
        accessor: &Accessor<'_>,
        numbers: usize,
        decode: &dyn Fn(&[u8]) -> T,
    ) -> Result<Vec<T>> {
        let place = |e: Error| e.at(format!("accessor {}", accessor.index()));
        let found = accessor.dimensions().multiplicity();
        if found != numbers {
            return Err(place(Error::input(format!(
                "expected elements of {numbers} numbers, found {found}"
            ))));
        }
        let size = numbers * accessor.data_type().size();
        let count = accessor.count();
        let mut elements = match accessor.view() {
            Some(view) => {
                let slices = self.strided(&view, accessor.offset(), count, size);
                memory::listed(MESH, slices.map_err(place)?.map(decode)).map_err(place)?
            }
            None => {
                // Nothing but zeros: the only length without bytes behind it, so it is held to
                // those of the file.
                let bytes: usize = self.content.iter().map(Vec::len).sum();
                if count > bytes {
                    return Err(place(Error::input(format!(
                        "{count} elements without data, in a file of {bytes} bytes of data"
                    ))));
                }
                memory::filled(MESH, decode(&vec![0; size]), count).map_err(place)?
            }
        };
        if let Some(sparse) = accessor.sparse() {
            let indices = sparse.indices();
            let index_size = indices.index_type().size();
            let places = self
                .strided(
                    &indices.view(),
                    indices.offset(),
                    sparse.count(),
                    index_size,
                )
                .map_err(place)?;
            let values = sparse.values();
            let values = self
                .strided(&values.view(), values.offset(), sparse.count(), size)
                .map_err(place)?;
            for (at, value) in places.zip(values) {
                let at = whole(at, index_size) as usize;
                let element = elements.get_mut(at).ok_or_else(|| {
                    place(Error::input(format!(
                        "a sparse index of {at} in {count} elements"
                    )))
                })?;
                *element = decode(value);
            }
        }
        Ok(elements)
    }

    /// `count` slices of `size` bytes.
    fn strided<'a>(
        &'a self,
        view: &View<'_>,
        offset: usize,
        count: usize,
        size: usize,
    ) -> Result<impl ExactSizeIterator<Item = &'a [u8]> + use<'a>> {
        let bytes = self.view(view)?;
        let stride = view.stride().unwrap_or(size);
        let end = count.checked_sub(1).map_or(Some(0), |last| {
            last.checked_mul(stride)?
                .checked_add(offset)?
                .checked_add(size)
        });
        // A stride below the size would make much out of few bytes.
        if stride < size || end.is_none_or(|end| end > bytes.len()) {
            return Err(Error::input(format!(
                "{count} elements of {size} bytes, {stride} apart from {offset} on, do not fit the \
                 {} bytes of buffer view {}",
                bytes.len(),
                view.index()
            )));
        }
        Ok((0..count).map(move |i| &bytes[offset + i * stride..][..size]))
    }
}

fn whole(bytes: &[u8], size: usize) -> u32 {
    let low = bytes[..size.min(4)].iter().rev();
    low.fold(0, |n, &b| n << 8 | u32::from(b))
}

fn float(bytes: &[u8], data_type: DataType, normalized: bool) -> f32 {
    let (value, one) = match data_type {
        DataType::F32 => {
            let bytes = [bytes[0], bytes[1], bytes[2], bytes[3]];
            return f32::from_le_bytes(bytes);
        }
        DataType::U8 => (f32::from(bytes[0]), 255.0),
        DataType::I8 => (f32::from(bytes[0] as i8), 127.0),
        DataType::U16 => (f32::from(whole(bytes, 2) as u16), 65535.0),
        DataType::I16 => (f32::from(whole(bytes, 2) as u16 as i16), 32767.0),
        DataType::U32 => (whole(bytes, 4) as f32, 4_294_967_295.0),
    };
    match normalized {
        true => (value / one).max(-1.0),
        false => value,
    }
}

fn read_uri(uri: &str, what: &str, path: &Path, files: &mut Files) -> Result<Vec<u8>> {
    if let Some(data) = uri.strip_prefix("data:") {
        let (_, text) = data
            .split_once(";base64,")
            .ok_or_else(|| Error::input("a data URI that is not base64"))?;
        return from_base64(text, &files.cancel);
    }
    if uri.contains("://") {
        let short: String = uri.chars().take(80).collect();
        return Err(Error::input(format!(
            "expected a file beside this one, found the URI {short}"
        )));
    }
    files.read_beside(what, path, &percent_decoded(uri))
}

fn percent_decoded(text: &str) -> String {
    let mut out = Vec::new();
    let mut rest = text.as_bytes();
    while let Some((&byte, after)) = rest.split_first() {
        let code = after.get(..2).filter(|_| byte == b'%');
        let code = code.and_then(|hex| u8::from_str_radix(std::str::from_utf8(hex).ok()?, 16).ok());
        match code {
            Some(decoded) => {
                out.push(decoded);
                rest = &after[2..];
            }
            None => {
                out.push(byte);
                rest = after;
            }
        }
    }
    String::from_utf8_lossy(&out).into_owned()
}

/// Characters that are decoded between two looks at whether to stop; a multiple of four.
const PIECE: usize = 16 << 20;

fn from_base64(text: &str, cancel: &Cancel) -> Result<Vec<u8>> {
    let damaged = || Error::input("damaged base64 in a data URI");
    let text = text.trim_end_matches('=');
    let alphabet = if text.contains(['-', '_']) {
        base64::URL_SAFE_NO_PAD
    } else {
        base64::STANDARD_NO_PAD
    };
    let alphabet = alphabet.decode_allow_trailing_bits(true);
    // The decoder takes room for eight characters more than there are.
    let mut out = memory::room("a buffer", text.len() / 4 * 3 + 8)?;
    for piece in text.as_bytes().chunks(PIECE) {
        cancel.check()?;
        base64::decode_config_buf(piece, alphabet, &mut out).map_err(|_| damaged())?;
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_and_percent_codes() {
        let decoded = |text: &str| from_base64(text, &Cancel::default()).ok();
        assert_eq!(decoded("TWFu").unwrap(), b"Man");
        assert_eq!(decoded("TWE=").unwrap(), b"Ma");
        assert_eq!(decoded("TQ==").unwrap(), b"M");
        assert_eq!(decoded("-_-_").unwrap(), decoded("+/+/").unwrap());
        assert_eq!(decoded("TQ=x"), None);
        assert_eq!(decoded("T"), None);
        assert_eq!(percent_decoded("a%20b%2"), "a b%2");
    }

    #[test]
    fn long_base64_goes_on_where_a_piece_ends_and_hears_a_stop() {
        let text = "TWFu".repeat(PIECE / 4 + 1) + "TQ==";
        let cancel = Cancel::default();
        let bytes = from_base64(&text, &cancel).unwrap();
        assert!(bytes == [&b"Man".repeat(PIECE / 4 + 1)[..], b"M"].concat());
        cancel.request();
        let stopped = from_base64(&text, &cancel).unwrap_err();
        assert_eq!(stopped.kind(), crate::Kind::Cancelled);
    }

    #[test]
    fn normalised_integers_become_fractions() {
        assert_eq!(float(&[255], DataType::U8, true), 1.0);
        assert_eq!(float(&[0x80], DataType::I8, true), -1.0);
        assert_eq!(float(&[0x01, 0x80], DataType::I16, true), -1.0);
        assert_eq!(float(&[7, 0], DataType::U16, false), 7.0);
    }
}

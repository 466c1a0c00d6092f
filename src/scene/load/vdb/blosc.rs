//! Unpacking of Blosc 1 buffers: byte and bit shuffles over LZ4, BloscLZ or zlib.
//!
//! A buffer is a header of 16 bytes (version, codec version, flags, item size, then three 32-bit
//! numbers: unpacked size, block size, packed size), the offsets of its blocks, and the blocks. A
//! block is cut into one stream for each byte of an item, unless it is the short last one or the
//! flags say otherwise; each stream has its length before it.

use super::bytes::Bytes;
use crate::{Error, Result};
use flate2::bufread::ZlibDecoder;
use std::io::Read;

const BYTE_SHUFFLE: u8 = 1;
const STORED: u8 = 2;
const BIT_SHUFFLE: u8 = 4;
const DONT_SPLIT: u8 = 0x10;

/// Blocks of larger items, or of fewer items, are never cut into streams.
const LARGEST_SPLIT_ITEM: usize = 16;
const FEWEST_SPLIT_ITEMS: usize = 128;

/// Unpacks `packed` to exactly `expected` bytes, which replace those in `unpacked`; `streams` is
/// room for what is on its way.
pub(super) fn unpack(
    packed: &[u8],
    expected: usize,
    unpacked: &mut Vec<u8>,
    streams: &mut Vec<u8>,
) -> Result<()> {
    unpacked.clear();
    let mut header = Bytes::new(packed);
    let version = header.u8()?;
    let _codec_version = header.u8()?;
    let flags = header.u8()?;
    let item = usize::from(header.u8()?).max(1);
    let size = header.u32()? as usize;
    let block_size = header.u32()? as usize;
    let _packed_size = header.u32()?;
    if version == 0 || version > 2 {
        return Err(damaged(&format!("format version {version} instead of 2")));
    }
    if size != expected {
        return Err(damaged(&format!(
            "{size} bytes unpacked instead of {expected}"
        )));
    }
    if size == 0 {
        return Ok(());
    }
    if flags & STORED != 0 {
        unpacked.extend(header.take(size)?);
        return Ok(());
    }
    if block_size == 0 {
        return Err(damaged("a block size of 0"));
    }
    for _ in 0..size.div_ceil(block_size) {
        let block = block_size.min(size - unpacked.len());
        let whole = block == block_size;
        let split = flags & DONT_SPLIT == 0
            && whole
            && item <= LARGEST_SPLIT_ITEM
            && block / item >= FEWEST_SPLIT_ITEMS;
        let count = if split { item } else { 1 };
        let start = header.i32()?;
        let mut source = Bytes::new(packed);
        source.seek(start.into())?;
        streams.clear();
        for _ in 0..count {
            stream(&mut source, flags >> 5, block / count, streams)?;
        }
        if streams.len() != block {
            return Err(damaged("streams that do not fill their block"));
        }
        if flags & BYTE_SHUFFLE != 0 && item > 1 {
            unshuffle_bytes(streams, item, unpacked);
        } else if flags & BIT_SHUFFLE != 0 && block >= item {
            unpacked.extend(unshuffle_bits(streams, item));
        } else {
            unpacked.extend(&*streams);
        }
    }
    Ok(())
}

/// Appends one stream of `size` unpacked bytes to `out`.
fn stream(source: &mut Bytes<'_>, codec: u8, size: usize, out: &mut Vec<u8>) -> Result<()> {
    let length = source.i32()?;
    let length = usize::try_from(length).map_err(|_| damaged("a negative length"))?;
    let packed = source.take(length)?;
    if length == size {
        out.extend_from_slice(packed);
        return Ok(());
    }
    let start = out.len();
    out.resize(start + size, 0);
    let target = &mut out[start..];
    let filled = match codec {
        0 => blosclz(packed, target),
        1 => lz4_flex::block::decompress_into(packed, target).ok(),
        3 => {
            let read = ZlibDecoder::new(packed).read_exact(target);
            read.is_ok().then_some(size)
        }
        _ => {
            let name = match codec {
                2 => "Snappy",
                4 => "Zstandard",
                _ => "an unknown codec",
            };
            return Err(Error::input(format!("Blosc with {name} is not supported"))
                .hint("write the file with the OpenVDB library's own Blosc, which uses LZ4"));
        }
    };
    match filled {
        Some(n) if n == size => Ok(()),
        _ => Err(damaged("a stream that does not unpack to its size")),
    }
}

fn damaged(what: &str) -> Error {
    Error::input(format!("a damaged Blosc buffer: {what}"))
}

/// Puts items back together from all their first bytes, all their second bytes, and so on.
fn unshuffle_bytes(bytes: &[u8], item: usize, out: &mut Vec<u8>) {
    let count = bytes.len() / item;
    if item == 4 {
        let start = out.len();
        out.resize(start + 4 * count, 0);
        let (items, _) = out[start..].as_chunks_mut();
        let [a, b, c, d] = std::array::from_fn(|b| &bytes[b * count..][..count]);
        let bytes = a.iter().zip(b).zip(c).zip(d);
        for (item, (((a, b), c), d)) in items.iter_mut().zip(bytes) {
            *item = [*a, *b, *c, *d];
        }
    } else {
        let of_item = |i: usize| (0..item).map(move |b| bytes[b * count + i]);
        out.extend((0..count).flat_map(of_item));
    }
    // What is left of a last item is not shuffled.
    out.extend(&bytes[count * item..]);
}

/// Puts items back together from all their first bits, all their second bits, and so on, low bits
/// first.
fn unshuffle_bits(bytes: &[u8], item: usize) -> Vec<u8> {
    // Items are shuffled in groups of eight; the rest is as it was.
    let count = bytes.len() / item / 8 * 8;
    let mut out = bytes.to_vec();
    out[..count * item].fill(0);
    for bit in 0..item * 8 {
        for i in 0..count {
            let from = bytes[(bit * count + i) / 8] >> (i % 8) & 1;
            out[i * item + bit / 8] |= from << (bit % 8);
        }
    }
    out
}

/// Unpacks a BloscLZ stream; the number of bytes written, or `None` if it is damaged.
///
/// A token is a literal run (below 32: its length less one), or a match: length in the upper three
/// bits, high bits of the distance in the lower five, longer lengths and the low byte of the
/// distance after it.
fn blosclz(packed: &[u8], out: &mut [u8]) -> Option<usize> {
    const FAR: usize = 8191;
    let mut source = packed.iter().copied();
    let mut at = 0;
    let mut token = usize::from(source.next()? & 31);
    loop {
        if token < 32 {
            for _ in 0..=token {
                *out.get_mut(at)? = source.next()?;
                at += 1;
            }
        } else {
            let mut length = token >> 5;
            let high = (token & 31) << 8;
            if length == 7 {
                loop {
                    let more = source.next()?;
                    length += usize::from(more);
                    if more != 255 {
                        break;
                    }
                }
            }
            let low = usize::from(source.next()?);
            let mut distance = high + low + 1;
            if low == 255 && high == 31 << 8 {
                let far = usize::from(source.next()?) << 8 | usize::from(source.next()?);
                distance = far + FAR + 1;
            }
            for _ in 0..length + 2 {
                let byte = *out.get(at.checked_sub(distance)?)?;
                *out.get_mut(at)? = byte;
                at += 1;
            }
        }
        match source.next() {
            Some(next) => token = usize::from(next),
            None => return Some(at),
        }
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// Packs items of 4 bytes with a byte shuffle and LZ4 in one block, as OpenVDB does.
    pub(in super::super) fn pack(bytes: &[u8]) -> Vec<u8> {
        let count = bytes.len() / 4;
        let mut shuffled = bytes.to_vec();
        for i in 0..count * 4 {
            shuffled[i % 4 * count + i / 4] = bytes[i];
        }
        let split = bytes.len() / 4 >= FEWEST_SPLIT_ITEMS;
        let streams = if split { 4 } else { 1 };
        let mut out = vec![2, 1, BYTE_SHUFFLE | 1 << 5, 4];
        out.extend((bytes.len() as u32).to_le_bytes());
        out.extend((bytes.len() as u32).to_le_bytes());
        out.extend([0; 4]);
        out.extend(20_i32.to_le_bytes());
        for stream in shuffled.chunks(bytes.len() / streams) {
            let packed = lz4_flex::block::compress(stream);
            let stored = packed.len() >= stream.len();
            let data = if stored { stream } else { &packed };
            out.extend((data.len() as i32).to_le_bytes());
            out.extend(data);
        }
        out
    }

    fn unpacked(packed: &[u8], expected: usize) -> Result<Vec<u8>> {
        let mut out = vec![7; 3];
        unpack(packed, expected, &mut out, &mut Vec::new())?;
        Ok(out)
    }

    fn sample(n: usize) -> Vec<u8> {
        (0..n)
            .flat_map(|i| ((i / 3) as f32 * 0.25).to_le_bytes())
            .collect()
    }

    #[test]
    fn shuffled_lz4_comes_back() {
        for n in [16, 127, 128, 512] {
            let bytes = sample(n);
            assert_eq!(unpacked(&pack(&bytes), bytes.len()).unwrap(), bytes);
        }
    }

    #[test]
    fn damage_is_an_error() {
        let bytes = sample(512);
        let packed = pack(&bytes);
        assert!(unpacked(&packed, bytes.len() + 4).is_err());
        for cut in 0..packed.len() {
            assert!(unpacked(&packed[..cut], bytes.len()).is_err());
        }
        for at in 0..packed.len() {
            for flip in [1, 0x80, 0xff] {
                let mut damaged = packed.clone();
                damaged[at] ^= flip;
                let _ = unpacked(&damaged, bytes.len());
            }
        }
    }

    #[test]
    fn blosclz_runs_and_matches() {
        // Literals "abc", then a match of 3 + 4 bytes at distance 3, then a literal "x".
        let packed = [2, b'a', b'b', b'c', 5 << 5, 2, 0, b'x'];
        let mut out = [0; 11];
        assert_eq!(blosclz(&packed, &mut out), Some(11));
        assert_eq!(&out, b"abcabcabcax");
        // A long match: 7 in the token, then 255 and 10 more.
        let packed = [0, b'z', 7 << 5, 255, 10, 0];
        let mut out = [0; 1 + 7 + 255 + 10 + 2];
        assert_eq!(blosclz(&packed, &mut out), Some(out.len()));
        assert!(out.iter().all(|b| *b == b'z'));
        assert_eq!(
            blosclz(&[0, b'z', 1 << 5, 9], &mut out),
            None,
            "before the start"
        );
    }

    #[test]
    fn bits_are_unshuffled() {
        // Eight items of one byte: bit b of item i is bit i of byte b.
        let items: Vec<u8> = (0..8).map(|i| 0x1d_u8.wrapping_mul(i + 3)).collect();
        let shuffled: Vec<u8> = (0..8)
            .map(|b| (0..8).fold(0, |byte, i| byte | (items[i] >> b & 1) << i))
            .collect();
        assert_eq!(unshuffle_bits(&shuffled, 1), items);
    }
}

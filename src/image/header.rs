//! Puts the attributes of an OpenEXR header into a fixed order.
//!
//! The encoder keeps user attributes in a hash map whose order changes from run to run. Attributes
//! are self-delimiting and may stand in any order, and sorting them does not change the header's
//! length, so the chunk table stays valid.

/// Magic number and version field.
const PREAMBLE: usize = 8;

/// Sorts the attributes of a single-part file by name. Leaves bytes that are no such header alone.
pub(super) fn sort_attributes(file: &mut [u8]) {
    let Some(spans) = attribute_spans(file) else {
        return;
    };
    let (Some(first), Some(last)) = (spans.first(), spans.last()) else {
        return;
    };
    let whole = first.start..last.end;
    let mut attributes: Vec<&[u8]> = spans.iter().map(|span| &file[span.clone()]).collect();
    // The name leads each attribute and is unique, so this is an order by name.
    attributes.sort_unstable();
    let sorted = attributes.concat();
    file[whole].copy_from_slice(&sorted);
}

/// Byte ranges of all attributes: name, zero, type, zero, size, value.
fn attribute_spans(file: &[u8]) -> Option<Vec<std::ops::Range<usize>>> {
    let mut spans = Vec::new();
    let mut at = PREAMBLE;
    while *file.get(at)? != 0 {
        let start = at;
        at = after_zero(file, at)?;
        at = after_zero(file, at)?;
        let size: [u8; 4] = file.get(at..at + 4)?.try_into().ok()?;
        at = (at + 4).checked_add(usize::try_from(i32::from_le_bytes(size)).ok()?)?;
        file.get(start..at)?;
        spans.push(start..at);
    }
    Some(spans)
}

fn after_zero(file: &[u8], from: usize) -> Option<usize> {
    let length = file.get(from..)?.iter().position(|&b| b == 0)?;
    Some(from + length + 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn attribute(name: &str, value: &[u8]) -> Vec<u8> {
        let size = i32::try_from(value.len()).unwrap().to_le_bytes();
        [name.as_bytes(), b"\0string\0", &size, value].concat()
    }

    #[test]
    fn order_does_not_matter() {
        let (a, b) = (attribute("a", b"zz"), attribute("b\u{e9}", b""));
        let tail = b"\0table";
        let mut one = [&[0; 8][..], &a, &b, tail].concat();
        let mut two = [&[0; 8][..], &b, &a, tail].concat();
        let sorted = one.clone();
        sort_attributes(&mut one);
        sort_attributes(&mut two);
        assert_eq!(one, sorted);
        assert_eq!(two, sorted);
    }

    #[test]
    fn cut_headers_are_left_alone() {
        let whole = [
            &[0; 8][..],
            &attribute("b", b"1"),
            &attribute("a", b"2"),
            b"\0",
        ]
        .concat();
        for length in 0..whole.len() {
            let mut cut = whole[..length].to_vec();
            sort_attributes(&mut cut);
            assert_eq!(cut, whole[..length]);
        }
    }
}

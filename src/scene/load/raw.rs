//! Raw bricks: nothing but samples, x fastest.

use super::field::Field;
use super::files::Content;
use super::samples::{Array, Number, byte_length};
use crate::{Error, Result};

/// Takes the content of a file as samples; its length must be exactly theirs.
pub(super) fn read(
    content: Content,
    dims: [usize; 3],
    number: Number,
    big_endian: bool,
) -> Result<Field> {
    let expected = byte_length(dims, number)?;
    let found = content.as_ref().len();
    if found != expected {
        return Err(Error::input(format!(
            "expected {expected} bytes for {} x {} x {} numbers of {} bytes, found {}",
            dims[0],
            dims[1],
            dims[2],
            number.size(),
            found
        ))
        .hint("check `dims` and `dtype`"));
    }
    Ok(Field::of_array(Array {
        dims,
        bytes: content,
        number,
        big_endian,
        rescale: None,
    }))
}

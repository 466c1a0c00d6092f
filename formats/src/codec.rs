//! The encoding of metadata and summary sections: fixed-width little-endian numbers, u64 lengths,
//! one-byte tags. Nothing else knows which library does it.

use crate::{FormatError, Result};

/// A section cannot be longer than this, nor make a reader allocate more.
pub const MAX_SECTION_BYTES: usize = 16 << 20;

fn config() -> impl bincode::config::Config {
    bincode::config::legacy().with_limit::<MAX_SECTION_BYTES>()
}

/// Encodes a section.
pub fn encode<T: bincode::Encode>(value: &T, what: &str) -> Result<Vec<u8>> {
    let bytes = bincode::encode_to_vec(value, config())
        .map_err(|e| FormatError::invalid(what, "values that can be encoded", e))?;
    if bytes.len() > MAX_SECTION_BYTES {
        return Err(FormatError::invalid(
            what,
            format!("at most {MAX_SECTION_BYTES} bytes"),
            bytes.len(),
        ));
    }
    Ok(bytes)
}

/// Decodes a section; every byte must be used.
pub fn decode<T: bincode::Decode<()>>(bytes: &[u8], what: &str) -> Result<T> {
    let (value, used) = bincode::decode_from_slice::<T, _>(bytes, config())
        .map_err(|e| FormatError::invalid(what, "a valid encoding", e))?;
    if used != bytes.len() {
        return Err(FormatError::invalid(
            what,
            format!("{used} bytes"),
            format!("{} bytes", bytes.len()),
        ));
    }
    Ok(value)
}

//! Sizes of memory as people write them.

use crate::{Error, Result};
use std::fmt::Display;

const UNITS: [(char, u64); 4] = [
    ('K', 1 << 10),
    ('M', 1 << 20),
    ('G', 1 << 30),
    ('T', 1 << 40),
];

/// Reads `64M`, `1.5G`, `512MiB` or a plain number of bytes. K, M, G and T stand for powers of
/// 1024, with or without `B` or `iB` behind them, in either case.
///
/// # Errors
/// [`crate::Kind::Input`] if the text is no such size, or it is not above zero.
#[cfg(feature = "cli")]
pub fn parse(text: &str) -> Result<u64> {
    let wrong = || {
        Error::input(format!("{text:?} is not a size of memory"))
            .hint("write bytes or K, M, G, T (powers of 1024): 64M, 1.5G, 512MiB")
    };
    let upper = text.trim().to_ascii_uppercase();
    let digits = upper.trim_end_matches(|c: char| c.is_ascii_alphabetic());
    let suffix = &upper[digits.len()..];
    let letter = suffix
        .strip_suffix("IB")
        .or(suffix.strip_suffix('B'))
        .unwrap_or(suffix);
    let factor = match letter {
        "" if suffix == "IB" => return Err(wrong()),
        "" => 1,
        _ => {
            let unit = UNITS
                .iter()
                .find(|(c, _)| letter.len() == 1 && letter.starts_with(*c));
            unit.ok_or_else(wrong)?.1
        }
    };
    let plain = !digits.is_empty() && digits.chars().all(|c| c.is_ascii_digit() || c == '.');
    let value: f64 = digits.trim().parse().map_err(|_| wrong())?;
    let bytes = value * factor as f64;
    // 2^63 is beyond any machine and exact in f64.
    if !plain || !(1.0..9_223_372_036_854_775_808.0).contains(&bytes) {
        return Err(wrong());
    }
    Ok(bytes as u64)
}

/// Writes a size with three digits: `1.50 GiB`.
#[must_use]
pub fn format(bytes: u64) -> String {
    match UNITS.iter().rev().find(|(_, size)| bytes >= *size) {
        Some((letter, size)) => {
            let value = bytes as f64 / *size as f64;
            let decimals = if value >= 100.0 {
                0
            } else if value >= 10.0 {
                1
            } else {
                2
            };
            format!("{value:.decimals$} {letter}iB")
        }
        None => format!("{bytes} B"),
    }
}

/// Most bytes of the tables that find bricks of volumes of a file of so many bytes: a header alone
/// may claim volumes of any size. Volumes of 2048^3 voxels in all are free; a brick that is not
/// empty takes a byte of the file, or several, and pays for those around it.
#[must_use]
pub fn most_of_tables(file_bytes: u64) -> u64 {
    const FREE: u64 = 256 << 20;
    file_bytes.saturating_mul(1024).saturating_add(FREE)
}

/// Refuses what takes more memory than the limit, if there is one, before it is begun. `what` is
/// the deed or the thing, as in "shading 100 pixels". Callers may replace the hint by one that
/// knows other ways out.
///
/// # Errors
/// [`crate::Kind::Input`] with both sizes.
pub fn within(what: impl Display, needed: u64, limit: Option<u64>) -> Result<()> {
    match limit {
        Some(limit) if needed > limit => Err(Error::input(format!(
            "{what} needs {}, `memory_limit` is {}",
            format(needed),
            format(limit)
        ))
        .hint("raise `memory_limit`")),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_spellings() {
        for (text, bytes) in [
            ("1", 1),
            ("4096b", 4096),
            ("64M", 64 << 20),
            ("64m", 64 << 20),
            ("4G", 4 << 30),
            ("512MiB", 512 << 20),
            ("1KB", 1024),
            (" 1.5g ", 3 << 29),
            ("2T", 2 << 40),
        ] {
            assert_eq!(parse(text).unwrap(), bytes, "{text}");
        }
        for text in [
            "", "G", "-1", "0", "1X", "1GG", "1iB", "nan", "inf", "1e9", "0x10", "0.1", "9999999T",
            "4 Gb it",
        ] {
            let error = parse(text).unwrap_err();
            assert!(error.hint_text().is_some(), "{text}");
        }
    }

    #[test]
    fn only_what_is_above_the_limit_is_refused() {
        for limit in [None, Some(4096), Some(u64::MAX)] {
            within("x", 4096, limit).unwrap();
        }
        let error = within("shading 9 pixels", 4096, Some(1)).unwrap_err();
        assert_eq!(error.kind(), crate::Kind::Input);
        assert_eq!(
            error.to_string(),
            "shading 9 pixels needs 4.00 KiB, `memory_limit` is 1 B"
        );
        assert!(error.hint_text().unwrap().contains("`memory_limit`"));
    }

    #[test]
    fn three_digits() {
        assert_eq!(format(1023), "1023 B");
        assert_eq!(format(3 << 29), "1.50 GiB");
        assert_eq!(format(200 << 20), "200 MiB");
        assert_eq!(format(u64::MAX), "16777216 TiB");
    }
}

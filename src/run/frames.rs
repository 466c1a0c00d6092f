//! Frames of an animation: ranges of them, and their numbers in the names of files.

use crate::{Error, Result};
use std::borrow::Cow;
use std::fmt;
use std::str::FromStr;

/// Numbers of frames, each once, in the order in which they were named; at least one.
///
/// Read from text as `1-10`, `1-10x2` or `1-10:2` (every second), `1,5,9`, or several of these with
/// commas between them. Numbers may be negative, as in `-5--1`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Frames(Vec<i32>);

impl Frames {
    /// Most frames of a list: what is longer is taken for a slip of the keyboard.
    const MOST: usize = 100_000;

    /// The one frame of this number.
    #[must_use]
    pub fn one(number: i32) -> Self {
        Self(vec![number])
    }

    /// The numbers, in order.
    #[must_use]
    pub fn numbers(&self) -> &[i32] {
        &self.0
    }
}

impl FromStr for Frames {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        let wrong = |found: &str| {
            Error::input(format!(
                "expected frames as 1-10, 1-10x2 or 1,5,9, found {found:?}"
            ))
        };
        let mut numbers: Vec<i32> = Vec::new();
        for part in text.split(',').map(str::trim) {
            let range = Range::read(part).ok_or_else(|| wrong(part))?;
            if range.first > range.last {
                return Err(wrong(part).hint("a range goes up, from its first frame to its last"));
            }
            if numbers.len() + range.len() > Self::MOST {
                return Err(Error::input(format!(
                    "expected at most {} frames, found more in {text:?}",
                    Self::MOST
                )));
            }
            numbers.extend((range.first..=range.last).step_by(range.step));
        }
        let mut seen = std::collections::HashSet::new();
        numbers.retain(|n| seen.insert(*n));
        Ok(Self(numbers))
    }
}

/// As `1-10`, with every second as `1-10x2`, with commas between what is no range.
impl fmt::Display for Frames {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&Self::text_of(&self.0))
    }
}

impl Frames {
    /// Some frames as they are read.
    #[must_use]
    pub fn text_of(numbers: &[i32]) -> String {
        let mut text = String::new();
        let mut rest = numbers;
        let mut comma = "";
        while let [first, ..] = *rest {
            let step = match *rest {
                [a, b, ..] if b > a => i64::from(b) - i64::from(a),
                _ => 1,
            };
            let follows = |p: &[i32]| i64::from(p[1]) - i64::from(p[0]) == step;
            let run = 1 + rest.windows(2).take_while(|p| follows(p)).count();
            // Two frames far apart are no range.
            let run = if run == 2 && step > 1 { 1 } else { run };
            text += &format!("{comma}{first}");
            if run > 1 {
                text += &format!("-{}", rest[run - 1]);
            }
            if run > 1 && step > 1 {
                text += &format!("x{step}");
            }
            rest = &rest[run..];
            comma = ",";
        }
        text
    }
}

/// Frames from one to another, every so many.
struct Range {
    first: i32,
    last: i32,
    step: usize,
}

impl Range {
    fn read(text: &str) -> Option<Self> {
        let (range, step) = match text.split_once(['x', ':']) {
            Some((range, step)) => (range, step.parse().ok().filter(|s| *s > 0)?),
            None => (text, 1),
        };
        // The sign of the first number is no dash between two.
        let dash = range
            .char_indices()
            .skip(1)
            .find(|c| c.1 == '-')
            .map(|c| c.0);
        let (first, last) = match dash {
            Some(at) => (&range[..at], &range[at + 1..]),
            None if range.len() == text.len() => (range, range),
            // A step of a single frame.
            None => return None,
        };
        Some(Self {
            first: first.parse().ok()?,
            last: last.parse().ok()?,
            step,
        })
    }

    fn len(&self) -> usize {
        let frames = i64::from(self.last) - i64::from(self.first);
        frames as usize / self.step + 1
    }
}

/// The place of a frame's number in a name, and how many digits it has at least.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Token {
    start: usize,
    end: usize,
    digits: usize,
}

/// The first token of a name from a place on: `####`, `%04d` or `%d`, `$F4` or `$F`. A single `#`
/// is none.
fn token(name: &str, from: usize) -> Option<Token> {
    let rest = &name[from..];
    let digits_at = |at: usize| {
        let digits = rest[at..].bytes().take_while(u8::is_ascii_digit);
        digits.count()
    };
    rest.bytes().enumerate().find_map(|(at, byte)| {
        let of = |len: usize, digits: usize| {
            Some(Token {
                start: from + at,
                end: from + at + len,
                digits,
            })
        };
        let number = |from: usize, len: usize| rest[from..from + len].parse::<usize>().ok();
        match byte {
            b'#' => {
                let len = rest[at..].bytes().take_while(|b| *b == b'#').count();
                (len > 1).then(|| of(len, len))?
            }
            b'%' => {
                let len = digits_at(at + 1);
                let is_number = rest[at + 1 + len..].starts_with('d');
                let is_padded = len == 0 || rest[at + 1..].starts_with('0');
                let digits = if len == 0 { 1 } else { number(at + 1, len)? };
                (is_number && is_padded && digits <= MOST_DIGITS).then(|| of(len + 2, digits))?
            }
            b'$' if rest[at + 1..].starts_with('F') => {
                let len = digits_at(at + 2);
                let is_word = |b: &u8| b.is_ascii_alphanumeric() || *b == b'_';
                let ends = !rest.as_bytes().get(at + 2 + len).is_some_and(is_word);
                let digits = if len == 0 { 1 } else { number(at + 2, len)? };
                (ends && digits <= MOST_DIGITS).then(|| of(len + 2, digits))?
            }
            _ => None,
        }
    })
}

/// More digits are no number of a frame.
const MOST_DIGITS: usize = 20;

/// The first token of a name as it stands there, if there is one.
#[must_use]
pub fn token_in(name: &str) -> Option<&str> {
    token(name, 0).map(|t| &name[t.start..t.end])
}

/// The name that a frame gives: each token in it becomes the frame's number, filled with zeros to
/// the digits of the token.
#[must_use]
pub fn at_frame(name: &str, frame: i32) -> Cow<'_, str> {
    let Some(mut next) = token(name, 0) else {
        return Cow::Borrowed(name);
    };
    let mut text = String::with_capacity(name.len() + 8);
    let mut from = 0;
    loop {
        text += &name[from..next.start];
        let sign = if frame < 0 { "-" } else { "" };
        let digits = frame.unsigned_abs().to_string();
        text += sign;
        text.extend(std::iter::repeat_n(
            '0',
            next.digits.saturating_sub(sign.len() + digits.len()),
        ));
        text += &digits;
        from = next.end;
        match token(name, from) {
            Some(found) => next = found,
            None => break,
        }
    }
    text += &name[from..];
    Cow::Owned(text)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Vec<i32> {
        let frames: Frames = text.parse().unwrap();
        frames.numbers().to_vec()
    }

    #[test]
    fn ranges_are_read() {
        assert_eq!(read("7"), [7]);
        assert_eq!(read("1-4"), [1, 2, 3, 4]);
        assert_eq!(read("1-10x3"), [1, 4, 7, 10]);
        assert_eq!(read("1-10:4"), [1, 5, 9]);
        assert_eq!(read("1,5, 9-10"), [1, 5, 9, 10]);
        assert_eq!(read("-2-1"), [-2, -1, 0, 1]);
        assert_eq!(read("-5--3"), [-5, -4, -3]);
        // Each once, where it came first.
        assert_eq!(read("3,1-4,2"), [3, 1, 2, 4]);
        assert_eq!(read("2147483646-2147483647"), [i32::MAX - 1, i32::MAX]);
    }

    #[test]
    fn what_is_no_range_is_refused() {
        for text in [
            "",
            "a",
            "1-",
            "-",
            "1--",
            "4-1",
            "1-4x0",
            "1-4x-1",
            "1x2",
            "1,,2",
            "1-4x",
            "1.5",
            "99999999999",
            "1-9-3",
            "-2147483648-2147483647",
            "0-100000",
        ] {
            let error = text.parse::<Frames>().unwrap_err();
            assert_eq!(error.kind(), crate::Kind::Input, "{text}");
            assert!(error.to_string().starts_with("expected"), "{error}");
        }
    }

    #[test]
    fn frames_are_told_as_ranges() {
        for text in [
            "7",
            "1-4",
            "1-10x3",
            "1,5",
            "-5--3",
            "1-3,7-9,20",
            "1,9-17x4",
        ] {
            let frames: Frames = text.parse().unwrap();
            let told = frames.to_string();
            assert_eq!(told.parse::<Frames>().unwrap(), frames, "{told}");
        }
        let told = |text: &str| text.parse::<Frames>().unwrap().to_string();
        assert_eq!(told("1,2,3,5"), "1-3,5");
        assert_eq!(told("1,5,9"), "1-9x4");
        assert_eq!(told("3,1-4"), "3,1-2,4");
    }

    #[test]
    fn names_get_the_number_of_a_frame() {
        for (name, frame, given) in [
            ("out.####.exr", 7, "out.0007.exr"),
            ("out.##.exr", 123, "out.123.exr"),
            ("out.####.exr", -7, "out.-007.exr"),
            ("a/%04d/b.%d", 12, "a/0012/b.12"),
            ("x.$F4.vdb", 3, "x.0003.vdb"),
            ("x.$F.vdb", 3, "x.3.vdb"),
            ("x$F", 3, "x3"),
            ("####.####", 1, "0001.0001"),
            ("é.####", i32::MIN, "é.-2147483648"),
        ] {
            assert!(token_in(name).is_some(), "{name}");
            assert_eq!(at_frame(name, frame), given);
        }
        for plain in [
            "a#1.exr", "100%.exr", "%s", "%4d", "$FF", "$Fog.vdb", "%099d", "$", "%", "%0", "$F4x",
            "",
        ] {
            assert_eq!(token_in(plain), None, "{plain}");
            assert!(matches!(at_frame(plain, 5), Cow::Borrowed(same) if same == plain));
        }
        assert_eq!(token_in("a.###.b.$F"), Some("###"));
    }
}

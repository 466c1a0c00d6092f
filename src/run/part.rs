//! A part of some work, for several processes.

use crate::{Error, Result};
use std::fmt;
use std::ops::Range;
use std::str::FromStr;

/// One of the parts into which work is split. All parts together are the whole, to the bit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Part {
    index: u32,
    count: u32,
}

impl Part {
    /// All of it.
    pub const WHOLE: Self = Self { index: 0, count: 1 };

    /// Part `index` of `count`, counted from 0.
    ///
    /// # Errors
    /// An index that is not below the count.
    pub fn new(index: u32, count: u32) -> Result<Self> {
        if index < count {
            return Ok(Self { index, count });
        }
        Err(Error::input(format!("there is no part {index} of {count}"))
            .hint("parts are numbered from 0: `part` 0/4 is the first of four"))
    }

    /// Number of this part, from 0.
    #[must_use]
    pub fn index(self) -> u32 {
        self.index
    }

    /// Number of all parts.
    #[must_use]
    pub fn count(self) -> u32 {
        self.count
    }

    /// The part's share of `n` things.
    pub(crate) fn of(self, n: u64) -> Range<u64> {
        let at = |i: u32| (u128::from(n) * u128::from(i) / u128::from(self.count)) as u64;
        at(self.index)..at(self.index + 1)
    }
}

impl fmt::Display for Part {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.index, self.count)
    }
}

impl FromStr for Part {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        let numbers = text.split_once('/');
        match numbers.and_then(|(i, n)| Some((i.parse().ok()?, n.parse().ok()?))) {
            Some((index, count)) => Self::new(index, count),
            None => Err(Error::input(format!(
                "expected a part and a count, as 0/8, found {text:?}"
            ))),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_share_all_without_a_gap() {
        for count in [1, 2, 7, 64] {
            for n in [0, 1, 5, 1000, u64::MAX] {
                let mut end = 0;
                for index in 0..count {
                    let share = Part::new(index, count).unwrap().of(n);
                    assert_eq!(share.start, end);
                    end = share.end;
                }
                assert_eq!(end, n);
            }
        }
        assert!(Part::new(4, 4).is_err());
        assert!("4/4".parse::<Part>().is_err() && "a/4".parse::<Part>().is_err());
        assert_eq!("3/4".parse::<Part>().unwrap().to_string(), "3/4");
    }
}

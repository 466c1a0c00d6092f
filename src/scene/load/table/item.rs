//! The value of a key, as a type or an error that names its place.

use super::super::nearest::nearest;
use super::{Item, Table};
use crate::scene::builder::is_singular;
use crate::{Error, Result};
use glam::{DAffine3, DMat4, DVec3};
use std::fmt::LowerExp;
use toml::Spanned;
use toml::de::DeValue;

impl<'a> Item<'a> {
    /// An error about this value.
    pub(in crate::scene::load) fn error(&self, message: impl std::fmt::Display) -> Error {
        self.document.error(format!("{}: {message}", self.place))
    }

    /// Leads an error by the place of the value.
    pub(in crate::scene::load) fn locate(&self, error: Error) -> Error {
        error.at(format!("{}: {}", self.document.path.display(), self.place))
    }

    fn expected(&self, what: &str) -> Error {
        self.mismatch(what, self.value)
    }

    fn mismatch(&self, what: &str, found: &Spanned<DeValue<'_>>) -> Error {
        let range = found.span();
        let text = self.document.text.get(range).unwrap_or_default();
        let text: String = text.lines().next().unwrap_or_default().chars().collect();
        let short: String = text.chars().take(40).collect();
        let dots = if short.len() < text.len() { "…" } else { "" };
        self.error(format_args!(
            "expected {what}, found the {} {short}{dots}",
            found.get_ref().type_str()
        ))
    }

    /// A table in place, checked for unknown keys.
    pub(in crate::scene::load) fn table(&self, title: &str, known: &[&str]) -> Result<Table<'a>> {
        let entries = self.value.get_ref().as_table();
        let entries = entries.ok_or_else(|| self.expected("a table"))?;
        let at = self.document.at(self.value.span().start);
        self.document.table(title, at, entries, known)
    }

    /// Whether the value is a table.
    pub(in crate::scene::load) fn is_table(&self) -> bool {
        self.value.get_ref().is_table()
    }

    /// Whether the value is text.
    pub(in crate::scene::load) fn is_text(&self) -> bool {
        self.value.get_ref().is_str()
    }

    /// Whether the value is a list.
    pub(in crate::scene::load) fn is_list(&self) -> bool {
        self.value.get_ref().is_array()
    }

    /// Text.
    pub(in crate::scene::load) fn text(&self) -> Result<&'a str> {
        let text = self.value.get_ref().as_str();
        text.ok_or_else(|| self.expected("text in quotes"))
    }

    /// Text that is one of `choices`; its place among them.
    pub(in crate::scene::load) fn choice(&self, choices: &[&str]) -> Result<usize> {
        let text = self.text()?;
        choices.iter().position(|c| *c == text).ok_or_else(|| {
            let error = self.error(format_args!(
                "expected one of {}, found \"{text}\"",
                choices.join(", ")
            ));
            match nearest(text, choices) {
                Some(near) => error.hint(format!("did you mean \"{near}\"?")),
                None => error,
            }
        })
    }

    /// A list of texts that are among `choices`; their places there.
    pub(in crate::scene::load) fn choices(&self, choices: &[&str]) -> Result<Vec<usize>> {
        let array = self.value.get_ref().as_array();
        let array = array.ok_or_else(|| self.expected("a list of texts"))?;
        let items = array.iter().map(|value| Item {
            document: self.document,
            place: self.place.clone(),
            value,
        });
        items.map(|item| item.choice(choices)).collect()
    }

    /// `true` or `false`.
    pub(in crate::scene::load) fn flag(&self) -> Result<bool> {
        let flag = self.value.get_ref().as_bool();
        flag.ok_or_else(|| self.expected("true or false"))
    }

    /// A finite number.
    pub(in crate::scene::load) fn number(&self) -> Result<f64> {
        self.number_in(self.value)
    }

    /// A number from `low` to `high`.
    pub(in crate::scene::load) fn number_within(&self, low: f64, high: f64) -> Result<f64> {
        let number = self.number()?;
        if (low..=high).contains(&number) {
            Ok(number)
        } else {
            Err(self.error(format_args!(
                "expected a number from {} to {}, found {}",
                brief(low),
                brief(high),
                brief(number)
            )))
        }
    }

    /// A whole number from `low` to `high`.
    pub(in crate::scene::load) fn whole(&self, low: u64, high: u64) -> Result<u64> {
        let number = integer(self.value.get_ref())
            .ok_or_else(|| self.expected(&format!("a whole number from {low} to {high}")))?;
        u64::try_from(number)
            .ok()
            .filter(|n| (low..=high).contains(n))
            .ok_or_else(|| {
                self.error(format_args!(
                    "expected a whole number from {low} to {high}, found {number}"
                ))
            })
    }

    /// The number of a frame.
    pub(in crate::scene::load) fn frame(&self) -> Result<i32> {
        let number = integer(self.value.get_ref()).and_then(|n| i32::try_from(n).ok());
        number.ok_or_else(|| self.expected("the number of a frame"))
    }

    /// `N` finite numbers.
    pub(in crate::scene::load) fn numbers<const N: usize>(&self) -> Result<[f64; N]> {
        self.numbers_in(self.value)
    }

    /// Three whole numbers of at least 1.
    pub(in crate::scene::load) fn dims(&self) -> Result<[usize; 3]> {
        let what = "three whole numbers of at least 1";
        let wrong = || self.expected(what);
        let array = self.value.get_ref().as_array().ok_or_else(wrong)?;
        let dims: Vec<usize> = array
            .iter()
            .filter_map(|v| {
                integer(v.get_ref())
                    .and_then(|n| usize::try_from(n).ok())
                    .filter(|&n| n > 0)
            })
            .collect();
        match dims[..] {
            [x, y, z] if array.len() == 3 => Ok([x, y, z]),
            _ => Err(wrong()),
        }
    }

    /// A point or a vector.
    pub(in crate::scene::load) fn vector(&self) -> Result<DVec3> {
        Ok(DVec3::from(self.numbers::<3>()?))
    }

    /// A direction of any length above zero, brought to unit length.
    pub(in crate::scene::load) fn direction(&self) -> Result<DVec3> {
        let vector = self.vector()?;
        vector
            .try_normalize()
            .ok_or_else(|| self.error("expected a direction, found one of zero length"))
    }

    /// A linear RGB triple with every channel from 0 to `high`.
    pub(in crate::scene::load) fn color(&self, high: f32) -> Result<[f32; 3]> {
        self.color_in(self.value, high)
    }

    /// A list of lists of `N` finite numbers.
    pub(in crate::scene::load) fn rows<const N: usize>(&self, what: &str) -> Result<Vec<[f64; N]>> {
        let array = self.value.get_ref().as_array();
        let array = array.ok_or_else(|| self.expected(what))?;
        array.iter().map(|v| self.numbers_in(v)).collect()
    }

    /// A list of linear RGB triples with every channel from 0 to `high`.
    pub(in crate::scene::load) fn colors(&self, high: f32) -> Result<Vec<[f32; 3]>> {
        let array = self.value.get_ref().as_array();
        let array = array.ok_or_else(|| self.expected("a list of RGB triples"))?;
        array.iter().map(|v| self.color_in(v, high)).collect()
    }

    /// An invertible affine map as a 4x4 matrix: four rows, the last of them 0 0 0 1, for column
    /// vectors.
    pub(in crate::scene::load) fn affine(&self) -> Result<DAffine3> {
        let what = "a 4x4 matrix: four rows of four numbers";
        let array = self.value.get_ref().as_array();
        let array = array.ok_or_else(|| self.expected(what))?;
        if array.len() != 4 {
            return Err(self.expected(what));
        }
        let mut rows = [[0.0; 4]; 4];
        for (row, value) in rows.iter_mut().zip(array.iter()) {
            *row = self.numbers_in(value)?;
        }
        if rows[3] != [0.0, 0.0, 0.0, 1.0] {
            return Err(self.error(format_args!(
                "expected 0 0 0 1 as the last row, found {:?}",
                rows[3]
            )));
        }
        let map = DAffine3::from_mat4(DMat4::from_cols_array_2d(&rows).transpose());
        match is_singular(&map) {
            false => Ok(map),
            true => Err(self.error("the matrix is singular: it flattens space")),
        }
    }

    fn color_in(&self, value: &Spanned<DeValue<'_>>, high: f32) -> Result<[f32; 3]> {
        let numbers = match value.get_ref() {
            // Grey.
            DeValue::Integer(_) | DeValue::Float(_) => [self.number_in(value)?; 3],
            _ => self.numbers_in::<3>(value)?,
        };
        let color = numbers.map(|n| n as f32);
        if let Some(n) = numbers.iter().find(|n| **n < 0.0) {
            return Err(self.error(format_args!("{} is negative", brief(*n))));
        }
        if let Some(i) = (0..3).find(|&i| !color[i].is_finite() || color[i] > high) {
            return Err(self.error(format_args!(
                "expected three numbers from 0 to {}, found {}",
                brief(high),
                brief(numbers[i])
            )));
        }
        Ok(color)
    }

    fn numbers_in<const N: usize>(&self, value: &Spanned<DeValue<'_>>) -> Result<[f64; N]> {
        let what = format!("{N} numbers in brackets");
        let array = value.get_ref().as_array();
        let array = array.ok_or_else(|| self.mismatch(&what, value))?;
        if array.len() != N {
            return Err(self.error(format_args!("expected {what}, found {}", array.len())));
        }
        let mut numbers = [0.0; N];
        for (number, value) in numbers.iter_mut().zip(array.iter()) {
            *number = self.number_in(value)?;
        }
        Ok(numbers)
    }

    fn number_in(&self, value: &Spanned<DeValue<'_>>) -> Result<f64> {
        let wrong = || self.mismatch("a number", value);
        let number = match value.get_ref() {
            DeValue::Integer(_) => integer(value.get_ref()).ok_or_else(wrong)? as f64,
            DeValue::Float(f) => f.as_str().parse::<f64>().map_err(|_| wrong())?,
            _ => return Err(wrong()),
        };
        if number.is_finite() {
            Ok(number)
        } else {
            Err(self.mismatch("a finite number", value))
        }
    }
}

/// A number in few digits, whatever its size.
fn brief(number: impl Into<f64> + LowerExp + ToString + Copy) -> String {
    let size = number.into().abs();
    if size == 0.0 || (1e-5..1e15).contains(&size) {
        number.to_string()
    } else {
        format!("{number:e}")
    }
}

fn integer(value: &DeValue<'_>) -> Option<i64> {
    let integer = value.as_integer()?;
    i64::from_str_radix(integer.as_str(), integer.radix()).ok()
}

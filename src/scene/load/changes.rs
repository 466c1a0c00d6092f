//! Changes of single values of a scene file, made as it is read.

use super::nearest::nearest;
use crate::{Error, Result};
use std::borrow::Cow;
use std::ops::Range;
use std::str::FromStr;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// A value for a key of a scene file: of a TOML file by its path, as `light.0.intensity`, with
/// lists by number or by the name of an entry; of a Mitsuba file for the parameter `$key`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Change {
    /// Which value.
    pub key: String,
    /// What it becomes, as it would stand in the file; text needs no quotes.
    pub value: String,
}

impl FromStr for Change {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        let pair = text.split_once('=').map(|(key, value)| (key.trim(), value));
        let pair = pair.filter(|(key, _)| key.split('.').all(|part| !part.is_empty()));
        match pair {
            Some((key, value)) => Ok(Self {
                key: key.into(),
                value: value.trim().into(),
            }),
            None => Err(Error::input(format!(
                "expected a key and a value, as in film.width=320, found {text}"
            ))),
        }
    }
}

/// The text of a scene file with the values of all changes behind it, and where each of these is.
pub(super) fn append(text: &str, changes: &[Change]) -> (String, Vec<Range<usize>>) {
    let mut all = text.to_owned();
    let places = changes.iter().map(|change| {
        all.push('\n');
        let start = all.len();
        all += &change.value;
        start..all.len()
    });
    let places = places.collect();
    (all, places)
}

/// Puts a value, which stands at `place` of the text of all, into a document.
///
/// # Errors
/// A key that leads nowhere, or a list or a table that cannot be parsed.
pub(super) fn apply<'a>(
    root: &mut DeTable<'a>,
    change: &'a Change,
    text: &'a str,
    place: &Range<usize>,
) -> Result<()> {
    let parts: Vec<&str> = change.key.split('.').collect();
    let place = Place {
        parts: &parts,
        key: &change.key,
        at: place.clone(),
    };
    let value = value(&text[place.at.clone()], &place)?;
    place.put_in_table(root, 0, value)
}

/// The value as TOML; what is no TOML is text.
fn value<'a>(text: &'a str, place: &Place<'_, '_>) -> Result<Spanned<DeValue<'a>>> {
    let parsed = match DeValue::parse(text) {
        Ok(parsed) => shifted(parsed, place.at.start),
        Err(e) if text.starts_with(['[', '{', '"', '\'']) => {
            let key = place.key;
            return Err(Error::input(format!(
                "`set` {key}: {text} is not valid TOML: {}",
                e.message()
            )));
        }
        Err(_) => Spanned::new(place.at.clone(), DeValue::String(Cow::Borrowed(text))),
    };
    Ok(parsed)
}

/// A value whose places are counted from `by`.
fn shifted(value: Spanned<DeValue<'_>>, by: usize) -> Spanned<DeValue<'_>> {
    let moved = |span: Range<usize>| span.start + by..span.end + by;
    let span = moved(value.span());
    let value = match value.into_inner() {
        DeValue::Array(mut array) => {
            let none = || Spanned::new(0..0, DeValue::Boolean(false));
            let entries = array
                .iter_mut()
                .map(|entry| std::mem::replace(entry, none()));
            DeValue::Array(entries.map(|entry| shifted(entry, by)).collect())
        }
        DeValue::Table(table) => {
            let entries = table.into_iter().map(|(key, value)| {
                let key = Spanned::new(moved(key.span()), key.into_inner());
                (key, shifted(value, by))
            });
            DeValue::Table(entries.collect())
        }
        other => other,
    };
    Spanned::new(span, value)
}

/// A key by its parts, and where its value is in the text.
struct Place<'k, 'a> {
    parts: &'k [&'a str],
    key: &'a str,
    at: Range<usize>,
}

impl<'a> Place<'_, 'a> {
    fn put_in_table(
        &self,
        table: &mut DeTable<'a>,
        depth: usize,
        value: Spanned<DeValue<'a>>,
    ) -> Result<()> {
        let part = self.parts[depth];
        let name = || Spanned::new(self.at.clone(), Cow::Borrowed(part));
        let is_last = depth + 1 == self.parts.len();
        if is_last {
            table.remove(part);
            table.insert(name(), value);
            return Ok(());
        }
        // A table as [film] may be left out of a scene.
        let is_table =
            depth + 2 == self.parts.len() && self.parts[depth + 1].parse::<u32>().is_err();
        if !table.contains_key(part) && is_table && part == "film" {
            let empty = Spanned::new(self.at.clone(), DeValue::Table(DeTable::new()));
            table.insert(name(), empty);
        }
        let names: Vec<&str> = table.keys().map(|key| key.get_ref().as_ref()).collect();
        let missing = self.missing(depth, part, &names);
        let Some(inner) = table.get_mut(part) else {
            return Err(missing);
        };
        self.put(inner.get_mut(), depth + 1, value)
    }

    fn put(&self, into: &mut DeValue<'a>, depth: usize, value: Spanned<DeValue<'a>>) -> Result<()> {
        let part = self.parts[depth];
        match into {
            DeValue::Table(table) => self.put_in_table(table, depth, value),
            DeValue::Array(array) => {
                let names: Vec<String> = array.iter().enumerate().map(name_of).collect();
                let by_name = || names.iter().position(|name| name == part);
                let number = by_name().or_else(|| part.parse().ok());
                let Some(entry) = number.and_then(|i| array.get_mut(i)) else {
                    return Err(self.missing_entry(depth, array, &names));
                };
                match depth + 1 == self.parts.len() {
                    true => {
                        *entry = value;
                        Ok(())
                    }
                    false => self.put(entry.get_mut(), depth + 1, value),
                }
            }
            other => {
                let (before, found) = (self.parts[..depth].join("."), other.type_str());
                Err(Error::input(format!(
                    "`set` {}: there is nothing below `{before}`, which is of type {found}",
                    self.key
                )))
            }
        }
    }

    /// An error for a part of the key that names no entry of a list: of a list of tables it may be
    /// a key of these.
    fn missing_entry(
        &self,
        depth: usize,
        entries: &[Spanned<DeValue<'_>>],
        names: &[String],
    ) -> Error {
        let others: Vec<&str> = names.iter().map(String::as_str).collect();
        let error = self.missing(depth, self.parts[depth], &others);
        let is_table = |entry: &Spanned<DeValue<'_>>| entry.get_ref().as_table().is_some();
        match (names.first(), self.parts[depth].parse::<u32>()) {
            (Some(first), Err(_))
                if entries.iter().all(is_table) && depth + 1 == self.parts.len() =>
            {
                let (before, key) = (self.parts[..depth].join("."), self.parts[depth]);
                error.hint(format!(
                    "name one of {}, as in {before}.{first}.{key}",
                    names.join(", ")
                ))
            }
            _ => error,
        }
    }

    /// An error for a part of the key that is not there, but others are.
    fn missing(&self, depth: usize, part: &str, others: &[&str]) -> Error {
        let place = match depth {
            0 => "the scene".to_owned(),
            _ => format!("`{}`", self.parts[..depth].join(".")),
        };
        let error = Error::input(format!("`set` {}: {place} has no `{part}`", self.key));
        let is_number = part.parse::<u32>().is_ok();
        match nearest(part, others).filter(|_| !is_number) {
            Some(near) => error.hint(format!("did you mean `{near}`?")),
            None if others.is_empty() => error,
            None => error.hint(format!("it has {}", others.join(", "))),
        }
    }
}

/// The name of an entry of a list, or else its number, counted from 0.
fn name_of((number, entry): (usize, &Spanned<DeValue<'_>>)) -> String {
    let table = entry.get_ref().as_table();
    let name = table.and_then(|table| table.get("name"));
    let name = name.and_then(|name| name.get_ref().as_str());
    name.map_or_else(|| number.to_string(), str::to_owned)
}

//! Typed access to a TOML document that remembers where everything stands, so that every message
//! can name the line.

mod item;

use super::changes::{self, Change};
use super::nearest::nearest;
use crate::run::size;
use crate::{Error, Result};
use std::fs;
use std::ops::Range;
use std::path::Path;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// Bytes of a document.
const MAX_BYTES: u64 = 64 << 20;
/// Values in all lists of a document, of some 150 bytes each once parsed.
const MAX_VALUES: usize = 4 << 20;
/// Marks in a document, each of which is a word to the parser.
const MAX_MARKS: usize = 16 << 20;
/// What to do with a larger one.
const LARGE: &str = "put what is large into mesh and volume files, and name these in the scene";

/// Refuses a document by the size of its file, before it is read; what cannot be found out is for
/// the reader to tell.
pub(in crate::scene::load) fn check_bytes(path: &Path) -> Result<()> {
    let found = fs::metadata(path).map_or(0, |m| m.len());
    if found <= MAX_BYTES {
        return Ok(());
    }
    let (most, found) = (size::format(MAX_BYTES), size::format(found));
    Err(Error::input(format!(
        "{}: expected a scene description of at most {most}, found {found}",
        path.display()
    ))
    .hint(LARGE))
}

/// A TOML document: its text and where it came from.
pub(in crate::scene::load) struct Document<'a> {
    path: &'a Path,
    text: &'a str,
    /// Where the file ends in the text; behind it are the values of changes.
    end: usize,
    changes: &'a [Change],
    /// Where the values of the changes are in the text.
    changed: Vec<Range<usize>>,
    /// Where lines end, in bytes: every value asks for its line.
    line_ends: Vec<usize>,
}

/// One table of a document. All its keys are known ones.
pub(in crate::scene::load) struct Table<'a> {
    document: &'a Document<'a>,
    title: String,
    /// Where it is: a line, or a change.
    at: String,
    entries: &'a DeTable<'a>,
}

/// The value of a key.
pub(in crate::scene::load) struct Item<'a> {
    document: &'a Document<'a>,
    place: String,
    value: &'a Spanned<DeValue<'a>>,
}

impl<'a> Document<'a> {
    /// Names the text for messages.
    #[cfg(test)]
    pub(in crate::scene::load) fn new(path: &'a Path, text: &'a str) -> Self {
        Self::changed(path, text, text.len(), &[], Vec::new())
    }

    /// A file of which some values are changed: its text up to `end`, and behind it, where
    /// `changed` says, the values.
    pub(in crate::scene::load) fn changed(
        path: &'a Path,
        text: &'a str,
        end: usize,
        changes: &'a [Change],
        changed: Vec<Range<usize>>,
    ) -> Self {
        let bytes = text.bytes().enumerate();
        Self {
            path,
            text,
            end,
            changes,
            changed,
            line_ends: bytes
                .filter_map(|(i, b)| (b == b'\n').then_some(i))
                .collect(),
        }
    }

    /// Parses the text; hand the result to [`Document::root`].
    pub(in crate::scene::load) fn parse(&self) -> Result<Spanned<DeTable<'a>>> {
        self.check_size()?;
        let mut parsed = DeTable::parse(&self.text[..self.end]).map_err(|e| {
            let at = self.at(e.span().map_or(0, |s| s.start));
            let error = self.error(format!("not valid TOML {at}: {}", e.message()));
            let line = e.span().map_or("", |s| self.line(s.start));
            // Of `[mesh]` and `[[mesh]]` the parser says that a key is there twice.
            let title = line.trim_start_matches('[').split(']').next();
            match title.filter(|_| line.starts_with('[') && e.message().contains("duplicate key")) {
                Some(title) => error.hint(format!(
                    "where there may be many, each begins with [[{title}]]"
                )),
                None => error,
            }
        })?;
        for (change, place) in self.changes.iter().zip(&self.changed) {
            changes::apply(parsed.get_mut(), change, self.text, place)
                .map_err(|e| e.at(self.path.display()))?;
        }
        Ok(parsed)
    }

    /// Refuses what would take far more memory than a description is worth.
    fn check_size(&self) -> Result<()> {
        let count = |is_one: fn(&&u8) -> bool| self.text.as_bytes().iter().filter(is_one).count();
        let values = count(|&&b| b == b',');
        let marks = count(|b| b",\n[]{}=.\"'#".contains(b));
        for (what, found, most) in [("values", values, MAX_VALUES), ("marks", marks, MAX_MARKS)] {
            if found > most {
                let message = format!("expected at most {most} {what}, found {found}");
                return Err(self.error(message).hint(LARGE));
            }
        }
        Ok(())
    }

    /// The top of the document; an error if it has a key that is not in `known`.
    pub(in crate::scene::load) fn root(
        &'a self,
        parsed: &'a Spanned<DeTable<'a>>,
        known: &[&str],
    ) -> Result<Table<'a>> {
        self.table("the scene", self.at(0), parsed.get_ref(), known)
    }

    fn table(
        &'a self,
        title: &str,
        at: String,
        entries: &'a DeTable<'a>,
        known: &[&str],
    ) -> Result<Table<'a>> {
        for (key, _) in entries {
            let name = key.get_ref().as_ref();
            if !known.contains(&name) {
                let at = self.at(key.span().start);
                let error = self.error(format!("unknown key `{name}` in {title} {at}"));
                return Err(match nearest(name, known) {
                    Some(near) => error.hint(format!("did you mean `{near}`?")),
                    None => error.hint(format!("the keys of {title} are {}", known.join(", "))),
                });
            }
        }
        Ok(Table {
            document: self,
            title: title.into(),
            at,
            entries,
        })
    }

    /// The line around a byte of the text.
    fn line(&self, byte: usize) -> &'a str {
        let start = self.text[..byte].rfind('\n').map_or(0, |end| end + 1);
        self.text[start..].lines().next().unwrap_or("").trim()
    }

    fn error(&self, message: String) -> Error {
        Error::input(format!("{}: {message}", self.path.display()))
    }

    /// Where a byte of the text stands.
    fn at(&self, byte: usize) -> String {
        let is_of = |place: &Range<usize>| byte > self.end && byte <= place.end;
        match self.changed.iter().position(is_of) {
            Some(change) => format!("by `set` {}", self.changes[change].key),
            None => {
                let line = 1 + self.line_ends.partition_point(|&end| end < byte);
                format!("at line {line}")
            }
        }
    }
}

impl<'a> Table<'a> {
    /// The value of a key, if the key is there.
    pub(in crate::scene::load) fn get(&self, key: &str) -> Option<Item<'a>> {
        let (name, value) = self.entries.get_key_value(key)?;
        Some(Item {
            document: self.document,
            place: format!(
                "`{key}` in {} {}",
                self.title,
                self.document.at(name.span().start)
            ),
            value,
        })
    }

    /// What stands in the document for each of the keys that are there.
    pub(in crate::scene::load) fn texts(&self, keys: &[&str]) -> Vec<Option<&'a str>> {
        let text = |key: &&str| self.document.text.get(self.entries.get(*key)?.span());
        keys.iter().map(text).collect()
    }

    /// The value of a key that must be there.
    pub(in crate::scene::load) fn require(&self, key: &str) -> Result<Item<'a>> {
        self.get(key)
            .ok_or_else(|| self.error(format!("`{key}` is missing")))
    }

    /// An error if more than one of `keys` is there; they say the same thing in different ways.
    pub(in crate::scene::load) fn exclusive(&self, keys: &[&str]) -> Result<()> {
        let given: Vec<_> = keys
            .iter()
            .filter(|&&k| self.entries.contains_key(k))
            .collect();
        match given[..] {
            [a, b, ..] => Err(self.error(format!("`{a}` and `{b}` exclude each other"))),
            _ => Ok(()),
        }
    }

    /// An error about the table as a whole.
    pub(in crate::scene::load) fn error(&self, message: impl std::fmt::Display) -> Error {
        self.document
            .error(format!("{} {}: {message}", self.title, self.at))
    }

    /// Leads an error by the place of the table.
    pub(in crate::scene::load) fn locate(&self, error: Error) -> Error {
        error.at(format!(
            "{}: {} {}",
            self.document.path.display(),
            self.title,
            self.at
        ))
    }

    /// The tables of `[[key]]`, checked for unknown keys; empty if there are none.
    pub(in crate::scene::load) fn tables(
        &self,
        key: &str,
        known: &[&str],
    ) -> Result<Vec<Table<'a>>> {
        let Some(item) = self.get(key) else {
            return Ok(Vec::new());
        };
        let title = format!("[[{key}]]");
        let wrong = || item.error(format_args!("expected tables, written as {title}"));
        let array = item.value.get_ref().as_array().ok_or_else(wrong)?;
        array
            .iter()
            .map(|entry| {
                let entries = entry.get_ref().as_table().ok_or_else(wrong)?;
                let at = self.document.at(entry.span().start);
                self.document.table(&title, at, entries, known)
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fails(text: &str, read: impl Fn(&Table<'_>) -> Result<()>) -> (String, Option<String>) {
        let document = Document::new(Path::new("s.toml"), text);
        let parsed = document.parse().unwrap();
        let error = document
            .root(&parsed, &["number", "color", "matrix", "mesh"])
            .and_then(|root| read(&root))
            .unwrap_err();
        (error.to_string(), error.hint_text().map(String::from))
    }

    #[test]
    fn an_unknown_key_names_its_line_and_the_nearest_key() {
        let (message, hint) = fails("\n[[mesh]]\nfile = 'a'\nalbdo = 1\n", |root| {
            root.tables("mesh", &["file", "albedo"]).map(|_| ())
        });
        assert_eq!(message, "s.toml: unknown key `albdo` in [[mesh]] at line 4");
        assert_eq!(hint.as_deref(), Some("did you mean `albedo`?"));
    }

    #[test]
    fn a_far_off_key_lists_the_choices() {
        let (_, hint) = fails("[[mesh]]\nzzzzzzzz = 1\n", |root| {
            root.tables("mesh", &["file", "albedo"]).map(|_| ())
        });
        assert_eq!(
            hint.as_deref(),
            Some("the keys of [[mesh]] are file, albedo")
        );
    }

    #[test]
    fn values_of_the_wrong_type_or_range_say_what_was_found() {
        let get = |key: &'static str, read: fn(Item<'_>) -> Result<()>| {
            move |root: &Table<'_>| read(root.require(key)?)
        };
        let number = get("number", |i| i.number().map(|_| ()));
        assert!(
            fails("number = 'x'", number)
                .0
                .ends_with("at line 1: expected a number, found the string 'x'")
        );
        assert!(
            fails("number = nan", number)
                .0
                .contains("expected a finite number, found the float nan")
        );
        assert!(fails("mesh = 1", number).0.contains("`number` is missing"));
        let color = get("color", |i| i.color(1.0).map(|_| ()));
        assert!(
            fails("color = [0, 0.5, 2]", color)
                .0
                .contains("numbers from 0 to 1, found 2")
        );
        for color_text in ["color = [0, 1e300, 2]", "color = [0, -1e300, 2]"] {
            let (message, _) = fails(color_text, color);
            assert!(
                message.contains("1e300") && message.len() < 100,
                "{message}"
            );
        }
        assert!(
            fails("color = [0, -0.5, 2]", color)
                .0
                .contains("-0.5 is negative")
        );
        assert!(
            fails("color = [0, 1]", color)
                .0
                .contains("expected 3 numbers in brackets, found 2")
        );
        let matrix = get("matrix", |i| i.affine().map(|_| ()));
        assert!(
            fails("matrix = [[1,0,0,0],[0,0,0,0],[0,0,1,0],[0,0,0,1]]", matrix)
                .0
                .contains("singular")
        );
        assert!(
            fails("matrix = [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,2]]", matrix)
                .0
                .contains("last row")
        );
    }

    #[test]
    fn words_are_mended_by_the_nearest_known_one() {
        assert_eq!(nearest("albdo", &["albedo", "file"]), Some("albedo"));
        assert_eq!(nearest("flie", &["albedo", "file"]), Some("file"));
        assert_eq!(nearest("", &["file"]), None);
        assert_eq!(nearest("emision", &["file", "emission"]), Some("emission"));
        assert_eq!(nearest("qqq", &["file", "emission"]), None);
    }
}

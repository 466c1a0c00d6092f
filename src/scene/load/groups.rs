//! Groups of lights, and scenes that are lit by one of them.

use super::table::Table;
use crate::{Error, Result};

/// Name of the group of lights that are in none.
pub const DEFAULT: &str = "default";
/// Most letters of a name: it becomes a part of the names of layers.
const MOST_LETTERS: usize = 64;

/// Whether this may be the name of a group: letters, digits, `-` and `_`.
#[must_use]
pub fn is_name(text: &str) -> bool {
    let is_letter = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
    (1..=MOST_LETTERS).contains(&text.len()) && text.chars().all(is_letter)
}

/// The groups that lights of a scene are in, and the one that is to light it.
#[derive(Debug, Default)]
pub struct Groups {
    /// In the order in which the scene file names them.
    names: Vec<String>,
    wanted: Option<String>,
}

impl Groups {
    /// No groups yet; `wanted` is the one that is to light the scene, if not all are.
    pub fn new(wanted: Option<&str>) -> Self {
        Self {
            names: Vec::new(),
            wanted: wanted.map(Into::into),
        }
    }

    /// Notes the group of the light that a table is of; tells whether it is to light the scene.
    pub fn add(&mut self, table: &Table<'_>) -> Result<bool> {
        let name = match table.get("group") {
            None => DEFAULT,
            Some(item) => {
                let name = item.text()?;
                if !is_name(name) || name == DEFAULT {
                    let expected = format!(
                        "expected a name of letters, digits, - and _ other than \"{DEFAULT}\", \
                         found \"{name}\""
                    );
                    return Err(item.error(expected));
                }
                name
            }
        };
        Ok(self.add_named(name))
    }

    /// The same of light that no table is of.
    pub fn add_default(&mut self) -> bool {
        self.add_named(DEFAULT)
    }

    fn add_named(&mut self, name: &str) -> bool {
        if !self.names.iter().any(|n| n == name) {
            self.names.push(name.into());
        }
        self.wanted.as_deref().is_none_or(|w| w == name)
    }

    /// The groups that there are, of which the wanted one is one.
    ///
    /// # Errors
    /// One that is wanted and not there.
    pub fn finish(self) -> Result<Vec<String>> {
        match self.wanted {
            Some(wanted) if !self.names.contains(&wanted) => Err(missing(&wanted, &self.names)),
            _ => Ok(self.names),
        }
    }
}

/// The error for a group that is not there.
pub fn missing(wanted: &str, names: &[String]) -> Error {
    let found = match names {
        [] => "no lights".into(),
        names => names.join(", "),
    };
    Error::input(format!(
        "`group` {wanted}: expected a group of the scene's lights, found {found}"
    ))
    .hint("add `group = \"NAME\"` to lights, meshes that emit and emissions of volumes")
}

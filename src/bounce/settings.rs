//! How light is bounced.

use crate::formats::TreeMeta;
use crate::{Error, Result};
use std::fmt;

/// How to bounce light between surfaces.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Settings {
    /// The bounces that a frame shaded from the new tree has.
    pub bounces: Bounces,
    /// Rays of each receiver.
    pub samples: u32,
    /// Key of all random choices.
    pub seed: u64,
}

/// A number of bounces.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub enum Bounces {
    /// Until what is left of the light no longer counts.
    #[default]
    All,
    /// So many, the one that a frame gathers included: at least one, which leaves a tree as it is.
    Count(u32),
}

impl fmt::Display for Bounces {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::All => f.write_str("all"),
            Self::Count(n) => write!(f, "{n}"),
        }
    }
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            bounces: Bounces::All,
            samples: 16,
            seed: 0,
        }
    }
}

impl Settings {
    /// Refuses settings that make no sense.
    ///
    /// # Errors
    /// Names the setting, what it may be and what it was.
    pub fn check(&self) -> Result<()> {
        if let Bounces::Count(n) = self.bounces
            && !(1..=10_000).contains(&n)
        {
            return Err(Error::input(format!(
                "`bounces` must be 1 to 10000 or all, found {n}"
            )));
        }
        if !(1..=65_536).contains(&self.samples) {
            return Err(Error::input(format!(
                "`samples` must be 1 to 65536, found {}",
                self.samples
            )));
        }
        Ok(())
    }

    /// Names and values, as they are kept in the tree.
    #[must_use]
    pub fn listed(&self) -> Vec<(String, String)> {
        let entry = |name: &str, value: String| (name.to_owned(), value);
        vec![
            entry(TreeMeta::BOUNCES, self.bounces.to_string()),
            entry("bounce-samples", self.samples.to_string()),
            entry("bounce-seed", self.seed.to_string()),
        ]
    }
}

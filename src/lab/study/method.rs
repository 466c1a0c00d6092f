//! The ways to render that a study measures side by side.

use crate::shade;
use serde::Serialize;
use std::fmt;

/// A way to render. In files it goes by its name.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, serde::Deserialize)]
pub enum Method {
    /// Path tracing.
    #[default]
    #[serde(rename = "monte carlo")]
    MonteCarlo,
    /// [`shade::Method::Traditional`].
    #[serde(rename = "traditional")]
    Traditional,
    /// [`shade::Method::Extended`].
    #[serde(rename = "extended")]
    Extended,
}

impl Method {
    /// All, in the order of reports.
    pub const ALL: [Self; 3] = [Self::MonteCarlo, Self::Traditional, Self::Extended];
}

impl From<shade::Method> for Method {
    fn from(method: shade::Method) -> Self {
        match method {
            shade::Method::Traditional => Self::Traditional,
            shade::Method::Extended => Self::Extended,
        }
    }
}

impl fmt::Display for Method {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.serialize(f)
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::assert_names;
    use super::*;

    #[test]
    fn files_have_the_names_and_no_others() {
        assert_names([
            (Method::MonteCarlo, "monte carlo"),
            (Method::Traditional, "traditional"),
            (Method::Extended, "extended"),
        ]);
        serde_json::from_str::<Method>("\"photons\"").unwrap_err();
    }
}

//! The ways to render that a study measures side by side.

use crate::shade;
use std::fmt;

/// A way to render. In files it goes by its name.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
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

    /// Its name in files and reports.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::MonteCarlo => "monte carlo",
            Self::Traditional => "traditional",
            Self::Extended => "extended",
        }
    }
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
        f.pad(self.name())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_have_the_names_and_no_others() {
        for method in Method::ALL {
            let json = serde_json::to_value(method).unwrap();
            assert_eq!(json, method.name());
            assert_eq!(serde_json::from_value::<Method>(json).unwrap(), method);
        }
        serde_json::from_str::<Method>("\"photons\"").unwrap_err();
    }
}

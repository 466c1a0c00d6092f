//! What a user hands to a study beside its reference: images of other renderers, and the noise of
//! the reference.

use crate::{Error, Result};
use std::path::PathBuf;

/// An image of another renderer, and the CPU seconds that it took.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct PeerImage {
    /// Name of the renderer.
    pub name: String,
    /// The image.
    pub path: PathBuf,
    /// CPU seconds of all threads.
    pub cpu_secs: f64,
}

/// Points of all peers, at most: more are no plot.
pub const MAX_PEERS: usize = 4096;

/// The noise of a reference, relMSE against the truth.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub enum Noise {
    /// A number.
    Given(f64),
    /// Half the relMSE between it and this image of other samples and as many.
    Image(PathBuf),
}

impl std::str::FromStr for Noise {
    type Err = Error;

    /// A number, or the name of an image.
    fn from_str(text: &str) -> Result<Self> {
        match text.parse::<f64>() {
            Ok(value) if value.is_finite() && value >= 0.0 => Ok(Self::Given(value)),
            Ok(_) => {
                let what = format!("expected a relMSE of at least 0, or an image, found `{text}`");
                Err(Error::input(what))
            }
            Err(_) => Ok(Self::Image(text.into())),
        }
    }
}

impl std::str::FromStr for PeerImage {
    type Err = Error;

    /// Of `NAME=IMAGE,SECONDS`.
    fn from_str(text: &str) -> Result<Self> {
        let wrong = || {
            let hint = "for example Mitsuba=mitsuba-64.exr,3.2";
            Error::input(format!("expected NAME=IMAGE,SECONDS, found `{text}`")).hint(hint)
        };
        let (name, rest) = text.split_once('=').ok_or_else(wrong)?;
        let (path, secs) = rest.rsplit_once(',').ok_or_else(wrong)?;
        let cpu_secs: f64 = secs.trim().parse().map_err(|_| wrong())?;
        if name.trim().is_empty() || path.is_empty() {
            return Err(wrong());
        }
        if !is_positive(cpu_secs) {
            return Err(Error::input(format!(
                "expected seconds above 0, found `{}`",
                secs.trim()
            )));
        }
        Ok(Self {
            name: name.trim().into(),
            path: path.into(),
            cpu_secs,
        })
    }
}

/// Whether it is a number above 0.
pub fn is_positive(value: f64) -> bool {
    value.is_finite() && value > 0.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn images_are_named_with_seconds() {
        let peer: PeerImage = "Mitsuba 3=out/a=b,c.exr, 3.5".parse().unwrap();
        assert_eq!((peer.name.as_str(), peer.cpu_secs), ("Mitsuba 3", 3.5));
        assert_eq!(peer.path, PathBuf::from("out/a=b,c.exr"));
        for wrong in [
            "a.exr,3",
            "a=a.exr",
            "a=a.exr,x",
            "=a.exr,3",
            "a=,3",
            "a=a.exr,-1",
            "a=a.exr,inf",
        ] {
            wrong.parse::<PeerImage>().unwrap_err();
        }
    }
}

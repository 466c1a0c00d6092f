//! The subject of a picture, as far as its header tells it: pictures of different subjects are no
//! measure of each other.

use serde_json::Value;
use std::collections::BTreeMap;

/// The scene of a picture, the camera, and how much of the light. Pictures of other programs tell
/// nothing.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Subject {
    /// Digest of the scene's files.
    pub scene: Option<String>,
    /// Name of the camera.
    pub camera: Option<String>,
    /// Most segments of a path of light from camera to source; 0 for no limit.
    pub segments: Option<u32>,
}

/// Segments of paths that shading counts unless a picture tells others: direct light, and one
/// bounce from the tree.
pub const SHADED_SEGMENTS: u32 = 3;

impl Subject {
    /// Finds the subject in the text attributes of an OpenEXR file.
    #[must_use]
    pub fn of(attributes: &BTreeMap<String, String>) -> Self {
        let text = |name: &str| attributes.get(name).map(String::as_str);
        let settings: Value = text("lvox/settings")
            .and_then(|s| serde_json::from_str(s).ok())
            .unwrap_or_default();
        let segments = match settings.get("max_depth") {
            Some(depth) => depth.as_u64().and_then(|d| u32::try_from(d).ok()),
            None => text("lvox/tree").map(|_| {
                let told = text("lvox/segments").and_then(|s| s.parse().ok());
                told.unwrap_or(SHADED_SEGMENTS)
            }),
        };
        let camera = settings.get("camera").and_then(Value::as_str);
        Self {
            scene: text("lvox/scene").map(Into::into),
            camera: camera.map(Into::into),
            segments,
        }
    }

    /// Tells in words where two subjects differ, of what both tell.
    #[must_use]
    pub fn differences(&self, other: &Self) -> Vec<String> {
        let mut found = Vec::new();
        if let (Some(here), Some(there)) = (&self.scene, &other.scene)
            && here != there
        {
            let short = |hash: &str| hash.chars().take(8).collect::<String>();
            let (here, there) = (short(here), short(there));
            found.push(format!("scene: files of digest {here}… and {there}…"));
        }
        if let (Some(here), Some(there)) = (&self.camera, &other.camera)
            && here != there
        {
            found.push(format!("camera: `{here}` and `{there}`"));
        }
        if let (Some(here), Some(there)) = (self.segments, other.segments)
            && here != there
        {
            let (here, there) = (segments(here), segments(there));
            found.push(format!("transport: {here} and {there}"));
        }
        found
    }
}

fn segments(count: u32) -> String {
    match count {
        0 => "paths of any length".into(),
        1 => "paths of 1 segment".into(),
        n => format!("paths of up to {n} segments"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn subject(attributes: &[(&str, &str)]) -> Subject {
        let owned = attributes
            .iter()
            .map(|(n, v)| ((*n).to_owned(), (*v).to_owned()));
        Subject::of(&owned.collect())
    }

    #[test]
    fn only_what_both_tell_can_differ() {
        let traced = subject(&[
            ("lvox/scene", "0123456789"),
            ("lvox/settings", r#"{"camera":"front","max_depth":0}"#),
        ]);
        assert_eq!(traced.segments, Some(0));
        let shaded = |scene, settings| {
            subject(&[
                ("lvox/scene", scene),
                ("lvox/tree", "ff"),
                ("lvox/settings", settings),
            ])
        };
        let same = shaded("0123456789", r#"{"camera":"front","samples":8}"#);
        let found = traced.differences(&same);
        assert_eq!(
            found,
            ["transport: paths of any length and paths of up to 3 segments"]
        );
        let bounced = subject(&[
            ("lvox/tree", "ff"),
            ("lvox/segments", "0"),
            ("lvox/settings", "{}"),
        ]);
        assert_eq!(bounced.differences(&traced), [""; 0]);
        let other = shaded("9876543210", r#"{"camera":"back"}"#);
        let found = same.differences(&other);
        assert_eq!(found.len(), 2, "{found:?}");
        assert!(found[0].contains("01234567… and 98765432…"), "{found:?}");
        assert!(found[1].contains("`front` and `back`"), "{found:?}");
        for foreign in [
            subject(&[]),
            subject(&[("lvox/settings", "{"), ("software", "other")]),
        ] {
            assert_eq!(foreign, Subject::default());
            assert!(traced.differences(&foreign).is_empty());
            assert!(foreign.differences(&traced).is_empty());
        }
    }
}

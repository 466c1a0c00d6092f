//! What a reader leaves out of a file, or takes otherwise than the file says: a sentence for each
//! kind, whatever the number.

use super::files::Files;
use std::collections::BTreeSet;
use std::fmt::Display;
use std::path::Path;

/// Places that a sentence names.
const NAMED_PLACES: usize = 8;

/// A way in which a material is not diffuse, which is all that surfaces are. The order is that of
/// the sentence.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum SurfaceFeature {
    Mirror,
    Glass,
    Metal,
    Highlight,
    Coat,
    Sheen,
    Bump,
}

impl SurfaceFeature {
    fn name(self) -> &'static str {
        match self {
            Self::Mirror => "mirrors",
            Self::Glass => "glass",
            Self::Metal => "metal",
            Self::Highlight => "highlights",
            Self::Coat => "clear coats",
            Self::Sheen => "sheen",
            Self::Bump => "bumps and normal maps",
        }
    }
}

/// What was left out of one file so far.
#[derive(Debug, Default)]
pub(super) struct LeftOut {
    notes: Vec<Note>,
    /// Features by the number of the material that has them.
    features: BTreeSet<(SurfaceFeature, usize)>,
}

/// A kind of thing that was left out.
#[derive(Debug)]
struct Note {
    what: String,
    count: u64,
    /// The first few.
    places: Vec<String>,
}

impl LeftOut {
    /// Notes that something was left out at a place, such as a line, or of something with a name.
    pub(super) fn note(&mut self, what: &str, place: impl Display) {
        let note = match self.notes.iter().position(|n| n.what == what) {
            Some(at) => &mut self.notes[at],
            None => {
                self.notes.push(Note {
                    what: what.into(),
                    count: 0,
                    places: Vec::new(),
                });
                self.notes.last_mut().expect("one was added")
            }
        };
        if note.places.len() < NAMED_PLACES {
            let place = place.to_string();
            if note.places.last() == Some(&place) {
                return;
            }
            note.places.push(place);
        }
        note.count += 1;
    }

    /// Notes that a material has a feature.
    pub(super) fn feature(&mut self, feature: SurfaceFeature, material: usize) {
        self.features.insert((feature, material));
    }

    /// Warns of everything that was noted, for a file of so many materials.
    pub(super) fn tell(self, path: &Path, materials: usize, files: &mut Files) {
        let features = self.features_told(materials);
        for note in &self.notes {
            let mut line = format!(
                "{}: {}: {}",
                path.display(),
                note.what,
                note.places.join(", ")
            );
            let others = note.count - note.places.len() as u64;
            if others > 0 {
                line.push_str(&format!(" and {others} more"));
            }
            files.warn(line);
        }
        if let Some(features) = features {
            files.warn(format!("{}: {features}", path.display()));
        }
    }

    /// One sentence about all features.
    fn features_told(&self, materials: usize) -> Option<String> {
        let mut counts: Vec<(SurfaceFeature, usize)> = Vec::new();
        for &(feature, _) in &self.features {
            match counts.last_mut() {
                Some((last, count)) if *last == feature => *count += 1,
                _ => counts.push((feature, 1)),
            }
        }
        if counts.is_empty() {
            return None;
        }
        let each: Vec<String> = counts
            .into_iter()
            .map(|(feature, count)| format!("{} of {count}", feature.name()))
            .collect();
        let materials = match materials {
            1 => "1 material".into(),
            n => format!("{n} materials"),
        };
        Some(format!(
            "all surfaces are taken as diffuse; of {materials} this leaves out {}",
            each.join(", ")
        ))
    }
}

/// Warns of the grids that no volume of a file drew.
pub(super) fn tell_left_grids(files: &mut Files) {
    for (path, labels) in std::mem::take(&mut files.left_grids) {
        let mut left_out = LeftOut::default();
        for label in labels {
            left_out.note("grids are left out", format_args!("`{label}`"));
        }
        left_out.tell(&path, 0, files);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_feature_is_counted_by_materials() {
        let mut left_out = LeftOut::default();
        assert_eq!(left_out.features_told(3), None);
        for (feature, material) in [
            (SurfaceFeature::Bump, 0),
            (SurfaceFeature::Glass, 2),
            (SurfaceFeature::Bump, 2),
            (SurfaceFeature::Bump, 0),
        ] {
            left_out.feature(feature, material);
        }
        assert_eq!(
            left_out.features_told(3).unwrap(),
            "all surfaces are taken as diffuse; of 3 materials this leaves out glass of 1, bumps \
             and normal maps of 2"
        );
    }

    #[test]
    fn each_kind_is_told_once_with_its_first_places() {
        let mut left_out = LeftOut::default();
        for line in 1..=10 {
            left_out.note("normals are dropped", format_args!("line {line}"));
        }
        left_out.note("lines are left out", "line 7");
        left_out.note("lines are left out", "line 7");
        let mut files = Files::default();
        left_out.tell(Path::new("x.obj"), 0, &mut files);
        assert_eq!(
            files.warnings,
            [
                "x.obj: normals are dropped: line 1, line 2, line 3, line 4, line 5, line 6, line \
                 7, line 8 and 2 more",
                "x.obj: lines are left out: line 7"
            ]
        );
    }
}

//! What materials ask for beyond diffuse reflection, which is all that surfaces have: one sentence
//! a file.

use std::collections::BTreeSet;

/// A kind of looks that is left out. The order is that of the sentence.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Look {
    Mirror,
    Glass,
    Metal,
    Highlight,
    Coat,
    Sheen,
    Bump,
}

impl Look {
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

/// Looks by the number of the material that asks for them.
#[derive(Debug, Default)]
pub(super) struct LeftOut(BTreeSet<(Look, usize)>);

impl LeftOut {
    /// A material asks for this.
    pub(super) fn add(&mut self, look: Look, material: usize) {
        self.0.insert((look, material));
    }

    /// What to tell the user, of a file of so many materials.
    pub(super) fn told(&self, materials: usize) -> Option<String> {
        let mut counts: Vec<(Look, usize)> = Vec::new();
        for &(look, _) in &self.0 {
            match counts.last_mut() {
                Some((last, count)) if *last == look => *count += 1,
                _ => counts.push((look, 1)),
            }
        }
        if counts.is_empty() {
            return None;
        }
        let each: Vec<String> = counts
            .into_iter()
            .map(|(look, count)| format!("{} of {count}", look.name()))
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_kind_is_counted_by_materials() {
        let mut left_out = LeftOut::default();
        assert_eq!(left_out.told(3), None);
        for (look, material) in [
            (Look::Bump, 0),
            (Look::Glass, 2),
            (Look::Bump, 2),
            (Look::Bump, 0),
        ] {
            left_out.add(look, material);
        }
        assert_eq!(
            left_out.told(3).unwrap(),
            "all surfaces are taken as diffuse; of 3 materials this leaves out glass of 1, bumps and normal maps of 2"
        );
    }
}

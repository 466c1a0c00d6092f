//! What may have been meant by a word that is not known.

/// The known word that takes the fewest edits to reach, if it takes few for its length.
pub(super) fn nearest<'k>(word: &str, known: &[&'k str]) -> Option<&'k str> {
    let word = &word.to_lowercase();
    let (edits, near) = known
        .iter()
        .map(|k| (strsim::osa_distance(word, &k.to_lowercase()), *k))
        .min_by_key(|(edits, _)| *edits)?;
    (edits <= near.len().max(word.len()).div_ceil(3)).then_some(near)
}

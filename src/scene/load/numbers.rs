//! Numbers in text, as programs write them.

/// A number, or NaN for any of the ways in which programs write what is none.
pub(super) fn number(word: &str) -> Option<f64> {
    word.parse()
        .ok()
        .or_else(|| is_no_number(word).then_some(f64::NAN))
}

/// Whether it is written for a result that is none: `-nan(ind)`, `1.#QNAN`, `-1.#IND`, `1.#INF`.
fn is_no_number(word: &str) -> bool {
    let word = word.trim_start_matches(['+', '-']).to_ascii_lowercase();
    word.starts_with("nan") || word.starts_with("inf") || word.starts_with("1.#")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_number_is_told_from_what_is_no_word_for_it() {
        assert_eq!(number("-1.5e3"), Some(-1500.0));
        for word in ["nan", "-nan", "-nan(ind)", "NaN", "1.#QNAN", "-1.#IND"] {
            assert!(number(word).is_some_and(f64::is_nan), "{word}");
        }
        assert!(number("inf").is_some_and(|x| !x.is_finite()));
        assert_eq!(number("x"), None);
        assert_eq!(number(""), None);
    }
}

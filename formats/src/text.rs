//! Text for people: one line, and nothing in it that a terminal would obey.

use std::fmt::Display;

/// Characters of a message. Of a longer one the middle is left out: it begins with the file and
/// ends with what was found there.
const MAX_CHARACTERS: usize = 1000;
/// Of these the last ones.
const TAIL: usize = 300;

/// `text` as one line of at most 1000 characters, whoever made it: control characters, line breaks,
/// escapes, and marks that turn the direction of text stand there as in a string of Rust, such as
/// `\n` or `\u{1b}`. A line that was made so stays as it is.
#[must_use]
pub fn one_line(text: impl Display) -> String {
    let mut line = String::new();
    for c in text.to_string().chars() {
        if is_obeyed(c) {
            line.extend(c.escape_default());
        } else {
            line.push(c);
        }
    }
    let count = line.chars().count();
    if count <= MAX_CHARACTERS {
        return line;
    }
    let head = line.chars().take(MAX_CHARACTERS - TAIL - 1);
    let tail = line.chars().skip(count - TAIL);
    head.chain(['…']).chain(tail).collect()
}

/// Whether a terminal, or whatever shows text, does something else than draw the character.
fn is_obeyed(c: char) -> bool {
    c.is_control()
        || matches!(c, '\u{61c}' | '\u{200e}' | '\u{200f}' | '\u{2028}'..='\u{202e}'
            | '\u{2060}'..='\u{206f}' | '\u{feff}' | '\u{fff9}'..='\u{fffb}' | '\u{e0000}'..='\u{e007f}')
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_terminal_would_obey_is_shown() {
        for (text, line) in [
            ("a\nb\r\tc\0", r"a\nb\r\tc\u{0}"),
            ("\u{1b}[31m\u{9b}1m\u{7f}", r"\u{1b}[31m\u{9b}1m\u{7f}"),
            ("a\u{202e}b\u{2066}\u{2028}", r"a\u{202e}b\u{2066}\u{2028}"),
            ("é \\ \"ن\u{200c}\" … 木", "é \\ \"ن\u{200c}\" … 木"),
        ] {
            assert_eq!(one_line(text), line);
            assert_eq!(one_line(one_line(text)), line);
        }
    }

    #[test]
    fn long_text_keeps_both_ends() {
        let whole: String = "é".repeat(MAX_CHARACTERS);
        assert_eq!(one_line(&whole), whole);
        for long in [format!("a{whole}z"), "\n".repeat(100_000) + "z"] {
            let line = one_line(&long);
            assert_eq!(line.chars().count(), MAX_CHARACTERS);
            assert!(line.ends_with('z') && line.contains('…'), "{line}");
            assert_eq!(one_line(&line), line);
        }
    }
}

//! What the program says: data on stdout, errors on stderr.

use crate::{Error, Result};
use std::io::{ErrorKind, Write};

/// Writes data to stdout. A reader that has gone away has had enough: that is success.
pub fn print(text: &str) -> Result<()> {
    let mut out = std::io::stdout().lock();
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
        Err(e) if e.kind() != ErrorKind::BrokenPipe => {
            Err(Error::failed(format!("cannot write to stdout: {e}")))
        }
        _ => Ok(()),
    }
}

/// Writes a value to stdout as JSON with a line end.
pub fn print_json(value: &impl serde::Serialize) -> Result<()> {
    let json = serde_json::to_string_pretty(value)
        .map_err(|e| Error::failed(format!("cannot encode the result: {e}")))?;
    print(&(json + "\n"))
}

/// Writes an error and its hint to stderr.
pub fn print_error(error: &Error) {
    let message = error.to_string();
    // What stands in backquotes in a message about a scene file is a key of it, mostly.
    let is_of_scene = [".toml:", ".xml:"]
        .iter()
        .any(|name| message.contains(name));
    let told = |text: &str| match is_of_scene {
        true => with_options_of(text, |setting| OF_READING.contains(&setting)),
        false => with_options(text),
    };
    let mut err = std::io::stderr().lock();
    let _ = writeln!(err, "error: {}", told(&message));
    if let Some(hint) = error.hint_text() {
        let _ = writeln!(err, "hint: {}", told(hint));
    }
}

/// Settings of how a scene is read, which are no keys of it.
const OF_READING: [&str; 4] = ["allow_outside", "frames", "set", "texture_limit"];

/// A message of the library with the options that set what it names in backquotes.
pub fn with_options(message: &str) -> String {
    with_options_of(message, |_| true)
}

fn with_options_of(message: &str, is_setting: impl Fn(&str) -> bool) -> String {
    let mut text = String::with_capacity(message.len());
    let mut pieces = message.split('`').enumerate().peekable();
    while let Some((i, piece)) = pieces.next() {
        // As in "`group` in [[mesh]] at line 3".
        let is_key = pieces
            .peek()
            .is_some_and(|(_, rest)| rest.starts_with(" in ["));
        let option = match piece {
            "overwrite" => "force".into(),
            _ => piece.replace('_', "-"),
        };
        let is_quoted = i % 2 == 1;
        if is_quoted && !is_key && is_setting(piece) && super::has_option(&option) {
            text += "--";
            text += &option;
        } else if is_quoted {
            text += "`";
            text += piece;
            text += "`";
        } else {
            text += piece;
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_are_told_as_their_options() {
        for (message, told) in [
            (
                "`max_dist` must be more than 0",
                "--max-dist must be more than 0",
            ),
            ("replace it with `overwrite`", "replace it with --force"),
            (
                "make one with `lvox scatter`",
                "make one with `lvox scatter`",
            ),
            (
                "raise `memory_limit`, or enlarge by `scale`",
                "raise --memory-limit, or enlarge by `scale`",
            ),
            ("nothing is named", "nothing is named"),
            (
                "`group` in [[mesh]] at line 3 names none",
                "`group` in [[mesh]] at line 3 names none",
            ),
        ] {
            assert_eq!(with_options(message), told);
        }
    }
}

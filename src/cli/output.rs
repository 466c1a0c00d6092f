//! What the program says: data on stdout, errors on stderr.

use lvox::{Error, Result};
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
    let mut err = std::io::stderr().lock();
    let _ = writeln!(err, "error: {error}");
    if let Some(hint) = error.hint_text() {
        let _ = writeln!(err, "hint: {hint}");
    }
}

//! What the program says: data on stdout, errors on stderr.

use crate::run::Job;
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

/// Says what the last stage took, and what it took with those before it that are named; nothing of
/// stages that did not run.
pub fn say_times(job: &Job, last: &str, before: &[&str]) {
    let stages = job.report.stages();
    let secs = |name: &str| {
        let of_name = stages.iter().filter(|s| s.stage == name);
        of_name.map(|s| s.cpu_secs).reduce(|a, b| a + b)
    };
    let Some(own) = secs(last) else { return };
    let found: Vec<(&str, f64)> = before
        .iter()
        .filter_map(|name| Some((*name, secs(name)?)))
        .collect();
    let mut text = format!("{last} {own:.1} CPU s");
    if let Some(((last, _), rest)) = found.split_last() {
        let rest: Vec<&str> = rest.iter().map(|f| f.0).collect();
        let names = match &rest[..] {
            [] => (*last).to_owned(),
            _ => format!("{} and {last}", rest.join(", ")),
        };
        let total = own + found.iter().map(|f| f.1).sum::<f64>();
        text += &format!("; with {names} {total:.1}");
    }
    job.progress.say(&text);
}

/// What the library calls its settings, with the options that set them, where that is not plain.
const OPTIONS_OF_SETTINGS: &[(&str, &str)] = &[
    ("memory limit", "--memory-limit"),
    ("allow overwriting", "--force"),
    ("temporary folder", "--temp-dir"),
    ("block depth", "--block-depth"),
    ("block voxels", "--block-voxels"),
    ("block samples", "--block-samples"),
    ("bake shadow rays", "--bake-shadow-rays"),
    ("crease angle", "--crease-deg"),
    ("camera rate", "--camera-rate"),
    ("strict mode", "--strict"),
];

/// Writes an error and its hint to stderr.
pub fn print_error(error: &Error) {
    let mut err = std::io::stderr().lock();
    let _ = writeln!(err, "error: {}", with_options(&error.to_string()));
    if let Some(hint) = error.hint_text() {
        let _ = writeln!(err, "hint: {}", with_options(hint));
    }
}

/// A message in which the option stands behind the first mention of its setting.
fn with_options(message: &str) -> String {
    let mut text = message.to_owned();
    for (setting, option) in OPTIONS_OF_SETTINGS {
        text = text.replacen(setting, &format!("{setting} ({option})"), 1);
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn options_stand_behind_their_settings() {
        assert_eq!(
            with_options("raise the memory limit, or the memory limit is passed"),
            "raise the memory limit (--memory-limit), or the memory limit is passed"
        );
        assert_eq!(
            with_options("samples must be at least 1"),
            "samples must be at least 1"
        );
    }
}

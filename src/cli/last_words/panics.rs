//! A panic: a bug of ours or of a library.

use super::{Line, end};
use std::fmt::Write;
use std::panic::PanicHookInfo;

/// From here on a panic in any thread ends the program. With `RUST_BACKTRACE` set, its trace comes
/// before.
pub fn install() {
    let with_trace = std::env::var_os("RUST_BACKTRACE").is_some();
    let default = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |info| {
        if with_trace {
            default(info);
        }
        end(line(info));
    }));
}

fn line(info: &PanicHookInfo) -> Line {
    let mut line = Line::new();
    let payload = info.payload();
    let literal = payload.downcast_ref::<&str>().copied();
    let formatted = payload.downcast_ref::<String>().map(String::as_str);
    let message = literal.or(formatted).unwrap_or("a panic without words");
    let _ = write!(
        line,
        "error: lvox failed, which is a fault in it or a lack of memory or threads: "
    );
    for (i, part) in message.lines().enumerate() {
        let gap = if i == 0 { "" } else { " " };
        let _ = write!(line, "{gap}{}", part.trim());
    }
    if let Some(place) = info.location() {
        let _ = write!(line, " ({}:{})", place.file(), place.line());
    }
    line
}

//! How the program ends where no error can be returned: one line on stderr, no temporary files
//! left, and the exit code of what a retry may help.
//!
//! - `memory`: the allocator, which ends the program where nobody hears that memory ran out.
//! - `panics`: a bug, here or in a library.
//! - `mapped`: a file that was cut while it was mapped (SIGBUS).

mod mapped;
pub mod memory;
mod panics;

use crate::formats::emergency;
use std::fmt::{self, Write};
use std::io::IsTerminal;
use std::sync::atomic::{AtomicBool, AtomicU8, Ordering};

/// Exit code where a retry may help.
static RETRY_CODE: AtomicU8 = AtomicU8::new(1);

/// Exit code where a retry may help.
pub fn retry_code() -> u8 {
    RETRY_CODE.load(Ordering::Relaxed)
}

/// From here on runs that a retry may help end with this exit code.
pub fn set_retry_code(code: u8) {
    RETRY_CODE.store(code, Ordering::Relaxed);
}

/// Longest line; a path of 1024 bytes fits.
const LINE_BYTES: usize = 2048;

/// From here on a panic and a cut file end the program so.
pub fn install() {
    panics::install();
    mapped::install();
}

/// A line in memory of fixed size: what does not fit is left out. Bytes that move a terminal's
/// cursor are shown as `?`.
struct Line {
    bytes: [u8; LINE_BYTES],
    len: usize,
}

impl Line {
    fn new() -> Self {
        let bytes = [0; LINE_BYTES];
        Self { bytes, len: 0 }
    }

    fn push(&mut self, text: &[u8]) {
        // The last byte is for the end of the line.
        let room = &mut self.bytes[self.len..LINE_BYTES - 1];
        for (to, byte) in room.iter_mut().zip(text) {
            *to = if byte.is_ascii_control() { b'?' } else { *byte };
        }
        self.len += room.len().min(text.len());
    }
}

impl Write for Line {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        self.push(text.as_bytes());
        Ok(())
    }
}

/// Writes the line, removes temporary files and ends the process. May be called in
/// a signal handler and where there is no memory: it neither allocates nor waits for a lock. Of
/// several threads that come here the first one is heard.
fn end(mut line: Line) -> ! {
    static IS_ENDING: AtomicBool = AtomicBool::new(false);
    if IS_ENDING.swap(true, Ordering::Relaxed) {
        wait();
    }
    line.bytes[line.len] = b'\n';
    // Behind a progress bar the line begins anew.
    if std::io::stderr().is_terminal() {
        write(b"\n");
    }
    write(&line.bytes[..=line.len]);
    emergency::remove_temporaries();
    exit()
}

#[cfg(unix)]
fn write(bytes: &[u8]) {
    // SAFETY: the bytes are there. Past the lock of `std::io::stderr`, which another thread may
    // hold; a closed stderr hears nothing.
    #[allow(unsafe_code)]
    unsafe {
        libc::write(libc::STDERR_FILENO, bytes.as_ptr().cast(), bytes.len());
    }
}

#[cfg(unix)]
fn exit() -> ! {
    // SAFETY: ends the process at once; no destructors and no handlers of exit run, which might
    // wait for what this thread holds.
    #[allow(unsafe_code)]
    unsafe {
        libc::_exit(retry_code().into())
    }
}

/// Waits for the thread that ends the process.
#[cfg(unix)]
fn wait() -> ! {
    loop {
        // SAFETY: sleeps until a signal comes.
        #[allow(unsafe_code)]
        unsafe {
            libc::pause();
        }
    }
}

#[cfg(not(unix))]
fn write(bytes: &[u8]) {
    let _ = std::io::Write::write_all(&mut std::io::stderr(), bytes);
}

#[cfg(not(unix))]
fn exit() -> ! {
    std::process::exit(retry_code().into())
}

#[cfg(not(unix))]
fn wait() -> ! {
    loop {
        std::thread::park();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_is_one_and_has_an_end() {
        let mut line = Line::new();
        write!(line, "a\nb\x1b{}", 7).unwrap();
        assert_eq!(&line.bytes[..line.len], b"a?b?7");
        line.push(&[b'x'; 2 * LINE_BYTES]);
        line.push(b"y");
        assert_eq!(line.len, LINE_BYTES - 1);
    }
}

//! The one error of the library: what went wrong, where, and what to do next. Settings are named in
//! backquotes, as in `max_dist`, and whoever tells the user may put another spelling there.

use lvox_formats::one_line;
use std::fmt;
use std::path::Path;

/// The meaning of an error for the caller, and for the exit code of the program.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// The input or a setting is wrong; the same call will fail again. Exit code 2.
    Input,
    /// The machine failed us (disk, memory, permission); a retry may succeed. Exit code 1.
    Failed,
    /// Stopped on request. Exit code 1.
    Cancelled,
}

/// An error with a message and, where there is one, a hint at the cure: each one line of at most
/// 1000 characters, in which control characters of files and their names are escaped.
#[derive(Clone, Debug)]
pub struct Error {
    kind: Kind,
    message: String,
    hint: Option<String>,
}

/// Result with the library's [`Error`].
pub type Result<T, E = Error> = std::result::Result<T, E>;

impl Error {
    /// Makes an error of wrong input; the message names what was expected and what was found.
    pub fn input(message: impl Into<String>) -> Self {
        Self {
            kind: Kind::Input,
            message: message.into(),
            hint: None,
        }
    }

    /// Makes an error of a machine that failed.
    pub fn failed(message: impl Into<String>) -> Self {
        Self {
            kind: Kind::Failed,
            message: message.into(),
            hint: None,
        }
    }

    /// Makes the error of work that was stopped on request.
    #[must_use]
    pub fn cancelled() -> Self {
        Self {
            kind: Kind::Cancelled,
            message: "stopped on request".into(),
            hint: None,
        }
    }

    /// Makes an error of input or output on a file: a file that is not there is wrong input, a full
    /// disk is a failure.
    pub fn io(doing: &str, path: &Path, error: &std::io::Error) -> Self {
        let kind = kind_of(error.kind());
        Self {
            kind,
            message: format!("cannot {doing} {}: {error}", path.display()),
            hint: None,
        }
    }

    /// Adds a hint at what to do next.
    #[must_use]
    pub fn hint(mut self, hint: impl Into<String>) -> Self {
        self.hint = Some(one_line(hint.into()));
        self
    }

    /// Leads the message by the place where the error happened; a stop on request has none.
    #[must_use]
    pub fn at(mut self, place: impl fmt::Display) -> Self {
        if self.kind != Kind::Cancelled {
            self.message = format!("{place}: {}", self.message);
        }
        self
    }

    /// Returns the meaning of the error for the caller.
    #[must_use]
    pub fn kind(&self) -> Kind {
        self.kind
    }

    /// Returns the hint at what to do next, where there is one.
    #[must_use]
    pub fn hint_text(&self) -> Option<&str> {
        self.hint.as_deref()
    }
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&one_line(&self.message))
    }
}

impl std::error::Error for Error {}

impl From<lvox_formats::FormatError> for Error {
    /// A damaged or foreign file is wrong input; what the system refused is sorted as any other I/O
    /// error.
    fn from(error: lvox_formats::FormatError) -> Self {
        let kind = match error.io_error().map(std::io::Error::kind) {
            None => Kind::Input,
            Some(kind) => kind_of(kind),
        };
        Self {
            kind,
            message: error.to_string(),
            hint: error.hint().map(Into::into),
        }
    }
}

fn kind_of(kind: std::io::ErrorKind) -> Kind {
    use std::io::ErrorKind as K;
    match kind {
        K::NotFound
        | K::PermissionDenied
        | K::AlreadyExists
        | K::IsADirectory
        | K::NotADirectory
        | K::InvalidInput => Kind::Input,
        _ => Kind::Failed,
    }
}

//! What went wrong, in a sentence that names the way out, and the exit code that a script can tell it by.

use std::fmt;
use std::io::Write;
use std::process::ExitCode;

/// An error that ends a process.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Error {
    kind: Kind,
    text: String,
}

/// What kind of an error, and so which exit code (those of `sysexits.h`).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Usage,
    Data,
    Unavailable,
    Internal,
    Config,
    /// Not an error: what was to be checked is right.
    Checked,
}

impl Error {
    /// The command line is wrong: exit code 64.
    pub fn usage(text: impl Into<String>) -> Self {
        Self {
            kind: Kind::Usage,
            text: text.into(),
        }
    }

    /// The input data are wrong: exit code 65.
    pub fn data(text: impl Into<String>) -> Self {
        Self {
            kind: Kind::Data,
            text: text.into(),
        }
    }

    /// Something that has to run first does not, or is in the way: exit code 69.
    pub fn unavailable(text: impl Into<String>) -> Self {
        Self {
            kind: Kind::Unavailable,
            text: text.into(),
        }
    }

    /// Something that must not happen did: exit code 70.
    pub fn internal(text: impl Into<String>) -> Self {
        Self {
            kind: Kind::Internal,
            text: text.into(),
        }
    }

    /// The configuration is wrong: exit code 78.
    pub fn config(text: impl Into<String>) -> Self {
        Self {
            kind: Kind::Config,
            text: text.into(),
        }
    }

    /// Ends a process that was only asked to check its configuration: exit code 0.
    pub(crate) fn checked() -> Self {
        Self {
            kind: Kind::Checked,
            text: String::new(),
        }
    }

    /// The same kind of error, with what led to it in front.
    #[must_use]
    pub fn within(self, context: &str) -> Self {
        Self {
            text: format!("{context}: {}", self.text),
            ..self
        }
    }

    /// The exit code.
    #[must_use]
    pub fn code(&self) -> u8 {
        match self.kind {
            Kind::Checked => 0,
            Kind::Usage => 64,
            Kind::Data => 65,
            Kind::Unavailable => 69,
            Kind::Internal => 70,
            Kind::Config => 78,
        }
    }

    /// Ends `main`: prints the error, if it is one, under the program's name.
    #[must_use]
    pub fn exit(&self, program: &str) -> ExitCode {
        if self.kind != Kind::Checked {
            tell(format_args!("{program}: {}", self.text));
        }
        ExitCode::from(self.code())
    }
}

/// Writes a line to standard error. Where nobody can take it, on a full disk or after the terminal has been closed, the line
/// is lost, and nothing else: `eprintln!` would end the process.
pub fn tell(line: impl fmt::Display) {
    let _ = writeln!(std::io::stderr(), "{line}");
}

impl fmt::Display for Error {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(&self.text)
    }
}

impl std::error::Error for Error {}

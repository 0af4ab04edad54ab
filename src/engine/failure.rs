//! Who has to act when something fails: the user, or those who maintain the program and the machine?

use super::kind::StageKind;
use crate::store;
use std::{fmt, io};

/// Who can do something about a failure. The command line turns this into the exit code.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Blame {
    /// The user's input: arguments, configuration, recordings, given files.
    Input,
    /// The program or the machine: a bug, a full disk, a damaged file of ours.
    Fault,
    /// Everything ran, but a quality gate that the user set was not met.
    Gate,
    /// Nobody: the work had to stop, or waits for other work. The same command continues later.
    Later,
}

/// An error with the blame for it and, where it is known, what to do about it.
pub struct Failure {
    /// Who can act.
    pub blame: Blame,
    /// The error, with its causes.
    pub error: anyhow::Error,
    /// A remedy.
    pub hint: Option<String>,
}

/// The result of work that may fail with a [`Failure`].
pub type Result<T, E = Failure> = std::result::Result<T, E>;

impl Failure {
    /// A failure that the user can fix.
    pub fn input(error: impl Into<anyhow::Error>) -> Self {
        Self { blame: Blame::Input, error: error.into(), hint: None }
    }

    /// A failure of ours or of the machine.
    pub fn fault(error: impl Into<anyhow::Error>) -> Self {
        Self { blame: Blame::Fault, error: error.into(), hint: None }
    }

    /// The failure to read a record, with advice if it is damaged.
    pub(super) fn unreadable(error: store::Error, advice: impl FnOnce() -> String) -> Self {
        let is_damaged = matches!(error, store::Error::Record { .. });
        let failure = Self::fault(error);
        if is_damaged { failure.with_hint(format!("nothing was changed; {}", advice())) } else { failure }
    }

    /// A failure that the user can fix, from a message.
    pub fn input_message(message: impl fmt::Display) -> Self {
        Self::input(anyhow::anyhow!("{message}"))
    }

    /// A quality gate that was not met.
    pub fn gate(message: impl fmt::Display) -> Self {
        Self { blame: Blame::Gate, error: anyhow::anyhow!("{message}"), hint: None }
    }

    /// Work that continues later, with the same command.
    pub fn later(message: impl fmt::Display) -> Self {
        Self { blame: Blame::Later, error: anyhow::anyhow!("{message}"), hint: None }
    }

    /// Attributes the failure to a stage.
    #[must_use]
    pub(super) fn of_stage(self, stage: &StageKind) -> Self {
        let what = if self.blame == Blame::Later { "was stopped" } else { "failed" };
        self.context(format!("stage {stage} {what}"))
    }

    /// Adds advice.
    #[must_use]
    pub fn with_hint(mut self, hint: impl Into<String>) -> Self {
        self.hint = Some(hint.into());
        self
    }

    /// Adds context.
    #[must_use]
    pub fn context(mut self, context: impl fmt::Display + Send + Sync + 'static) -> Self {
        self.error = self.error.context(context);
        self
    }
}

impl fmt::Debug for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:?}: {:#}", self.blame, self.error)?;
        self.hint.iter().try_for_each(|hint| write!(f, " (hint: {hint})"))
    }
}

/// An error that nobody classified is a fault of ours: the user is never blamed by default.
impl From<anyhow::Error> for Failure {
    fn from(error: anyhow::Error) -> Self {
        Self::fault(error)
    }
}

impl From<io::Error> for Failure {
    fn from(error: io::Error) -> Self {
        Self::fault(error)
    }
}

/// Assigns the blame for an error of another layer.
pub trait Classify<T> {
    /// Blames the user.
    fn blame_input(self) -> Result<T>;
    /// Blames the program or the machine.
    fn blame_fault(self) -> Result<T>;
}

impl<T, E: Into<anyhow::Error>> Classify<T> for std::result::Result<T, E> {
    fn blame_input(self) -> Result<T> {
        self.map_err(Failure::input)
    }

    fn blame_fault(self) -> Result<T> {
        self.map_err(Failure::fault)
    }
}

//! Maps the errors of each layer to who can act on them, once for all stages.

use crate::engine::{Blame, Failure};
use crate::{cloud, corpus, drive, evaluate, export, files, generate, ingest, nn, simulate, store, train};
use std::io::ErrorKind;

impl From<ingest::Error> for Failure {
    fn from(error: ingest::Error) -> Self {
        match error {
            ingest::Error::Io(io) => of_named_path(io),
            // Failures of the sink are ours: errors of the store, which tell more than the wrapper.
            ingest::Error::Sink(source) => match source.downcast::<store::Error>() {
                Ok(source) => Self::from(*source).context("failed to store ingested scenes"),
                Err(source) => Self::fault(anyhow::anyhow!(source)),
            },
            error => Self::input(error),
        }
    }
}

impl From<store::Error> for Failure {
    fn from(error: store::Error) -> Self {
        match error {
            store::Error::Io(io) if matches!(io.kind(), ErrorKind::NotFound | ErrorKind::InvalidInput) => {
                Self::input(io)
            }
            store::Error::Files(error) => error.into(),
            error @ (store::Error::Unfinished { .. }
            | store::Error::NoCorpus { .. }
            | store::Error::SchemaVersion { .. }
            | store::Error::NotFound { .. }
            | store::Error::Unfit { .. }
            | store::Error::DuplicateScene { .. }
            | store::Error::UnknownMap { .. }) => Self::input(error),
            error => Self::fault(error),
        }
    }
}

/// The user can act on a refusal to write; damage is not the user's doing.
impl From<files::Error> for Failure {
    fn from(error: files::Error) -> Self {
        match error {
            files::Error::Io(error) => error.into(),
            error @ files::Error::Damaged { .. } => Self::fault(error),
            error => Self::input(error),
        }
    }
}

/// The user can act on refusals of a store.
impl From<cloud::Error> for Failure {
    fn from(error: cloud::Error) -> Self {
        if error.is_refusal() { Self::input(error) } else { Self::fault(error) }
    }
}

impl From<corpus::Error> for Failure {
    fn from(error: corpus::Error) -> Self {
        match error {
            corpus::Error::Store(error) => error.into(),
            corpus::Error::Io(io) | corpus::Error::Files(files::Error::Io(io)) => match io.kind() {
                ErrorKind::NotFound | ErrorKind::NotADirectory => Self::input(io),
                _ => Self::fault(io),
            },
            corpus::Error::Files(error) => error.into(),
            error => Self::input(error),
        }
    }
}

impl From<evaluate::Error> for Failure {
    fn from(error: evaluate::Error) -> Self {
        match error {
            evaluate::Error::Store(error) => error.into(),
            evaluate::Error::Config { message, advice } => Self::input_message(message).with_hint(advice),
            error @ evaluate::Error::UnknownScene(_) => Self::input(error),
            error @ evaluate::Error::OtherShard { .. } => Self::fault(error),
        }
    }
}

impl From<export::Error> for Failure {
    fn from(error: export::Error) -> Self {
        match error {
            export::Error::Store(error) => Self::from(error),
            export::Error::Io(io) | export::Error::Files(files::Error::Io(io)) => of_named_path(io),
            export::Error::Files(error) => error.into(),
            error @ export::Error::Encode { .. } => Self::fault(error),
            error => Self::input(error),
        }
    }
}

impl From<simulate::Error> for Failure {
    fn from(error: simulate::Error) -> Self {
        match error {
            simulate::Error::Generate(error) => error.into(),
            simulate::Error::Store(error) => error.into(),
            simulate::Error::Io(io) => of_named_path(io),
            error @ simulate::Error::Machine(_) => Self::fault(error),
            error => Self::input(error),
        }
    }
}

impl From<drive::Error> for Failure {
    fn from(error: drive::Error) -> Self {
        match error {
            drive::Error::Simulate(error) => error.into(),
            drive::Error::Store(error) => error.into(),
            drive::Error::Files(error) => error.into(),
            drive::Error::Io(io) => of_named_path(io),
            error => Self::input(error),
        }
    }
}

impl From<train::Error> for Failure {
    fn from(error: train::Error) -> Self {
        let blame = match &error {
            train::Error::Config(_)
            | train::Error::NoScenes(_)
            | train::Error::NoExamples { .. }
            | train::Error::Diverged { .. } => Blame::Input,
            train::Error::Stopped { .. } => Blame::Later,
            _ => Blame::Fault,
        };
        Self { blame, ..Self::fault(error) }
    }
}

/// For checkpoints that the user names or another stage made: a missing or foreign file is for the user to fix.
impl From<nn::Error> for Failure {
    fn from(error: nn::Error) -> Self {
        Self::input(error)
    }
}

/// An error at a path that the user named: the user can fix the path, but not a full disk.
fn of_named_path(error: std::io::Error) -> Failure {
    match error.kind() {
        ErrorKind::NotFound
        | ErrorKind::PermissionDenied
        | ErrorKind::ReadOnlyFilesystem
        | ErrorKind::AlreadyExists
        | ErrorKind::NotADirectory
        | ErrorKind::IsADirectory => Failure::input(error).with_hint(
            "relative paths are relative to the pipeline file, those of the command line to the current directory",
        ),
        // Neither a file nor a folder.
        ErrorKind::InvalidInput => Failure::input(error),
        _ => Failure::fault(error),
    }
}

impl From<generate::Error> for Failure {
    fn from(error: generate::Error) -> Self {
        let blame = match &error {
            generate::Error::Scene { .. } | generate::Error::Stale { .. } | generate::Error::Tensor(_) => Blame::Fault,
            generate::Error::Stopped => Blame::Later,
            _ => Blame::Input,
        };
        Self { blame, ..Self::fault(error) }
    }
}

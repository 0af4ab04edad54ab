//! Errors of training.

use std::path::PathBuf;

/// A failure of training.
#[derive(Debug, thiserror::Error)]
#[expect(missing_docs, reason = "the messages tell what the fields are")]
pub enum Error {
    /// A tensor operation failed.
    #[error("a tensor operation failed")]
    Tensor(#[from] candle_core::Error),
    /// A checkpoint could not be written or read.
    #[error("cannot save or restore the training state")]
    Checkpoint(#[from] crate::nn::Error),
    /// A file could not be written or read.
    #[error("cannot use the training folder")]
    Io(#[from] std::io::Error),
    /// A training state that changed since it was saved.
    #[error(
        "{path} has changed since it was saved, or the disk is failing; restore it from a copy, or remove it to train \
         from the start"
    )]
    DamagedState { path: PathBuf },
    /// A scene could not be loaded.
    #[error("cannot load a training scene")]
    Scene(#[source] Box<dyn std::error::Error + Send + Sync>),
    /// Nothing to train on.
    #[error("no scenes to train on: {0}")]
    NoScenes(String),
    /// A classifier needs examples of both labels.
    #[error(
        "{behavior}: found {n_positive} positive and {n_negative} negative pairs; training needs both: mine more \
         scenes or other places, or relax the behavior's definition"
    )]
    NoExamples { behavior: String, n_positive: usize, n_negative: usize },
    /// An invalid setting.
    #[error("{0}")]
    Config(String),
    /// The training was interrupted, and its state is saved.
    #[error("stopped after step {step}, with everything saved")]
    Stopped { step: u64 },
    /// The loss is no longer a number.
    #[error("the loss is {loss} at step {step}: lower the learning rate or look for non-finite inputs")]
    Diverged { step: u64, loss: f64 },
}

//! Errors that stop an evaluation.

use crate::scene::SceneId;
use crate::store;

/// A failure of evaluation.
#[derive(Debug, thiserror::Error)]
#[expect(missing_docs, reason = "the messages tell what the fields are")]
pub enum Error {
    /// A setting that cannot work.
    #[error("{message}; {advice}")]
    Config { message: String, advice: String },
    /// A sample continues a scene that the store does not have.
    #[error("scene {0} of the samples is not in the scene store; pass the scenes that the samples were generated from")]
    UnknownScene(SceneId),
    /// Figures belong to a different shard.
    #[error(
        "figures of {found} cells belong to another shard than the one with {expected}; measure it again with --redo \
         evaluate"
    )]
    OtherShard { expected: usize, found: usize },
    /// A file of ours could not be read or written.
    #[error(transparent)]
    Store(#[from] store::Error),
}

/// The result of evaluation.
pub type Result<T, E = Error> = std::result::Result<T, E>;

//! Errors of checkpoints, with remedies.

use std::path::PathBuf;

/// A failure to write or read a checkpoint.
#[derive(Debug, thiserror::Error)]
#[expect(missing_docs, reason = "the messages tell what the fields are")]
pub enum Error {
    /// The file cannot be read or written; the message of `fs_err` names it.
    #[error(transparent)]
    Io(#[from] std::io::Error),
    /// The file is not a safetensors file, or is cut off.
    #[error("{path} is not a complete safetensors file; write it again or use another checkpoint")]
    Format { path: PathBuf, source: safetensors::SafeTensorError },
    /// The file holds tensors but no metadata of ours.
    #[error(
        "{path} has no `djinn` entry in its metadata, so djinn did not write it; use a checkpoint from `djinn train`"
    )]
    NoMetadata { path: PathBuf },
    /// The metadata does not describe the expected kind of model.
    #[error(
        "the metadata of {path} is for another model or version; use a checkpoint of this kind of model, written by \
         this version"
    )]
    Metadata { path: PathBuf, source: serde_json::Error },
    /// A model that cannot work.
    #[error("{path} is no model that can work: {what}; use a checkpoint as `djinn train` wrote it")]
    Unfit { path: PathBuf, what: String },
    /// Tensors could not be moved between memory and the device.
    #[error("cannot move the tensors of {path} between memory and the device")]
    Tensor { path: PathBuf, source: candle_core::Error },
}

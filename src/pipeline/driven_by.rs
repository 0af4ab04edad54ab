//! Which model moves everybody else in a closed loop?

use super::layout::{DENOISER, DISTILLED};
use super::stages::checkpoint_file;
use crate::engine::{Failure, Result};
use crate::model::TrainedDenoiser;
use crate::nn::Compute;
use std::path::Path;

/// The model that is `named`, or otherwise the distilled denoiser or the denoiser of the run of the `corpus`.
///
/// # Errors
/// When there is none, or it is not a whole checkpoint.
pub fn open_model(named: Option<&Path>, corpus: &Path, compute: &Compute) -> Result<TrainedDenoiser> {
    let beside = corpus.parent().unwrap_or(Path::new(""));
    let of_run = [DISTILLED, DENOISER].map(|name| checkpoint_file(&beside.join(name)));
    let path = match named {
        Some(path) => checkpoint_file(path),
        None => of_run.into_iter().find(|path| path.is_file()).ok_or_else(|| {
            let message = format!("there is no model beside {}: neither {DISTILLED} nor {DENOISER}", corpus.display());
            Failure::input_message(message).with_hint("pass a checkpoint with --model")
        })?,
    };
    Ok(TrainedDenoiser::read(&path, compute)?)
}

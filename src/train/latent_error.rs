//! The error of a prediction, for all trainings of a denoiser.

use super::Error;
use crate::tensor::SceneBatch;
use candle_core::Tensor;

/// The squared error of `answer` (B, A, T, D) at each scored scalar of `batch`, 0 elsewhere. In the motion
/// parametrization, the squared error of the paths that motion adds up to is added with the weight `path_loss`.
pub(super) fn squared_error(
    batch: &SceneBatch,
    answer: &Tensor,
    target: &Tensor,
    path_loss: f64,
) -> Result<Tensor, Error> {
    let scored = batch.scored.unsqueeze(3)?;
    let error = (answer - target)?.broadcast_mul(&scored)?;
    let squared = error.sqr()?;
    if path_loss > 0.0
        && let Some(path) = batch.unit_path()?
    {
        let path_error = path.matmul(&error)?.broadcast_mul(&scored)?;
        return Ok((squared + (path_error.sqr()? * path_loss)?)?);
    }
    Ok(squared)
}

/// √(m + c²) - c for each row of `squared` (B, A, T, D), where m is the mean over the row's scored scalars: quadratic
/// for small errors and linear above c (pseudo-Huber). Returns (B).
pub(super) fn pseudo_huber(batch: &SceneBatch, squared: &Tensor, c: f64) -> Result<Tensor, Error> {
    let state_dim = squared.dim(3)? as f64;
    let n_scored = (batch.scored.flatten_from(1)?.sum(1)? * state_dim)?.maximum(1.0)?;
    let mean = squared.flatten_from(1)?.sum(1)?.div(&n_scored)?;
    // The small number keeps the slope finite at 0.
    Ok(((mean + (c * c + 1e-12))?.sqrt()? - c)?)
}

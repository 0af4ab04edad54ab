//! Training of Scene Transformer: the best of its joint futures is trained toward the recording, and its probability
//! raised.

use super::{DrawnBatch, Error, SceneDraws, TrainTask};
use crate::model::{JointFutures, SceneTransformer};
use crate::tensor::SceneBatch;
use candle_core::{Result, Tensor};
use std::collections::BTreeMap;

/// The terms of the loss, averaged over the rows of a batch that have latent entries.
#[derive(Debug, Clone)]
pub struct JointLoss {
    /// Mean error of the best future of each row.
    pub regression: Tensor,
    /// -ln p of that future.
    pub mode: Tensor,
}

impl JointLoss {
    /// The loss of `futures` predicted for `batch`.
    ///
    /// The error of a decoded state is √(1 + d²) - 1 of its distance d in meters, plus the same of its angle in
    /// radians: Huber's loss with a smooth turn, d² / 2 near zero and d - 1 far out. The error of a future is its mean
    /// over the scene's latent states; the future with the least is the best one, and the only one whose states get a
    /// gradient. The loss compares decoded states, because futures are compared by displacements in every
    /// parametrization.
    pub fn new(futures: &JointFutures, batch: &SceneBatch) -> Result<Self> {
        let n_modes = futures.logits.dim(1)?;
        let errors = Self::errors(futures, batch)?;
        // 1 for each row with latent entries, (B).
        let has_latent = batch.latent.flatten_from(1)?.max(1)?;
        let n_counted = has_latent.sum_all()?.maximum(1.0)?;
        let best = one_hot(&errors.argmin(1)?, n_modes, errors.device())?.broadcast_mul(&has_latent.unsqueeze(1)?)?;
        let log_p = futures.logits.broadcast_sub(&futures.logits.log_sum_exp(1)?.unsqueeze(1)?)?;
        Ok(Self {
            regression: (errors * &best)?.sum_all()?.div(&n_counted)?,
            mode: (log_p * &best)?.sum_all()?.neg()?.div(&n_counted)?,
        })
    }

    /// The error of every future, (B, F).
    fn errors(futures: &JointFutures, batch: &SceneBatch) -> Result<Tensor> {
        let (n_rows, n_modes) = futures.logits.dims2()?;
        let repeated = batch.repeated(n_modes)?;
        let latent = &repeated.latent;
        let squared = (repeated.decode(&futures.x0)? - repeated.decode(&repeated.x0)?)?.sqr()?;
        let smooth = |squared: Tensor| ((squared + 1.0)?.sqrt()? - 1.0)?.broadcast_mul(latent);
        let position = smooth(squared.narrow(3, 0, 2)?.sum(3)?)?;
        let heading = smooth(squared.narrow(3, 2, 1)?.squeeze(3)?)?;
        let n_latent = latent.flatten_from(1)?.sum(1)?.maximum(1.0)?;
        (position + heading)?.flatten_from(1)?.sum(1)?.div(&n_latent)?.reshape((n_rows, n_modes))
    }
}

/// 1 at `indices` (B) of each row, (B, n).
fn one_hot(indices: &Tensor, n: usize, device: &candle_core::Device) -> Result<Tensor> {
    let indices = indices.to_vec1::<u32>()?;
    let values = indices.iter().flat_map(|at| (0..n).map(move |i| f32::from(u8::from(i == *at as usize)))).collect();
    Tensor::from_vec(values, (indices.len(), n), device)
}

/// Training of a `SceneTransformer` on the scenes of a dataset.
pub struct JointFuturesTask<'a> {
    /// The network with trainable parameters.
    pub network: &'a SceneTransformer,
    /// The model without gradients, for evaluation.
    pub frozen: &'a SceneTransformer,
    /// Draws batches.
    pub draws: SceneDraws<'a>,
}

impl TrainTask for JointFuturesTask<'_> {
    fn loss(&self, step: u64) -> std::result::Result<Tensor, Error> {
        let DrawnBatch { batch, .. } = self.draws.training_batch(step)?;
        let JointLoss { regression, mode } = JointLoss::new(&self.network.forward(&batch)?, &batch)?;
        // Both as they are: a nat counts as much as a meter beyond one.
        Ok((regression + mode)?)
    }

    fn prepare(&self, step: u64) -> std::result::Result<(), Error> {
        self.draws.prepare(step)
    }

    fn evaluate(&self) -> std::result::Result<BTreeMap<String, f64>, Error> {
        let names = ["held_out_error_of_best", "held_out_mode_loss"];
        let means = self.draws.held_out_means(names.len(), |DrawnBatch { batch, .. }| {
            let JointLoss { regression, mode } = JointLoss::new(&self.frozen.forward(batch)?, batch)?;
            Ok(vec![regression, mode])
        })?;
        Ok(names.into_iter().map(str::to_owned).zip(means).collect())
    }
}

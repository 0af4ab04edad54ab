//! Training the denoiser: the paper's loss over p(𝒪), p_train and the recorded scenes.

use super::latent_error::squared_error;
use super::{DenoiserTraining, DrawnBatch, Error, SceneDraws, TrainTask};
use crate::diffusion::{Denoiser, NoiseSource, rows_like};
use crate::model::SceneDenoiser;
use crate::tensor::SceneBatch;
use candle_core::Tensor;
use std::collections::BTreeMap;

/// The noise levels at which held-out losses are given: from finest detail to the choice of a maneuver.
const EVALUATION_SIGMAS: [f64; 4] = [0.05, 0.2, 0.8, 3.0];

/// Training of a `SceneDenoiser` on the scenes of a dataset.
pub struct DenoisingTask<'a> {
    /// The denoiser with trainable parameters.
    pub denoiser: &'a SceneDenoiser,
    /// The same parameters without gradients, for evaluation.
    pub frozen: &'a SceneDenoiser,
    /// Settings.
    pub training: &'a DenoiserTraining,
    /// Draws batches.
    pub draws: SceneDraws<'a>,
}

impl DenoisingTask<'_> {
    /// λ(σ) |D(x0 + σ ε; σ) - x0|², averaged over the scored scalars of the batch; one σ a row.
    pub(super) fn weighted_error(
        &self,
        denoiser: &SceneDenoiser,
        batch: &SceneBatch,
        sigmas: &[f64],
        noise: &mut NoiseSource,
    ) -> Result<Tensor, Error> {
        let latent = batch.latent.unsqueeze(3)?;
        let weight: Vec<f64> =
            sigmas.iter().map(|s| denoiser.edm().loss_weight(self.training.loss_weight, *s)).collect();
        let sigma_rows = rows_like(sigmas.to_vec(), &batch.x0)?;
        let noise = noise.draw_like(&batch.x0)?.broadcast_mul(&sigma_rows)?;
        let x = (&batch.x0 + noise)?.broadcast_mul(&latent)?;
        let x0_hat = denoiser.bind(batch, 1)?.denoise(&x, &sigma_rows.flatten_all()?)?;
        let squared = squared_error(batch, &x0_hat, &batch.x0, self.training.path_loss)?;
        let weighted = squared.broadcast_mul(&rows_like(weight, &batch.x0)?)?;
        let n_scored = (batch.scored.sum_all()? * self.draws.collator.normalizer.state_dim as f64)?.maximum(1.0)?;
        Ok(weighted.sum_all()?.div(&n_scored)?)
    }
}

impl TrainTask for DenoisingTask<'_> {
    fn loss(&self, step: u64) -> Result<Tensor, Error> {
        let DrawnBatch { batch, seeds, mut rngs } = self.draws.training_batch(step)?;
        let sigmas: Vec<f64> = rngs.iter_mut().map(|rng| self.training.noise.draw(rng)).collect();
        self.weighted_error(self.denoiser, &batch, &sigmas, &mut NoiseSource::new(seeds))
    }

    fn prepare(&self, step: u64) -> Result<(), Error> {
        self.draws.prepare(step)
    }

    fn evaluate(&self) -> Result<BTreeMap<String, f64>, Error> {
        let means = self.draws.held_out_means(EVALUATION_SIGMAS.len(), |batch, seeds| {
            let loss = |sigma: f64| {
                let sigmas = vec![sigma; seeds.len()];
                self.weighted_error(self.frozen, batch, &sigmas, &mut NoiseSource::new(seeds.to_vec()))
            };
            EVALUATION_SIGMAS.into_iter().map(loss).collect()
        })?;
        let named = |(sigma, mean): (f64, f64)| (format!("held_out_loss_at_sigma_{sigma}"), mean);
        Ok(EVALUATION_SIGMAS.into_iter().zip(means).map(named).collect())
    }
}

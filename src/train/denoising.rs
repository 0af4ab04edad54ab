//! Training the denoiser: the paper's loss over p(𝒪), p_train and the recorded scenes.

use super::changed_losses::losses_of;
use super::latent_error::squared_error;
use super::objective_loss::{objective_costs, objective_loss};
use super::scene_error::scene_error_m;
use super::{DenoiserTraining, DrawnBatch, Error, SceneDraws, TrainTask};
use crate::diffusion::{Denoiser, NoiseSource, rows_like};
use crate::model::{SceneChange, SceneDenoiser};
use crate::seed::Seed;
use crate::tensor::{Collator, SceneBatch};
use candle_core::Tensor;
use std::collections::BTreeMap;

/// The noise levels at which held-out losses are given: from finest detail to the choice of a maneuver.
const EVALUATION_SIGMAS: [f64; 4] = [0.05, 0.2, 0.8, 3.0];

/// The noise level at which losses on changed scenes are also taken; all of them would cost too much.
const CHANGED_SIGMA: f64 = 0.8;

/// The figure by which trainings that start from a checkpoint are judged, meters.
pub const SCENE_ERROR: &str = "held_out_min_scene_ade_m";

/// Training of a `SceneDenoiser` on the scenes of a dataset.
pub struct DenoisingTask<'a> {
    /// The denoiser with trainable parameters.
    pub denoiser: &'a SceneDenoiser,
    /// The model without gradients, for evaluation.
    pub frozen: &'a SceneDenoiser,
    /// Settings.
    pub training: &'a DenoiserTraining,
    /// Draws batches.
    pub draws: SceneDraws<'a>,
    /// How scenes become batches to sample, if evaluations sample futures and are judged by their error.
    pub sampling: Option<Collator>,
}

impl DenoisingTask<'_> {
    /// D(x0 + σ ε; σ), one σ a row, with ε drawn from `seeds`.
    fn estimate(denoiser: &SceneDenoiser, batch: &SceneBatch, sigmas: &[f64], seeds: &[Seed]) -> Result<Tensor, Error> {
        let sigma_rows = rows_like(sigmas.to_vec(), &batch.x0)?;
        let noise = NoiseSource::new(seeds.to_vec()).draw_like(&batch.x0)?.broadcast_mul(&sigma_rows)?;
        let x = (&batch.x0 + noise)?.broadcast_mul(&batch.latent.unsqueeze(3)?)?;
        Ok(denoiser.bind(batch, 1)?.denoise(&x, &sigma_rows.flatten_all()?)?)
    }

    /// λ(σ) |x0_hat - x0|², averaged over the scored scalars of the batch; one σ a row.
    fn weighted_error(&self, batch: &SceneBatch, x0_hat: &Tensor, sigmas: &[f64]) -> Result<Tensor, Error> {
        let edm = self.denoiser.edm();
        let weight: Vec<f64> = sigmas.iter().map(|s| edm.loss_weight(*s)).collect();
        let squared = squared_error(batch, x0_hat, &batch.x0, self.training.path_loss)?;
        let weighted = squared.broadcast_mul(&rows_like(weight, &batch.x0)?)?;
        let n_scored = (batch.scored.sum_all()? * self.draws.collator.normalizer.state_dim as f64)?;
        Ok(weighted.sum_all()?.div(&n_scored.maximum(1.0)?)?)
    }

    /// The error of sampled futures of held-out scenes, if they are sampled, meters.
    pub(super) fn scene_error_m(&self) -> Result<Option<f64>, Error> {
        let error_m = self.sampling.as_ref().map(|collator| scene_error_m(self.frozen, collator, &self.draws));
        Ok(error_m.transpose()?.flatten())
    }

    /// 1 for each row at a noise level at which objectives count.
    fn counts(&self, sigmas: &[f64]) -> Vec<f32> {
        sigmas.iter().map(|sigma| f32::from(u8::from(*sigma <= self.training.objectives_below_sigma))).collect()
    }

    /// The loss of the frozen denoiser with every row at noise level `sigma`.
    pub(super) fn held_out_loss(&self, batch: &SceneBatch, sigma: f64, seeds: &[Seed]) -> Result<Tensor, Error> {
        let sigmas = vec![sigma; seeds.len()];
        self.weighted_error(batch, &Self::estimate(self.frozen, batch, &sigmas, seeds)?, &sigmas)
    }
}

impl TrainTask for DenoisingTask<'_> {
    fn loss(&self, step: u64) -> Result<Tensor, Error> {
        let drawn = self.draws.training_batch(step)?;
        let sigmas: Vec<f64> = drawn.rngs.iter().map(|rng| self.training.noise.draw(&mut rng.clone())).collect();
        let x0_hat = Self::estimate(self.denoiser, &drawn.batch, &sigmas, &drawn.seeds)?;
        let error = self.weighted_error(&drawn.batch, &x0_hat, &sigmas)?;
        let counts = self.counts(&sigmas);
        let n_counted = f64::from(counts.iter().sum::<f32>());
        Ok(match objective_loss(&self.training.objectives, &x0_hat, &drawn, &counts, n_counted)? {
            Some(cost) => (error + cost)?,
            None => error,
        })
    }

    fn prepare(&self, step: u64) -> Result<(), Error> {
        self.draws.prepare(step)
    }

    fn evaluate(&self) -> Result<BTreeMap<String, f64>, Error> {
        let objectives = &self.training.objectives;
        let losses = EVALUATION_SIGMAS.into_iter().map(|sigma| format!("held_out_loss_at_sigma_{sigma}"));
        let costs = objectives.iter().map(|objective| format!("held_out_cost_of_{}", objective.kind()));
        let names: Vec<String> = losses.chain(costs).collect();
        let means = self.draws.held_out_means(names.len(), |drawn| {
            let DrawnBatch { batch, seeds, .. } = drawn;
            let loss = |sigma: f64| self.held_out_loss(batch, sigma, seeds);
            let mut figures = EVALUATION_SIGMAS.into_iter().map(loss).collect::<Result<Vec<_>, Error>>()?;
            let sigmas = vec![self.training.objectives_below_sigma; seeds.len()];
            if !objectives.is_empty() {
                let x0_hat = Self::estimate(self.frozen, batch, &sigmas, seeds)?;
                for cost in objective_costs(objectives, &x0_hat, drawn)? {
                    figures.push(cost.mean_all()?);
                }
            }
            Ok(figures)
        })?;
        let mut found: BTreeMap<String, f64> = names.into_iter().zip(means).collect();
        for change in SceneChange::ALL.into_iter().filter(|change| *change != SceneChange::AsRecorded) {
            let losses = losses_of(self, self.draws.held_out, change, &[CHANGED_SIGMA])?;
            let name = format!("held_out_loss_at_sigma_{CHANGED_SIGMA}_{}", change.name());
            found.extend(losses.into_iter().map(|loss| (name.clone(), loss)));
        }
        found.extend(self.scene_error_m()?.map(|error_m| (SCENE_ERROR.to_owned(), error_m)));
        Ok(found)
    }

    fn badness(&self, figures: &BTreeMap<String, f64>) -> Option<f64> {
        // The loss may fall while sampled scenes get worse.
        if self.sampling.is_some() {
            return figures.get(SCENE_ERROR).copied();
        }
        // A mean of logarithms: losses differ by orders of magnitude between levels.
        let loss = |sigma: f64| figures.get(&format!("held_out_loss_at_sigma_{sigma}")).map(|loss| loss.ln());
        EVALUATION_SIGMAS.into_iter().map(loss).sum()
    }
}

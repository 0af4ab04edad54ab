//! Tuning a denoiser into a consistency model (ECT, Geng et al. 2024): the loss.

use super::latent_error::{pseudo_huber, squared_error};
use super::{BatchPart, DistillTraining, DrawnBatch, Error, SceneDraws, TrainTask};
use crate::diffusion::{Denoiser, NoiseDistribution, NoiseSource, rows_like};
use crate::model::SceneDenoiser;
use crate::settings::{self, Issue};
use crate::tensor::SceneBatch;
use candle_core::Tensor;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// The noise levels at which held-out losses are given.
const EVALUATION_SIGMAS: [f64; 3] = [0.2, 0.8, 10.0];
/// The least gap of the last stage relative to the noise level, so that single precision resolves it.
const MAX_SHRINKING: f64 = 1e5;

/// Consistency tuning: predictions at two levels of the same noise are trained to agree.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct ConsistencyTuning {
    /// The gap between the two noise levels.
    pub gap: LevelGap,
    /// Distribution of the upper noise level.
    pub noise: NoiseDistribution,
}

impl Default for ConsistencyTuning {
    fn default() -> Self {
        // Wider than for training from scratch, because a consistency model must also predict from pure noise.
        Self { gap: LevelGap::default(), noise: NoiseDistribution { p_mean: -0.5, p_std: 2.0 } }
    }
}

impl ConsistencyTuning {
    /// Rejects gaps that shrink too far.
    pub(super) fn validate(&self) -> settings::Result {
        settings::check_ranges(self)?;
        let shrunk = self.gap.ratio.powf(self.gap.n_stages as f64);
        match shrunk <= MAX_SHRINKING {
            true => Ok(()),
            false => Err(Issue::new(
                "gap.n_stages",
                format_args!(
                    "is {}, by which gap.ratio grows to {shrunk}, expected 100000 at most; closer levels are \
                     indistinguishable",
                    self.gap.n_stages
                ),
            )),
        }
    }
}

/// The gap between the two noise levels at which predictions are trained to agree.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct LevelGap {
    /// The gap shrinks by this factor q from stage to stage.
    #[schemars(extend("exclusiveMinimum" = 1))]
    pub ratio: f64,
    /// Number of stages, of equal length.
    #[schemars(range(min = 1, max = 1_000_000))]
    pub n_stages: u64,
    /// How much wider the gap is at low noise, k.
    #[schemars(range(min = 0.0))]
    pub widening: f64,
    /// How quickly that decreases as the noise grows, b.
    #[schemars(range(min = 0.0))]
    pub widening_decay: f64,
}

impl Default for LevelGap {
    fn default() -> Self {
        Self { ratio: 2.0, n_stages: 6, widening: 8.0, widening_decay: 1.0 }
    }
}

impl LevelGap {
    /// The lower noise level r of t in `stage` (from 0): r = t (1 - (1 + k / (1 + e^(b t))) / q^(stage + 1)), at
    /// least 0. In the first stage it is mostly 0, and the loss that of a denoiser; in the end t and r are close.
    pub fn lower(&self, t: f64, stage: u64) -> f64 {
        let widened = 1.0 + self.widening / (1.0 + (self.widening_decay * t).exp());
        let share = widened / self.ratio.powi(i32::try_from(stage).unwrap_or(i32::MAX - 1) + 1);
        (t * (1.0 - share)).max(0.0)
    }

    /// The stage of a step.
    pub fn stage(&self, step: u64, steps: u64) -> u64 {
        (step * self.n_stages / steps.max(1)).min(self.n_stages.saturating_sub(1))
    }
}

/// Consistency tuning of a `SceneDenoiser` on the scenes of a dataset.
pub struct ConsistencyTask<'a> {
    /// The denoiser with trainable parameters.
    pub denoiser: &'a SceneDenoiser,
    /// The same parameters without gradients, for the lower noise level and for evaluations.
    pub frozen: &'a SceneDenoiser,
    /// The levels.
    pub tuning: ConsistencyTuning,
    /// Other settings.
    pub training: &'a DistillTraining,
    /// Draws batches.
    pub draws: SceneDraws<'a>,
}

impl ConsistencyTask<'_> {
    /// The mean over `n_rows` rows, of which these are all or a part, of (√(‖D(x0 + t ε; t) - D(x0 + r ε; r)‖² + c²) -
    /// c) / (t - r), with the same ε on both sides, no gradient through the second one, and D(x0; 0) = x0. The norm is
    /// the root mean square of the valid latent scalars, and of their sums along time, as in the denoiser's loss.
    fn disagreement(
        &self,
        denoiser: &SceneDenoiser,
        batch: &SceneBatch,
        levels: &[(f64, f64)],
        noise: &mut NoiseSource,
        n_rows: usize,
    ) -> Result<Tensor, Error> {
        let latent = batch.latent.unsqueeze(3)?;
        let eps = noise.draw_like(&batch.x0)?.broadcast_mul(&latent)?;
        let at = |denoiser: &SceneDenoiser, sigmas: Vec<f64>| -> Result<Tensor, Error> {
            let rows = rows_like(sigmas, &batch.x0)?;
            let x = (&batch.x0 + eps.broadcast_mul(&rows)?)?.broadcast_mul(&latent)?;
            Ok(denoiser.bind(batch, 1)?.denoise(&x, &rows.flatten_all()?)?)
        };
        let upper = at(denoiser, levels.iter().map(|(t, _)| *t).collect())?;
        let ends = levels.iter().map(|(_, r)| f64::from(u8::from(*r <= 0.0))).collect::<Vec<_>>();
        // The network takes the logarithm of the noise level, so rows at 0 are evaluated at another level and replaced.
        let asked = levels.iter().map(|(t, r)| if *r > 0.0 { *r } else { *t }).collect();
        let lower = match ends.iter().all(|end| *end > 0.0) {
            true => batch.x0.clone(),
            false => {
                let is_end = rows_like(ends, &batch.x0)?;
                let answered = at(self.frozen, asked)?.detach();
                (batch.x0.broadcast_mul(&is_end)? + answered.broadcast_mul(&(1.0 - &is_end)?)?)?
            }
        };
        let squared = squared_error(batch, &upper, &lower, self.training.path_loss)?;
        let distance = pseudo_huber(batch, &squared, self.training.huber)?;
        let weights: Vec<f64> = levels.iter().map(|(t, r)| 1.0 / (t - r)).collect();
        let weights = rows_like(weights, &distance)?.flatten_all()?;
        Ok(((distance * weights)?.sum_all()? / n_rows as f64)?)
    }
}

impl TrainTask for ConsistencyTask<'_> {
    fn batch_size(&self) -> usize {
        self.draws.batch_size
    }

    fn loss(&self, part: &BatchPart, _divisors: Option<&[f64]>) -> Result<Tensor, Error> {
        let DrawnBatch { batch, seeds, mut rngs, .. } = self.draws.training_batch(part)?;
        let stage = self.tuning.gap.stage(part.step, self.training.common.fit.steps);
        let levels: Vec<(f64, f64)> = (rngs.iter_mut())
            .map(|rng| self.tuning.noise.draw(rng))
            .map(|t| (t, self.tuning.gap.lower(t, stage)))
            .collect();
        self.disagreement(self.denoiser, &batch, &levels, &mut NoiseSource::new(seeds), self.batch_size())
    }

    fn prepare(&self, part: &BatchPart) -> Result<(), Error> {
        self.draws.prepare(part)
    }

    fn evaluate(&self) -> Result<BTreeMap<String, f64>, Error> {
        // Always with the gap of the last stage, so that evaluations of all stages are comparable.
        let last = self.tuning.gap.n_stages.saturating_sub(1);
        let means = self.draws.held_out_means(EVALUATION_SIGMAS.len(), |DrawnBatch { batch, seeds, .. }| {
            let disagreement = |sigma: f64| {
                let levels = vec![(sigma, self.tuning.gap.lower(sigma, last)); seeds.len()];
                self.disagreement(self.frozen, batch, &levels, &mut NoiseSource::new(seeds.clone()), seeds.len())
            };
            EVALUATION_SIGMAS.into_iter().map(disagreement).collect()
        })?;
        let named = |(sigma, mean): (f64, f64)| (format!("held_out_disagreement_at_sigma_{sigma}"), mean);
        Ok(EVALUATION_SIGMAS.into_iter().zip(means).map(named).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_lower_level_has_the_hand_computed_values() {
        let gap = LevelGap { ratio: 2.0, n_stages: 4, widening: 8.0, widening_decay: 1.0 };
        // At t = ln 3 the widening is 1 + 8 / (1 + 3) = 3: shares 3/2 (so 0), 3/4, 3/8, 3/16.
        let t = 3f64.ln();
        for (stage, expected) in [0.0, 0.25, 0.625, 0.8125].into_iter().enumerate() {
            assert!((gap.lower(t, stage as u64) - t * expected).abs() < 1e-12, "stage {stage}");
        }
        // Far up the widening is gone: half of t.
        assert!((gap.lower(60.0, 0) - 30.0).abs() < 1e-9);
        // Stages are of equal length, and the last one does not end early.
        assert_eq!([0, 24, 25, 50, 99, 200].map(|step| gap.stage(step, 100)), [0, 0, 1, 2, 3, 3]);
    }
}

//! Training a behavior classifier: weighted cross-entropy on mined pairs.

use super::{Error, NoiseLevelReport, NoisyBatch, NoisyPairs, TrainTask};
use crate::diffusion::rows_like;
use crate::model::{BehaviorClassifier, log_sigmoid};
use crate::nn::side_by_side;
use crate::seed::Seed;
use candle_core::{DType, Tensor};
use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::{Mutex, PoisonError};

/// The noise levels at which held-out figures are given, from fine detail to little more than the history.
pub const REPORT_SIGMAS: [f64; 6] = [0.02, 0.1, 0.3, 1.0, 3.0, 10.0];

/// Training of a classifier on pairs.
pub struct ClassificationTask<'a> {
    /// The classifier with trainable parameters.
    pub classifier: &'a BehaviorClassifier,
    /// The model without gradients, for evaluation.
    pub frozen: &'a BehaviorClassifier,
    /// The pairs.
    pub inputs: &'a NoisyPairs<'a>,
    /// The weight of a positive pair relative to a negative one.
    pub pos_weight: f64,
    /// Pairs a step.
    pub batch_size: usize,
    /// Seed of every draw.
    pub seed: Seed,
    /// The batch of a step that was made in advance; `None` at first.
    pub ahead: Mutex<Option<(u64, NoisyBatch)>>,
}

impl ClassificationTask<'_> {
    /// The pairs of `step` with their weights. Half of them are positive, whatever the balance of the data. Weights
    /// correct for this, so that the expected loss is that of uniform draws in which a positive pair counts
    /// `pos_weight` times as much as a negative one. Uniform draws would have a handful of positive pairs a batch at
    /// best.
    fn draw(&self, step: u64) -> (Vec<usize>, Vec<f64>) {
        let mut rng = self.seed.derive("batch", &[step]).rng();
        let [labels, _] = self.inputs.labels();
        let (n_positive, n_negative) = (labels.positive().len() as f64, labels.negative().len() as f64);
        let positive_mass = n_positive * self.pos_weight / (n_positive * self.pos_weight + n_negative);
        let draw = |row: usize| {
            let (pool, mass) = match row % 2 {
                0 => (labels.positive(), positive_mass),
                _ => (labels.negative(), 1.0 - positive_mass),
            };
            (pool[rng.below(pool.len())], 2.0 * mass)
        };
        (0..self.batch_size).map(draw).unzip()
    }

    /// Figures on the held-out pairs at each of `REPORT_SIGMAS`, with the same noise at every call.
    pub fn report(&self) -> Result<Vec<NoiseLevelReport>, Error> {
        let is_positive = self.inputs.labels()[1].is_positive();
        let n = is_positive.len();
        let chunks: Vec<Range<usize>> =
            (0..n).step_by(self.batch_size).map(|first| first..(first + self.batch_size).min(n)).collect();
        let seed = |level: usize, i: usize| self.seed.derive("held-out", &[level as u64, i as u64]);
        let logits = side_by_side(self.inputs.device, &chunks, |pairs| {
            let at_levels = self.inputs.held_out_logits(self.frozen, pairs.clone(), &REPORT_SIGMAS, seed)?;
            let on_host = |logits: Tensor| Ok(logits.to_dtype(DType::F64)?.to_vec1::<f64>()?);
            at_levels.into_iter().map(on_host).collect::<Result<Vec<_>, Error>>()
        })?;
        let at_level = |(level, sigma): (usize, f64)| {
            let logits: Vec<f64> = logits.iter().flat_map(|at_levels| at_levels[level].clone()).collect();
            NoiseLevelReport::new(sigma, &logits, is_positive, self.pos_weight)
        };
        Ok(REPORT_SIGMAS.into_iter().enumerate().map(at_level).collect())
    }

    /// The pairs of `step` under noise.
    fn batch(&self, step: u64) -> Result<NoisyBatch, Error> {
        let seeds: Vec<Seed> = (0..self.batch_size).map(|row| self.seed.derive("row", &[step, row as u64])).collect();
        self.inputs.training_batch(&self.draw(step).0, seeds)
    }
}

impl TrainTask for ClassificationTask<'_> {
    fn loss(&self, step: u64) -> Result<Tensor, Error> {
        let (pairs, weights) = self.draw(step);
        let ahead = self.ahead.lock().unwrap_or_else(PoisonError::into_inner).take();
        let batch = match ahead.filter(|(of_step, _)| *of_step == step) {
            Some((_, batch)) => batch,
            None => self.batch(step)?,
        };
        let logits = batch.logits(self.classifier)?;
        // -ln p of the label: the sign of the logit is the label's.
        let is_positive = self.inputs.labels()[0].is_positive();
        let signs = pairs.iter().map(|i| if is_positive[*i] { 1.0 } else { -1.0 }).collect();
        let log_likelihood = log_sigmoid(&(&logits * rows_like(signs, &logits)?)?)?;
        let weighted = (log_likelihood * rows_like(weights, &logits)?)?;
        Ok((weighted.sum_all()? / self.batch_size as f64)?.neg()?)
    }

    fn prepare(&self, step: u64) -> Result<(), Error> {
        let batch = self.batch(step)?;
        *self.ahead.lock().unwrap_or_else(PoisonError::into_inner) = Some((step, batch));
        Ok(())
    }

    fn evaluate(&self) -> Result<BTreeMap<String, f64>, Error> {
        let mut figures = BTreeMap::new();
        for level in self.report()? {
            let mut put = |name: &str, value: Option<f64>| {
                figures.extend(value.map(|value| (format!("held_out_{name}_at_sigma_{}", level.sigma), value)));
            };
            put("auc", level.auc);
            put("precision", level.precision);
            put("recall", level.recall);
            put("calibration_error", level.calibration_error);
        }
        Ok(figures)
    }
}

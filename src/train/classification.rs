//! Training a behavior classifier: weighted cross-entropy on mined pairs, seen through noise of every level.

use super::{BatchPart, Error, NoiseLevelReport, PairExample, PairExamples, TrainTask};
use crate::diffusion::{NoiseDistribution, NoiseSource, rows_like};
use crate::model::{BehaviorClassifier, ClassifierSpec, log_sigmoid};
use crate::scene::ObservationMask;
use crate::seed::Seed;
use crate::tensor::{Collator, FutureValidity, SceneBatch, SceneView};
use candle_core::{DType, Device, Tensor};
use std::collections::BTreeMap;

/// The noise levels at which held-out figures are given, from fine detail to little more than the history.
pub const REPORT_SIGMAS: [f64; 6] = [0.02, 0.1, 0.3, 1.0, 3.0, 10.0];

/// Training of a `BehaviorClassifier` on pairs.
pub struct ClassificationTask<'a> {
    /// The classifier with trainable parameters.
    pub classifier: &'a BehaviorClassifier,
    /// The same parameters without gradients, for evaluation.
    pub frozen: &'a BehaviorClassifier,
    /// What the classifier is.
    pub spec: &'a ClassifierSpec,
    /// Distribution of the training noise levels.
    pub noise: NoiseDistribution,
    /// Pairs a step.
    pub batch_size: usize,
    /// Pairs to train on, of both labels.
    pub train: &'a PairExamples,
    /// Held-out pairs.
    pub held_out: &'a PairExamples,
    /// Seed of every draw.
    pub seed: Seed,
    /// Where tensors live.
    pub device: &'a Device,
}

impl ClassificationTask<'_> {
    /// The examples of `step` with their weights. Half of them are positive, whatever the balance of the data. Weights
    /// correct for this, so that the expected loss is that of uniform draws in which a positive example counts
    /// `pos_weight` times as much as a negative one. Uniform draws would have a handful of positive examples a batch at
    /// best.
    fn draw(&self, step: u64) -> (Vec<&PairExample>, Vec<f64>) {
        let mut rng = self.seed.derive("batch", &[step]).rng();
        let (n_positive, n_negative) = (self.train.positive().len() as f64, self.train.negative().len() as f64);
        let positive_mass = n_positive * self.spec.pos_weight / (n_positive * self.spec.pos_weight + n_negative);
        let draw = |row: usize| {
            let (pool, mass) = match row % 2 {
                0 => (self.train.positive(), positive_mass),
                _ => (self.train.negative(), 1.0 - positive_mass),
            };
            (&self.train.examples()[pool[rng.below(pool.len())]], 2.0 * mass)
        };
        (0..self.batch_size).map(draw).unzip()
    }

    /// The logits (B) of pairs at the noise levels `sigmas`, with noise from `noise`.
    fn logits(
        &self,
        classifier: &BehaviorClassifier,
        examples: &[&PairExample],
        sigmas: &[f64],
        noise: &mut NoiseSource,
    ) -> Result<Tensor, Error> {
        let batch = self.collate(examples)?;
        let pairs: Vec<(usize, usize)> = examples.iter().map(|example| example.pair).collect();
        let sigma_rows = rows_like(sigmas.to_vec(), &batch.x0)?;
        let x = (&batch.x0 + noise.draw_like(&batch.x0)?.broadcast_mul(&sigma_rows)?)?;
        Ok(classifier.logits(&self.spec.features(&batch, &pairs)?, &x, &sigma_rows.flatten_all()?)?)
    }

    fn collate(&self, examples: &[&PairExample]) -> Result<SceneBatch, Error> {
        let masks: Vec<ObservationMask> = examples
            .iter()
            .map(|PairExample { scene, .. }| {
                ObservationMask::predictive(scene.tracks.len(), scene.n_timesteps, scene.n_history)
            })
            .collect();
        let view = |(example, mask)| {
            let PairExample { scene, .. }: &PairExample = example;
            SceneView { scene, ego_idx: scene.ego_idx, mask }
        };
        let views: Vec<SceneView<'_>> = examples.iter().copied().zip(&masks).map(view).collect();
        let collator = Collator {
            normalizer: self.spec.normalizer.clone(),
            n_timesteps: self.spec.n_timesteps,
            max_agents: 2,
            max_lanes: 0,
            sight: None,
        };
        Ok(collator.collate(&views, FutureValidity::Recorded, self.device)?)
    }

    /// Figures on the held-out pairs at each of `REPORT_SIGMAS`, with the same noise at every call.
    ///
    /// # Errors
    /// When a tensor operation fails.
    pub fn report(&self) -> Result<Vec<NoiseLevelReport>, Error> {
        let examples: Vec<(usize, &PairExample)> = self.held_out.examples().iter().enumerate().collect();
        let is_positive: Vec<bool> = examples.iter().map(|(_, example)| example.is_positive).collect();
        let at_level = |(level, sigma): (usize, f64)| {
            let mut logits = Vec::with_capacity(examples.len());
            for chunk in examples.chunks(self.batch_size) {
                let seed = |(i, _): &(usize, &PairExample)| self.seed.derive("held-out", &[level as u64, *i as u64]);
                let mut noise = NoiseSource::new(chunk.iter().map(seed).collect());
                let chunk: Vec<&PairExample> = chunk.iter().map(|(_, example)| *example).collect();
                let chunk_logits = self.logits(self.frozen, &chunk, &vec![sigma; chunk.len()], &mut noise)?;
                logits.extend(chunk_logits.to_dtype(DType::F64)?.to_vec1::<f64>()?);
            }
            Ok(NoiseLevelReport::new(sigma, &logits, &is_positive))
        };
        REPORT_SIGMAS.into_iter().enumerate().map(at_level).collect()
    }
}

impl TrainTask for ClassificationTask<'_> {
    fn batch_size(&self) -> usize {
        self.batch_size
    }

    fn loss(&self, BatchPart { step, rows }: &BatchPart, _divisors: Option<&[f64]>) -> Result<Tensor, Error> {
        let (examples, weights) = self.draw(*step);
        let (examples, weights) = (&examples[rows.clone()], weights[rows.clone()].to_vec());
        let seeds: Vec<Seed> = rows.clone().map(|row| self.seed.derive("row", &[*step, row as u64])).collect();
        let sigmas: Vec<f64> = seeds.iter().map(|seed| self.noise.draw(&mut seed.derive("sigma", &[]).rng())).collect();
        let logits = self.logits(self.classifier, examples, &sigmas, &mut NoiseSource::new(seeds))?;
        // -ln p of the label: the sign of the logit is the label's.
        let signs = examples.iter().map(|example| if example.is_positive { 1.0 } else { -1.0 }).collect();
        let log_likelihood = log_sigmoid(&(&logits * rows_like(signs, &logits)?)?)?;
        let weighted = (log_likelihood * rows_like(weights, &logits)?)?;
        Ok((weighted.sum_all()? / self.batch_size as f64)?.neg()?)
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
        }
        Ok(figures)
    }
}

//! Labeled pairs as a classifier of clean futures is shown them: the recorded future, and the denoiser's estimates of it.

use super::{DenoisingTask, Error, LabeledPair, Labels, PairInputs, REPORT_SIGMAS, SceneDataset, TrainJob};
use crate::diffusion::NoiseDistribution;
use crate::model::{ClassifierNetwork, TrainedDenoiser};
use crate::scene::{ObservationMask, Scene};
use crate::seed::Seed;
use crate::tensor::{Collator, FutureFeatures, FutureValidity, Moments, SceneBatch, ScenePair, SceneView};
use candle_core::{Device, Tensor};
use rayon::prelude::*;
use std::ops::Range;

/// Estimates of each training pair, at drawn noise levels. They are made once, before the first step.
const N_ESTIMATES: usize = 3;
/// Scenes that are denoised together.
const BATCH_SIZE: usize = 8;

/// Futures of pairs, several of each, as features.
struct PairFutures {
    labels: Labels,
    /// The futures of each pair after one another.
    moments: Moments,
    n_futures: usize,
}

/// The pairs of a training on clean futures.
///
/// The label of every future is the miner's, on the recording. An estimate at a high noise level may not show the event that the
/// recording does; it counts as positive all the same, because this is how a sample looks that will still become one. What is learned is
/// therefore the probability of the event given an estimate of the drawn levels, and not whether the estimate shows it already.
pub struct CleanPairs {
    train: PairFutures,
    held_out: PairFutures,
}

/// What futures are made with.
struct Estimator<'a> {
    dataset: &'a dyn SceneDataset,
    denoiser: &'a TrainedDenoiser,
    job: TrainJob<'a>,
    /// The noise levels of a pair's futures. At 0 it is the recorded one.
    sigmas: &'a (dyn Fn(usize) -> Vec<f64> + Sync),
    seed: Seed,
}

impl CleanPairs {
    /// The recorded future of each pair in `train` and three estimates at levels drawn from `noise`, and an estimate of each in `held_out` at
    /// every one of [`REPORT_SIGMAS`].
    ///
    /// # Errors
    /// When a scene cannot be loaded or lacks the tracks of its pairs.
    pub fn gather(
        dataset: &dyn SceneDataset,
        [train, held_out]: [&[LabeledPair]; 2],
        denoiser: &TrainedDenoiser,
        noise: NoiseDistribution,
        job: TrainJob<'_>,
    ) -> Result<Self, Error> {
        let drawn = |pair: usize| {
            let mut rng = job.seed.derive("estimate levels", &[pair as u64]).rng();
            let estimates = (0..N_ESTIMATES).map(|_| noise.draw(&mut rng));
            std::iter::once(0.0).chain(estimates).collect()
        };
        let of = |pairs, purpose, sigmas| {
            let seed = job.seed.derive(purpose, &[]);
            Estimator { dataset, denoiser, job, sigmas, seed }.futures(pairs)
        };
        Ok(Self {
            train: of(train, "train estimates", &drawn)?,
            held_out: of(held_out, "held-out estimates", &|_| REPORT_SIGMAS.to_vec())?,
        })
    }
}

impl Estimator<'_> {
    fn futures(&self, pairs: &[LabeledPair]) -> Result<PairFutures, Error> {
        let (progress, device) = (self.job.progress, &self.job.compute.device);
        progress.start("estimate", pairs.len() as u64, "pairs");
        let batches: Vec<(usize, &[LabeledPair])> = pairs.chunks(BATCH_SIZE).enumerate().collect();
        let batch = |(i, batch): &(usize, &[LabeledPair])| {
            let moments = self.futures_of_batch(i * BATCH_SIZE, batch)?;
            progress.advance(batch.len() as u64);
            Ok(moments)
        };
        let moments: Vec<Moments> = match device {
            Device::Cpu => batches.par_iter().map(batch).collect::<Result<_, Error>>()?,
            _ => batches.iter().map(batch).collect::<Result<_, Error>>()?,
        };
        progress.finish();
        let labels = Labels::new(pairs.iter().map(|pair| pair.is_positive).collect());
        Ok(PairFutures { labels, moments: joined(&moments, device)?, n_futures: (self.sigmas)(0).len() })
    }

    /// The futures of pairs that begin with the `first`, those of each after one another.
    fn futures_of_batch(&self, first: usize, pairs: &[LabeledPair]) -> Result<Moments, Error> {
        let scenes: Vec<Scene> = pairs
            .iter()
            .map(|pair| self.dataset.scene(pair.scene_idx).map_err(Error::Scene))
            .collect::<Result<_, Error>>()?;
        let agents: Vec<(usize, usize)> =
            pairs.iter().zip(&scenes).map(|(pair, scene)| pair.agents(scene)).collect::<Result<_, Error>>()?;
        let scene_pair = |(scene, agents): (_, &(usize, usize))| ScenePair { scene, agents: *agents };
        let of_scenes: Vec<ScenePair<'_>> = scenes.iter().zip(&agents).map(scene_pair).collect();
        let batch = self.collate(&of_scenes)?;
        let features = FutureFeatures::new(&batch, &of_scenes)?;
        let sigmas: Vec<Vec<f64>> = (0..pairs.len()).map(|row| (self.sigmas)(first + row)).collect();
        let (mut values, mut valid) = (Vec::new(), Vec::new());
        for level in 0..sigmas[0].len() {
            let at_level: Vec<f64> = sigmas.iter().map(|of_pair| of_pair[level]).collect();
            let x0 = self.estimates(&batch, first, level, &at_level)?;
            let moments = features.moments(&batch.decode(&x0)?)?;
            values.push(moments.features);
            valid.push(moments.valid);
        }
        Ok(Moments {
            features: Tensor::stack(&values, 1)?.flatten(0, 1)?.detach(),
            valid: Tensor::stack(&valid, 1)?.flatten(0, 1)?,
        })
    }

    /// Scenes as in sampling: with everybody in them, around the first agent of each pair, with all that sampling would generate.
    fn collate(&self, pairs: &[ScenePair<'_>]) -> Result<SceneBatch, Error> {
        let mask = |scene: &Scene| ObservationMask::predictive(scene.tracks.len(), scene.n_timesteps, scene.n_history);
        let masks: Vec<ObservationMask> = pairs.iter().map(|pair| mask(pair.scene)).collect();
        let view = |(ScenePair { scene, agents }, mask)| SceneView { scene, ego_idx: agents.0, mask };
        let views: Vec<SceneView<'_>> = pairs.iter().copied().zip(&masks).map(view).collect();
        // Both agents of a pair must be among those that are kept.
        let collator = Collator { max_agents: usize::MAX, ..self.denoiser.spec.sampling_collator() };
        Ok(collator.collate(&views, FutureValidity::Continued, &self.job.compute.device)?)
    }

    /// D(x₀ + σ ε; σ), or x₀ where every σ is 0.
    fn estimates(&self, batch: &SceneBatch, first: usize, level: usize, sigmas: &[f64]) -> Result<Tensor, Error> {
        if sigmas.iter().all(|sigma| *sigma == 0.0) {
            return Ok(batch.x0.clone());
        }
        let seed = |row: usize| self.seed.derive("noise", &[(first + row) as u64, level as u64]);
        let seeds: Vec<Seed> = (0..sigmas.len()).map(seed).collect();
        DenoisingTask::estimate(&self.denoiser.network, batch, sigmas, &seeds)
    }
}

/// All of them as one. Without any, none.
fn joined(parts: &[Moments], device: &Device) -> Result<Moments, Error> {
    if parts.is_empty() {
        let none = |shape: &[usize]| Tensor::zeros(shape, candle_core::DType::F32, device);
        return Ok(Moments { features: none(&[0, 1, FutureFeatures::MOMENT])?, valid: none(&[0, 1])? });
    }
    let join = |of: fn(&Moments) -> &Tensor| Tensor::cat(&parts.iter().map(of).collect::<Vec<_>>(), 0);
    Ok(Moments { features: join(|part| &part.features)?, valid: join(|part| &part.valid)? })
}

impl PairFutures {
    /// The logits of these pairs, each in one of its futures.
    fn logits(
        &self,
        classifier: &ClassifierNetwork,
        chosen: impl Iterator<Item = (usize, usize)>,
    ) -> Result<Tensor, Error> {
        let rows: Vec<u32> = chosen.map(|(pair, future)| (pair * self.n_futures + future) as u32).collect();
        let rows = Tensor::new(rows, self.moments.valid.device())?;
        let Moments { features, valid } = &self.moments;
        let moments = Moments { features: features.index_select(&rows, 0)?, valid: valid.index_select(&rows, 0)? };
        Ok(classifier.of_clean_futures()?.logits(&moments)?)
    }
}

impl PairInputs for CleanPairs {
    fn labels(&self) -> [&Labels; 2] {
        [&self.train.labels, &self.held_out.labels]
    }

    fn training_logits(
        &self,
        classifier: &ClassifierNetwork,
        pairs: &[usize],
        seeds: Vec<Seed>,
    ) -> Result<Tensor, Error> {
        let future = |seed: Seed| seed.derive("future", &[]).rng().below(self.train.n_futures);
        self.train.logits(classifier, pairs.iter().copied().zip(seeds.into_iter().map(future)))
    }

    fn held_out_logits(
        &self,
        classifier: &ClassifierNetwork,
        pairs: Range<usize>,
        (level, _): (usize, f64),
        _seeds: Vec<Seed>,
    ) -> Result<Tensor, Error> {
        self.held_out.logits(classifier, pairs.map(|pair| (pair, level)))
    }
}

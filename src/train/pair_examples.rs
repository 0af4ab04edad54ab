//! Labeled pairs as a classifier of noisy states is shown them: scenes of two agents under noise of every level.

use super::{Error, LabeledPair, Labels, SceneDataset};
use crate::diffusion::{NoiseDistribution, NoiseSource, rows_like};
use crate::model::{BehaviorClassifier, ClassifierSpec};
use crate::scene::{LaneGraph, ObservationMask, Scene, Track};
use crate::seed::Seed;
use crate::tensor::{Collator, FutureValidity, PairFeatures, SceneView};
use candle_core::{Device, Tensor};
use rayon::prelude::*;
use std::ops::Range;
use std::sync::Arc;

/// A scene reduced to the input of the classifier for one pair.
#[derive(Debug, Clone)]
pub struct PairExample {
    /// The agents of the pair, with the first as the ego agent, as guidance will see them; no lanes.
    pub scene: Scene,
    /// Indices of the first and second role among the scene's tracks; equal for behaviors of a single agent.
    pub pair: (usize, usize),
}

/// Examples of one behavior, positive and hard negative.
#[derive(Debug, Clone, Default)]
pub struct PairExamples {
    examples: Vec<PairExample>,
    labels: Labels,
}

impl PairExamples {
    /// The examples of `pairs`, which are ordered by scene.
    ///
    /// # Errors
    /// When a scene cannot be loaded or lacks the tracks of its pairs.
    pub fn gather(dataset: &dyn SceneDataset, pairs: &[LabeledPair]) -> Result<Self, Error> {
        // Each scene is loaded once, and results are collected in order.
        let by_scene: Vec<&[LabeledPair]> = pairs.chunk_by(|a, b| a.scene_idx == b.scene_idx).collect();
        let loaded: Vec<Vec<PairExample>> = by_scene
            .par_iter()
            .map(|pairs| {
                let mut scene = dataset.scene(pairs[0].scene_idx).map_err(Error::Scene)?;
                let agents = pairs.iter().map(|pair| pair.agents(&scene)).collect::<Result<Vec<_>, Error>>()?;
                let tracks = std::mem::take(&mut scene.tracks);
                let bare = Scene { ego_idx: 0, lanes: Arc::new(LaneGraph::default()), ..scene };
                Ok(agents.into_iter().map(|agents| PairExample::new(&bare, &tracks, agents)).collect())
            })
            .collect::<Result<_, Error>>()?;
        let labels = Labels::new(pairs.iter().map(|pair| pair.is_positive).collect());
        Ok(Self { examples: loaded.into_iter().flatten().collect(), labels })
    }

    /// All examples, in a fixed order.
    pub fn examples(&self) -> &[PairExample] {
        &self.examples
    }

    /// Their labels.
    pub const fn labels(&self) -> &Labels {
        &self.labels
    }
}

impl PairExample {
    /// The example of two of the `tracks` of a scene that is `bare` of them and of lanes.
    fn new(bare: &Scene, tracks: &[Track], (first, second): (usize, usize)) -> Self {
        let mut kept = vec![first, second];
        kept.dedup();
        let pair = (0, kept.len() - 1);
        let tracks = kept.iter().map(|track_idx| tracks[*track_idx].clone()).collect();
        Self { scene: Scene { tracks, ..bare.clone() }, pair }
    }
}

/// The pairs of a training on noisy states.
pub struct NoisyPairs<'a> {
    /// The specification of the classifier.
    pub spec: &'a ClassifierSpec,
    /// Distribution of the training noise levels.
    pub noise: NoiseDistribution,
    /// Pairs to train on, of both labels.
    pub train: &'a PairExamples,
    /// Held-out pairs.
    pub held_out: &'a PairExamples,
    /// Where tensors live.
    pub device: &'a Device,
}

/// Some pairs as the classifier sees them, and their states without noise.
struct CleanPairs {
    features: PairFeatures,
    x0: Tensor,
}

impl CleanPairs {
    /// Their states (B, A, T, D) and noise levels (B), with noise of levels `sigmas` drawn from `seeds`.
    fn noisy(&self, sigmas: Vec<f64>, seeds: Vec<Seed>) -> Result<[Tensor; 2], Error> {
        let sigmas = rows_like(sigmas, &self.x0)?;
        let noise = NoiseSource::new(seeds).draw_like(&self.x0)?.broadcast_mul(&sigmas)?;
        Ok([(&self.x0 + noise)?, sigmas.flatten_all()?])
    }
}

/// The pairs of a training step under noise.
pub struct NoisyBatch {
    clean: CleanPairs,
    noisy: [Tensor; 2],
}

impl NoisyBatch {
    /// The logits (B).
    pub fn logits(&self, classifier: &BehaviorClassifier) -> Result<Tensor, Error> {
        let [x, sigmas] = &self.noisy;
        Ok(classifier.logits(&self.clean.features, x, sigmas)?)
    }
}

impl NoisyPairs<'_> {
    fn collate(&self, examples: &[&PairExample]) -> Result<CleanPairs, Error> {
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
        let batch = collator.collate(&views, FutureValidity::Recorded, self.device)?;
        let pairs: Vec<(usize, usize)> = examples.iter().map(|example| example.pair).collect();
        Ok(CleanPairs { features: self.spec.features(&batch, &pairs)?, x0: batch.x0.clone() })
    }

    /// Labels of the pairs to train on, which include both kinds, and of the held-out pairs.
    pub const fn labels(&self) -> [&Labels; 2] {
        [&self.train.labels, &self.held_out.labels]
    }

    /// These training pairs, each at the noise level and with the noise that its seed draws.
    pub fn training_batch(&self, pairs: &[usize], seeds: Vec<Seed>) -> Result<NoisyBatch, Error> {
        let examples: Vec<&PairExample> = pairs.iter().map(|i| &self.train.examples[*i]).collect();
        let sigmas: Vec<f64> = seeds.iter().map(|seed| self.noise.draw(&mut seed.derive("sigma", &[]).rng())).collect();
        let clean = self.collate(&examples)?;
        Ok(NoisyBatch { noisy: clean.noisy(sigmas, seeds)?, clean })
    }

    /// The logits (B) of held-out pairs at each of the noise levels `sigmas`, with the noise that `seed` draws for a
    /// level and a pair.
    pub fn held_out_logits(
        &self,
        classifier: &BehaviorClassifier,
        pairs: Range<usize>,
        sigmas: &[f64],
        seed: impl Fn(usize, usize) -> Seed,
    ) -> Result<Vec<Tensor>, Error> {
        let examples: Vec<&PairExample> = self.held_out.examples[pairs.clone()].iter().collect();
        let clean = self.collate(&examples)?;
        let at_level = |(level, sigma): (usize, &f64)| {
            let seeds = pairs.clone().map(|i| seed(level, i)).collect();
            let [x, sigmas] = clean.noisy(vec![*sigma; pairs.len()], seeds)?;
            Ok(classifier.logits(&clean.features, &x, &sigmas)?)
        };
        sigmas.iter().enumerate().map(at_level).collect()
    }
}

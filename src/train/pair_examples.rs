//! Labeled pairs as a classifier of noisy states is shown them: scenes of two agents under noise of every level.

use super::{Error, LabeledPair, Labels, SceneDataset};
use crate::diffusion::{NoiseDistribution, NoiseSource, rows_like};
use crate::model::{BehaviorClassifier, ClassifierSpec};
use crate::scene::{LaneGraph, ObservationMask, Scene};
use crate::seed::Seed;
use crate::tensor::{Collator, FutureValidity, SceneBatch, SceneView};
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
                let scene = dataset.scene(pairs[0].scene_idx).map_err(Error::Scene)?;
                pairs.iter().map(|pair| Ok(PairExample::new(&scene, pair.agents(&scene)?))).collect()
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
    fn new(scene: &Scene, (first, second): (usize, usize)) -> Self {
        let mut kept = vec![first, second];
        kept.dedup();
        let pair = (0, kept.len() - 1);
        let tracks = kept.iter().map(|track_idx| scene.tracks[*track_idx].clone()).collect();
        let scene = Scene { tracks, ego_idx: 0, lanes: Arc::new(LaneGraph::default()), ..scene.clone() };
        Self { scene, pair }
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

impl NoisyPairs<'_> {
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
        let features = self.spec.features(&batch, &pairs)?;
        Ok(classifier.logits(&features, &x, &sigma_rows.flatten_all()?)?)
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

    /// Labels of the pairs to train on, which include both kinds, and of the held-out pairs.
    pub const fn labels(&self) -> [&Labels; 2] {
        [&self.train.labels, &self.held_out.labels]
    }

    /// The logits (B) of these training pairs, each at the noise level and with the noise that its seed draws.
    pub fn training_logits(
        &self,
        classifier: &BehaviorClassifier,
        pairs: &[usize],
        seeds: Vec<Seed>,
    ) -> Result<Tensor, Error> {
        let examples: Vec<&PairExample> = pairs.iter().map(|i| &self.train.examples[*i]).collect();
        let sigmas: Vec<f64> = seeds.iter().map(|seed| self.noise.draw(&mut seed.derive("sigma", &[]).rng())).collect();
        self.logits(classifier, &examples, &sigmas, &mut NoiseSource::new(seeds))
    }

    /// The logits (B) of held-out pairs at noise level `sigma`, each with the noise that its seed draws.
    pub fn held_out_logits(
        &self,
        classifier: &BehaviorClassifier,
        pairs: Range<usize>,
        sigma: f64,
        seeds: Vec<Seed>,
    ) -> Result<Tensor, Error> {
        let examples: Vec<&PairExample> = self.held_out.examples[pairs].iter().collect();
        self.logits(classifier, &examples, &vec![sigma; examples.len()], &mut NoiseSource::new(seeds))
    }
}

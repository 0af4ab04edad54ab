//! Turns mined events into training examples for a pairwise classifier.

use super::{Error, SceneDataset};
use crate::behavior::{BehaviorEvent, EventLabel};
use crate::scene::{LaneGraph, Scene, TrackId};
use crate::seed::Seed;
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::sync::Arc;

/// A mined event with the place of its scene in the dataset.
#[derive(Debug, Clone, Copy)]
pub struct MinedEvent<'a> {
    /// Index of the scene in the dataset.
    pub scene_idx: usize,
    /// The event.
    pub event: &'a BehaviorEvent,
}

/// A scene reduced to what the classifier of one pair needs.
#[derive(Debug, Clone)]
pub struct PairExample {
    /// The agents of the pair, with the first as the ego agent, as guidance will see them; no lanes.
    pub scene: Scene,
    /// Indices of the first and second role among the scene's tracks; equal for behaviors of a single agent.
    pub pair: (usize, usize),
    /// Whether the pair performs the behavior.
    pub is_positive: bool,
}

/// Examples of one behavior, positive and hard negative.
#[derive(Debug, Clone, Default)]
pub struct PairExamples {
    examples: Vec<PairExample>,
    positive: Vec<usize>,
    negative: Vec<usize>,
}

/// The pair of a scene that a label belongs to.
type PairKey = (usize, TrackId, TrackId);

impl PairExamples {
    /// The examples of `events`, which are all of one behavior. A pair with several events is positive if one of them
    /// is. With more than `max_examples` pairs, random negative ones are left out, and then positive ones.
    ///
    /// # Errors
    /// When a scene cannot be loaded or lacks the tracks of its events.
    pub fn gather(
        dataset: &dyn SceneDataset,
        events: &[MinedEvent<'_>],
        max_examples: usize,
        seed: Seed,
    ) -> Result<Self, Error> {
        let mut labels: BTreeMap<PairKey, bool> = BTreeMap::new();
        for MinedEvent { scene_idx, event } in events {
            let mut tracks = event.roles.tracks().cloned();
            let Some(first) = tracks.next() else { continue };
            let second = tracks.next().unwrap_or_else(|| first.clone());
            *labels.entry((*scene_idx, first, second)).or_default() |= event.label == EventLabel::Positive;
        }
        let kept = limit(labels, max_examples, seed);
        // Each scene is loaded once, and results are collected in order.
        let by_scene: Vec<&[(PairKey, bool)]> = kept.chunk_by(|a, b| a.0.0 == b.0.0).collect();
        let loaded: Vec<Vec<PairExample>> = by_scene
            .par_iter()
            .map(|pairs| {
                let scene = dataset.scene(pairs[0].0.0).map_err(Error::Scene)?;
                pairs.iter().map(|(key, is_positive)| PairExample::new(&scene, key, *is_positive)).collect()
            })
            .collect::<Result<_, Error>>()?;
        Ok(Self::new(loaded.into_iter().flatten().collect()))
    }

    /// The given examples.
    pub fn new(examples: Vec<PairExample>) -> Self {
        let (positive, negative) = (0..examples.len()).partition(|i| examples[*i].is_positive);
        Self { examples, positive, negative }
    }

    /// All examples, in a fixed order.
    pub fn examples(&self) -> &[PairExample] {
        &self.examples
    }

    /// Indices of the positive examples.
    pub fn positive(&self) -> &[usize] {
        &self.positive
    }

    /// Indices of the negative examples.
    pub fn negative(&self) -> &[usize] {
        &self.negative
    }
}

impl PairExample {
    fn new(scene: &Scene, (_, first, second): &PairKey, is_positive: bool) -> Result<Self, Error> {
        let find = |track: &TrackId| {
            scene
                .track_idx(track)
                .ok_or_else(|| Error::Config(format!("scene {} has no track {track}; mine the scenes again", scene.id)))
        };
        let mut kept = vec![find(first)?, find(second)?];
        kept.dedup();
        let pair = (0, kept.len() - 1);
        let tracks = kept.iter().map(|track_idx| scene.tracks[*track_idx].clone()).collect();
        let scene = Scene { tracks, ego_idx: 0, lanes: Arc::new(LaneGraph::default()), ..scene.clone() };
        Ok(Self { scene, pair, is_positive })
    }
}

/// At most `max_examples` of the labeled pairs, in their order.
fn limit(labels: BTreeMap<PairKey, bool>, max_examples: usize, seed: Seed) -> Vec<(PairKey, bool)> {
    let mut labels: Vec<(PairKey, bool)> = labels.into_iter().collect();
    if labels.len() > max_examples {
        let mut order: Vec<usize> = (0..labels.len()).collect();
        seed.derive("examples", &[]).rng().shuffle(&mut order);
        order.sort_by_key(|i| !labels[*i].1);
        let mut is_kept = vec![false; labels.len()];
        order[..max_examples].iter().for_each(|i| is_kept[*i] = true);
        let mut is_kept = is_kept.into_iter();
        labels.retain(|_| is_kept.next().unwrap_or(false));
    }
    labels
}

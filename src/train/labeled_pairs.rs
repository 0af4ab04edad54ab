//! Turns mined events into labeled pairs for a pairwise classifier.

use super::Error;
use crate::behavior::{BehaviorEvent, EventLabel};
use crate::scene::{Scene, TrackId};
use crate::seed::Seed;
use std::collections::BTreeMap;

/// A mined event with the place of its scene in the dataset.
#[derive(Debug, Clone, Copy)]
pub struct MinedEvent<'a> {
    /// Index of the scene in the dataset.
    pub scene_idx: usize,
    /// The event.
    pub event: &'a BehaviorEvent,
}

/// A pair of a scene with its label.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LabeledPair {
    /// Index of the scene in the dataset.
    pub scene_idx: usize,
    /// The tracks of the first and second role; one track twice for behaviors of a single agent.
    pub tracks: (TrackId, TrackId),
    /// Whether the pair performs the behavior.
    pub is_positive: bool,
}

impl LabeledPair {
    /// The pairs of `events`, which are all of one behavior, by scene. A pair with several events is positive if one of
    /// them is. With more than `max_pairs` pairs, random negative ones are left out until half are positive, then
    /// random ones of both kinds.
    pub fn of_events(events: &[MinedEvent<'_>], max_pairs: usize, seed: Seed) -> Vec<Self> {
        let mut labels: BTreeMap<(usize, TrackId, TrackId), bool> = BTreeMap::new();
        for MinedEvent { scene_idx, event } in events {
            let mut tracks = event.roles.tracks().cloned();
            let Some(first) = tracks.next() else { continue };
            let second = tracks.next().unwrap_or_else(|| first.clone());
            *labels.entry((*scene_idx, first, second)).or_default() |= event.label == EventLabel::Positive;
        }
        let pair = |((scene_idx, first, second), is_positive)| Self { scene_idx, tracks: (first, second), is_positive };
        limit(labels.into_iter().map(pair).collect(), max_pairs, seed)
    }

    /// Indices of the two tracks in the pair's scene.
    pub(super) fn agents(&self, scene: &Scene) -> Result<(usize, usize), Error> {
        let find = |track: &TrackId| {
            scene
                .track_idx(track)
                .ok_or_else(|| Error::Config(format!("scene {} has no track {track}; mine the scenes again", scene.id)))
        };
        Ok((find(&self.tracks.0)?, find(&self.tracks.1)?))
    }
}

/// The labels of some pairs.
#[derive(Debug, Clone, Default)]
pub struct Labels {
    is_positive: Vec<bool>,
    positive: Vec<usize>,
    negative: Vec<usize>,
}

impl Labels {
    /// The labels of pairs in this order.
    pub fn new(is_positive: Vec<bool>) -> Self {
        let (positive, negative) = (0..is_positive.len()).partition(|i| is_positive[*i]);
        Self { is_positive, positive, negative }
    }

    /// Whether each pair is positive.
    pub fn is_positive(&self) -> &[bool] {
        &self.is_positive
    }

    /// Indices of the positive pairs.
    pub fn positive(&self) -> &[usize] {
        &self.positive
    }

    /// Indices of the negative pairs.
    pub fn negative(&self) -> &[usize] {
        &self.negative
    }
}

/// At most `max_pairs` of the pairs, in their order.
fn limit(mut pairs: Vec<LabeledPair>, max_pairs: usize, seed: Seed) -> Vec<LabeledPair> {
    if pairs.len() > max_pairs {
        let mut order: Vec<usize> = (0..pairs.len()).collect();
        seed.derive("examples", &[]).rng().shuffle(&mut order);
        let (positive, negative): (Vec<usize>, Vec<usize>) = order.into_iter().partition(|i| pairs[*i].is_positive);
        let n_positive = max_pairs.div_ceil(2).max(max_pairs.saturating_sub(negative.len())).min(positive.len());
        let mut is_kept = vec![false; pairs.len()];
        let kept = positive[..n_positive].iter().chain(&negative[..max_pairs - n_positive]);
        kept.for_each(|i| is_kept[*i] = true);
        let mut is_kept = is_kept.into_iter();
        pairs.retain(|_| is_kept.next().unwrap_or(false));
    }
    pairs
}

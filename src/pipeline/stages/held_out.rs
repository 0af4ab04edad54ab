//! Which scenes of a store do models learn from, and which are held out?

use crate::engine::Result;
use crate::progress::{Progress, Silent};
use crate::scene::{SceneId, Split, moments};
use crate::seed::Seed;
use crate::store::{SceneIndex, SceneIndexEntry, SceneStore};
use crate::train::{MoreScenes, OwnScenes, SceneChoice};
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet, HashSet};
use std::ops::Range;

/// Where no split tells them apart, one in this many recordings is held out; of a single recording, this part of its
/// scenes.
const HOLD_OUT_EVERY: usize = 10;

/// Scenes by index, in the store's order.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(super) struct TrainingScenes {
    pub(super) train: Vec<usize>,
    /// Scenes to judge by, none of which shares a moment with one to train on.
    pub(super) held_out: Vec<usize>,
    /// Scenes that are neither, for they share moments with scenes to train on and with held-out ones.
    pub(super) across: Vec<usize>,
}

impl TrainingScenes {
    /// Trains on the given splits (none: `train`, or everything unsplit if there is no such split) and places (none:
    /// all), and holds out the `val` scenes of these places; without any, a part of the scenes to train on.
    pub(super) fn of(store: &SceneStore, own: OwnScenes<'_>, progress: &dyn Progress) -> Result<Self> {
        let index = store.index();
        let chosen = Self::new(index, own);
        let is_divided_here = |idx: &usize| {
            let SceneIndexEntry { id, split, .. } = index.get(*idx);
            split != Split::Val || SceneId::window_of(id).is_some()
        };
        // The splits of datasets are trusted. Of what is divided here or was by the ingest, two files may show the same
        // moment.
        let n_chosen = chosen.train.len();
        let mut apart = chosen;
        if apart.held_out.iter().any(is_divided_here) {
            let (held_out, train) = (moments_of(store, &apart.held_out)?, moments_of(store, &apart.train)?);
            apart = apart.apart(&held_out, &train);
        }
        if n_chosen > apart.train.len() {
            let n = n_chosen - apart.train.len();
            progress.warn(&format!("{n} scenes are not trained on: they show moments of scenes that are held out"));
        }
        if apart.held_out.is_empty() && !apart.train.is_empty() {
            let (n, all) =
                (apart.train.len(), "all that there are: none can be held out, and none is left to judge by");
            progress.warn(&format!("models learn from {n} scenes, {all}"));
        }
        Ok(apart)
    }

    /// The choice by splits, places, recordings and time alone.
    fn new(index: &SceneIndex, OwnScenes { splits, places }: OwnScenes<'_>) -> Self {
        let of = |wanted: &dyn Fn(Split) -> bool| -> Vec<usize> {
            let chosen = index.iter().enumerate().filter(|(_, entry)| wanted(entry.split));
            chosen.map(|(idx, _)| idx).collect()
        };
        let is_here = |idx: &usize| places.is_empty() || places.iter().any(|place| place == index.get(*idx).place);
        let has_train = index.iter().any(|entry| entry.split == Split::Train);
        let default = if has_train { Split::Train } else { Split::Unsplit };
        let train = of(&|split| if splits.is_empty() { split == default } else { splits.contains(&split) });
        let mut held_out = of(&|split| split == Split::Val && !splits.contains(&split));
        held_out.retain(is_here);
        // The places do not change what is held out: trainings with other places share it.
        let mut chosen = match held_out.is_empty() {
            true => Self::divided(index, train),
            false => Self { train, held_out, across: Vec::new() },
        };
        for scenes in [&mut chosen.train, &mut chosen.held_out, &mut chosen.across] {
            scenes.retain(is_here);
        }
        chosen
    }

    /// Divides scenes by their recordings, or a single recording by time. A recording alone decides on which side it
    /// is, so that the others may come and go; only where that would leave one side empty, the others count.
    fn divided(index: &SceneIndex, scenes: Vec<usize>) -> Self {
        let mut recordings: BTreeMap<&str, Vec<usize>> = BTreeMap::new();
        for idx in scenes {
            recordings.entry(frames_of(index, idx).0).or_default().push(idx);
        }
        let draw = |name: &str| Seed(0).derive_named("held out", name).0;
        let mut drawn: Vec<(u64, Vec<usize>)> =
            recordings.into_iter().map(|(name, scenes)| (draw(name), scenes)).collect();
        drawn.sort_unstable();
        if drawn.len() < 2 {
            return Self::divided_by_time(index, drawn.pop().map_or_else(Vec::new, |(_, scenes)| scenes));
        }
        let n_chosen = drawn.partition_point(|(draw, _)| *draw < u64::MAX / HOLD_OUT_EVERY as u64);
        let trained = drawn.split_off(n_chosen.clamp(1, drawn.len() - 1));
        let [train, held_out] = [trained, drawn].map(|side| {
            let mut scenes: Vec<usize> = side.into_iter().flat_map(|(_, scenes)| scenes).collect();
            scenes.sort_unstable();
            scenes
        });
        Self { train, held_out, across: Vec::new() }
    }

    /// Holds out the last scenes of a recording, if any scene ends before them; those across the cut are neither.
    fn divided_by_time(index: &SceneIndex, mut scenes: Vec<usize>) -> Self {
        let frames = |idx: &usize| frames_of(index, *idx).1;
        scenes.sort_by_key(|idx| frames(idx).start);
        let n_held_out = scenes.len().div_ceil(HOLD_OUT_EVERY);
        let Some(first) = scenes.get(scenes.len().saturating_sub(n_held_out)) else { return Self::default() };
        let cut = frames(first).start;
        let (held_out, earlier): (Vec<usize>, Vec<usize>) = scenes.iter().partition(|idx| frames(idx).start >= cut);
        let (train, across): (Vec<usize>, Vec<usize>) = earlier.into_iter().partition(|idx| frames(idx).end <= cut);
        if train.is_empty() { Self { train: scenes, ..Self::default() } } else { Self { train, held_out, across } }
    }

    /// Does not train on scenes that have a moment in common with held-out ones, by the moments of both.
    fn apart(self, held_out: &[Vec<u64>], train: &[Vec<u64>]) -> Self {
        let seen: HashSet<u64> = held_out.iter().flatten().copied().collect();
        let (mut left, mut across) = (Vec::new(), self.across);
        for (idx, moments) in self.train.iter().zip(train) {
            let is_seen = moments.iter().any(|moment| seen.contains(moment));
            if is_seen { &mut across } else { &mut left }.push(*idx);
        }
        match left.is_empty() {
            true => Self { train: self.train, held_out: Vec::new(), across: self.held_out },
            false => Self { train: left, held_out: self.held_out, across },
        }
    }
}

/// The recording and the frames of a scene. A scene that is no window is a recording by itself.
fn frames_of(index: &SceneIndex, idx: usize) -> (&str, Range<i64>) {
    let SceneIndexEntry { id, n_timesteps, .. } = index.get(idx);
    let (recording, first) = SceneId::window_of(id).unwrap_or((id, 0));
    (recording, first..first + i64::from(n_timesteps))
}

fn moments_of(store: &SceneStore, scenes: &[usize]) -> Result<Vec<Vec<u64>>> {
    let marks = |idx: &usize| Ok(moments(&store.scene(*idx)?).into_iter().map(|(_, mark)| mark).collect());
    scenes.par_iter().map(marks).collect()
}

/// The scenes that one of these trainings learns from, wholly or in part: none of them is held out.
///
/// # Errors
/// When scenes of other runs are not there any more.
pub(super) fn learned(choices: &[SceneChoice<'_>], store: &SceneStore) -> Result<BTreeSet<usize>> {
    let mut learned = BTreeSet::new();
    for SceneChoice { own, own_weight, data, .. } in choices {
        if *own_weight > 0.0 {
            let TrainingScenes { train, across, .. } = TrainingScenes::of(store, *own, &Silent)?;
            learned.extend(train.into_iter().chain(across));
        }
        for MoreScenes { scenes, .. } in *data {
            let other = SceneStore::open(scenes)?;
            let mut elsewhere: BTreeMap<&str, Vec<Range<i64>>> = BTreeMap::new();
            for idx in TrainingScenes::of(&other, OwnScenes::default(), &Silent)?.train {
                let (recording, frames) = frames_of(other.index(), idx);
                elsewhere.entry(recording).or_default().push(frames);
            }
            learned.extend((0..store.len()).filter(|idx| {
                let (recording, frames) = frames_of(store.index(), *idx);
                let meets = |other: &Range<i64>| frames.start < other.end && other.start < frames.end;
                elsewhere.get(recording).is_some_and(|learned| learned.iter().any(meets))
            }));
        }
    }
    Ok(learned)
}

#[cfg(test)]
mod tests;

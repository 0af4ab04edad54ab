//! Are closed loops of a denoiser that was trained further at least as valid as those of the one it began as?
//!
//! Samples of three seconds may look fine where a loop of thirty leads across the island of a roundabout.

use super::training_scenes::OpenedScenes;
use crate::engine::{Result, Stopwatch};
use crate::evaluate::MapFits;
use crate::generate::Futures;
use crate::ingest::IngestConfig;
use crate::metrics::{MetricSettings, ValidityConfig};
use crate::model::TrainedDenoiser;
use crate::progress::Progress;
use crate::simulate::{LoopCounts, NewScenes, SituationsConfig};
use crate::store::SceneStore;
use crate::train::TrainJob;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// The length of a loop: this part of the time of the training, within these limits, seconds.
const OF_TRAINING: f64 = 1.0 / 20.0;
const HORIZON_S: [f64; 2] = [6.0, 30.0];
/// The part of the training's time in which loops of the checkpoint are driven; those of what is trained take as long.
const SHARE: f64 = 0.055;
/// The least and largest number of loops.
const N_LOOPS: [usize; 2] = [3, 40];
/// How often loops of models that drive as well may be taken for worse ones at most.
const BY_CHANCE: f64 = 0.125;

/// The part of each closed loop that is valid, up to the first window that is not, by the scene that it begins with.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct ValidLoops {
    /// By scene: the valid windows.
    n_valid: BTreeMap<String, u64>,
    n_windows: u64,
    /// The length of each loop, seconds.
    horizon_s: f64,
    /// The time that it took, seconds.
    pub(super) seconds: f64,
    /// What is valid, once it is known.
    #[serde(skip)]
    judged_by: Option<MetricSettings>,
}

/// Hears whether to stop, and shows nothing.
struct Unseen<'a>(&'a dyn Progress);

impl Progress for Unseen<'_> {
    fn must_stop(&self) -> bool {
        self.0.must_stop()
    }
}

impl ValidLoops {
    /// Drives loops with `model` from held-out scenes, as long and as many as suit a training of `within_s` seconds.
    pub(super) fn of_start(
        model: &TrainedDenoiser,
        scenes: &OpenedScenes,
        within_s: f64,
        job: TrainJob<'_>,
    ) -> Result<Self> {
        let watch = Stopwatch::start();
        let horizon_s = (OF_TRAINING * within_s).clamp(HORIZON_S[0], HORIZON_S[1]).round();
        let mut loops = Self { horizon_s, ..Self::default() };
        let Some((store, held_out)) = scenes.held_out() else { return Ok(loops) };
        let mut positions = held_out.to_vec();
        job.seed.derive("loops", &[]).rng().shuffle(&mut positions);
        positions.truncate(N_LOOPS[1]);
        // The first ones tell how many there is time for.
        let later = positions.split_off(positions.len().min(N_LOOPS[0].max(rayon::current_num_threads())));
        loops.drive(model, store, &positions, job)?;
        let n_more = (SHARE * within_s / watch.elapsed_s() - 1.0).max(0.0) * positions.len() as f64;
        loops.drive(model, store, &later[..later.len().min(n_more as usize)], job)?;
        loops.seconds = watch.elapsed_s();
        Ok(loops)
    }

    /// Drives loops with another model from the same scenes.
    pub(super) fn again(&self, model: &TrainedDenoiser, scenes: &OpenedScenes, job: TrainJob<'_>) -> Result<Self> {
        let mut loops = Self { horizon_s: self.horizon_s, judged_by: self.judged_by.clone(), ..Self::default() };
        let Some((store, held_out)) = scenes.held_out() else { return Ok(loops) };
        let is_driven = |position: &&usize| self.n_valid.contains_key(store.index().get(**position).id);
        let positions: Vec<usize> = held_out.iter().filter(is_driven).copied().collect();
        loops.drive(model, store, &positions, job)?;
        Ok(loops)
    }

    fn drive(
        &mut self,
        model: &TrainedDenoiser,
        store: &SceneStore,
        positions: &[usize],
        job: TrainJob<'_>,
    ) -> Result<()> {
        let Some(first) = positions.first() else { return Ok(()) };
        // Scenes of a place follow each other in the store.
        let mut positions = positions.to_vec();
        positions.sort_unstable();
        let config = SituationsConfig {
            continued: positions.len(),
            populated: 0,
            horizon_s: self.horizon_s,
            ..SituationsConfig::default()
        };
        let futures = Futures::new(model, job.seed.0, &job.compute.device)?;
        let judged_by = match self.judged_by.take() {
            Some(known) => known,
            None => MapFits::of(store, &ValidityConfig::default())?.settings(&ValidityConfig::default()),
        };
        let ingest = IngestConfig::new(store.index().get(*first).dataset, Vec::new());
        let new = NewScenes { config: &config, futures: &futures, store, judged_by: &judged_by, ingest: &ingest };
        for position in &positions {
            self.n_valid.insert(store.index().get(*position).id.to_owned(), 0);
        }
        job.progress.start("loops", 0, "loops");
        let counts = new.make(&positions, LoopCounts::default(), &Unseen(job.progress), &mut |found, _, _| {
            for continued in found.iter().filter_map(|scene| scene.source.continues.as_ref()) {
                *self.n_valid.entry(continued.0.clone()).or_default() += 1;
            }
            Ok(())
        })?;
        job.progress.finish();
        self.judged_by = Some(judged_by);
        self.n_windows = (counts.n_scenes + counts.n_left_out) / counts.n_loops.max(1);
        Ok(())
    }

    pub(super) fn n_loops(&self) -> usize {
        self.n_valid.len()
    }

    /// The mean of the valid parts.
    pub(super) fn valid_share(&self) -> f64 {
        let n = self.n_valid.len() as f64 * self.n_windows as f64;
        if n > 0.0 { self.n_valid.values().sum::<u64>() as f64 / n } else { 1.0 }
    }

    /// Whether loops from the same scenes are less valid than these in so many more scenes than they are more valid
    /// that chance brings it in at most [`BY_CHANCE`] (a sign test): a few loops of long trainings say little.
    pub(super) fn are_better_than(&self, others: &Self) -> bool {
        let pairs = || self.n_valid.iter().filter_map(|(scene, n)| Some((*n, *others.n_valid.get(scene)?)));
        let n_worse = pairs().filter(|(n, of_other)| of_other < n).count();
        let n_differing = pairs().filter(|(n, of_other)| of_other != n).count();
        let mut share = 0.5_f64.powi(n_differing as i32);
        let mut by_chance = 0.0;
        for n in 0..=n_differing {
            by_chance += if n >= n_worse { share } else { 0.0 };
            share *= (n_differing - n) as f64 / (n + 1) as f64;
        }
        by_chance <= BY_CHANCE
    }

    /// Loops of nine windows, of which so many are valid.
    #[cfg(test)]
    pub(super) fn made(n_valid: &[u64]) -> Self {
        let n_valid = n_valid.iter().enumerate().map(|(i, n)| (format!("scene {i}"), *n)).collect();
        Self { n_valid, n_windows: 9, horizon_s: 30.0, ..Self::default() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn loops_are_worse_if_more_scenes_are_than_chance_brings() {
        let began = ValidLoops::made(&[9, 9, 9, 5]);
        assert!((began.valid_share() - 32.0 / 36.0).abs() < 1e-12);
        // One of eight if three of three are worse, one of four if two are, five of sixteen if three of four are.
        assert!(began.are_better_than(&ValidLoops::made(&[0, 8, 3, 5])));
        assert!(!began.are_better_than(&ValidLoops::made(&[0, 0, 9, 5])));
        assert!(!began.are_better_than(&ValidLoops::made(&[0, 0, 0, 9])));
        assert!(!began.are_better_than(&began) && !began.are_better_than(&ValidLoops::made(&[9; 4])));
        assert!(!ValidLoops::default().are_better_than(&ValidLoops::default()));
    }
}

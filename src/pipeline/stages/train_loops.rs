//! Are closed loops of a denoiser that was trained further at least as valid as those of the one it began as?
//!
//! Samples of three seconds may look fine where a loop of thirty leads across the island of a roundabout.

use super::training_scenes::OpenedScenes;
use crate::engine::Result;
use crate::evaluate::{for_maps, map_fits};
use crate::generate::Futures;
use crate::ingest::IngestConfig;
use crate::metrics::ValidityConfig;
use crate::model::TrainedDenoiser;
use crate::progress::Progress;
use crate::simulate::{LoopCounts, NewScenes, SituationsConfig};
use crate::train::TrainJob;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// The length of a loop, seconds: this part of the training, within these limits.
const OF_TRAINING: f64 = 1.0 / 6.0;
const HORIZON_S: [f64; 2] = [6.0, 30.0];
/// The length of the windows by which it is judged, seconds.
const EVERY_S: f64 = 3.0;
/// Loops for each minute of training, and the least and largest number of them.
const LOOPS_PER_MINUTE: f64 = 1.0;
const N_LOOPS: [f64; 2] = [4.0, 40.0];

/// The part of each closed loop that is valid, up to the first window that is not, by the scene that it begins with.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct ValidLoops {
    /// By scene: the valid windows.
    n_valid: BTreeMap<String, u64>,
    /// The windows of each loop.
    n_windows: u64,
    /// The time that it took, seconds.
    pub(super) seconds: f64,
}

/// Hears whether to stop, and shows nothing.
struct Unseen<'a>(&'a dyn Progress);

impl Progress for Unseen<'_> {
    fn must_stop(&self) -> bool {
        self.0.must_stop()
    }
}

impl ValidLoops {
    /// Drives loops with `model` from held-out scenes, as many as suit a training of `within_s` seconds.
    pub(super) fn of(model: &TrainedDenoiser, scenes: &OpenedScenes, within_s: f64, job: TrainJob<'_>) -> Result<Self> {
        let Some((store, held_out)) = scenes.held_out() else { return Ok(Self::default()) };
        let continued = (within_s / 60.0 * LOOPS_PER_MINUTE).clamp(N_LOOPS[0], N_LOOPS[1]) as usize;
        let continued = continued.min(held_out.len());
        // Evenly over places and recordings.
        let positions: Vec<usize> = (0..continued).map(|i| held_out[i * held_out.len() / continued]).collect();
        let Some(first) = positions.first() else { return Ok(Self::default()) };
        let config = SituationsConfig {
            continued,
            populated: 0,
            horizon_s: (OF_TRAINING * within_s).clamp(HORIZON_S[0], HORIZON_S[1]).round(),
            every_s: EVERY_S,
            ..SituationsConfig::default()
        };
        let futures = Futures::new(model, job.seed.0, &job.compute.device)?;
        let validity = ValidityConfig::default();
        let validity = for_maps(&validity, &map_fits(store, &validity)?);
        let ingest = IngestConfig::new(store.index().get(*first).dataset, Vec::new());
        let new = NewScenes { config: &config, futures: &futures, store, validity: &validity, ingest: &ingest };
        let mut loops = Self::default();
        for position in &positions {
            loops.n_valid.insert(store.index().get(*position).id.to_owned(), 0);
        }
        job.progress.start("loops", 0, "loops");
        let counts = new.make(&positions, LoopCounts::default(), &Unseen(job.progress), &mut |found, _, _| {
            for continued in found.iter().filter_map(|scene| scene.source.continues.as_ref()) {
                *loops.n_valid.entry(continued.0.clone()).or_default() += 1;
            }
            Ok(())
        })?;
        job.progress.finish();
        loops.n_windows = (counts.n_scenes + counts.n_left_out) / counts.n_loops.max(1);
        Ok(loops)
    }

    /// The mean of the valid parts.
    pub(super) fn valid_share(&self) -> f64 {
        let n = self.n_valid.len() as f64 * self.n_windows as f64;
        if n > 0.0 { self.n_valid.values().sum::<u64>() as f64 / n } else { 1.0 }
    }

    /// Whether loops from the same scenes are less valid than these by more than chance brings: by more than the
    /// standard error of the difference.
    pub(super) fn are_better_than(&self, others: &Self) -> bool {
        let differences: Vec<f64> =
            self.n_valid.iter().filter_map(|(scene, n)| Some(*n as f64 - *others.n_valid.get(scene)? as f64)).collect();
        let n = differences.len() as f64;
        let mean = differences.iter().sum::<f64>() / n;
        let squares: f64 = differences.iter().map(|difference| (difference - mean).powi(2)).sum();
        mean > (squares / (n * (n - 1.0).max(1.0))).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn loops_are_worse_by_more_than_the_standard_error() {
        let loops = |valid: &[u64]| ValidLoops {
            n_valid: valid.iter().enumerate().map(|(i, n)| (format!("scene {i}"), *n)).collect(),
            n_windows: 9,
            seconds: 0.0,
        };
        let began = loops(&[9, 9, 9, 5]);
        assert!((began.valid_share() - 32.0 / 36.0).abs() < 1e-12);
        // Differences 9, 9, 0, 0: a mean of 4.5 and a standard error of 2.6; 0, 0, 0, 5: both are 1.25.
        assert!(began.are_better_than(&loops(&[0, 0, 9, 5])));
        assert!(!began.are_better_than(&loops(&[9, 9, 9, 0])));
        assert!(!began.are_better_than(&began) && !began.are_better_than(&loops(&[9; 4])));
        assert!(!ValidLoops::default().are_better_than(&ValidLoops::default()));
    }
}

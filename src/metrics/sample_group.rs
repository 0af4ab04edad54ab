//! The input of a metric: a recorded scene and futures sampled for it.

use crate::scene::{Roles, Scene};
use std::ops::Range;

/// A recorded scene and samples of its future.
///
/// The samples have the same tracks in the same order, the same timesteps and the same observed states (the history,
/// unless the sweep sets another mask). Every agent tracked at present has a future state if it has one in the
/// recording; otherwise the agent cannot be scored. The recording itself may serve as its only sample.
#[derive(Debug, Clone, Copy)]
pub struct SampleGroup<'a> {
    /// The recording.
    pub recorded: &'a Scene,
    /// The samples.
    pub samples: &'a [Scene],
    /// The samples to their end, if closed loops last longer than the recording: for figures of samples alone.
    pub whole: Option<&'a [&'a Scene]>,
    /// How likely each sample is, up to a common factor; `None` if they are equally likely, as plain draws are.
    pub probabilities: Option<&'a [f64]>,
    /// The requested agents as (role, track), in the order of roles; empty if there are none.
    pub asked: &'a Roles,
    /// Whether the requested behavior is a collision.
    pub asked_to_collide: bool,
}

impl<'a> SampleGroup<'a> {
    /// A recorded scene and equally likely samples, without requested agents.
    pub const fn equally_likely(recorded: &'a Scene, samples: &'a [Scene]) -> Self {
        Self { recorded, samples, whole: None, probabilities: None, asked: Roles::none(), asked_to_collide: false }
    }

    /// The probability of a sample; over all samples they sum to 1. `None` if there is no such sample, or no finite
    /// sum.
    pub(super) fn probability(&self, sample_idx: usize) -> Option<f64> {
        let Some(probabilities) = self.probabilities else { return Some(1.0 / self.samples.len() as f64) };
        let sum: f64 = probabilities.iter().sum();
        Some(probabilities.get(sample_idx)? / sum).filter(|probability| probability.is_finite())
    }

    /// The sample with the least `figure` (the first among equals), and that figure; `None` without samples, or if the
    /// figure is undefined for one of them.
    pub(super) fn best_sample(&self, figure: impl Fn(&Scene) -> Option<f64>) -> Option<(usize, f64)> {
        let figures: Option<Vec<f64>> = self.samples.iter().map(figure).collect();
        figures?.into_iter().enumerate().min_by(|a, b| a.1.total_cmp(&b.1))
    }

    /// The least `figure` of all samples; `None` without samples, or if it is undefined for one of them.
    pub(super) fn min_over_samples(&self, figure: impl Fn(&Scene) -> Option<f64>) -> Option<f64> {
        let figures: Option<Vec<f64>> = self.samples.iter().map(figure).collect();
        figures?.into_iter().reduce(f64::min)
    }

    /// The mean `figure` of the whole samples for which it is defined; `None` if there are none.
    pub(super) fn mean_over_whole(&self, figure: impl Fn(&Scene) -> Option<f64>) -> Option<f64> {
        let figures: Vec<f64> = match self.whole {
            Some(whole) => whole.iter().filter_map(|scene| figure(scene)).collect(),
            None => self.samples.iter().filter_map(figure).collect(),
        };
        (!figures.is_empty()).then(|| figures.iter().sum::<f64>() / figures.len() as f64)
    }

    /// The share of `true` among all verdicts on all samples; `None` without verdicts.
    pub(super) fn share_over_samples(&self, verdicts: impl Fn(&Scene) -> Vec<bool>) -> Option<f64> {
        let verdicts: Vec<bool> = self.samples.iter().flat_map(verdicts).collect();
        let n_true = verdicts.iter().filter(|verdict| **verdict).count();
        (!verdicts.is_empty()).then(|| n_true as f64 / verdicts.len() as f64)
    }
}

/// The timesteps after the present.
pub(super) const fn future(scene: &Scene) -> Range<usize> {
    scene.n_history..scene.n_timesteps
}

/// The agents tracked at present.
pub(super) fn present_agents(scene: &Scene) -> impl Iterator<Item = usize> + '_ {
    let present = scene.current_timestep();
    (0..scene.tracks.len()).filter(move |agent_idx| scene.state(*agent_idx, present).is_some())
}

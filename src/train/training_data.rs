//! The scenes of a training run, and the constants that are gathered from them.

use super::{Balance, Error, SceneDataset, TrainJob};
use crate::seed::Seed;
use crate::tensor::{Normalizer, NormalizerFit, StateParametrization};
use std::collections::BTreeMap;

/// Scenes to gather the normalization constants from: enough for three digits.
const N_NORMALIZER_SCENES: usize = 2_000;

/// The scenes of a training run.
pub struct TrainingData<'a> {
    /// The scenes.
    pub dataset: &'a dyn SceneDataset,
    /// Indices of the scenes to train on.
    pub train: Vec<usize>,
    /// The place of each of them, by number.
    pub places: Vec<usize>,
    /// Indices of held-out scenes; those evaluated on are chosen from them.
    pub held_out: Vec<usize>,
    /// Dimensions of a diffused state.
    pub state_dim: usize,
    /// Fingerprint of the scenes.
    pub fingerprint: String,
}

/// What all training scenes have in common.
pub(super) struct SceneConstants {
    /// Scales.
    pub(super) normalizer: Normalizer,
    /// Observed timesteps t_obs.
    pub(super) n_history: usize,
    /// Timesteps T.
    pub(super) n_timesteps: usize,
    /// Time between timesteps, seconds.
    pub(super) dt_s: f64,
}

impl TrainingData<'_> {
    /// The scenes to train on, in groups that count the same; no group is empty.
    pub(super) fn groups(&self, balance: Balance) -> Vec<Vec<usize>> {
        let mut groups: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
        for (idx, place) in self.train.iter().zip(&self.places) {
            let group = if balance == Balance::Places { *place } else { 0 };
            groups.entry(group).or_default().push(*idx);
        }
        groups.into_values().collect()
    }

    /// The held-out scenes to evaluate on, at most `n`.
    pub(super) fn chosen_held_out(&self, n: usize, seed: Seed) -> Vec<usize> {
        let mut held_out = self.held_out.clone();
        seed.derive("held-out", &[]).rng().shuffle(&mut held_out);
        held_out.truncate(n);
        held_out
    }
}

impl SceneConstants {
    /// Gathers the constants of the training set.
    ///
    /// # Errors
    /// When there is no scene to train on, scenes differ in their timesteps, or one cannot be loaded.
    pub(super) fn gather(
        data: &TrainingData<'_>,
        parametrization: StateParametrization,
        TrainJob { seed, progress, .. }: TrainJob<'_>,
    ) -> Result<Self, Error> {
        let mut sample = data.train.clone();
        seed.derive("normalizer", &[]).rng().shuffle(&mut sample);
        sample.truncate(N_NORMALIZER_SCENES);
        progress.start("normalize", sample.len() as u64, "scenes");
        let mut fit = NormalizerFit::default();
        let mut shape: Option<(usize, usize, f64)> = None;
        for idx in sample {
            let scene = data.dataset.scene(idx).map_err(Error::Scene)?;
            let this = (scene.n_history, scene.n_timesteps, scene.dt_s);
            if *shape.get_or_insert(this) != this {
                let message = format!(
                    "scene {} has {} + {} timesteps of {} s, others differ: train on scenes of one shape",
                    scene.id,
                    scene.n_history,
                    scene.n_timesteps - scene.n_history,
                    scene.dt_s
                );
                return Err(Error::Config(message));
            }
            fit.add(&scene);
            progress.advance(1);
        }
        progress.finish();
        let Some((n_history, n_timesteps, dt_s)) = shape else {
            return Err(Error::NoScenes("choose other splits or places in the training section".to_owned()));
        };
        Ok(Self { normalizer: fit.finish(parametrization, data.state_dim), n_history, n_timesteps, dt_s })
    }
}

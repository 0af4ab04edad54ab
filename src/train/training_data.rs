//! The scenes of a training run, and the constants gathered from them.

use super::{Balance, Error, SceneDataset, TrainJob, WeightedGroups};
use crate::model::DenoiserSpec;
use crate::progress::Progress;
use crate::seed::Seed;
use crate::tensor::{Normalizer, NormalizerFit, StateParametrization};
use std::collections::BTreeMap;

/// Scenes to gather the normalization constants from: enough for three digits.
const N_NORMALIZER_SCENES: usize = 2_000;
/// With fewer scenes than this, a covariance over all timesteps is mostly chance.
const FEW_SCENES: usize = 50;

/// The scenes of a training run.
pub struct TrainingData<'a> {
    /// The scenes.
    pub dataset: &'a dyn SceneDataset,
    /// The scenes to draw, by source; not empty.
    pub sources: Vec<TrainingSource>,
    /// Dimensions of a diffused state.
    pub state_dim: usize,
    /// Fingerprint of the scenes.
    pub fingerprint: String,
}

/// The scenes of one ingest.
#[derive(Debug, Clone, PartialEq)]
pub struct TrainingSource {
    /// How often one of them is drawn, relative to other sources.
    pub weight: f64,
    /// Indices of the scenes to train on.
    pub train: Vec<usize>,
    /// The place of each of them, by number.
    pub places: Vec<usize>,
    /// Indices of held-out scenes, from which the evaluated ones are chosen.
    pub held_out: Vec<usize>,
}

/// The constants of the training scenes.
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
    /// Number of scenes to train on.
    pub fn n_train(&self) -> usize {
        self.sources.iter().map(|source| source.train.len()).sum()
    }

    /// Warns that a covariance of motion was taken from few scenes when a denoiser is `done` so: "calibrated", say.
    pub(super) fn warn_if_few(&self, done: &str, progress: &dyn Progress) {
        let n = self.n_train();
        if n < FEW_SCENES {
            let why = "fewer hardly tell how motion varies";
            progress.warn(&format!("the denoiser is {done} on {n} scenes, expected at least {FEW_SCENES}: {why}"));
        }
    }

    /// Number of held-out scenes.
    pub fn n_held_out(&self) -> usize {
        self.sources.iter().map(|source| source.held_out.len()).sum()
    }

    /// The scenes to train on: for each source, groups of equal weight, none empty.
    pub(super) fn groups(&self, balance: Balance) -> Vec<WeightedGroups> {
        let of_source = |source: &TrainingSource| {
            let mut groups: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
            for (idx, place) in source.train.iter().zip(&source.places) {
                let group = if balance == Balance::Places { *place } else { 0 };
                groups.entry(group).or_default().push(*idx);
            }
            WeightedGroups { weight: source.weight, groups: groups.into_values().collect() }
        };
        self.sources.iter().map(of_source).collect()
    }

    /// The held-out scenes to evaluate on, at most `n`, from each source its share.
    pub(super) fn chosen_held_out(&self, n: usize, seed: Seed) -> Vec<usize> {
        self.sample(n, |source| &source.held_out, seed.derive("held-out", &[]))
    }

    /// Refuses scenes that are of another shape than those of a denoiser; `verb` is what was to be done on them. Only
    /// the first is checked, because batches reject scenes of different shapes.
    pub(super) fn check_shape(&self, spec: &DenoiserSpec, verb: &str) -> Result<(), Error> {
        let Some(first) = self.sources.iter().find_map(|source| source.train.first()) else {
            return Err(Error::NoScenes(format!("choose other splits or places to {verb} on")));
        };
        let scene = self.dataset.scene(*first).map_err(Error::Scene)?;
        let is_alike = (scene.n_history, scene.n_timesteps) == (spec.n_history, spec.n_timesteps)
            && (scene.dt_s - spec.dt_s).abs() < 1e-6;
        if is_alike {
            return Ok(());
        }
        Err(Error::Config(format!(
            "scene {} has {} + {} timesteps of {} s, the denoiser was trained on {} + {} of {} s: {verb} on scenes of \
             the same length",
            scene.id,
            scene.n_history,
            scene.n_timesteps.saturating_sub(scene.n_history),
            scene.dt_s,
            spec.n_history,
            spec.n_timesteps.saturating_sub(spec.n_history),
            spec.dt_s
        )))
    }

    /// At most about `n` random scenes of those that `of` returns, from each source in proportion to its weight.
    fn sample(&self, n: usize, of: impl Fn(&TrainingSource) -> &Vec<usize>, seed: Seed) -> Vec<usize> {
        let total: f64 = self.sources.iter().map(|source| source.weight).sum();
        let chosen = self.sources.iter().enumerate().flat_map(|(i, source)| {
            let mut scenes = of(source).clone();
            let seed = if i == 0 { seed } else { seed.derive("source", &[i as u64]) };
            seed.rng().shuffle(&mut scenes);
            scenes.truncate((n as f64 * source.weight / total).ceil() as usize);
            scenes
        });
        chosen.collect()
    }
}

impl SceneConstants {
    /// Gathers the constants of the training set. If the network derives headings, derived headings do not count.
    pub(super) fn gather(
        data: &TrainingData<'_>,
        parametrization: StateParametrization,
        network_derives_headings: bool,
        TrainJob { seed, progress, .. }: TrainJob<'_>,
    ) -> Result<Self, Error> {
        let sample = data.sample(N_NORMALIZER_SCENES, |source| &source.train, seed.derive("normalizer", &[]));
        progress.start("normalize", sample.len() as u64, "scenes");
        let mut fit = NormalizerFit::default();
        if network_derives_headings && data.state_dim > 2 {
            fit = fit.without_derived_headings();
        }
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

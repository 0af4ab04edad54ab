//! From scenes to a denoiser checkpoint: constants, network, training, file.

use super::changed_losses::changed_losses;
use super::training_data::{SceneConstants, TrainingData};
use super::{Ahead, DenoiserTraining, DenoisingTask, Error, FitStatistics, SceneDraws, fit};
use crate::model::{DenoiserKind, DenoiserSpec, SceneDenoiser};
use crate::nn::{Checkpoint, Params};
use crate::progress::Progress;
use crate::seed::Seed;
use crate::tensor::MaskSampler;
use candle_core::Device;
use std::path::Path;

/// What training a denoiser came to.
#[derive(Debug, Clone, PartialEq)]
pub struct DenoiserOutcome {
    /// Fingerprint of the checkpoint.
    pub fingerprint: String,
    /// What the denoiser is.
    pub spec: DenoiserSpec,
    /// Number of trained values.
    pub n_parameters: usize,
    /// Losses and evaluations.
    pub statistics: Vec<FitStatistics>,
}

/// Trains a denoiser in `dir` (resuming what is there) and writes it to `dir/model.safetensors`. With `start`, training
/// begins at the weights of that checkpoint, and keeps its scales.
///
/// # Errors
/// When there is no scene to train on, scenes differ in their timesteps, `start` is of another kind, or training fails.
pub fn train_denoiser(
    training: &DenoiserTraining,
    data: &TrainingData<'_>,
    start: Option<&Checkpoint<DenoiserSpec>>,
    seed: Seed,
    dir: &Path,
    device: &Device,
    progress: &dyn Progress,
) -> Result<DenoiserOutcome, Error> {
    let Some(masks) = MaskSampler::new(&training.tasks) else {
        return Err(Error::Config("train.denoiser.tasks are no weights".to_owned()));
    };
    let mut spec = describe(training, data, seed, progress)?;
    if let Some(start) = start {
        check_start(&start.metadata, &spec)?;
        spec.normalizer = start.metadata.normalizer.clone();
    }
    let mut params = Params::new(device);
    let (network, state_dim) = (&spec.network, data.state_dim);
    let denoiser = SceneDenoiser::new(&mut params, network, state_dim, spec.edm, seed.derive("weights", &[]))?;
    if let Some(start) = start {
        params.load(&start.tensors)?;
    }
    let frozen = SceneDenoiser::new(&mut params.frozen(), network, state_dim, spec.edm, seed)?;
    let held_out = data.chosen_held_out(training.n_eval_scenes, seed);
    let collator = spec.collator();
    let draws = SceneDraws {
        collator: &collator,
        dataset: data.dataset,
        train: &data.groups(training.balance),
        held_out: &held_out,
        masks: &masks,
        batch_size: training.batch_size,
        with_context: !training.objectives.is_empty(),
        seed,
        device,
        ahead: Ahead::default(),
    };
    let task = DenoisingTask { denoiser: &denoiser, frozen: &frozen, training, draws };
    let outcome = fit(&training.fit, &mut params, &task, dir, progress)?;
    spec.changed_losses = changed_losses(&task, progress)?;
    let fingerprint = spec.write(&params, &dir.join("model.safetensors"))?;
    Ok(DenoiserOutcome { fingerprint, n_parameters: params.n_parameters(), spec, statistics: outcome.statistics })
}

/// Fails where weights of `start` would mean something else in `wanted`.
fn check_start(start: &DenoiserSpec, wanted: &DenoiserSpec) -> Result<(), Error> {
    let kind = |spec: &DenoiserSpec| (spec.normalizer.parametrization, spec.normalizer.state_dim);
    let shape = |spec: &DenoiserSpec| (spec.n_history, spec.n_timesteps, spec.dt_s.to_bits());
    let differs = [
        (start.network != wanted.network, "network"),
        (kind(start) != kind(wanted), "state parametrization"),
        (start.edm != wanted.edm, "constants of the diffusion"),
        (shape(start) != shape(wanted), "number or length of timesteps"),
    ];
    match differs.iter().find(|(differs, _)| *differs) {
        Some((_, what)) => Err(Error::Config(format!(
            "the checkpoint of train.denoiser.start_from has another {what}: compare `djinn inspect` with the settings"
        ))),
        None => Ok(()),
    }
}

/// Gathers the constants of the training set.
fn describe(
    training: &DenoiserTraining,
    data: &TrainingData<'_>,
    seed: Seed,
    progress: &dyn Progress,
) -> Result<DenoiserSpec, Error> {
    let SceneConstants { normalizer, n_history, n_timesteps, dt_s } =
        SceneConstants::gather(data, training.parametrization, seed, progress)?;
    Ok(DenoiserSpec {
        kind: DenoiserKind::SceneDenoiser,
        network: training.network.clone(),
        edm: training.edm,
        normalizer,
        n_history,
        n_timesteps,
        dt_s,
        max_agents: training.max_agents,
        max_lanes: training.max_lanes,
        steps: training.fit.steps,
        seed: seed.0,
        scenes: data.fingerprint.clone(),
        changed_losses: Vec::new(),
        distillation: None,
    })
}

//! From scenes to a denoiser checkpoint: constants, network, training, file.

use super::changed_losses::{changed_losses, losses_by_place, map_warnings};
use super::objective_loss::described;
use super::scene_error::scene_error_m;
use super::timed::choose;
use super::trainable::ScenesOfFit;
use super::training_data::{SceneConstants, TrainingData};
use super::{DenoiserTraining, DenoisingTask, Error, FitConfig, Scales, TrainJob, TrainOutcome, Trainable, fit};
use crate::model::{DenoiserKind, DenoiserSpec, ModelSpec};
use crate::nn::{Checkpoint, Params};

/// Trains a denoiser and writes it to `model.safetensors` in the job's folder. With `start`, training begins at the
/// weights of that checkpoint, keeps its scales but for those of motion (`Normalizer::for_motion_of`) unless `scales`
/// says otherwise, and ends with the weights whose samples of held-out scenes had the least error. A training that is
/// given time chooses its steps and learning rate, and ends with `start` as it is if that is no worse.
///
/// # Errors
/// When there is no scene to train on, scenes differ in their timesteps, `start` is of another kind, or training fails.
pub fn train_denoiser(
    training: &DenoiserTraining,
    data: &TrainingData<'_>,
    start: Option<&Checkpoint<DenoiserSpec>>,
    job: TrainJob<'_>,
) -> Result<TrainOutcome<DenoiserSpec>, Error> {
    let mut spec = describe(training, data, job)?;
    if let Some(start) = start {
        check_start(&start.metadata, &spec)?;
        spec.normalizer = match training.scales {
            Scales::Recordings => {
                data.warn_if_few("trained further", job.progress);
                start.metadata.normalizer.for_motion_of(&spec.normalizer)
            }
            Scales::Checkpoint => start.metadata.normalizer.clone(),
        };
    }
    let mut model = Trainable::new(&spec, start, job)?;
    let scenes = ScenesOfFit::new(data, &training.common, training.balance, spec.collator(), job.seed)?;
    let draws = scenes.draws(!training.objectives.is_empty(), job);
    let keeps_best = start.is_some() || training.within.is_some();
    let sampling = keeps_best.then(|| spec.sampling_collator());
    let task = DenoisingTask { denoiser: &model.network, frozen: &model.frozen, training, draws, sampling };
    let schedule = match &training.within {
        Some(within) => {
            let chosen = choose(within, training, (&task, data), &mut model.params, job)?;
            chosen.schedule(&training.common.fit)
        }
        None => training.common.fit.clone(),
    };
    // Training a model further must not end with a worse one.
    let outcome = fit(&FitConfig { keeps_best, ..schedule }, &mut model.params, &task, job)?;
    spec.steps = outcome.n_steps;
    if let Some(start) = start.filter(|_| training.within.is_some()) {
        let began_m = error_of(start, &task, job)?;
        if let Some((began_m, best_m)) = began_m.zip(outcome.best).filter(|(began_m, best_m)| began_m <= best_m) {
            let figures = format!("{best_m:.3} m, {began_m:.3} m before");
            job.progress.warn(&format!("the denoiser stays as it was: no sampled scene error is less ({figures})"));
            model.params.load(&start.tensors)?;
            return model.finish(start.metadata.clone(), outcome, job);
        }
    }
    spec.changed_losses = changed_losses(&task)?;
    spec.losses_by_place = losses_by_place(&task)?;
    map_warnings(&spec.changed_losses).iter().for_each(|warning| job.progress.warn(warning));
    model.finish(spec, outcome, job)
}

/// The scene error of a checkpoint as it is, with its own scales.
fn error_of(
    start: &Checkpoint<DenoiserSpec>,
    task: &DenoisingTask<'_>,
    job: TrainJob<'_>,
) -> Result<Option<f64>, Error> {
    let mut params = Params::new(job.compute).frozen();
    let network = start.metadata.build(&mut params, job.seed)?;
    params.load(&start.tensors)?;
    scene_error_m(&network, &start.metadata.sampling_collator(), &task.draws)
}

/// Fails if the weights of `start` would have another meaning in `wanted`.
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
fn describe(training: &DenoiserTraining, data: &TrainingData<'_>, job: TrainJob<'_>) -> Result<DenoiserSpec, Error> {
    let SceneConstants { normalizer, n_history, n_timesteps, dt_s } =
        SceneConstants::gather(data, training.parametrization, training.network.geometry.is_some(), job)?;
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
        steps: training.common.fit.steps,
        seed: job.seed.0,
        scenes: data.fingerprint.clone(),
        objectives: described(&training.objectives)?,
        changed_losses: Vec::new(),
        losses_by_place: Vec::new(),
        distillation: None,
    })
}

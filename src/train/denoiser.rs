//! From scenes to a denoiser checkpoint: constants, network, training, file.

use super::changed_losses::{changed_losses, losses_by_place, map_warnings};
use super::objective_loss::described;
use super::timed::Choice;
use super::trainable::ScenesOfFit;
use super::training_data::{SceneConstants, TrainingData};
use super::{DenoiserTraining, DenoisingTask, Error, FitConfig, Scales, TrainJob, TrainOutcome, Trainable, fit};
use crate::model::{DenoiserKind, DenoiserSpec};
use crate::nn::{Checkpoint, Params};

/// What a denoiser is trained on, and from.
#[derive(Clone, Copy)]
pub(super) struct TrainedFrom<'a> {
    /// Settings.
    pub(super) training: &'a DenoiserTraining,
    pub(super) data: &'a TrainingData<'a>,
    pub(super) start: Option<&'a Checkpoint<DenoiserSpec>>,
    /// The description with the constants of the scenes.
    found: &'a DenoiserSpec,
    pub(super) job: TrainJob<'a>,
}

impl TrainedFrom<'_> {
    /// Hands a network, with the weights to start from, and its task under other settings to `then`.
    pub(super) fn with_task<T>(
        &self,
        training: &DenoiserTraining,
        then: impl FnOnce(&mut Params, &DenoisingTask<'_>) -> Result<T, Error>,
    ) -> Result<(T, Trainable<DenoiserSpec>), Error> {
        let spec = self.spec(training.scales);
        let mut model = Trainable::new(&spec, self.start, self.job)?;
        let scenes = ScenesOfFit::new(self.data, &training.common, training.balance, spec.collator(), self.job.seed)?;
        let draws = scenes.draws(!training.objectives.is_empty(), self.job);
        let sampling = self.keeps_best().then(|| spec.sampling_collator());
        let task = DenoisingTask { denoiser: &model.network, frozen: &model.frozen, training, draws, sampling };
        let found = then(&mut model.params, &task)?;
        Ok((found, model))
    }

    /// The description with these scales of motion.
    fn spec(&self, scales: Scales) -> DenoiserSpec {
        let normalizer = match (self.start, scales) {
            (None, _) => self.found.normalizer.clone(),
            (Some(start), Scales::Recordings) => start.metadata.normalizer.for_motion_of(&self.found.normalizer),
            (Some(start), Scales::Checkpoint) => start.metadata.normalizer.clone(),
        };
        DenoiserSpec { normalizer, ..self.found.clone() }
    }

    /// Whether training ends with the weights that were best on held-out scenes.
    const fn keeps_best(&self) -> bool {
        self.start.is_some() || self.training.within.is_some()
    }
}

/// Trains a denoiser and writes it to `model.safetensors` in the job's folder. With `start`, training begins at the
/// weights of that checkpoint, keeps its scales but for those of motion (`Normalizer::for_motion_of`) unless `scales`
/// says otherwise, and ends with the weights whose samples of held-out scenes had the least error. A training that is
/// given time chooses its steps, learning rate and scales, and ends with `start` as it is if that is no worse.
///
/// # Errors
/// When there is no scene to train on, scenes differ in their timesteps, `start` is of another kind, or training fails.
pub fn train_denoiser(
    training: &DenoiserTraining,
    data: &TrainingData<'_>,
    start: Option<&Checkpoint<DenoiserSpec>>,
    job: TrainJob<'_>,
) -> Result<TrainOutcome<DenoiserSpec>, Error> {
    let found = describe(training, data, job)?;
    if let Some(start) = start {
        check_start(&start.metadata, &found)?;
    }
    let from = TrainedFrom { training, data, start, found: &found, job };
    let chosen = training.within.as_ref().map(|within| Choice::made(within, from)).transpose()?;
    let settings = chosen.as_ref().map_or_else(|| training.clone(), |chosen| chosen.settings(training));
    if start.is_some() && settings.scales == Scales::Recordings {
        data.warn_if_few("trained further", job.progress);
    }
    let ((outcome, judged), mut model) = from.with_task(&settings, |params, task| {
        // Training a model further must not end with a worse one.
        let config = FitConfig { keeps_best: from.keeps_best(), ..settings.common.fit.clone() };
        let outcome = fit(&config, params, task, job)?;
        let began_m = chosen.as_ref().and_then(|chosen| chosen.began_m);
        if let Some((began_m, best_m)) = began_m.zip(outcome.best).filter(|(began_m, best_m)| began_m <= best_m) {
            let figures = format!("{best_m:.3} m, {began_m:.3} m before");
            job.progress.warn(&format!("the denoiser stays as it was: no sampled scene error is less ({figures})"));
            return Ok((outcome, None));
        }
        Ok((outcome, Some((changed_losses(task)?, losses_by_place(task)?))))
    })?;
    let mut spec = DenoiserSpec { steps: outcome.n_steps, ..from.spec(settings.scales) };
    match (judged, start) {
        (Some((of_changed, by_place)), _) => {
            map_warnings(&of_changed).iter().for_each(|warning| job.progress.warn(warning));
            (spec.changed_losses, spec.losses_by_place) = (of_changed, by_place);
        }
        (None, Some(start)) => {
            model.params.load(&start.tensors)?;
            spec = start.metadata.clone();
        }
        (None, None) => {}
    }
    model.finish(spec, outcome, job)
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

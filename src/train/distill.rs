//! Distills a denoiser's checkpoint into one that needs few evaluations.

use super::objective_loss::described;
use super::trainable::ScenesOfFit;
use super::{
    Balance, DistillTraining, Error, StepDistillationTask, TrainJob, TrainOutcome, Trainable, TrainingData, fit,
};
use crate::model::{DenoiserSpec, ModelSpec};
use crate::nn::{Checkpoint, Params};

/// The checkpoints that distillation starts from.
#[derive(Clone, Copy)]
pub struct DistillSource<'a> {
    /// The denoiser that is distilled.
    pub teacher: &'a Checkpoint<DenoiserSpec>,
    /// The checkpoint to start from, if not the denoiser: an earlier result of its distillation.
    pub start: Option<&'a Checkpoint<DenoiserSpec>>,
}

/// Tunes the denoiser of `source` and writes it to `model.safetensors` in the job's folder: a checkpoint of the same
/// network, scales and limits that samples in few evaluations.
///
/// # Errors
/// When there is no scene to train on, scenes are not of the teacher's shape, the method or the start does not fit it,
/// or training fails.
pub fn distill_denoiser(
    training: &DistillTraining,
    data: &TrainingData<'_>,
    DistillSource { teacher, start }: DistillSource<'_>,
    job: TrainJob<'_>,
) -> Result<TrainOutcome<DenoiserSpec>, Error> {
    let mut objectives = teacher.metadata.objectives.clone();
    objectives.extend(described(&training.objectives)?);
    let spec = DenoiserSpec {
        objectives,
        steps: training.common.fit.steps,
        seed: job.seed.0,
        scenes: data.fingerprint.clone(),
        changed_losses: Vec::new(),
        losses_by_place: Vec::new(),
        distillation: Some(training.method.distillation(&teacher.metadata.edm)),
        ..teacher.metadata.clone()
    };
    check_shape(&spec, data)?;
    training.method.check(&teacher.metadata)?;
    if let Some(start) = start {
        check_start(&start.metadata, &spec)?;
    }
    let mut model = Trainable::new(&spec, Some(start.unwrap_or(teacher)), job)?;
    let balance = if spec.network.geometry.is_some() { Balance::Places } else { Balance::Scenes };
    let scenes = ScenesOfFit::new(data, &training.common, balance, spec.collator(), job.seed)?;
    let draws = scenes.draws(!training.objectives.is_empty(), job);
    let mut kept = Params::new(job.compute).frozen();
    let taught_by = spec.build(&mut kept, job.seed)?;
    kept.load(&teacher.tensors)?;
    let (denoiser, frozen, steps) = (&model.network, &model.frozen, &training.method);
    let task = StepDistillationTask { denoiser, frozen, teacher: &taught_by, steps, training, draws };
    let outcome = fit(&training.common.fit, &mut model.params, &task, job)?;
    model.finish(spec, outcome, job)
}

/// Fails if `start` is not an earlier result of a distillation to `wanted`.
fn check_start(start: &DenoiserSpec, wanted: &DenoiserSpec) -> Result<(), Error> {
    let differs = [
        (start.network != wanted.network, "has a different network than the denoiser"),
        (start.normalizer != wanted.normalizer, "has different scales than the denoiser"),
        (start.distillation != wanted.distillation, "was not distilled, or onto different noise levels"),
    ];
    match differs.iter().find(|(differs, _)| *differs) {
        Some((_, how)) => Err(Error::Config(format!(
            "the checkpoint of train.distill.start_from {how}: compare `djinn inspect` with the settings"
        ))),
        None => Ok(()),
    }
}

/// Fails if the scenes do not have the shape of the teacher's. Only the first is checked, because batches reject scenes
/// of different shapes.
fn check_shape(spec: &DenoiserSpec, data: &TrainingData<'_>) -> Result<(), Error> {
    let Some(first) = data.sources.iter().find_map(|source| source.train.first()) else {
        return Err(Error::NoScenes("choose other splits or places in train.distill".to_owned()));
    };
    let scene = data.dataset.scene(*first).map_err(Error::Scene)?;
    let is_alike = (scene.n_history, scene.n_timesteps) == (spec.n_history, spec.n_timesteps)
        && (scene.dt_s - spec.dt_s).abs() < 1e-6;
    if is_alike {
        return Ok(());
    }
    Err(Error::Config(format!(
        "scene {} has {} + {} timesteps of {} s, the denoiser was trained on {} + {} of {} s: distill on scenes of the \
         same length",
        scene.id,
        scene.n_history,
        scene.n_timesteps.saturating_sub(scene.n_history),
        scene.dt_s,
        spec.n_history,
        spec.n_timesteps.saturating_sub(spec.n_history),
        spec.dt_s
    )))
}

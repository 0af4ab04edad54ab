//! Distills a denoiser's checkpoint into one that needs few evaluations.

use super::objective_loss::described;
use super::trainable::ScenesOfFit;
use super::{
    Balance, DistillTraining, Error, StepDistillationTask, TrainJob, TrainOutcome, Trainable, TrainingData, fit,
};
use crate::model::{DenoiserSpec, ModelSpec};
use crate::nn::{Checkpoint, Params};

/// Distills the denoiser `teacher` and writes it to `model.safetensors` in the job's folder: a checkpoint of the same
/// network, scales and limits that samples in few evaluations.
///
/// # Errors
/// When there is no scene to train on, scenes are not of the teacher's shape, the method does not fit it,
/// or training fails.
pub fn distill_denoiser(
    training: &DistillTraining,
    data: &TrainingData<'_>,
    teacher: &Checkpoint<DenoiserSpec>,
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
    data.check_shape(&spec, "distill")?;
    training.method.check(&teacher.metadata)?;
    let mut model = Trainable::new(&spec, Some(teacher), job)?;
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

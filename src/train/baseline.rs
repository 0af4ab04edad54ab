//! From scenes to a Scene Transformer checkpoint: constants, network, training, file.

use super::trainable::ScenesOfFit;
use super::training_data::{SceneConstants, TrainingData};
use super::{Balance, BaselineTraining, Error, JointFuturesTask, TrainJob, TrainOutcome, Trainable, fit};
use crate::model::{SceneTransformerKind, SceneTransformerSpec};

/// Trains a Scene Transformer and writes it to `model.safetensors` in the job's folder. Scenes, masks and scales are
/// drawn as for a denoiser: with the same seed and settings, they are the same.
///
/// # Errors
/// When there is no scene to train on, scenes differ in their timesteps, or training fails.
pub fn train_baseline(
    training: &BaselineTraining,
    data: &TrainingData<'_>,
    job: TrainJob<'_>,
) -> Result<TrainOutcome<SceneTransformerSpec>, Error> {
    let SceneConstants { normalizer, n_history, n_timesteps, dt_s } =
        SceneConstants::gather(data, training.parametrization, false, job)?;
    let spec = SceneTransformerSpec {
        kind: SceneTransformerKind::SceneTransformer,
        network: training.network.clone(),
        normalizer,
        n_history,
        n_timesteps,
        dt_s,
        max_agents: training.max_agents,
        max_lanes: training.max_lanes,
        steps: training.common.fit.steps,
        seed: job.seed.0,
        scenes: data.fingerprint.clone(),
    };
    let mut model = Trainable::new(&spec, None, job)?;
    let scenes = ScenesOfFit::new(data, &training.common, Balance::Scenes, spec.collator(), job.seed)?;
    let draws = scenes.draws(false, job);
    let task = JointFuturesTask { network: &model.network, frozen: &model.frozen, draws };
    let outcome = fit(&training.common.fit, &mut model.params, &task, job)?;
    model.finish(spec, outcome, job)
}

//! From scenes to a Scene Transformer checkpoint: constants, network, training, file.

use super::training_data::{SceneConstants, TrainingData};
use super::{Ahead, Balance, BaselineTraining, Error, FitStatistics, JointFuturesTask, SceneDraws, fit};
use crate::model::{SceneTransformer, SceneTransformerKind, SceneTransformerSpec};
use crate::nn::Params;
use crate::progress::Progress;
use crate::seed::Seed;
use crate::tensor::MaskSampler;
use candle_core::Device;
use std::path::Path;

/// What training the baseline came to.
#[derive(Debug, Clone, PartialEq)]
pub struct BaselineOutcome {
    /// Fingerprint of the checkpoint.
    pub fingerprint: String,
    /// What the network is.
    pub spec: SceneTransformerSpec,
    /// Number of trained values.
    pub n_parameters: usize,
    /// Losses and evaluations.
    pub statistics: Vec<FitStatistics>,
}

/// Trains a Scene Transformer in `dir` (resuming what is there) and writes it to `dir/model.safetensors`. Scenes, masks and
/// scales are drawn as for a denoiser: of the same seed and settings they are the same.
///
/// # Errors
/// When there is no scene to train on, scenes differ in their timesteps, or training fails.
pub fn train_baseline(
    training: &BaselineTraining,
    data: &TrainingData<'_>,
    seed: Seed,
    dir: &Path,
    device: &Device,
    progress: &dyn Progress,
) -> Result<BaselineOutcome, Error> {
    let Some(masks) = MaskSampler::new(&training.tasks) else {
        return Err(Error::Config("train.baseline.tasks are no weights".to_owned()));
    };
    let SceneConstants { normalizer, n_history, n_timesteps, dt_s } =
        SceneConstants::gather(data, training.parametrization, seed, progress)?;
    let spec = SceneTransformerSpec {
        kind: SceneTransformerKind::SceneTransformer,
        network: training.network.clone(),
        normalizer,
        n_history,
        n_timesteps,
        dt_s,
        max_agents: training.max_agents,
        max_lanes: training.max_lanes,
        steps: training.fit.steps,
        seed: seed.0,
        scenes: data.fingerprint.clone(),
    };
    let mut params = Params::new(device);
    let build = |params: &mut Params, seed| {
        SceneTransformer::new(params, &spec.network, data.state_dim, training.parametrization, seed)
    };
    let network = build(&mut params, seed.derive("weights", &[]))?;
    let frozen = build(&mut params.frozen(), seed)?;
    let held_out = data.chosen_held_out(training.n_eval_scenes, seed);
    let draws = SceneDraws {
        collator: &spec.collator(),
        dataset: data.dataset,
        train: &data.groups(Balance::Scenes),
        held_out: &held_out,
        masks: &masks,
        batch_size: training.batch_size,
        with_context: false,
        seed,
        device,
        ahead: Ahead::default(),
    };
    let task = JointFuturesTask { network: &network, frozen: &frozen, mode_loss: training.mode_loss, draws };
    let outcome = fit(&training.fit, &mut params, &task, dir, progress)?;
    let fingerprint = spec.write(&params, &dir.join("model.safetensors"))?;
    Ok(BaselineOutcome { fingerprint, n_parameters: params.n_parameters(), spec, statistics: outcome.statistics })
}

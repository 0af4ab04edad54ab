//! Scenes to a denoiser; or a denoiser that was trained elsewhere, taken over.

use super::training_scenes::{training_data, training_summary};
use super::with_precision;
use crate::model::{DenoiserSpec, TrainedDenoiser};
use crate::nn::{Precision, read_checkpoint};
use crate::pipeline::layout::{DENOISER, Layout};
use crate::pipeline::{Result, Stage, StageContext, StageId, StageInput};
use crate::seed::Seed;
use crate::store::{SceneStore, write_atomically};
use crate::train::{DenoiserTrainingConfig, train_denoiser};
use serde_json::{Value, json};
use std::io::Write;
use std::path::{Path, PathBuf};

/// Name of the weights in a model's folder.
pub(super) const MODEL_FILE: &str = "model.safetensors";

/// The stage.
pub struct TrainDenoiser<'a> {
    /// Its section.
    pub config: &'a DenoiserTrainingConfig,
    /// Seed of the weights, batches and noise.
    pub seed: u64,
    /// How products of networks are rounded.
    pub precision: Precision,
    /// Where the scenes are.
    pub layout: &'a Layout,
}

impl Stage for TrainDenoiser<'_> {
    fn id(&self) -> StageId {
        StageId::TrainDenoiser
    }

    fn version(&self) -> u32 {
        2
    }

    fn check(&self) -> Result<()> {
        self.config.resolve()?;
        Ok(())
    }

    fn config(&self) -> anyhow::Result<Value> {
        let mut config = serde_json::to_value(self.config)?;
        config["seed"] = json!(self.seed);
        // Presets change from version to version: what they come to counts.
        config["resolved"] = serde_json::to_value(self.config.resolve()?)?;
        Ok(with_precision(config, self.config.checkpoint.is_none().then_some(self.precision)))
    }

    fn inputs(&self) -> Vec<StageInput> {
        match &self.config.checkpoint {
            Some(path) => vec![StageInput::external("checkpoint", &checkpoint_file(path))],
            None => {
                let scenes = StageInput::made_by(StageId::Ingest, "scenes", &self.layout.scenes);
                let start = self.config.start_from.as_deref();
                let start = start.map(|path| StageInput::external("start_from", &checkpoint_file(path)));
                [scenes].into_iter().chain(start).collect()
            }
        }
    }

    fn outputs(&self) -> &'static [&'static str] {
        &[DENOISER]
    }

    fn run(&self, context: &StageContext<'_>) -> Result<Value> {
        let dir = context.root.join(DENOISER);
        if let Some(path) = &self.config.checkpoint {
            let trained = TrainedDenoiser::read(&checkpoint_file(path), context.device)?;
            take_over(path, &dir)?;
            return Ok(json!({ "fingerprint": trained.fingerprint, "steps": trained.spec.steps, "trained": false }));
        }
        let training = self.config.resolve()?;
        let store = SceneStore::open(&self.layout.scenes)?;
        let config = self.config;
        let data = training_data(&store, (&config.splits, &config.places), config.state_dim, "train.denoiser")?;
        let start = self.config.start_from.as_deref().map(checkpoint_file);
        let start = start.map(|path| read_checkpoint::<DenoiserSpec>(&path, context.device)).transpose()?;
        let seed = Seed(self.seed);
        let outcome = train_denoiser(&training, &data, start.as_ref(), seed, &dir, context.device, context.progress)?;
        let model = (outcome.fingerprint.as_str(), training.fit.steps, outcome.n_parameters);
        Ok(training_summary(&data, model, &outcome.statistics))
    }
}

/// A checkpoint is named by its file or by the folder of the model.
pub(in crate::pipeline) fn checkpoint_file(path: &Path) -> PathBuf {
    if path.is_dir() { path.join(MODEL_FILE) } else { path.to_owned() }
}

/// Copies a checkpoint into a model's folder.
pub(super) fn take_over(path: &Path, dir: &Path) -> Result<()> {
    fs_err::create_dir_all(dir)?;
    let bytes = fs_err::read(checkpoint_file(path))?;
    write_atomically::<std::io::Error>(&dir.join(MODEL_FILE), |file| file.write_all(&bytes))?;
    Ok(())
}

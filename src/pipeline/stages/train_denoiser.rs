//! Scenes to a denoiser; or a denoiser that was trained elsewhere, taken over.

use super::selection::Selection;
use crate::model::{DenoiserSpec, TrainedDenoiser};
use crate::nn::read_checkpoint;
use crate::pipeline::layout::{DENOISER, Layout};
use crate::pipeline::{Failure, Result, Stage, StageContext, StageId, StageInput};
use crate::scene::Dataset;
use crate::seed::Seed;
use crate::store::{SceneStore, write_atomically};
use crate::train::{DenoiserTrainingConfig, TrainingData, train_denoiser};
use candle_core::Device;
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
        Ok(config)
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
            let trained = TrainedDenoiser::read(&checkpoint_file(path), &Device::Cpu)?;
            take_over(path, &dir)?;
            return Ok(json!({ "fingerprint": trained.fingerprint, "steps": trained.spec.steps, "trained": false }));
        }
        let training = self.config.resolve()?;
        let store = SceneStore::open(&self.layout.scenes)?;
        let Selection { train, held_out } = Selection::new(store.index(), &self.config.splits, &self.config.places);
        let Some(first) = train.first() else {
            return Err(Failure::input_message("no scene is of the splits and places of train.denoiser"));
        };
        // Argoverse 1 has no headings of its own: they are derived from the positions, and so are those of its samples.
        let default_state_dim = if store.index()[*first].dataset == Dataset::Argoverse1 { 2 } else { 3 };
        let (n_train, n_held_out) = (train.len(), held_out.len());
        let data = TrainingData {
            dataset: &store,
            train,
            held_out,
            state_dim: self.config.state_dim.unwrap_or(default_state_dim),
            fingerprint: store.fingerprint().to_owned(),
        };
        let start = self.config.start_from.as_deref().map(checkpoint_file);
        let start = start.map(|path| read_checkpoint::<DenoiserSpec>(&path, &Device::Cpu)).transpose()?;
        let seed = Seed(self.seed);
        let outcome = train_denoiser(&training, &data, start.as_ref(), seed, &dir, &Device::Cpu, context.progress)?;
        Ok(json!({
            "fingerprint": outcome.fingerprint,
            "steps": training.fit.steps,
            "trained": true,
            "n_parameters": outcome.n_parameters,
            "n_train_scenes": n_train,
            "n_held_out_scenes": n_held_out,
            "last_evaluation": outcome.statistics.iter().rev().find(|line| !line.evaluation.is_empty()),
        }))
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

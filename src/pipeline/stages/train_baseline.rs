//! Scenes to a Scene Transformer, the baseline; or one that was trained elsewhere, taken over.

use super::selection::Selection;
use super::train_denoiser::{checkpoint_file, take_over};
use crate::model::TrainedSceneTransformer;
use crate::pipeline::layout::{BASELINE, Layout};
use crate::pipeline::{Failure, Result, Stage, StageContext, StageId, StageInput};
use crate::scene::Dataset;
use crate::seed::Seed;
use crate::store::SceneStore;
use crate::train::{BaselineTrainingConfig, TrainingData, train_baseline};
use candle_core::Device;
use serde_json::{Value, json};

/// The stage.
pub struct TrainBaseline<'a> {
    /// Its section.
    pub config: &'a BaselineTrainingConfig,
    /// Seed of the weights and batches.
    pub seed: u64,
    /// Where the scenes are.
    pub layout: &'a Layout,
}

impl Stage for TrainBaseline<'_> {
    fn id(&self) -> StageId {
        StageId::TrainBaseline
    }

    fn version(&self) -> u32 {
        1
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
        vec![match &self.config.checkpoint {
            Some(path) => StageInput::external("checkpoint", &checkpoint_file(path)),
            None => StageInput::made_by(StageId::Ingest, "scenes", &self.layout.scenes),
        }]
    }

    fn outputs(&self) -> &'static [&'static str] {
        &[BASELINE]
    }

    fn run(&self, context: &StageContext<'_>) -> Result<Value> {
        let dir = context.root.join(BASELINE);
        if let Some(path) = &self.config.checkpoint {
            let trained = TrainedSceneTransformer::read(&checkpoint_file(path), &Device::Cpu)?;
            take_over(path, &dir)?;
            return Ok(json!({ "fingerprint": trained.fingerprint, "steps": trained.spec.steps, "trained": false }));
        }
        let training = self.config.resolve()?;
        let store = SceneStore::open(&self.layout.scenes)?;
        let Selection { train, held_out } = Selection::new(store.index(), &self.config.splits, &self.config.places);
        let Some(first) = train.first() else {
            return Err(Failure::input_message("no scene is of the splits and places of train.baseline"));
        };
        // As for the denoiser: Argoverse 1 has no headings of its own.
        let default_state_dim = if store.index()[*first].dataset == Dataset::Argoverse1 { 2 } else { 3 };
        let (n_train, n_held_out) = (train.len(), held_out.len());
        let data = TrainingData {
            dataset: &store,
            train,
            held_out,
            state_dim: self.config.state_dim.unwrap_or(default_state_dim),
            fingerprint: store.fingerprint().to_owned(),
        };
        let outcome = train_baseline(&training, &data, Seed(self.seed), &dir, &Device::Cpu, context.progress)?;
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

//! Scenes to a Scene Transformer, the baseline; or one that was trained elsewhere, taken over.

use super::train_denoiser::{checkpoint_file, take_over};
use super::training_scenes::{training_data, training_summary};
use super::with_precision;
use crate::model::TrainedSceneTransformer;
use crate::nn::Precision;
use crate::pipeline::layout::{BASELINE, Layout};
use crate::pipeline::{Result, Stage, StageContext, StageId, StageInput};
use crate::seed::Seed;
use crate::store::SceneStore;
use crate::train::{BaselineTrainingConfig, train_baseline};
use serde_json::{Value, json};

/// The stage.
pub struct TrainBaseline<'a> {
    /// Its section.
    pub config: &'a BaselineTrainingConfig,
    /// Seed of the weights and batches.
    pub seed: u64,
    /// How products of networks are rounded.
    pub precision: Precision,
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
        Ok(with_precision(config, self.config.checkpoint.is_none().then_some(self.precision)))
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
            let trained = TrainedSceneTransformer::read(&checkpoint_file(path), context.device)?;
            take_over(path, &dir)?;
            return Ok(json!({ "fingerprint": trained.fingerprint, "steps": trained.spec.steps, "trained": false }));
        }
        let training = self.config.resolve()?;
        let store = SceneStore::open(&self.layout.scenes)?;
        let config = self.config;
        let data = training_data(&store, (&config.splits, &config.places), config.state_dim, "train.baseline")?;
        let outcome = train_baseline(&training, &data, Seed(self.seed), &dir, context.device, context.progress)?;
        let model = (outcome.fingerprint.as_str(), training.fit.steps, outcome.n_parameters);
        Ok(training_summary(&data, model, &outcome.statistics))
    }
}

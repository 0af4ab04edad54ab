//! Scenes to a Scene Transformer, the baseline.

use super::train::Recipe;
use super::training_scenes::{training_data, training_summary};
use crate::model::SceneTransformerSpec;
use crate::pipeline::layout::{BASELINE, Layout};
use crate::pipeline::{Result, StageId};
use crate::store::SceneStore;
use crate::train::{BaselineTrainingConfig, TrainJob, train_baseline};
use serde_json::{Value, json};
use std::path::Path;

impl Recipe for BaselineTrainingConfig {
    type Spec = SceneTransformerSpec;
    const STAGE: StageId = StageId::TrainBaseline;
    const VERSION: u32 = 1;
    const OUTPUTS: &'static [&'static str] = &[BASELINE];
    const LEARNS_FROM: &'static [StageId] = &[StageId::Ingest];

    fn checkpoint(&self) -> Option<&Path> {
        self.checkpoint.as_deref()
    }

    fn resolved(&self) -> std::result::Result<Option<Value>, crate::train::Error> {
        Ok(Some(json!(self.resolve()?)))
    }

    fn about(spec: &SceneTransformerSpec) -> Value {
        json!({ "steps": spec.steps })
    }

    fn train(&self, layout: &Layout, job: TrainJob<'_>) -> Result<Value> {
        let store = SceneStore::open(&layout.scenes)?;
        let data = training_data(&store, (&self.splits, &self.places), self.state_dim, Self::SECTION)?;
        let outcome = train_baseline(&self.resolve()?, &data, job)?;
        Ok(training_summary(&data, outcome.spec.steps, &outcome))
    }
}

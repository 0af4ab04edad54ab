//! Scenes to a Scene Transformer, the baseline.

use super::train::{Recipe, Source};
use super::training_scenes::{OpenedScenes, training_summary};
use crate::engine::Result;
use crate::model::SceneTransformerSpec;
use crate::pipeline::StageId;
use crate::pipeline::layout::Layout;
use crate::train::{BaselineTrainingConfig, OwnScenes, TrainJob, train_baseline};
use serde_json::{Value, json};

impl Recipe for BaselineTrainingConfig {
    type Spec = SceneTransformerSpec;
    const STAGE: StageId = StageId::TrainBaseline;
    const VERSION: u32 = 2;
    const LEARNS_FROM: &'static [StageId] = &[StageId::Ingest];

    fn source<'a>(&'a self, own: OwnScenes<'a>) -> Source<'a> {
        let checkpoint = self.checkpoint.as_deref();
        Source { checkpoint, scenes: Some(Self::scene_choice(own)), ..Source::default() }
    }

    fn resolved(&self) -> std::result::Result<Option<Value>, crate::train::Error> {
        Ok(Some(json!(self.resolve()?)))
    }

    fn about(spec: &SceneTransformerSpec) -> Value {
        json!({ "steps": spec.steps })
    }

    fn train(&self, own: OwnScenes<'_>, layout: &Layout, job: TrainJob<'_>) -> Result<Value> {
        let scenes = OpenedScenes::open(Self::scene_choice(own), &layout.scenes, job.progress)?;
        let data = scenes.training_data(None, false)?;
        let outcome = train_baseline(&self.resolve()?, &data, job)?;
        Ok(training_summary(&data, outcome.spec.steps, &outcome))
    }
}

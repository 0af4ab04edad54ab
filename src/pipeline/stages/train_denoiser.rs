//! Scenes to a denoiser.

use super::train::{Calibrate, Recipe, Source};
use super::training_scenes::{OpenedScenes, calibrate, training_summary};
use crate::engine::Result;
use crate::model::DenoiserSpec;
use crate::pipeline::StageId;
use crate::pipeline::layout::Layout;
use crate::train::{DenoiserTrainingConfig, OwnScenes, TrainJob, train_denoiser};
use serde_json::{Value, json};

impl Recipe for DenoiserTrainingConfig {
    type Spec = DenoiserSpec;
    const STAGE: StageId = StageId::TrainDenoiser;
    const VERSION: u32 = 8;
    const LEARNS_FROM: &'static [StageId] = &[StageId::Ingest];
    const CALIBRATE: Option<Calibrate<DenoiserSpec>> = Some(calibrate);

    fn source<'a>(&'a self, own: OwnScenes<'a>) -> Source<'a> {
        Source {
            checkpoint: self.checkpoint.as_deref(),
            calibrates: self.calibrate,
            start_from: self.start_from.as_deref(),
            scenes: Some(self.scene_choice(own)),
        }
    }

    fn check_kind(spec: &DenoiserSpec) -> std::result::Result<(), &'static str> {
        match spec.distillation {
            None => Ok(()),
            Some(_) => Err("is a distilled denoiser, which [train.distill] takes"),
        }
    }

    fn resolved(&self) -> std::result::Result<Option<Value>, crate::train::Error> {
        Ok(Some(json!(self.resolve()?)))
    }

    fn about(spec: &DenoiserSpec) -> Value {
        json!({ "steps": spec.steps })
    }

    fn train(&self, own: OwnScenes<'_>, layout: &Layout, job: TrainJob<'_>) -> Result<Value> {
        let scenes = OpenedScenes::open(self.scene_choice(own), &layout.scenes, job.progress)?;
        let start = self.read_start(&job.compute.device)?;
        let state_dim = self.state_dim.or_else(|| start.as_ref().map(|start| start.metadata.normalizer.state_dim));
        let data = scenes.training_data(state_dim, self.resolve()?.network.geometry.is_some())?;
        let outcome = train_denoiser(&self.resolve()?, &data, start.as_ref(), job)?;
        Ok(training_summary(&data, outcome.spec.steps, &outcome))
    }
}

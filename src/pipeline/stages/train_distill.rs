//! A denoiser and scenes to a denoiser that needs few evaluations.

use super::train::{Calibrate, Recipe, Source, checkpoint_file};
use super::training_scenes::{OpenedScenes, calibrate, training_summary};
use crate::engine::Result;
use crate::model::DenoiserSpec;
use crate::nn::read_checkpoint;
use crate::pipeline::StageId;
use crate::pipeline::layout::Layout;
use crate::train::{DistillTrainingConfig, OwnScenes, TrainJob, distill_denoiser};
use serde_json::{Value, json};

impl Recipe for DistillTrainingConfig {
    type Spec = DenoiserSpec;
    const STAGE: StageId = StageId::TrainDistill;
    const VERSION: u32 = 3;
    const LEARNS_FROM: &'static [StageId] = &[StageId::Ingest, StageId::TrainDenoiser];
    const CALIBRATE: Option<Calibrate<DenoiserSpec>> = Some(calibrate);

    fn source<'a>(&'a self, own: OwnScenes<'a>) -> Source<'a> {
        Source {
            checkpoint: self.checkpoint.as_deref(),
            calibrates: self.calibrate,
            scenes: Some(self.scene_choice(own)),
            ..Source::default()
        }
    }

    fn check_kind(spec: &DenoiserSpec) -> std::result::Result<(), &'static str> {
        match spec.distillation {
            Some(_) => Ok(()),
            None => Err("is a denoiser that was not distilled, which [train.denoiser] takes"),
        }
    }

    fn resolved(&self) -> std::result::Result<Option<Value>, crate::train::Error> {
        // The section has no preset, so it is complete.
        self.resolve()?;
        Ok(None)
    }

    fn about(spec: &DenoiserSpec) -> Value {
        json!({ "steps": spec.steps })
    }

    fn train(&self, own: OwnScenes<'_>, layout: &Layout, job: TrainJob<'_>) -> Result<Value> {
        let teacher = read_checkpoint::<DenoiserSpec>(&checkpoint_file(&layout.denoiser), &job.compute.device)?;
        let scenes = OpenedScenes::open(self.scene_choice(own), &layout.scenes, job.progress)?;
        let data = scenes.data_of(&teacher.metadata)?;
        let outcome = distill_denoiser(&self.resolve()?, &data, &teacher, job)?;
        Ok(training_summary(&data, outcome.spec.steps, &outcome))
    }
}

//! A denoiser and scenes to a denoiser that needs few evaluations; or one that was distilled elsewhere, taken over.

use super::train_denoiser::{checkpoint_file, take_over};
use super::training_scenes::{training_data, training_summary};
use super::with_precision;
use crate::model::{DenoiserSpec, TrainedDenoiser};
use crate::nn::{Precision, read_checkpoint};
use crate::pipeline::layout::{DISTILLED, Layout};
use crate::pipeline::{Result, Stage, StageContext, StageId, StageInput};
use crate::seed::Seed;
use crate::store::SceneStore;
use crate::train::{DistillSource, DistillTrainingConfig, distill_denoiser};
use serde_json::{Value, json};

/// The stage.
pub struct TrainDistill<'a> {
    /// Its section.
    pub config: &'a DistillTrainingConfig,
    /// Seed of the batches and noise.
    pub seed: u64,
    /// How products of networks are rounded.
    pub precision: Precision,
    /// Where the scenes and the denoiser are.
    pub layout: &'a Layout,
}

impl Stage for TrainDistill<'_> {
    fn id(&self) -> StageId {
        StageId::TrainDistill
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
        Ok(with_precision(config, self.config.checkpoint.is_none().then_some(self.precision)))
    }

    fn inputs(&self) -> Vec<StageInput> {
        match &self.config.checkpoint {
            Some(path) => vec![StageInput::external("checkpoint", &checkpoint_file(path))],
            None => {
                let made = [
                    StageInput::made_by(StageId::Ingest, "scenes", &self.layout.scenes),
                    StageInput::made_by(StageId::TrainDenoiser, "denoiser", &self.layout.denoiser),
                ];
                let start = self.config.start_from.as_deref();
                let start = start.map(|path| StageInput::external("start_from", &checkpoint_file(path)));
                made.into_iter().chain(start).collect()
            }
        }
    }

    fn outputs(&self) -> &'static [&'static str] {
        &[DISTILLED]
    }

    fn run(&self, context: &StageContext<'_>) -> Result<Value> {
        let dir = context.root.join(DISTILLED);
        if let Some(path) = &self.config.checkpoint {
            let trained = TrainedDenoiser::read(&checkpoint_file(path), context.device)?;
            take_over(path, &dir)?;
            return Ok(json!({ "fingerprint": trained.fingerprint, "steps": trained.spec.steps, "trained": false }));
        }
        let training = self.config.resolve()?;
        let store = SceneStore::open(&self.layout.scenes)?;
        let teacher = read_checkpoint::<DenoiserSpec>(&checkpoint_file(&self.layout.denoiser), context.device)?;
        let start = self.config.start_from.as_deref().map(checkpoint_file);
        let start = start.map(|path| read_checkpoint::<DenoiserSpec>(&path, context.device)).transpose()?;
        let state_dim = Some(teacher.metadata.normalizer.state_dim);
        let config = self.config;
        let data = training_data(&store, (&config.splits, &config.places), state_dim, "train.distill")?;
        let source = DistillSource { teacher: &teacher, start: start.as_ref() };
        let seed = Seed(self.seed);
        let outcome = distill_denoiser(&training, &data, source, seed, &dir, context.device, context.progress)?;
        let model = (outcome.fingerprint.as_str(), training.fit.steps, outcome.n_parameters);
        Ok(training_summary(&data, model, &outcome.statistics))
    }
}

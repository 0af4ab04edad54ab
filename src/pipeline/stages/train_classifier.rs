//! Mined pairs to the classifier that guides generation; or one that was trained elsewhere, taken over.

use super::train_denoiser::{checkpoint_file, take_over};
use super::training_scenes::TrainingScenes;
use super::with_precision;
use crate::behavior::{BehaviorEvent, EventLabel};
use crate::model::{TrainedClassifier, TrainedDenoiser};
use crate::nn::Precision;
use crate::pipeline::layout::{CLASSIFIER, Layout};
use crate::pipeline::{Failure, Result, Stage, StageContext, StageId, StageInput, fingerprint_path};
use crate::seed::Seed;
use crate::store::{SceneStore, read_events};
use crate::train::{ClassifierTrainingConfig, MinedEvent, PairData, PairExamples, train_classifier};
use serde_json::{Value, json};
use std::collections::BTreeMap;

/// The stage.
pub struct TrainClassifier<'a> {
    /// Its section.
    pub config: &'a ClassifierTrainingConfig,
    /// How products of networks are rounded.
    pub precision: Precision,
    /// Where the scenes, events and the denoiser are.
    pub layout: &'a Layout,
}

impl Stage for TrainClassifier<'_> {
    fn id(&self) -> StageId {
        StageId::TrainClassifier
    }

    fn version(&self) -> u32 {
        1
    }

    fn check(&self) -> Result<()> {
        self.config.resolve()?;
        Ok(())
    }

    fn config(&self) -> anyhow::Result<Value> {
        Ok(with_precision(
            serde_json::to_value(self.config)?,
            self.config.checkpoint.is_none().then_some(self.precision),
        ))
    }

    fn inputs(&self) -> Vec<StageInput> {
        match &self.config.checkpoint {
            Some(path) => vec![StageInput::external("checkpoint", &checkpoint_file(path))],
            None => vec![
                StageInput::made_by(StageId::Ingest, "scenes", &self.layout.scenes),
                StageInput::made_by(StageId::Mine, "events", &self.layout.events),
                StageInput::made_by(StageId::TrainDenoiser, "denoiser", &self.layout.denoiser),
            ],
        }
    }

    fn outputs(&self) -> &'static [&'static str] {
        &[CLASSIFIER]
    }

    fn run(&self, context: &StageContext<'_>) -> Result<Value> {
        let dir = context.root.join(CLASSIFIER);
        if let Some(path) = &self.config.checkpoint {
            let trained = TrainedClassifier::read(&checkpoint_file(path), context.device)?;
            take_over(path, &dir)?;
            let behavior = trained.spec.behavior;
            return Ok(json!({ "fingerprint": trained.fingerprint, "behavior": behavior, "trained": false }));
        }
        let store = SceneStore::open(&self.layout.scenes)?;
        let denoiser = TrainedDenoiser::read(&checkpoint_file(&self.layout.denoiser), context.device)?;
        let events = read_events(&self.layout.events, |event| {
            event.behavior == self.config.behavior || event.label == EventLabel::Positive
        })?;
        let roles = self.roles(&events)?;
        let TrainingScenes { train, held_out } =
            TrainingScenes::new(store.index(), &self.config.splits, &self.config.places);
        let seed = Seed(self.config.seed);
        let gather = |scenes: &[usize], max_examples: usize, purpose: &str| {
            let mined = self.mined(&store, &events, scenes);
            PairExamples::gather(&store, &mined, max_examples, seed.derive(purpose, &[]))
        };
        let (train, held_out) = (
            gather(&train, self.config.max_examples, "train examples")?,
            gather(&held_out, self.config.max_held_out, "held-out examples")?,
        );
        let fingerprint = fingerprint_path(&self.layout.events)?.hash;
        let data = PairData { roles, train: &train, held_out: &held_out, fingerprint };
        let report = train_classifier(self.config, &denoiser.spec, &data, &dir, context.device, context.progress)?;
        Ok(json!({
            "fingerprint": report.fingerprint,
            "behavior": self.config.behavior,
            "trained": true,
            "n_parameters": report.n_parameters,
            "n_positive": report.spec.n_positive,
            "n_negative": report.spec.n_negative,
        }))
    }
}

impl TrainClassifier<'_> {
    /// The roles of the behavior, from its events.
    fn roles(&self, events: &[BehaviorEvent]) -> Result<Vec<String>> {
        let behavior = &self.config.behavior;
        let Some(event) = events.iter().find(|event| event.behavior == *behavior) else {
            let n_positive = |label| events.iter().filter(|event| event.label == label).count();
            let message = format!(
                "there are no events of {behavior} to learn from ({} positive events of other behaviors)",
                n_positive(EventLabel::Positive)
            );
            return Err(Failure::input_message(message)
                .with_hint(format!("add {{ kind = \"{behavior}\" }} to mine.behaviors, or ingest more scenes")));
        };
        Ok(event.roles.iter().map(|(role, _)| role.clone()).collect())
    }

    /// The behavior's events in the given scenes, in the order of the event table.
    fn mined<'e>(&self, store: &SceneStore, events: &'e [BehaviorEvent], scenes: &[usize]) -> Vec<MinedEvent<'e>> {
        let scene_idx: BTreeMap<&str, usize> =
            scenes.iter().map(|idx| (store.index()[*idx].id.0.as_str(), *idx)).collect();
        let of_behavior = events.iter().filter(|event| event.behavior == self.config.behavior);
        of_behavior
            .filter_map(|event| Some(MinedEvent { scene_idx: *scene_idx.get(event.scene_id.0.as_str())?, event }))
            .collect()
    }
}

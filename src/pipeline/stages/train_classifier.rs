//! Mined pairs to the classifier that guides generation.

use super::held_out::TrainingScenes;
use super::train::{Recipe, Source, checkpoint_file};
use crate::behavior::BehaviorEvent;
use crate::engine::{Failure, Result, fingerprint_path};
use crate::model::{ClassifierSpec, TrainedDenoiser};
use crate::pipeline::StageId;
use crate::pipeline::layout::Layout;
use crate::store::{SceneStore, read_events};
use crate::train::{
    ClassifierTrainingConfig, LabeledPair, MAX_EXAMPLES, MAX_HELD_OUT, MinedEvent, OwnScenes, PairData, SceneChoice,
    TrainJob, train_classifier,
};
use serde_json::{Value, json};
use std::collections::BTreeMap;

impl Recipe for ClassifierTrainingConfig {
    type Spec = ClassifierSpec;
    const STAGE: StageId = StageId::TrainClassifier;
    const VERSION: u32 = 3;
    const LEARNS_FROM: &'static [StageId] = &[StageId::Ingest, StageId::Mine, StageId::TrainDenoiser];

    fn source<'a>(&'a self, own: OwnScenes<'a>) -> Source<'a> {
        let scenes = SceneChoice { section: Self::SECTION, own: chosen(self, own), own_weight: 1.0, data: &[] };
        Source { checkpoint: self.checkpoint.as_deref(), scenes: Some(scenes), ..Source::default() }
    }

    fn resolved(&self) -> std::result::Result<Option<Value>, crate::train::Error> {
        // The section has no preset, so it is complete.
        self.resolve()?;
        Ok(None)
    }

    fn about(spec: &ClassifierSpec) -> Value {
        json!({ "behavior": spec.behavior })
    }

    fn train(&self, own: OwnScenes<'_>, layout: &Layout, job: TrainJob<'_>) -> Result<Value> {
        let store = SceneStore::open(&layout.scenes)?;
        let denoiser = TrainedDenoiser::read(&checkpoint_file(&layout.denoiser), job.compute)?;
        let events = read_events(&layout.events, |event| event.behavior == self.behavior)?;
        let roles = roles(&self.behavior, &events)?;
        let TrainingScenes { train, held_out, .. } = TrainingScenes::of(&store, chosen(self, own), job.progress)?;
        let pairs = |scenes: &[usize], max_pairs: usize, purpose: &str| {
            LabeledPair::of_events(&mined(&store, &events, scenes), max_pairs, job.seed.derive(purpose, &[]))
        };
        let train = pairs(&train, MAX_EXAMPLES, "train examples");
        let held_out = pairs(&held_out, MAX_HELD_OUT, "held-out examples");
        let fingerprint = fingerprint_path(&layout.events)?.hash;
        let data = PairData { roles, dataset: &store, train: &train, held_out: &held_out, fingerprint };
        let report = train_classifier(self, &denoiser.spec, &data, job)?;
        Ok(json!({
            "fingerprint": report.fingerprint,
            "behavior": self.behavior,
            "trained": true,
            "n_parameters": report.n_parameters,
            "n_positive": report.spec.n_positive,
            "n_negative": report.spec.n_negative,
        }))
    }
}

/// The run's scenes to use: those of the section's own places, if it names some.
fn chosen<'a>(config: &'a ClassifierTrainingConfig, own: OwnScenes<'a>) -> OwnScenes<'a> {
    OwnScenes { places: if config.places.is_empty() { own.places } else { &config.places }, ..own }
}

fn roles(behavior: &str, events: &[BehaviorEvent]) -> Result<Vec<String>> {
    let Some(event) = events.first() else {
        return Err(Failure::input_message(format_args!("no events of {behavior} to train on"))
            .with_hint(format!("add {{ kind = \"{behavior}\" }} to mine.behaviors, or ingest more scenes")));
    };
    Ok(event.roles.names().map(str::to_owned).collect())
}

/// The events in the given scenes, in the order of the event table.
fn mined<'e>(store: &SceneStore, events: &'e [BehaviorEvent], scenes: &[usize]) -> Vec<MinedEvent<'e>> {
    let scene_idx: BTreeMap<&str, usize> = scenes.iter().map(|idx| (store.index().get(*idx).id, *idx)).collect();
    let mined =
        |event: &'e BehaviorEvent| Some(MinedEvent { scene_idx: *scene_idx.get(event.scene_id.0.as_str())?, event });
    events.iter().filter_map(mined).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn its_own_places_come_before_those_of_all_models() {
        let (all, own) = (["A".to_owned()], vec!["B".to_owned()]);
        let of_all = OwnScenes { places: &all, ..OwnScenes::default() };
        assert_eq!(chosen(&ClassifierTrainingConfig::default(), of_all).places, all);
        assert_eq!(chosen(&ClassifierTrainingConfig { places: own.clone(), ..Default::default() }, of_all).places, own);
    }
}

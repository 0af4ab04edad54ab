//! Situations and a model for the tests of driving: from the fixture corpus, on the simulated merge.

use super::Situation;
use crate::model::TrainedDenoiser;
use crate::nn::Compute;
use crate::scenario::ScenarioRecord;
use crate::scene::Scene;
use crate::store::{CorpusReader, MapSource, SceneWriter};
use std::path::{Path, PathBuf};

fn at(path: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join(path)
}

pub(super) fn corpus() -> PathBuf {
    at("tests/fixtures/corpus/cut_ins")
}

/// The two-step model.
pub(super) fn model() -> TrainedDenoiser {
    TrainedDenoiser::read(&at("pipelines/models/geometric_two_steps.safetensors"), &Compute::cpu()).unwrap()
}

/// The verified scenarios of the fixture corpus.
pub(super) fn records() -> Vec<ScenarioRecord> {
    let reader = CorpusReader::open(&corpus()).unwrap();
    (0..reader.len()).map(|i| reader.scenario(i).unwrap()).filter(|record| record.verified).collect()
}

/// The first of them.
pub(super) fn record() -> ScenarioRecord {
    records().remove(0)
}

/// Its start, for the vehicle that is cut off.
pub(super) fn situation(record: &ScenarioRecord) -> Situation {
    let reader = CorpusReader::open(&corpus()).unwrap();
    let map = reader.map(record.scenario.scene.map_id.as_ref().unwrap()).unwrap();
    Situation::new(record, record.subject_idx().unwrap(), Some(&map)).unwrap()
}

/// Writes scenes on a map of the corpus into a store.
pub(super) fn write_scenes(dir: &Path, reader: &CorpusReader, scenes: &[Scene]) {
    let (mut writer, _) = SceneWriter::resume(dir).unwrap();
    let map_id = scenes[0].map_id.clone().unwrap();
    let map = reader.map(&map_id).unwrap();
    let nothing = serde_json::Value::Null;
    writer.write_batch(scenes, &[(map_id, map)], Some(0), &nothing).unwrap();
    writer.finish(&nothing).unwrap();
}

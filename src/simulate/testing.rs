//! Situations and a model for the tests of driving: from the fixture corpus, on the simulated merge.

use super::Situation;
use crate::model::TrainedDenoiser;
use crate::nn::Compute;
use crate::scenario::ScenarioRecord;
use crate::scene::{Scene, TrackId};
use crate::store::{CorpusNotes, CorpusReader, CorpusWriter, MapSource, SceneWriter};
use std::path::{Path, PathBuf};

fn at(path: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join(path)
}

pub(crate) fn corpus() -> PathBuf {
    at("tests/fixtures/corpus/cut_ins")
}

/// The two-step model.
pub(crate) fn model() -> TrainedDenoiser {
    TrainedDenoiser::read(&at("pipelines/models/geometric_two_steps.safetensors"), &Compute::cpu()).unwrap()
}

/// The verified scenarios of the fixture corpus.
pub(crate) fn records() -> Vec<ScenarioRecord> {
    let reader = CorpusReader::open(&corpus()).unwrap();
    (0..reader.len()).map(|i| reader.scenario(i).unwrap()).filter(|record| record.verified).collect()
}

/// The first of them.
pub(crate) fn record() -> ScenarioRecord {
    records().remove(0)
}

/// Its start, for the vehicle that is cut off.
pub(crate) fn situation(record: &ScenarioRecord) -> Situation {
    let reader = CorpusReader::open(&corpus()).unwrap();
    let map = reader.map(record.scenario.scene.map_id.as_ref().unwrap()).unwrap();
    Situation::new(record, record.subject_idx().unwrap(), Some(&map)).unwrap()
}

/// Writes scenes on a map of the corpus into a store.
pub(crate) fn write_scenes(dir: &Path, reader: &CorpusReader, scenes: &[Scene]) {
    let (mut writer, _) = SceneWriter::resume(dir).unwrap();
    let map_id = scenes[0].map_id.clone().unwrap();
    let map = reader.map(&map_id).unwrap();
    let nothing = serde_json::Value::Null;
    writer.write_batch(scenes, &[(map_id, map)], Some(0), &nothing).unwrap();
    writer.finish(&nothing).unwrap();
}

/// A corpus of two windows of a recording, 2.5 s apart: by the second, all agents have been replaced.
pub(crate) fn write_windows(dir: &Path) -> CorpusReader {
    let reader = CorpusReader::open(&corpus()).unwrap();
    let window = |first_frame: &str| {
        let mut record = record();
        let id = format!("interaction/train/FIX_Merging/000@{first_frame}");
        record.scenario.id = format!("from{first_frame}");
        record.scenario.provenance.scene_id = id.as_str().into();
        record.events.iter_mut().for_each(|event| event.scene_id = id.as_str().into());
        record.scenario.scene.id = id.as_str().into();
        record.scenario.scene.source.first_frame = first_frame.to_owned();
        record
    };
    let (first, mut second) = (window("1"), window("26"));
    (second.requested_behavior, second.verified, second.events) = (None, false, Vec::new());
    for track in &mut second.scenario.scene.tracks {
        track.id = TrackId(format!("later_{}", track.id));
    }
    let mut writer = CorpusWriter::create(dir, &reader).unwrap();
    writer.write_scenarios(&[first, second]).unwrap();
    writer.finish(&CorpusNotes::default()).unwrap();
    CorpusReader::open(dir).unwrap()
}

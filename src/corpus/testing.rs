//! Corpora for the tests of the tools: arbitrary scenarios that only depend on their seeds.

use crate::metrics::{Group, MetricRow};
use crate::scenario::ScenarioRecord;
use crate::scene::{GuidanceLevel, LaneGraph, LaneId, MapId, Scene};
use crate::store::testing::{map, record, scene};
use crate::store::{CorpusManifest, CorpusNotes, CorpusWriter, MapSource, Result, SCENES_PER_FILE, as_stored};
use std::path::Path;

/// Any map, as seed 5 makes it.
pub(super) struct AnyMap(pub(super) u64);

impl MapSource for AnyMap {
    fn map(&self, _id: &MapId) -> Result<LaneGraph> {
        Ok(map(self.0, 9))
    }

    fn lanes(&self, _id: &MapId, lane_ids: &[LaneId]) -> Result<LaneGraph> {
        Ok(map(self.0, 9).subset(lane_ids))
    }
}

/// The recorded scene of this number, at one of two places.
pub(super) fn recorded(i: u64) -> Scene {
    let graph = map(5, 9);
    let mut scene = scene(i, Some((&MapId::from("PIT"), &graph)));
    scene.source.place = if i.is_multiple_of(3) { "MIA" } else { "PIT" }.to_owned();
    as_stored(&scene)
}

/// Two scenarios of each recorded scene in `seeds`: one unverified cut-in, one verified; every fourth scene requests
/// nothing.
pub(super) fn records(seeds: impl IntoIterator<Item = u64>) -> Vec<ScenarioRecord> {
    let of_scene = |i: u64| {
        let scene = recorded(i);
        [0, 1].map(|sample| {
            let mut record = record(&scene, sample);
            if i.is_multiple_of(4) {
                (record.requested_behavior, record.verified, record.events) = (None, false, Vec::new());
            }
            record
        })
    };
    seeds.into_iter().flat_map(of_scene).collect()
}

/// Writes a corpus of these records with a metric value of each, and one over all.
pub(super) fn write(dir: &Path, records: &[ScenarioRecord]) -> CorpusManifest {
    write_in_files_of(SCENES_PER_FILE, dir, records)
}

/// Writes files of at most this many scenarios or scenes.
pub(super) fn write_in_files_of(scenes_per_file: usize, dir: &Path, records: &[ScenarioRecord]) -> CorpusManifest {
    let maps = AnyMap(5);
    let mut writer = CorpusWriter::create(dir, &maps).unwrap().in_files_of(scenes_per_file);
    writer.write_scenarios(records).unwrap();
    let metric = |record: Option<&ScenarioRecord>| MetricRow {
        group: Group::Sweep("guided".to_owned()),
        sweep: "guided".to_owned(),
        level: GuidanceLevel::of_strength(2.0),
        scene_id: record.map(|record| record.scenario.scene.id.clone()),
        scenario_id: record.map(|record| record.scenario.id.clone()),
        n: 1,
        ..MetricRow::example("collision_rate", 0.5)
    };
    writer.write_metrics([Ok(metric(None))]).unwrap();
    for record in records {
        let number = record.scenario.scene.source.case_id.parse().unwrap();
        writer.write_recording(&recorded(number)).unwrap();
        writer.write_metrics([Ok(metric(Some(record)))]).unwrap();
    }
    let notes = [("pipeline".to_owned(), "test".to_owned())].into();
    writer.finish(&CorpusNotes { notes, ..CorpusNotes::default() }).unwrap()
}

//! The table of a sample shard: one row a generated scenario, with everything needed to read it back.

use super::columns::{Columns, flags, lists};
use super::{provenance, scene_header, scene_tracks};
use crate::geometry::Transform2;
use crate::scenario::ScenarioRecord;
use crate::scene::{LaneGraph, LaneId, MapId, ObservationMask, Scene};
use crate::store::schema::{TableSchema, column, list_of};
use crate::store::{Error, MapSource, Result, as_stored};
use arrow::array::RecordBatch;
use arrow::datatypes::DataType;
use std::collections::BTreeSet;
use std::path::Path;
use std::sync::Arc;

/// `sample.v1`.
pub(crate) fn schema() -> TableSchema {
    let mut fields = provenance::fields();
    fields.extend(scene_header::fields());
    fields.push(scene_tracks::field());
    fields.push(column(
        "observed",
        list_of(DataType::Boolean),
        "Whether a state was observed, track by track with one entry a timestep; false if there is no state.",
    ));
    TableSchema {
        name: "sample",
        version: 1,
        description: "One row a generated scenario, with its tracks nested; the form between generation and the \
                      corpus.",
        fields,
        open: Vec::new(),
    }
}

/// The rows of these records.
pub(crate) fn encode(records: &[ScenarioRecord]) -> Result<RecordBatch> {
    records.iter().try_for_each(check)?;
    let scenes: Vec<&Scene> = records.iter().map(|record| &record.scenario.scene).collect();
    let mut arrays = provenance::encode(&records.iter().collect::<Vec<_>>())?;
    arrays.extend(scene_header::encode(&scenes)?);
    arrays.push(scene_tracks::encode(&scenes)?);
    let masks = || records.iter().map(|record| record.scenario.observed.entries());
    arrays.push(lists(masks().map(<[bool]>::len), flags(masks().flatten().copied())));
    RecordBatch::try_new(schema().arrow(), arrays).map_err(|error| Error::invalid("samples", error.to_string()))
}

/// Checks that the record can be read back unchanged.
pub(crate) fn check(record: &ScenarioRecord) -> Result<()> {
    let scenario = &record.scenario;
    let refuse = |detail: &str| Err(Error::invalid(&scenario.id, detail));
    if scenario.scene.id != scenario.provenance.scene_id {
        return refuse("its scene must have the scene_id of its provenance");
    }
    let (scene, observed) = (&scenario.scene, &scenario.observed);
    if (observed.n_agents(), observed.n_timesteps()) != (scene.tracks.len(), scene.n_timesteps) {
        return refuse("its mask of observed states must have an entry for each of its tracks and timesteps");
    }
    if scene.tracks.iter().map(|track| &track.id).collect::<BTreeSet<_>>().len() < scene.tracks.len() {
        return refuse("two of its tracks have the same id");
    }
    let has_state = |i: usize| scene.state(i / scene.n_timesteps, i % scene.n_timesteps).is_some();
    if observed.entries().iter().enumerate().any(|(i, is_observed)| *is_observed && !has_state(i)) {
        return refuse("its mask must not mark missing states as observed");
    }
    if record.events.iter().any(|event| event.scene_id != scenario.scene.id) {
        return refuse("its events must have the scene_id of its scene");
    }
    if as_stored(&scenario.scene).tracks != scenario.scene.tracks {
        return refuse(
            "its states are not rounded as the store rounds them: pass the scene through as_stored before verifying it",
        );
    }
    Ok(())
}

/// The records in a batch. Neighboring samples of a scene share their lanes.
pub(crate) fn decode(batch: &RecordBatch, path: &Path, maps: &dyn MapSource) -> Result<Vec<ScenarioRecord>> {
    let columns = Columns::of_batch(batch, path);
    let mut lanes = LaneCache::default();
    let record = |row: usize| {
        let header = scene_header::decode(&columns, row)?;
        let tracks = scene_tracks::decode(&columns, row, header.scene.n_timesteps)?;
        let lanes = lanes.of(&header, maps, path)?;
        let scene = header.complete(path, tracks, lanes)?;
        let flags = columns.flags("observed", row)?;
        if flags.values().len() != scene.tracks.len() * scene.n_timesteps {
            return Err(Error::corrupt(path, "a mask does not have as many entries as its scene".to_owned()));
        }
        let n_timesteps = scene.n_timesteps;
        let observed = ObservationMask::from_fn(scene.tracks.len(), n_timesteps, |agent_idx, timestep| {
            flags.values().value(agent_idx * n_timesteps + timestep)
        });
        provenance::decode(&columns, row, scene, observed)
    };
    (0..batch.num_rows()).map(record).collect()
}

/// The lanes of the last scene: samples of one scene follow each other.
#[derive(Default)]
struct LaneCache {
    last: Option<(LaneKey, Arc<LaneGraph>)>,
}

/// Key that determines the lanes of a scene.
type LaneKey = (Option<MapId>, Vec<LaneId>, Transform2);

impl LaneCache {
    fn of(&mut self, header: &scene_header::SceneHeader, maps: &dyn MapSource, path: &Path) -> Result<Arc<LaneGraph>> {
        let key = (header.scene.map_id.clone(), header.lane_ids.clone(), header.scene.world_from_scene);
        if let Some((last, lanes)) = &self.last
            && *last == key
        {
            return Ok(Arc::clone(lanes));
        }
        let lanes = Arc::new(header.lanes(maps, path)?);
        self.last = Some((key, Arc::clone(&lanes)));
        Ok(lanes)
    }
}

//! Sample shards: the generated scenarios between the generate stage and the corpus.

use super::tables::sample;
use super::{Error, MapSource, Result, parquet_file};
use crate::files::FileStamp;
use crate::scenario::ScenarioRecord;
use arrow::array::{Array, StringArray};
use arrow::util::display::array_value_to_string;
use std::path::Path;

/// Writes one shard of generated scenarios, in the given order. Keep samples of a scene together: they share its lanes
/// when read.
///
/// # Errors
/// [`Error::Invalid`](super::Error::Invalid) when a record would not be read back unchanged, for instance because its
/// scene was not passed through [`as_stored`](super::as_stored); errors of the file system.
pub fn write_samples(path: &Path, records: &[ScenarioRecord]) -> Result<FileStamp> {
    parquet_file::write_batch(path, &sample::schema(), &sample::encode(records)?)
}

/// Reads one shard of generated scenarios; lanes come from `maps`, such as the scene store they were generated from.
///
/// # Errors
/// [`Error::Corrupt`](super::Error::Corrupt) and [`Error::SchemaVersion`](super::Error::SchemaVersion) when the file is
/// not such a shard; errors of `maps` and of the file system.
pub fn read_samples(path: &Path, maps: &dyn MapSource) -> Result<Vec<ScenarioRecord>> {
    let mut records = Vec::new();
    for batch in parquet_file::read(path, &sample::schema())? {
        records.extend(sample::decode(&batch, path, maps)?);
    }
    Ok(records)
}

/// The ids of the scenarios in a shard, in order; nothing else is read.
pub fn sample_ids(path: &Path) -> Result<Vec<String>> {
    let mut ids = Vec::new();
    for batch in parquet_file::stream(path, &sample::schema(), Some(&["scenario_id"]))? {
        let batch = batch?;
        let column: Option<&StringArray> = batch.column(0).as_any().downcast_ref();
        let column = column.ok_or_else(|| Error::corrupt(path, "scenario_id has another type".to_owned()))?;
        ids.extend(column.iter().flatten().map(str::to_owned));
    }
    Ok(ids)
}

/// A column in which two scenarios differ.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Difference {
    /// The column.
    pub column: String,
    /// The values as text, shortened.
    pub values: [String; 2],
}

/// The columns of a sample shard in which two scenarios differ, even by a bit, and the number of columns.
pub fn differences(a: &ScenarioRecord, b: &ScenarioRecord) -> Result<(Vec<Difference>, usize)> {
    let [a, b] = [sample::encode(std::slice::from_ref(a))?, sample::encode(std::slice::from_ref(b))?];
    let schema = a.schema();
    let differs = schema.fields().iter().enumerate().filter(|(i, _)| a.column(*i).to_data() != b.column(*i).to_data());
    let value = |array: &dyn Array| -> String {
        let text = array_value_to_string(array, 0).unwrap_or_default();
        if text.chars().count() <= 80 { text } else { text.chars().take(77).chain("...".chars()).collect() }
    };
    let differences = differs.map(|(i, field)| Difference {
        column: field.name().clone(),
        values: [value(a.column(i).as_ref()), value(b.column(i).as_ref())],
    });
    Ok((differences.collect(), schema.fields().len()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{LaneGraph, LaneId, MapId, Scene, SceneId};
    use crate::store::testing::{map, record, scene};
    use std::sync::Arc;

    /// A map source with one map, under any name.
    struct OneMap(LaneGraph);

    impl MapSource for OneMap {
        fn map(&self, _id: &MapId) -> Result<LaneGraph> {
            Ok(self.0.clone())
        }

        fn lanes(&self, _id: &MapId, lane_ids: &[LaneId]) -> Result<LaneGraph> {
            Ok(self.0.subset(lane_ids))
        }
    }

    fn scenes(maps: &OneMap) -> Vec<Scene> {
        let id = MapId::from("PIT");
        vec![scene(1, Some((&id, &maps.0))), scene(2, None), scene(3, Some((&id, &maps.0)))]
    }

    #[test]
    fn scenarios_come_back_as_they_were() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("samples-00000.parquet");
        let maps = OneMap(map(5, 9));
        let records: Vec<_> = scenes(&maps).iter().flat_map(|scene| (0..3).map(|i| record(scene, i))).collect();
        let stamp = write_samples(&path, &records).unwrap();
        let read = read_samples(&path, &maps).unwrap();
        assert_eq!(read, records);
        assert!(Arc::ptr_eq(&read[0].scenario.scene.lanes, &read[2].scenario.scene.lanes));
        assert_eq!(write_samples(&path, &read).unwrap(), stamp);
    }

    #[test]
    fn ids_are_read_alone_and_differences_are_named() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("samples-00000.parquet");
        let records: Vec<_> = (0..3).map(|i| record(&scene(2, None), i)).collect();
        write_samples(&path, &records).unwrap();
        assert_eq!(sample_ids(&path).unwrap(), records.iter().map(|r| r.scenario.id.clone()).collect::<Vec<_>>());
        let (same, n_columns) = differences(&records[0], &records[0].clone()).unwrap();
        assert_eq!((same, n_columns), (Vec::new(), sample::schema().fields.len()));
        let mut other = records[0].clone();
        other.sweep = "other".to_owned();
        let mut states = other.scenario.scene.tracks[1].trajectory.entries().to_vec();
        let state = states.iter_mut().flatten().next_back().unwrap();
        state.position.x = f64::from((state.position.x as f32).next_up());
        other.scenario.scene.tracks[1].trajectory = crate::scene::Trajectory::new(states);
        let (found, _) = differences(&records[0], &other).unwrap();
        let columns: Vec<&str> = found.iter().map(|difference| difference.column.as_str()).collect();
        assert_eq!(columns, ["sweep", "tracks"]);
        assert_eq!(found[0].values, ["guided", "other"]);
    }

    #[test]
    fn what_would_not_come_back_as_it_is_is_refused() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("samples-00000.parquet");
        let whole = record(&scene(2, None), 1);
        let refused = |change: &dyn Fn(&mut ScenarioRecord)| {
            let mut record = whole.clone();
            change(&mut record);
            let error = write_samples(&path, &[record]).unwrap_err();
            assert!(matches!(error, Error::Invalid { .. }) && !path.exists());
            error.to_string()
        };
        assert!(refused(&|r| r.scenario.scene = scene(2, None)).contains("pass the scene through as_stored"));
        assert!(refused(&|r| r.scenario.scene.id = SceneId::from("other")).contains("scene_id of its provenance"));
        assert!(refused(&|r| r.events[0].scene_id = SceneId::from("other")).contains("scene_id of its scene"));
        assert!(refused(&|r| r.scenario.scene.ego_idx = 99).contains("center is not among its tracks"));
    }
}

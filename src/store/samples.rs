//! Sample shards: the generated scenarios between the generate stage and the corpus.

use super::atomic::FileStamp;
use super::tables::sample;
use super::{MapSource, Result, ScenarioRecord, parquet_file};
use std::path::Path;

/// Writes one shard of generated scenarios, in the order given. Keep samples of a scene together: they share its lanes
/// when read.
///
/// # Errors
/// [`Error::Invalid`](super::Error::Invalid) when a record would not be read back as it is, for instance because its scene
/// was not passed through [`as_stored`](super::as_stored); those of the file system.
pub fn write_samples(path: &Path, records: &[ScenarioRecord]) -> Result<FileStamp> {
    parquet_file::write_batch(path, &sample::schema(), &sample::encode(records)?)
}

/// Reads one shard of generated scenarios; lanes come from `maps`, such as the scene store they were generated from.
///
/// # Errors
/// [`Error::Corrupt`](super::Error::Corrupt) and [`Error::SchemaVersion`](super::Error::SchemaVersion) when the file is no
/// such shard; those of `maps` and of the file system.
pub fn read_samples(path: &Path, maps: &dyn MapSource) -> Result<Vec<ScenarioRecord>> {
    let mut records = Vec::new();
    for batch in parquet_file::read(path, &sample::schema())? {
        records.extend(sample::decode(&batch, path, maps)?);
    }
    Ok(records)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{LaneGraph, LaneId, MapId, Scene, SceneId};
    use crate::store::Error;
    use crate::store::testing::{map, record, scene};
    use std::sync::Arc;

    /// One map of any name.
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
        assert!(refused(&|r| r.scenario.scene.id = SceneId::from("other")).contains("name of the recording"));
        assert!(refused(&|r| r.events[0].scene_id = SceneId::from("other")).contains("name of its scene"));
        assert!(refused(&|r| r.scenario.scene.ego_idx = 99).contains("ego is not among its tracks"));
    }
}

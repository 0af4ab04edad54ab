//! Writing a corpus: the tables that users query, and the manifest that says they are whole.

use super::atomic::{FileStamp, remove_if_present, remove_partials, write_json_atomically};
use super::corpus_manifest::{CorpusManifest, CorpusNotes, TableEntry, source_terms};
use super::parquet_file::ParquetFile;
use super::scene_manifest::MANIFEST_FILE;
use super::schema::TableSchema;
use super::tables::scenario::ScenarioRows;
use super::tables::{lane, metric, sample, scenario, track};
use super::{Error, MapSource, MetricRow, Result, ScenarioRecord};
use crate::scene::MapId;
use fs_err as fs;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// The table of scenarios.
pub(crate) const SCENARIOS_FILE: &str = "scenarios.parquet";
/// The table of tracks.
pub(crate) const TRACKS_FILE: &str = "tracks.parquet";
/// The table of metric values.
pub(crate) const METRICS_FILE: &str = "metrics.parquet";
/// The table of lanes.
pub(crate) const LANES_FILE: &str = "lanes.parquet";

/// Scenarios whose tracks are encoded at a time.
const SCENARIOS_PER_BATCH: usize = 64;

/// Writes a corpus folder. Tracks, lanes and metric values are written as they come; the rows of scenarios, some hundred
/// bytes each, wait in memory because the columns of parameters are known only at the end.
pub struct CorpusWriter<'m> {
    dir: PathBuf,
    maps: &'m dyn MapSource,
    tracks: ParquetFile,
    lanes: ParquetFile,
    metrics: ParquetFile,
    scenarios: Vec<ScenarioRows>,
    scenario_ids: BTreeSet<String>,
    known_maps: BTreeSet<MapId>,
    manifest: CorpusManifest,
}

impl<'m> CorpusWriter<'m> {
    /// Begins a corpus in `dir`, which is created where it is missing; the files of an earlier one are removed. Maps are
    /// copied from `maps` as scenarios need them.
    ///
    /// # Errors
    /// Those of the file system.
    pub fn create(dir: &Path, maps: &'m dyn MapSource) -> Result<Self> {
        fs::create_dir_all(dir)?;
        for file in [MANIFEST_FILE, SCENARIOS_FILE, TRACKS_FILE, METRICS_FILE, LANES_FILE] {
            remove_if_present(&dir.join(file))?;
        }
        remove_partials(dir)?;
        let table = |file: &str, schema: &TableSchema| ParquetFile::create(&dir.join(file), schema, schema.arrow());
        Ok(Self {
            dir: dir.to_owned(),
            maps,
            tracks: table(TRACKS_FILE, &track::schema())?,
            lanes: table(LANES_FILE, &lane::schema())?,
            metrics: table(METRICS_FILE, &metric::schema())?,
            scenarios: Vec::new(),
            scenario_ids: BTreeSet::new(),
            known_maps: BTreeSet::new(),
            manifest: CorpusManifest::empty(),
        })
    }

    /// Adds scenarios, in the order given.
    ///
    /// # Errors
    /// [`Error::Invalid`] when an id occurs twice or a record would not be read back as it is; those of the maps and of the
    /// file system.
    pub fn write_scenarios(&mut self, records: &[ScenarioRecord]) -> Result<()> {
        for batch in records.chunks(SCENARIOS_PER_BATCH) {
            for record in batch {
                self.register(record)?;
            }
            self.tracks.write(&track::encode(batch)?)?;
            self.scenarios.push(ScenarioRows::new(batch)?);
        }
        Ok(())
    }

    /// Adds metric values, in the order given.
    ///
    /// # Errors
    /// Those of the file system.
    pub fn write_metrics(&mut self, rows: &[MetricRow]) -> Result<()> {
        self.metrics.write(&metric::encode(rows)?)
    }

    /// Finishes the tables and writes the manifest.
    ///
    /// # Errors
    /// [`Error::Invalid`] when a parameter has the name of another column; those of the file system.
    pub fn finish(mut self, notes: &CorpusNotes) -> Result<CorpusManifest> {
        let (n_rows, stamp) = write_scenario_table(&self.dir.join(SCENARIOS_FILE), self.scenarios)?;
        let mut add = |file: &str, schema: &TableSchema, n_rows: u64, stamp: FileStamp| {
            self.manifest.tables.insert(file.to_owned(), TableEntry { schema: schema.id(), n_rows, stamp });
        };
        add(SCENARIOS_FILE, &scenario::schema(), n_rows, stamp);
        add(TRACKS_FILE, &track::schema(), self.tracks.n_rows(), self.tracks.finish()?);
        add(METRICS_FILE, &metric::schema(), self.metrics.n_rows(), self.metrics.finish()?);
        add(LANES_FILE, &lane::schema(), self.lanes.n_rows(), self.lanes.finish()?);
        self.manifest.n_maps = self.known_maps.len() as u64;
        self.manifest.sources.extend(notes.sources.clone());
        self.manifest.notes.clone_from(&notes.notes);
        self.manifest.left_out.clone_from(&notes.left_out);
        write_json_atomically(&self.dir.join(MANIFEST_FILE), &self.manifest)?;
        Ok(self.manifest)
    }

    /// Counts a scenario and writes its map when it is the first to need it.
    fn register(&mut self, record: &ScenarioRecord) -> Result<()> {
        sample::check(record)?;
        let scene = &record.scenario.scene;
        if !self.scenario_ids.insert(record.scenario.id.clone()) {
            return Err(Error::invalid(&record.scenario.id, "another scenario has this id"));
        }
        if let Some(map_id) = &scene.map_id
            && !scene.lanes.is_empty()
            && self.known_maps.insert(map_id.clone())
        {
            self.lanes.write(&lane::encode(&[(map_id, &self.maps.map(map_id)?)])?)?;
        }
        let dataset = scene.source.dataset;
        let manifest = &mut self.manifest;
        manifest.n_scenarios += 1;
        manifest.n_verified += u64::from(record.verified);
        *manifest.scenarios_by_dataset.entry(dataset.name().to_owned()).or_default() += 1;
        *manifest.scenarios_by_sweep.entry(record.sweep.clone()).or_default() += 1;
        manifest.sources.entry(dataset.name().to_owned()).or_insert_with(|| source_terms(dataset).to_owned());
        Ok(())
    }
}

/// Writes the rows of all scenarios with the columns of all parameters that occur.
fn write_scenario_table(path: &Path, batches: Vec<ScenarioRows>) -> Result<(u64, FileStamp)> {
    let mut names = BTreeSet::new();
    for rows in &batches {
        names.extend(rows.parameters()?.into_iter().map(str::to_owned));
    }
    let names: BTreeSet<&str> = names.iter().map(String::as_str).collect();
    let mut file = ParquetFile::create(path, &scenario::schema(), ScenarioRows::schema_with(&names))?;
    for rows in batches {
        file.write(&rows.into_batch(&names)?)?;
    }
    Ok((file.n_rows(), file.finish()?))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{LaneGraph, Scene};
    use crate::store::testing::{assessment, event, folder_bytes, map, record, scene};
    use crate::store::{CorpusReader, SceneStore, SceneWriter, SceneWriterOptions};
    use serde_json::Value;

    /// A store of some scenes on two maps, and scenarios from them.
    fn store_and_records(dir: &Path) -> (SceneStore, Vec<ScenarioRecord>) {
        let maps: Vec<(MapId, LaneGraph)> = vec![("PIT".into(), map(1, 9)), ("MIA".into(), map(2, 7))];
        let scenes: Vec<Scene> =
            (0..70).map(|i| scene(i, maps.get(i as usize % 3).map(|(id, graph)| (id, graph)))).collect();
        let mut writer = SceneWriter::create(dir, SceneWriterOptions::default()).unwrap();
        writer.write_batch(&scenes, &maps, 1, &Value::Null).unwrap();
        writer.finish(&Value::Null).unwrap();
        let mut records: Vec<ScenarioRecord> =
            scenes.iter().flat_map(|scene| (0..2).map(|i| record(scene, i))).collect();
        for (i, record) in records.iter_mut().enumerate().filter(|(i, _)| i % 3 > 0) {
            record.assessment = Some(assessment(&record.scenario.scene, i % 3 == 1));
        }
        // A parameter that occurs late, in a batch of its own.
        let last = records.last_mut().unwrap();
        last.events = vec![event(&last.scenario.scene.id, "cut_in", &[("ttc_s", 2.5)])];
        (SceneStore::open(dir).unwrap(), records)
    }

    fn metric_row() -> MetricRow {
        MetricRow {
            group: "recorded".to_owned(),
            sweep: String::new(),
            strength: 0.0,
            place: "PIT".to_owned(),
            scene_id: None,
            scenario_id: None,
            metric: "collision_rate".to_owned(),
            value: 0.25,
            n: 4,
            std_error: None,
        }
    }

    fn write(dir: &Path, store: &SceneStore, records: &[ScenarioRecord], batch_len: usize) -> CorpusManifest {
        let mut writer = CorpusWriter::create(dir, store).unwrap();
        for batch in records.chunks(batch_len) {
            writer.write_scenarios(batch).unwrap();
        }
        writer.write_metrics(&[metric_row()]).unwrap();
        let left_out = [("guided".to_owned(), [("not_verified".to_owned(), 7)].into())].into();
        writer.finish(&CorpusNotes { left_out, ..CorpusNotes::default() }).unwrap()
    }

    #[test]
    fn scenarios_come_back_as_they_were() {
        let (store_dir, dir) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let (store, records) = store_and_records(store_dir.path());
        let manifest = write(dir.path(), &store, &records, 33);
        assert_eq!((manifest.n_scenarios, manifest.n_verified, manifest.n_maps), (140, 70, 2));
        assert_eq!(manifest.scenarios_by_sweep["guided"], 140);
        assert_eq!(manifest.left_out["guided"]["not_verified"], 7);
        assert!(manifest.sources["argoverse1"].contains("CC BY-NC-SA 4.0"));

        let reader = CorpusReader::open(dir.path()).unwrap();
        assert_eq!(*reader.manifest(), manifest);
        assert_eq!(reader.metrics().unwrap(), [metric_row()]);
        assert!(reader.scenario_ids().unwrap().eq(records.iter().map(|record| record.scenario.id.as_str())));
        for (i, record) in records.iter().enumerate().rev() {
            assert_eq!(reader.scenario(i).unwrap(), *record, "scenario {i}");
        }
        assert_eq!(reader.position(&records[7].scenario.id).unwrap(), 7);
        assert!(reader.scenario(140).unwrap_err().to_string().ends_with("holds no scenario number 140 of 140"));
    }

    #[test]
    fn the_same_scenarios_give_the_same_bytes_however_they_come() {
        let (store_dir, one, two) =
            (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let (store, records) = store_and_records(store_dir.path());
        write(one.path(), &store, &records, 5);
        write(two.path(), &store, &records, 140);
        assert!(folder_bytes(one.path()) == folder_bytes(two.path()));
    }

    #[test]
    fn an_abandoned_corpus_is_no_corpus() {
        let (store_dir, dir) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let (store, records) = store_and_records(store_dir.path());
        write(dir.path(), &store, &records, 33);
        let mut writer = CorpusWriter::create(dir.path(), &store).unwrap();
        writer.write_scenarios(&records[..3]).unwrap();
        drop(writer);
        assert_eq!(folder_bytes(dir.path()).len(), 0);
        assert!(matches!(CorpusReader::open(dir.path()).err(), Some(Error::Unfinished { .. })));
    }

    #[test]
    fn an_id_cannot_occur_twice() {
        let (store_dir, dir) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let (store, records) = store_and_records(store_dir.path());
        let mut writer = CorpusWriter::create(dir.path(), &store).unwrap();
        let error = writer.write_scenarios(&[records[0].clone(), records[0].clone()]).unwrap_err();
        assert!(error.to_string().ends_with("another scenario has this id"), "{error}");
    }

    #[test]
    fn damage_is_found() {
        let (store_dir, dir) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let (store, records) = store_and_records(store_dir.path());
        write(dir.path(), &store, &records, 33);
        for file in [SCENARIOS_FILE, TRACKS_FILE, LANES_FILE, METRICS_FILE] {
            let path = dir.path().join(file);
            let whole = fs::read(&path).unwrap();
            fs::write(&path, &whole[..whole.len() - 1]).unwrap();
            let error = CorpusReader::open(dir.path()).err().unwrap().to_string();
            assert!(error.contains(file) && error.contains("is damaged"), "{error}");
            let mut damaged = whole.clone();
            damaged[whole.len() / 2] ^= 1;
            fs::write(&path, &damaged).unwrap();
            let found = CorpusReader::open(dir.path()).err().unwrap().to_string();
            assert!(found.contains(file) && found.contains("is damaged"), "{found}");
            fs::write(&path, &whole).unwrap();
        }
    }
}

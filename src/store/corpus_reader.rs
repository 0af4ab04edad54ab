//! Random access to a corpus: its counts, its metric values, and each scenario as it was written.

use super::corpus_layout::CorpusTable;
use super::corpus_manifest::{CorpusManifest, FileEntry};
use super::corpus_scan::{CorpusScan, widened};
use super::maps::{MapSource, MapTable};
use super::tables::columns::Columns;
use super::tables::{metric, recording, scenario, track};
use super::{Error, Result, parquet_file};
use crate::metrics::MetricRow;
use crate::scenario::ScenarioRecord;
use crate::scene::{LaneGraph, LaneId, MapId, ObservationMask, SceneId, Track};
use arrow::array::{BooleanArray, RecordBatch, StringArray, UInt64Array};
use arrow::compute::concat_batches;
use arrow::datatypes::UInt32Type;
use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;
use std::path::{Path, PathBuf};

/// A finished corpus with random access to its scenarios. The tables of scenarios and lanes are in memory; tracks are
/// read on demand. Scenarios are in the order of their partitions, and within each as they were written.
pub struct CorpusReader {
    scan: CorpusScan,
    scenarios: RecordBatch,
    /// The path of the scenario table, for errors.
    scenarios_path: PathBuf,
    /// The file of each scenario's states and their rows in it.
    tracks: Vec<(PathBuf, Range<usize>)>,
    /// The file of each recorded scene's states and their rows in it.
    recordings: BTreeMap<String, (PathBuf, Range<usize>)>,
    maps: MapTable,
}

impl CorpusReader {
    /// Opens a finished corpus, of this version or an earlier one with one file per table, and verifies the checksums
    /// of all of its tables.
    ///
    /// # Errors
    /// [`Error::Unfinished`] without a manifest, [`Error::SchemaVersion`] when its version cannot be read,
    /// [`Error::Corrupt`] when a table is not as it was written.
    pub fn open(dir: &Path) -> Result<Self> {
        let scan = CorpusScan::open(dir)?;
        let scenarios_path = dir.join(CorpusTable::Scenarios.name());
        let schema = scan.scenario_schema()?;
        let (mut batches, mut tracks) = (Vec::new(), Vec::new());
        for i in 0..scan.n_parts() {
            let (file, tracks_file) = scan.part(i)?;
            let (path, tracks_path) = (scan.path(file), scan.path(tracks_file));
            let mut end = 0usize;
            for batch in scan.batches(CorpusTable::Scenarios, file, None)? {
                let batch = widened(&batch?, &schema, &path)?;
                let n_states: &UInt64Array = Columns::of_batch(&batch, &path).get("n_states")?;
                for n in n_states.values() {
                    let start = end;
                    end = end.saturating_add(*n as usize);
                    tracks.push((tracks_path.clone(), start..end));
                }
                batches.push(batch);
            }
            if end as u64 != tracks_file.n_rows {
                let detail = format!("it has {} rows, and the scenarios have {end} states", tracks_file.n_rows);
                return Err(Error::corrupt(&tracks_path, detail));
            }
        }
        let scenarios = concat_batches(&schema, &batches).map_err(|e| Error::unreadable(&scenarios_path, e))?;
        let (maps, recordings) = (scan.maps()?, recordings(&scan)?);
        Ok(Self { scan, scenarios, scenarios_path, tracks, recordings, maps })
    }

    /// The manifest.
    pub const fn manifest(&self) -> &CorpusManifest {
        self.scan.manifest()
    }

    /// Number of scenarios.
    pub fn len(&self) -> usize {
        self.scenarios.num_rows()
    }

    /// Whether there are no scenarios.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The ids of all scenarios, in order.
    ///
    /// # Errors
    /// [`Error::Corrupt`] when the table has no such column.
    pub fn scenario_ids(&self) -> Result<impl Iterator<Item = &str>> {
        let ids: &StringArray = self.columns().get("scenario_id")?;
        Ok(ids.iter().flatten())
    }

    /// The behavior requested of each scenario, and whether it was accepted.
    pub fn requests(&self) -> Result<impl Iterator<Item = (Option<&str>, bool)>> {
        let behaviors: &StringArray = self.columns().get("requested_behavior")?;
        let accepted: &BooleanArray = self.columns().get("accepted")?;
        Ok(behaviors.iter().zip(accepted.iter().map(|accepted| accepted == Some(true))))
    }

    /// The position of the scenario whose id is or begins with `scenario_id`.
    ///
    /// # Errors
    /// [`Error::NotFound`] when there is none or several.
    pub fn position(&self, scenario_id: &str) -> Result<usize> {
        let ids = || Ok::<_, Error>(self.scenario_ids()?.enumerate());
        if let Some((position, _)) = ids()?.find(|(_, id)| *id == scenario_id) {
            return Ok(position);
        }
        let mut abbreviated = ids()?.filter(|(_, id)| id.starts_with(scenario_id));
        match (abbreviated.next(), abbreviated.next()) {
            (Some((position, _)), None) => Ok(position),
            (Some(_), Some(_)) => Err(self.missing(&format!("only scenario whose id begins with {scenario_id}"))),
            (None, _) => Err(self.missing(&format!("scenario {scenario_id}"))),
        }
    }

    /// Loads scenario `i` with its tracks, lanes and events.
    ///
    /// # Errors
    /// [`Error::NotFound`] when there are fewer, [`Error::Corrupt`] when the tables do not fit each other.
    pub fn scenario(&self, i: usize) -> Result<ScenarioRecord> {
        let missing = || self.missing(&format!("scenario number {i} of {}", self.len()));
        let (path, rows) = self.tracks.get(i).ok_or_else(missing)?;
        let columns = self.columns();
        let n_timesteps = columns.number::<UInt32Type>("n_timesteps", i)? as usize;
        let (tracks, observed) = tracks(path, rows.clone(), columns.text("scenario_id", i)?, n_timesteps)?;
        scenario::decode(&columns, i, tracks, observed, &self.maps)
    }

    /// The position of the first scenario of each scene on this map.
    ///
    /// # Errors
    /// [`Error::Corrupt`] when the table lacks a column.
    pub fn scenes_of(&self, map_id: &MapId) -> Result<Vec<usize>> {
        let columns = self.columns();
        let [scenes, maps]: [&StringArray; 2] = [columns.get("scene_id")?, columns.get("map_id")?];
        let mut known = BTreeSet::new();
        let is_first = |i: &usize| known.insert(scenes.value(*i));
        let is_on_map = |(_, id): &(usize, Option<&str>)| *id == Some(map_id.0.as_str());
        Ok(maps.iter().enumerate().filter(is_on_map).map(|(i, _)| i).filter(is_first).collect())
    }

    /// The windows of this recording ([`SceneId::windows_of`]), with the position of the first scenario of each.
    ///
    /// # Errors
    /// [`Error::Corrupt`] when the table lacks a column.
    pub fn windows_of(&self, recording: &str) -> Result<Vec<(i64, usize)>> {
        let ids: &StringArray = self.columns().get("scene_id")?;
        Ok(SceneId::windows_of(recording, (0..self.len()).map(|i| ids.value(i))))
    }

    /// The tracks of a recorded scene, in the scene frame; `None` if the corpus lacks the recording. The rest of the
    /// scene is as in the scenarios that continue it.
    ///
    /// # Errors
    /// [`Error::Corrupt`] when the table cannot be read or has a state after `n_timesteps`.
    pub fn recorded_tracks(&self, scene_id: &SceneId, n_timesteps: usize) -> Result<Option<Vec<Track>>> {
        let Some((path, rows)) = self.recordings.get(&scene_id.0) else { return Ok(None) };
        let batch = rows_of(path, CorpusTable::Recordings, rows.clone())?;
        recording::decode(&Columns::of_batch(&batch, path), batch.num_rows(), n_timesteps).map(Some)
    }

    /// All metric values.
    pub fn metrics(&self) -> Result<Vec<MetricRow>> {
        let mut rows = Vec::new();
        for file in self.manifest().files(CorpusTable::Metrics) {
            for batch in self.scan.batches(CorpusTable::Metrics, file, None)? {
                rows.extend(metric::decode(&batch?, &self.scan.path(file))?);
            }
        }
        Ok(rows)
    }

    fn columns(&self) -> Columns<'_> {
        Columns::of_batch(&self.scenarios, &self.scenarios_path)
    }

    fn missing(&self, what: &str) -> Error {
        Error::NotFound { path: self.scan.dir().to_owned(), what: what.to_owned() }
    }
}

impl MapSource for CorpusReader {
    fn map(&self, id: &MapId) -> Result<LaneGraph> {
        self.maps.map(id)
    }

    fn lanes(&self, id: &MapId, lane_ids: &[LaneId]) -> Result<LaneGraph> {
        self.maps.lanes(id, lane_ids)
    }
}

/// The tracks in these rows, which must all belong to this scenario, and the mask of their observed states.
fn tracks(
    path: &Path,
    rows: Range<usize>,
    scenario_id: &str,
    n_timesteps: usize,
) -> Result<(Vec<Track>, ObservationMask)> {
    let batch = rows_of(path, CorpusTable::Tracks, rows)?;
    let columns = Columns::of_batch(&batch, path);
    let ids: &StringArray = columns.get("scenario_id")?;
    if ids.iter().any(|id| id != Some(scenario_id)) {
        return Err(Error::corrupt(path, format!("the rows of {scenario_id} are not in the order of the scenarios")));
    }
    track::decode(&columns, batch.num_rows(), n_timesteps)
}

fn rows_of(path: &Path, table: CorpusTable, rows: Range<usize>) -> Result<RecordBatch> {
    let batches = parquet_file::read_rows(path, &table.schema(), rows)?;
    let schema = batches.first().map_or_else(|| table.schema().arrow(), RecordBatch::schema);
    concat_batches(&schema, &batches).map_err(|error| Error::unreadable(path, error))
}

/// The file and rows of the states of each recorded scene.
fn recordings(scan: &CorpusScan) -> Result<BTreeMap<String, (PathBuf, Range<usize>)>> {
    let mut scenes: BTreeMap<String, (PathBuf, Range<usize>)> = BTreeMap::new();
    for file in scan.manifest().files(CorpusTable::Recordings) {
        add_recordings(scan, file, &mut scenes)?;
    }
    Ok(scenes)
}

fn add_recordings(
    scan: &CorpusScan,
    file: &FileEntry,
    scenes: &mut BTreeMap<String, (PathBuf, Range<usize>)>,
) -> Result<()> {
    let path = scan.path(file);
    let mut row = 0;
    for batch in scan.batches(CorpusTable::Recordings, file, Some(&["scene_id"]))? {
        let batch = batch?;
        let ids: &StringArray = Columns::of_batch(&batch, &path).get("scene_id")?;
        for id in ids.iter().flatten() {
            match scenes.get_mut(id) {
                Some((_, rows)) if rows.end == row => rows.end += 1,
                Some(_) => return Err(Error::corrupt(&path, format!("the rows of scene {id} are not together"))),
                None => {
                    scenes.insert(id.to_owned(), (path.clone(), row..row + 1));
                }
            }
            row += 1;
        }
    }
    Ok(())
}

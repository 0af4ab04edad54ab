//! Reading a corpus: its counts, its metric values, and any scenario as it was written.

use super::corpus_manifest::CorpusManifest;
use super::corpus_writer::{LANES_FILE, METRICS_FILE, SCENARIOS_FILE, TRACKS_FILE};
use super::maps::{MapSource, MapTable};
use super::schema::TableSchema;
use super::tables::columns::Columns;
use super::tables::{lane, scenario, track};
use super::{Error, MetricRow, Result, ScenarioRecord, parquet_file, read_metrics};
use crate::scene::{LaneGraph, LaneId, MapId, ObservationMask, Track};
use arrow::array::{RecordBatch, StringArray, UInt64Array};
use arrow::compute::concat_batches;
use arrow::datatypes::UInt32Type;
use rayon::prelude::*;
use std::ops::Range;
use std::path::{Path, PathBuf};

/// A finished corpus. The tables of scenarios and lanes are held in memory, tracks are read when asked for.
pub struct CorpusReader {
    dir: PathBuf,
    manifest: CorpusManifest,
    scenarios_path: PathBuf,
    /// The scenario table.
    scenarios: RecordBatch,
    /// Where each scenario's rows in the track table end.
    track_ends: Vec<usize>,
    maps: MapTable,
}

impl CorpusReader {
    /// Opens a finished corpus and verifies the checksums of all of its tables.
    ///
    /// # Errors
    /// [`Error::Unfinished`] without a manifest, [`Error::SchemaVersion`] when another version wrote it, [`Error::Corrupt`]
    /// when a table is not what was written.
    pub fn open(dir: &Path) -> Result<Self> {
        let manifest = CorpusManifest::read(dir)?;
        manifest.tables.par_iter().try_for_each(|(file, table)| table.stamp.verify_file(&dir.join(file)))?;
        let path = dir.join(SCENARIOS_FILE);
        let table = scenario::schema();
        let scenarios = concatenated(&path, &table, &parquet_file::read(&path, &table)?)?;
        let n_states: &UInt64Array = Columns::of_batch(&scenarios, &path).get("n_states")?;
        let track_ends = n_states.values().iter().scan(0, |end, n| {
            *end += *n as usize;
            Some(*end)
        });
        let track_ends = track_ends.collect();
        let lanes_path = dir.join(LANES_FILE);
        let mut maps = MapTable::new(dir);
        for batch in parquet_file::read(&lanes_path, &lane::schema())? {
            maps.push(&lanes_path, batch)?;
        }
        Ok(Self { dir: dir.to_owned(), manifest, scenarios_path: path, scenarios, track_ends, maps })
    }

    /// The manifest.
    pub const fn manifest(&self) -> &CorpusManifest {
        &self.manifest
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

    /// The position of a scenario.
    ///
    /// # Errors
    /// [`Error::NotFound`] when there is none of this id.
    pub fn position(&self, scenario_id: &str) -> Result<usize> {
        self.scenario_ids()?.position(|id| id == scenario_id).ok_or_else(|| self.missing(scenario_id))
    }

    /// Loads scenario `i` with its tracks, lanes and events.
    ///
    /// # Errors
    /// [`Error::NotFound`] when there are not as many, [`Error::Corrupt`] when the tables do not fit each other.
    pub fn scenario(&self, i: usize) -> Result<ScenarioRecord> {
        let end = *self.track_ends.get(i).ok_or_else(|| self.missing(&format!("number {i} of {}", self.len())))?;
        let start = i.checked_sub(1).map_or(0, |before| self.track_ends[before]);
        let columns = self.columns();
        let n_timesteps = columns.number::<UInt32Type>("n_timesteps", i)? as usize;
        let (tracks, observed) = self.tracks(start..end, columns.text("scenario_id", i)?, n_timesteps)?;
        scenario::decode(&columns, i, tracks, observed, &self.maps)
    }

    /// All metric values.
    ///
    /// # Errors
    /// [`Error::Corrupt`] when the table cannot be read.
    pub fn metrics(&self) -> Result<Vec<MetricRow>> {
        read_metrics(&self.dir.join(METRICS_FILE))
    }

    fn columns(&self) -> Columns<'_> {
        Columns::of_batch(&self.scenarios, &self.scenarios_path)
    }

    fn tracks(
        &self,
        rows: Range<usize>,
        scenario_id: &str,
        n_timesteps: usize,
    ) -> Result<(Vec<Track>, ObservationMask)> {
        let path = self.dir.join(TRACKS_FILE);
        let table = track::schema();
        let batch = concatenated(&path, &table, &parquet_file::read_rows(&path, &table, rows)?)?;
        let columns = Columns::of_batch(&batch, &path);
        let ids: &StringArray = columns.get("scenario_id")?;
        if ids.iter().any(|id| id != Some(scenario_id)) {
            return Err(Error::corrupt(&path, format!("its rows are not in the order of {SCENARIOS_FILE}")));
        }
        track::decode(&columns, batch.num_rows(), n_timesteps)
    }

    fn missing(&self, scenario: &str) -> Error {
        Error::NotFound { path: self.dir.clone(), what: format!("scenario {scenario}") }
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

fn concatenated(path: &Path, table: &TableSchema, batches: &[RecordBatch]) -> Result<RecordBatch> {
    let schema = batches.first().map_or_else(|| table.arrow(), RecordBatch::schema);
    concat_batches(&schema, batches).map_err(|error| Error::corrupt(path, error.to_string()))
}

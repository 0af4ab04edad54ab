//! The corpus table of scenarios: one row a generated scenario; its states are in the track table.

use super::columns::{Columns, numbers, optional_numbers, optional_texts, small};
use super::parameters::{self, Parameters};
use super::{assessment, event_list, provenance, scene_header};
use crate::behavior::BehaviorEvent;
use crate::scenario::ScenarioRecord;
use crate::scene::{ObservationMask, Scene, Track};
use crate::store::schema::{ColumnExt, TableSchema, column};
use crate::store::{Error, MapSource, Result};
use arrow::array::{ArrayRef, RecordBatch};
use arrow::datatypes::{DataType, Field, UInt32Type, UInt64Type};
use std::collections::BTreeSet;
use std::path::Path;
use std::sync::Arc;

/// `scenario.v1`.
pub(crate) fn schema() -> TableSchema {
    let mut fields = provenance::fields();
    fields.extend(scene_header::fields());
    fields.extend([
        column("n_agents", DataType::UInt32, "Number of tracks with at least one state.").unit("1"),
        column("n_states", DataType::UInt64, "Number of its rows in the track table, which are in the same order.")
            .unit("1"),
        column("event_start_timestep", DataType::UInt32, "First timestep of the first requested event.")
            .unit("1")
            .optional(),
        column("event_end_timestep", DataType::UInt32, "Last timestep of the first requested event.")
            .unit("1")
            .optional(),
        column(
            "subject_track_id",
            DataType::Utf8,
            "The vehicle to which the first requested event happens, such as the one that is cut off; missing without \
             an event, or if it happens to nobody.",
        )
        .optional(),
    ]);
    fields.extend(assessment::fields());
    TableSchema {
        name: "scenario",
        version: 1,
        description: "One row a generated scenario; parameters are those of the first requested event found in it.",
        fields,
        open: vec![parameters::open_columns()],
    }
}

/// The column of parameters while rows are spooled.
const SPOOLED: &str = "spooled_parameters";

/// Rows without the parameter columns, which are known only after the last row.
pub(crate) struct ScenarioRows {
    arrays: Vec<ArrayRef>,
    parameters: Vec<Option<Parameters>>,
}

impl ScenarioRows {
    /// The rows of these records.
    pub(crate) fn new(records: &[ScenarioRecord]) -> Result<Self> {
        let scenes: Vec<&Scene> = records.iter().map(|record| &record.scenario.scene).collect();
        let events: Vec<Option<&BehaviorEvent>> = records.iter().map(ScenarioRecord::main_event).collect();
        let (mut n_agents, mut starts, mut ends) = (Vec::new(), Vec::new(), Vec::new());
        for (record, event) in records.iter().zip(&events) {
            let id = &record.scenario.id;
            let present = record.scenario.scene.tracks.iter().filter(|track| track.trajectory.n_valid() > 0);
            n_agents.push(small(id, "number of agents", present.count())?);
            starts.push(event.map(|event| small(id, "timestep", event.start_timestep)).transpose()?);
            ends.push(event.map(|event| small(id, "timestep", event.end_timestep)).transpose()?);
        }
        let n_states = |scene: &&Scene| scene.tracks.iter().map(|track| track.trajectory.n_valid() as u64).sum();
        let mut arrays = provenance::encode(&records.iter().collect::<Vec<_>>())?;
        arrays.extend(scene_header::encode(&scenes)?);
        arrays.extend([
            numbers::<UInt32Type>(n_agents),
            numbers::<UInt64Type>(scenes.iter().map(n_states)),
            optional_numbers::<UInt32Type>(starts),
            optional_numbers::<UInt32Type>(ends),
            optional_texts(records.iter().map(|record| Some(record.subject()?.id.0.as_str()))),
        ]);
        let judged: Vec<_> = records.iter().map(|r| (r.scenario.id.as_str(), r.assessment.as_ref())).collect();
        arrays.extend(assessment::encode(&judged)?);
        Ok(Self { arrays, parameters: events.iter().map(|event| event.map(|e| e.parameters.clone())).collect() })
    }

    /// The parameters that occur in these rows.
    pub(crate) fn parameters(&self) -> Result<BTreeSet<&str>> {
        parameters::occurring(&schema(), &self.parameters.iter().map(Option::as_ref).collect::<Vec<_>>())
    }

    /// The schema of a table with these parameters.
    pub(crate) fn schema_with(names: &BTreeSet<&str>) -> arrow::datatypes::SchemaRef {
        let fields: Vec<Field> = parameters::flatten(names, &[]).into_iter().map(|(f, _)| f).collect();
        schema().arrow_with(fields)
    }

    /// The columns of [`into_spooled`](Self::into_spooled).
    pub(crate) fn spool_schema() -> arrow::datatypes::SchemaRef {
        schema().arrow_with(vec![event_list::parameters_field(SPOOLED)])
    }

    /// The rows with their parameters in one column, until the names of all parameters are known.
    pub(crate) fn into_spooled(mut self) -> Result<RecordBatch> {
        let none = Parameters::new();
        let rows = self.parameters.iter().map(|row| row.as_ref().unwrap_or(&none));
        self.arrays.push(event_list::encode_parameters(&rows.collect::<Vec<_>>())?);
        RecordBatch::try_new(Self::spool_schema(), self.arrays)
            .map_err(|error| Error::invalid("scenarios", error.to_string()))
    }

    /// The rows of [`into_spooled`](Self::into_spooled).
    pub(crate) fn from_spooled(batch: &RecordBatch, path: &Path) -> Result<Self> {
        let columns = Columns::of_batch(batch, path);
        let decode = |row: usize| Ok(Some(event_list::decode_parameters(&columns, SPOOLED, row)?));
        let parameters: Result<Vec<Option<Parameters>>> = (0..batch.num_rows()).map(decode).collect();
        let n_fixed = schema().fields.len();
        Ok(Self { arrays: batch.columns()[..n_fixed].to_vec(), parameters: parameters? })
    }

    /// The rows with the columns of these parameters.
    pub(crate) fn into_batch(mut self, names: &BTreeSet<&str>) -> Result<RecordBatch> {
        let columns = parameters::flatten(names, &self.parameters.iter().map(Option::as_ref).collect::<Vec<_>>());
        self.arrays.extend(columns.into_iter().map(|(_, array)| array));
        RecordBatch::try_new(Self::schema_with(names), self.arrays)
            .map_err(|error| Error::invalid("scenarios", error.to_string()))
    }
}

/// The record in a row, given its tracks and the mask of their observed states.
pub(crate) fn decode(
    columns: &Columns<'_>,
    row: usize,
    tracks: Vec<Track>,
    observed: ObservationMask,
    maps: &dyn MapSource,
) -> Result<ScenarioRecord> {
    let path: &Path = columns.path;
    let header = scene_header::decode(columns, row)?;
    let lanes = Arc::new(header.lanes(maps, path)?);
    let record = provenance::decode(columns, row, header.complete(path, tracks, lanes)?, observed)?;
    Ok(ScenarioRecord { assessment: assessment::decode(columns, row)?, ..record })
}

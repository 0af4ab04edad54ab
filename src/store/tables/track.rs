//! The corpus table of tracks: one row a state of a road user, in the scene frame and in that of the recording.

use super::columns::{Columns, flags, optional_texts, texts};
use super::state_rows::{self, StateRow, rows_of};
use crate::scenario::ScenarioRecord;
use crate::scene::{ObservationMask, Track};
use crate::store::schema::{ColumnExt, TableSchema, column};
use crate::store::{Error, Result};
use arrow::array::RecordBatch;
use arrow::datatypes::DataType;
use std::collections::BTreeSet;

/// `track.v1`.
pub(crate) fn schema() -> TableSchema {
    let mut fields = vec![column("scenario_id", DataType::Utf8, "The scenario.")];
    fields.extend(state_rows::who_fields("scenario"));
    fields.push(
        column("event_role", DataType::Utf8, "Its role in the first requested event; missing if it has none.")
            .optional(),
    );
    fields.extend(state_rows::when_fields());
    fields.push(column(
        "observed",
        DataType::Boolean,
        "true: given to the denoiser, as recorded or edited; false: generated.",
    ));
    fields.extend(state_rows::state_fields());
    TableSchema {
        name: "track",
        version: 1,
        description: "One row a state of a road user in a scenario; in the order of the scenario table, then by track, \
                      then by time.",
        fields,
        open: Vec::new(),
    }
}

fn event_role<'r>(record: &'r ScenarioRecord, row: &StateRow<'r>) -> Option<&'r str> {
    let roles = &record.main_event()?.roles;
    roles.role_of(&row.track().id)
}

pub(crate) fn encode(record: &ScenarioRecord) -> Result<RecordBatch> {
    let scenario = &record.scenario;
    let rows: Vec<StateRow<'_>> = rows_of(&scenario.scene).collect();
    let mut arrays = vec![texts(rows.iter().map(|_| scenario.id.as_str()))];
    arrays.extend(state_rows::who(&rows));
    arrays.push(optional_texts(rows.iter().map(|row| event_role(record, row))));
    arrays.extend(state_rows::when(&rows)?);
    arrays.push(flags(rows.iter().map(|row| scenario.observed.is_observed(row.agent_idx, row.timestep))));
    arrays.extend(state_rows::states(&rows));
    RecordBatch::try_new(schema().arrow(), arrays).map_err(|error| Error::invalid("tracks", error.to_string()))
}

/// The tracks of one scenario, whose rows are all of `columns`, and the mask of their observed states.
pub(crate) fn decode(
    columns: &Columns<'_>,
    n_rows: usize,
    n_timesteps: usize,
) -> Result<(Vec<Track>, ObservationMask)> {
    let mut observed = BTreeSet::new();
    let tracks = state_rows::decode(columns, n_rows, n_timesteps, |agent_idx, timestep, row| {
        if columns.flag("observed", row)? {
            observed.insert((agent_idx, timestep));
        }
        Ok(())
    })?;
    let is_observed = |agent_idx, timestep| observed.contains(&(agent_idx, timestep));
    let mask = ObservationMask::from_fn(tracks.len(), n_timesteps, is_observed);
    Ok((tracks, mask))
}

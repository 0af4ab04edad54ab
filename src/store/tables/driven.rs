//! The table of driven states: one row a state of a road user in a drive.

use super::columns::{optional_texts, texts};
use super::state_rows::{self, StateRow, rows_of};
use crate::scene::{Roles, Scene};
use crate::store::schema::{ColumnExt, TableSchema, column};
use crate::store::{Error, Result};
use arrow::array::RecordBatch;
use arrow::datatypes::DataType;

/// `driven.v1`.
pub(crate) fn schema() -> TableSchema {
    let mut fields = vec![
        column("scenario_id", DataType::Utf8, "The scenario."),
        column("driver", DataType::Utf8, "Who drives the ego, as in the table of drives."),
    ];
    fields.extend(state_rows::who_fields("scenario"));
    fields.push(column("event_role", DataType::Utf8, "Its role in the event; missing if it has none.").optional());
    fields.push(column(
        "moved_by",
        DataType::Utf8,
        "scenario: the past, as in the corpus; plan: the event, as in the corpus; model: sampled; driver: the ego.",
    ));
    fields.extend(state_rows::when_fields());
    fields.extend(state_rows::state_fields());
    TableSchema {
        name: "driven",
        version: 1,
        description: "One row a state of a road user in a drive; is_center marks the ego. In the order of the table of \
                      drives, then by track, then by time.",
        fields,
        open: Vec::new(),
    }
}

/// The rows of a drive with the roles of its event; `moved_by` gives who moved an agent at a timestep.
pub(crate) fn encode(
    [scenario_id, driver]: [&str; 2],
    (scene, roles): (&Scene, &Roles),
    moved_by: &dyn Fn(usize, usize) -> &'static str,
) -> Result<RecordBatch> {
    let rows: Vec<StateRow<'_>> = rows_of(scene).collect();
    let mut arrays = vec![texts(rows.iter().map(|_| scenario_id)), texts(rows.iter().map(|_| driver))];
    arrays.extend(state_rows::who(&rows));
    arrays.push(optional_texts(rows.iter().map(|row| roles.role_of(&row.track().id))));
    arrays.push(texts(rows.iter().map(|row| moved_by(row.agent_idx, row.timestep))));
    arrays.extend(state_rows::when(&rows)?);
    arrays.extend(state_rows::states(&rows));
    RecordBatch::try_new(schema().arrow(), arrays).map_err(|error| Error::invalid("driven states", error.to_string()))
}

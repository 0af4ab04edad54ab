//! The corpus table of recordings: one row a recorded state of a road user, for every scene that scenarios of the
//! corpus continue, so that scenarios can be joined with their recordings.

use super::columns::{Columns, texts};
use super::state_rows::{self, StateRow, rows_of};
use crate::scene::{Scene, Track};
use crate::store::schema::{TableSchema, column};
use crate::store::{Error, Result};
use arrow::array::RecordBatch;
use arrow::datatypes::DataType;

/// `recording.v1`.
pub(crate) fn schema() -> TableSchema {
    let mut fields = vec![column("scene_id", DataType::Utf8, "The recorded scene: dataset/split/place/case.")];
    fields.extend(state_rows::who_fields("scene"));
    fields.extend(state_rows::when_fields());
    fields.extend(state_rows::state_fields());
    TableSchema {
        name: "recording",
        version: 1,
        description: "One row a state of a road user in a recorded scene, each scene once; by scene as first used, \
                      then by track, then by time. Timing, frame and map of the scene are in the rows of its \
                      scenarios.",
        fields,
        open: Vec::new(),
    }
}

pub(crate) fn encode(scene: &Scene) -> Result<RecordBatch> {
    let rows: Vec<StateRow<'_>> = rows_of(scene).collect();
    let mut arrays = vec![texts(rows.iter().map(|row| row.scene.id.0.as_str()))];
    arrays.extend(state_rows::who(&rows));
    arrays.extend(state_rows::when(&rows)?);
    arrays.extend(state_rows::states(&rows));
    RecordBatch::try_new(schema().arrow(), arrays).map_err(|error| Error::invalid("recordings", error.to_string()))
}

/// The tracks of one scene, whose rows are all of `columns`.
pub(crate) fn decode(columns: &Columns<'_>, n_rows: usize, n_timesteps: usize) -> Result<Vec<Track>> {
    state_rows::decode(columns, n_rows, n_timesteps, |_, _, _| Ok(()))
}

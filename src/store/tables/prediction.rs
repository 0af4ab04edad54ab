//! The table of predictions for Argoverse: one row a track and mode, in the columns of the benchmark.

use super::columns::{number_lists, numbers, texts};
use crate::store::schema::{ColumnExt, TableSchema, column};
use crate::store::{Error, Result};
use arrow::array::RecordBatch;
use arrow::datatypes::{DataType, Field, Float64Type};
use std::sync::Arc;

/// The predicted path of one track in one mode.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct PredictionRow {
    pub(crate) scenario_id: String,
    pub(crate) track_id: String,
    pub(crate) probability: f64,
    pub(crate) x_m: Vec<f64>,
    pub(crate) y_m: Vec<f64>,
}

/// `prediction.v1`.
pub(crate) fn schema() -> TableSchema {
    let path = |name: &str, axis: &str| {
        let list = DataType::List(Arc::new(Field::new_list_field(DataType::Float64, false)));
        column(name, list, &format!("Predicted {axis} at each future timestep.")).unit("m").frame("recording")
    };
    let fields = vec![
        column("scenario_id", DataType::Utf8, "The scenario as the dataset names it; in Argoverse 1 the sequence."),
        column("track_id", DataType::Utf8, "The track as the dataset names it."),
        column("probability", DataType::Float64, "Of the mode; those of a track sum to 1.").unit("1"),
        path("predicted_trajectory_x", "x"),
        path("predicted_trajectory_y", "y"),
    ];
    let description = "Predictions in the columns of Argoverse 2's submissions: one row a track and mode.";
    TableSchema { name: "prediction", version: 1, description, fields, open: Vec::new() }
}

pub(crate) fn encode(rows: &[PredictionRow]) -> Result<RecordBatch> {
    let arrays = vec![
        texts(rows.iter().map(|row| row.scenario_id.as_str())),
        texts(rows.iter().map(|row| row.track_id.as_str())),
        numbers::<Float64Type>(rows.iter().map(|row| row.probability)),
        number_lists::<Float64Type, _>(rows.iter().map(|row| row.x_m.iter().copied())),
        number_lists::<Float64Type, _>(rows.iter().map(|row| row.y_m.iter().copied())),
    ];
    RecordBatch::try_new(schema().arrow(), arrays).map_err(|error| Error::invalid("predictions", error.to_string()))
}

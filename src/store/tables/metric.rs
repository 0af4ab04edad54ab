//! The table of metric values: one row a value, of one scene or scenario or aggregated over many.

use super::columns::{Columns, numbers, optional_numbers, optional_texts, texts};
use super::{strength_column, weight_column};
use crate::metrics::MetricRow;
use crate::scene::{GuidanceLevel, SceneId};
use crate::store::schema::{ColumnExt, TableSchema, column};
use crate::store::{Error, Result};
use arrow::array::RecordBatch;
use arrow::datatypes::{DataType, Float64Type, UInt64Type};
use std::path::Path;

/// `metric.v1`.
pub(crate) fn schema() -> TableSchema {
    let by_metric = "by metric";
    let fields = vec![
        column(
            "series",
            DataType::Utf8,
            "What was measured: recorded, constant_velocity, unguided or a sweep (`group` is a word of SQL).",
        ),
        column("sweep", DataType::Utf8, "The sweep; empty for recorded data and baselines."),
        strength_column(),
        weight_column(),
        column("place", DataType::Utf8, "The place; empty for all together."),
        column("scene_id", DataType::Utf8, "The recorded scene; missing for aggregates.").optional(),
        column(
            "scenario_id",
            DataType::Utf8,
            "The scenario; missing for aggregates and for values over all samples of a scene.",
        )
        .optional(),
        column("metric", DataType::Utf8, "The metric; its name ends in its unit where it has one."),
        column("value", DataType::Float64, "The value.").unit(by_metric),
        column("n", DataType::UInt64, "How many scenes, scenarios or samples the value is over.").unit("1"),
        column("std_error", DataType::Float64, "Standard error of the mean; missing below two values.")
            .unit(by_metric)
            .optional(),
    ];
    TableSchema { name: "metric", version: 1, description: "One row a value of a metric.", fields, open: Vec::new() }
}

pub(crate) fn encode(rows: &[MetricRow]) -> Result<RecordBatch> {
    let arrays = vec![
        texts(rows.iter().map(|row| row.group.name())),
        texts(rows.iter().map(|row| row.sweep.as_str())),
        numbers::<Float64Type>(rows.iter().map(|row| row.level.strength)),
        numbers::<Float64Type>(rows.iter().map(|row| row.level.weight)),
        texts(rows.iter().map(|row| row.place.as_str())),
        optional_texts(rows.iter().map(|row| row.scene_id.as_ref().map(|id| id.0.as_str()))),
        optional_texts(rows.iter().map(|row| row.scenario_id.as_deref())),
        texts(rows.iter().map(|row| row.metric.as_str())),
        numbers::<Float64Type>(rows.iter().map(|row| row.value)),
        numbers::<UInt64Type>(rows.iter().map(|row| row.n)),
        optional_numbers::<Float64Type>(rows.iter().map(|row| row.std_error)),
    ];
    RecordBatch::try_new(schema().arrow(), arrays).map_err(|error| Error::invalid("metrics", error.to_string()))
}

pub(crate) fn decode(batch: &RecordBatch, path: &Path) -> Result<Vec<MetricRow>> {
    let columns = Columns::of_batch(batch, path);
    let text = |name: &str, row: usize| columns.text(name, row).map(str::to_owned);
    let metric_row = |row: usize| {
        Ok(MetricRow {
            group: text("series", row)?.into(),
            sweep: text("sweep", row)?,
            level: GuidanceLevel {
                strength: columns.number::<Float64Type>("strength", row)?,
                weight: columns.number::<Float64Type>("weight", row)?,
            },
            place: text("place", row)?,
            scene_id: columns.optional_text("scene_id", row)?.map(SceneId::from),
            scenario_id: columns.optional_text("scenario_id", row)?.map(str::to_owned),
            metric: text("metric", row)?,
            value: columns.number::<Float64Type>("value", row)?,
            n: columns.number::<UInt64Type>("n", row)?,
            std_error: columns.optional_number::<Float64Type>("std_error", row)?,
        })
    };
    (0..batch.num_rows()).map(metric_row).collect()
}

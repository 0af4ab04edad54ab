//! The table of exposure: one row a recording.

use super::columns::{Columns, numbers, optional_texts, texts};
use crate::rates::{CLASSES, ExposureRow};
use crate::scene::{Dataset, Split};
use crate::store::schema::{ColumnExt, TableSchema, column};
use crate::store::{Error, Result};
use arrow::array::RecordBatch;
use arrow::datatypes::{DataType, Float64Type, UInt64Type};
use std::path::Path;

/// `exposure.v1`.
pub(crate) fn schema() -> TableSchema {
    let mut fields = vec![
        column("recording", DataType::Utf8, "The recording: scene ids without first frame, or the only scene."),
        column("dataset", DataType::Utf8, "Its dataset."),
        column("split", DataType::Utf8, "Its split."),
        column("place", DataType::Utf8, "Its place."),
        column(
            "shares_with",
            DataType::Utf8,
            "The first recording that shows some of the same moments, which count there; missing if there is none.",
        )
        .optional(),
        column("n_scenes", DataType::UInt64, "Scenes that show a part of it.").unit("1"),
        column("observed_h", DataType::Float64, "Time that scenes show, each moment once.").unit("h"),
    ];
    for class in CLASSES.map(|class| class.name()) {
        let what = class.replace('_', " ");
        fields.push(
            column(&format!("{class}_h"), DataType::Float64, &format!("Time of each {what}, added up.")).unit("h"),
        );
        fields.push(
            column(&format!("{class}_km"), DataType::Float64, &format!("Way of each {what}, added up.")).unit("km"),
        );
    }
    let description = "One row a recording: what it shows of whom, every moment once however scenes overlap, and \
                       moments that an earlier recording shows left out.";
    TableSchema { name: "exposure", version: 1, description, fields, open: Vec::new() }
}

pub(crate) fn encode(rows: &[ExposureRow]) -> Result<RecordBatch> {
    let mut arrays = vec![
        texts(rows.iter().map(|row| row.recording.as_str())),
        texts(rows.iter().map(|row| row.dataset.name())),
        texts(rows.iter().map(|row| row.split.name())),
        texts(rows.iter().map(|row| row.place.as_str())),
        optional_texts(rows.iter().map(|row| row.shares_with.as_deref())),
        numbers::<UInt64Type>(rows.iter().map(|row| row.n_scenes)),
        numbers::<Float64Type>(rows.iter().map(|row| row.observed_h)),
    ];
    for class in 0..CLASSES.len() {
        arrays.push(numbers::<Float64Type>(rows.iter().map(|row| row.class_h[class])));
        arrays.push(numbers::<Float64Type>(rows.iter().map(|row| row.class_km[class])));
    }
    RecordBatch::try_new(schema().arrow(), arrays).map_err(|error| Error::invalid("exposure", error.to_string()))
}

pub(crate) fn decode(batch: &RecordBatch, path: &Path) -> Result<Vec<ExposureRow>> {
    let columns = Columns::of_batch(batch, path);
    let row = |row: usize| {
        let by_class = |unit: &str| -> Result<[f64; CLASSES.len()]> {
            let mut values = [0.0; CLASSES.len()];
            for (value, class) in values.iter_mut().zip(CLASSES) {
                *value = columns.number::<Float64Type>(&format!("{}_{unit}", class.name()), row)?;
            }
            Ok(values)
        };
        Ok(ExposureRow {
            dataset: columns.named("dataset", row, Dataset::from_name)?,
            place: columns.text("place", row)?.to_owned(),
            split: columns.named("split", row, Split::from_name)?,
            recording: columns.text("recording", row)?.to_owned(),
            shares_with: columns.optional_text("shares_with", row)?.map(str::to_owned),
            n_scenes: columns.number::<UInt64Type>("n_scenes", row)?,
            observed_h: columns.number::<Float64Type>("observed_h", row)?,
            class_h: by_class("h")?,
            class_km: by_class("km")?,
        })
    };
    (0..batch.num_rows()).map(row).collect()
}

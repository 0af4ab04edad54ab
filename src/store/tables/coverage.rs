//! The table of coverage: one row a combination of tags, behavior and bucket.

use super::columns::{Columns, numbers, optional_numbers, optional_texts, texts};
use crate::coverage::CoverageRow;
use crate::statistics::Interval;
use crate::store::schema::{ColumnExt, TableSchema, column};
use crate::store::{Error, Result};
use arrow::array::RecordBatch;
use arrow::datatypes::{DataType, Float64Type, UInt64Type};
use std::path::Path;

/// `coverage.v1`.
pub(crate) fn schema() -> TableSchema {
    let number = |name: &str, unit: &str, description: &str| column(name, DataType::Float64, description).unit(unit);
    let n = |name: &str, description: &str| column(name, DataType::UInt64, description).unit("1");
    let fields = vec![
        column("tag", DataType::Utf8, "A tag, as attribute:value; missing for any surroundings.").optional(),
        column("and_tag", DataType::Utf8, "A second one, of another attribute.").optional(),
        column("behavior", DataType::Utf8, "The behavior."),
        column(
            "within",
            DataType::Utf8,
            "Ranges of parameters, the lower end included; empty for all events of the behavior.",
        ),
        column(
            "state",
            DataType::Utf8,
            "covered: there are accepted scenarios; missing: there are none, though it was recorded; never_recorded: \
             it never happened in such surroundings; no_such_place: no such surroundings were recorded.",
        ),
        number("observed_h", "h", "Time that was recorded in such surroundings."),
        n("n_recorded", "Recorded events, each once."),
        number("rate_per_hour", "1/h", "Recorded events an hour; missing without such surroundings.").optional(),
        number("low_per_hour", "1/h", "Lower end of its 95 % interval.").optional(),
        number("high_per_hour", "1/h", "Upper end of it; without events, what that still allows.").optional(),
        n("n_generated", "Scenarios in which the behavior was asked for and found."),
        n("n_accepted", "Those of them that were accepted."),
    ];
    TableSchema {
        name: "coverage",
        version: 1,
        description: "One row a combination of up to two tags, behavior and bucket that was recorded or generated.",
        fields,
        open: Vec::new(),
    }
}

pub(crate) fn encode(rows: &[CoverageRow]) -> Result<RecordBatch> {
    let tag = |idx: usize| -> Vec<Option<String>> {
        rows.iter().map(|row| row.tags[idx].map(|tag| tag.to_string())).collect()
    };
    let [first, second] = [0, 1].map(tag);
    let optional = |of: fn(&CoverageRow) -> Option<f64>| optional_numbers::<Float64Type>(rows.iter().map(of));
    let arrays = vec![
        optional_texts(first.iter().map(Option::as_deref)),
        optional_texts(second.iter().map(Option::as_deref)),
        texts(rows.iter().map(|row| row.behavior.as_str())),
        texts(rows.iter().map(|row| row.within.as_str())),
        texts(rows.iter().map(|row| row.state().name())),
        numbers::<Float64Type>(rows.iter().map(|row| row.observed_h)),
        numbers::<UInt64Type>(rows.iter().map(|row| row.n_recorded)),
        optional(|row| row.rate_per_hour),
        optional(|row| Some(row.per_hour?.low)),
        optional(|row| Some(row.per_hour?.high)),
        numbers::<UInt64Type>(rows.iter().map(|row| row.n_generated)),
        numbers::<UInt64Type>(rows.iter().map(|row| row.n_accepted)),
    ];
    RecordBatch::try_new(schema().arrow(), arrays).map_err(|error| Error::invalid("coverage", error.to_string()))
}

pub(crate) fn decode(batch: &RecordBatch, path: &Path) -> Result<Vec<CoverageRow>> {
    let columns = Columns::of_batch(batch, path);
    let row = |row: usize| {
        let tag = |name: &str| {
            let text = columns.optional_text(name, row)?;
            text.map(|text| text.parse().map_err(|_| Error::corrupt(path, format!("row {row}: {text} is no tag"))))
                .transpose()
        };
        let count = |name: &str| columns.number::<UInt64Type>(name, row);
        let optional = |name: &str| columns.optional_number::<Float64Type>(name, row);
        Ok(CoverageRow {
            tags: [tag("tag")?, tag("and_tag")?],
            behavior: columns.text("behavior", row)?.to_owned(),
            within: columns.text("within", row)?.to_owned(),
            observed_h: columns.number::<Float64Type>("observed_h", row)?,
            n_recorded: count("n_recorded")?,
            rate_per_hour: optional("rate_per_hour")?,
            per_hour: optional("low_per_hour")?
                .zip(optional("high_per_hour")?)
                .map(|(low, high)| Interval { low, high }),
            n_generated: count("n_generated")?,
            n_accepted: count("n_accepted")?,
        })
    };
    (0..batch.num_rows()).map(row).collect()
}

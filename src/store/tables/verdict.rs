//! The table of verdicts: one row a generated scenario.

use super::columns::{Columns, entries, flags, lists, numbers, optional_flags, optional_numbers, texts};
use super::{strength_column, weight_column};
use crate::scenario::VerdictRow;
use crate::scene::GuidanceLevel;
use crate::store::schema::{ColumnExt, TableSchema, column, list_of};
use crate::store::{Error, Result};
use arrow::array::{ListArray, RecordBatch, StringArray};
use arrow::datatypes::{DataType, Float64Type};
use std::path::Path;

/// `verdict.v1`.
pub(crate) fn schema() -> TableSchema {
    let fields = vec![
        column("scenario_id", DataType::Utf8, "The scenario, as in the samples and, if it was kept, in the corpus."),
        column("sweep", DataType::Utf8, "The sweep that it belongs to."),
        strength_column(),
        weight_column(),
        column("accepted", DataType::Boolean, "Whether it is verified, valid and no near-duplicate."),
        column("kept", DataType::Boolean, "Whether it is in the corpus."),
        column(
            "reasons",
            list_of(DataType::Utf8),
            "Why it is not accepted, the first reason first: nothing_asked or not_verified, what a request found, \
             failed checks of validity, no_cause, not_as_driven, near_duplicate; empty where it is.",
        ),
        column(
            "preventable",
            DataType::Boolean,
            "Whether the careful driver avoids any contact, as in the corpus; missing where it was not judged.",
        )
        .optional(),
        column(
            "careful_margin_s",
            DataType::Float64,
            "By how much later it could react, as in the corpus; missing where it was not judged.",
        )
        .unit("s")
        .optional(),
        column(
            "not_checked",
            list_of(DataType::Utf8),
            "The checks of validity that were not made: left out by the configuration, of motion where the dataset \
             does not allow them, offroad where there is no map or one that does not say where the road is. Missing in \
             files of version 1 and 2.",
        )
        .optional(),
    ];
    TableSchema {
        name: "verdict",
        version: 1,
        description: "One row a generated scenario: whether it is accepted, and why not.",
        fields,
        open: Vec::new(),
    }
}

pub(crate) fn encode(rows: &[VerdictRow]) -> Result<RecordBatch> {
    let reasons = texts(rows.iter().flat_map(|row| &row.reasons).map(String::as_str));
    let not_checked = texts(rows.iter().flat_map(|row| &row.not_checked).map(String::as_str));
    let arrays = vec![
        texts(rows.iter().map(|row| row.scenario_id.as_str())),
        texts(rows.iter().map(|row| row.sweep.as_str())),
        numbers::<Float64Type>(rows.iter().map(|row| row.level.strength)),
        numbers::<Float64Type>(rows.iter().map(|row| row.level.weight)),
        flags(rows.iter().map(|row| row.accepted)),
        flags(rows.iter().map(|row| row.kept)),
        lists(rows.iter().map(|row| row.reasons.len()), reasons),
        optional_flags(rows.iter().map(|row| row.preventable)),
        optional_numbers::<Float64Type>(rows.iter().map(|row| row.careful_margin_s)),
        lists(rows.iter().map(|row| row.not_checked.len()), not_checked),
    ];
    RecordBatch::try_new(schema().arrow(), arrays).map_err(|error| Error::invalid("verdicts", error.to_string()))
}

pub(crate) fn decode(batch: &RecordBatch, path: &Path) -> Result<Vec<VerdictRow>> {
    let columns = Columns::of_batch(batch, path);
    let lists_of_texts = |name: &str| {
        let list: &ListArray = columns.get(name)?;
        let texts: Option<&StringArray> = list.values().as_any().downcast_ref();
        let texts = texts.ok_or_else(|| Error::corrupt(path, format!("column {name} has lists of another type")))?;
        Ok::<_, Error>(move |row: usize| entries(list, row).map(|at| texts.value(at).to_owned()).collect::<Vec<_>>())
    };
    let (reasons, not_checked) = (lists_of_texts("reasons")?, lists_of_texts("not_checked")?);
    let verdict = |row: usize| {
        Ok(VerdictRow {
            scenario_id: columns.text("scenario_id", row)?.to_owned(),
            sweep: columns.text("sweep", row)?.to_owned(),
            level: GuidanceLevel {
                strength: columns.number::<Float64Type>("strength", row)?,
                weight: columns.number::<Float64Type>("weight", row)?,
            },
            accepted: columns.flag("accepted", row)?,
            kept: columns.flag("kept", row)?,
            reasons: reasons(row),
            preventable: columns.optional_flag("preventable", row)?,
            careful_margin_s: columns.optional_number::<Float64Type>("careful_margin_s", row)?,
            not_checked: not_checked(row),
        })
    };
    (0..batch.num_rows()).map(verdict).collect()
}

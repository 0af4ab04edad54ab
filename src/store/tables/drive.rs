//! The table of drives: one row a scenario and driver.

use super::columns::{flags, numbers, optional_flags, optional_numbers, optional_texts, texts};
use super::parameters::{self, open_columns};
use crate::scenario::DriveRow;
use crate::store::schema::{ColumnExt, TableSchema, column};
use crate::store::{Error, Result};
use arrow::array::RecordBatch;
use arrow::datatypes::{DataType, Float64Type};

/// `drive.v1`.
pub(crate) fn schema() -> TableSchema {
    let fields = vec![
        column("scenario_id", DataType::Utf8, "The scenario, as in the corpus."),
        column("behavior", DataType::Utf8, "The requested behavior; missing if none was.").optional(),
        column(
            "driver",
            DataType::Utf8,
            "Who drives the ego: planner (the command that was given), or the name of a driver: model, log, \
             constant_velocity, idm, careful.",
        ),
        column(
            "outcome",
            DataType::Utf8,
            "survived, hit, left_road, stopped_dead, timed_out, planner_failed, or not_sampled (the model had no \
             future for the others).",
        ),
        column(
            "careful_survives",
            DataType::Boolean,
            "Whether the careful driver of UN Regulation No. 157 comes through the same scenario: a failure is \
             avoidable then. Missing where the model had no future.",
        )
        .optional(),
        column("why", DataType::Utf8, "More about the end, for people.").optional(),
        column("lasted_s", DataType::Float64, "How long it was driven, from the present.").unit("s"),
        column("contact_track_id", DataType::Utf8, "Whom the ego touched.").optional(),
        column("contact_side", DataType::Utf8, "On which side of the ego: front, flank or rear.").optional(),
        column("contact_relative_mps", DataType::Float64, "The speed of one seen from the other.")
            .unit("m/s")
            .optional(),
        column("ego_min_ttc_s", DataType::Float64, "The shortest time to collision of the ego; missing without one.")
            .unit("s")
            .optional(),
        column("max_braking_mps2", DataType::Float64, "The hardest braking of the ego.").unit("m/s^2"),
        column("progress_m", DataType::Float64, "How far the ego came.").unit("m"),
        column(
            "gave_up_plan",
            DataType::Boolean,
            "Whether the other agents of the event gave their plan up because it led into the ego.",
        ),
        column(
            "event_happens",
            DataType::Boolean,
            "Whether the definition of the requested behavior, with default options, finds its event with the same \
             roles in what was driven. Missing for a scenario without an event.",
        )
        .optional(),
    ];
    TableSchema {
        name: "drive",
        version: 1,
        description: "One row a scenario and driver of its ego: how the drive ended.",
        fields,
        open: vec![open_columns()],
    }
}

pub(crate) fn encode(rows: &[DriveRow]) -> Result<RecordBatch> {
    let of_rows: Vec<_> = rows.iter().map(|row| Some(&row.parameters)).collect();
    let names = parameters::occurring(&schema(), &of_rows)?;
    let contact = |row: &DriveRow| row.contact.clone();
    let mut arrays = vec![
        texts(rows.iter().map(|row| row.scenario_id.as_str())),
        optional_texts(rows.iter().map(|row| row.behavior.as_deref())),
        texts(rows.iter().map(|row| row.driver.as_str())),
        texts(rows.iter().map(|row| row.outcome.as_str())),
        optional_flags(rows.iter().map(|row| row.careful_survives)),
        optional_texts(rows.iter().map(|row| row.why.as_deref())),
        numbers::<Float64Type>(rows.iter().map(|row| row.lasted_s)),
        optional_texts(rows.iter().map(|row| row.contact.as_ref().map(|(track, ..)| track.as_str()))),
        optional_texts(rows.iter().map(|row| row.contact.as_ref().map(|(_, side, _)| side.as_str()))),
        optional_numbers::<Float64Type>(rows.iter().map(|row| contact(row).map(|(.., mps)| mps))),
        optional_numbers::<Float64Type>(rows.iter().map(|row| row.min_ttc_s)),
        numbers::<Float64Type>(rows.iter().map(|row| row.max_braking_mps2)),
        numbers::<Float64Type>(rows.iter().map(|row| row.progress_m)),
        flags(rows.iter().map(|row| row.gave_up_plan)),
        optional_flags(rows.iter().map(|row| row.event_happens)),
    ];
    let (fields, columns): (Vec<_>, Vec<_>) = parameters::flatten(&names, &of_rows).into_iter().unzip();
    arrays.extend(columns);
    let arrow = schema().arrow_with(fields);
    RecordBatch::try_new(arrow, arrays).map_err(|error| Error::invalid("drives", error.to_string()))
}

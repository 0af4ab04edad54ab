//! The table of rates: one row a behavior, bucket, place and split.

use super::columns::{Columns, numbers, optional_numbers, optional_texts, texts};
use crate::rates::{RateMethod, RateRow};
use crate::statistics::Interval;
use crate::store::schema::{ColumnExt, TableSchema, column};
use crate::store::{Error, Result};
use arrow::array::RecordBatch;
use arrow::datatypes::{DataType, Float64Type, UInt64Type};
use std::path::Path;

/// `rate.v1`.
pub(crate) fn schema() -> TableSchema {
    let number = |name: &str, unit: &str, description: &str| column(name, DataType::Float64, description).unit(unit);
    let (per_h, per_km) = ("1/h", "1/(1000 km)");
    let fields = vec![
        column("place", DataType::Utf8, "The place; empty for all together."),
        column("split", DataType::Utf8, "The split; empty for all together."),
        column("behavior", DataType::Utf8, "The behavior."),
        column(
            "within",
            DataType::Utf8,
            "Ranges of parameters, the lower end included; empty for all events of the behavior.",
        ),
        column("n_events", DataType::UInt64, "Events, each once; of modeled rates, those of all ends of loops.")
            .unit("1"),
        column("n_recordings", DataType::UInt64, "Recordings; those that share moments count as one.").unit("1"),
        number("observed_h", "h", "Time that was recorded, or modeled, there."),
        number("motorized_km", "km", "Way of all motorized road users in it, and of those who may be."),
        number("rate_per_hour", per_h, "Events an hour at the place."),
        number("low_per_hour", per_h, "Lower end of its 95 % interval."),
        number("high_per_hour", per_h, "Upper end of it; without events, what that still allows."),
        number("rate_per_1000_km", per_km, "Events in 1,000 km of motorized road users; missing without any.")
            .optional(),
        number("low_per_1000_km", per_km, "Lower end of its 95 % interval.").optional(),
        number("high_per_1000_km", per_km, "Upper end of it.").optional(),
        number(
            "dispersion",
            "1",
            "How many times the variance of independent events the counts of recordings have, at least 1; missing for \
             a single recording.",
        )
        .optional(),
        column(
            "method",
            DataType::Utf8,
            "over_recordings: the interval allows for events that come in clusters; one_recording: it does not, for \
             one recording cannot tell; none_found: an upper end only; extrapolated: from the tail of less severe \
             events; modeled: from closed loops of the unguided model.",
        ),
        column("note", DataType::Utf8, "From where the rate is extrapolated, or why it is not.").optional(),
    ];
    TableSchema {
        name: "rate",
        version: 1,
        description: "One row a behavior, bucket, place and split: how often it was recorded, or happens in closed \
                      loops of the unguided model. Generated scenarios never count.",
        fields,
        open: Vec::new(),
    }
}

pub(crate) fn encode(rows: &[RateRow]) -> Result<RecordBatch> {
    let number = |of: fn(&RateRow) -> f64| numbers::<Float64Type>(rows.iter().map(of));
    let optional = |of: fn(&RateRow) -> Option<f64>| optional_numbers::<Float64Type>(rows.iter().map(of));
    let arrays = vec![
        texts(rows.iter().map(|row| row.place.as_str())),
        texts(rows.iter().map(|row| row.split.as_str())),
        texts(rows.iter().map(|row| row.behavior.as_str())),
        texts(rows.iter().map(|row| row.within.as_str())),
        numbers::<UInt64Type>(rows.iter().map(|row| row.n_events)),
        numbers::<UInt64Type>(rows.iter().map(|row| row.n_recordings)),
        number(|row| row.observed_h),
        number(|row| row.motorized_km),
        number(|row| row.rate_per_hour),
        number(|row| row.per_hour.low),
        number(|row| row.per_hour.high),
        optional(|row| row.rate_per_1000_km),
        optional(|row| Some(row.per_1000_km?.low)),
        optional(|row| Some(row.per_1000_km?.high)),
        optional(|row| row.dispersion),
        texts(rows.iter().map(|row| row.method.name())),
        optional_texts(rows.iter().map(|row| row.note.as_deref())),
    ];
    RecordBatch::try_new(schema().arrow(), arrays).map_err(|error| Error::invalid("rates", error.to_string()))
}

pub(crate) fn decode(batch: &RecordBatch, path: &Path) -> Result<Vec<RateRow>> {
    let columns = Columns::of_batch(batch, path);
    let row = |row: usize| {
        let text = |name: &str| columns.text(name, row).map(str::to_owned);
        let number = |name: &str| columns.number::<Float64Type>(name, row);
        let optional = |name: &str| columns.optional_number::<Float64Type>(name, row);
        Ok(RateRow {
            place: text("place")?,
            split: text("split")?,
            behavior: text("behavior")?,
            within: text("within")?,
            n_events: columns.number::<UInt64Type>("n_events", row)?,
            n_recordings: columns.number::<UInt64Type>("n_recordings", row)?,
            observed_h: number("observed_h")?,
            motorized_km: number("motorized_km")?,
            rate_per_hour: number("rate_per_hour")?,
            per_hour: Interval { low: number("low_per_hour")?, high: number("high_per_hour")? },
            rate_per_1000_km: optional("rate_per_1000_km")?,
            per_1000_km: optional("low_per_1000_km")?
                .zip(optional("high_per_1000_km")?)
                .map(|(low, high)| Interval { low, high }),
            dispersion: optional("dispersion")?,
            method: columns.named("method", row, RateMethod::from_name)?,
            note: columns.optional_text("note", row)?.map(str::to_owned),
        })
    };
    (0..batch.num_rows()).map(row).collect()
}

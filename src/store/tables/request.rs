//! The columns for the origin of a scenario within its run: the shard, and the request with its bucket.

use super::columns::{Columns, numbers, optional_numbers, optional_texts, small};
use crate::scenario::{BucketTag, RequestOutcome, RequestTag, ScenarioRecord};
use crate::store::schema::{ColumnExt, column};
use crate::store::{Error, Result};
use arrow::array::ArrayRef;
use arrow::datatypes::{DataType, Field, UInt32Type};

/// The columns, in order.
pub(crate) fn fields() -> Vec<Field> {
    vec![
        column("shard", DataType::UInt32, "The shard of the run's samples in which it was generated.").optional(),
        column(
            "request",
            DataType::Utf8,
            "The request that it was generated for; missing for scenarios of plain sweeps.",
        )
        .optional(),
        column(
            "request_outcome",
            DataType::Utf8,
            "Its outcome: accepted; surplus (its bucket was full), repeated (its bucket had enough of the same scene \
             and agents), near_duplicate (of an accepted scenario), outside (of all buckets or conditions), \
             beyond_limits, not_found.",
        )
        .optional(),
        column("bucket", DataType::UInt32, "Index of its bucket among those of the request; missing if it is in none.")
            .optional(),
        column("bucket_ranges", DataType::Utf8, "What the bucket holds, such as gap_m 0..5, relative_speed_mps -5..0.")
            .optional(),
        column("request_round", DataType::UInt32, "The round of the request in which it was generated.").optional(),
    ]
}

/// The arrays of these records, in the order of [`fields`].
pub(crate) fn encode(records: &[&ScenarioRecord]) -> Result<Vec<ArrayRef>> {
    let tags = || records.iter().map(|record| record.request.as_ref());
    let bucket = |tag: Option<&'_ RequestTag>| tag.and_then(|tag| tag.bucket.clone());
    let (mut shards, mut buckets, mut rounds) = (Vec::new(), Vec::new(), Vec::new());
    for record in records {
        let (id, tag) = (&record.scenario.id, record.request.as_ref());
        shards.push(small(id, "shard", record.shard)?);
        buckets.push(bucket(tag).map(|bucket| small(id, "bucket", bucket.idx)).transpose()?);
        rounds.push(tag.map(|tag| small(id, "round", tag.round)).transpose()?);
    }
    Ok(vec![
        numbers::<UInt32Type>(shards),
        optional_texts(tags().map(|tag| tag.map(|tag| tag.request.as_str()))),
        optional_texts(tags().map(|tag| tag.map(|tag| tag.outcome.name()))),
        optional_numbers::<UInt32Type>(buckets),
        optional_texts(tags().map(|tag| tag.and_then(|tag| tag.bucket.as_ref()).map(|bucket| bucket.ranges.as_str()))),
        optional_numbers::<UInt32Type>(rounds),
    ])
}

pub(crate) fn decode(columns: &Columns<'_>, row: usize) -> Result<(usize, Option<RequestTag>)> {
    let shard = columns.optional_number::<UInt32Type>("shard", row)?.unwrap_or_default() as usize;
    let Some(request) = columns.optional_text("request", row)? else { return Ok((shard, None)) };
    let incomplete = || Error::corrupt(columns.path, "a scenario of a request has no outcome or no round".to_owned());
    let outcome = columns.optional_text("request_outcome", row)?;
    let outcome = outcome.and_then(RequestOutcome::from_name).ok_or_else(incomplete)?;
    let round = columns.optional_number::<UInt32Type>("request_round", row)?.ok_or_else(incomplete)? as usize;
    let idx = columns.optional_number::<UInt32Type>("bucket", row)?;
    let ranges = columns.optional_text("bucket_ranges", row)?;
    let bucket = idx.zip(ranges).map(|(idx, ranges)| BucketTag { idx: idx as usize, ranges: ranges.to_owned() });
    Ok((shard, Some(RequestTag { request: request.to_owned(), round, outcome, bucket })))
}

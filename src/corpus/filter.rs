//! `djinn corpus filter`: the scenarios for which all conditions hold, of a list, or at the end of an order.

use super::condition::unknown_column;
use super::copy::{CopyOutcome, CopySelection, copy};
use super::rows::{column, texts};
use super::{Condition, Error, Result};
use crate::progress::Progress;
use crate::store::{CorpusChunk, CorpusScan, Partition};
use arrow::array::{Array, Float64Array};
use arrow::compute::cast;
use arrow::datatypes::DataType;
use std::collections::BTreeSet;
use std::path::Path;

/// The scenarios to keep.
#[derive(Debug, Clone, Default)]
pub struct FilterOptions {
    /// Conditions that must all hold.
    pub conditions: Vec<Condition>,
    /// Ids, or beginnings of ids.
    pub ids: Option<Vec<String>>,
    /// They are the first in an order.
    pub top: Option<Top>,
}

/// The scenarios with the greatest values of a column, or the least.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Top {
    /// Their number.
    pub n: usize,
    /// The column, of numbers.
    pub column: String,
    /// Whether the least values are meant.
    pub least: bool,
}

/// Writes the scenarios of the corpus in `dir` that `options` keep into a new corpus at `out`.
///
/// # Errors
/// [`Error::UnknownColumn`] and [`Error::Condition`] when a condition or an order does not fit the scenarios and
/// [`Error::Usage`] when an id does not exist, before anything is written; errors of reading and writing corpora.
pub fn filter(dir: &Path, options: &FilterOptions, out: &Path, progress: &dyn Progress) -> Result<CopyOutcome> {
    let FilterOptions { conditions, ids, top } = options;
    let scan = CorpusScan::open(dir)?;
    let schema = scan.scenario_schema()?;
    conditions.iter().try_for_each(|condition| condition.check(&schema))?;
    if conditions.is_empty() && ids.is_none() && top.is_none() {
        return Err(Error::Usage(
            "a filter needs a condition, a list of ids or an order to take the top of".to_owned(),
        ));
    }
    let mut words: Vec<String> = conditions.iter().map(ToString::to_string).collect();
    let mut listed = ids.as_ref().map(|ids| listed(&scan, ids)).transpose()?;
    words.extend(listed.as_ref().map(|ids| format!("scenario_id is one of {}", ids.len())));
    if let Some(top) = top {
        match schema.field_with_name(&top.column) {
            Ok(field) if field.data_type().is_numeric() => {}
            Ok(_) => {
                return Err(Error::Usage(format!("scenarios have no order by {}: it holds no numbers", top.column)));
            }
            Err(_) => {
                let names: Vec<&str> = schema.fields().iter().map(|field| field.name().as_str()).collect();
                return Err(unknown_column(&top.column, &names));
            }
        }
        listed = Some(first(&scan, &Kept { conditions, ids: listed.as_ref() }, top)?);
        let extreme = if top.least { "least" } else { "greatest" };
        words.push(format!("{} is one of the {} {extreme}", top.column, top.n));
    }
    let history = format!("filtered where {} from corpus {}", words.join(" and "), scan.fingerprint()?);
    copy(&[scan], out, &history, &mut Kept { conditions, ids: listed.as_ref() }, progress)
}

/// The scenarios for which all conditions hold, of a list if there is one.
struct Kept<'c> {
    conditions: &'c [Condition],
    ids: Option<&'c BTreeSet<String>>,
}

impl Kept<'_> {
    fn of(&self, chunk: &CorpusChunk) -> Result<Vec<bool>> {
        let ids = texts(&chunk.scenarios, "scenario_id", &chunk.path)?;
        let is_listed = |row: usize| self.ids.is_none_or(|listed| listed.contains(ids.value(row)));
        let mut keep: Vec<bool> = (0..chunk.len()).map(is_listed).collect();
        for condition in self.conditions {
            for (keep, holds) in keep.iter_mut().zip(condition.holds(&chunk.scenarios, &chunk.path)?) {
                *keep &= holds;
            }
        }
        Ok(keep)
    }
}

impl CopySelection for Kept<'_> {
    fn wants_part(&self, partition: &Partition) -> bool {
        self.conditions.iter().all(|condition| condition.may_hold_in(partition))
    }

    fn keep(&mut self, _input: usize, chunk: &CorpusChunk) -> Result<Vec<bool>> {
        self.of(chunk)
    }
}

/// The ids of the scenarios that a list names, by their beginnings.
fn listed(scan: &CorpusScan, wanted: &[String]) -> Result<BTreeSet<String>> {
    let mut all = BTreeSet::new();
    for chunk in scan.all_chunks(false) {
        let chunk = chunk?;
        let ids = texts(&chunk.scenarios, "scenario_id", &chunk.path)?;
        all.extend(ids.iter().flatten().map(str::to_owned));
    }
    let found = wanted.iter().map(|id| {
        let mut begin_so = all.range(id.clone()..).take_while(|known| known.starts_with(id.as_str()));
        match (begin_so.next(), begin_so.next()) {
            (Some(known), other) if other.is_none() || known == id => Ok(known.clone()),
            (Some(_), _) => Err(Error::Usage(format!("several scenarios have an id that begins with {id}"))),
            (None, _) => Err(Error::Usage(format!("{} holds no scenario {id}", scan.dir().display()))),
        }
    });
    found.collect()
}

/// The ids of the `kept` scenarios that come first in an order; scenarios without a value have no place in it.
fn first(scan: &CorpusScan, kept: &Kept<'_>, top: &Top) -> Result<BTreeSet<String>> {
    let mut order: Vec<(f64, String)> = Vec::new();
    for chunk in scan.all_chunks(false) {
        let chunk = chunk?;
        let ids = texts(&chunk.scenarios, "scenario_id", &chunk.path)?;
        let values = column(&chunk.scenarios, &top.column, &chunk.path)?;
        let values = cast(values, &DataType::Float64).map_err(Error::arrow(&chunk.path))?;
        let values: Option<&Float64Array> = values.as_any().downcast_ref();
        for (row, _) in kept.of(&chunk)?.into_iter().enumerate().filter(|(_, keep)| *keep) {
            let value = values.filter(|values| !values.is_null(row)).map(|values| values.value(row));
            if let Some(value) = value.filter(|value| !value.is_nan()) {
                order.push((if top.least { value } else { -value }, ids.value(row).to_owned()));
            }
        }
        order.sort_by(|(a, one), (b, other)| a.total_cmp(b).then_with(|| one.cmp(other)));
        order.truncate(top.n);
    }
    Ok(order.into_iter().map(|(_, id)| id).collect())
}

//! `djinn corpus sample`: a smaller corpus of the same kind, drawn at random and reproducible by its seed.

use super::condition::unknown_column;
use super::copy::{CopyOutcome, CopySelection, copy};
use super::rows::{column, texts};
use super::{Error, Result};
use crate::progress::Progress;
use crate::seed::Seed;
use crate::store::{CorpusChunk, CorpusScan, CorpusTable, Fingerprint, NO_BEHAVIOR, fingerprint};
use arrow::datatypes::DataType;
use arrow::util::display::{ArrayFormatter, FormatOptions};
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// Options of a draw.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SampleOptions {
    /// Number of scenarios.
    pub n: u64,
    /// The column whose values share the number equally, such as `behavior`; `None` draws from all scenarios alike.
    pub by: Option<String>,
    /// Seed of the draw.
    pub seed: u64,
}

/// Draws scenarios of the corpus in `dir` without replacement into a new corpus at `out`. With a column to share by,
/// each of its values gets the same number; the shortfall of values with too few scenarios goes to the others in equal
/// parts.
///
/// A scenario is drawn by its id and the seed: the draw does not depend on the order of the corpus, and a draw of more
/// scenarios from the same ones contains any draw of fewer.
///
/// # Errors
/// [`Error::UnknownColumn`] when there is no such column; errors of reading and writing corpora.
pub fn sample(dir: &Path, options: &SampleOptions, out: &Path, progress: &dyn Progress) -> Result<CopyOutcome> {
    let SampleOptions { n, by, seed } = options;
    if *n == 0 {
        return Err(Error::Usage("a sample of 0 scenarios is empty; set --n to at least 1".to_owned()));
    }
    let scan = CorpusScan::open(dir)?;
    if let Some(by) = by {
        check_column(&scan, by)?;
    }
    let strata = strata(&scan, options)?;
    let quotas = quotas(&strata.values().map(BTreeSet::len).collect::<Vec<_>>(), *n as usize);
    let chosen: BTreeSet<Fingerprint> = strata
        .values()
        .zip(quotas)
        .flat_map(|(stratum, quota)| stratum.iter().take(quota).map(|(_, id)| *id))
        .collect();
    if (chosen.len() as u64) < *n {
        progress.warn(&format!("{n} scenarios requested, but there are only {}; all of them were taken", chosen.len()));
    }
    let by = by.as_ref().map_or(String::new(), |by| format!(" by {by}"));
    let history = format!("sampled {n}{by} with seed {seed} from corpus {}", scan.fingerprint()?);
    copy(&[scan], out, &history, &mut Chosen(chosen), progress)
}

/// The column of the table, for a partition's name of it.
fn column_name(name: &str) -> &str {
    if name == "behavior" { "requested_behavior" } else { name }
}

fn check_column(scan: &CorpusScan, name: &str) -> Result<()> {
    let schema = scan.scenario_schema()?;
    match schema.field_with_name(column_name(name)).map(arrow::datatypes::Field::data_type) {
        Ok(DataType::Utf8 | DataType::Boolean) => Ok(()),
        Ok(data_type) if data_type.is_integer() => Ok(()),
        Ok(_) => Err(Error::Usage(format!("--by {name}: expected a column of text, flags or whole numbers"))),
        Err(_) => {
            let names: Vec<&str> = schema.fields().iter().map(|f| f.name().as_str()).chain(["behavior"]).collect();
            Err(unknown_column(name, &names))
        }
    }
}

/// For each value of the column, the scenarios that would be drawn first, at most as many as are drawn in total.
fn strata(scan: &CorpusScan, options: &SampleOptions) -> Result<BTreeMap<String, BTreeSet<(u64, Fingerprint)>>> {
    let by = options.by.as_deref().map(column_name);
    let mut strata: BTreeMap<String, BTreeSet<(u64, Fingerprint)>> = BTreeMap::new();
    let wanted: Vec<&str> = ["scenario_id"].into_iter().chain(by).collect();
    for file in scan.manifest().files(CorpusTable::Scenarios) {
        let path = scan.path(file);
        for batch in scan.batches(CorpusTable::Scenarios, file, Some(&wanted))? {
            let batch = batch?;
            let ids = texts(&batch, "scenario_id", &path)?;
            let options_of_text = FormatOptions::new().with_null(NO_BEHAVIOR);
            let values = match by {
                Some(by) => {
                    let values = column(&batch, by, &path)?.as_ref();
                    Some(ArrayFormatter::try_new(values, &options_of_text).map_err(Error::arrow(&path))?)
                }
                None => None,
            };
            for (row, id) in ids.iter().flatten().enumerate() {
                let stratum = values.as_ref().map_or(String::new(), |values| values.value(row).to_string());
                let stratum = strata.entry(stratum).or_default();
                stratum.insert((Seed(options.seed).derive_named("corpus sample", id).0, fingerprint(id.as_bytes())));
                if stratum.len() as u64 > options.n {
                    stratum.pop_last();
                }
            }
        }
    }
    Ok(strata)
}

/// The number to draw from each stratum: equal parts of `n`, the smallest stratum first, so that its shortfall is
/// shared by the others.
fn quotas(sizes: &[usize], n: usize) -> Vec<usize> {
    let mut order: Vec<usize> = (0..sizes.len()).collect();
    order.sort_by_key(|i| sizes[*i]);
    let (mut quotas, mut n_left) = (vec![0; sizes.len()], n);
    for (done, i) in order.iter().enumerate() {
        let share = n_left / (sizes.len() - done);
        quotas[*i] = share.min(sizes[*i]);
        n_left -= quotas[*i];
    }
    quotas
}

/// The scenarios that were drawn.
struct Chosen(BTreeSet<Fingerprint>);

impl CopySelection for Chosen {
    fn keep(&mut self, _input: usize, chunk: &CorpusChunk) -> Result<Vec<bool>> {
        let ids = texts(&chunk.scenarios, "scenario_id", &chunk.path)?;
        Ok(ids.iter().map(|id| self.0.contains(&fingerprint(id.unwrap_or_default().as_bytes()))).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_are_equal_and_shortfalls_are_shared() {
        assert_eq!(quotas(&[10, 10, 10], 9), [3, 3, 3]);
        assert_eq!(quotas(&[10, 1, 10], 9), [4, 1, 4]);
        assert_eq!(quotas(&[2, 1, 3], 9), [2, 1, 3]);
        // A remainder goes to the largest.
        assert_eq!(quotas(&[10, 9, 11], 8), [3, 2, 3]);
        assert_eq!(quotas(&[10], 4), [4]);
        assert_eq!(quotas(&[], 4), [0; 0]);
    }
}

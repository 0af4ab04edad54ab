//! `djinn corpus filter`: the scenarios for which all conditions hold.

use super::copy::{CopyOutcome, CopySelection, copy};
use super::{Condition, Error, Result};
use crate::progress::Progress;
use crate::store::{CorpusChunk, CorpusScan, Partition};
use std::path::Path;

/// Writes the scenarios of the corpus in `dir` for which all of `conditions` hold into a new corpus at `out`.
///
/// # Errors
/// [`Error::UnknownColumn`] and [`Error::Condition`] when a condition does not fit the scenarios, before anything is
/// written; those of reading and writing corpora.
pub fn filter(dir: &Path, conditions: &[Condition], out: &Path, progress: &dyn Progress) -> Result<CopyOutcome> {
    if conditions.is_empty() {
        return Err(Error::Usage("a filter needs at least one condition, such as --where \"gap_m < 5\"".to_owned()));
    }
    let scan = CorpusScan::open(dir)?;
    let schema = scan.scenario_schema()?;
    conditions.iter().try_for_each(|condition| condition.check(&schema))?;
    let texts: Vec<String> = conditions.iter().map(ToString::to_string).collect();
    let history = format!("filtered where {} from corpus {}", texts.join(" and "), scan.fingerprint()?);
    copy(&[scan], out, &history, &mut All(conditions), progress)
}

/// The scenarios for which all conditions hold.
struct All<'c>(&'c [Condition]);

impl CopySelection for All<'_> {
    fn wants_part(&self, partition: &Partition) -> bool {
        self.0.iter().all(|condition| condition.may_hold_in(partition))
    }

    fn keep(&mut self, _input: usize, chunk: &CorpusChunk) -> Result<Vec<bool>> {
        let mut keep = vec![true; chunk.len()];
        for condition in self.0 {
            for (keep, holds) in keep.iter_mut().zip(condition.holds(&chunk.scenarios, &chunk.path)?) {
                *keep &= holds;
            }
        }
        Ok(keep)
    }
}

//! `djinn corpus merge`: several corpora as one.

use super::copy::{CopyOutcome, CopySelection, copy};
use super::rows::{Content, contents, texts};
use super::{Error, Result};
use crate::progress::Progress;
use crate::store::{CorpusChunk, CorpusScan, CorpusTable, Fingerprint, fingerprint};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Writes the scenarios of all corpora in `dirs` into a new corpus at `out`. A scenario that several hold is copied
/// once.
///
/// # Errors
/// [`Error::Conflict`] when two hold different scenarios under one id, [`Error::MapConflict`] when they hold different
/// maps under one name; errors of reading and writing corpora.
pub fn merge(dirs: &[PathBuf], out: &Path, progress: &dyn Progress) -> Result<CopyOutcome> {
    if dirs.len() < 2 {
        return Err(Error::Usage("a merge needs at least two corpora".to_owned()));
    }
    let scans = dirs.iter().map(|dir| CorpusScan::open(dir)).collect::<Result<Vec<_>, _>>()?;
    let names = scans.iter().map(CorpusScan::fingerprint).collect::<Result<Vec<_>, _>>()?;
    let mut selection = Once { dirs, shared: shared(&scans)?, n_duplicates: 0 };
    let history = format!("merged from corpora {}", names.join(", "));
    let outcome = copy(&scans, out, &history, &mut selection, progress)?;
    Ok(CopyOutcome { n_duplicates: selection.n_duplicates, ..outcome })
}

/// The ids that several corpora hold.
fn shared(scans: &[CorpusScan]) -> Result<BTreeMap<Fingerprint, Option<(usize, Content)>>> {
    let mut ids: Vec<Fingerprint> = Vec::new();
    for scan in scans {
        for file in scan.manifest().files(CorpusTable::Scenarios) {
            let path = scan.path(file);
            for batch in scan.batches(CorpusTable::Scenarios, file, Some(&["scenario_id"]))? {
                let batch = batch?;
                let column = texts(&batch, "scenario_id", &path)?;
                ids.extend(column.iter().flatten().map(|id| fingerprint(id.as_bytes())));
            }
        }
    }
    ids.sort_unstable();
    Ok(ids.windows(2).filter(|pair| pair[0] == pair[1]).map(|pair| (pair[0], None)).collect())
}

/// Keeps every scenario the first time that it occurs.
struct Once<'d> {
    dirs: &'d [PathBuf],
    /// The ids that occur more than once; the first corpus and content of each, once it has occurred.
    shared: BTreeMap<Fingerprint, Option<(usize, Content)>>,
    n_duplicates: u64,
}

impl CopySelection for Once<'_> {
    fn keep(&mut self, input: usize, chunk: &CorpusChunk) -> Result<Vec<bool>> {
        let ids = texts(&chunk.scenarios, "scenario_id", &chunk.path)?;
        let hashes: Vec<Fingerprint> = ids.iter().map(|id| fingerprint(id.unwrap_or_default().as_bytes())).collect();
        let contents = contents(chunk, |row| self.shared.contains_key(&hashes[row]))?;
        let mut keep = vec![true; chunk.len()];
        for (row, content) in contents.into_iter().enumerate() {
            let (Some(content), Some(known)) = (content, self.shared.get_mut(&hashes[row])) else { continue };
            match known {
                None => *known = Some((input, content)),
                Some((_, known)) if *known == content => {
                    keep[row] = false;
                    self.n_duplicates += 1;
                }
                Some((first, _)) => {
                    let (first, second) = (self.dirs[*first].clone(), self.dirs[input].clone());
                    return Err(Error::Conflict { id: ids.value(row).to_owned(), first, second });
                }
            }
        }
        Ok(keep)
    }
}

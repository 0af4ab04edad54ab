//! `djinn corpus validate`: is a corpus whole, consistent, and possible?
//!
//! Unlike the readers, which stop at the first damage, this continues as far as it can and lists its findings.

mod files;
mod scenarios;
mod states;
#[cfg(test)]
mod tests;

use super::{Error, Result};
use crate::progress::Progress;
use crate::scene::MapId;
use crate::store::{self, CARD_FILE, CorpusScan, Fingerprint, MapSource, card};
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};
use std::io::ErrorKind;
use std::path::Path;

/// Findings of one kind that are kept; all are counted.
const MAX_PER_CHECK: u64 = 10;

/// The severity of a finding.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Severity {
    /// The corpus is not as it was written, or contradicts itself.
    Damage,
    /// Possible, but worth a look.
    Remark,
}

/// Something that is wrong, or worth a look.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Finding {
    /// Its severity.
    pub severity: Severity,
    /// The check that found it, in a word.
    pub check: &'static str,
    /// The file, within the corpus.
    pub file: String,
    /// The row of the file, from 0; `None` if it concerns the file as a whole.
    pub row: Option<u64>,
    /// The value found and the value expected.
    pub detail: String,
}

/// The checks made, and their findings.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct ValidationReport {
    /// Files that were read.
    pub n_files: u64,
    /// Rows of scenarios.
    pub n_scenarios: u64,
    /// Rows of states, generated and recorded.
    pub n_states: u64,
    /// Everything that damages the corpus.
    pub n_damages: u64,
    /// Everything that is merely worth a look.
    pub n_remarks: u64,
    /// The number of findings of each check.
    pub by_check: BTreeMap<&'static str, u64>,
    /// The first findings of each check, in the order in which they were found.
    pub findings: Vec<Finding>,
}

impl ValidationReport {
    fn add(&mut self, finding: Finding) {
        match finding.severity {
            Severity::Damage => self.n_damages += 1,
            Severity::Remark => self.n_remarks += 1,
        }
        let n = self.by_check.entry(finding.check).or_default();
        *n += 1;
        if *n <= MAX_PER_CHECK {
            self.findings.push(finding);
        }
    }

    fn damage(&mut self, check: &'static str, file: &str, row: Option<usize>, detail: impl Into<String>) {
        let (file, row, detail) = (file.to_owned(), row.map(|row| row as u64), detail.into());
        self.add(Finding { severity: Severity::Damage, check, file, row, detail });
    }

    /// Adds the damage for which a file cannot be read.
    ///
    /// # Errors
    /// On I/O errors: the file may well be whole.
    fn unreadable(&mut self, check: &'static str, file: &str, error: impl Into<Error>) -> Result<()> {
        match error.into() {
            Error::Io(io) | Error::Store(store::Error::Io(io)) if io.kind() != ErrorKind::NotFound => Err(io.into()),
            error => {
                self.damage(check, file, None, error.to_string());
                Ok(())
            }
        }
    }

    fn remark(&mut self, check: &'static str, file: &str, row: Option<usize>, detail: impl Into<String>) {
        let (file, row, detail) = (file.to_owned(), row.map(|row| row as u64), detail.into());
        self.add(Finding { severity: Severity::Remark, check, file, row, detail });
    }
}

/// Facts about all scenarios, to look the other tables up in.
#[derive(Default)]
struct Known {
    scenarios: BTreeSet<Fingerprint>,
    /// The scenes that scenarios continue, and their number of timesteps and time step.
    scenes: BTreeMap<Fingerprint, (u32, f64)>,
    lanes: BTreeMap<String, BTreeSet<i64>>,
}

/// Checks the corpus in `dir`.
///
/// # Errors
/// When there is no readable manifest: then nothing can be checked; errors of the system. Everything else is a finding.
pub fn validate(dir: &Path, progress: &dyn Progress) -> Result<ValidationReport> {
    let scan = CorpusScan::open_unverified(dir)?;
    let (mut report, mut known) = (ValidationReport::default(), Known::default());
    let readable = files::check(&scan, &mut report, progress)?;
    match scan.maps() {
        Ok(maps) => {
            for id in maps.ids() {
                match maps.map(&MapId::from(id)) {
                    Ok(graph) => {
                        let lanes = graph.lanes().iter().map(|lane| lane.id.0).collect();
                        known.lanes.insert(id.to_owned(), lanes);
                    }
                    Err(error) => report.unreadable("lanes", "lanes.parquet", error)?,
                }
            }
        }
        Err(error) => report.unreadable("lanes", "lanes.parquet", error)?,
    }
    progress.start("check", scan.manifest().n_scenarios, "scenarios");
    scenarios::check(&scan, &readable, &mut known, &mut report, progress)?;
    states::check_recordings(&scan, &readable, &known, &mut report)?;
    files::check_metrics(&scan, &readable, &known, &mut report)?;
    check_totals(&scan, &known, &mut report);
    progress.finish();
    Ok(report)
}

/// Checks that the manifest has the right counts, and that the card agrees with the manifest.
fn check_totals(scan: &CorpusScan, known: &Known, report: &mut ValidationReport) {
    let manifest = scan.manifest();
    let counts = [
        ("n_scenarios", manifest.n_scenarios, report.n_scenarios),
        ("n_maps", manifest.n_maps, known.lanes.len() as u64),
    ];
    for (name, said, found) in counts {
        if said != found {
            report.damage("counts", "manifest.json", None, format!("{name} is {said}, but there are {found}"));
        }
    }
    match fs_err::read_to_string(scan.dir().join(CARD_FILE)) {
        Ok(text) if text == card(manifest) => {}
        Ok(_) => {
            report.remark(
                "card",
                CARD_FILE,
                None,
                "it does not match the manifest; it was edited or written by another version",
            );
        }
        Err(error) => report.remark("card", CARD_FILE, None, error.to_string()),
    }
}

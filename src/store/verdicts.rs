//! `verdicts.parquet`: what became of each generated scenario, one a row.

use super::tables::verdict;
use super::{Result, VerdictRow, parquet_file};
use crate::files::FileStamp;
use std::path::Path;

/// Writes a table of verdicts, in the order given.
///
/// # Errors
/// Those of the file system.
pub fn write_verdicts(path: &Path, rows: &[VerdictRow]) -> Result<FileStamp> {
    parquet_file::write_batch(path, &verdict::schema(), &verdict::encode(rows)?)
}

/// Reads a table of verdicts, in the order it was written.
///
/// # Errors
/// [`Error::Corrupt`](super::Error::Corrupt) and [`Error::SchemaVersion`](super::Error::SchemaVersion) when the file is no
/// such table; those of the file system.
pub fn read_verdicts(path: &Path) -> Result<Vec<VerdictRow>> {
    let mut rows = Vec::new();
    for batch in parquet_file::read(path, &verdict::schema())? {
        rows.extend(verdict::decode(&batch, path)?);
    }
    Ok(rows)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::GuidanceLevel;

    #[test]
    fn reasons_stay_with_their_scenario() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("verdicts.parquet");
        let row = |id: &str, reasons: &[&str]| VerdictRow {
            scenario_id: id.to_owned(),
            sweep: "cut_ins".to_owned(),
            level: GuidanceLevel::of_strength(2.0),
            accepted: reasons.is_empty(),
            kept: reasons.len() < 2,
            reasons: reasons.iter().map(|reason| (*reason).to_owned()).collect(),
            not_checked: if id == "b" { vec!["offroad".to_owned()] } else { Vec::new() },
        };
        let rows = [row("a", &["not_verified", "jerk"]), row("b", &[]), row("c", &["near_duplicate"])];
        write_verdicts(&path, &rows).unwrap();
        assert_eq!(read_verdicts(&path).unwrap(), rows);
    }
}

//! `verdicts.parquet`: the verdict on each generated scenario.

use super::Result;
use super::row_file::{self, RowFile};
use super::tables::verdict;
use crate::files::FileStamp;
use crate::scenario::VerdictRow;
use std::path::Path;

/// Writes a table of verdicts row by row, holding one row group in memory.
pub struct VerdictWriter(RowFile<VerdictRow>);

impl VerdictWriter {
    /// Begins the table.
    pub fn create(path: &Path) -> Result<Self> {
        RowFile::create(path, &verdict::schema(), verdict::encode).map(Self)
    }

    /// Adds a verdict.
    pub fn push(&mut self, row: VerdictRow) -> Result<()> {
        self.0.push(row)
    }

    /// Finishes the table and gives the file its name.
    pub fn finish(self) -> Result<FileStamp> {
        self.0.finish()
    }
}

/// Reads a table of verdicts row by row, in the order in which it was written; few rows are in memory at a time.
///
/// # Errors
/// [`Error::Corrupt`](super::Error::Corrupt) and [`Error::SchemaVersion`](super::Error::SchemaVersion) when the file is
/// not such a table or a row is damaged; errors of the file system.
pub fn read_verdicts(path: &Path) -> Result<impl Iterator<Item = Result<VerdictRow>> + use<>> {
    row_file::read(path, &verdict::schema(), verdict::decode)
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
            preventable: (id == "b").then_some(false),
            careful_margin_s: (id == "b").then_some(-0.25),
            not_checked: if id == "b" { vec!["offroad".to_owned()] } else { Vec::new() },
        };
        let rows = [row("a", &["not_verified", "jerk"]), row("b", &[]), row("c", &["near_duplicate"])];
        let mut writer = VerdictWriter::create(&path).unwrap();
        rows.iter().try_for_each(|row| writer.push(row.clone())).unwrap();
        writer.finish().unwrap();
        assert_eq!(read_verdicts(&path).unwrap().collect::<Result<Vec<_>>>().unwrap(), rows);
    }
}

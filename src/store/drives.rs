//! `drives.parquet` and `driven.parquet`: how drives ended, and all states in them.

use super::Result;
use super::parquet_file::{ParquetFile, write_batch};
use super::tables::{drive, driven};
use crate::files::FileStamp;
use crate::scenario::DriveRow;
use crate::scene::{Roles, Scene};
use std::path::Path;

/// Writes the table of drives.
///
/// # Errors
/// On I/O errors, or if a parameter has the name of another column.
pub fn write_drives(path: &Path, rows: &[DriveRow]) -> Result<FileStamp> {
    write_batch(path, &drive::schema(), &drive::encode(rows)?)
}

/// Writes the table of driven states, drive by drive, holding one row group in memory.
pub struct DrivenWriter(ParquetFile);

impl DrivenWriter {
    /// Begins the table.
    pub fn create(path: &Path) -> Result<Self> {
        ParquetFile::create(path, &driven::schema(), driven::schema().arrow()).map(Self)
    }

    /// Adds all states of a drive with its scenario and driver, and the roles of the event; `moved_by` gives who moved
    /// an agent at a timestep.
    pub fn push(
        &mut self,
        drive: [&str; 2],
        (scene, roles): (&Scene, &Roles),
        moved_by: &dyn Fn(usize, usize) -> &'static str,
    ) -> Result<()> {
        self.0.write(&driven::encode(drive, (scene, roles), moved_by)?)
    }

    /// Finishes the table and gives the file its name.
    pub fn finish(self) -> Result<FileStamp> {
        self.0.finish()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::testing::{Drive, scene};
    use crate::store::parquet_file;
    use arrow::array::AsArray;
    use arrow::datatypes::Float64Type;

    #[test]
    fn drives_and_their_states_are_tables_with_a_column_a_parameter() {
        let dir = tempfile::tempdir().unwrap();
        let (drives, states) = (dir.path().join("drives.parquet"), dir.path().join("driven.parquet"));
        let row = |id: &str, gap_m: Option<f64>| DriveRow {
            scenario_id: id.to_owned(),
            outcome: "hit".to_owned(),
            contact: gap_m.map(|gap_m| ("7".to_owned(), "front".to_owned(), gap_m)),
            parameters: gap_m.map(|gap_m| ("gap_m".to_owned(), gap_m)).into_iter().collect(),
            ..DriveRow::default()
        };
        write_drives(&drives, &[row("a", Some(4.5)), row("b", None)]).unwrap();
        // No parameter of a known behavior has the name of another column.
        let known = drive::schema().open.into_iter().flat_map(|columns| columns.known);
        assert_eq!(known.filter(|field| drive::schema().has(field.name())).count(), 0);
        let batch = &parquet_file::read(&drives, &drive::schema()).unwrap()[0];
        let gap = batch["gap_m"].as_primitive::<Float64Type>();
        assert_eq!((gap.value(0), gap.iter().nth(1)), (4.5, Some(None)));
        assert_eq!(batch["contact_side"].as_string::<i32>().value(0), "front");

        let scene = scene(&[Drive::straight(0.0, 0.0, 0.0, 10.0), Drive::straight(9.0, 0.0, 0.0, 10.0)]);
        let mut writer = DrivenWriter::create(&states).unwrap();
        let moved_by = |agent_idx, timestep| if timestep < 4 { "scenario" } else { ["driver", "model"][agent_idx] };
        writer.push(["a", "careful"], (&scene, &Roles::from([("ego", "1")])), &moved_by).unwrap();
        writer.finish().unwrap();
        let batch = &parquet_file::read(&states, &driven::schema()).unwrap()[0];
        let roles = batch["event_role"].as_string::<i32>();
        assert_eq!([0, 23].map(|row| roles.iter().nth(row).flatten()), [Some("ego"), None]);
        let moved = batch["moved_by"].as_string::<i32>();
        let found = (batch.num_rows(), moved.value(0), moved.value(5), moved.value(23));
        assert_eq!(found, (24, "scenario", "driver", "model"));
    }
}

//! `tags.parquet` and `coverage.parquet`: what surrounds the center of each recorded scene, and what of it is covered.

use super::Result;
use super::row_file;
use super::tables::{coverage, tag};
use crate::coverage::{CoverageRow, TaggedScene};
use crate::files::FileStamp;
use std::path::Path;

/// Writes a table of tags.
pub fn write_tags(path: &Path, rows: Vec<TaggedScene>) -> Result<FileStamp> {
    row_file::write(path, &tag::schema(), tag::encode, rows.into_iter().map(Ok))
}

/// Writes a table of coverage.
pub fn write_coverage(path: &Path, rows: Vec<CoverageRow>) -> Result<FileStamp> {
    row_file::write(path, &coverage::schema(), coverage::encode, rows.into_iter().map(Ok))
}

/// Reads a table of tags.
///
/// # Errors
/// [`Error::Corrupt`](super::Error::Corrupt) and [`Error::SchemaVersion`](super::Error::SchemaVersion) when the file is
/// not such a table or a row is damaged; errors of the file system.
pub fn read_tags(path: &Path) -> Result<Vec<TaggedScene>> {
    row_file::read(path, &tag::schema(), tag::decode)?.collect()
}

/// Reads a table of coverage.
///
/// # Errors
/// See [`read_tags`].
pub fn read_coverage(path: &Path) -> Result<Vec<CoverageRow>> {
    row_file::read(path, &coverage::schema(), coverage::decode)?.collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::coverage::Tags;
    use crate::scene::testing::{Drive, scene};
    use crate::statistics::Interval;

    #[test]
    fn rows_come_back_as_they_were() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("t.parquet");
        let scene = scene(&[Drive::straight(0.0, 0.0, 0.0, 5.0)]);
        let (place, split, tags) = (scene.source.place.clone(), scene.source.split, Tags::of(&scene));
        let rows = vec![TaggedScene { scene_id: scene.id, place, split, tags, observed_h: 0.25 }];
        write_tags(&path, rows.clone()).unwrap();
        assert_eq!(read_tags(&path).unwrap(), rows);
        let [first, second, ..] = tags.each();
        let row = CoverageRow {
            tags: [Some(first), Some(second)],
            behavior: "cut_in".to_owned(),
            within: "gap_m 0..5".to_owned(),
            observed_h: 2.0,
            n_recorded: 3,
            rate_per_hour: Some(1.5),
            per_hour: Some(Interval { low: 0.5, high: 4.0 }),
            n_generated: 2,
            n_accepted: 1,
        };
        let anywhere = CoverageRow { tags: [None, None], rate_per_hour: None, per_hour: None, ..row.clone() };
        let rows = vec![row, anywhere];
        write_coverage(&path, rows.clone()).unwrap();
        assert_eq!(read_coverage(&path).unwrap(), rows);
    }
}

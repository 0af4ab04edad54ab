//! Checks that every file exists, is whole, has its schema, and that there are no others.

use super::{Known, ValidationReport};
use crate::corpus::Result;
use crate::corpus::rows::texts;
use crate::progress::Progress;
use crate::store::{CorpusScan, CorpusTable, fingerprint};
use arrow::array::{Array, Float32Array, Float64Array, RecordBatch};
use fs_err as fs;
use std::collections::BTreeSet;
use std::path::Path;

/// Checks each file by itself, and returns those that can be read.
pub(super) fn check(
    scan: &CorpusScan,
    report: &mut ValidationReport,
    progress: &dyn Progress,
) -> Result<BTreeSet<String>> {
    let manifest = scan.manifest();
    let mut readable = BTreeSet::new();
    progress.start("verify", manifest.all_files().count() as u64, "files");
    for (name, entry) in &manifest.tables {
        let Some(table) = CorpusTable::from_name(name) else {
            report.damage("manifest", "manifest.json", None, format!("it lists an unknown table {name}"));
            continue;
        };
        if entry.schema != table.schema().id() {
            let detail = format!("{name} has schema {}, expected {}", entry.schema, table.schema().id());
            report.damage("schema", "manifest.json", None, detail);
        }
        if entry.n_rows != entry.files.iter().map(|file| file.n_rows).sum::<u64>() {
            report.damage(
                "counts",
                "manifest.json",
                None,
                format!("the row counts of the files of {name} do not match their total"),
            );
        }
        for file in &entry.files {
            report.n_files += 1;
            progress.advance(1);
            if let Err(error) = scan.verify(file) {
                report.unreadable("checksum", &file.path, error)?;
            }
            match scan.n_rows(table, file) {
                Ok(n_rows) if n_rows == file.n_rows => {
                    readable.insert(file.path.clone());
                }
                Ok(n_rows) => {
                    let detail = format!("it has {n_rows} rows, but the manifest lists {}", file.n_rows);
                    report.damage("counts", &file.path, None, detail);
                    readable.insert(file.path.clone());
                }
                Err(error) => report.unreadable("schema", &file.path, error)?,
            }
        }
    }
    for table in CorpusTable::ALL {
        if manifest.files(table).is_empty() && !(table == CorpusTable::Recordings && manifest.n_recordings == 0) {
            report.damage("manifest", "manifest.json", None, format!("it lists no files of {}", table.name()));
        }
    }
    strangers(scan, report)?;
    progress.finish();
    Ok(readable)
}

/// Parquet files that the manifest does not list: queries over the folder would read them.
fn strangers(scan: &CorpusScan, report: &mut ValidationReport) -> Result<()> {
    let listed: BTreeSet<&str> = scan.manifest().all_files().map(|file| file.path.as_str()).collect();
    let mut found = Vec::new();
    parquet_files(scan.dir(), "", &mut found)?;
    found.sort();
    for file in found.into_iter().filter(|file| !listed.contains(file.as_str())) {
        report.damage(
            "stranger",
            &file,
            None,
            "the manifest does not list it, but queries over the folder would read it",
        );
    }
    Ok(())
}

fn parquet_files(dir: &Path, prefix: &str, found: &mut Vec<String>) -> Result<()> {
    for entry in fs::read_dir(dir)? {
        let entry = entry?;
        let name = format!("{prefix}{}", entry.file_name().to_string_lossy());
        if entry.file_type()?.is_dir() {
            parquet_files(&entry.path(), &format!("{name}/"), found)?;
        } else if name.ends_with(".parquet") {
            found.push(name);
        }
    }
    Ok(())
}

/// Checks that metric values are numbers and of scenarios that are there.
pub(super) fn check_metrics(
    scan: &CorpusScan,
    readable: &BTreeSet<String>,
    known: &Known,
    report: &mut ValidationReport,
) -> Result<()> {
    for file in scan.manifest().files(CorpusTable::Metrics).iter().filter(|file| readable.contains(&file.path)) {
        let path = scan.path(file);
        let mut first_row = 0;
        let checked: Result<()> = (|| {
            for batch in scan.batches(CorpusTable::Metrics, file, None)? {
                let batch = batch?;
                non_finite(&batch, &file.path, first_row, report);
                let ids = texts(&batch, "scenario_id", &path)?;
                for row in (0..batch.num_rows()).filter(|row| !ids.is_null(*row)) {
                    let id = ids.value(row);
                    if !known.scenarios.contains(&fingerprint(id.as_bytes())) {
                        report.damage(
                            "reference",
                            &file.path,
                            Some(first_row + row),
                            format!("there is no scenario {id}"),
                        );
                    }
                }
                first_row += batch.num_rows();
            }
            Ok(())
        })();
        if let Err(error) = checked {
            report.unreadable("unreadable", &file.path, error)?;
        }
    }
    Ok(())
}

/// Finds values that are NaN or infinite. Missing values are allowed.
pub(super) fn non_finite(batch: &RecordBatch, file: &str, first_row: usize, report: &mut ValidationReport) {
    for (field, column) in batch.schema_ref().fields().iter().zip(batch.columns()) {
        let any = column.as_any();
        let is_wrong = |row: usize| {
            let single = any.downcast_ref::<Float32Array>().map(|numbers| numbers.value(row).is_finite());
            let double = any.downcast_ref::<Float64Array>().map(|numbers| numbers.value(row).is_finite());
            !column.is_null(row) && single.or(double) == Some(false)
        };
        if !matches!(field.data_type(), arrow::datatypes::DataType::Float32 | arrow::datatypes::DataType::Float64) {
            continue;
        }
        for row in (0..batch.num_rows()).filter(|row| is_wrong(*row)) {
            report.damage(
                "not_a_number",
                file,
                Some(first_row + row),
                format!("{} is not a finite number", field.name()),
            );
        }
    }
}

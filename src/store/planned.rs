//! Planned states from elsewhere: a Parquet file with scenario, timestep, position and heading.

use super::parquet_file::contained;
use super::{Error, Result};
use crate::files::regular;
use crate::store::tables::columns::Columns;
use arrow::array::{Array, Float64Array, Int64Array, StringArray};
use arrow::compute::cast;
use arrow::datatypes::{DataType, Field, Schema};
use arrow::record_batch::RecordBatch;
use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

/// The columns, with any types that can be converted to these.
const COLUMNS: [(&str, DataType); 5] = [
    ("scenario_id", DataType::Utf8),
    ("timestep", DataType::Int64),
    ("x", DataType::Float64),
    ("y", DataType::Float64),
    ("heading", DataType::Float64),
];

/// The planned states of a scenario: x, y and heading by timestep.
pub type Planned = BTreeMap<usize, [f64; 3]>;

/// Reads planned states by scenario.
///
/// # Errors
/// [`Error::Unfit`] when it is no Parquet file, a column is missing, or a row lacks a value or repeats a timestep.
pub fn read_planned(path: &Path) -> Result<BTreeMap<String, Planned>> {
    if regular(path)?.is_dir() {
        return Err(unfit(path, "it is a folder, expected a Parquet file"));
    }
    read(path).map_err(|error| match error {
        Error::Corrupt { detail, .. } => unfit(path, format!("expected a whole Parquet file: {detail}")),
        error => error,
    })
}

fn unfit(path: &Path, detail: impl Into<String>) -> Error {
    Error::Unfit { path: path.to_owned(), detail: detail.into() }
}

fn read(path: &Path) -> Result<BTreeMap<String, Planned>> {
    let (file, _) = fs_err::File::open(path)?.into_parts();
    let unreadable = |error| Error::unreadable(path, error);
    let reader = contained(path, || {
        let reader = ParquetRecordBatchReaderBuilder::try_new(file).map_err(unreadable)?;
        reader.build().map_err(unreadable)
    })?;
    let mut found: BTreeMap<String, Planned> = BTreeMap::new();
    for batch in reader {
        let batch = converted(&batch.map_err(|error| Error::unreadable(path, error))?, path)?;
        let columns = Columns::of_batch(&batch, path);
        let ids: &StringArray = columns.get("scenario_id")?;
        let timesteps: &Int64Array = columns.get("timestep")?;
        let number = |name: &str| columns.get::<Float64Array>(name);
        let numbers = [number("x")?, number("y")?, number("heading")?];
        for row in 0..batch.num_rows() {
            let invalid = |why: String| unfit(path, why);
            if ids.is_null(row) || timesteps.is_null(row) || numbers.iter().any(|column| column.is_null(row)) {
                return Err(invalid(format!("row {row} of a batch lacks a value; fill it in or leave the row out")));
            }
            let (id, timestep) = (ids.value(row), timesteps.value(row));
            let at = usize::try_from(timestep)
                .map_err(|_| invalid(format!("{id} has timestep {timestep}, expected one from 0 on")))?;
            let state = numbers.map(|column| column.value(row));
            if found.entry(id.to_owned()).or_default().insert(at, state).is_some() {
                return Err(invalid(format!("{id} has timestep {timestep} twice; keep one of them")));
            }
        }
    }
    Ok(found)
}

fn converted(batch: &RecordBatch, path: &Path) -> Result<RecordBatch> {
    let fields: Vec<Field> = COLUMNS.iter().map(|(name, kind)| Field::new(*name, kind.clone(), true)).collect();
    let column = |(name, kind): &(&str, DataType)| {
        let found = batch.column_by_name(name);
        let column = found.and_then(|column| cast(column, kind).ok());
        // Numbers with a fraction would be cut off.
        if let Some((found, cut)) = found.zip(column.as_ref())
            && found.data_type().is_floating()
            && cast(cut, found.data_type()).is_ok_and(|whole| whole.as_ref() != found.as_ref())
        {
            return Err(unfit(path, format!("column {name} has numbers that are no {kind}, expected whole ones")));
        }
        let names: Vec<&str> = COLUMNS.iter().map(|(name, _)| *name).collect();
        column.ok_or_else(|| {
            let why = format!("column {name} is missing or no {kind}, expected {}", names.join(", "));
            unfit(path, why)
        })
    };
    let arrays = COLUMNS.iter().map(column).collect::<Result<Vec<_>>>()?;
    RecordBatch::try_new(Arc::new(Schema::new(fields)), arrays).map_err(|error| Error::unreadable(path, error))
}

#[cfg(test)]
mod tests {
    use super::*;
    use arrow::array::{ArrayRef, Float32Array, Int32Array};
    use parquet::arrow::ArrowWriter;

    fn written(columns: &[(&str, ArrayRef)]) -> Result<BTreeMap<String, Planned>> {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("planned.parquet");
        let batch = RecordBatch::try_from_iter(columns.to_vec()).unwrap();
        let (file, _) = fs_err::File::create(&path).unwrap().into_parts();
        let mut writer = ArrowWriter::try_new(file, batch.schema(), None).unwrap();
        writer.write(&batch).unwrap();
        writer.close().unwrap();
        read_planned(&path)
    }

    #[test]
    fn columns_of_any_number_type_are_read_and_gaps_are_named() {
        let ids: ArrayRef = Arc::new(StringArray::from(vec!["a", "b", "a"]));
        let number = |values: Vec<Option<f32>>| -> ArrayRef { Arc::new(Float32Array::from(values)) };
        let some = || number(vec![Some(1.5), Some(2.0), Some(0.0)]);
        let steps = |values: Vec<i32>| -> ArrayRef { Arc::new(Int32Array::from(values)) };
        let table = |steps: ArrayRef, x: ArrayRef| {
            [("timestep", steps), ("scenario_id", ids.clone()), ("y", some()), ("heading", some()), ("x", x)]
        };
        let found = written(&table(steps(vec![11, 10, 10]), some())).unwrap();
        assert_eq!((found["a"][&10], found["a"][&11], found["b"].len()), ([0.0; 3], [1.5; 3], 1));
        let why = |table: &[(&str, ArrayRef)]| written(table).unwrap_err().to_string();
        assert!(why(&table(steps(vec![10, 10, 10]), some())).contains("a has timestep 10 twice"));
        assert!(why(&table(steps(vec![-1, 10, 10]), some())).contains("timestep -1"));
        let fraction = why(&table(some(), some()));
        assert!(fraction.contains("column timestep has numbers that are no Int64"), "{fraction}");
        assert!(why(&table(steps(vec![1, 2, 3]), number(vec![None, Some(1.0), Some(1.0)]))).contains("lacks a value"));
        let missing = why(&table(steps(vec![1, 2, 3]), some())[..4]);
        assert!(missing.starts_with("cannot read ") && missing.contains("column x is missing"), "{missing}");
        for path in ["Cargo.toml", "src", "/dev/zero"] {
            let why = read_planned(Path::new(path)).unwrap_err().to_string();
            assert!(why.contains(path) && !why.contains("damaged"), "{why}");
        }
    }
}

//! The parameters of events, which differ by behavior: one nullable column for each that occurs, so that
//! `SELECT avg(gap_m) FROM events WHERE behavior = 'cut_in'` works.

use super::columns::{Columns, optional_numbers};
use super::parameter_descriptions::{DESCRIPTIONS, describe};
use crate::store::schema::{ColumnExt, OpenColumns, TableSchema, column, unit_of_name};
use crate::store::{Error, Result};
use arrow::array::{ArrayRef, RecordBatch};
use arrow::datatypes::{DataType, Field, Float64Type};
use std::collections::{BTreeMap, BTreeSet};

/// Parameters as events hold them.
pub(crate) type Parameters = BTreeMap<String, f64>;

/// The schema of the columns of [`flatten`].
pub(crate) fn open_columns() -> OpenColumns {
    OpenColumns {
        pattern: "<parameter>",
        data_type: DataType::Float64,
        description: "A parameter of the event, such as gap_m; its name ends in its unit; missing where the event has \
                      none of this name.",
        known: DESCRIPTIONS.iter().map(|(name, _)| field(name)).collect(),
    }
}

/// The column of a parameter.
fn field(name: &str) -> Field {
    column(name, DataType::Float64, describe(name)).unit(unit_of_name(name)).optional()
}

/// The parameters that occur in these rows.
pub(crate) fn occurring<'p>(table: &TableSchema, rows: &[Option<&'p Parameters>]) -> Result<BTreeSet<&'p str>> {
    let mut names = BTreeSet::new();
    for name in rows.iter().flatten().flat_map(|row| row.keys()) {
        // A few names recur in many rows: a tree of all occurrences would cost more than the search for the events.
        if !names.contains(name.as_str()) {
            names.insert(name.as_str());
        }
    }
    check_names(table, &names)?;
    Ok(names)
}

/// Refuses parameters that cannot be columns.
pub(crate) fn check_names(table: &TableSchema, names: &BTreeSet<&str>) -> Result<()> {
    match names.iter().find(|name| table.has(name) || name.ends_with("_track_id")) {
        Some(taken) => {
            Err(Error::invalid(taken, format!("a parameter of this name cannot be a column of {}", table.id())))
        }
        None => Ok(()),
    }
}

/// The columns of these parameters, in the order of `names`.
pub(crate) fn flatten(names: &BTreeSet<&str>, rows: &[Option<&Parameters>]) -> Vec<(Field, ArrayRef)> {
    let mut columns: Vec<(&str, Vec<Option<f64>>)> =
        names.iter().map(|name| (*name, Vec::with_capacity(rows.len()))).collect();
    for row in rows {
        // Both are in the order of names: one walk through a row fills its place in every column.
        let mut own = row.iter().flat_map(|parameters| parameters.iter()).peekable();
        for (name, values) in &mut columns {
            while own.next_if(|(other, _)| other.as_str() < *name).is_some() {}
            values.push(own.next_if(|(other, _)| other.as_str() == *name).map(|(_, value)| *value));
        }
    }
    let array = |(name, values): (&str, Vec<Option<f64>>)| (field(name), optional_numbers::<Float64Type>(values));
    columns.into_iter().map(array).collect()
}

/// The names of the parameter columns of a batch.
pub(crate) fn names<'b>(table: &TableSchema, batch: &'b RecordBatch) -> Vec<&'b str> {
    let fields = batch.schema_ref().fields().iter();
    fields
        .filter(|field| !table.has(field.name()) && *field.data_type() == DataType::Float64)
        .map(|field| field.name().as_str())
        .collect()
}

pub(crate) fn decode(columns: &Columns<'_>, names: &[&str], row: usize) -> Result<Parameters> {
    let mut parameters = Parameters::new();
    for name in names {
        if let Some(value) = columns.optional_number::<Float64Type>(name, row)? {
            parameters.insert((*name).to_owned(), value);
        }
    }
    Ok(parameters)
}

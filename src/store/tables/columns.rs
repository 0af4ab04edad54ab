//! Conversions between Arrow arrays and plain values: typed columns by name, lists by row, and the arrays of our
//! tables.

use crate::store::{Error, Result};
use arrow::array::{
    Array, ArrayRef, ArrowPrimitiveType, BooleanArray, ListArray, PrimitiveArray, RecordBatch, StringArray, StructArray,
};
use arrow::buffer::OffsetBuffer;
use arrow::datatypes::{DataType, Field, Fields};
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

/// The columns of a batch or of a struct, by name. All accessors return [`Error::Corrupt`] if a column is missing or of
/// another type, and do not panic on existing rows.
#[derive(Clone, Copy)]
pub(crate) struct Columns<'a> {
    pub(crate) path: &'a Path,
    fields: &'a Fields,
    arrays: &'a [ArrayRef],
}

impl<'a> Columns<'a> {
    /// The columns of a batch that was read from `path`.
    pub(crate) fn of_batch(batch: &'a RecordBatch, path: &'a Path) -> Self {
        Self { path, fields: batch.schema_ref().fields(), arrays: batch.columns() }
    }

    /// The columns of the structs in a list column.
    pub(crate) fn of_list(&self, name: &str) -> Result<(&'a ListArray, Self)> {
        let list: &ListArray = self.get(name)?;
        Ok((list, Self::of_struct(list.values(), self.path, name)?))
    }

    pub(crate) fn of_struct_column(&self, name: &str) -> Result<Self> {
        let array: &StructArray = self.get(name)?;
        Ok(Self { path: self.path, fields: array.fields(), arrays: array.columns() })
    }

    fn of_struct(array: &'a ArrayRef, path: &'a Path, name: &str) -> Result<Self> {
        let array: &StructArray = array
            .as_any()
            .downcast_ref()
            .ok_or_else(|| Error::corrupt(path, format!("column {name} has no structs")))?;
        Ok(Self { path, fields: array.fields(), arrays: array.columns() })
    }

    /// The column with this name and type.
    pub(crate) fn get<A: Array + 'static>(&self, name: &str) -> Result<&'a A> {
        self.fields
            .iter()
            .position(|field| field.name() == name)
            .and_then(|i| self.arrays[i].as_any().downcast_ref())
            .ok_or_else(|| Error::corrupt(self.path, format!("column {name} is missing or has another type")))
    }

    pub(crate) fn text(&self, name: &str, row: usize) -> Result<&'a str> {
        Ok(self.get::<StringArray>(name)?.value(row))
    }

    /// A text, if any.
    pub(crate) fn optional_text(&self, name: &str, row: usize) -> Result<Option<&'a str>> {
        let column: &StringArray = self.get(name)?;
        Ok((!column.is_null(row)).then(|| column.value(row)))
    }

    pub(crate) fn number<T: ArrowPrimitiveType>(&self, name: &str, row: usize) -> Result<T::Native> {
        Ok(self.get::<PrimitiveArray<T>>(name)?.value(row))
    }

    /// A number, if any.
    pub(crate) fn optional_number<T: ArrowPrimitiveType>(&self, name: &str, row: usize) -> Result<Option<T::Native>> {
        let column: &PrimitiveArray<T> = self.get(name)?;
        Ok((!column.is_null(row)).then(|| column.value(row)))
    }

    /// A truth value.
    pub(crate) fn flag(&self, name: &str, row: usize) -> Result<bool> {
        Ok(self.get::<BooleanArray>(name)?.value(row))
    }

    /// A truth value, if any.
    pub(crate) fn optional_flag(&self, name: &str, row: usize) -> Result<Option<bool>> {
        let column: &BooleanArray = self.get(name)?;
        Ok((!column.is_null(row)).then(|| column.value(row)))
    }

    /// The numbers of a list, without copying.
    pub(crate) fn numbers<T: ArrowPrimitiveType>(&self, name: &str, row: usize) -> Result<&'a [T::Native]> {
        let list: &ListArray = self.get(name)?;
        let values: &PrimitiveArray<T> = list
            .values()
            .as_any()
            .downcast_ref()
            .ok_or_else(|| Error::corrupt(self.path, format!("column {name} has lists of another type")))?;
        Ok(&values.values()[entries(list, row)])
    }

    /// The truth values of a list.
    pub(crate) fn flags(&self, name: &str, row: usize) -> Result<BooleanArray> {
        let list: &ListArray = self.get(name)?;
        let values: &BooleanArray = list
            .values()
            .as_any()
            .downcast_ref()
            .ok_or_else(|| Error::corrupt(self.path, format!("column {name} has lists of another type")))?;
        let range = entries(list, row);
        Ok(values.slice(range.start, range.len()))
    }

    /// A name that stands for one of a fixed set of values.
    pub(crate) fn named<T>(&self, name: &str, row: usize, from_name: impl Fn(&str) -> Option<T>) -> Result<T> {
        let text = self.text(name, row)?;
        from_name(text).ok_or_else(|| Error::corrupt(self.path, format!("{name} {text:?} is not known")))
    }
}

/// The range of a row's entries in the values of a list column.
pub(crate) fn entries(list: &ListArray, row: usize) -> Range<usize> {
    let offsets = list.value_offsets();
    // Offsets are validated to ascend from zero when a batch is decoded or built.
    offsets[row] as usize..offsets[row + 1] as usize
}

/// A column of texts.
pub(crate) fn texts<'t>(values: impl IntoIterator<Item = &'t str>) -> ArrayRef {
    Arc::new(StringArray::from_iter_values(values))
}

/// A column of optional texts.
pub(crate) fn optional_texts<'t>(values: impl IntoIterator<Item = Option<&'t str>>) -> ArrayRef {
    Arc::new(values.into_iter().collect::<StringArray>())
}

/// A column of numbers.
pub(crate) fn numbers<T: ArrowPrimitiveType>(values: impl IntoIterator<Item = T::Native>) -> ArrayRef {
    Arc::new(PrimitiveArray::<T>::from_iter_values(values))
}

/// A column of optional numbers.
pub(crate) fn optional_numbers<T: ArrowPrimitiveType>(values: impl IntoIterator<Item = Option<T::Native>>) -> ArrayRef {
    Arc::new(PrimitiveArray::<T>::from_iter(values))
}

/// A column of truth values.
pub(crate) fn flags(values: impl IntoIterator<Item = bool>) -> ArrayRef {
    Arc::new(BooleanArray::from(values.into_iter().collect::<Vec<_>>()))
}

/// A column of optional truth values.
pub(crate) fn optional_flags(values: impl IntoIterator<Item = Option<bool>>) -> ArrayRef {
    Arc::new(BooleanArray::from(values.into_iter().collect::<Vec<_>>()))
}

/// A column of lists: `lengths` of each row's list within `values`.
pub(crate) fn lists(lengths: impl IntoIterator<Item = usize>, values: ArrayRef) -> ArrayRef {
    let item = Arc::new(Field::new_list_field(values.data_type().clone(), false));
    Arc::new(ListArray::new(item, OffsetBuffer::from_lengths(lengths), values, None))
}

/// A column of lists of numbers.
pub(crate) fn number_lists<T: ArrowPrimitiveType, L: IntoIterator<Item = T::Native>>(
    rows: impl IntoIterator<Item = L>,
) -> ArrayRef {
    let (mut lengths, mut values) = (Vec::new(), Vec::new());
    for row in rows {
        let before = values.len();
        values.extend(row);
        lengths.push(values.len() - before);
    }
    lists(lengths, numbers::<T>(values))
}

/// A column of structs with the members of `data_type`.
pub(crate) fn structs(table: &str, data_type: &DataType, arrays: Vec<ArrayRef>) -> Result<ArrayRef> {
    let members = match data_type {
        DataType::Struct(members) => members.clone(),
        DataType::List(item) => match item.data_type() {
            DataType::Struct(members) => members.clone(),
            _ => Fields::empty(),
        },
        _ => Fields::empty(),
    };
    let array =
        StructArray::try_new(members, arrays, None).map_err(|error| Error::invalid(table, error.to_string()))?;
    Ok(Arc::new(array))
}

/// A number as an unsigned 32-bit one.
pub(crate) fn small(id: &str, what: &str, number: usize) -> Result<u32> {
    u32::try_from(number).map_err(|_| Error::invalid(id, format!("{what} {number} is too large")))
}

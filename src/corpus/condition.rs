//! Conditions on scenarios: a column, a comparison and a value, such as `gap_m < 5`; a flag may stand alone.
//!
//! As in SQL, a comparison with a missing value does not hold. `behavior` is the name of the partition: the requested
//! behavior, or `none`. For more than comparisons, choose ids by SQL.

use super::rows::{column, texts};
use super::{Error, Result};
use crate::store::{NO_BEHAVIOR, Partition};
use arrow::array::{Array, ArrayRef, BooleanArray, Datum, Scalar, StringArray};
use arrow::compute::cast;
use arrow::compute::kernels::cmp;
use arrow::datatypes::{DataType, Schema};
use arrow::error::ArrowError;
use arrow::record_batch::RecordBatch;
use std::fmt;
use std::path::Path;
use std::str::FromStr;

/// The name that partitions give to `requested_behavior`.
const BEHAVIOR: &str = "behavior";

type Compare = fn(&dyn Datum, &dyn Datum) -> Result<BooleanArray, ArrowError>;

/// Comparisons by their signs; those that are prefixes of others come after them.
const COMPARISONS: [(&str, Compare); 7] = [
    ("==", cmp::eq),
    ("!=", cmp::neq),
    ("<=", cmp::lt_eq),
    (">=", cmp::gt_eq),
    ("=", cmp::eq),
    ("<", cmp::lt),
    (">", cmp::gt),
];

/// One condition on a column of scenarios.
#[derive(Debug, Clone)]
pub struct Condition {
    text: String,
    column: String,
    compare: Compare,
    value: String,
}

impl fmt::Display for Condition {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text)
    }
}

impl FromStr for Condition {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        let text = text.trim();
        let is_name = |c: char| c.is_alphanumeric() || c == '_';
        let (column, rest) = text.split_at(text.find(|c| !is_name(c)).unwrap_or(text.len()));
        let rest = if rest.is_empty() { "= true" } else { rest.trim_start() };
        let found = COMPARISONS.iter().find_map(|(sign, compare)| Some((compare, rest.strip_prefix(sign)?.trim())));
        let unquoted = |value: &str, quote| Some(value.strip_prefix(quote)?.strip_suffix(quote)?.to_owned());
        match found.filter(|(_, value)| !value.is_empty() && !column.is_empty()) {
            Some((compare, value)) => Ok(Self {
                text: text.to_owned(),
                column: column.to_owned(),
                compare: *compare,
                value: unquoted(value, '\'').or_else(|| unquoted(value, '"')).unwrap_or_else(|| value.to_owned()),
            }),
            None => Err(Error::Condition {
                text: text.to_owned(),
                detail: "expected a column, one of =, !=, <, <=, > and >=, and a value, as in gap_m < 5, or a flag; \
                         for more, select ids by SQL and pass them by --ids"
                    .to_owned(),
            }),
        }
    }
}

impl Condition {
    /// Whether the condition fits the columns of the scenarios.
    pub(super) fn check(&self, schema: &Schema) -> Result<()> {
        let Ok(field) = schema.field_with_name(self.column()) else {
            let names: Vec<&str> =
                schema.fields().iter().map(|field| field.name().as_str()).chain([BEHAVIOR]).collect();
            return Err(unknown_column(&self.column, &names));
        };
        self.value_as(field.data_type()).map(drop)
    }

    fn value_as(&self, data_type: &DataType) -> Result<Scalar<ArrayRef>> {
        let value = match data_type.is_nested() {
            true => None,
            false => cast(&StringArray::from(vec![self.value.as_str()]), data_type).ok(),
        };
        let wanted = match data_type {
            DataType::Boolean => "true or false",
            number if number.is_numeric() => "a number",
            _ => "a text, a number or a flag",
        };
        let detail =
            || format!("{} is {:?}, but {} must be compared with {wanted}", "the value", self.value, self.column);
        let value = value.filter(|value| value.is_valid(0));
        value.map(Scalar::new).ok_or_else(|| Error::Condition { text: self.text.clone(), detail: detail() })
    }

    fn column(&self) -> &str {
        if self.column == BEHAVIOR { "requested_behavior" } else { &self.column }
    }

    /// Whether rows of a partition can satisfy it; true if the partition does not tell.
    pub(super) fn may_hold_in(&self, partition: &Partition) -> bool {
        let value = match self.column.as_str() {
            BEHAVIOR => &partition.behavior,
            "place" => &partition.place,
            _ => return true,
        };
        let holds = |value: &str| self.holds_for(&StringArray::from(vec![value]), Path::new("")).ok();
        value.as_deref().and_then(holds).is_none_or(|holds| holds[0])
    }

    /// Whether it holds for each row. The condition must have passed [`check`](Self::check).
    pub(super) fn holds(&self, batch: &RecordBatch, path: &Path) -> Result<Vec<bool>> {
        if self.column != BEHAVIOR {
            return self.holds_for(column(batch, &self.column, path)?, path);
        }
        let named = texts(batch, self.column(), path)?.iter().map(|text| text.or(Some(NO_BEHAVIOR)));
        self.holds_for(&named.collect::<StringArray>(), path)
    }

    fn holds_for(&self, values: &dyn Array, path: &Path) -> Result<Vec<bool>> {
        let value = self.value_as(values.data_type())?;
        let holds = (self.compare)(&values, &value).map_err(Error::arrow(path))?;
        Ok(holds.iter().map(|holds| holds == Some(true)).collect())
    }
}

/// The error for a column that is not there.
pub(super) fn unknown_column(name: &str, known: &[&str]) -> Error {
    let nearest = known.iter().min_by_key(|other| strsim::damerau_levenshtein(name, other));
    let hint = match nearest {
        Some(nearest) if strsim::damerau_levenshtein(name, nearest) <= 3 => format!(": did you mean {nearest}?"),
        _ => format!("; they have {}", known.join(", ")),
    };
    Error::UnknownColumn { name: name.to_owned(), hint }
}

#[cfg(test)]
mod tests {
    use super::*;
    use arrow::array::{Float64Array, UInt64Array};
    use arrow::datatypes::Field;
    use std::sync::Arc;

    fn batch() -> RecordBatch {
        let columns: [(&str, ArrayRef); 5] = [
            (
                "requested_behavior",
                Arc::new(StringArray::from(vec![Some("cut_in"), None, Some("near_miss"), Some("cut_in")])),
            ),
            ("verified", Arc::new(BooleanArray::from(vec![true, false, true, false]))),
            ("gap_m", Arc::new(Float64Array::from(vec![Some(4.5), None, Some(5.0), Some(-1.0)]))),
            ("seed", Arc::new(UInt64Array::from(vec![u64::MAX, u64::MAX - 1, 3, 4]))),
            ("place", Arc::new(StringArray::from(vec!["PIT", "São Paulo", "PIT", "a, b"]))),
        ];
        RecordBatch::try_from_iter_with_nullable(columns.map(|(name, array)| (name, array, true))).unwrap()
    }

    #[test]
    fn conditions_hold_for_the_rows_they_describe() {
        for (text, expected) in [
            ("gap_m < 5", vec![0, 3]),
            ("gap_m<=5.0", vec![0, 2, 3]),
            ("gap_m != 5", vec![0, 3]),
            ("gap_m > -1e0", vec![0, 2]),
            ("verified", vec![0, 2]),
            ("verified = false", vec![1, 3]),
            ("behavior = none", vec![1]),
            ("behavior != none", vec![0, 2, 3]),
            ("requested_behavior != cut_in", vec![2]),
            ("place = \"São Paulo\"", vec![1]),
            ("place == 'a, b'", vec![3]),
            // Both are equal as floats.
            ("seed = 18446744073709551615", vec![0]),
        ] {
            let (condition, batch) = (text.parse::<Condition>().unwrap(), batch());
            condition.check(&batch.schema()).unwrap();
            let holds = condition.holds(&batch, Path::new("scenarios")).unwrap();
            assert_eq!((0..4).filter(|row| holds[*row]).collect::<Vec<_>>(), expected, "{text}");
        }
    }

    #[test]
    fn what_does_not_fit_is_refused_with_advice() {
        let mut fields = batch().schema().fields().to_vec();
        fields.push(Arc::new(Field::new("lane_ids", DataType::new_list(DataType::Int64, false), false)));
        let schema = Schema::new(fields);
        for (text, part) in [
            ("gap < 5", "did you mean gap_m?"),
            ("temperature_of_the_sea < 5", "they have requested_behavior, verified, gap_m"),
            ("gap_m < five", "\"five\", but gap_m must be compared with a number"),
            ("gap_m", "gap_m must be compared with a number"),
            ("verified = maybe", "must be compared with true or false"),
            ("lane_ids = 5", "a text, a number or a flag"),
            ("gap_m ~ 5", "pass them by --ids"),
            ("gap_m <", "pass them by --ids"),
            ("< 5", "expected a column"),
        ] {
            let error =
                text.parse::<Condition>().and_then(|condition| condition.check(&schema)).unwrap_err().to_string();
            assert!(error.contains(part), "{text}: {error}");
        }
    }

    #[test]
    fn files_that_cannot_hold_any_are_told() {
        let partition =
            |behavior: Option<&str>| Partition { behavior: behavior.map(str::to_owned), place: Some("PIT".to_owned()) };
        let may = |text: &str, behavior| text.parse::<Condition>().unwrap().may_hold_in(&partition(behavior));
        assert!(may("behavior = cut_in", Some("cut_in")) && !may("behavior = cut_in", Some("none")));
        assert!(may("behavior = cut_in", None) && may("gap_m < 5", Some("none")) && !may("place != PIT", None));
    }
}

//! Conditions on scenarios: a column, an operator and a value, such as `gap_m < 5`.
//!
//! Operators: `=`, `!=`, `<`, `<=`, `>`, `>=` with a value; `in (a, b)`, `not in (a, b)` with a list; `is missing`,
//! `is present` without. A flag may stand alone: `verified`, `not recorded_event`. As in SQL, a comparison with a
//! missing value does not hold. `behavior` is the name of the partition: the requested behavior, or `none`.

use super::{Error, Result};
use crate::store::{NO_BEHAVIOR, Partition};
use arrow::array::{Array, ArrayRef, BooleanArray, Float64Array, RecordBatch, StringArray, UInt64Array};
use arrow::compute::cast;
use arrow::datatypes::{DataType, Schema};
use std::cmp::Ordering;
use std::fmt;
use std::path::Path;
use std::str::FromStr;

/// The name that partitions give to `requested_behavior`.
const BEHAVIOR: &str = "behavior";

/// One condition on the columns of a scenario.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Condition {
    text: String,
    column: String,
    test: Test,
}

#[derive(Debug, Clone, PartialEq, Eq)]
enum Test {
    Compare(Operator, String),
    In { negated: bool, values: Vec<String> },
    Missing(bool),
    Flag(bool),
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Operator {
    Equal,
    NotEqual,
    Less,
    LessEqual,
    Greater,
    GreaterEqual,
}

/// Operators by their signs; those that are prefixes of others come after them.
const OPERATORS: [(&str, Operator); 7] = [
    ("==", Operator::Equal),
    ("!=", Operator::NotEqual),
    ("<=", Operator::LessEqual),
    (">=", Operator::GreaterEqual),
    ("=", Operator::Equal),
    ("<", Operator::Less),
    (">", Operator::Greater),
];

impl Operator {
    fn holds(self, ordering: Option<Ordering>) -> bool {
        match self {
            Self::Equal => ordering == Some(Ordering::Equal),
            Self::NotEqual => ordering.is_some_and(|ordering| ordering != Ordering::Equal),
            Self::Less => ordering == Some(Ordering::Less),
            Self::LessEqual => ordering.is_some_and(Ordering::is_le),
            Self::Greater => ordering == Some(Ordering::Greater),
            Self::GreaterEqual => ordering.is_some_and(Ordering::is_ge),
        }
    }
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
        let wrong = |detail: &str| Error::Condition { text: text.to_owned(), detail: detail.to_owned() };
        let name_end = |text: &str| text.find(|c: char| !(c.is_alphanumeric() || c == '_')).unwrap_or(text.len());
        let (negated, rest) = match text.strip_prefix("not ") {
            Some(rest) => (true, rest.trim_start()),
            None => (false, text),
        };
        let (column, rest) = rest.split_at(name_end(rest));
        let rest = rest.trim();
        if column.is_empty() {
            return Err(wrong("begin with the name of a column, as in gap_m < 5"));
        }
        let test = if rest.is_empty() {
            Test::Flag(!negated)
        } else if negated {
            return Err(wrong("`not` stands before a flag alone, as in not recorded_event; use != or not in"));
        } else {
            parse_test(rest).ok_or_else(|| {
                wrong(
                    "after the column comes =, !=, <, <=, > or >= and a value, in (a, b), not in (a, b), is missing or \
                     is present",
                )
            })?
        };
        Ok(Self { text: text.to_owned(), column: column.to_owned(), test })
    }
}

fn parse_test(rest: &str) -> Option<Test> {
    for (words, missing) in [("is missing", true), ("is null", true), ("is present", false), ("is not null", false)] {
        if rest.eq_ignore_ascii_case(words) {
            return Some(Test::Missing(missing));
        }
    }
    for (word, negated) in [("not in", true), ("in", false)] {
        let after =
            rest.get(..word.len()).filter(|start| start.eq_ignore_ascii_case(word)).map(|_| &rest[word.len()..]);
        if let Some(list) = after.map(str::trim).and_then(|list| list.strip_prefix('(')?.strip_suffix(')')) {
            let values: Vec<String> = list.split(',').filter_map(|value| unquoted(value.trim())).collect();
            return (values.len() == list.split(',').count()).then_some(Test::In { negated, values });
        }
    }
    let (sign, operator) = OPERATORS.iter().find(|(sign, _)| rest.starts_with(sign))?;
    Some(Test::Compare(*operator, unquoted(rest[sign.len()..].trim())?))
}

/// A value without its quotes; `None` if there is none.
fn unquoted(value: &str) -> Option<String> {
    for quote in ['\'', '"'] {
        if let Some(inner) = value.strip_prefix(quote).and_then(|rest| rest.strip_suffix(quote)) {
            return Some(inner.to_owned());
        }
    }
    (!value.is_empty()).then(|| value.to_owned())
}

impl Condition {
    /// Whether the condition fits the columns of the scenarios.
    ///
    /// # Errors
    /// [`Error::UnknownColumn`] with the nearest name, [`Error::Condition`] when the value or operator does not fit the
    /// type.
    pub(super) fn check(&self, schema: &Schema) -> Result<()> {
        let column = self.column();
        let Ok(field) = schema.field_with_name(column) else {
            let names: Vec<&str> =
                schema.fields().iter().map(|field| field.name().as_str()).chain([BEHAVIOR]).collect();
            return Err(unknown_column(&self.column, &names));
        };
        let wrong = |detail: String| Error::Condition { text: self.text.clone(), detail };
        let values: Vec<&String> = match &self.test {
            Test::Missing(_) => return Ok(()),
            Test::Compare(_, value) => vec![value],
            Test::In { values, .. } => values.iter().collect(),
            Test::Flag(_) => Vec::new(),
        };
        let is_flag = *field.data_type() == DataType::Boolean;
        if matches!(self.test, Test::Flag(_)) != values.is_empty() || (values.is_empty() && !is_flag) {
            return Err(wrong(format!("{} is not a flag; compare it with a value", self.column)));
        }
        let is_order = matches!(
            &self.test,
            Test::Compare(operator, _) if !matches!(operator, Operator::Equal | Operator::NotEqual)
        );
        match field.data_type() {
            DataType::Utf8 => Ok(()),
            DataType::Boolean if is_order => {
                Err(wrong(format!("{} is a flag: true or false, not more or less", self.column)))
            }
            DataType::Boolean => match values.iter().find(|value| value.parse::<bool>().is_err()) {
                Some(value) => Err(wrong(format!("{} is true or false, not {value}", self.column))),
                None => Ok(()),
            },
            data_type if data_type.is_numeric() => {
                match values.iter().find(|value| !value.parse::<f64>().is_ok_and(f64::is_finite)) {
                    Some(value) => Err(wrong(format!("{} is a number, but {value:?} is not", self.column))),
                    None => Ok(()),
                }
            }
            _ => Err(wrong(format!("{} holds lists, which can only be missing or present", self.column))),
        }
    }

    /// The column of the table.
    pub(super) fn column(&self) -> &str {
        if self.column == BEHAVIOR { "requested_behavior" } else { &self.column }
    }

    /// Whether rows of a partition can satisfy it; true if the partition does not tell.
    pub(super) fn may_hold_in(&self, partition: &Partition) -> bool {
        let value = match self.column.as_str() {
            BEHAVIOR => &partition.behavior,
            "place" => &partition.place,
            _ => return true,
        };
        value.as_deref().is_none_or(|value| self.holds_for_text(Some(value)))
    }

    /// Whether it holds for each row. The condition must have passed [`check`](Self::check).
    pub(super) fn holds(&self, batch: &RecordBatch, path: &Path) -> Result<Vec<bool>> {
        let column = super::rows::column(batch, self.column(), path)?;
        let present = |row: usize| !column.is_null(row);
        if let Test::Missing(missing) = self.test
            && self.column != BEHAVIOR
        {
            return Ok((0..column.len()).map(|row| present(row) != missing).collect());
        }
        let any = column.as_any();
        if let Some(texts) = any.downcast_ref::<StringArray>() {
            let default = (self.column == BEHAVIOR).then_some(NO_BEHAVIOR);
            return Ok(texts.iter().map(|text| self.holds_for_text(text.or(default))).collect());
        }
        if let Some(flags) = any.downcast_ref::<BooleanArray>() {
            return Ok(flags.iter().map(|flag| self.holds_for_flag(flag)).collect());
        }
        if let Some(numbers) = any.downcast_ref::<UInt64Array>()
            && let Some(holds) = self.holds_for_exact(numbers)
        {
            return Ok(holds);
        }
        let numbers: ArrayRef = cast(column, &DataType::Float64).map_err(Error::arrow(path))?;
        let Some(numbers) = numbers.as_any().downcast_ref::<Float64Array>() else {
            return Ok(vec![false; column.len()]);
        };
        Ok(numbers.iter().map(|number| self.holds_for_number(number)).collect())
    }

    fn holds_for_text(&self, text: Option<&str>) -> bool {
        self.holds_for(text, |text, value| Some(text.cmp(value)))
    }

    fn holds_for_flag(&self, flag: Option<bool>) -> bool {
        match self.test {
            Test::Flag(expected) => flag == Some(expected),
            _ => self.holds_for(flag, |flag, value| value.parse::<bool>().ok().map(|value| flag.cmp(&value))),
        }
    }

    fn holds_for_number(&self, number: Option<f64>) -> bool {
        self.holds_for(number, |number, value| value.parse().ok().and_then(|value| number.partial_cmp(&value)))
    }

    /// Whether it holds for large whole numbers, such as seeds, which a float would round; `None` if a value is not
    /// one.
    fn holds_for_exact(&self, numbers: &UInt64Array) -> Option<Vec<bool>> {
        let values: &[String] = match &self.test {
            Test::Compare(_, value) => std::slice::from_ref(value),
            Test::In { values, .. } => values,
            _ => return None,
        };
        values.iter().all(|value| value.parse::<u64>().is_ok()).then(|| {
            let compare = |number: u64, value: &str| value.parse().ok().map(|value| number.cmp(&value));
            numbers.iter().map(|number| self.holds_for(number, compare)).collect()
        })
    }

    fn holds_for<T: Copy>(&self, found: Option<T>, compare: impl Fn(T, &str) -> Option<Ordering>) -> bool {
        match (&self.test, found) {
            (Test::Missing(missing), found) => found.is_none() == *missing,
            (_, None) | (Test::Flag(_), _) => false,
            (Test::Compare(operator, value), Some(found)) => operator.holds(compare(found, value)),
            (Test::In { negated, values }, Some(found)) => {
                values.iter().any(|value| compare(found, value) == Some(Ordering::Equal)) != *negated
            }
        }
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

    fn rows(text: &str) -> Vec<usize> {
        let (condition, batch) = (text.parse::<Condition>().unwrap(), batch());
        condition.check(&batch.schema()).unwrap();
        let holds = condition.holds(&batch, Path::new("scenarios")).unwrap();
        (0..4).filter(|row| holds[*row]).collect()
    }

    #[test]
    fn conditions_hold_for_the_rows_they_describe() {
        for (text, expected) in [
            ("gap_m < 5", vec![0, 3]),
            ("gap_m<=5.0", vec![0, 2, 3]),
            ("gap_m != 5", vec![0, 3]),
            ("gap_m > -1e0", vec![0, 2]),
            ("gap_m is missing", vec![1]),
            ("gap_m is present", vec![0, 2, 3]),
            ("verified", vec![0, 2]),
            ("not verified", vec![1, 3]),
            ("verified = false", vec![1, 3]),
            ("behavior = none", vec![1]),
            ("behavior != none", vec![0, 2, 3]),
            ("behavior is present", vec![0, 1, 2, 3]),
            ("requested_behavior != cut_in", vec![2]),
            ("behavior in (none, 'near_miss')", vec![1, 2]),
            ("behavior not in (none, near_miss)", vec![0, 3]),
            ("place = \"São Paulo\"", vec![1]),
            ("place = 'a, b'", vec![3]),
            // Both are equal as floats.
            ("seed = 18446744073709551615", vec![0]),
            ("seed in (3, 4)", vec![2, 3]),
            ("seed < 3.5", vec![2]),
        ] {
            assert_eq!(rows(text), expected, "{text}");
        }
    }

    #[test]
    fn what_does_not_fit_is_refused_with_advice() {
        let refused = |text: &str| match text.parse::<Condition>() {
            Ok(condition) => condition.check(&batch().schema()).unwrap_err().to_string(),
            Err(error) => error.to_string(),
        };
        for (text, part) in [
            ("gap < 5", "did you mean gap_m?"),
            ("temperature_of_the_sea < 5", "they have requested_behavior, verified, gap_m"),
            ("gap_m < five", "gap_m is a number, but \"five\" is not"),
            ("gap_m < nan", "is not"),
            ("gap_m", "is not a flag"),
            ("verified > false", "not more or less"),
            ("verified = yes", "true or false, not yes"),
            ("gap_m ~ 5", "after the column comes"),
            ("gap_m in 5, 6", "after the column comes"),
            ("gap_m <", "after the column comes"),
            ("< 5", "begin with the name of a column"),
            ("not gap_m < 5", "use != or not in"),
        ] {
            let error = refused(text);
            assert!(error.contains(part), "{text}: {error}");
        }
        let lists = Schema::new(vec![Field::new("lane_ids", DataType::new_list(DataType::Int64, false), false)]);
        let error = "lane_ids = 5".parse::<Condition>().unwrap().check(&lists).unwrap_err().to_string();
        assert!(error.contains("holds lists"), "{error}");
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

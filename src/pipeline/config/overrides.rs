//! The effect of `--set a.b.c=value` on a parsed configuration.

use crate::settings::Unreadable;
use std::ops::Range;
use toml::Spanned;
use toml::de::{DeArray, DeString, DeTable, DeValue};

/// The deepest setting has fewer parts; tables of greater depth would exhaust the stack.
const MAX_PARTS: usize = 32;

/// One `key=value` given on the command line.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Override {
    /// The key's parts, outermost first.
    key: Vec<String>,
    /// The value as written.
    value: String,
}

impl Override {
    /// Reads `generate.sweeps.0.n_samples=2`. The error tells what is wrong with the text.
    pub fn parse(text: &str) -> Result<Self, Unreadable> {
        let (key, value) = text.split_once('=').ok_or("missing `=`; write key=value")?;
        let key: Vec<String> = key.split('.').map(|part| part.trim().to_owned()).collect();
        if key.iter().any(String::is_empty) {
            return Err("its key has an empty part".into());
        }
        if key.len() > MAX_PARTS {
            return Err(format!("its key has {} parts, expected at most {MAX_PARTS}", key.len()).into());
        }
        Ok(Self { key, value: value.trim().to_owned() })
    }

    /// Sets the value in `table`, creating missing tables. Everything it adds gets `span`, so that a later error about
    /// it can be distinguished from one about the file.
    pub fn apply<'i>(&'i self, table: &mut DeTable<'i>, span: &Range<usize>) -> Result<(), Unreadable> {
        let (last, parents) = self.key.split_last().ok_or("its key is empty")?;
        let mut place = Container::Table(table);
        for part in parents {
            place = place.enter(part, span)?;
        }
        // A value that is not TOML is taken as text, so that strings need no quotes: `--set run.name=night`. So is a
        // date, as no setting is one.
        let text = || DeValue::String(DeString::Borrowed(&self.value));
        let value = match DeValue::parse(&self.value).map(Spanned::into_inner) {
            Err(_) | Ok(DeValue::Datetime(_)) => text(),
            Ok(value) => value,
        };
        place.set(last, relocate(value, span), span)
    }
}

/// Somewhere in a parsed configuration that can hold values.
enum Container<'t, 'i> {
    Table(&'t mut DeTable<'i>),
    Array(&'t mut DeArray<'i>),
}

impl<'i> Container<'_, 'i> {
    fn enter(self, part: &'i str, span: &Range<usize>) -> Result<Self, Unreadable> {
        let value = match self {
            Container::Table(table) => table
                .entry(spanned_key(part, span))
                .or_insert_with(|| Spanned::new(span.clone(), DeValue::Table(DeTable::new())))
                .get_mut(),
            Container::Array(array) => element(array, part)?.get_mut(),
        };
        match value {
            DeValue::Table(table) => Ok(Container::Table(table)),
            DeValue::Array(array) => Ok(Container::Array(array)),
            _ => Err(format!("`{part}` is a value, not a table").into()),
        }
    }

    fn set(self, part: &'i str, value: Spanned<DeValue<'i>>, span: &Range<usize>) -> Result<(), Unreadable> {
        match self {
            Container::Table(table) => {
                // The old key is removed first: inserting alone would keep its place in the file.
                table.remove(part);
                table.insert(spanned_key(part, span), value);
            }
            Container::Array(array) => *element(array, part)? = value,
        }
        Ok(())
    }
}

fn spanned_key<'i>(part: &'i str, span: &Range<usize>) -> Spanned<DeString<'i>> {
    Spanned::new(span.clone(), DeString::Borrowed(part))
}

fn element<'t, 'i>(array: &'t mut DeArray<'i>, part: &str) -> Result<&'t mut Spanned<DeValue<'i>>, Unreadable> {
    let n_elements = array.len();
    let idx: usize = part.parse().map_err(|_| format!("`{part}` is not an array index"))?;
    Ok(array.get_mut(idx).ok_or_else(|| format!("index {idx} is out of range for an array of {n_elements}"))?)
}

/// Gives a value and everything in it one span.
fn relocate<'i>(value: DeValue<'i>, span: &Range<usize>) -> Spanned<DeValue<'i>> {
    let value = match value {
        DeValue::Array(array) => {
            DeValue::Array(array.into_iter().map(|item| relocate(item.into_inner(), span)).collect())
        }
        DeValue::Table(table) => DeValue::Table(
            table
                .into_iter()
                .map(|(name, item)| (Spanned::new(span.clone(), name.into_inner()), relocate(item.into_inner(), span)))
                .collect(),
        ),
        plain => plain,
    };
    Spanned::new(span.clone(), value)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn applied(text: &str, written: &str) -> Result<toml::Table, Unreadable> {
        let parsed = Override::parse(written)?;
        let mut table = DeTable::parse(text).unwrap().into_inner();
        parsed.apply(&mut table, &(0..0))?;
        let deserializer = toml::de::Deserializer::from(Spanned::new(0..0, table));
        Ok(serde::Deserialize::deserialize(deserializer).unwrap())
    }

    #[test]
    fn tables_are_made_and_array_elements_are_reached() {
        let table = applied("", "a.b.c=[1, 2]").unwrap();
        assert_eq!(table["a"]["b"]["c"].as_array().unwrap().len(), 2);
        let table = applied("[[a.list]]\nn = 1\n[[a.list]]\nn = 2\n", "a.list.1.n=5").unwrap();
        let found = (table["a"]["list"][0]["n"].as_integer(), table["a"]["list"][1]["n"].as_integer());
        assert_eq!(found, (Some(1), Some(5)));
        let table = applied("", "behaviors=[{ kind = \"cut_in\" }]").unwrap();
        assert_eq!(table["behaviors"][0]["kind"].as_str(), Some("cut_in"));
    }

    #[test]
    fn impossible_places_are_refused() {
        assert!(applied("a = [1]", "a.1=2").unwrap_err().0.contains("out of range for an array of 1"));
        assert!(applied("a = [1]", "a.x=2").unwrap_err().0.contains("not an array index"));
        assert!(applied("a = 1", "a.x=2").unwrap_err().0.contains("is a value"));
        assert!(applied("", "a..x=2").unwrap_err().0.contains("empty part"));
        let deep = format!("{}=1", vec!["a"; 30_000].join("."));
        assert!(applied("", &deep).unwrap_err().0.contains("30000 parts, expected at most 32"));
        assert!(applied("", &format!("{}=1", vec!["a"; 32].join("."))).is_ok());
    }
}

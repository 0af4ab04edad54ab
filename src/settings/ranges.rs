//! Checks that every number is in the range of its JSON schema.
//!
//! One statement serves editors, readers and this check. It handles the parts of JSON Schema that our types use:
//! references, properties, items, alternatives, the bounds of numbers, and lists without repetitions.

use super::{Issue, Result, distinct, in_words};
use schemars::JsonSchema;
use serde::Serialize;
use serde_json::Value as Schema;
use std::collections::BTreeMap;
use std::fmt::Display;
use toml::Spanned;
use toml::de::{DeArray, DeTable, DeValue};

/// The keywords that bound a number.
const BOUNDS: [&str; 5] = ["minimum", "exclusiveMinimum", "maximum", "exclusiveMaximum", "multipleOf"];

/// The key of the checked value within the checked text.
const SECTION: &str = "section";

/// Refuses settings with a number that is NaN or outside the range in the type's schema. A number with a range is
/// finite.
///
/// # Errors
/// The first such setting with the range; an error if they cannot be written as TOML.
pub fn check_ranges<T: Serialize + JsonSchema>(settings: &T) -> Result {
    let schema = schemars::schema_for!(T).to_value();
    // The text can hold values that TOML cannot: whole numbers of 2^63 and more.
    let unwritable = |error: &dyn Display| Issue::new("a setting", format_args!("cannot be written as TOML: {error}"));
    let text = toml::to_string(&BTreeMap::from([(SECTION, settings)])).map_err(|error| unwritable(&error))?;
    let table = DeTable::parse(&text).map_err(|error| unwritable(&error))?;
    let section = table.get_ref().get(SECTION).map(Spanned::get_ref);
    section.map_or(Ok(()), |section| {
        check_no_nan(section, "")?;
        Walk { root: &schema }.check(&schema, section, "")
    })
}

/// Refuses NaN under any schema: it is meaningless in every setting.
fn check_no_nan(value: &DeValue<'_>, key: &str) -> Result {
    match value {
        DeValue::Float(number) if float(number.as_str()).is_nan() => Err(Issue::new(key, "is NaN, expected a number")),
        DeValue::Array(items) => {
            items.iter().enumerate().try_for_each(|(i, item)| check_no_nan(item.get_ref(), &below(key, i)))
        }
        DeValue::Table(table) => {
            table.iter().try_for_each(|(name, entry)| check_no_nan(entry.get_ref(), &below(key, name.get_ref())))
        }
        _ => Ok(()),
    }
}

/// A number as it is written; NaN for anything else.
fn float(text: &str) -> f64 {
    text.parse().unwrap_or(f64::NAN)
}

fn below(key: &str, part: impl Display) -> String {
    if key.is_empty() { part.to_string() } else { format!("{key}.{part}") }
}

struct Walk<'a> {
    root: &'a Schema,
}

impl Walk<'_> {
    fn check(&self, schema: &Schema, value: &DeValue<'_>, key: &str) -> Result {
        if let Some(referred) = self.referred(schema) {
            self.check(referred, value, key)?;
        }
        let every = schema["allOf"].as_array().into_iter().flatten();
        every.into_iter().try_for_each(|part| self.check(part, value, key))?;
        for alternatives in ["oneOf", "anyOf"] {
            let mut listed = schema[alternatives].as_array().into_iter().flatten();
            if let Some(chosen) = listed.find(|schema| self.fits(schema, value)) {
                self.check(chosen, value, key)?;
            }
        }
        match value {
            DeValue::Integer(number) => check_number(schema, float(number.as_str()), number.as_str(), key),
            DeValue::Float(number) => {
                let number = float(number.as_str());
                check_number(schema, number, &in_words(number), key)
            }
            DeValue::Array(items) => {
                check_unique(schema, items, key)?;
                items
                    .iter()
                    .enumerate()
                    .try_for_each(|(i, item)| self.check(&schema["items"], item.get_ref(), &below(key, i)))
            }
            DeValue::Table(table) => table.iter().try_for_each(|(name, entry)| {
                let name = name.get_ref().as_ref();
                let known = &schema["properties"][name];
                let schema = if known.is_null() { &schema["additionalProperties"] } else { known };
                self.check(schema, entry.get_ref(), &below(key, name))
            }),
            DeValue::String(_) | DeValue::Boolean(_) | DeValue::Datetime(_) => Ok(()),
        }
    }

    fn referred<'s>(&'s self, schema: &'s Schema) -> Option<&'s Schema> {
        self.root.pointer(schema["$ref"].as_str()?.strip_prefix('#')?)
    }

    /// Whether a value is meant as an alternative: it has that type, and the constants of the alternative.
    fn fits(&self, schema: &Schema, value: &DeValue<'_>) -> bool {
        let fits_referred = self.referred(schema).is_none_or(|referred| self.fits(referred, value));
        let type_name = match value {
            DeValue::Integer(_) => "integer",
            DeValue::Float(_) => "number",
            DeValue::Array(_) => "array",
            DeValue::Table(_) => "object",
            DeValue::Boolean(_) => "boolean",
            DeValue::String(_) | DeValue::Datetime(_) => "string",
        };
        let fits_one = |alternatives: &str| {
            let listed = schema[alternatives].as_array();
            listed.is_none_or(|listed| listed.iter().any(|schema| self.fits(schema, value)))
        };
        let is_such = |found: &Schema| {
            found.as_str().is_some_and(|name| name == type_name || (name == "number" && type_name == "integer"))
        };
        let types = &schema["type"];
        let is_of_type =
            types.is_null() || is_such(types) || types.as_array().is_some_and(|all| all.iter().any(is_such));
        let is_constant = schema["const"].is_null() || schema["const"].as_str() == text_of(value);
        let says_so = schema["properties"].as_object().is_none_or(|properties| {
            let required = schema["required"].as_array().into_iter().flatten().filter_map(Schema::as_str);
            let constant = properties.iter().filter_map(|(name, property)| Some((name, property["const"].as_str()?)));
            required.into_iter().all(|name| entry_of(value, name).is_some())
                && constant.into_iter().all(|(name, text)| entry_of(value, name).and_then(text_of) == Some(text))
        });
        fits_referred && fits_one("oneOf") && fits_one("anyOf") && is_of_type && is_constant && says_so
    }
}

fn text_of<'v>(value: &'v DeValue<'_>) -> Option<&'v str> {
    if let DeValue::String(text) = value { Some(text) } else { None }
}

fn entry_of<'v, 'i>(value: &'v DeValue<'i>, name: &str) -> Option<&'v DeValue<'i>> {
    if let DeValue::Table(table) = value { table.get(name).map(Spanned::get_ref) } else { None }
}

/// Refuses a text that occurs twice in a list without repetitions.
fn check_unique(schema: &Schema, items: &DeArray<'_>, key: &str) -> Result {
    let texts: Vec<&str> = items.iter().filter_map(|item| text_of(item.get_ref())).collect();
    if schema["uniqueItems"] == true { distinct(key, &texts) } else { Ok(()) }
}

fn check_number(schema: &Schema, number: f64, written: &str, key: &str) -> Result {
    let bound = |name: &str| schema[name].as_f64();
    if BOUNDS.iter().all(|name| bound(name).is_none()) {
        return Ok(());
    }
    let is_within = number.is_finite()
        && bound("minimum").is_none_or(|least| number >= least)
        && bound("exclusiveMinimum").is_none_or(|limit| number > limit)
        && bound("maximum").is_none_or(|most| number <= most)
        && bound("exclusiveMaximum").is_none_or(|limit| number < limit)
        && bound("multipleOf").is_none_or(|divisor| number % divisor == 0.0);
    match is_within {
        true => Ok(()),
        false => Err(Issue::new(key, format_args!("is {written}, expected {}", range_in_words(schema)))),
    }
}

/// The range of a number, to be read after "expected".
fn range_in_words(schema: &Schema) -> String {
    let bound = |name: &str| schema[name].as_f64();
    let low = bound("minimum").map(|least| (least, true)).or(bound("exclusiveMinimum").map(|limit| (limit, false)));
    let high = bound("maximum").map(|most| (most, true)).or(bound("exclusiveMaximum").map(|limit| (limit, false)));
    let range = match (low, high) {
        (Some((low, true)), Some((high, true))) => format!("{low} to {high}"),
        (Some((low, true)), Some((high, false))) => format!("{low} up to below {high}"),
        (Some((low, false)), Some((high, true))) => format!("more than {low} and at most {high}"),
        (Some((low, false)), Some((high, false))) => format!("more than {low} and less than {high}"),
        (Some((low, true)), None) => format!("a number of at least {low}"),
        (Some((0.0, false)), None) => "a positive number".to_owned(),
        (Some((low, false)), None) => format!("a number beyond {low}"),
        (None, Some((high, _))) => format!("at most {high}"),
        (None, None) => "a number".to_owned(),
    };
    match bound("multipleOf") {
        Some(divisor) => format!("{range}, a multiple of {divisor}"),
        None => range,
    }
}

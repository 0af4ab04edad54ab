//! Refuses values of kinds that settings do not have, before they are read as something else: TOML's dates, which the
//! parser passes on as tables, and lists in place of tables, whose items would become the settings of the table in
//! their order.

use super::PipelineConfig;
use crate::settings::Issue;
use serde_json::Value as Schema;
use std::fmt::Display;
use toml::de::{DeTable, DeValue};

/// Refuses the first such value.
pub(super) fn check_kinds(table: &DeTable<'_>) -> Result<(), Issue> {
    let root = schemars::schema_for!(PipelineConfig).to_value();
    Kinds { root: &root }.check_table(&[&root], table, "")
}

struct Kinds<'a> {
    root: &'a Schema,
}

impl<'a> Kinds<'a> {
    fn check_table(&self, schemas: &[&'a Schema], table: &DeTable<'_>, key: &str) -> Result<(), Issue> {
        table.iter().try_for_each(|(name, value)| {
            let name = name.get_ref().as_ref();
            let of = |schema: &&'a Schema| match &schema["properties"][name] {
                Schema::Null => &schema["additionalProperties"],
                property => property,
            };
            let schemas: Vec<&Schema> = schemas.iter().map(of).collect();
            self.check(&schemas, value.get_ref(), &below(key, name))
        })
    }

    fn check(&self, schemas: &[&'a Schema], value: &DeValue<'_>, key: &str) -> Result<(), Issue> {
        let schemas: Vec<&Schema> = schemas.iter().flat_map(|schema| self.alternatives(schema)).collect();
        match value {
            DeValue::Datetime(date) => {
                let message = format!("is the date {date}, and no setting is a date; a text needs quotes: \"{date}\"");
                Err(Issue::new(key, message))
            }
            DeValue::Array(_) if !schemas.is_empty() && schemas.iter().all(|schema| schema["type"] == "object") => {
                Err(Issue::new(key, "is a list, expected a table"))
            }
            DeValue::Array(items) => {
                let schemas: Vec<&Schema> = schemas.iter().map(|schema| &schema["items"]).collect();
                let mut items = items.iter().enumerate();
                items.try_for_each(|(idx, item)| self.check(&schemas, item.get_ref(), &below(key, idx)))
            }
            DeValue::Table(table) => self.check_table(&schemas, table, key),
            _ => Ok(()),
        }
    }

    /// The alternatives that a schema allows, without references and null; empty if it does not restrict the value.
    fn alternatives(&self, schema: &'a Schema) -> Vec<&'a Schema> {
        let referred = schema["$ref"].as_str().and_then(|name| self.root.pointer(name.strip_prefix('#')?));
        let listed = ["oneOf", "anyOf", "allOf"].iter().filter_map(|name| schema[name].as_array()).flatten();
        let own = Some(schema).filter(|schema| !schema["type"].is_null() && schema["type"] != "null");
        let others = referred.into_iter().chain(listed).flat_map(|schema| self.alternatives(schema));
        own.into_iter().chain(others).collect()
    }
}

fn below(key: &str, part: impl Display) -> String {
    if key.is_empty() { part.to_string() } else { format!("{key}.{part}") }
}

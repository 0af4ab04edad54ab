//! `djinn list`: the names that pipelines, commands and tables can use, and what they mean.

use crate::cli::args::Listed;
use crate::cli::printer::Printer;
use crate::engine::Result;
use crate::export::ExportFormat;
use crate::guidance::ObjectiveKind;
use crate::scene::Dataset;
use crate::{behavior, metrics};
use schemars::{Schema, schema_for};
use serde_json::Value;

pub(in crate::cli) fn list(what: Listed, printer: &Printer) -> Result<()> {
    let rows: Vec<(String, String)> = match what {
        Listed::Behaviors => described(behavior::ALL.iter().map(|entry| (entry.id, entry.description))),
        Listed::Objectives => of_schema(&schema_for!(ObjectiveKind)),
        Listed::Datasets => of_schema(&schema_for!(Dataset)),
        Listed::Formats => described(ExportFormat::ALL.iter().map(|format| (format.name(), format.description()))),
        Listed::Metrics => described(metrics::ALL.iter().map(|metric| (metric.spec().id, metric.spec().description))),
    };
    let width = rows.iter().map(|(name, _)| name.len()).max().unwrap_or_default();
    printer.data(&rows.iter().map(|(name, text)| format!("{name:width$}  {text}\n")).collect::<String>())
}

fn described<'a>(rows: impl Iterator<Item = (&'a str, &'a str)>) -> Vec<(String, String)> {
    rows.map(|(name, text)| (name.to_owned(), text.to_owned())).collect()
}

/// The variants of an enum, each with the first sentence of its docstring, taken from its schema.
fn of_schema(schema: &Schema) -> Vec<(String, String)> {
    let variants = schema.get("oneOf").and_then(Value::as_array).map(Vec::as_slice).unwrap_or_default();
    let row = |variant: &Value| {
        let name = variant.get("const").or_else(|| variant.pointer("/properties/kind/const"))?.as_str()?;
        let text = variant.get("description")?.as_str()?;
        Some((name.to_owned(), text.split(". ").next()?.trim_end_matches('.').replace('\n', " ")))
    };
    variants.iter().filter_map(row).collect()
}

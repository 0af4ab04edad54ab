//! `djinn list`: the names that pipelines, commands and tables can use, and what they mean.

use crate::behavior::{self, BehaviorConfig, BehaviorEntry};
use crate::cli::args::Listed;
use crate::cli::printer::Printer;
use crate::engine::Result;
use crate::export::ExportFormat;
use crate::guidance::ObjectiveKind;
use crate::metrics;
use crate::scene::Dataset;
use schemars::{Schema, schema_for};
use serde_json::Value;

pub(in crate::cli) fn list(what: Listed, printer: &Printer) -> Result<()> {
    let rows: Vec<(String, String)> = match what {
        Listed::Behaviors => behavior::ALL.iter().flat_map(with_parameters).collect(),
        Listed::Objectives => of_schema(&schema_for!(ObjectiveKind)),
        Listed::Datasets => of_schema(&schema_for!(Dataset)),
        Listed::Formats => described(ExportFormat::ALL.iter().map(|format| (format.name(), format.description()))),
        Listed::Metrics => described(metrics::ALL.iter().map(|metric| (metric.spec().id, metric.spec().description))),
    };
    let width = rows.iter().map(|(name, _)| name.len()).max().unwrap_or_default();
    printer.data(&rows.iter().map(|(name, text)| format!("{name:width$}  {text}\n")).collect::<String>())
}

/// A behavior, and below it the parameters of its events, which requests divide into buckets.
fn with_parameters(entry: &BehaviorEntry) -> [(String, String); 2] {
    let template = BehaviorConfig::from_id(entry.id).map(|config| config.build().template_parameters().join(", "));
    let of_templates = template.filter(|names| !names.is_empty()).map(|names| format!("; templates aim at {names}"));
    let parameters = format!("  {}{}", entry.parameters.join(", "), of_templates.unwrap_or_default());
    [(entry.id.to_owned(), entry.description.to_owned()), (String::new(), parameters)]
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

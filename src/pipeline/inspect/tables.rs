//! Single files: event tables, metric tables, parts of folders, reports.

use super::{Description, inspect};
use crate::behavior::EventLabel;
use crate::engine::Result;
use crate::metrics::MetricRow;
use crate::store::{
    CorpusManifest, Error, ParameterSummary, QUANTILES, read_events, read_json, read_metrics, read_verdicts,
    summarize_events,
};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::path::Path;

fn has_extension(path: &Path, extension: &str) -> bool {
    path.is_file() && path.extension().is_some_and(|found| found == extension)
}

/// The table, or `None` if the file is a table of another kind.
fn of_this_schema<T>(read: Result<T, Error>) -> Result<Option<T>> {
    match read {
        Ok(rows) => Ok(Some(rows)),
        Err(Error::SchemaVersion { .. }) => Ok(None),
        Err(error) => Err(error.into()),
    }
}

pub(super) fn events(path: &Path) -> Result<Option<Description>> {
    if !has_extension(path, "parquet") {
        return Ok(None);
    }
    let Some(events) = of_this_schema(read_events(path, |_| true))? else { return Ok(None) };
    let mut counts = BTreeMap::<&str, BTreeMap<&str, usize>>::new();
    let mut scenes = BTreeMap::<&str, usize>::new();
    let mut parameters = BTreeMap::<&str, BTreeMap<&str, Value>>::new();
    let summaries = summarize_events(&events)?;
    for summary in &summaries {
        counts.entry(&summary.behavior).or_default().insert(summary.label.name(), summary.n_events);
        if summary.label == EventLabel::Positive {
            scenes.insert(&summary.behavior, summary.n_scenes);
            let own = parameters.entry(&summary.behavior).or_default();
            own.extend(summary.parameters.iter().map(|parameter| (parameter.name.as_str(), distribution(parameter))));
        }
    }
    let description = Description::new("event table")
        .with("n_events", events.len())
        .with_json("events_by_behavior", &counts)?
        .with_json("scenes_with_positive_events", &scenes)?
        .with_json("parameters_of_positive_events", &parameters)?;
    Ok(Some(description))
}

/// How a parameter is distributed, to three digits after the point.
fn distribution(parameter: &ParameterSummary) -> Value {
    let rounded = |value: f64| (value * 1e3).round() / 1e3;
    let mut told = serde_json::Map::from_iter([("n".to_owned(), json!(parameter.n))]);
    told.insert("mean".to_owned(), json!(rounded(parameter.mean)));
    let quantiles = QUANTILES.iter().zip(parameter.quantiles);
    told.extend(quantiles.map(|(q, value)| (format!("{}%", q * 100.0), json!(rounded(value)))));
    Value::Object(told)
}

pub(super) fn metrics(path: &Path) -> Result<Option<Description>> {
    if !has_extension(path, "parquet") {
        return Ok(None);
    }
    let Some(rows) = of_this_schema(read_metrics(path))? else { return Ok(None) };
    let is_overall = |row: &MetricRow| row.place.is_empty() && row.scene_id.is_none() && row.scenario_id.is_none();
    let (mut n_rows, mut overall) = (0_u64, BTreeMap::<String, BTreeMap<String, Value>>::new());
    for row in rows {
        let row = row?;
        n_rows += 1;
        if is_overall(&row) {
            let group = match row.group.is_generated() {
                false => format!("{} of {}", row.group.name(), row.sweep),
                true => format!("{} at {}", row.sweep, row.level),
            };
            overall.entry(group).or_default().insert(row.metric, json!(row.value));
        }
    }
    let description =
        Description::new("metric table").with("n_rows", n_rows).with_json("means_over_scenes", &overall)?;
    Ok(Some(description))
}

pub(super) fn verdicts(path: &Path) -> Result<Option<Description>> {
    if !has_extension(path, "parquet") {
        return Ok(None);
    }
    let Some(rows) = of_this_schema(read_verdicts(path))? else { return Ok(None) };
    let mut by_reason = BTreeMap::<String, u64>::new();
    let (mut n_scenarios, mut n_accepted, mut n_kept) = (0_u64, 0_u64, 0_u64);
    for row in rows {
        let row = row?;
        n_scenarios += 1;
        n_accepted += u64::from(row.accepted);
        n_kept += u64::from(row.kept);
        row.reasons.into_iter().for_each(|reason| *by_reason.entry(reason).or_default() += 1);
    }
    let description = Description::new("table of verdicts")
        .with("n_scenarios", n_scenarios)
        .with("n_accepted", n_accepted)
        .with("n_kept", n_kept)
        .with_json("rejected_by_reason", &by_reason)?;
    Ok(Some(description))
}

/// Shards and other tables are described by their folder and the note beside them.
pub(super) fn part_of_folder(path: &Path) -> Result<Option<Description>> {
    if !path.is_dir() && !has_extension(path, "parquet") && !has_extension(path, "arrow") {
        return Ok(None);
    }
    // Files of a corpus lie in folders of their partition: up to scenarios/behavior=…/place=….
    let Some(folder) = path.ancestors().skip(1).take(4).find(|folder| folder.join("manifest.json").exists()) else {
        return Ok(None);
    };
    let whole = inspect(folder)?;
    let name = path.strip_prefix(folder).unwrap_or(path).to_string_lossy().into_owned();
    let mut description = Description::new("part of a folder").with("file", name.as_str()).with("folder", whole.kind);
    if !path.is_dir() {
        description = description.with("n_bytes", fs_err::metadata(path)?.len());
    }
    if let Ok(beside) = read_json::<Value>(&path.with_extension("json")) {
        description = description.with("shard", beside);
    }
    if whole.kind == "corpus" {
        let manifest = CorpusManifest::read(folder)?;
        for (table, entry) in &manifest.tables {
            let files_below = || entry.files.iter().filter(|file| Path::new(&file.path).starts_with(&name));
            if path.is_dir() && files_below().next().is_some() {
                description = description
                    .with("table", table.as_str())
                    .with("schema", entry.schema.as_str())
                    .with("n_files", files_below().count())
                    .with("n_rows", files_below().map(|file| file.n_rows).sum::<u64>());
            } else if let Some(file) = entry.files.iter().find(|file| file.path == name) {
                description = description
                    .with("table", table.as_str())
                    .with("schema", entry.schema.as_str())
                    .with("n_rows", file.n_rows)
                    .with_json("partition", &file.partition)?;
            }
        }
    }
    Ok(Some(description))
}

pub(super) fn report_or_json(path: &Path) -> Result<Option<Description>> {
    if has_extension(path, "html") {
        let text = fs_err::read_to_string(path)?;
        let title =
            text.split_once("<title>").and_then(|(_, rest)| rest.split_once("</title>")).map(|(title, _)| title);
        return Ok(Some(Description::new("report").with("title", title).with("n_bytes", text.len())));
    }
    if has_extension(path, "json") {
        let content: Value = read_json(path)?;
        return Ok(Some(Description::new("json").with("content", content)));
    }
    Ok(None)
}

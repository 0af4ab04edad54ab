//! Tables of events: how many, and with which parameters.

use super::Description;
use crate::behavior::EventLabel;
use crate::engine::Result;
use crate::store::{Error, ParameterSummary, QUANTILES, read_events, summarize_events};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::path::Path;

pub(super) fn describe(path: &Path) -> Result<Option<Description>> {
    if !path.is_file() || path.extension().is_none_or(|extension| extension != "parquet") {
        return Ok(None);
    }
    let events = match read_events(path, |_| true) {
        Ok(events) => events,
        Err(Error::SchemaVersion { .. }) => return Ok(None),
        Err(error) => return Err(error.into()),
    };
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

//! Rates, and what they are counted in.

use super::Description;
use crate::engine::Result;
use crate::rates::CLASSES;
use crate::store::{Error, read_exposure, read_rates};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::path::Path;

/// The rows of the file, or `None` if it is another table or none.
fn of_this_schema<T>(path: &Path, read: fn(&Path) -> Result<Vec<T>, Error>) -> Result<Option<Vec<T>>> {
    if !(path.is_file() && path.extension().is_some_and(|found| found == "parquet")) {
        return Ok(None);
    }
    match read(path) {
        Ok(rows) => Ok(Some(rows)),
        Err(Error::SchemaVersion { .. }) => Ok(None),
        Err(error) => Err(error.into()),
    }
}

pub(super) fn describe(path: &Path) -> Result<Option<Description>> {
    let Some(rows) = of_this_schema(path, read_rates)? else { return Ok(None) };
    let rounded = |value: f64| format!("{value:.3e}").parse::<f64>().unwrap_or(value);
    let mut found = BTreeMap::<String, BTreeMap<String, Value>>::new();
    for row in rows.iter().filter(|row| row.split.is_empty()) {
        let place = if row.place.is_empty() { "all places".to_owned() } else { row.place.clone() };
        let per_hour = [row.rate_per_hour, row.per_hour.low, row.per_hour.high].map(rounded);
        let mut told = json!({
            "n_events": row.n_events,
            "per_hour": per_hour,
            "method": row.method.name(),
        });
        if let Some((rate, interval)) = row.rate_per_1000_km.zip(row.per_1000_km) {
            let per_1000_km = [rate, interval.low, interval.high].map(rounded);
            told["per_1000_km"] = json!(per_1000_km);
        }
        if let Some(note) = &row.note {
            told["note"] = json!(note);
        }
        found.entry(format!("{} {}", row.behavior, row.within).trim_end().to_owned()).or_default().insert(place, told);
    }
    let description = Description::new("table of rates")
        .with("n_rows", rows.len())
        .with_json("rates_with_lower_and_upper_ends", &found)?;
    Ok(Some(description))
}

pub(super) fn exposure(path: &Path) -> Result<Option<Description>> {
    let Some(rows) = of_this_schema(path, read_exposure)? else { return Ok(None) };
    let mut parts = BTreeMap::<String, BTreeMap<String, f64>>::new();
    for row in &rows {
        let part = parts.entry(format!("{} {}", row.split.name(), row.place)).or_default();
        *part.entry("observed_h".to_owned()).or_default() += row.observed_h;
        for ((class, hours), km) in CLASSES.iter().zip(row.class_h).zip(row.class_km).filter(|((_, h), _)| *h > 0.0) {
            *part.entry(format!("{}_h", class.name())).or_default() += hours;
            *part.entry(format!("{}_km", class.name())).or_default() += km;
        }
    }
    let description = Description::new("table of exposure")
        .with("n_recordings", rows.len())
        .with("n_that_share_moments", rows.iter().filter(|row| row.shares_with.is_some()).count())
        .with_json("exposure_by_split_and_place", &parts)?;
    Ok(Some(description))
}

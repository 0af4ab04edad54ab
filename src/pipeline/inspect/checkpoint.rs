//! Describes checkpoints: the network, its training and its constants.

use super::Description;
use crate::engine::Result;
use crate::model::ChangedLoss;
use crate::nn::read_checkpoint;
use crate::train::map_warnings;
use candle_core::Device;
use serde_json::{Map, Value, json};
use std::path::Path;

pub(super) fn describe(path: &Path) -> Result<Option<Description>> {
    if path.extension().is_none_or(|extension| extension != "safetensors") {
        return Ok(None);
    }
    let checkpoint = read_checkpoint::<Value>(path, &Device::Cpu)?;
    let kind = match checkpoint.metadata.get("kind").and_then(Value::as_str) {
        Some("scene_denoiser") => "denoiser checkpoint",
        Some("behavior_classifier") => "behavior classifier checkpoint",
        Some("scene_transformer") => "Scene Transformer checkpoint",
        _ => "training state",
    };
    let n_values: usize = checkpoint.tensors.values().map(candle_core::Tensor::elem_count).sum();
    let mut description = Description::new(kind)
        .with("fingerprint", checkpoint.fingerprint)
        .with("n_tensors", checkpoint.tensors.len())
        .with("n_values", n_values);
    let changed = checkpoint.metadata.get("changed_losses").cloned();
    if let Value::Object(metadata) = checkpoint.metadata {
        for (name, mut value) in metadata.into_iter().filter(|(name, _)| name != "kind") {
            // Hundreds of numbers that nobody reads one by one.
            if let Some(covariance) = value.get_mut("motion_covariance").filter(|found| found.is_object()) {
                *covariance = json!(format!("of {} timesteps", covariance["n_timesteps"]));
            }
            let value = match name.as_str() {
                "changed_losses" => by_name(&value, "change", "loss"),
                "losses_by_place" => losses_by_place(&value),
                _ => value,
            };
            description = description.with(&name, value);
        }
    }
    let warnings = changed.and_then(|losses| serde_json::from_value::<Vec<ChangedLoss>>(losses).ok());
    let warnings = warnings.map(|losses| map_warnings(&losses)).unwrap_or_default();
    Ok(Some(if warnings.is_empty() { description } else { description.with("warnings", warnings) }))
}

/// Entries with a noise level as a table: a row for each value of `key`, with the `figure` at each noise level.
fn by_name(entries: &Value, key: &str, figure: &str) -> Value {
    let mut rows = Map::new();
    for entry in entries.as_array().into_iter().flatten() {
        let row = rows.entry(entry[key].as_str().unwrap_or_default()).or_insert_with(|| json!({}));
        row[format!("sigma_{}", entry["sigma"])] = entry[figure].clone();
    }
    Value::Object(rows)
}

/// The table of places: the number of scenes, the loss, and the loss with the map turned.
fn losses_by_place(entries: &Value) -> Value {
    let (mut rows, turned) = (by_name(entries, "place", "loss"), by_name(entries, "place", "map_turned"));
    for entry in entries.as_array().into_iter().flatten() {
        let place = entry["place"].as_str().unwrap_or_default();
        rows[place]["n_scenes"] = entry["n_scenes"].clone();
        rows[place]["map_turned"] = turned[place].clone();
    }
    rows
}

//! Checkpoints: what network, trained how, with which constants?

use super::Description;
use crate::nn::read_checkpoint;
use crate::pipeline::Result;
use candle_core::Device;
use serde_json::{Value, json};
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
    if let Value::Object(metadata) = checkpoint.metadata {
        for (name, mut value) in metadata.into_iter().filter(|(name, _)| name != "kind") {
            // Hundreds of numbers that nobody reads one by one.
            if let Some(covariance) = value.get_mut("motion_covariance").filter(|found| found.is_object()) {
                *covariance = json!(format!("of {} timesteps", covariance["n_timesteps"]));
            }
            description = description.with(&name, value);
        }
    }
    Ok(Some(description))
}

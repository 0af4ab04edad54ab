//! Which settings may be a URL of an object store, and can this build open one?

use super::PipelineConfig;
use crate::cloud::{IS_BUILT, ObjectUrl};
use crate::settings::{self, Issue};
use serde_json::Value;
use std::path::Path;

/// The settings that may be a URL; the last two are lists.
const KEYS: [&str; 3] = ["run.output", "ingest.inputs", "ingest.map_inputs"];

/// Refuses URLs where paths on disk are needed, and all of them in a build without object stores.
pub(super) fn check_urls(config: &PipelineConfig) -> settings::Result {
    // A configuration that cannot be written as JSON fails where that is needed.
    serde_json::to_value(config).map_or(Ok(()), |config| check("", &config))
}

fn check(key: &str, value: &Value) -> settings::Result {
    let below = |name: &str| if key.is_empty() { name.to_owned() } else { format!("{key}.{name}") };
    match value {
        Value::Object(fields) => fields.iter().try_for_each(|(name, value)| check(&below(name), value)),
        Value::Array(items) => {
            items.iter().enumerate().try_for_each(|(idx, item)| check(&below(&idx.to_string()), item))
        }
        Value::String(text) => check_text(key, Path::new(text)),
        Value::Null | Value::Bool(_) | Value::Number(_) => Ok(()),
    }
}

fn check_text(key: &str, path: &Path) -> settings::Result {
    let is_known =
        KEYS.iter().any(|known| key.strip_prefix(known).is_some_and(|idx| idx.is_empty() || idx.starts_with('.')));
    match ObjectUrl::of(path) {
        Ok(None) => Ok(()),
        Ok(Some(_)) if !is_known => {
            let message = format!(
                "is {}, expected a path on disk: only {} may be in an object store; copy it to disk",
                path.display(),
                KEYS.join(", ")
            );
            Err(Issue::new(key, message))
        }
        Ok(Some(url)) if !IS_BUILT => {
            let message = format!(
                "is {url}, expected a path on disk: this djinn was built without object stores; use one that was built \
                 with them (`cargo build --release --features cloud`), or copy the files to disk"
            );
            Err(Issue::new(key, message))
        }
        Ok(Some(_)) => Ok(()),
        Err(why) => Err(Issue::new(key, format!("is no URL of an object store: {why}"))),
    }
}

//! Every setting that a sample was drawn with, for its provenance.

use super::{GenerateConfig, Level, SweepConfig};
use serde_json::Value;

/// Keys of a sweep that decide which samples there are, and not what they are.
const NOT_OF_A_SAMPLE: [&str; 8] =
    ["name", "n_scenes", "n_samples", "strengths", "behavior", "pairs", "select", "stop_after_verified"];

impl SweepConfig {
    /// The settings of a sample of this sweep at `level` as JSON: sampler, what is observed, edits, and how it is guided and
    /// how strongly, with every option of the objectives.
    pub(super) fn settings(&self, config: &GenerateConfig, level: Level) -> String {
        // A configuration of plain values always becomes JSON.
        let mut settings = serde_json::to_value(self).unwrap_or_default();
        if let Value::Object(settings) = &mut settings {
            NOT_OF_A_SAMPLE.iter().for_each(|key| _ = settings.remove(*key));
            if let Some(Value::Object(classifier_free)) = settings.get_mut("classifier_free") {
                classifier_free.remove("weights");
                classifier_free.insert("weight".to_owned(), level.weight.into());
            }
            settings.insert("strength".to_owned(), level.strength.into());
            settings.insert("sampler".to_owned(), serde_json::to_value(self.sampler(config)).unwrap_or_default());
            settings.retain(|_, value| !value.is_null());
        }
        settings.to_string()
    }
}

//! The `[report]` section: what is shown.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// What the report shows.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ReportConfig {
    /// Title of the page; empty: the pipeline's name.
    pub title: String,
    /// Verified scenarios that are drawn of each sweep that asks for a behavior: new ones first, of as many scenes as there are.
    #[schemars(range(max = 100_000))]
    pub n_drawn: usize,
    /// Scenarios that are drawn of such a sweep though they do not hold what was asked for.
    #[schemars(range(max = 100_000))]
    pub n_failed_drawn: usize,
    /// Scenes that are drawn of each sweep that asks for no behavior, at each strength; the same scenes in all of them.
    #[schemars(range(max = 100_000))]
    pub n_scenes_drawn: usize,
    /// Samples of each of these scenes that are drawn, one over the other.
    #[schemars(range(max = 100_000))]
    pub n_samples_drawn: usize,
    /// Recorded scenes, and scenarios of each kind, whose motion is compared.
    #[schemars(range(max = 100_000))]
    pub n_compared: usize,
}

impl Default for ReportConfig {
    fn default() -> Self {
        Self {
            title: String::new(),
            n_drawn: 12,
            n_failed_drawn: 3,
            n_scenes_drawn: 2,
            n_samples_drawn: 6,
            n_compared: 300,
        }
    }
}

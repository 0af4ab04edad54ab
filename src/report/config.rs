//! The `[report]` section.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The content of the report.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ReportConfig {
    /// Title of the page; empty: the pipeline's name.
    pub title: String,
    /// Accepted scenarios to draw per sweep with a behavior, the hardest first: those with the least time to collision.
    /// Without an evaluation verified ones, new ones first, from as many scenes as possible.
    #[schemars(range(max = 100_000))]
    pub n_drawn: usize,
    /// Scenarios to draw per such sweep that are verified and not accepted, and as many without the behavior.
    #[schemars(range(max = 100_000))]
    pub n_failed_drawn: usize,
    /// Accepted scenarios to draw of each bucket of a request.
    #[schemars(range(max = 100_000))]
    pub n_drawn_per_bucket: usize,
    /// Scenes to draw per sweep without a behavior, at each strength; the same scenes in all of them.
    #[schemars(range(max = 100_000))]
    pub n_scenes_drawn: usize,
    /// Recorded scenes, and scenarios of each kind, whose motion is compared.
    #[schemars(range(max = 100_000))]
    pub n_compared: usize,
}

impl Default for ReportConfig {
    fn default() -> Self {
        Self {
            title: String::new(),
            n_drawn: 100,
            n_failed_drawn: 3,
            n_drawn_per_bucket: 2,
            n_scenes_drawn: 2,
            n_compared: 300,
        }
    }
}

//! The `[report]` section.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The content of the report.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ReportConfig {
    /// Accepted scenarios to draw per sweep with a behavior, the hardest first: those with the least time to collision.
    /// Without an evaluation verified ones, new ones first, from as many scenes as possible.
    #[schemars(range(max = 100_000))]
    pub n_drawn: usize,
}

impl Default for ReportConfig {
    fn default() -> Self {
        Self { n_drawn: 100 }
    }
}

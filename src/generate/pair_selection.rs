//! Which pairs of a scene does a sweep or a request ask?

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Which pairs of a scene are requested to show a behavior of two agents, in the behavior's order of roles (for a
/// cut-in: the vehicle that is cut off, then the one that cuts in).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct PairSelectionConfig {
    /// Number of pairs per scene, one at a time.
    #[schemars(range(min = 1, max = 10_000))]
    pub per_scene: usize,
    /// Their largest distance at present, meters.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub max_distance_m: f64,
    /// Whether to skip pairs that cannot show the behavior, given their past and the limits of driving. The recorded
    /// future is never used.
    pub only_feasible: bool,
    /// Which of the possible pairs come first. Left out: `classifier`; with `aim = "hard"`, which takes no other
    /// ranking, those that can show the hardest events.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ranking: Option<PairRanking>,
}

impl Default for PairSelectionConfig {
    fn default() -> Self {
        Self { per_scene: 1, max_distance_m: 30.0, only_feasible: true, ranking: None }
    }
}

/// Which of the possible pairs of a scene come first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum PairRanking {
    /// Those with the highest probability by the classifier, from their history; without a classifier, as `effort`.
    Classifier,
    /// Those that can show it with the least effort, by the limits of driving; if that is undefined, the closest.
    Effort,
}

//! The meaning of a metric's value.

use super::ModesOf;
use serde::{Deserialize, Serialize};

/// Which way is better.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Direction {
    /// More is better.
    HigherIsBetter,
    /// Less is better.
    LowerIsBetter,
    /// Neither: to be compared with the recorded data.
    Neither,
}

/// Name and meaning of a metric.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct MetricSpec {
    /// Its name in configs and tables; ends in its unit, if it has one.
    pub id: &'static str,
    /// Unit of its values: `m`, or `1` for shares.
    pub unit: &'static str,
    /// Which way is better.
    pub direction: Direction,
    /// Its definition in a line.
    pub description: &'static str,
    /// The agents whose modes may replace the samples, for figures that a benchmark takes over a few guesses. `None`
    /// for metrics of the samples themselves, such as their variety, or how often they collide.
    #[serde(skip)]
    pub modes: Option<ModesOf>,
}

impl MetricSpec {
    /// The specification of a metric of the samples themselves.
    pub const fn new(id: &'static str, unit: &'static str, direction: Direction, description: &'static str) -> Self {
        Self { id, unit, direction, description, modes: None }
    }

    /// The specification of a metric in which the modes of these agents may replace the samples.
    #[must_use]
    pub const fn over_modes(self, agents: ModesOf) -> Self {
        Self { modes: Some(agents), ..self }
    }
}

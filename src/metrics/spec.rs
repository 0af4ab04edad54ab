//! The meaning of a metric's value.

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
}

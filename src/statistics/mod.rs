//! Statistics of counts and of rare values: how sure is a rate, and how far does what was recorded reach?

mod clustered;
mod estimate;
mod gamma;
mod pareto;
mod splitting;
mod wilson;

pub use clustered::{ClusteredRate, clustered_rate, weighted_rate};
pub use estimate::Estimate;
pub use pareto::Pareto;
pub use splitting::{Levels, Process, split};
pub use wilson::wilson_interval;

use serde::{Deserialize, Serialize};

/// A closed interval.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Interval {
    /// Lower end.
    pub low: f64,
    /// Upper end.
    pub high: f64,
}

impl Interval {
    /// Both ends times a factor that is not negative.
    #[must_use]
    pub fn times(self, factor: f64) -> Self {
        Self { low: self.low * factor, high: self.high * factor }
    }
}

/// Values that scipy gives (`scripts/golden_rates.py`).
#[cfg(test)]
fn golden() -> serde_json::Value {
    serde_json::from_str(include_str!("../../tests/golden/rates.json")).unwrap()
}

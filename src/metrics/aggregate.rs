//! The mean of a metric over many scenes, with its standard error.

use serde::{Deserialize, Serialize};

/// The mean of a metric over groups.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Aggregate {
    /// Arithmetic mean; every group has the same weight.
    pub mean: f64,
    /// Number of groups for which the metric is defined.
    pub n: u64,
    /// Standard error of the mean, s / √n with the sample standard deviation s. `None` for fewer than two groups.
    pub std_error: Option<f64>,
}

/// Aggregates values in two passes: the first for their mean, the second for their deviations from it. The last digits
/// depend on their order, so add them in the order of scenes.
#[derive(Debug, Clone, Default)]
pub struct AggregateTally {
    n: u64,
    sum: f64,
    squares: f64,
}

impl AggregateTally {
    /// Adds a value to the mean: the first pass.
    pub fn add(&mut self, value: f64) {
        self.n += 1;
        self.sum += value;
    }

    /// Adds a value's deviation from the mean: the second pass.
    pub fn compare(&mut self, value: f64) {
        let deviation = value - self.mean();
        self.squares += deviation * deviation;
    }

    /// The aggregate; `None` without values.
    pub fn finish(&self) -> Option<Aggregate> {
        let n = self.n as f64;
        let std_error = (self.n > 1).then(|| (self.squares / (n - 1.0) / n).sqrt());
        (self.n > 0).then(|| Aggregate { mean: self.mean(), n: self.n, std_error })
    }

    fn mean(&self) -> f64 {
        self.sum / self.n as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn known_mean_and_error() {
        // Deviations -2, 0, 2: s² = 8 / 2 = 4, so s / √3.
        let of = |values: &[f64]| {
            let mut tally = AggregateTally::default();
            values.iter().for_each(|value| tally.add(*value));
            values.iter().for_each(|value| tally.compare(*value));
            tally.finish()
        };
        let aggregate = of(&[1.0, 3.0, 5.0]).expect("defined");
        assert_eq!((aggregate.mean, aggregate.n), (3.0, 3));
        assert!((aggregate.std_error.expect("three values") - 2.0 / 3.0_f64.sqrt()).abs() < 1e-12);
        assert_eq!(of(&[2.0]), Some(Aggregate { mean: 2.0, n: 1, std_error: None }));
        assert_eq!(of(&[]), None);
    }
}

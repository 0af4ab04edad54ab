//! From the figures of many scenes to one: their mean, and how well it is known.

use serde::{Deserialize, Serialize};

/// The mean of a metric over groups.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Aggregate {
    /// Arithmetic mean; every group counts the same.
    pub mean: f64,
    /// Number of groups for which the metric is defined.
    pub n: u64,
    /// Standard error of the mean, s / √n with the sample standard deviation s. `None` for fewer than two groups.
    pub std_error: Option<f64>,
}

impl Aggregate {
    /// The aggregate of the values that are defined. `None` when none is. The result depends on the order of the
    /// values in the last digits, so they are to come in the order of scenes.
    pub fn of(values: impl IntoIterator<Item = Option<f64>>) -> Option<Self> {
        let values: Vec<f64> = values.into_iter().flatten().collect();
        let n = values.len() as f64;
        let mean = values.iter().sum::<f64>() / n;
        let squares: f64 = values.iter().map(|value| (value - mean) * (value - mean)).sum();
        let std_error = (values.len() > 1).then(|| (squares / (n - 1.0) / n).sqrt());
        (!values.is_empty()).then_some(Self { mean, n: values.len() as u64, std_error })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn known_mean_and_error() {
        // Deviations -2, 0, 2: s² = 8 / 2 = 4, so s / √3.
        let aggregate = Aggregate::of([Some(1.0), None, Some(3.0), Some(5.0)]).expect("defined");
        assert_eq!((aggregate.mean, aggregate.n), (3.0, 3));
        assert!((aggregate.std_error.expect("three values") - 2.0 / 3.0_f64.sqrt()).abs() < 1e-12);
        assert_eq!(Aggregate::of([Some(2.0)]), Some(Aggregate { mean: 2.0, n: 1, std_error: None }));
        assert_eq!(Aggregate::of([None, None]), None);
    }
}

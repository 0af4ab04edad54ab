//! The range of most values, from counts in fixed bins.
//!
//! Memory does not grow with the number of values, and counts can be added up in any order.

use serde::{Deserialize, Serialize};

const N_BINS: usize = 400;

/// Counts of the values of a quantity in equal bins over a fixed range.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Histogram {
    range: [f64; 2],
    counts: Vec<u64>,
}

impl Histogram {
    /// An empty histogram. Values beyond `range` count as its ends.
    pub fn new(range: [f64; 2]) -> Self {
        Self { range, counts: vec![0; N_BINS] }
    }

    /// Adds a value, if it is finite.
    pub fn add(&mut self, value: f64) {
        if !value.is_finite() {
            return;
        }
        let [low, high] = self.range;
        let share = ((value - low) / (high - low)).clamp(0.0, 1.0);
        self.counts[((share * N_BINS as f64) as usize).min(N_BINS - 1)] += 1;
    }

    /// Adds the values of another histogram of the same range.
    pub fn merge(&mut self, other: &Self) {
        self.counts.iter_mut().zip(&other.counts).for_each(|(own, theirs)| *own += theirs);
    }

    /// Number of values.
    pub fn n(&self) -> u64 {
        self.counts.iter().sum()
    }

    /// The range of all values except a share of `beyond` at either end, rounded outward to a bin. An end in the first
    /// or last bin is infinite, because these hold all values beyond. `None` without values.
    pub fn central_range(&self, beyond: f64) -> Option<[f64; 2]> {
        let n = self.n() as f64;
        let width = (self.range[1] - self.range[0]) / N_BINS as f64;
        let mut before = 0.0;
        let bin_at = |share: f64, before: &mut f64| {
            self.counts.iter().position(|count| {
                *before += *count as f64;
                *before > share * n || *before >= n
            })
        };
        let low = bin_at(beyond, &mut before)?;
        before = 0.0;
        let high = bin_at(1.0 - beyond, &mut before)?;
        let edge = |bin: usize| self.range[0] + bin as f64 * width;
        (n > 0.0).then(|| {
            let low = if low == 0 { f64::NEG_INFINITY } else { edge(low) };
            let high = if high + 1 == N_BINS { f64::INFINITY } else { edge(high + 1) };
            [low, high]
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(range: [f64; 2], values: impl IntoIterator<Item = f64>) -> Histogram {
        let mut histogram = Histogram::new(range);
        values.into_iter().for_each(|value| histogram.add(value));
        histogram
    }

    #[test]
    fn central_ranges_leave_out_the_ends() {
        // 1000 values of 5.005, 5.015, …, 14.995: a hundredth at either end are ten values, 0.1.
        let evenly = of([0.0, 40.0], (0..1000).map(|i| 5.005 + f64::from(i) / 100.0));
        let [low, high] = evenly.central_range(0.01).expect("values");
        assert!((low - 5.1).abs() < 1e-9 && (high - 14.9).abs() < 0.11, "{low} {high}");
        assert_eq!(of([0.0, 40.0], [0.01, 39.99]).central_range(0.01), Some([f64::NEG_INFINITY, f64::INFINITY]));
        assert_eq!(of([0.0, 40.0], []).central_range(0.01), None);
        let one = of([0.0, 40.0], [7.25]).central_range(0.001).expect("a value");
        assert!((one[0] - 7.2).abs() < 1e-9 && (one[1] - 7.3).abs() < 1e-9);
    }

    #[test]
    fn parts_add_up_and_ends_hold_what_is_beyond() {
        let values = [-3.0, 0.2, 39.99, 40.0, 1e9, f64::NAN, f64::INFINITY];
        let whole = of([0.0, 40.0], values);
        let mut parts = of([0.0, 40.0], values[..2].iter().copied());
        parts.merge(&of([0.0, 40.0], values[2..].iter().copied()));
        assert_eq!(whole.counts, parts.counts);
        assert_eq!((whole.n(), whole.counts[0], whole.counts[N_BINS - 1]), (5, 1, 3));
    }
}

//! Distances between distributions, from counts in fixed bins.
//!
//! Memory does not grow with the number of values, and counts can be added up in any order.

use serde::{Deserialize, Serialize};

/// Bins for the Wasserstein distance.
const N_BINS: usize = 400;
/// Bins that are joined to one of the 40 bins for the Jensen-Shannon divergence: it compares shares of bins, and fine
/// bins with few values would differ by chance.
const BINS_PER_COARSE: usize = 10;

/// Counts of the values of a quantity in equal bins over a fixed range.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Histogram {
    range: [f64; 2],
    counts: Vec<u64>,
    sum: f64,
}

impl Histogram {
    /// An empty histogram. Values beyond `range` count as its ends.
    pub fn new(range: [f64; 2]) -> Self {
        Self { range, counts: vec![0; N_BINS], sum: 0.0 }
    }

    /// Adds a value, if it is finite.
    pub fn add(&mut self, value: f64) {
        if !value.is_finite() {
            return;
        }
        let [low, high] = self.range;
        let share = ((value - low) / (high - low)).clamp(0.0, 1.0);
        self.counts[((share * N_BINS as f64) as usize).min(N_BINS - 1)] += 1;
        self.sum += value;
    }

    /// Adds the values of another histogram of the same range.
    pub fn merge(&mut self, other: &Self) {
        self.counts.iter_mut().zip(&other.counts).for_each(|(own, theirs)| *own += theirs);
        self.sum += other.sum;
    }

    /// Number of values.
    pub fn n(&self) -> u64 {
        self.counts.iter().sum()
    }

    /// The mean of the exact values, including those beyond the range; `None` without values.
    pub fn mean(&self) -> Option<f64> {
        (self.n() > 0).then(|| self.sum / self.n() as f64)
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

    /// Wasserstein-1 distance in the quantity's unit: the area between the cumulative distributions, with the values of
    /// a bin spread evenly over it. It is off by a bin's width (1/400 of the range) at most, and values beyond the
    /// range count as its ends. `None` if either is empty.
    pub fn wasserstein(&self, other: &Self) -> Option<f64> {
        let (own, theirs) = (self.shares(1)?, other.shares(1)?);
        let (mut before, mut area) = (0.0_f64, 0.0);
        for (p, q) in own.iter().zip(&theirs) {
            let after = before + p - q;
            // The mean size of a difference that goes from `before` to `after` in a straight line.
            area += match before * after < 0.0 {
                true => (before * before + after * after) / (2.0 * (before.abs() + after.abs())),
                false => (before.abs() + after.abs()) / 2.0,
            };
            before = after;
        }
        Some(area * (self.range[1] - self.range[0]) / N_BINS as f64)
    }

    /// Jensen-Shannon divergence over 40 bins, in bits: 0 for equal distributions, 1 for distributions without a common
    /// bin. `None` if either is empty.
    pub fn jensen_shannon(&self, other: &Self) -> Option<f64> {
        let (own, theirs) = (self.shares(BINS_PER_COARSE)?, other.shares(BINS_PER_COARSE)?);
        let term = |p: f64, q: f64| if p > 0.0 { p * (2.0 * p / (p + q)).log2() } else { 0.0 };
        Some(own.iter().zip(&theirs).map(|(p, q)| (term(*p, *q) + term(*q, *p)) / 2.0).sum())
    }

    /// The share of values in each run of `n_joined` bins; `None` without values.
    fn shares(&self, n_joined: usize) -> Option<Vec<f64>> {
        let n = self.n();
        let share = |bins: &[u64]| bins.iter().sum::<u64>() as f64 / n as f64;
        (n > 0).then(|| self.counts.chunks(n_joined).map(share).collect())
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
    fn distances_by_hand() {
        // Bins of 0.1; everything moved by 2.5 is a distance of 2.5.
        let range = [0.0, 40.0];
        let evenly = |from: f64| of(range, (0..1000).map(|i| from + 0.005 + f64::from(i) / 100.0));
        let (a, b) = (evenly(5.0), evenly(7.5));
        assert!((a.wasserstein(&b).expect("values") - 2.5).abs() < 1e-9);
        assert_eq!((a.wasserstein(&a), a.jensen_shannon(&a)), (Some(0.0), Some(0.0)));
        // Half at 0 and half at 1; half at 0, a quarter at 1 and a quarter at 3: a quarter moves by 2.
        let (c, d) = (of(range, [0.05, 1.05]), of(range, [0.05, 0.05, 1.05, 3.05]));
        assert!((c.wasserstein(&d).expect("values") - 0.5).abs() < 1e-9);
        // Bins of 1 for the divergence: shares ½ ½ 0 0 and ½ ¼ 0 ¼; ½ [½ lb(4/3) + ¼ lb(2/3) + ¼ lb 2].
        let expected = 0.5 * (0.5 * (4.0_f64 / 3.0).log2() + 0.25 * (2.0_f64 / 3.0).log2() + 0.25);
        assert!((c.jensen_shannon(&d).expect("values") - expected).abs() < 1e-12);
        assert_eq!(of(range, [1.5]).jensen_shannon(&of(range, [2.5])), Some(1.0));
        assert_eq!((a.wasserstein(&of(range, [])), a.jensen_shannon(&of(range, []))), (None, None));
    }

    #[test]
    fn crossing_cumulative_distributions_within_a_bin() {
        // One bin's width w = 0.1. All of a in the bin in the middle; half of b in the one before, half in the one
        // after: the difference goes from 0 to -½, to ½, to 0, with mean sizes ¼, ¼ and ¼.
        let (a, b) = (of([0.0, 40.0], [10.05]), of([0.0, 40.0], [9.95, 10.15]));
        assert!((a.wasserstein(&b).expect("values") - 0.075).abs() < 1e-9);
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
        assert_eq!(of([0.0, 40.0], [1.0, 60.0]).mean(), Some(30.5));
        assert_eq!(of([0.0, 40.0], []).mean(), None);
    }
}

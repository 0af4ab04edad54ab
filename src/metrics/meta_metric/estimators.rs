//! The probability of a value, estimated from samples: a histogram over a fixed range.

/// The bins of a histogram, all of one width.
#[derive(Debug, Clone, Copy)]
pub(super) struct Bins {
    /// The lower end of the first one. Lower values count there.
    pub(super) min: f64,
    /// The upper end of the last bin. Higher and undefined values count there.
    pub(super) max: f64,
    pub(super) n_bins: usize,
    /// Added to the count of each.
    pub(super) pseudocount: f64,
}

impl Bins {
    /// The log probability of a value, by these samples.
    pub(super) fn log_p(self, samples: impl Iterator<Item = f64>) -> impl Fn(f64) -> f64 {
        let mut counts = vec![self.pseudocount; self.n_bins];
        samples.for_each(|value| counts[self.bin(value)] += 1.0);
        let sum: f64 = counts.iter().sum();
        move |value| (counts[self.bin(value)] / sum).ln()
    }

    fn bin(&self, value: f64) -> usize {
        let share = (value - self.min) / (self.max - self.min);
        // The cast turns values below 0 into 0.
        if share.is_nan() { self.n_bins - 1 } else { ((share * self.n_bins as f64) as usize).min(self.n_bins - 1) }
    }
}

//! Wilson's confidence interval of a rate.

use super::Interval;

/// The standard normal distribution's 97.5 % quantile.
const Z: f64 = 1.959_963_984_540_054;

/// Wilson's 95 % score interval for `n_hits` of `n`. `None` if nothing was counted.
///
/// It stays within [0, 1] and remains meaningful for rare events, for which the textbook interval collapses to a point.
pub fn wilson_interval(n_hits: u64, n: u64) -> Option<Interval> {
    if n == 0 {
        return None;
    }
    let (hits, n) = (n_hits.min(n) as f64, n as f64);
    let rate = hits / n;
    let spread = Z * (rate * (1.0 - rate) / n + Z * Z / (4.0 * n * n)).sqrt();
    let scale = 1.0 + Z * Z / n;
    let center = rate + Z * Z / (2.0 * n);
    Some(Interval { low: ((center - spread) / scale).max(0.0), high: ((center + spread) / scale).min(1.0) })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn matches_published_values() {
        // Newcombe (1998), table I, method 3: 81/263, 15/148, 0/20, 1/29.
        for (hits, n, low, high) in
            [(81, 263, 0.2553, 0.3662), (15, 148, 0.0624, 0.1605), (0, 20, 0.0, 0.1611), (1, 29, 0.0061, 0.1718)]
        {
            let interval = wilson_interval(hits, n).unwrap();
            assert!((interval.low - low).abs() < 5e-5, "{interval:?}");
            assert!((interval.high - high).abs() < 5e-5, "{interval:?}");
        }
        assert_eq!(wilson_interval(0, 0), None);
    }
}

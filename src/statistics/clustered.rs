//! How sure is the rate of events that come in clusters?

use super::Interval;
use super::gamma::gamma_quantile;

/// The rate of events per exposure, with its interval.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ClusteredRate {
    /// Events per exposure.
    pub rate: f64,
    /// The 95 % interval; from 0 if there were no events.
    pub interval: Interval,
    /// How many times the variance of independent events the counts of clusters vary with, at least 1; `None` if there
    /// are not two clusters to tell.
    pub dispersion: Option<f64>,
}

/// The rate in clusters, such as recordings, of (events, exposure). `None` without exposure.
///
/// Events that come together tell less than their number. Their dispersion is that of counts over clusters (Pearson's
/// χ² over its degrees of freedom; McCullagh and Nelder 1989, section 6.2): as many independent events as `n` divided
/// by it are as sure. The interval is the exact one for their number (Garwood 1936), which for a single cluster, or
/// where events do not cluster, is that of a Poisson variable.
pub fn clustered_rate(clusters: &[(u64, f64)]) -> Option<ClusteredRate> {
    let clusters: Vec<(f64, f64)> = clusters.iter().map(|(n, exposure)| (*n as f64, *exposure)).collect();
    weighted_rate(&clusters, 1.0)
}

/// The rate in clusters of (sum of the weights of events, exposure). `None` without exposure.
///
/// A sum whose variance is φ times its expectation is as sure as that many divided by φ independent events, whose
/// interval is that of Fay and Feuer (1997) for weighted sums, with φ as the largest weight. φ is the dispersion of
/// clusters, at least `least`: the sum of squared weights of independent events over that of weights.
pub fn weighted_rate(clusters: &[(f64, f64)], least: f64) -> Option<ClusteredRate> {
    let n: f64 = clusters.iter().map(|(n, _)| n).sum();
    let exposure: f64 = clusters.iter().map(|(_, exposure)| exposure).sum();
    if !(exposure > 0.0 && exposure.is_finite()) {
        return None;
    }
    let rate = n / exposure;
    let dispersion = dispersion(clusters, rate, least);
    let scale = dispersion.unwrap_or(least);
    let n_alike = n / scale;
    let end = |p: f64, shape: f64| gamma_quantile(p, shape) * scale / exposure;
    let interval = Interval { low: end(0.025, n_alike), high: end(0.975, n_alike + 1.0) };
    Some(ClusteredRate { rate, interval, dispersion })
}

/// How many times their expectation sums vary; `least` if they vary less, or there are no events.
fn dispersion(clusters: &[(f64, f64)], rate: f64, least: f64) -> Option<f64> {
    let seen = || clusters.iter().filter(|(_, exposure)| *exposure > 0.0);
    let n_free = seen().count().checked_sub(1).filter(|n_free| *n_free > 0)?;
    let of = |(n, exposure): &(f64, f64)| (n - rate * exposure).powi(2) / (rate * exposure);
    let chi_squared: f64 = if rate > 0.0 { seen().map(of).sum() } else { 0.0 };
    Some((chi_squared / n_free as f64).max(least))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(serde::Deserialize)]
    struct Case {
        name: String,
        clusters: Vec<(u64, f64)>,
        expected: (f64, f64, f64, Option<f64>),
    }

    #[test]
    fn intervals_are_those_of_scipy() {
        let cases: Vec<Case> = serde_json::from_value(crate::statistics::golden()["clusters"].clone()).unwrap();
        for Case { name, clusters, expected: (rate, low, high, dispersion) } in cases {
            let found = clustered_rate(&clusters).unwrap();
            let pairs = [
                (found.rate, rate),
                (found.interval.low, low),
                (found.interval.high, high),
                (found.dispersion.unwrap_or(-1.0), dispersion.unwrap_or(-1.0)),
            ];
            assert!(pairs.iter().all(|(a, b)| (a - b).abs() <= 1e-9 * b.abs()), "{name}: {found:?}");
        }
        assert_eq!(clustered_rate(&[(0, 0.0)]), None);
        assert_eq!(clustered_rate(&[]), None);
        // Weights, exposure, and the expected rate with its interval.
        let cases: Vec<(Vec<f64>, f64, [f64; 3])> =
            serde_json::from_value(crate::statistics::golden()["weighted"].clone()).unwrap();
        for (weights, exposure, expected) in cases {
            let sum: f64 = weights.iter().sum();
            let least = weights.iter().map(|w| w * w).sum::<f64>() / sum;
            let ClusteredRate { rate, interval, .. } = weighted_rate(&[(sum, exposure)], least).unwrap();
            let found = [rate, interval.low, interval.high];
            assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() <= 1e-9 * b), "{weights:?}: {found:?}");
        }
    }
}

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
/// Events that come together tell less than their number: as many independent events as `n` divided by their
/// dispersion are as sure. The interval is the exact one for their number (Garwood 1936), which for a single cluster,
/// or where events do not cluster, is that of a Poisson variable.
pub fn clustered_rate(clusters: &[(u64, f64)]) -> Option<ClusteredRate> {
    let clusters: Vec<(f64, f64)> = clusters.iter().map(|(n, exposure)| (*n as f64, *exposure)).collect();
    weighted_rate(&clusters, 1.0)
}

/// The rate in clusters of (sum of the weights of events, exposure). `None` without exposure.
///
/// A sum whose variance is φ times its expectation is as sure as that many divided by φ independent events, whose
/// interval is that of Fay and Feuer (1997) for weighted sums, with φ as the largest weight. φ is at least `least`: the
/// sum of squared weights of independent events over that of weights. It follows from the variance of a ratio (Cochran
/// 1977, 6.3), which asks of no cluster that its variance is what is expected of it: in recordings of seconds, or where
/// an event ends the exposure, that is next to nothing, and Pearson's χ² takes a single event there for many.
pub fn weighted_rate(clusters: &[(f64, f64)], least: f64) -> Option<ClusteredRate> {
    let n: f64 = clusters.iter().map(|(n, _)| n).sum();
    let exposure: f64 = clusters.iter().map(|(_, exposure)| exposure).sum();
    if !(exposure > 0.0 && exposure.is_finite()) {
        return None;
    }
    let rate = n / exposure;
    let seen: Vec<&(f64, f64)> = clusters.iter().filter(|(_, exposure)| *exposure > 0.0).collect();
    let dispersion = (seen.len() > 1).then(|| {
        let squares: f64 = seen.iter().map(|(n, exposure)| (n - rate * exposure).powi(2)).sum();
        let share = seen.len() as f64 / (seen.len() - 1) as f64;
        if n > 0.0 { (share * squares / n).max(least) } else { least }
    });
    let scale = dispersion.unwrap_or(least);
    let n_alike = n / scale;
    let end = |p: f64, shape: f64| gamma_quantile(p, shape) * scale / exposure;
    let interval = Interval { low: end(0.025, n_alike), high: end(0.975, n_alike + 1.0) };
    Some(ClusteredRate { rate, interval, dispersion })
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

    #[test]
    fn an_event_that_ends_its_cluster_counts_once() {
        // Four events in 10,000 clusters, each of which ends its own after a thousandth of it: as sure as four
        // independent ones (Garwood 1936: 1.090 to 10.242). With three of six in one of them, squares add up to 12.
        let clusters =
            |n: [f64; 4]| (0..10_000).map(|i| n.get(i).map_or((0.0, 1.0), |n| (*n, 1e-3))).collect::<Vec<(f64, f64)>>();
        let close = |found: f64, expected: f64| assert!((found / expected - 1.0).abs() < 2e-3, "{found}, {expected}");
        let apart = weighted_rate(&clusters([1.0; 4]), 1.0).unwrap();
        close(apart.interval.low, 1.090 / 9996.0);
        close(apart.interval.high, 10.242 / 9996.0);
        let together = weighted_rate(&clusters([3.0, 1.0, 1.0, 1.0]), 1.0).unwrap();
        close(together.dispersion.unwrap(), 12.0 / 6.0);
        // Each of two deviates by 1 from 2, and one of them is free.
        close(weighted_rate(&[(1.0, 1.0), (3.0, 1.0)], 0.1).unwrap().dispersion.unwrap(), 1.0);
    }
}

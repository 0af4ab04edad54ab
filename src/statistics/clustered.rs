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
    let n: u64 = clusters.iter().map(|(n, _)| n).sum();
    let exposure: f64 = clusters.iter().map(|(_, exposure)| exposure).sum();
    if !(exposure > 0.0 && exposure.is_finite()) {
        return None;
    }
    let rate = n as f64 / exposure;
    let dispersion = dispersion(clusters, rate);
    let scale = dispersion.unwrap_or(1.0);
    let n_alike = n as f64 / scale;
    let end = |p: f64, shape: f64| gamma_quantile(p, shape) * scale / exposure;
    let interval = Interval { low: end(0.025, n_alike), high: end(0.975, n_alike + 1.0) };
    Some(ClusteredRate { rate, interval, dispersion })
}

/// How much more than independent events counts vary; 1 if they vary less, or there are no events.
fn dispersion(clusters: &[(u64, f64)], rate: f64) -> Option<f64> {
    let seen = || clusters.iter().filter(|(_, exposure)| *exposure > 0.0);
    let n_free = seen().count().checked_sub(1).filter(|n_free| *n_free > 0)?;
    let of = |(n, exposure): &(u64, f64)| (*n as f64 - rate * exposure).powi(2) / (rate * exposure);
    let chi_squared: f64 = if rate > 0.0 { seen().map(of).sum() } else { 0.0 };
    Some((chi_squared / n_free as f64).max(1.0))
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
    }
}

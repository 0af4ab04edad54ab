//! The tail of a distribution: a generalized Pareto distribution of how far values exceed a threshold.
//!
//! Beyond a high threshold, what exceeds it by `y` has the survival function (1 + ξ y / σ)^(-1/ξ), whatever the
//! distribution below (Pickands 1975; Coles 2001, section 4.2).

use super::Interval;
use super::gamma::distribution as gamma_distribution;
use std::collections::BTreeMap;

/// Shapes for which maximum likelihood is regular (Smith 1985), and above which nothing is fitted.
const SHAPES: [f64; 2] = [-0.5, 1.0];
/// Half of the 95 % quantile of χ² with one degree of freedom: how much lower the log likelihood is at the ends of a
/// profile-likelihood interval.
const DROP: f64 = 1.920_729_410_347_062;
/// The least survival that is looked at, as a logarithm.
const LEAST_LN_SURVIVAL: f64 = -40.0;

/// A generalized Pareto distribution that was fitted to exceedances.
#[derive(Debug, Clone, PartialEq)]
pub struct Pareto {
    /// The shape ξ: below 0 the tail ends.
    pub shape: f64,
    /// The scale σ.
    pub scale: f64,
    exceedances: Vec<f64>,
}

impl Pareto {
    /// The most likely distribution of these exceedances, which are positive. `None` if there are fewer than two, or
    /// its shape is at an end of what can be fitted.
    pub fn fit(exceedances: Vec<f64>) -> Option<Self> {
        let most = exceedances.iter().copied().fold(0.0, f64::max);
        if exceedances.len() < 2 || !(most > 0.0 && most.is_finite()) {
            return None;
        }
        // For each shape the best scale is found; likelihoods of a fixed shape have one peak.
        let of_shape = |shape: f64| {
            let least = if shape < 0.0 { -shape * most * (1.0 + 1e-9) } else { most * 1e-6 };
            let scale =
                peak([least.ln(), (10.0 * most).ln()], |scale| log_likelihood(&exceedances, shape, scale.exp()));
            (scale.0.exp(), scale.1)
        };
        let (shape, _) = peak(SHAPES, |shape| of_shape(shape).1);
        let is_inside = SHAPES[0] + 1e-3 < shape && shape < SHAPES[1] - 1e-3;
        let scale = of_shape(shape).0;
        is_inside.then_some(Self { shape, scale, exceedances })
    }

    /// How many times the variance of independent exceedances the logarithm of the survival at `y` has, at least 1,
    /// where those of one cluster are alike: exceedance `i` is of `clusters[i]`. What each adds to the estimate, its
    /// score by the expected information (Smith 1985), is summed within clusters (Chandler and Bate 2007). Exceedances
    /// that come together, but are not alike, tell as much as others.
    pub fn dispersion(&self, y: f64, clusters: &[usize]) -> f64 {
        // Slopes by the shape and by the logarithm of the scale; the limit of shape 0 is approached.
        let shape = if self.shape.abs() < 1e-4 { 1e-4 } else { self.shape };
        let slopes = |y: f64| {
            let z = y / self.scale;
            let inner = (1.0 + shape * z).max(1e-9);
            [inner.ln() / (shape * shape) - z / (shape * inner), z / inner]
        };
        let [by_shape, by_scale] = slopes(y);
        let factors = [(1.0 + shape) * by_shape - by_scale, 2.0 * by_scale - by_shape];
        let added = |y: &f64| {
            // The log density is 1 + ξ times the log survival, less ln σ.
            let [by_shape, by_scale] = slopes(*y);
            let score = [(1.0 + shape) * by_shape + ln_survival(*y, shape, self.scale), (1.0 + shape) * by_scale - 1.0];
            factors[0] * score[0] + factors[1] * score[1]
        };
        let added: Vec<f64> = self.exceedances.iter().map(added).collect();
        let mean = added.iter().sum::<f64>() / added.len() as f64;
        let mut sums: BTreeMap<usize, f64> = BTreeMap::new();
        added.iter().zip(clusters).for_each(|(added, cluster)| *sums.entry(*cluster).or_default() += added - mean);
        let together: f64 = sums.values().map(|sum| sum * sum).sum();
        let alone: f64 = added.iter().map(|added| (added - mean).powi(2)).sum();
        let n = sums.len() as f64;
        if sums.len() > 1 { (together / alone * n / (n - 1.0)).max(1.0) } else { 1.0 }
    }

    /// The probability that an exceedance is above `y`, with its profile-likelihood interval (Coles 2001, section
    /// 4.3.3), whose log likelihood is divided by the [`dispersion`](Self::dispersion).
    pub fn survival(&self, y: f64, dispersion: f64) -> (f64, Interval) {
        let best = log_likelihood(&self.exceedances, self.shape, self.scale);
        let ln_estimate = ln_survival(y, self.shape, self.scale).max(LEAST_LN_SURVIVAL);
        // The likelihood of the best distribution with this survival at `y`.
        let profile = |ln_p: f64| {
            let of_shape = |shape: f64| {
                let scale = if shape.abs() < 1e-9 { -y / ln_p } else { shape * y / (-shape * ln_p).exp_m1() };
                log_likelihood(&self.exceedances, shape, scale)
            };
            peak(SHAPES, of_shape).1
        };
        let is_inside = |ln_p: f64| best - profile(ln_p) < DROP * dispersion;
        let low = match is_inside(LEAST_LN_SURVIVAL) {
            true => 0.0,
            false => edge([ln_estimate, LEAST_LN_SURVIVAL], is_inside).exp(),
        };
        let high = edge([ln_estimate, -1e-9], is_inside).exp();
        (ln_survival(y, self.shape, self.scale).exp(), Interval { low, high })
    }

    /// The statistic of Anderson and Darling, which weighs the tail: the less, the better the fit.
    pub fn anderson_darling(&self) -> f64 {
        let mut sorted = self.exceedances.clone();
        sorted.sort_by(f64::total_cmp);
        let n = sorted.len();
        let ln_above: Vec<f64> = sorted.iter().map(|y| ln_survival(*y, self.shape, self.scale)).collect();
        let terms = (0..n).map(|i| {
            let ln_below = (-ln_above[i].exp()).ln_1p();
            (2 * i + 1) as f64 * (ln_below + ln_above[n - 1 - i])
        });
        -(n as f64) - terms.sum::<f64>() / n as f64
    }

    /// Whether the fit is not rejected at the 10 % level.
    pub fn is_good(&self) -> bool {
        self.anderson_darling() < critical_value(self.shape)
    }

    /// The least probability, over `k` from 2 to half of the exceedances, that the `k` largest together come so close
    /// to the next one. On the scale of the logarithm of the fitted survival, exceedances are exponential variables,
    /// and the distances of their `k` largest from the next one sum up to a gamma variable of shape `k` (Rényi 1953).
    pub fn crowding(&self) -> f64 {
        let mut scaled: Vec<f64> = self.exceedances.iter().map(|y| -ln_survival(*y, self.shape, self.scale)).collect();
        scaled.sort_by(|a, b| b.total_cmp(a));
        let mut sum = scaled[0];
        let mut least = 1.0_f64;
        for k in 2..=scaled.len() / 2 {
            sum += scaled[k - 1];
            least = least.min(gamma_distribution(sum - k as f64 * scaled[k], k as f64));
        }
        least
    }

    /// Whether the largest exceedances crowd, as where they reach a limit: closer together than in 95 % of samples of
    /// the fitted distribution. The fit of all exceedances hardly sees the few at a limit, but what is beyond them
    /// hangs on it.
    pub fn is_crowded(&self) -> bool {
        self.crowding() < critical_crowding(self.exceedances.len(), self.shape)
    }
}

/// The value that the statistic of Anderson and Darling exceeds in 10 % of samples of a distribution of this shape
/// (simulated by `scripts/golden_rates.py`, as Choulakian and Stephens 2001 do).
fn critical_value(shape: f64) -> f64 {
    between(&CRITICAL, (shape - SHAPES[0]) / STEP)
}

/// The crowding that 5 % of samples of so many exceedances of a distribution of this shape fall below, simulated so.
fn critical_crowding(n: usize, shape: f64) -> f64 {
    let of_shape = CRITICAL_CROWDING.map(|values| between(&values, (shape - SHAPES[0]) / STEP));
    between(&of_shape, 2.0 * (n as f64 / LEAST_SIZE).log10())
}

/// Linear between values, whose ends go on.
fn between(values: &[f64], at: f64) -> f64 {
    let at = at.clamp(0.0, (values.len() - 1) as f64);
    let below = (at as usize).min(values.len() - 2);
    values[below] + (values[below + 1] - values[below]) * (at - below as f64)
}

/// Steps of shapes for which critical values are known, from the least shape on.
const STEP: f64 = 0.25;
const CRITICAL: [f64; 7] = [0.937, 0.858, 0.78, 0.741, 0.691, 0.65, 0.641];
/// The first number of exceedances for which critical crowdings are known; the others follow by half orders of
/// magnitude.
const LEAST_SIZE: f64 = 30.0;
/// For shapes up to 0.5, whose values heavier tails have, too.
const CRITICAL_CROWDING: [[f64; 5]; 4] = [
    [0.12, 0.12, 0.088, 0.072, 0.058],
    [0.053, 0.044, 0.032, 0.021, 0.021],
    [0.029, 0.021, 0.017, 0.012, 0.01],
    [0.017, 0.013, 0.01, 0.0074, 0.0074],
];

fn ln_survival(y: f64, shape: f64, scale: f64) -> f64 {
    match shape.abs() < 1e-9 {
        true => -y / scale,
        false => {
            let inner = shape * y / scale;
            if inner <= -1.0 { f64::NEG_INFINITY } else { -inner.ln_1p() / shape }
        }
    }
}

fn log_likelihood(exceedances: &[f64], shape: f64, scale: f64) -> f64 {
    if !(scale > 0.0 && scale.is_finite()) {
        return f64::NEG_INFINITY;
    }
    // The density is the survival to the power 1 + ξ, per σ.
    let sum: f64 = exceedances.iter().map(|y| ln_survival(*y, shape, scale)).sum();
    if sum == f64::NEG_INFINITY { sum } else { (1.0 + shape) * sum - exceedances.len() as f64 * scale.ln() }
}

/// Where a function with one peak is largest between two ends, and its value there: on a grid, then by the golden
/// section between the neighbors of its best point.
fn peak([low, high]: [f64; 2], value: impl Fn(f64) -> f64) -> (f64, f64) {
    const POINTS: usize = 24;
    let at = |i: usize| low + (high - low) * i as f64 / POINTS as f64;
    let mut best = (low, value(low));
    for i in 1..=POINTS {
        let found = (at(i), value(at(i)));
        if found.1 > best.1 {
            best = found;
        }
    }
    let step = (high - low) / POINTS as f64;
    let (mut a, mut b) = ((best.0 - step).max(low), (best.0 + step).min(high));
    let golden = 0.5 * (5.0_f64.sqrt() - 1.0);
    for _ in 0..45 {
        let (left, right) = (b - golden * (b - a), a + golden * (b - a));
        if value(left) < value(right) { a = left } else { b = right }
    }
    let middle = 0.5 * (a + b);
    let found = (middle, value(middle));
    if found.1 > best.1 { found } else { best }
}

/// Where a condition that holds at the first end ceases to hold toward the second; the second where it never does.
fn edge([mut inside, mut outside]: [f64; 2], is_inside: impl Fn(f64) -> bool) -> f64 {
    if is_inside(outside) {
        return outside;
    }
    for _ in 0..50 {
        let middle = 0.5 * (inside + outside);
        if is_inside(middle) { inside = middle } else { outside = middle }
    }
    inside
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(serde::Deserialize)]
    struct Case {
        name: String,
        exceedances: Vec<f64>,
        /// Shape and scale.
        fit: [f64; 2],
        anderson_darling: f64,
        crowding: f64,
        /// Where, the dispersion, survival, and the ends of its interval.
        survival: Vec<[f64; 5]>,
        /// Where, the number of clusters of exceedances that follow each other, and the dispersion.
        clustered: Vec<(f64, usize, f64)>,
    }

    #[test]
    fn fits_and_intervals_are_those_of_scipy() {
        let cases: Vec<Case> = serde_json::from_value(crate::statistics::golden()["tails"].clone()).unwrap();
        for case in cases {
            let n = case.exceedances.len();
            let fitted = Pareto::fit(case.exceedances).unwrap();
            let close = |a: f64, b: f64| (a - b).abs() <= 2e-3 * b.abs() + 1e-9;
            assert!((fitted.shape - case.fit[0]).abs() < 1e-3 && close(fitted.scale, case.fit[1]), "{}", case.name);
            assert!(close(fitted.anderson_darling(), case.anderson_darling), "{}", case.name);
            assert!(close(fitted.crowding(), case.crowding) && !fitted.is_crowded(), "{}", case.name);
            for [y, dispersion, survival, low, high] in case.survival {
                let (found, interval) = fitted.survival(y, dispersion);
                let all = close(found, survival) && close(interval.low, low) && close(interval.high, high);
                assert!(all, "{} at {y}: {found}, {interval:?}", case.name);
            }
            for (y, n_clusters, dispersion) in case.clustered {
                let clusters: Vec<usize> = (0..n).map(|i| i * n_clusters / n).collect();
                let found = fitted.dispersion(y, &clusters);
                assert!((found / dispersion - 1.0).abs() < 0.01, "{} at {y}: {found}, not {dispersion}", case.name);
            }
        }
        assert_eq!(Pareto::fit(vec![1.0]), None);
    }

    #[test]
    fn critical_values_are_the_simulated_ones() {
        let simulated: Vec<f64> = serde_json::from_value(crate::statistics::golden()["critical"].clone()).unwrap();
        assert_eq!(CRITICAL.to_vec(), simulated);
        assert!((critical_value(-0.375) - 0.5 * (CRITICAL[0] + CRITICAL[1])).abs() < 1e-12);
        let simulated: Vec<[f64; 5]> =
            serde_json::from_value(crate::statistics::golden()["crowding_critical"].clone()).unwrap();
        assert_eq!(CRITICAL_CROWDING.to_vec(), simulated);
        let [.., of_300, of_949] = CRITICAL_CROWDING;
        let middle = 0.25 * (of_300[2] + of_300[3] + of_949[2] + of_949[3]);
        let cases = [(5, -0.9, CRITICAL_CROWDING[0][0]), (300, 0.0, of_300[2]), (9999, 0.9, of_949[4])];
        for (n, shape, expected) in cases {
            assert!((critical_crowding(n, shape) - expected).abs() < 1e-12, "{n}, {shape}");
        }
        assert!((critical_crowding(533, 0.125) / middle - 1.0).abs() < 1e-2);
    }

    #[test]
    fn the_largest_crowd_at_a_limit_and_seldom_without_one() {
        let mut rng = crate::seed::Seed(3).rng();
        let mut n_crowded = |n: usize, limit: f64| {
            let is_crowded = |_| {
                let sample = (0..n).map(|_| (-(1.0 - rng.uniform()).ln()).min(limit)).collect();
                Pareto::fit(sample).filter(Pareto::is_good).map(|fitted| fitted.is_crowded())
            };
            let found: Vec<bool> = (0..60).filter_map(is_crowded).collect();
            [found.iter().filter(|is_crowded| **is_crowded).count(), found.len()]
        };
        // A twentieth of the values is at the limit.
        let at_limit = n_crowded(100, 3.0);
        assert!(at_limit[1] >= 20 && at_limit[0] * 10 >= 9 * at_limit[1], "{at_limit:?}");
        let [n, of] = n_crowded(100, f64::INFINITY);
        assert!(of >= 45 && n * 10 <= of, "{n} of {of}");
    }
}

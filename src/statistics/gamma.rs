//! The gamma distribution of scale 1: its distribution function and its quantiles.

/// Terms after which series end in any case.
const MAX_TERMS: usize = 10_000;

/// The value that a gamma variable of this shape stays below with probability `p` in (0, 1); 0 for shape 0.
///
/// Half of the quantile of a χ² variable with `2 * shape` degrees of freedom.
pub(super) fn gamma_quantile(p: f64, shape: f64) -> f64 {
    if shape <= 0.0 {
        return 0.0;
    }
    let (mut low, mut high) = (0.0, shape + 1.0);
    while distribution(high, shape) < p && high.is_finite() {
        (low, high) = (high, 2.0 * high);
    }
    // Bisection, until the ends agree; quantiles near zero need more steps than the 53 of their digits, and some are
    // less than numbers can be.
    while high - low > 4.0 * f64::EPSILON * high && high > f64::MIN_POSITIVE {
        let middle = 0.5 * (low + high);
        if distribution(middle, shape) < p { low = middle } else { high = middle }
    }
    0.5 * (low + high)
}

/// The probability that a gamma variable of this shape is at most `x`: the regularized lower incomplete gamma function,
/// by its series and its continued fraction (Abramowitz and Stegun 6.5.29 and 6.5.31).
pub(super) fn distribution(x: f64, shape: f64) -> f64 {
    if x <= 0.0 {
        return 0.0;
    }
    let scale = (shape * x.ln() - x - ln_gamma(shape)).exp();
    if x < shape + 1.0 {
        let (mut term, mut sum) = (1.0 / shape, 1.0 / shape);
        for i in 1..MAX_TERMS {
            term *= x / (shape + i as f64);
            sum += term;
            if term < sum * f64::EPSILON {
                break;
            }
        }
        return (sum * scale).min(1.0);
    }
    // Lentz's algorithm.
    let mut b = x + 1.0 - shape;
    let (mut c, mut d) = (f64::MAX, 1.0 / b);
    let mut fraction = d;
    for i in 1..MAX_TERMS {
        let a = -(i as f64) * (i as f64 - shape);
        b += 2.0;
        d = 1.0 / (a * d + b);
        c = b + a / c;
        fraction *= c * d;
        if (c * d - 1.0).abs() < 4.0 * f64::EPSILON {
            break;
        }
    }
    (1.0 - scale * fraction).max(0.0)
}

/// The logarithm of the gamma function for positive values, by Stirling's series (Abramowitz and Stegun 6.1.41), to
/// 1e-13.
fn ln_gamma(x: f64) -> f64 {
    const COEFFICIENTS: [f64; 6] =
        [1.0 / 12.0, -1.0 / 360.0, 1.0 / 1260.0, -1.0 / 1680.0, 1.0 / 1188.0, -691.0 / 360_360.0];
    // The series is exact enough from here on; Γ(x + 1) = x Γ(x) leads there.
    let (mut x, mut below) = (x, 0.0);
    while x < 12.0 {
        below += x.ln();
        x += 1.0;
    }
    let series = COEFFICIENTS.iter().rev().fold(0.0, |sum, coefficient| sum / (x * x) + coefficient) / x;
    (x - 0.5) * x.ln() - x + 0.5 * (2.0 * std::f64::consts::PI).ln() + series - below
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_those_of_scipy() {
        let golden: serde_json::Value = crate::statistics::golden();
        let rows: Vec<[f64; 3]> = serde_json::from_value(golden["gamma"].clone()).unwrap();
        for [p, shape, expected] in rows {
            let found = gamma_quantile(p, shape);
            assert!((found / expected - 1.0).abs() < 1e-9, "{p} of {shape}: {found}, expected {expected}");
        }
        assert_eq!(gamma_quantile(0.025, 0.0), 0.0);
        // About 0.025 to the power of 1 / shape, which is less than numbers can be.
        assert!(gamma_quantile(0.025, 1e-3) <= f64::MIN_POSITIVE);
    }
}

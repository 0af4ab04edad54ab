//! Draws from beta and gamma distributions, the posteriors of rates.

use crate::seed::SeededRng;

/// A draw from Beta(a, b); a and b are positive, and at least one of them is no tiny fraction.
pub(super) fn beta(rng: &mut SeededRng, a: f64, b: f64) -> f64 {
    let (x, y) = (gamma(rng, a), gamma(rng, b));
    x / (x + y)
}

/// A draw from the gamma distribution of this shape and scale 1 (Marsaglia and Tsang, 2000).
pub(super) fn gamma(rng: &mut SeededRng, shape: f64) -> f64 {
    if shape < 1.0 {
        // Gamma(a) is Gamma(a + 1) times U^(1/a).
        let u = 1.0 - rng.uniform();
        return gamma(rng, shape + 1.0) * u.powf(1.0 / shape);
    }
    let d = shape - 1.0 / 3.0;
    let c = 1.0 / (9.0 * d).sqrt();
    loop {
        let x = rng.normal();
        let v = (1.0 + c * x).powi(3);
        let u = 1.0 - rng.uniform();
        if v > 0.0 && u.ln() < 0.5 * x * x + d - d * v + d * v.ln() {
            return d * v;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::seed::Seed;

    /// Mean a / (a + b) and variance ab / ((a + b)² (a + b + 1)), within four standard errors of the sample mean and 5
    /// % of the variance.
    #[test]
    fn draws_have_the_moments_of_the_distribution() {
        for (i, (a, b)) in [(0.5, 0.5), (1.0, 1.0), (2.0, 8.0), (0.05, 4.0), (40.0, 3.0)].into_iter().enumerate() {
            let mut rng = Seed(3).derive("beta", &[i as u64]).rng();
            let n = 60_000;
            let draws: Vec<f64> = (0..n).map(|_| beta(&mut rng, a, b)).collect();
            assert!(draws.iter().all(|draw| (0.0..=1.0).contains(draw)));
            let mean = draws.iter().sum::<f64>() / f64::from(n);
            let variance = draws.iter().map(|draw| (draw - mean).powi(2)).sum::<f64>() / f64::from(n);
            let expected = a / (a + b);
            let expected_variance = a * b / ((a + b) * (a + b) * (a + b + 1.0));
            let error = (expected_variance / f64::from(n)).sqrt();
            assert!((mean - expected).abs() < 4.0 * error, "Beta({a}, {b}): mean {mean}");
            assert!((variance / expected_variance - 1.0).abs() < 0.05, "Beta({a}, {b}): variance {variance}");
        }
    }
}

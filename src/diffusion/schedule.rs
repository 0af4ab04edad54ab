//! At which noise levels does a sampler stop on its way to 0? (EDM, equation 5.)

/// Noise levels of `n_steps` steps: σ_i = (σ_max^(1/ρ) + i / (N - 1) (σ_min^(1/ρ) - σ_max^(1/ρ)))^ρ for i < N, and 0 at
/// the end, `n_steps + 1` values in all. With one step it is σ_max and 0; with none, only 0.
pub fn karras_schedule(sigma_min: f64, sigma_max: f64, rho: f64, n_steps: usize) -> Vec<f64> {
    let (from, to) = (sigma_max.powf(rho.recip()), sigma_min.powf(rho.recip()));
    let n_intervals = n_steps.saturating_sub(1).max(1) as f64;
    let positive = (0..n_steps).map(|i| match i {
        // The ends as given rather than through two powers: they are compared with the configured values elsewhere.
        0 => sigma_max,
        i if i + 1 == n_steps => sigma_min,
        i => (from + i as f64 / n_intervals * (to - from)).powf(rho),
    });
    positive.chain([0.0]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn strictly_decreasing_to_zero(
            n_steps in 1..200usize,
            sigma_min in 1e-4..1e-2f64,
            sigma_max in 0.1..200.0f64,
            rho in 1.0..10.0f64,
        ) {
            let sigmas = karras_schedule(sigma_min, sigma_max, rho, n_steps);
            prop_assert_eq!(sigmas.len(), n_steps + 1);
            prop_assert_eq!(sigmas[0], sigma_max);
            prop_assert_eq!(sigmas[n_steps], 0.0);
            prop_assert!(sigmas.windows(2).all(|pair| pair[0] > pair[1]));
            prop_assert!(n_steps == 1 || sigmas[n_steps - 1] == sigma_min);
        }
    }

    #[test]
    fn rho_of_one_is_an_even_grid() {
        let sigmas = karras_schedule(1.0, 5.0, 1.0, 5);
        for (sigma, expected) in sigmas.iter().zip([5.0, 4.0, 3.0, 2.0, 1.0, 0.0]) {
            assert!((sigma - expected).abs() < 1e-12);
        }
    }

    #[test]
    fn no_steps_leave_only_the_end() {
        assert_eq!(karras_schedule(0.002, 80.0, 7.0, 0), [0.0]);
    }
}

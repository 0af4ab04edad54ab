//! Do groups of particles follow the tilted distribution? Checked on a mixture whose tilt is known in closed form.

use super::*;
use crate::diffusion::analytic::{Component, GaussianMixture, MixtureDenoiser};
use crate::diffusion::sampler::{ConsistencyConfig, Dpmpp2mConfig, HeunConfig};
use crate::diffusion::{Edm, NoiseSource, SamplerConfig};
use candle_core::{DType, Device};

/// J(x₀) = c · x₀.
struct Slope([f64; 2]);

impl CleanPotential for Slope {
    fn log_potential(&self, x0: &Tensor) -> Result<Tensor> {
        x0.broadcast_mul(&Tensor::new(&[self.0], x0.device())?)?.sum(1)
    }
}

/// Tells potentials of steps that are never sampled: the first number of each row.
struct First;

impl CleanPotential for First {
    fn log_potential(&self, x0: &Tensor) -> Result<Tensor> {
        x0.narrow(1, 0, 1)?.squeeze(1)
    }
}

const SLOPE: [f64; 2] = [2.0, -1.5];

fn mixture() -> GaussianMixture {
    GaussianMixture {
        components: vec![
            Component { weight: 0.6, mean: vec![-0.6, 0.2], variance: vec![0.04, 0.02] },
            Component { weight: 0.4, mean: vec![0.4, -0.1], variance: vec![0.03, 0.09] },
        ],
    }
}

/// The mixture times exp(s c · x): weights w exp(s c · μ + s² c · Σ c / 2), means μ + s Σ c, the same covariances.
fn tilted(strength: f64) -> GaussianMixture {
    let components = mixture().components.into_iter().map(|component| {
        let c = SLOPE.map(|slope| strength * slope);
        let exponent: f64 = (0..2).map(|i| c[i] * component.mean[i] + 0.5 * c[i] * c[i] * component.variance[i]).sum();
        let mean = (0..2).map(|i| component.mean[i] + component.variance[i] * c[i]).collect();
        Component { weight: component.weight * exponent.exp(), mean, variance: component.variance }
    });
    GaussianMixture { components: components.collect() }
}

fn group_seeds(n_groups: u64) -> Vec<Seed> {
    (0..n_groups).map(|group| Seed(7).derive("group", &[group])).collect()
}

fn stochastic(n_steps: usize) -> SamplerConfig {
    SamplerConfig::Dpmpp2m(Dpmpp2mConfig { n_steps, eta: 1.0, ..Dpmpp2mConfig::default() })
}

/// Samples of the groups with these seeds, and the weight of each within its group.
fn sample(sampler: &SamplerConfig, config: &ParticleConfig, seeds: Vec<Seed>) -> Vec<(Vec<f64>, f64)> {
    let denoiser = MixtureDenoiser::new(&mixture(), DType::F64).unwrap();
    let of_group = |seed: &Seed| (0..config.n as u64).map(|i| seed.derive("particle", &[i])).collect::<Vec<_>>();
    let mut noise = NoiseSource::new(seeds.iter().flat_map(of_group).collect());
    let n_groups = seeds.len();
    let mut particles = Particles::new(config, &Slope(SLOPE), seeds);
    let x = (noise.draw(&[2], DType::F64, &Device::Cpu).unwrap() * 80.0).unwrap();
    let sigmas = sampler.schedule(&Edm::default(), 80.0);
    let mut resampler = |going: &Going<'_>| particles.step(going);
    let x = sampler.integrate_resampled(&sigmas, &denoiser, x, &mut noise, &mut resampler, &mut |_| {}).unwrap();
    let weights = (0..n_groups).flat_map(|group| particles.weights(group));
    x.to_vec2::<f64>().unwrap().into_iter().zip(weights).collect()
}

/// The mean and the share of the left component; `is_weighted` by the weights that are left, or equally.
fn summary(samples: &[(Vec<f64>, f64)], is_weighted: bool) -> [f64; 3] {
    let weight = |own: f64| if is_weighted { own } else { 1.0 };
    let total: f64 = samples.iter().map(|(_, own)| weight(*own)).sum();
    let mean =
        |value: &dyn Fn(&[f64]) -> f64| samples.iter().map(|(x, own)| weight(*own) * value(x)).sum::<f64>() / total;
    // The components are five standard deviations apart in the first dimension.
    [mean(&|x| x[0]), mean(&|x| x[1]), mean(&|x| f64::from(u8::from(x[0] < -0.08)))]
}

fn expected(strength: f64) -> [f64; 3] {
    let tilted = tilted(strength);
    let share = tilted.components[0].weight / tilted.components.iter().map(|c| c.weight).sum::<f64>();
    [tilted.mean()[0], tilted.mean()[1], share]
}

fn assert_close(found: [f64; 3], expected: [f64; 3], tolerance: f64, what: &str) {
    let is_close = found.iter().zip(expected).all(|(found, expected)| (found - expected).abs() < tolerance);
    assert!(is_close, "{what}: {found:?}, expected {expected:?}");
}

#[test]
fn groups_follow_the_tilted_distribution() {
    // 500 groups of 16: the standard error of the mean is 0.01, and the bias of order 1/16 about as large.
    let config = ParticleConfig { n: 16, strength: 1.0, resample_below: 1.0 };
    let churned = HeunConfig { s_churn: 30.0, s_tmin: 0.02, s_tmax: None, ..HeunConfig::with_steps(40) };
    for sampler in [stochastic(60), SamplerConfig::Heun(churned)] {
        let samples = sample(&sampler, &config, group_seeds(500));
        assert_close(summary(&samples, false), expected(1.0), 0.04, &sampler.name());
        // Where groups are resampled seldom, samples with the weights that are left.
        let seldom = sample(&sampler, &ParticleConfig { resample_below: 0.5, ..config }, group_seeds(500));
        assert_close(summary(&seldom, true), expected(1.0), 0.04, &sampler.name());
    }
    let half = sample(&stochastic(60), &ParticleConfig { strength: 0.5, ..config }, group_seeds(500));
    assert_close(summary(&half, false), expected(0.5), 0.04, "half the strength");
    // One particle cannot be tilted: it follows the mixture itself, far away.
    let alone = sample(&stochastic(60), &ParticleConfig { n: 1, ..config }, group_seeds(4000));
    assert_close(summary(&alone, true), expected(0.0), 0.04, "groups of one");
    assert!((expected(1.0)[0] - expected(0.0)[0]).abs() > 0.4);
    // The error decreases with the number of particles.
    let error = |n: usize| {
        let samples = sample(&stochastic(30), &ParticleConfig { n, ..config }, group_seeds(4000 / n as u64));
        (summary(&samples, false)[0] - expected(1.0)[0]).abs()
    };
    let errors = [1, 2, 4].map(error);
    assert!(errors[0] > errors[1] && errors[1] > errors[2] && errors[2] > 0.03, "{errors:?}");
}

#[test]
fn a_group_is_the_same_alone_and_among_others() {
    let config = ParticleConfig { n: 4, strength: 2.0, resample_below: 0.7 };
    for sampler in
        [stochastic(10), SamplerConfig::Consistency(ConsistencyConfig { sigma_max: None, levels: vec![5.0, 0.8, 0.1] })]
    {
        let together = sample(&sampler, &config, group_seeds(5));
        let alone = sample(&sampler, &config, vec![group_seeds(5)[3]]);
        assert_eq!(together[12..16], alone[..]);
        assert_eq!(together, sample(&sampler, &config, group_seeds(5)));
    }
}

/// The rows that go on after steps with these estimates.
fn rows(config: &ParticleConfig, steps: &[&[f64]]) -> Vec<Option<Vec<u32>>> {
    let mut particles = Particles::new(config, &First, group_seeds((steps[0].len() / config.n) as u64));
    let step = |values: &&[f64]| {
        let x0_hat = Tensor::from_slice(values, (values.len(), 1), &Device::Cpu).unwrap();
        let going = Going { sigma: 1.0, x0_hat: &x0_hat, adds_noise: true };
        particles.step(&going).unwrap().map(|rows| rows.to_vec1().unwrap())
    };
    steps.iter().map(step).collect()
}

#[test]
fn a_group_is_resampled_when_few_of_its_particles_count() {
    let config = ParticleConfig { n: 2, strength: 1.0, resample_below: 0.6 };
    // Weights 1 and e⁻¹ count as (1 + e⁻¹)² / (1 + e⁻²) = 1.65 particles; below 1.2 a group is resampled.
    assert_eq!(rows(&config, &[&[0.0, -1.0, 0.0, -1.0], &[0.0, -1.0, -9.0, 0.0]]), [None, Some(vec![0, 1, 3, 3])]);
    // Increases count since the group was resampled last, not once more.
    assert_eq!(rows(&config, &[&[0.0, -9.0], &[-0.5, -0.5], &[-9.0, 0.0]]), [Some(vec![0, 0]), None, Some(vec![1, 1])]);
    // Strength multiplies them.
    assert_eq!(rows(&ParticleConfig { strength: 0.01, ..config }, &[&[0.0, -9.0]]), [None]);
    // What is not finite dies out, and where nothing is finite, all go on.
    assert_eq!(rows(&config, &[&[f64::NAN, -50.0]]), [Some(vec![1, 1])]);
    assert_eq!(rows(&config, &[&[f64::NAN, f64::INFINITY]]), [None]);
}

#[test]
fn another_number_of_rows_is_an_error() {
    let config = ParticleConfig::default();
    let mut particles = Particles::new(&config, &First, group_seeds(2));
    let x0_hat = Tensor::zeros((6, 1), DType::F64, &Device::Cpu).unwrap();
    let message = particles.step(&Going { sigma: 1.0, x0_hat: &x0_hat, adds_noise: true }).unwrap_err().to_string();
    assert!(message.contains("8 particles were announced for a batch of 6 rows"), "{message}");
}

#[test]
fn resampling_is_unbiased() {
    let weights = [0.05, 0.4, 0.0, 0.25, 0.3];
    let n_draws = 2000;
    let mut total = [0usize; 5];
    for draw in 0..n_draws {
        let counts = systematic(&weights, (f64::from(draw) + 0.5) / f64::from(n_draws));
        assert_eq!(counts.iter().sum::<usize>(), 5);
        for (i, count) in counts.iter().enumerate() {
            assert!((*count as f64 - 5.0 * weights[i]).abs() < 1.0, "{counts:?}");
            total[i] += count;
        }
    }
    for (total, weight) in total.iter().zip(weights) {
        assert!((*total as f64 / f64::from(n_draws) - 5.0 * weight).abs() < 1e-3, "{total} for {weight}");
    }
    assert_eq!(in_place(&[0, 3, 0, 1, 1]), [1, 1, 1, 3, 4]);
}

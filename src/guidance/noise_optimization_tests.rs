//! Does the noise move as derivatives say, to where theory puts the optimum, and no further?

use super::*;
use crate::diffusion::analytic::{Component, GaussianMixture, MixtureDenoiser};
use crate::diffusion::sampler::EulerConfig;
use crate::diffusion::{NoiseSource, SamplerConfig};
use crate::seed::Seed;
use candle_core::{DType, Device};

const SIGMAS: [f64; 3] = [20.0, 1.5, 0.0];

/// J(x₀) = -½ |x₀ - wanted|².
struct Near(Vec<f64>);

impl CleanPotential for Near {
    fn log_potential(&self, x0: &Tensor) -> Result<Tensor> {
        let x0 = x0.flatten_from(1)?;
        let wanted = Tensor::from_slice(&self.0, (1, self.0.len()), x0.device())?;
        x0.broadcast_sub(&wanted)?.sqr()?.sum(1)? * -0.5
    }
}

fn component(weight: f64, mean: &[f64], variance: f64) -> Component {
    Component { weight, mean: mean.to_vec(), variance: vec![variance; mean.len()] }
}

fn denoiser(components: Vec<Component>) -> MixtureDenoiser {
    MixtureDenoiser::new(&GaussianMixture { components }, DType::F64).unwrap()
}

fn noise(n_rows: u64, dims: &[usize]) -> Tensor {
    let seeds = (0..n_rows).map(|row| Seed(3).derive("row", &[row])).collect();
    NoiseSource::new(seeds).draw(dims, DType::F64, &Device::Cpu).unwrap()
}

fn values(x: &Tensor) -> Vec<f64> {
    x.flatten_all().unwrap().to_vec1().unwrap()
}

/// J of one row of noise.
fn potential_of(denoiser: &dyn Denoiser, wanted: &Near, z: &Tensor) -> f64 {
    let x = (z * SIGMAS[0]).unwrap();
    let euler = SamplerConfig::Euler(EulerConfig::default());
    let x0 = euler.integrate(&SIGMAS, denoiser, x, &mut NoiseSource::new(Vec::new()), &mut |_| {}).unwrap();
    values(&wanted.log_potential(&x0).unwrap())[0]
}

#[test]
fn gradients_through_the_sampler_are_its_slopes() {
    let denoiser = denoiser(vec![component(0.4, &[-0.5, 0.1, 0.3], 0.05), component(0.6, &[0.4, -0.2, 0.0], 0.1)]);
    let (wanted, z) = (Near(vec![0.1, 0.4, -0.3]), noise(1, &[1, 3]));
    let var = Var::from_tensor(&z).unwrap();
    let x = (var.as_tensor() * SIGMAS[0]).unwrap();
    let x0 = EulerConfig::integrate_differentiably(&SIGMAS, &denoiser, x).unwrap();
    let gradients = wanted.log_potential(&x0).unwrap().sum_all().unwrap().backward().unwrap();
    let found = values(gradients.get(&var).unwrap());
    let h = 1e-5;
    for i in 0..3 {
        let step: Vec<f64> = (0..3).map(|j| if i == j { h } else { 0.0 }).collect();
        let step = Tensor::from_vec(step, (1, 1, 3), &Device::Cpu).unwrap();
        let at = |z: Result<Tensor>| potential_of(&denoiser, &wanted, &z.unwrap());
        let expected = (at(&z + &step) - at(&z - &step)) / (2.0 * h);
        assert!((found[i] - expected).abs() < 1e-6 * expected.abs().max(1.0), "{found:?}, {expected} at {i}");
    }
    assert!(found.iter().any(|slope| slope.abs() > 1e-2), "{found:?}: flat functions have any gradient");
}

/// Data N(μ, v): each step is linear, so x₀ = a z + b, and on the sphere |z| = r the best noise is r (wanted - b) / |wanted - b|.
#[test]
fn the_optimum_of_a_linear_denoiser_is_found() {
    let (mean, variance) = ([0.2, -0.1, 0.4], 0.25);
    let denoiser = denoiser(vec![component(1.0, &mean, variance)]);
    let wanted = [0.9, 0.6, -0.5];
    let (mut a, mut b) = (SIGMAS[0], 0.0);
    for pair in SIGMAS.windows(2) {
        let ratio = pair[1] / pair[0];
        let kept = variance / (variance + pair[0] * pair[0]);
        // x' = r x + (1 - r) (kept x + (1 - kept) μ), in units of μ for b.
        let slope = ratio + (1.0 - ratio) * kept;
        (a, b) = (a * slope, b * slope + (1.0 - ratio) * (1.0 - kept));
    }
    let z = noise(2, &[1, 3]);
    let config = NoiseOptimizationConfig { iterations: 1000, learning_rate: 0.02 };
    let found = config.optimize(&SIGMAS, &denoiser, &Near(wanted.to_vec()), &z).unwrap();
    for (start, found) in values(&z).chunks(3).zip(values(&found).chunks(3)) {
        let radius = start.iter().map(|value| value * value).sum::<f64>().sqrt();
        let toward: Vec<f64> = (0..3).map(|i| wanted[i] - b * mean[i]).collect();
        let length = toward.iter().map(|value| value * value).sum::<f64>().sqrt() * a.signum();
        for i in 0..3 {
            let expected = radius * toward[i] / length;
            assert!((found[i] - expected).abs() < 5e-3, "{found:?}: {expected} at {i}");
        }
    }
}

#[test]
fn each_agent_keeps_the_norm_of_its_noise_and_few_iterations_help_already() {
    let denoiser = denoiser(vec![component(0.4, &[0.3; 12], 0.05), component(0.6, &[-0.2; 12], 0.2)]);
    let (wanted, z) = (Near(vec![0.5; 12]), noise(4, &[2, 3, 2]));
    let config = NoiseOptimizationConfig::default();
    let found = config.optimize(&SIGMAS, &denoiser, &wanted, &z).unwrap();
    let norms = |z: &Tensor| values(&block_norms(z).unwrap());
    assert_eq!(norms(&z).len(), 8);
    norms(&z).iter().zip(norms(&found)).for_each(|(before, after)| assert!((before - after).abs() < 1e-12));
    for row in 0..4 {
        let own = |z: &Tensor| z.narrow(0, row, 1).unwrap();
        let (before, after) = (own(&z), own(&found));
        assert!(potential_of(&denoiser, &wanted, &after) > potential_of(&denoiser, &wanted, &before) + 0.01);
        // Alone as among others.
        assert_eq!(values(&config.optimize(&SIGMAS, &denoiser, &wanted, &before).unwrap()), values(&after));
        // Each iteration moves a number by about the learning rate at most.
        let moved = (values(&before).iter().zip(values(&after))).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(moved > 0.1 && moved < 2.0 * 3.0 * config.learning_rate, "{moved}");
    }
}

#[test]
fn a_cut_gradient_is_an_error() {
    struct Cut(MixtureDenoiser);
    impl Denoiser for Cut {
        fn denoise(&self, x: &Tensor, sigma: &Tensor) -> Result<Tensor> {
            Ok(self.0.denoise(x, sigma)?.detach())
        }
    }
    struct Flat;
    impl CleanPotential for Flat {
        fn log_potential(&self, x0: &Tensor) -> Result<Tensor> {
            x0.detach().flatten_from(1)?.sum(1)
        }
    }
    let z = noise(1, &[1, 3]);
    let inner = || denoiser(vec![component(1.0, &[0.0; 3], 0.2)]);
    let config = NoiseOptimizationConfig::default();
    let message = config.optimize(&SIGMAS, &inner(), &Flat, &z).unwrap_err().to_string();
    assert!(message.contains("some operation cuts its gradient"), "{message}");
    // Through the steps alone, the noise has a slope still: the denoiser's share of it is what is missing.
    assert!(config.optimize(&SIGMAS[..2], &Cut(inner()), &Near(vec![0.0; 3]), &z).is_ok());
}

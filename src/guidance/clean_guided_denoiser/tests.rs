//! Do objectives of clean samples shift estimates by the closed forms for Gaussian data and mixtures?

use super::*;
use crate::diffusion::analytic::{Component, GaussianMixture, MixtureDenoiser};
use crate::diffusion::{Edm, NoiseSource, SamplerConfig};
use crate::seed::Seed;
use candle_core::{DType, Device};

const SIGMA: f64 = 0.8;
const AT: [f64; 2] = [0.7, -0.4];

fn gaussian(variance: [f64; 2]) -> GaussianMixture {
    let component = Component { weight: 1.0, mean: vec![0.3, -0.2], variance: variance.to_vec() };
    GaussianMixture { components: vec![component] }
}

/// So far below the best that nothing is damped.
const FAR: f64 = 1e15;

/// J = c · x₀ - 10¹⁵.
struct Linear([f64; 2]);
impl CleanPotential for Linear {
    fn log_potential(&self, x0: &Tensor) -> Result<Tensor> {
        x0.broadcast_mul(&Tensor::new(&self.0, x0.device())?)?.sum(1)? - FAR
    }
}

/// J = -½ k (c · x₀ - b)².
struct Squared([f64; 2], f64, f64);
impl CleanPotential for Squared {
    fn log_potential(&self, x0: &Tensor) -> Result<Tensor> {
        let along = x0.broadcast_mul(&Tensor::new(&self.0, x0.device())?)?.sum(1)?;
        (along - self.1)?.sqr()? * (-0.5 * self.2)
    }
}

fn guided<'a>(inner: &'a dyn Denoiser, potential: &'a dyn CleanPotential) -> CleanGuidedDenoiser<'a> {
    CleanGuidedDenoiser {
        inner,
        potential,
        strength: 1.5,
        gate: GuidanceConfig::UNRESTRICTED,
        to_mode: true,
        modes: None,
    }
}

fn estimate(denoiser: &dyn Denoiser, sigma: f64) -> [f64; 2] {
    let (x, sigma) = (Tensor::new(&[AT], &Device::Cpu).unwrap(), Tensor::new(&[sigma], &Device::Cpu).unwrap());
    denoiser.denoise(&x, &sigma).unwrap().get(0).unwrap().to_vec1::<f64>().unwrap().try_into().unwrap()
}

fn assert_close(found: [f64; 2], expected: [f64; 2], tolerance: f64) {
    assert!((0..2).all(|i| (found[i] - expected[i]).abs() < tolerance), "{found:?}, expected {expected:?}");
}

/// Mean and variance of the clean point given the noisy one, by Bayes' rule.
fn posterior(variance: f64, mean: f64, at: f64, sigma: f64) -> (f64, f64) {
    let precision = 1.0 / variance + 1.0 / (sigma * sigma);
    ((mean / variance + at / (sigma * sigma)) / precision, 1.0 / precision)
}

#[test]
fn linear_wishes_of_gaussian_data_are_met_exactly() {
    let c = [2.0, -0.7];
    let denoiser = MixtureDenoiser::new(&gaussian([0.25, 0.25]), DType::F64).unwrap();
    let found = estimate(&guided(&denoiser, &Linear(c)), SIGMA);
    // The posterior under the tilt exp(1.5 c · x₀): its mean moves by 1.5 times its covariance times c.
    let expected = [0, 1].map(|i| {
        let (mean, variance) = posterior(0.25, [0.3, -0.2][i], AT[i], SIGMA);
        mean + 1.5 * variance * c[i]
    });
    assert_close(found, expected, 1e-12);
}

#[test]
fn damping_is_exact_for_the_square_of_one_linear_wish() {
    let (c, b, k) = ([2.0, -0.7], 3.0, 40.0);
    let denoiser = MixtureDenoiser::new(&gaussian([0.25, 0.25]), DType::F64).unwrap();
    let (mean, variance) = {
        let both = [0, 1].map(|i| posterior(0.25, [0.3, -0.2][i], AT[i], SIGMA));
        ([both[0].0, both[1].0], both[0].1)
    };
    // A normal observation b of c · x₀ with precision 1.5 k.
    let residual = b - c[0] * mean[0] - c[1] * mean[1];
    let gain = 1.5 * k * variance / (1.0 + 1.5 * k * variance * (c[0] * c[0] + c[1] * c[1]));
    let expected = [0, 1].map(|i| mean[i] + gain * c[i] * residual);
    assert_close(estimate(&guided(&denoiser, &Squared(c, b, k)), SIGMA), expected, 1e-10);
}

/// Two wishes of different weight, J = -½ Σ k (c · x₀ - b)², and one that only a guided sample violates.
struct Several;
impl Several {
    const WISHES: [([f64; 2], f64, f64); 2] = [([2.0, -0.7], 1.0, 40.0), ([0.3, 0.6], -0.4, 700.0)];
    const MOST: f64 = 0.15;
}
impl CleanPotential for Several {
    fn log_potential(&self, x0: &Tensor) -> Result<Tensor> {
        let excess = (x0.narrow(1, 0, 1)?.sum(1)? - Self::MOST)?.relu()?;
        let costs = Self::WISHES.map(|(c, b, k)| Squared(c, b, k).log_potential(x0));
        costs.into_iter().try_fold((excess.sqr()? * -50.0)?, |sum, cost| sum + cost?)
    }
}

#[test]
fn several_wishes_are_weighed_as_the_mode_of_the_tilted_posterior_does() {
    let denoiser = MixtureDenoiser::new(&gaussian([0.25, 0.25]), DType::F64).unwrap();
    let found = estimate(&guided(&denoiser, &Several), SIGMA);
    // The normal equations (1 / v + 1.5 Σ k c cᵀ) x = m / v + 1.5 Σ k b c, with the excess as a third observation.
    let both = [0, 1].map(|i| posterior(0.25, [0.3, -0.2][i], AT[i], SIGMA));
    let mut matrix = [[1.0 / both[0].1, 0.0], [0.0, 1.0 / both[1].1]];
    let mut right = both.map(|(mean, variance)| mean / variance);
    for (c, b, k) in Several::WISHES.into_iter().chain([([1.0, 0.0], Several::MOST, 100.0)]) {
        for i in 0..2 {
            right[i] += 1.5 * k * b * c[i];
            (0..2).for_each(|j| matrix[i][j] += 1.5 * k * c[i] * c[j]);
        }
    }
    let [[a, b], [c, d]] = matrix;
    let expected = [(d * right[0] - b * right[1]) / (a * d - b * c), (a * right[1] - c * right[0]) / (a * d - b * c)];
    assert!(expected[0] > Several::MOST, "the last wish counts at the mode: {expected:?}");
    assert_close(found, expected, 0.02);
}

#[test]
fn samples_of_gaussian_data_follow_the_tilted_distribution() {
    let denoiser = MixtureDenoiser::new(&gaussian([0.25, 0.25]), DType::F64).unwrap();
    let (c, linear) = ([0.8, -0.4], Linear([0.8, -0.4]));
    let guided = guided(&denoiser, &linear);
    let mut noise = NoiseSource::new((0..3000).map(|row| Seed(11).derive("row", &[row])).collect());
    let like = Tensor::zeros(1, DType::F64, &Device::Cpu).unwrap();
    let sampler = SamplerConfig::heun(20);
    let x = sampler.sample(&Edm::default(), &guided, &[2], &like, &mut noise, &mut |_| {}).unwrap();
    let mean: [f64; 2] = x.mean(0).unwrap().to_vec1::<f64>().unwrap().try_into().unwrap();
    // exp(1.5 c · x₀) moves the mean by 1.5 · 0.25 c; the mean of 3000 has a standard error of 0.01.
    assert_close(mean, [0.3 + 0.375 * c[0], -0.2 + 0.375 * c[1]], 0.03);
}

#[test]
fn the_gate_and_the_limit_hold_and_no_strength_is_no_guidance() {
    let denoiser = MixtureDenoiser::new(&gaussian([0.25, 0.25]), DType::F64).unwrap();
    let (linear, plain) = (Linear([2.0, 1.0]), |sigma: f64| estimate(&denoiser, sigma));
    let mut guided = guided(&denoiser, &linear);
    guided.gate = GuidanceConfig { sigma_hi: 2.0, max_shift: 0.05 };
    assert_eq!(estimate(&guided, 3.0), plain(3.0));
    let (shifted, own) = (estimate(&guided, 0.8), plain(0.8));
    assert!(((shifted[0] - own[0]).hypot(shifted[1] - own[1]) - 0.05).abs() < 1e-9);
    guided.strength = 0.0;
    assert_eq!(estimate(&guided, 0.8), plain(0.8));
}

/// Gaussian data of variance λ in each of two modes of three timesteps: D(x) = Uᵀ λ / (λ + σ²) U x.
struct InModes(Surroundings);

impl InModes {
    fn new() -> Self {
        let device = &Device::Cpu;
        let (a, h) = (0.5f32.sqrt(), 0.5f32);
        // One agent of one dimension, and a third row without a mode.
        let modes = Tensor::new(&[[h, a, h], [a, 0.0, -a], [0.0, 0.0, 0.0]], device).unwrap();
        let variances = Tensor::new(&[0.8f32, 0.001, 0.0], device).unwrap();
        let nothing = Tensor::zeros((1, 1, 1), DType::F32, device).unwrap();
        Self(Surroundings {
            origin: nothing.clone(),
            attributes: nothing.clone(),
            lanes: nothing.clone(),
            lane_valid: nothing,
            modes: modes.reshape((1, 1, 1, 3, 3)).unwrap(),
            variances: variances.reshape((1, 1, 1, 3)).unwrap(),
            rows: Vec::new(),
        })
    }
}

impl Denoiser for InModes {
    fn denoise(&self, x: &Tensor, sigma: &Tensor) -> Result<Tensor> {
        let variance = sigma.sqr()?.reshape((1, 1, 1, 1))?;
        let gains = self.0.variances.div(&self.0.variances.broadcast_add(&variance)?)?;
        mode_filter(x, &self.0.modes, &gains)
    }
}

#[test]
fn wishes_push_along_the_modes_as_the_covariance_says() {
    let data = InModes::new();
    let (x, sigma) = (Tensor::new(&[0.3f32, -0.1, 0.6], &Device::Cpu).unwrap(), 0.8);
    let x = x.reshape((1, 1, 3, 1)).unwrap();
    struct Last;
    impl CleanPotential for Last {
        fn log_potential(&self, x0: &Tensor) -> Result<Tensor> {
            x0.narrow(2, 2, 1)?.flatten_all()? - FAR
        }
    }
    let shift = |modes: Option<&Surroundings>| -> Vec<f32> {
        let guided = CleanGuidedDenoiser { modes, ..guided(&data, &Last) };
        let sigma = Tensor::new(&[sigma as f32], &Device::Cpu).unwrap();
        let moved = guided.denoise(&x, &sigma).unwrap() - data.denoise(&x, &sigma).unwrap();
        moved.unwrap().flatten_all().unwrap().to_vec1().unwrap()
    };
    let found = shift(Some(&data.0));
    // α Uᵀ c U e₃ with c = σ² λ / (σ² + λ): 1.5 (½ c₁ u₁ - √½ c₂ u₂).
    let c = |variance: f64| sigma * sigma * variance / (sigma * sigma + variance);
    let (along, across) = (1.5 * 0.5 * c(0.8), 1.5 * 0.5f64.sqrt() * c(0.001));
    let expected = [0.5 * along - 0.5f64.sqrt() * across, 0.5f64.sqrt() * along, 0.5 * along + 0.5f64.sqrt() * across];
    for (i, expected) in expected.into_iter().enumerate() {
        assert!((f64::from(found[i]) - expected).abs() < 1e-6, "{found:?}, expected {expected} at {i}");
    }
    // Independent entries would be pushed in the last timestep alone: with a jolt.
    let jolt = shift(None);
    assert!(jolt[..2] == [0.0, 0.0] && jolt[2] > 0.1, "{jolt:?}");
}

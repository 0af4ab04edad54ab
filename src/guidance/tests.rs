//! Does guidance push in the right direction, exactly as far as in theory? Checked on a mixture under a linear tilt.

use super::*;
use crate::diffusion::analytic::{Component, GaussianMixture, MixtureDenoiser};
use crate::diffusion::{Denoiser, Edm, NoiseSource, SamplerConfig};
use crate::seed::Seed;
use candle_core::{DType, Device};
use std::cell::Cell;

fn mixture() -> GaussianMixture {
    GaussianMixture {
        components: vec![
            Component { weight: 0.6, mean: vec![-0.6, 0.2], variance: vec![0.04, 0.02] },
            Component { weight: 0.4, mean: vec![0.4, -0.1], variance: vec![0.03, 0.09] },
        ],
    }
}

/// The exact noise-aware potential ln E[exp(c · x₀) | x] of the tilt exp(c · x₀) on the mixture's clean points.
struct LinearTilt {
    denoiser: MixtureDenoiser,
    slope: [f64; 2],
}

impl LinearTilt {
    fn new(slope: [f64; 2]) -> Self {
        Self { denoiser: MixtureDenoiser::new(&mixture(), DType::F64).unwrap(), slope }
    }

    /// The tilted mixture: weights w exp(c · μ + c · Σ c / 2), means μ + Σ c, the same covariances.
    fn tilted(&self) -> GaussianMixture {
        let components = mixture().components.into_iter().map(|component| {
            let c = self.slope;
            let exponent: f64 =
                (0..2).map(|i| c[i] * component.mean[i] + 0.5 * c[i] * c[i] * component.variance[i]).sum();
            let mean = (0..2).map(|i| component.mean[i] + component.variance[i] * c[i]).collect();
            Component { weight: component.weight * exponent.exp(), mean, variance: component.variance }
        });
        GaussianMixture { components: components.collect() }
    }
}

impl Guidance for LinearTilt {
    fn log_potential(&self, x: &Tensor, sigma: &Tensor) -> Result<Tensor> {
        let posterior = self.denoiser.posterior(x, sigma)?;
        let slope = Tensor::new(&[[self.slope]], x.device())?;
        let linear = posterior.mean.broadcast_mul(&slope)?.sum(2)?;
        let quadratic = posterior.variance.broadcast_mul(&slope.sqr()?)?.sum(2)?;
        (posterior.log_responsibility + (linear + (quadratic * 0.5)?)?)?.log_sum_exp(1)
    }
}

fn sample(denoiser: &dyn Denoiser, n_rows: u64) -> Vec<Vec<f64>> {
    let mut noise = NoiseSource::new((0..n_rows).map(|row| Seed(11).derive("row", &[row])).collect());
    let like = Tensor::zeros(1, DType::F64, &Device::Cpu).unwrap();
    let sampler = SamplerConfig::heun(20);
    let x = sampler.sample(&Edm::default(), denoiser, &[2], &like, &mut noise, &mut |_| {}).unwrap();
    x.to_vec2().unwrap()
}

fn guided(tilt: &LinearTilt, strength: f64, config: GuidanceConfig) -> GuidedDenoiser<'_> {
    GuidedDenoiser { inner: &tilt.denoiser, guidance: tilt, strength, config }
}

fn mean(x: &[Vec<f64>]) -> [f64; 2] {
    [0, 1].map(|i| x.iter().map(|row| row[i]).sum::<f64>() / x.len() as f64)
}

fn tensors(x: [f64; 2], sigma: f64) -> (Tensor, Tensor) {
    (Tensor::new(&[x], &Device::Cpu).unwrap(), Tensor::new(&[sigma], &Device::Cpu).unwrap())
}

#[test]
fn at_strength_one_samples_follow_the_tilted_distribution() {
    let tilt = LinearTilt::new([2.0, -1.5]);
    let expected = tilt.tilted();
    let x = sample(&guided(&tilt, 1.0, GuidanceConfig::UNRESTRICTED), 6000);
    let mean = mean(&x);
    for i in 0..2 {
        assert!((mean[i] - expected.mean()[i]).abs() < 0.02, "mean {mean:?}, expected {:?}", expected.mean());
        for j in 0..2 {
            let covariance = x.iter().map(|row| (row[i] - mean[i]) * (row[j] - mean[j])).sum::<f64>() / x.len() as f64;
            assert!((covariance - expected.covariance()[i][j]).abs() < 0.02, "covariance {i} {j}: {covariance}");
        }
    }
    // The tilt does move mass: by more than the tolerance, and in the direction of its slope.
    assert!(expected.mean()[0] - mixture().mean()[0] > 0.3);
}

#[test]
fn more_strength_moves_further_and_none_changes_nothing() {
    let tilt = LinearTilt::new([1.0, 0.0]);
    let first = |strength: f64| mean(&sample(&guided(&tilt, strength, GuidanceConfig::UNRESTRICTED), 1000))[0];
    assert!(first(0.5) < first(1.0) && first(1.0) < first(3.0));
    assert!(first(-1.0) < first(0.0));
    assert_eq!(sample(&guided(&tilt, 0.0, GuidanceConfig::UNRESTRICTED), 4), sample(&tilt.denoiser, 4));
}

#[test]
fn the_gradient_agrees_with_finite_differences() {
    let tilt = LinearTilt::new([2.0, -1.5]);
    let at = [0.3, -0.2];
    let value = |x: [f64; 2]| {
        let (x, sigma) = tensors(x, 0.7);
        tilt.log_potential(&x, &sigma).unwrap().to_vec1::<f64>().unwrap()[0]
    };
    let (x, sigma) = tensors(at, 0.7);
    let gradient = log_potential_gradient(&tilt, &x, &sigma).unwrap().to_vec2::<f64>().unwrap();
    let h = 1e-5;
    for i in 0..2 {
        let (mut up, mut down) = (at, at);
        up[i] += h;
        down[i] -= h;
        assert!((gradient[0][i] - (value(up) - value(down)) / (2.0 * h)).abs() < 1e-8);
    }
}

#[test]
fn the_gate_closes_and_the_limit_holds() {
    let tilt = LinearTilt::new([2.0, -1.5]);
    let shift = |sigma: f64, config: GuidanceConfig| {
        let (x, sigma) = tensors([0.3, -0.2], sigma);
        let unguided = tilt.denoiser.denoise(&x, &sigma).unwrap();
        let shift = (guided(&tilt, 1.0, config).denoise(&x, &sigma).unwrap() - unguided).unwrap();
        shift.to_vec2::<f64>().unwrap()[0].clone()
    };
    let gate = GuidanceConfig { sigma_hi: 2.0, ..GuidanceConfig::UNRESTRICTED };
    assert_eq!(shift(3.0, gate), [0.0, 0.0]);
    let free = shift(0.7, gate);
    assert!(free[0] > 0.0 && free[1] < 0.0);
    let length = free[0].hypot(free[1]);
    // Samplers pass levels in single precision, in which 0.8 is a little more.
    let bound = GuidanceConfig { sigma_hi: 0.8, ..GuidanceConfig::UNRESTRICTED };
    assert!(shift(f64::from(0.8f32), bound)[0] > 0.0 && shift(f64::from(0.801f32), bound) == [0.0; 2]);
    let limited = shift(0.7, GuidanceConfig { max_shift: length / 2.0, ..gate });
    assert!((limited[0] - free[0] / 2.0).abs() < 1e-12 && (limited[1] - free[1] / 2.0).abs() < 1e-12);
    assert_eq!(shift(0.7, GuidanceConfig { max_shift: length * 2.0, ..gate }), free);
}

#[test]
fn the_denoiser_is_not_differentiated_through() {
    /// Fails if it gets a tensor with a graph.
    struct Opaque<'a>(&'a MixtureDenoiser, Cell<usize>);
    impl Denoiser for Opaque<'_> {
        fn denoise(&self, x: &Tensor, sigma: &Tensor) -> Result<Tensor> {
            assert!(!x.track_op());
            self.1.set(self.1.get() + 1);
            self.0.denoise(x, sigma)
        }
    }
    let tilt = LinearTilt::new([2.0, -1.5]);
    let inner = Opaque(&tilt.denoiser, Cell::new(0));
    let (x, sigma) = tensors([0.3, -0.2], 0.7);
    let denoiser =
        GuidedDenoiser { inner: &inner, guidance: &tilt, strength: 1.0, config: GuidanceConfig::UNRESTRICTED };
    assert!(!denoiser.denoise(&x, &sigma).unwrap().track_op());
    assert_eq!(inner.1.get(), 1);
}

#[test]
fn a_potential_that_ignores_the_sample_is_an_error() {
    struct Constant;
    impl Guidance for Constant {
        fn log_potential(&self, x: &Tensor, _sigma: &Tensor) -> Result<Tensor> {
            x.detach().sum(1)
        }
    }
    let tilt = LinearTilt::new([1.0, 1.0]);
    let (x, sigma) = tensors([0.3, -0.2], 0.7);
    let denoiser = GuidedDenoiser {
        inner: &tilt.denoiser,
        guidance: &Constant,
        strength: 1.0,
        config: GuidanceConfig::UNRESTRICTED,
    };
    assert!(denoiser.denoise(&x, &sigma).unwrap_err().to_string().contains("cuts its gradient"));
}

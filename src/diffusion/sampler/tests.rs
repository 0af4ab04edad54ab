//! Do the samplers solve the equation they claim to, at the order they claim to? Checked on a mixture with known
//! answers.

use super::*;
use crate::diffusion::analytic::{Component, GaussianMixture, MixtureDenoiser};
use crate::seed::Seed;
use candle_core::{DType, Device};

/// A skewed mixture whose overall scale is about σ_data.
fn mixture() -> GaussianMixture {
    GaussianMixture {
        components: vec![
            Component { weight: 0.3, mean: vec![-0.6, 0.2], variance: vec![0.04, 0.02] },
            Component { weight: 0.7, mean: vec![0.4, -0.1], variance: vec![0.03, 0.09] },
        ],
    }
}

fn noise(n_rows: u64) -> NoiseSource {
    NoiseSource::new((0..n_rows).map(|row| Seed(5).derive("row", &[row])).collect())
}

fn like() -> Tensor {
    Tensor::zeros(1, DType::F64, &Device::Cpu).unwrap()
}

fn sample(config: &SamplerConfig, noise: &mut NoiseSource) -> Vec<Vec<f64>> {
    let denoiser = MixtureDenoiser::new(&mixture(), DType::F64).unwrap();
    let x = config.sample(&Edm::default(), &denoiser, &[2], &like(), noise, &mut |_| {}).unwrap();
    x.to_vec2().unwrap()
}

fn moments(x: &[Vec<f64>]) -> ([f64; 2], [[f64; 2]; 2]) {
    let n = x.len() as f64;
    let mean = [0, 1].map(|i| x.iter().map(|row| row[i]).sum::<f64>() / n);
    let covariance =
        [0, 1].map(|i| [0, 1].map(|j| x.iter().map(|row| (row[i] - mean[i]) * (row[j] - mean[j])).sum::<f64>() / n));
    (mean, covariance)
}

fn assert_moments(x: &[Vec<f64>], tolerance: f64) {
    let (mean, covariance) = moments(x);
    let expected = (mixture().mean(), mixture().covariance());
    for i in 0..2 {
        assert!((mean[i] - expected.0[i]).abs() < tolerance, "mean {mean:?}, expected {:?}", expected.0);
        for j in 0..2 {
            let error = (covariance[i][j] - expected.1[i][j]).abs();
            assert!(error < tolerance, "covariance {covariance:?}, expected {:?}", expected.1);
        }
    }
}

#[test]
fn samples_have_the_mean_and_covariance_of_the_data() {
    // The mean's standard error is 0.55 / √8000 = 0.006.
    for config in [SamplerConfig::heun(18), SamplerConfig::dpmpp_2m(30)] {
        assert_moments(&sample(&config, &mut noise(8000)), 0.02);
    }
}

/// The error at `sigma_min` of `n_steps` steps of `config`'s kind against a very fine solution.
fn error_after(config: &SamplerConfig, n_steps: usize) -> f64 {
    // The last step, to 0, is of first order and of fixed length in every sampler: it would hide the order.
    let sigmas = |n_steps: usize| karras_without_zero(n_steps);
    let denoiser = MixtureDenoiser::new(&mixture(), DType::F64).unwrap();
    let start = (noise(32).draw(&[2], DType::F64, &Device::Cpu).unwrap() * 10.0).unwrap();
    let solve = |config: &SamplerConfig, n_steps: usize| {
        config.integrate(&sigmas(n_steps), &denoiser, start.clone(), &mut |_| {}).unwrap()
    };
    let exact = solve(&SamplerConfig::heun(50), 4000);
    let error = (solve(config, n_steps) - exact).unwrap().sqr().unwrap().mean_all().unwrap();
    error.to_scalar::<f64>().unwrap().sqrt()
}

fn karras_without_zero(n_steps: usize) -> Vec<f64> {
    let mut sigmas = crate::diffusion::karras_schedule(0.02, 10.0, 7.0, n_steps + 1);
    sigmas.pop();
    sigmas
}

#[test]
fn each_sampler_converges_at_its_order() {
    for kind in SamplerKind::ALL {
        let order: f64 = match kind {
            SamplerKind::Euler => 1.0,
            SamplerKind::Heun | SamplerKind::Dpmpp2m => 2.0,
        };
        let config = SamplerConfig::of(kind, 1);
        let measured = (error_after(&config, 200) / error_after(&config, 400)).log2();
        assert!((measured - order).abs() < 0.2, "{}: order {measured}, expected {order}", kind.name());
    }
}

#[test]
fn a_row_is_the_same_alone_and_in_a_batch() {
    for config in SamplerKind::ALL.map(|kind| SamplerConfig::of(kind, 8)) {
        let together = sample(&config, &mut noise(5));
        let alone = sample(&config, &mut NoiseSource::new(vec![Seed(5).derive("row", &[3])]));
        assert_eq!(together[3], alone[0], "{}", config.name());
    }
}

#[test]
fn the_denoiser_is_called_as_often_as_promised() {
    struct Counting(MixtureDenoiser, std::cell::Cell<usize>);
    impl Denoiser for Counting {
        fn denoise(&self, x: &Tensor, sigma: &Tensor) -> Result<Tensor> {
            self.1.set(self.1.get() + 1);
            self.0.denoise(x, sigma)
        }
    }
    let denoiser = Counting(MixtureDenoiser::new(&mixture(), DType::F64).unwrap(), std::cell::Cell::new(0));
    for config in SamplerKind::ALL.into_iter().flat_map(|kind| [1, 7].map(|n_steps| SamplerConfig::of(kind, n_steps))) {
        denoiser.1.set(0);
        let mut seen = Vec::new();
        let mut observer = |step: &Step<'_>| seen.push((step.step_idx, step.n_steps, step.sigma));
        config.sample(&Edm::default(), &denoiser, &[2], &like(), &mut noise(2), &mut observer).unwrap();
        assert_eq!(denoiser.1.get(), config.n_evaluations(), "{}", config.name());
        assert_eq!(seen.len(), config.n_steps());
        assert_eq!(seen[0], (0, config.n_steps(), 80.0));
    }
    assert_eq!(SamplerConfig::default().n_evaluations(), 99);
}

#[test]
fn configs_are_tagged_and_strict() {
    let parse = toml::from_str::<SamplerConfig>;
    assert_eq!(parse("kind = 'heun'").unwrap().name(), SamplerConfig::default().name());
    assert_eq!(parse("kind = 'dpmpp_2m'\nn_steps = 9").unwrap(), SamplerConfig::dpmpp_2m(9));
    assert!(parse("kind = 'heun'\nsteps = 9").unwrap_err().to_string().contains("steps"));
    assert!(parse("kind = 'ddim'").is_err());
    assert_eq!(SamplerConfig::heun(20).name(), "heun-20");
    for kind in SamplerKind::ALL {
        assert_eq!(serde_json::to_value(kind).unwrap(), kind.name());
    }
}

/// Preconditioning, schedule and one step of each kind as `scripts/golden_edm.py` computes them with numpy.
mod golden {
    use super::*;
    use serde::Deserialize;

    #[derive(Deserialize)]
    struct Golden {
        preconditioning: Vec<Factors>,
        schedules: Vec<Schedule>,
        mixture: Mixture,
        heun_step: HeunStep,
    }

    #[derive(Deserialize)]
    struct Factors {
        sigma: f64,
        c_skip: f64,
        c_out: f64,
        c_in: f64,
        c_noise: f64,
        loss_weight: f64,
    }

    #[derive(Deserialize)]
    struct Schedule {
        sigma_start: f64,
        n_steps: usize,
        sigmas: Vec<f64>,
    }

    #[derive(Deserialize)]
    struct Mixture {
        weights: Vec<f64>,
        means: Vec<Vec<f64>>,
        variances: Vec<Vec<f64>>,
    }

    #[derive(Deserialize)]
    struct HeunStep {
        sigma: f64,
        sigma_next: f64,
        x: Vec<Vec<f64>>,
        x0_hat: Vec<Vec<f64>>,
        x_next: Vec<Vec<f64>>,
    }

    fn golden() -> Golden {
        serde_json::from_str(include_str!("../../../tests/golden/edm.json")).unwrap()
    }

    fn assert_close(got: f64, expected: f64) {
        assert!((got - expected).abs() <= 1e-11 * expected.abs().max(1.0), "got {got}, expected {expected}");
    }

    fn tensor(rows: &[Vec<f64>]) -> Tensor {
        Tensor::from_vec(rows.concat(), (rows.len(), rows[0].len()), &Device::Cpu).unwrap()
    }

    fn assert_rows_close(got: &Tensor, expected: &[Vec<f64>]) {
        for (got, expected) in got.to_vec2::<f64>().unwrap().concat().iter().zip(expected.concat()) {
            assert_close(*got, expected);
        }
    }

    #[test]
    fn factors_and_schedules_agree() {
        let edm = Edm::default();
        for factors in golden().preconditioning {
            assert_close(edm.c_skip(factors.sigma), factors.c_skip);
            assert_close(edm.c_out(factors.sigma), factors.c_out);
            assert_close(edm.c_in(factors.sigma), factors.c_in);
            assert_close(edm.c_noise(factors.sigma), factors.c_noise);
            assert_close(edm.loss_weight(factors.sigma) * 1e-3, factors.loss_weight * 1e-3);
        }
        for schedule in golden().schedules {
            let sigmas = edm.schedule_from(schedule.sigma_start, schedule.n_steps);
            assert_eq!(sigmas.len(), schedule.sigmas.len());
            sigmas.iter().zip(&schedule.sigmas).for_each(|(got, expected)| assert_close(*got, *expected));
        }
    }

    #[test]
    fn one_heun_step_agrees() {
        let Golden { mixture, heun_step, .. } = golden();
        let components = mixture.weights.into_iter().zip(mixture.means).zip(mixture.variances);
        let components = components.map(|((weight, mean), variance)| Component { weight, mean, variance }).collect();
        let denoiser = MixtureDenoiser::new(&GaussianMixture { components }, DType::F64).unwrap();
        let x = tensor(&heun_step.x);
        assert_rows_close(&denoise_at(&denoiser, &x, heun_step.sigma).unwrap(), &heun_step.x0_hat);
        let sigmas = [heun_step.sigma, heun_step.sigma_next];
        let x_next = SamplerConfig::default().integrate(&sigmas, &denoiser, x, &mut |_| {}).unwrap();
        assert_rows_close(&x_next, &heun_step.x_next);
    }
}

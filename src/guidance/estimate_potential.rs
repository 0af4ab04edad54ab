//! The potential of a clean estimate under a guidance of noisy states.

use super::{BranchChange, CleanPotential, Guidance, MaskChange};
use candle_core::{Result, Tensor};

/// A log potential of noisy states as one of clean estimates: J(x₀) = ln p(y | x₀; σ) at a low noise level σ.
///
/// With [`super::CleanGuidedDenoiser`] this guides samples under masks whose noisy states are unknown to the guidance.
/// Clean estimates mean the same under every mask, and can be expressed in the coordinates of another one exactly;
/// noisy states cannot, because entries that only the one mask observes have no noise.
pub struct EstimatePotential<'a> {
    /// The guidance.
    pub guidance: &'a dyn Guidance,
    /// From the mask that the guidance knows (the base) to the sampled one; `None` if they are the same.
    pub change: Option<&'a MaskChange>,
    /// The noise level that the estimate is assumed to have.
    pub sigma: f64,
}

impl CleanPotential for EstimatePotential<'_> {
    fn log_potential(&self, x0: &Tensor) -> Result<Tensor> {
        let own = match self.change {
            Some(change) => change.to_unconditional(x0)?,
            None => x0.clone(),
        };
        let sigma = Tensor::full(self.sigma as f32, x0.dim(0)?, x0.device())?.to_dtype(x0.dtype())?;
        self.guidance.log_potential(&own, &sigma)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diffusion::NoiseSource;
    use crate::scene::testing::{Drive, scene};
    use crate::scene::{ObservationMask, Scene};
    use crate::seed::Seed;
    use crate::tensor::testing::collator;
    use crate::tensor::{FutureValidity, SceneBatch, StateParametrization};
    use candle_core::Var;

    /// Favors the second agent far to the left at the end, and reports the noise level that it gets.
    struct ToTheLeft<'a> {
        batch: &'a SceneBatch,
    }

    impl Guidance for ToTheLeft<'_> {
        fn log_potential(&self, x: &Tensor, sigma: &Tensor) -> Result<Tensor> {
            let y = self
                .batch
                .decode(x)?
                .narrow(1, 1, 1)?
                .narrow(2, 10, 1)?
                .narrow(3, 1, 1)?
                .flatten_from(1)?
                .squeeze(1)?;
            y * sigma
        }
    }

    fn batch(scene: &Scene, parametrization: StateParametrization, mask: &ObservationMask) -> SceneBatch {
        collator([scene], parametrization).masked(scene, mask, FutureValidity::Everything)
    }

    #[test]
    fn an_estimate_means_the_same_under_another_mask() {
        let turning = Drive { x: 30.0, y: 20.0, heading_rad: -1.6, speed_mps: 8.0, curvature_1pm: -0.2 };
        let scene = scene(&[Drive::straight(5.0, 1.0, 0.3, 12.0), turning]);
        for parametrization in [StateParametrization::Scene, StateParametrization::Motion] {
            let known = batch(&scene, parametrization, &ObservationMask::predictive(2, 12, 4));
            let goals = ObservationMask::from_fn(2, 12, |_, timestep| timestep < 4 || timestep == 11);
            let sampled = batch(&scene, parametrization, &goals);
            let change = MaskChange::new(&known, &sampled).unwrap();
            let guidance = ToTheLeft { batch: &known };
            let potential = EstimatePotential { guidance: &guidance, change: Some(&change), sigma: 0.25 };
            let value =
                |x0: &Tensor| -> f64 { f64::from(potential.log_potential(x0).unwrap().to_vec1::<f32>().unwrap()[0]) };
            let estimate = NoiseSource::new(vec![Seed(3)]).draw_like(&sampled.x0).unwrap();
            // Decoded under the mask that is sampled, without any change of coordinates.
            let y_m = sampled.decode(&estimate).unwrap().to_dtype(candle_core::DType::F32).unwrap();
            let y_m = y_m.flatten_all().unwrap().to_vec1::<f32>().unwrap()[(12 + 10) * 3 + 1];
            assert!((value(&estimate) - 0.25 * f64::from(y_m)).abs() < 1e-3, "{parametrization:?}");
            // The potential is linear: finite differences are exact up to rounding.
            let x0 = Var::from_tensor(&estimate).unwrap();
            let gradients = potential.log_potential(x0.as_tensor()).unwrap().sum_all().unwrap().backward().unwrap();
            let gradient = gradients.get(x0.as_tensor()).unwrap();
            let along = NoiseSource::new(vec![Seed(4)]).draw_like(&sampled.x0).unwrap();
            let slope = (gradient * &along).unwrap().sum_all().unwrap().to_scalar::<f32>().unwrap();
            let step = |factor: f64| value(&(&estimate + (&along * factor).unwrap()).unwrap());
            let difference = (step(1.0) - step(-1.0)) / 2.0;
            assert!(difference.abs() > 1e-3, "{parametrization:?}");
            assert!((f64::from(slope) - difference).abs() < 2e-3 * difference.abs().max(1.0), "{parametrization:?}");
        }
    }
}

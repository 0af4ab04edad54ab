//! Classifier guidance on clean estimates: make a behavior likely in the futures that estimates stand for.

use super::{ClassifierPotential, CleanPotential};
use crate::model::FutureClassifier;
use crate::tensor::{FutureFeatures, SceneBatch};
use candle_core::{Result, Tensor};

/// ln p_φ(y | decode(x₀)), or its log odds, for one chosen pair of agents in each batch row. Nobody else is pushed.
pub struct FutureGuidance<'a> {
    /// The classifier of the behavior.
    pub classifier: &'a FutureClassifier,
    /// The batch that is sampled, under any mask: clean futures mean the same under all of them.
    pub batch: &'a SceneBatch,
    /// Its chosen pairs.
    pub pairs: FutureFeatures,
    /// What of the classifier is made large.
    pub potential: ClassifierPotential,
}

impl CleanPotential for FutureGuidance<'_> {
    fn log_potential(&self, x0: &Tensor) -> Result<Tensor> {
        let moments = self.pairs.moments(&self.batch.decode(x0)?)?;
        self.potential.of_logits(self.classifier.logits(&moments)?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::BehaviorClassifierConfig;
    use crate::nn::testing::values;
    use crate::nn::{Compute, Params};
    use crate::scene::Scene;
    use crate::scene::testing::{Drive, scene};
    use crate::seed::Seed;
    use crate::tensor::testing::collator;
    use crate::tensor::{FutureValidity, ScenePair, StateParametrization};
    use candle_core::{DType, Var};

    /// The ego, a bystander, and one that bears toward the ego's lane.
    fn traffic() -> Scene {
        let bearing = Drive { curvature_1pm: -0.01, ..Drive::straight(12.0, 3.0, -0.1, 8.0) };
        scene(&[Drive::straight(0.0, 0.2, 0.0, 10.0), Drive::straight(-9.0, -4.0, 0.0, 9.0), bearing])
    }

    fn batch(scene: &Scene) -> SceneBatch {
        collator([scene], StateParametrization::Motion).predictive(&[scene], FutureValidity::Everything)
    }

    fn classifier(dtype: DType) -> FutureClassifier {
        let mut params = Params::with_dtype(&Compute::cpu(), dtype);
        FutureClassifier::new(&mut params, &BehaviorClassifierConfig::default(), Seed(5)).unwrap()
    }

    fn pairs(scene: &Scene, batch: &SceneBatch) -> FutureFeatures {
        FutureFeatures::new(batch, &[ScenePair { scene, agents: (0, 2) }]).unwrap()
    }

    /// Finite differences in f64 of the logit in each coordinate of both agents.
    #[test]
    fn the_gradient_of_the_log_odds_is_that_of_finite_differences() {
        let scene = traffic();
        let batch = batch(&scene);
        let (pairs, classifier) = (pairs(&scene, &batch), classifier(DType::F64));
        let states = batch.decode(&batch.x0).unwrap().to_dtype(DType::F64).unwrap();
        let logit = |states: &Tensor| classifier.logits(&pairs.moments(states).unwrap()).unwrap();
        let var = Var::from_tensor(&states).unwrap();
        let gradients = logit(var.as_tensor()).sum_all().unwrap().backward().unwrap();
        let gradient = values(gradients.get(var.as_tensor()).unwrap());
        let base = values(&states);
        let h = 1e-5;
        for at in (0..base.len()).filter(|at| at % 3 < 2) {
            let moved = |by: f64| {
                let mut own = base.clone();
                own[at] += by;
                values(&logit(&Tensor::from_vec(own, states.shape(), states.device()).unwrap()))[0]
            };
            let difference = (moved(h) - moved(-h)) / (2.0 * h);
            let (agent, timestep) = (at / 36, at % 36 / 3);
            assert!((gradient[at] - difference).abs() < 1e-6, "agent {agent} at {timestep}");
            // The states that velocities and accelerations of the future begin with have a part in them, the bystander has none.
            assert_eq!(gradient[at] != 0.0, agent != 1, "agent {agent} at {timestep}");
        }
    }

    #[test]
    fn only_the_future_of_the_pair_is_pushed_and_no_recorded_future_is_seen() {
        let scene = traffic();
        let shown = batch(&scene);
        let classifier = classifier(DType::F32);
        let gradient_of = |batch: &SceneBatch, pairs: FutureFeatures, potential: ClassifierPotential| {
            let guidance = FutureGuidance { classifier: &classifier, batch, pairs, potential };
            let x0 = Var::from_tensor(&shown.x0).unwrap();
            let total = guidance.log_potential(x0.as_tensor()).unwrap().sum_all().unwrap();
            values(total.backward().unwrap().get(x0.as_tensor()).unwrap())
        };
        let gradient = gradient_of(&shown, pairs(&scene, &shown), ClassifierPotential::LogOdds);
        for (at, slope) in gradient.iter().enumerate().filter(|(at, _)| at % 3 < 2) {
            assert_eq!(*slope != 0.0, at / 36 != 1 && at % 36 / 3 >= 4, "agent {}, timestep {}", at / 36, at % 36 / 3);
        }
        // ∇ ln p = (1 - p) ∇z.
        let z = values(
            &classifier.logits(&pairs(&scene, &shown).moments(&shown.decode(&shown.x0).unwrap()).unwrap()).unwrap(),
        )[0];
        let of_log_p = gradient_of(&shown, pairs(&scene, &shown), ClassifierPotential::LogProbability);
        let share = 1.0 / (1.0 + z.exp());
        assert!(gradient.iter().zip(&of_log_p).all(|(odds, log_p)| (odds * share - log_p).abs() < 1e-5));
        // With other recorded futures of everybody, the same.
        let mut other = scene.clone();
        for (track, recorded) in other.tracks.iter_mut().zip(scene.tracks.iter().rev()) {
            let state = |t: usize| if t < 4 { track.trajectory.get(t) } else { recorded.trajectory.get(t) };
            track.trajectory = crate::scene::Trajectory::new((0..12).map(|t| state(t).copied()).collect());
        }
        // Scales are those of the first scene, as in training.
        let collated =
            collator([&scene], StateParametrization::Motion).predictive(&[&other], FutureValidity::Everything);
        assert_eq!(gradient_of(&collated, pairs(&other, &collated), ClassifierPotential::LogOdds), gradient);
    }
}

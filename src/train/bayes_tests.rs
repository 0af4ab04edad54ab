//! Does a classifier of clean futures learn the log odds that are known in closed form?

use super::testing::job;
use super::*;
use crate::model::{BehaviorClassifierConfig, ClassifierNetwork, FutureClassifier};
use crate::nn::testing::assert_gradients;
use crate::nn::{Compute, Params};
use crate::seed::Seed;
use crate::tensor::{FutureFeatures, Moments};
use candle_core::{Device, Tensor};

/// Futures whose one feature is normal around 1 where the label is positive and around -1 where it is not, with variance 1. With equal
/// weights of the labels, Bayes' log odds are 2 x.
struct Gaussian(Labels, Vec<f32>);

impl Gaussian {
    fn logits(&self, classifier: &ClassifierNetwork, pairs: &[usize]) -> Result<Tensor, Error> {
        Ok(classifier.of_clean_futures()?.logits(&moments(pairs.iter().map(|i| self.1[*i])))?)
    }
}

impl PairInputs for Gaussian {
    fn labels(&self) -> [&Labels; 2] {
        [&self.0; 2]
    }

    fn training_logits(&self, c: &ClassifierNetwork, pairs: &[usize], _: Vec<Seed>) -> Result<Tensor, Error> {
        self.logits(c, pairs)
    }

    fn held_out_logits(
        &self,
        c: &ClassifierNetwork,
        pairs: std::ops::Range<usize>,
        _: (usize, f64),
        _: Vec<Seed>,
    ) -> Result<Tensor, Error> {
        self.logits(c, &pairs.collect::<Vec<_>>())
    }
}

/// Three moments each, of which the last has the feature and the first two do not count.
fn moments(xs: impl Iterator<Item = f32>) -> Moments {
    let width = FutureFeatures::MOMENT;
    let rows: Vec<f32> = xs.flat_map(|x| (0..3 * width).map(move |i| if i == 2 * width { x } else { 0.0 })).collect();
    let n_rows = rows.len() / (3 * width);
    let valid = [0.0f32, 0.0, 1.0].repeat(n_rows);
    Moments {
        features: Tensor::from_vec(rows, (n_rows, 3, width), &Device::Cpu).unwrap(),
        valid: Tensor::from_vec(valid, (n_rows, 3), &Device::Cpu).unwrap(),
    }
}

#[test]
fn bayes_log_odds_are_learned() {
    let mut rng = Seed(3).rng();
    let labels: Vec<bool> = (0..20_000).map(|i| i % 5 == 0).collect();
    let xs = labels.iter().map(|label| (if *label { 1.0 } else { -1.0 } + rng.normal()) as f32).collect();
    let inputs = Gaussian(Labels::new(labels), xs);
    let mut params = Params::new(&Compute::cpu());
    let config = BehaviorClassifierConfig { width: 16, ..BehaviorClassifierConfig::default() };
    let network = |params: &mut Params| {
        ClassifierNetwork::CleanEstimate(FutureClassifier::new(params, &config, Seed(1)).unwrap())
    };
    let (classifier, frozen) = (network(&mut params), network(&mut params.frozen()));
    let task = ClassificationTask {
        classifier: &classifier,
        frozen: &frozen,
        inputs: &inputs,
        pos_weight: 4.0,
        batch_size: 256,
        seed: Seed(6),
    };
    assert_gradients(&task.loss(&BatchPart::whole(0, 256), None).unwrap(), &params, |_| true);
    let fit_config = FitConfig { steps: 400, learning_rate: 0.01, warmup_steps: 10, ..FitConfig::default() };
    let dir = tempfile::tempdir().unwrap();
    fit(&fit_config, &mut params, &task, job(6, dir.path())).unwrap();
    let xs = [-1.5f32, -0.5, 0.0, 0.5, 1.5];
    let logits = frozen.of_clean_futures().unwrap().logits(&moments(xs.into_iter())).unwrap();
    for (x, logit) in xs.iter().zip(logits.to_vec1::<f32>().unwrap()) {
        assert!((logit - 2.0 * x).abs() < 0.4, "at {x}: {logit}");
    }
    let report = task.report().unwrap();
    assert!(report[0].calibration_error.unwrap() < 0.03, "{:?}", report[0]);
    // P(N(1, 1) > N(-1, 1)) = Φ(√2).
    assert!((report[0].auc.unwrap() - 0.921).abs() < 0.01, "{:?}", report[0]);
}

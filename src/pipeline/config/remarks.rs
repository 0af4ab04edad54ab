//! Settings that have no effect.

use super::{PipelineConfig, TrainConfig};
use crate::train::{BaselineTrainingConfig, ClassifierTrainingConfig, DenoiserTrainingConfig, DistillTrainingConfig};

impl PipelineConfig {
    /// What a user may have meant otherwise, although it can work.
    pub fn remarks(&self) -> Vec<String> {
        let TrainConfig { denoiser, distill, classifier, baseline } = &self.train;
        let beside_checkpoints = [
            (
                "denoiser",
                denoiser.as_ref().is_some_and(|own| {
                    let alone = DenoiserTrainingConfig { checkpoint: own.checkpoint.clone(), ..Default::default() };
                    own.checkpoint.is_some() && *own != alone
                }),
            ),
            (
                "distill",
                distill.as_ref().is_some_and(|own| {
                    let alone = DistillTrainingConfig { checkpoint: own.checkpoint.clone(), ..Default::default() };
                    own.checkpoint.is_some() && *own != alone
                }),
            ),
            (
                "classifier",
                classifier.as_ref().is_some_and(|own| {
                    let alone = ClassifierTrainingConfig { checkpoint: own.checkpoint.clone(), ..Default::default() };
                    own.checkpoint.is_some() && *own != alone
                }),
            ),
            (
                "baseline",
                baseline.as_ref().is_some_and(|own| {
                    let alone = BaselineTrainingConfig { checkpoint: own.checkpoint.clone(), ..Default::default() };
                    own.checkpoint.is_some() && *own != alone
                }),
            ),
        ];
        let named = beside_checkpoints.into_iter().filter(|(_, has_more)| *has_more);
        named
            .map(|(section, _)| {
                format!(
                    "train.{section}.checkpoint is used as it is: the other settings of the section have no effect; \
                     to train it further, use start_from"
                )
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_beside_a_checkpoint_have_no_effect() {
        let remarks = |overrides: &[&str]| {
            let overrides: Vec<String> = overrides.iter().map(|text| (*text).to_owned()).collect();
            PipelineConfig::load(None, &overrides).unwrap().remarks()
        };
        assert!(remarks(&["train.denoiser.checkpoint=\"a\"", "train.distill.steps=7"]).is_empty());
        let found = remarks(&["train.denoiser.checkpoint=\"a\"", "train.denoiser.steps=7"]);
        assert!(found.len() == 1 && found[0].starts_with("train.denoiser.checkpoint is used as it is"), "{found:?}");
    }
}

//! Settings that have no effect.

use super::{PipelineConfig, TrainConfig};
use crate::generate::{GenerateConfig, SweepConfig};
use serde::Serialize;
use serde_json::Value;

impl PipelineConfig {
    /// Remarks on valid settings that the user may not have intended.
    pub fn remarks(&self) -> Vec<String> {
        let TrainConfig { denoiser, distill, classifier, baseline, .. } = &self.train;
        let sections = [
            ("denoiser", has_more_than_checkpoint(denoiser.as_ref())),
            ("distill", has_more_than_checkpoint(distill.as_ref())),
            ("classifier", has_more_than_checkpoint(classifier.as_ref())),
            ("baseline", has_more_than_checkpoint(baseline.as_ref())),
        ];
        let remark = |(section, has_more): (&str, bool)| {
            has_more.then(|| {
                format!("train.{section}.checkpoint is used as it is: the other settings of the section have no effect")
            })
        };
        let of_sections = sections.into_iter().filter_map(remark);
        let arms = self.generate.iter().flat_map(|GenerateConfig { arms, requests, .. }| {
            let is_idle = |arm: &&SweepConfig| !requests.iter().any(|request| request.arms.contains(&arm.name));
            arms.iter().filter(is_idle).map(|arm| format!("generate.arms has {}, which no request names", arm.name))
        });
        of_sections.chain(arms).collect()
    }
}

/// Whether a section has a checkpoint and other settings that are not their defaults.
fn has_more_than_checkpoint<C: Serialize + Default>(section: Option<&C>) -> bool {
    let settings = |section: &C| match serde_json::to_value(section) {
        Ok(Value::Object(mut settings)) => {
            let checkpoint = settings.remove("checkpoint");
            // A checkpoint is calibrated on the chosen scenes.
            if settings.remove("calibrate").is_some() {
                settings.retain(|name, _| !["data", "own_weight"].contains(&name.as_str()));
            }
            Some((checkpoint, settings))
        }
        _ => None,
    };
    let (own, default) = (section.and_then(settings), settings(&C::default()));
    own.zip(default).is_some_and(|((checkpoint, own), (_, default))| {
        checkpoint.is_some_and(|checkpoint| !checkpoint.is_null()) && own != default
    })
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
        let found = remarks(&["generate.arms=[{ name = \"idle\" }]"]);
        assert_eq!(found, ["generate.arms has idle, which no request names"]);
        assert!(remarks(&["train.denoiser.checkpoint=\"a\"", "train.distill.steps=7"]).is_empty());
        let calibrated = ["train.denoiser.checkpoint=\"a\"", "train.denoiser.calibrate=true"];
        let with = |more: &str| remarks(&[&calibrated[..], &[more]].concat());
        assert!(with("train.denoiser.data=[{ scenes = \"more\" }]").is_empty());
        assert!(with("train.denoiser.steps=7")[0].contains("the other settings"));
        let found = remarks(&["train.denoiser.checkpoint=\"a\"", "train.denoiser.steps=7"]);
        assert!(found.len() == 1 && found[0].starts_with("train.denoiser.checkpoint is used as it is"), "{found:?}");
    }
}

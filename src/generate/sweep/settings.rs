//! Every setting that a sample was drawn with, for its provenance.

use super::{Diffusion, ResolvedSweep, SweepModel};
use crate::scene::GuidanceLevel;
use serde_json::{Value, json};

impl ResolvedSweep {
    /// The settings of a sample of this sweep at `level` as JSON: sampler, observed states, edits, and its guidance
    /// with strengths and every option of the objectives. Settings without effect at this level are left out.
    pub(in crate::generate) fn settings(&self, level: GuidanceLevel) -> String {
        let mut settings = match &self.model {
            SweepModel::Denoiser(diffusion) | SweepModel::Distilled(diffusion) => diffusion.settings(level),
            SweepModel::Baseline => json!({}),
        };
        settings["model"] = json!(match self.model {
            SweepModel::Denoiser(_) => "denoiser",
            SweepModel::Distilled(_) => "distilled",
            SweepModel::Baseline => "baseline",
        });
        settings["observe"] = json!(self.observe);
        if let Some(rollout) = &self.rollout {
            settings["rollout"] = json!(rollout);
        }
        settings.to_string()
    }
}

impl Diffusion {
    fn settings(&self, level: GuidanceLevel) -> Value {
        let mut settings = json!({ "sampler": self.sampler, "validity_strength": self.validity_strength });
        if let Some(edit) = &self.edit {
            settings["edit"] = json!(edit);
        }
        if !self.template.is_empty() {
            settings["template"] = json!(true);
        }
        if level.strength != 0.0 {
            let guidance = &self.guidance;
            settings["strength"] = json!(level.strength);
            settings["guidance"] = json!(guidance.gate);
            settings["classifier_scope"] = json!(guidance.classifier_scope);
            // The only ways, named so that ids of scenarios stay what they were.
            settings["classifier_input"] = json!("noisy_states");
            settings["objective_guidance"] = json!({ "damped": true, "inner_steps": 1 });
            if !guidance.classifier_potential.is_default() {
                settings["classifier_potential"] = json!(guidance.classifier_potential);
            }
            settings["objectives"] = json!(guidance.objectives);
        }
        if let Some(config) = self.classifier_free.as_ref().filter(|_| level.weight != 0.0) {
            let mut classifier_free = json!(config);
            classifier_free.as_object_mut().map(|config| config.remove("weights"));
            classifier_free["weight"] = json!(level.weight);
            settings["classifier_free"] = classifier_free;
        }
        settings
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::generate::testing::resolve;

    fn settings(toml: &str) -> Vec<Value> {
        let resolved = resolve(&format!("[[sweeps]]\nname = 's'\nn_scenes = 1\nbehavior = 'drift'\n{toml}"));
        let sweep = &resolved.sweeps[0];
        sweep.levels().iter().map(|level| serde_json::from_str(&sweep.settings(*level)).unwrap()).collect()
    }

    #[test]
    fn what_acts_is_told_with_its_options() {
        let found =
            settings("strengths = [0.0, 2.0]\nobjectives = [{ kind = 'acceleration_limit', limit_mps2 = 7.0 }]");
        assert_eq!(found[0].get("objectives").or(found[0].get("strength")), None);
        assert_eq!(found[0]["sampler"]["n_steps"], 4);
        assert_eq!(found[1]["strength"], 2.0);
        let objective = &found[1]["objectives"][0];
        assert_eq!((&objective["kind"], &objective["limit_mps2"]), (&"acceleration_limit".into(), &7.0.into()));
        let goals = "classifier_free = { extra = [{ agents = 'all', times = 'goal' }], weights = [0.0, 0.5] }";
        let found = settings(goals);
        assert_eq!(found[0].get("classifier_free"), None);
        assert_eq!(found[1]["classifier_free"]["weight"], 0.5);
        assert_eq!(settings("")[0], settings("n_samples = 9\nstrengths = [0.0]")[0]);
        assert_ne!(settings("")[0], settings("edit = { tau = 0.5 }")[0]);
    }
}

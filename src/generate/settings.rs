//! Every setting that a sample was drawn with, for its provenance.

use super::{GenerateConfig, Level, SweepConfig};
use serde_json::Value;

/// Keys of a sweep that decide which samples there are, and not what they are.
const NOT_OF_A_SAMPLE: [&str; 8] =
    ["name", "n_scenes", "n_samples", "strengths", "behavior", "pairs", "select", "stop_after_verified"];
/// Keys that mean nothing without guidance.
const OF_GUIDANCE: [&str; 5] = ["guidance", "classifier_scope", "classifier_input", "objectives", "objective_guidance"];

impl SweepConfig {
    /// The settings of a sample of this sweep at `level` as JSON: sampler, what is observed, edits, and how it is guided and
    /// how strongly, with every option of the objectives. What has no effect at this level is left out.
    pub(super) fn settings(&self, config: &GenerateConfig, level: Level) -> String {
        // A configuration of plain values always becomes JSON.
        let mut settings = serde_json::to_value(self).unwrap_or_default();
        if let Value::Object(settings) = &mut settings {
            NOT_OF_A_SAMPLE.iter().for_each(|key| _ = settings.remove(*key));
            if level.strength == 0.0 {
                OF_GUIDANCE.iter().for_each(|key| _ = settings.remove(*key));
            } else {
                settings.insert("strength".to_owned(), level.strength.into());
            }
            match settings.get_mut("classifier_free") {
                Some(Value::Object(classifier_free)) if level.weight != 0.0 => {
                    classifier_free.remove("weights");
                    classifier_free.insert("weight".to_owned(), level.weight.into());
                }
                _ => _ = settings.remove("classifier_free"),
            }
            settings.insert("validity_strength".to_owned(), self.validity_strength(config).into());
            settings.insert("sampler".to_owned(), serde_json::to_value(self.sampler(config)).unwrap_or_default());
            settings.retain(|_, value| !value.is_null());
        }
        settings.to_string()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::generate::testing::config;

    fn settings(toml: &str) -> Vec<Value> {
        let config = config(&format!("[[sweeps]]\nname = 's'\nn_scenes = 1\nbehavior = 'drift'\n{toml}"));
        let sweep = &config.sweeps[0];
        let text = |level: Level| sweep.settings(&config, level);
        sweep.levels().into_iter().map(|level| serde_json::from_str(&text(level)).unwrap()).collect()
    }

    #[test]
    fn what_acts_is_told_with_its_options() {
        let found = settings("strengths = [0.0, 2.0]\nobjectives = [{ kind = 'target_speed', speed_mps = 7.0 }]");
        assert_eq!(found[0].get("objectives").or(found[0].get("strength")), None);
        assert_eq!(found[0]["sampler"]["n_steps"], 4);
        assert_eq!(found[1]["strength"], 2.0);
        let objective = &found[1]["objectives"][0];
        assert_eq!((&objective["kind"], &objective["speed_mps"]), (&"target_speed".into(), &7.0.into()));
        let goals = "classifier_free = { extra = [{ agents = 'all', times = 'goal' }], weights = [0.0, 0.5] }";
        let found = settings(goals);
        assert_eq!(found[0].get("classifier_free"), None);
        assert_eq!(found[1]["classifier_free"]["weight"], 0.5);
        assert_eq!(settings("")[0], settings("n_samples = 9\nstrengths = [0.0]")[0]);
        assert_ne!(settings("")[0], settings("edit = { tau = 0.5 }")[0]);
    }
}

//! What guides a sweep? The questions that a sweep's configuration answers, and what makes no sense in it.

use super::{Level, ObserveConfig, SelectConfig, SweepConfig};
use crate::behavior;
use crate::guidance::CleanGradient;
use crate::tensor::MaskTask;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Whom the classifier of the behavior looks at.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ClassifierScope {
    /// The pair that is asked: chosen beforehand, and verified.
    #[default]
    Pair,
    /// Whichever pair of the scene comes nearest to the behavior (ln of the sum of all pairs' probabilities). Nobody is asked in
    /// particular; a scenario is verified if anybody performs the behavior.
    AnyPair,
    /// Nobody: objectives alone guide. Pairs are chosen and verified as with `pair`.
    None,
}

/// What the classifier of the behavior is shown of a sample that is being denoised.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ClassifierInput {
    /// The noisy states (paper, section 5.2): it was trained on them at every noise level.
    #[default]
    NoisyStates,
    /// The denoiser's clean estimate, as objectives are. Needed where more than the history is observed (`observe`): of other
    /// masks the classifier knows no noisy states. `objective_guidance` says how its gradient becomes a shift.
    CleanEstimate,
}

impl SweepConfig {
    /// Whether some of its samples are guided.
    pub fn is_guided(&self) -> bool {
        self.strengths.iter().any(|strength| *strength != 0.0)
    }

    /// Whether some of its samples are forecasts: neither guided nor leaning toward wanted states nor edited.
    pub fn has_unguided(&self) -> bool {
        let is_plain = |level: &Level| level.strength == 0.0 && level.weight == 0.0;
        self.edit.is_none() && self.levels().iter().any(is_plain)
    }

    /// Whether some of its samples are guided by the classifier of its behavior.
    pub fn needs_classifier(&self) -> bool {
        self.is_guided() && self.behavior.is_some() && self.classifier_scope != ClassifierScope::None
    }

    /// Whether wishes of clean estimates are carried back through the network.
    pub(super) fn guides_through_network(&self) -> bool {
        let judges_estimates = self.classifies_estimates() || (self.is_guided() && !self.objectives.is_empty());
        judges_estimates && self.objective_guidance.gradient == CleanGradient::ThroughNetwork
    }

    fn classifies_estimates(&self) -> bool {
        self.needs_classifier() && self.classifier_input == ClassifierInput::CleanEstimate
    }

    /// Whether two agents of each scene are asked for the behavior.
    pub(super) fn asks_pairs(&self) -> bool {
        let Some(id) = &self.behavior else { return false };
        let known = behavior::ALL.iter().find(|known| known.id == id);
        self.classifier_scope != ClassifierScope::AnyPair && known.is_none_or(|known| known.roles.len() > 1)
    }

    /// Says what of the guidance makes no sense, as far as that can be told without the mined behaviors.
    pub(super) fn check_guidance(&self) -> Result<(), String> {
        if self.guides_through_network() && self.classifies_estimates() && !self.objectives.is_empty() {
            return Err("objective_guidance.gradient = \"through_network\" goes through the network once: for objectives, or for \
                        classifier_input = \"clean_estimate\"; for both use gradient = \"clean\""
                .to_owned());
        }
        if self.behavior.is_none() && self.classifier_scope == ClassifierScope::AnyPair {
            return Err("classifier_scope = \"any_pair\" needs a behavior, such as behavior = \"cut_in\"".to_owned());
        }
        if self.objectives.is_empty() && self.is_guided() && !self.needs_classifier() {
            let missing = match self.behavior {
                Some(_) => "guided strengths with classifier_scope = \"none\" need objectives",
                None => "guided strengths need a behavior, such as behavior = \"cut_in\", or objectives",
            };
            return Err(missing.to_owned());
        }
        let selects = self.select.as_ref().is_some_and(SelectConfig::names_objectives);
        if !self.objectives.is_empty() && !self.is_guided() && !selects {
            return Err(
                "objectives guide at strengths other than 0 alone; add some, such as strengths = [1.0], or select by \
                        them, such as select = { best = 1, by = [\"objectives\"] }"
                    .to_owned(),
            );
        }
        match self.behavior.as_deref() {
            None => self.check_objectives(&[]),
            Some(id) => match behavior::ALL.iter().find(|known| known.id == id) {
                Some(known) => self.check_objectives(known.roles),
                None => Ok(()),
            },
        }
    }

    /// Says why the classifier cannot guide under the sweep's observation mask.
    pub(super) fn check_classifier_input(&self) -> Result<(), String> {
        let hides_history = match &self.observe {
            ObserveConfig::Task(task) => {
                matches!(task, MaskTask::Windowed | MaskTask::Upsampling | MaskTask::Imputation)
            }
            // What rules hide is seen when they meet a scene.
            ObserveConfig::Mask(_) => false,
        };
        if hides_history {
            return Err(
                "guidance by a classifier, which looks at histories, needs an observe that shows them".to_owned()
            );
        }
        match (self.observe == ObserveConfig::default(), self.classifier_input) {
            (false, ClassifierInput::NoisyStates) => {
                Err("a classifier knows noisy states of observe = \"predictive\" alone; \
                 with other masks it needs classifier_input = \"clean_estimate\""
                    .to_owned())
            }
            _ => Ok(()),
        }
    }

    /// Says what makes no sense in the objectives of a sweep whose behavior has `roles`.
    pub(super) fn check_objectives(&self, roles: &[&str]) -> Result<(), String> {
        let is_anybody = self.classifier_scope == ClassifierScope::AnyPair;
        let roles = if is_anybody { &[] } else { roles };
        for (i, objective) in self.objectives.iter().enumerate() {
            let kind = objective.objective().kind();
            objective.validate(roles).map_err(|why| format!("objectives.{i} ({kind}): {why}"))?;
        }
        Ok(())
    }
}

//! What guides a sweep? The questions that a sweep's configuration answers, and what makes no sense in it.

use super::SweepConfig;
use crate::behavior;
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

impl SweepConfig {
    /// Whether some of its samples are guided.
    pub fn is_guided(&self) -> bool {
        self.strengths.iter().any(|strength| *strength != 0.0)
    }

    /// Whether some of its samples are guided by the classifier of its behavior.
    pub fn needs_classifier(&self) -> bool {
        self.is_guided() && self.behavior.is_some() && self.classifier_scope != ClassifierScope::None
    }

    /// Says what of the guidance makes no sense, as far as that can be told without the mined behaviors.
    pub(super) fn check_guidance(&self) -> Result<(), String> {
        if self.objective_guidance.inner_steps == 0 {
            return Err("objective_guidance.inner_steps is 0, expected at least 1".to_owned());
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
        if !self.objectives.is_empty() && !self.is_guided() {
            return Err(
                "objectives act at strengths other than 0 alone; add some, such as strengths = [1.0]".to_owned()
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

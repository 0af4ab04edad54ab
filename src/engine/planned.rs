//! A stage with the decision on it: what the plan says and execution reads.

use super::earlier::Earlier;
use super::kept_models::Kept;
use super::record::StageRecord;
use super::stage::Stage;
use serde::Serialize;
use std::fmt;

/// A stage with its action.
pub struct PlannedStage<'a> {
    /// The stage.
    pub stage: Box<dyn Stage + 'a>,
    /// The record that a run of it would have.
    pub expected: StageRecord,
    /// The action to take.
    pub action: Action,
    /// What earlier runs left of it.
    pub(super) earlier: Earlier,
    /// Trained models that are moved aside for new ones.
    pub kept: Vec<Kept>,
    /// Whether it may run: the user selected it, or selected nothing.
    pub is_selected: bool,
    /// Whether it is to be done again even if it is up to date.
    pub is_requested: bool,
}

impl PlannedStage<'_> {
    /// Hash of its outputs; `None` while unknown, because it may run.
    pub(super) fn content(&self) -> Option<String> {
        self.earlier.done.as_ref().filter(|_| self.action == Action::Reuse).and_then(StageRecord::content)
    }

    /// For a stage that is done again: why, and what happens to its earlier results.
    pub fn redone(&self) -> Option<String> {
        let Action::Run(why) = &self.action else { return None };
        let kept = self.kept.iter().map(|Kept { name, as_name }| format!("; the current {name} is moved to {as_name}"));
        self.earlier
            .done
            .is_some()
            .then(|| format!("{} runs again: {why}{}", self.expected.stage, kept.collect::<String>()))
    }
}

/// The action for a stage.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Action {
    /// Nothing: its outputs exist, from the same configuration and inputs.
    Reuse,
    /// Continue an interrupted run.
    Resume,
    /// Run it from the start, for this reason.
    Run(String),
}

impl fmt::Display for Action {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Reuse => f.write_str("cached"),
            Self::Resume => f.write_str("fresh (resumes an interrupted run)"),
            Self::Run(why) => write!(f, "fresh ({why})"),
        }
    }
}

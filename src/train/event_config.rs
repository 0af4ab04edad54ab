//! `[train.denoiser.events]`: which mined events is a denoiser conditioned on, and how often?

use crate::behavior;
use crate::settings::{self, Issue};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Mined events that the network is told of, so that samples can ask for them (`classifier_free = { event = true }`).
///
/// A share of each batch is drawn from events that begin after the present, and these rows are told theirs. All other
/// rows are ordinary scenes that are told nothing, whether an event happens in them or not. What the network does
/// untold is so learned from ordinary traffic alone, as without this section; it is what classifier-free guidance leans
/// away from.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct EventTraining {
    /// The behaviors, among those that are mined. They take turns, however many events they have.
    pub behaviors: Vec<String>,
    /// The share of a batch that is told an event.
    #[serde(default = "half")]
    #[schemars(extend("exclusiveMinimum" = 0, "exclusiveMaximum" = 1))]
    pub share: f64,
    /// The chance that none of an event's values is told, only the behavior and who takes part; and otherwise the
    /// chance of each value that it is not told.
    #[serde(default = "three_tenths")]
    #[schemars(range(min = 0.0), extend("exclusiveMaximum" = 1))]
    pub value_dropout: f64,
}

const fn half() -> f64 {
    0.5
}

const fn three_tenths() -> f64 {
    0.3
}

impl EventTraining {
    /// Refuses behaviors that there are not.
    pub(super) fn validate(&self) -> settings::Result {
        settings::check_ranges(self)?;
        if self.behaviors.is_empty() {
            return Err(Issue::new("behaviors", "is empty, expected mined behaviors, such as [\"cut_in\"]"));
        }
        settings::distinct("behaviors", &self.behaviors)?;
        let is_unknown = |id: &String| behavior::BehaviorEntry::of(id).is_none();
        match self.behaviors.iter().position(is_unknown) {
            Some(i) => {
                let known: Vec<&str> = behavior::ALL.iter().map(|entry| entry.id).collect();
                let why = format_args!("is \"{}\", expected one of {}", self.behaviors[i], known.join(", "));
                Err(Issue::new(format!("behaviors.{i}"), why))
            }
            None => Ok(()),
        }
    }
}

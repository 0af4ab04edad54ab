//! What could still come of a scene, told from what was observed and from the map alone?

use std::collections::BTreeMap;

/// Parameters of an event that agents could still show, by the names under which the event would report them. A parameter that is not
/// named may come out as anything.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Outcome {
    parameters: BTreeMap<&'static str, f64>,
    effort: f64,
}

impl Outcome {
    /// The same with one parameter more; what is not defined (`None`) is left out.
    #[must_use]
    pub(crate) fn with(mut self, name: &'static str, value: impl Into<Option<f64>>) -> Self {
        if let Some(value) = value.into() {
            self.parameters.insert(name, value);
        }
        self
    }

    /// The value of a parameter, where it is named.
    pub fn get(&self, name: &str) -> Option<f64> {
        self.parameters.get(name).copied()
    }

    /// The same, said to take so much of what the limits of driving allow.
    #[must_use]
    pub(crate) const fn at_effort(mut self, effort: f64) -> Self {
        self.effort = effort;
        self
    }

    /// How much of the limits of driving it takes, from 0 to 1.
    pub const fn effort(&self) -> f64 {
        self.effort
    }
}

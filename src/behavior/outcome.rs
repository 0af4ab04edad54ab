//! Which events can agents still reach, judged from their past and the map alone?

use std::collections::BTreeMap;

/// The parameters of an event that agents can still show, under the names that the event would have. Other parameters
/// can take any value.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Outcome {
    parameters: BTreeMap<&'static str, f64>,
    effort: f64,
}

impl Outcome {
    /// Adds a parameter; an undefined one (`None`) is left out.
    #[must_use]
    pub(crate) fn with(mut self, name: &'static str, value: impl Into<Option<f64>>) -> Self {
        if let Some(value) = value.into() {
            self.parameters.insert(name, value);
        }
        self
    }

    /// The value of a parameter, if it is named.
    pub fn get(&self, name: &str) -> Option<f64> {
        self.parameters.get(name).copied()
    }

    /// Whether it names every parameter in `ranges` with a value in its range, ends included.
    pub(super) fn is_within(&self, ranges: &BTreeMap<String, [f64; 2]>) -> bool {
        self.may_be_within(ranges) && ranges.keys().all(|name| self.get(name).is_some())
    }

    /// Whether all of its parameters that are in `ranges` lie in their ranges. Parameters that it lacks may still do
    /// so.
    pub(super) fn may_be_within(&self, ranges: &BTreeMap<String, [f64; 2]>) -> bool {
        let is_in = |(name, [low, high]): (&String, &[f64; 2])| {
            self.get(name).is_none_or(|value| (*low..=*high).contains(&value))
        };
        ranges.iter().all(is_in)
    }

    /// Sets the effort.
    #[must_use]
    pub(crate) const fn at_effort(mut self, effort: f64) -> Self {
        self.effort = effort;
        self
    }

    /// The share of the limits of driving that it uses, from 0 to 1.
    pub const fn effort(&self) -> f64 {
        self.effort
    }
}

//! The guidance level of a sample: two numbers, one of which varies within a sweep.

use serde::{Deserialize, Serialize};
use std::fmt;

/// The strength of guidance, and the weight of target states.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct GuidanceLevel {
    /// Strength α of the guidance by classifier and objectives; 0 is none.
    pub strength: f64,
    /// Weight λ of classifier-free guidance; 0 is none.
    pub weight: f64,
}

impl GuidanceLevel {
    /// The level of forecasts and recordings.
    pub const UNGUIDED: Self = Self { strength: 0.0, weight: 0.0 };

    /// Guidance of this strength, without target states.
    pub const fn of_strength(strength: f64) -> Self {
        Self { strength, weight: 0.0 }
    }
}

/// `α = 2`, `λ = 0.5`, or both.
impl fmt::Display for GuidanceLevel {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (self.strength, self.weight) {
            (strength, 0.0) => write!(f, "α = {strength}"),
            (0.0, weight) => write!(f, "λ = {weight}"),
            (strength, weight) => write!(f, "α = {strength}, λ = {weight}"),
        }
    }
}

/// The number in which the levels of a sweep differ; the other is constant.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LevelAxis {
    /// The strength α.
    Strength,
    /// The weight λ.
    Weight,
}

impl LevelAxis {
    /// The axis of these levels of one sweep; the strength if they do not differ.
    pub fn of(levels: impl IntoIterator<Item = GuidanceLevel>) -> Self {
        let mut weights = levels.into_iter().map(|level| level.weight);
        let first = weights.next();
        if weights.any(|weight| Some(weight) != first) { Self::Weight } else { Self::Strength }
    }

    /// Its number in a level.
    pub const fn read(self, level: GuidanceLevel) -> f64 {
        match self {
            Self::Strength => level.strength,
            Self::Weight => level.weight,
        }
    }

    /// Its name.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Strength => "strength",
            Self::Weight => "weight",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn levels_are_told_by_what_acts_and_sweeps_by_what_varies() {
        let level = |strength, weight| GuidanceLevel { strength, weight };
        let words = [level(0.0, 0.0), level(2.0, 0.0), level(0.0, 0.5), level(2.0, 0.5)].map(|level| level.to_string());
        assert_eq!(words, ["α = 0", "α = 2", "λ = 0.5", "α = 2, λ = 0.5"]);
        assert_eq!(LevelAxis::of([level(0.0, 0.5), level(2.0, 0.5)]), LevelAxis::Strength);
        assert_eq!(LevelAxis::of([level(2.0, 0.0), level(2.0, 0.5)]), LevelAxis::Weight);
        assert_eq!(LevelAxis::of([level(2.0, 0.5)]), LevelAxis::Strength);
    }
}

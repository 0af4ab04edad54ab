//! The events that a network can be conditioned on: behaviors, roles, and the units of their values.

use crate::quantile::quantile;
use crate::seed::Seed;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// The value that every event has beside its parameters: the time from the present to its first timestep, seconds.
pub const ONSET: &str = "onset_s";

/// Values in robust units are cut off here, so that an outlier does not drown everything else.
const MOST_UNITS: f64 = 4.0;
/// Shares of a normal distribution below its mean minus and plus one standard deviation.
const ONE_DEVIATION: [f64; 2] = [0.1587, 0.8413];
/// Decimal digits of examples: they are drawn from, not computed with.
const EXAMPLE_DIGITS: i32 = 4;

/// The events that a network can be conditioned on, in the order of its inputs.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EventVocabulary {
    /// The behaviors.
    pub behaviors: Vec<KnownBehavior>,
}

/// A behavior that a network can be conditioned on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct KnownBehavior {
    /// Its name.
    pub id: String,
    /// Its roles, in the order of its events.
    pub roles: Vec<String>,
    /// Its values with their units: the onset, and the parameters that its events have.
    pub values: Vec<ValueUnit>,
    /// Number of events that the network was trained on.
    pub n_events: usize,
    /// Some of these events, from which values are drawn when none are requested.
    pub examples: Vec<EventExample>,
}

/// The robust unit of a value: (value - center) / spread.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ValueUnit {
    /// Its name.
    pub name: String,
    /// The median. 0 for a value that takes both signs, such as a side, so that the sign of the input is that of the
    /// value.
    pub center: f64,
    /// Half of what lies between -1 and +1 standard deviation of a normal distribution; around 0, the median distance
    /// from it.
    pub spread: f64,
}

/// The values of a mined event, and how its agents were at the present.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EventExample {
    /// The state of the agents at the present ([`present_of`](super::present_of)).
    pub present: Vec<f64>,
    /// Its values by name.
    pub values: BTreeMap<String, f64>,
}

impl EventVocabulary {
    /// The behavior of this name.
    pub fn behavior(&self, id: &str) -> Option<&KnownBehavior> {
        self.behaviors.iter().find(|behavior| behavior.id == id)
    }

    /// Number of inputs of an agent.
    pub fn n_inputs(&self) -> usize {
        self.behaviors.iter().map(KnownBehavior::n_inputs).sum()
    }

    /// The first input of a behavior, and the behavior.
    pub(super) fn place(&self, id: &str) -> Option<(usize, &KnownBehavior)> {
        let at = self.behaviors.iter().position(|behavior| behavior.id == id)?;
        Some((self.behaviors[..at].iter().map(KnownBehavior::n_inputs).sum(), &self.behaviors[at]))
    }

    /// Whether the inputs of a network for this vocabulary have the same meaning in `other`, up to units.
    pub fn has_inputs_of(&self, other: &Self) -> bool {
        let shape = |known: &KnownBehavior| {
            let names: Vec<String> = known.values.iter().map(|unit| unit.name.clone()).collect();
            (known.id.clone(), known.roles.clone(), names)
        };
        self.behaviors.iter().map(shape).eq(other.behaviors.iter().map(shape))
    }

    /// The names of the behaviors, for messages.
    pub fn names(&self) -> String {
        self.behaviors.iter().map(|behavior| behavior.id.as_str()).collect::<Vec<_>>().join(", ")
    }
}

impl KnownBehavior {
    /// The behavior `id` with these roles and the values of its `events`, in units that follow from them. A value that
    /// no event has is none of its values.
    pub fn new(id: &str, roles: &[&str], events: &[BTreeMap<String, f64>], examples: Vec<EventExample>) -> Self {
        let mut by_name: BTreeMap<&str, Vec<f64>> = BTreeMap::new();
        for (name, value) in events.iter().flatten() {
            by_name.entry(name).or_default().push(*value);
        }
        Self {
            id: id.to_owned(),
            roles: roles.iter().map(|role| (*role).to_owned()).collect(),
            values: by_name.into_iter().map(|(name, values)| ValueUnit::new(name, values)).collect(),
            n_events: events.len(),
            examples,
        }
    }

    /// Inputs of a role: whether the agent has it, and for each value whether it is given, and the value.
    pub(super) const fn n_inputs_of_role(&self) -> usize {
        1 + 2 * self.values.len()
    }

    const fn n_inputs(&self) -> usize {
        self.roles.len() * self.n_inputs_of_role()
    }

    /// At most `n` of `examples`, drawn from `seed`, in their order, with few digits.
    pub fn chosen_examples(examples: &[EventExample], n: usize, seed: Seed) -> Vec<EventExample> {
        let mut order: Vec<usize> = (0..examples.len()).collect();
        seed.rng().shuffle(&mut order);
        order.truncate(n);
        order.sort_unstable();
        let rounded = |value: &f64| (value * 10f64.powi(EXAMPLE_DIGITS)).round() / 10f64.powi(EXAMPLE_DIGITS);
        let short = |EventExample { present, values }: &EventExample| EventExample {
            present: present.iter().map(rounded).collect(),
            values: values.iter().map(|(name, value)| (name.clone(), rounded(value))).collect(),
        };
        order.into_iter().map(|i| short(&examples[i])).collect()
    }
}

impl ValueUnit {
    /// The unit of some values, at least one.
    fn new(name: &str, mut values: Vec<f64>) -> Self {
        values.sort_by(f64::total_cmp);
        let has_both_signs = values[0] < 0.0 && values[values.len() - 1] > 0.0;
        let (center, spread) = if has_both_signs {
            let mut sizes: Vec<f64> = values.iter().map(|value| value.abs()).collect();
            sizes.sort_by(f64::total_cmp);
            (0.0, quantile(&sizes, 0.5).unwrap_or_default())
        } else {
            let at = |share: f64| quantile(&values, share).unwrap_or_default();
            let [low, high] = ONE_DEVIATION.map(at);
            (at(0.5), 0.5 * (high - low))
        };
        // A value that is always the same says nothing in any unit.
        let spread = if spread > 1e-6 { spread } else { 1.0 };
        Self { name: name.to_owned(), center, spread }
    }

    /// The value in this unit.
    pub fn scaled(&self, value: f64) -> f64 {
        ((value - self.center) / self.spread).clamp(-MOST_UNITS, MOST_UNITS)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn unit(values: &[f64]) -> ValueUnit {
        ValueUnit::new("gap_m", values.to_vec())
    }

    #[test]
    fn units_are_medians_and_deviations_whatever_the_outliers() {
        // 0 to 100 and an outlier: the median of 102 values is 50.5, and the quantiles are near 16 and 85.
        let values: Vec<f64> = (0..=100).map(f64::from).chain([1e6]).collect();
        let found = unit(&values);
        assert_eq!(found.center, 50.5);
        assert!((found.spread - 0.5 * 0.6826 * 101.0).abs() < 1e-9, "{}", found.spread);
        assert_eq!((found.scaled(50.5), found.scaled(1e6), found.scaled(-1e6)), (0.0, 4.0, -4.0));
    }

    #[test]
    fn values_of_both_signs_keep_their_sign() {
        // Four left, one right: a median would turn every left into 0.
        let side = unit(&[1.0, 1.0, 1.0, 1.0, -1.0]);
        assert_eq!((side.scaled(1.0), side.scaled(-1.0)), (1.0, -1.0));
        let speed = unit(&[4.0, 2.0, -2.0, 8.0, -0.5]);
        assert_eq!((speed.center, speed.spread, speed.scaled(-1.0)), (0.0, 2.0, -0.5));
        assert_eq!(unit(&[3.0, 3.0]).scaled(3.5), 0.5);
    }

    #[test]
    fn inputs_follow_each_other_by_behavior_and_role() {
        let event = |names: &[&str]| names.iter().map(|name| ((*name).to_owned(), 1.0)).collect::<BTreeMap<_, _>>();
        let pair = KnownBehavior::new("cut_in", &["ego", "other"], &[event(&["gap_m"]), event(&["onset_s"])], vec![]);
        let single = KnownBehavior::new("hard_brake", &["agent"], &[event(&["onset_s"])], vec![]);
        let vocabulary = EventVocabulary { behaviors: vec![pair.clone(), single.clone()] };
        // Two roles with a flag and two values of two inputs each; then one role with one value.
        assert_eq!(vocabulary.n_inputs(), 2 * 5 + 3);
        assert_eq!(vocabulary.place("hard_brake").unwrap().0, 10);
        assert!(vocabulary.place("near_miss").is_none());
        let other = EventVocabulary { behaviors: vec![single, pair] };
        assert!(vocabulary.has_inputs_of(&vocabulary) && !vocabulary.has_inputs_of(&other));
    }

    #[test]
    fn few_examples_are_kept_in_their_order() {
        let example = |i: usize| EventExample { present: vec![i as f64 + 1e-9], values: BTreeMap::new() };
        let all: Vec<EventExample> = (0..50).map(example).collect();
        let kept = KnownBehavior::chosen_examples(&all, 10, Seed(3));
        let presents: Vec<f64> = kept.iter().map(|example| example.present[0]).collect();
        assert!(presents.len() == 10 && presents.windows(2).all(|pair| pair[0] < pair[1]), "{presents:?}");
        assert!(presents.iter().all(|value| value.fract() == 0.0), "{presents:?}");
        assert_eq!(KnownBehavior::chosen_examples(&all, 99, Seed(3)).len(), 50);
    }
}

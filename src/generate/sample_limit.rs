//! Limits on a metric or an objective of a sample.

use crate::settings::{self, Issue};
use schemars::JsonSchema;
use serde::de::value::{MapAccessDeserializer, SeqAccessDeserializer};
use serde::de::{Error as _, MapAccess, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize};
use std::fmt;

/// A limit of a metric or objective. Its ends are included.
///
/// A plain number is the worst value to keep, for metrics with a direction: the maximum if lower is better
/// (`collision_rate = 0.0`), the minimum if higher is better (`validity_rate = 1.0`). An undefined value satisfies it.
///
/// A range states its sides and works for every metric, including those without a direction, such as times to
/// collision: `[1.0, 2.5]`, `{ at_least = 1.0 }` or `{ at_most = 2.5 }`. An undefined value, such as the time to
/// collision without a collision course, counts as larger than every number: it satisfies `at_least` and violates
/// `at_most`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, JsonSchema)]
#[serde(untagged)]
pub enum Limit {
    /// The worst value to keep.
    Worst(f64),
    /// The least and the largest value to keep.
    Between([f64; 2]),
    /// The least value, the largest one, or both.
    Range(LimitRange),
}

/// The sides of a range, at least one of them.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct LimitRange {
    /// The least value to keep.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub at_least: Option<f64>,
    /// The largest value to keep.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub at_most: Option<f64>,
}

impl Limit {
    /// Rejects a limit under this key that no value can satisfy, or none can violate. `has_direction` is whether higher
    /// or lower values are better.
    pub(super) fn validate(&self, key: &str, has_direction: bool) -> settings::Result {
        let refuse = |why: String| Err(Issue::new(key, why));
        let range = match self {
            Self::Worst(value) if value.is_nan() => return refuse(format!("is {value}, expected a number")),
            Self::Worst(value) if !has_direction => {
                return refuse(format!(
                    "is {value}, but neither direction is better; give a side, as in {{ at_most = {value:?} }}, \
                     {{ at_least = {value:?} }} or [least, largest]"
                ));
            }
            Self::Worst(_) => return Ok(()),
            Self::Between([least, most]) => LimitRange { at_least: Some(*least), at_most: Some(*most) },
            Self::Range(range) => *range,
        };
        match (range.at_least, range.at_most) {
            (None, None) => refuse("is an empty range; set at_least, at_most or both".to_owned()),
            (Some(least), Some(most)) if least > most => {
                refuse(format!("is empty: at least {least} and at most {most}"))
            }
            (least, most) if least.into_iter().chain(most).any(f64::is_nan) => {
                refuse("has an end that is not a number".to_owned())
            }
            _ => Ok(()),
        }
    }

    /// Why a value violates the limit, in words that follow its name; `None` if it satisfies it. `higher_is_better`
    /// decides what a plain number means.
    pub(super) fn broken_by(&self, value: Option<f64>, higher_is_better: bool) -> Option<String> {
        let range = match (*self, value) {
            (Self::Worst(worst), Some(value)) => {
                let is_beyond = if higher_is_better { value < worst } else { value > worst };
                return is_beyond.then(|| format!("beyond {worst}"));
            }
            (Self::Worst(_), None) => return None,
            (Self::Between([least, most]), _) => LimitRange { at_least: Some(least), at_most: Some(most) },
            (Self::Range(range), _) => range,
        };
        let (least, most) = (range.at_least, range.at_most);
        match value {
            None => most.map(|most| format!("not defined, so above {most}")),
            Some(value) => {
                let below = least.filter(|least| value < *least).map(|least| format!("below {least}"));
                below.or_else(|| most.filter(|most| value > *most).map(|most| format!("above {most}")))
            }
        }
    }
}

impl<'de> Deserialize<'de> for Limit {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(LimitVisitor)
    }
}

/// Reads a limit and, unlike an untagged enum, reports what is wrong with it.
struct LimitVisitor;

impl<'de> Visitor<'de> for LimitVisitor {
    type Value = Limit;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a limit: a number, [least, largest], { at_least = … } or { at_most = … }")
    }

    fn visit_f64<E>(self, value: f64) -> Result<Limit, E> {
        Ok(Limit::Worst(value))
    }

    fn visit_i64<E>(self, value: i64) -> Result<Limit, E> {
        Ok(Limit::Worst(value as f64))
    }

    fn visit_u64<E>(self, value: u64) -> Result<Limit, E> {
        Ok(Limit::Worst(value as f64))
    }

    fn visit_seq<A: SeqAccess<'de>>(self, seq: A) -> Result<Limit, A::Error> {
        let ends: Vec<f64> = Vec::deserialize(SeqAccessDeserializer::new(seq))?;
        match ends.as_slice() {
            [least, most] => Ok(Limit::Between([*least, *most])),
            _ => Err(A::Error::custom(format!("expected a range of two ends, [least, largest], found {}", ends.len()))),
        }
    }

    fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<Limit, A::Error> {
        LimitRange::deserialize(MapAccessDeserializer::new(map)).map(Limit::Range)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;

    fn limit(toml: &str) -> Limit {
        let limits: BTreeMap<String, Limit> = toml::from_str(&format!("x = {toml}")).unwrap();
        limits["x"]
    }

    #[test]
    fn a_plain_number_is_the_worst_that_is_kept_and_ranges_say_their_sides() {
        // (limit, more is better, value, why it is left out)
        for (toml, higher, value, why) in [
            ("0.5", false, Some(0.5), None),
            ("0.5", false, Some(0.6), Some("beyond 0.5")),
            ("0.5", true, Some(0.5), None),
            ("1", true, Some(0.4), Some("beyond 1")),
            ("0", false, None, None),
            ("[1, 2.5]", false, Some(1.0), None),
            ("[1, 2.5]", true, Some(2.5), None),
            ("[1, 2.5]", false, Some(0.9), Some("below 1")),
            ("[1, 2.5]", true, Some(2.6), Some("above 2.5")),
            ("[1, 2.5]", false, None, Some("not defined, so above 2.5")),
            ("{ at_least = 1 }", false, Some(0.9), Some("below 1")),
            ("{ at_least = 1 }", false, Some(1e9), None),
            ("{ at_least = 1 }", false, None, None),
            ("{ at_most = 1.5 }", true, Some(1.6), Some("above 1.5")),
            ("{ at_most = 1.5 }", false, Some(-3.0), None),
            ("{ at_least = 1, at_most = 1 }", false, Some(1.0), None),
        ] {
            assert_eq!(limit(toml).broken_by(value, higher).as_deref(), why, "{toml} {value:?}");
        }
    }

    #[test]
    fn what_was_written_is_written_again() {
        for toml in ["0.0", "[1.0, 2.5]", "{ at_least = 1.0 }"] {
            let read = BTreeMap::from([("x", limit(toml))]);
            let again: BTreeMap<String, Limit> = toml::from_str(&toml::to_string(&read).unwrap()).unwrap();
            assert_eq!(again["x"], read["x"]);
        }
        assert_eq!(serde_json::to_string(&limit("0.25")).unwrap(), "0.25", "fingerprints of earlier runs hold");
    }
}

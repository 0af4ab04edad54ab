//! Limits on metrics of single scenarios.

use crate::metrics::{ALL, Direction, MetricSettings, SampleGroup, by_id};
use crate::settings::{self, Issue};
use schemars::JsonSchema;
use serde::de::value::{MapAccessDeserializer, SeqAccessDeserializer};
use serde::de::{Error as _, MapAccess, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize};
use std::collections::BTreeMap;
use std::fmt;

/// The prefix of metrics that look at the requested pair.
const PAIR_PREFIX: &str = "pair_";

/// A limit of a metric. Its ends are included.
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
    fn validate(&self, key: &str, has_direction: bool) -> settings::Result {
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

    /// Whether a value satisfies the limit. `higher_is_better` decides what a plain number means.
    fn is_met_by(&self, value: Option<f64>, higher_is_better: bool) -> bool {
        let range = match (*self, value) {
            (Self::Worst(worst), Some(value)) => return if higher_is_better { value >= worst } else { value <= worst },
            (Self::Worst(_), None) => return true,
            (Self::Between([least, most]), _) => LimitRange { at_least: Some(least), at_most: Some(most) },
            (Self::Range(range), _) => range,
        };
        match value {
            None => range.at_most.is_none(),
            Some(value) => {
                range.at_least.is_none_or(|least| value >= least) && range.at_most.is_none_or(|most| value <= most)
            }
        }
    }
}

/// Rejects limits of what is no metric, and limits that cannot work. `asks_pairs` is whether a pair is requested, as
/// metrics of pairs need.
pub(super) fn validate(limits: &BTreeMap<String, Limit>, asks_pairs: bool) -> settings::Result {
    for (id, limit) in limits {
        let key = format!("limits.{id}");
        let Some(metric) = by_id(id) else {
            let known: Vec<&str> = ALL.iter().map(|metric| metric.spec().id).collect();
            return Err(Issue::new(key, format_args!("is not a metric ({id}); known here: {}", known.join(", "))));
        };
        if id.starts_with(PAIR_PREFIX) && !asks_pairs {
            return Err(Issue::new(
                key,
                "needs a behavior of two agents, such as behavior = \"cut_in\"; use a metric of the whole scene",
            ));
        }
        limit.validate(&key, metric.spec().direction != Direction::Neither)?;
    }
    Ok(())
}

/// Whether a sample is within all limits.
pub(super) fn are_met(limits: &BTreeMap<String, Limit>, sample: &SampleGroup<'_>, settings: &MetricSettings) -> bool {
    limits.iter().all(|(id, limit)| {
        settings.by_id(id).is_some_and(|metric| {
            limit.is_met_by(metric.evaluate(sample), metric.spec().direction == Direction::HigherIsBetter)
        })
    })
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
    use crate::metrics::{Check, ValidityConfig};
    use crate::scene::testing::{Drive, scene};
    use crate::scene::{Roles, Scene};

    fn limits(toml: &str) -> BTreeMap<String, Limit> {
        toml::from_str(toml).unwrap()
    }

    fn limit(toml: &str) -> Limit {
        limits(&format!("x = {toml}"))["x"]
    }

    #[test]
    fn a_plain_number_is_the_worst_that_is_kept_and_ranges_say_their_sides() {
        // (limit, more is better, value, whether it is kept)
        for (toml, higher, value, kept) in [
            ("0.5", false, Some(0.5), true),
            ("0.5", false, Some(0.6), false),
            ("0.5", true, Some(0.5), true),
            ("1", true, Some(0.4), false),
            ("0", false, None, true),
            ("[1, 2.5]", false, Some(1.0), true),
            ("[1, 2.5]", true, Some(2.5), true),
            ("[1, 2.5]", false, Some(0.9), false),
            ("[1, 2.5]", true, Some(2.6), false),
            ("[1, 2.5]", false, None, false),
            ("{ at_least = 1 }", false, Some(0.9), false),
            ("{ at_least = 1 }", false, Some(1e9), true),
            ("{ at_least = 1 }", false, None, true),
            ("{ at_most = 1.5 }", true, Some(1.6), false),
            ("{ at_most = 1.5 }", false, Some(-3.0), true),
            ("{ at_least = 1, at_most = 1 }", false, Some(1.0), true),
        ] {
            assert_eq!(limit(toml).is_met_by(value, higher), kept, "{toml} {value:?}");
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

    #[test]
    fn limits_that_cannot_work_are_refused() {
        for (toml, asks_pairs, why) in [
            ("min_aed_m = 1.0", true, "limits.min_aed_m is not a metric"),
            ("mfd_m = 1.0", true, "limits.mfd_m is 1, but neither direction is better"),
            ("pair_min_ttc_s = [3, 2]", true, "limits.pair_min_ttc_s is empty: at least 3 and at most 2"),
            ("pair_min_ttc_s = { at_most = 2 }", false, "limits.pair_min_ttc_s needs a behavior of two agents"),
            ("mfd_m = {}", true, "empty range"),
            ("mfd_m = { at_most = nan }", true, "has an end that is not a number"),
            ("collision_rate = nan", true, "limits.collision_rate is NaN"),
        ] {
            let said = validate(&limits(toml), asks_pairs).unwrap_err().to_string();
            assert!(said.contains(why), "{toml}: {said}");
        }
        for (toml, why) in [
            ("'tight'", "{ at_least = … }"),
            ("[1]", "two ends"),
            ("[1, 2, 3]", "two ends"),
            ("{ at_mots = 1 }", "at_mots"),
        ] {
            let said = toml::from_str::<BTreeMap<String, Limit>>(&format!("mfd_m = {toml}")).unwrap_err().to_string();
            assert!(said.contains(why), "{toml}: {said}");
        }
        validate(&limits("collision_rate = 0.0\nmfd_m = [0, 9]"), false).unwrap();
    }

    #[test]
    fn ranges_choose_how_critical_the_pair_is() {
        // Cars of 4.5 m, ten meters apart from center to center, so 5.5 m from bumper to bumper at present. The one
        // behind drives at 10 m/s, the other at 6, 8 and 10 m/s for the 0.8 s of the future: the gap ends at 5.5 - 0.8
        // Δv, with TTC = gap / Δv of 0.575 s, 1.95 s, and none for the third.
        let at = |speed_mps: f64| {
            scene(&[
                Drive::straight(0.0, 0.0, 0.0, 10.0),
                Drive::straight(10.0 - 0.3 * (speed_mps - 10.0), 0.0, 0.0, speed_mps),
            ])
        };
        let (scenes, recorded) = ([6.0, 8.0, 10.0].map(at), at(10.0));
        let asked = &Roles::from([("ego", "1"), ("other", "2")]);
        let is_kept = |toml: &str, scene: &Scene| {
            let alone = SampleGroup::equally_likely(&recorded, std::slice::from_ref(scene));
            are_met(&limits(toml), &SampleGroup { asked, ..alone }, &MetricSettings::default())
        };
        let kept = |toml: &str| -> Vec<usize> { (0..3).filter(|i| is_kept(toml, &scenes[*i])).collect() };
        assert_eq!(kept("pair_min_ttc_s = { at_most = 2 }"), [0, 1], "the third never collides");
        assert_eq!(kept("pair_min_ttc_s = { at_least = 1 }"), [1, 2]);
        assert_eq!(kept("pair_min_ttc_s = [1, 2]"), [1]);
        assert_eq!(kept("pair_min_distance_m = [3.5, 5.5001]"), [1, 2]);
        assert_eq!(kept("pair_min_distance_m = { at_most = 4 }\nscene_max_drac_mps2 = { at_least = 1 }"), [0]);
    }

    #[test]
    fn validity_is_judged_by_the_limits_that_are_set() {
        // Two cars in a row, the second one stopping at once or in time: the first passes through it.
        let at = |speed_mps: f64| {
            scene(&[Drive::straight(0.0, 0.0, 0.0, 10.0), Drive::straight(10.0 - 0.3 * speed_mps, 0.0, 0.0, speed_mps)])
        };
        let recorded = at(10.0);
        let kept = |skip: &[Check]| -> [bool; 2] {
            let validity = ValidityConfig { skip: skip.to_vec(), ..ValidityConfig::default() };
            let settings = MetricSettings { validity, ..MetricSettings::default() };
            [0.0, 10.0].map(at).map(|scene| {
                let alone = SampleGroup::equally_likely(&recorded, std::slice::from_ref(&scene));
                are_met(&limits("validity_rate = 1.0"), &alone, &settings)
            })
        };
        assert_eq!(kept(&[]), [false, true]);
        assert_eq!(kept(&[Check::Collision]), [true, true]);
    }
}

//! A rate with its interval, and what it is of.

use crate::settings::named;
use crate::settings::{Issue, Unreadable};
use crate::statistics::Interval;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fmt;
use std::str::FromStr;

/// Ranges of parameters, from (included) to (excluded): a bucket of events. An event that lacks one is in none.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(transparent)]
pub struct Within(pub BTreeMap<String, [f64; 2]>);

impl Within {
    /// Whether an event with these parameters is in it.
    pub fn holds(&self, parameter: impl Fn(&str) -> Option<f64>) -> bool {
        let is_in = |(name, [from, to]): (&String, &[f64; 2])| parameter(name).is_some_and(|v| *from <= v && v < *to);
        self.0.iter().all(is_in)
    }

    /// Refuses ranges of parameters that the behavior does not have, and empty ones.
    pub fn validate(&self, parameters: &[&str]) -> crate::settings::Result {
        for (name, [from, to]) in &self.0 {
            if !parameters.contains(&name.as_str()) {
                return Err(Issue::new(name, format_args!("is no parameter of it; it has {}", parameters.join(", "))));
            }
            if from.partial_cmp(to) != Some(std::cmp::Ordering::Less) {
                return Err(Issue::new(name, format_args!("is [{from}, {to}], expected the lower end first")));
            }
        }
        Ok(())
    }
}

impl fmt::Display for Within {
    /// As buckets of requests are written: `gap_m 0..5, relative_speed_mps -5..0`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let parts: Vec<String> = self.0.iter().map(|(name, [from, to])| format!("{name} {from}..{to}")).collect();
        f.write_str(&parts.join(", "))
    }
}

impl FromStr for Within {
    type Err = Unreadable;

    fn from_str(text: &str) -> Result<Self, Unreadable> {
        let part = |part: &str| {
            let (name, range) = part.trim().split_once(' ')?;
            // Requests name the sides for which the parameter has numbers.
            let side = ["right", "left"].iter().position(|side| *side == range);
            if let Some(side) = side {
                return Some((name.to_owned(), [[-1.5, -0.5], [0.5, 1.5]][side]));
            }
            let (from, to) = range.split_once("..")?;
            Some((name.to_owned(), [from.parse().ok()?, to.parse().ok()?]))
        };
        let parts = text.split(',').filter(|part| !part.trim().is_empty());
        let parts =
            parts.map(|text| part(text).ok_or_else(|| format!("{text:?} is no range such as gap_m 0..5").into()));
        Ok(Self(parts.collect::<Result<_, Unreadable>>()?))
    }
}

/// How the interval of a rate came about.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum RateMethod {
    /// From counts over recordings, whose dispersion widens it.
    OverRecordings,
    /// As if events came independently: there is one recording alone, which cannot tell.
    OneRecording,
    /// Nothing was found: the lower end is 0, and the upper one what that still allows.
    NoneFound,
    /// Hardly anything was found, and the rate is that of the tail of a distribution that was fitted to less severe
    /// events.
    Extrapolated,
    /// From closed loops of the unguided model, which agree with recordings.
    Modeled,
}

named! { RateMethod {
    OverRecordings = "over_recordings", OneRecording = "one_recording", NoneFound = "none_found",
    Extrapolated = "extrapolated", Modeled = "modeled",
} }

/// How often a behavior was recorded, or modeled, at a place.
#[derive(Debug, Clone, PartialEq)]
pub struct RateRow {
    /// The place; empty for all places together.
    pub place: String,
    /// The split; empty for all together.
    pub split: String,
    /// The behavior.
    pub behavior: String,
    /// The ranges of parameters, as text; empty for all events.
    pub within: String,
    /// Events, each once; of loops that were split, those of all ends, whose weights differ.
    pub n_events: u64,
    /// Recordings that share no moment.
    pub n_recordings: u64,
    /// Time that was observed, hours.
    pub observed_h: f64,
    /// The way of motorized road users in it, kilometers.
    pub motorized_km: f64,
    /// Events an hour.
    pub rate_per_hour: f64,
    /// Its 95 % interval.
    pub per_hour: Interval,
    /// Events in 1,000 km of motorized road users; `None` without any.
    pub rate_per_1000_km: Option<f64>,
    /// Its 95 % interval.
    pub per_1000_km: Option<Interval>,
    /// How many times the variance of independent events counts over recordings have, at least 1.
    pub dispersion: Option<f64>,
    /// How the intervals came about.
    pub method: RateMethod,
    /// What to know about it: from where a rate is extrapolated, or why none is.
    pub note: Option<String>,
}

/// What the rate of a bucket is from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum RateSource {
    /// From recorded events of the bucket.
    Recorded,
    /// From the tail of less severe events.
    Extrapolated,
    /// From closed loops of the unguided model.
    Modeled,
    /// There is none: the upper end is what having found none allows.
    None,
}

named! { RateSource { Recorded = "recorded", Extrapolated = "extrapolated", Modeled = "modeled", None = "none" } }

/// How often events like that of a scenario were recorded at its place.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct BucketRate {
    /// Events in 1,000 km of motorized road users; `None` where there is no rate.
    pub per_1000_km: Option<f64>,
    /// Events an hour; `None` where there is no rate.
    pub per_hour: Option<f64>,
    /// The 95 % interval of the rate in 1,000 km; `None` without motorized road users, or what is asked for cannot be
    /// counted.
    pub interval: Option<Interval>,
    /// What it is from.
    pub source: RateSource,
}

impl BucketRate {
    /// The rate of what cannot be counted in recordings.
    pub const UNKNOWN: Self = Self { per_1000_km: None, per_hour: None, interval: None, source: RateSource::None };
}

impl From<&RateRow> for BucketRate {
    fn from(row: &RateRow) -> Self {
        let source = match row.method {
            RateMethod::OverRecordings | RateMethod::OneRecording => RateSource::Recorded,
            RateMethod::Extrapolated => RateSource::Extrapolated,
            RateMethod::Modeled => RateSource::Modeled,
            RateMethod::NoneFound => RateSource::None,
        };
        let known = |rate: Option<f64>| rate.filter(|_| source != RateSource::None);
        let (per_1000_km, per_hour) = (known(row.rate_per_1000_km), known(Some(row.rate_per_hour)));
        Self { per_1000_km, per_hour, interval: row.per_1000_km, source }
    }
}

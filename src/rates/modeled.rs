//! The traffic of closed loops of the unguided model: exposure, and events with weights.

use super::{Asked, RateMethod, RateRow};
use crate::statistics::{ClusteredRate, weighted_rate};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Closed loops that begin with held-out scenes. Neither guided samples nor templates are among them: these happen as
/// often as they were asked for.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct ModeledTraffic {
    /// The loops, independent of each other but for the recordings that they begin with.
    pub loops: Vec<ModeledLoop>,
}

/// A loop, over all of its ends, each times its weight.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct ModeledLoop {
    /// Its place.
    pub place: String,
    /// The recording of its first scene.
    pub recording: String,
    /// Time that counts, hours.
    pub observed_h: f64,
    /// The way of motorized road users in it, kilometers.
    pub motorized_km: f64,
    /// Events that begin in it.
    pub events: Vec<ModeledEvent>,
}

/// An event of an end of a loop.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ModeledEvent {
    /// The behavior.
    pub behavior: String,
    /// Its parameters by name.
    pub parameters: Vec<(String, f64)>,
    /// The weight of the end.
    pub weight: f64,
}

impl ModeledTraffic {
    /// How often events happen in the loops, whether that agrees with recordings or not. `None` for a single split, or
    /// where no loop was.
    pub fn rate(&self, asked: Asked<'_>) -> Option<RateRow> {
        let is_there = |one: &&ModeledLoop| asked.place.is_none_or(|place| place == one.place);
        let is_one = |event: &&ModeledEvent| {
            let value = |name: &str| event.parameters.iter().find(|(known, _)| known == name).map(|(_, value)| *value);
            event.behavior == asked.behavior && asked.within.holds(value)
        };
        let mut clusters: BTreeMap<&str, [f64; 3]> = BTreeMap::new();
        let (mut n_events, mut sum_of_squares) = (0, 0.0);
        for one in self.loops.iter().filter(is_there) {
            let events = one.events.iter().filter(is_one);
            n_events += events.clone().count() as u64;
            let sum: f64 = events.map(|event| event.weight).sum();
            sum_of_squares += sum * sum;
            let cluster = clusters.entry(&one.recording).or_default();
            [sum, one.observed_h, one.motorized_km].into_iter().zip(cluster).for_each(|(more, all)| *all += more);
        }
        let sums = [0, 1, 2].map(|i| clusters.values().map(|cluster| cluster[i]).sum::<f64>());
        // Where nothing was found, the next event may come without having been split for.
        let least = if sums[0] > 0.0 { sum_of_squares / sums[0] } else { 1.0 };
        let of = |i: usize, scale: f64| -> Option<ClusteredRate> {
            weighted_rate(&clusters.values().map(|cluster| (cluster[0], cluster[i] * scale)).collect::<Vec<_>>(), least)
        };
        let (per_hour, per_1000_km) = (of(1, 1.0).filter(|_| asked.split.is_none())?, of(2, 1e-3));
        Some(RateRow {
            place: asked.place.unwrap_or_default().to_owned(),
            split: String::new(),
            behavior: asked.behavior.to_owned(),
            within: asked.within.to_string(),
            n_events,
            n_recordings: clusters.len() as u64,
            observed_h: sums[1],
            motorized_km: sums[2],
            rate_per_hour: per_hour.rate,
            per_hour: per_hour.interval,
            rate_per_1000_km: per_1000_km.map(|rate| rate.rate),
            per_1000_km: per_1000_km.map(|rate| rate.interval),
            dispersion: Some(per_1000_km.and_then(|rate| rate.dispersion).unwrap_or(least)),
            method: RateMethod::Modeled,
            note: None,
        })
    }

    /// The places of the loops.
    pub fn places(&self) -> Vec<&str> {
        let mut places: Vec<&str> = self.loops.iter().map(|one| one.place.as_str()).collect();
        places.sort_unstable();
        places.dedup();
        places
    }
}

//! How often were events like that of a scenario recorded at its place?

use crate::rates::{Asked, BucketRate, ModeledRates, RateSource, RecordedTraffic};
use crate::scenario::ScenarioRecord;
use std::collections::BTreeMap;

/// Rates of the buckets of scenarios, each found once.
pub(super) struct BucketRates {
    traffic: RecordedTraffic,
    modeled: Option<ModeledRates>,
    /// By place, behavior and ranges of parameters.
    known: BTreeMap<[String; 3], Option<BucketRate>>,
}

impl BucketRates {
    pub(super) const fn new(traffic: RecordedTraffic, modeled: Option<ModeledRates>) -> Self {
        Self { traffic, modeled, known: BTreeMap::new() }
    }

    /// The rate of the bucket of the request that the scenario was made for, or of its behavior if no request made it.
    /// `None` without a verified event, or where nothing was recorded. It is a rate of recorded events or, where there
    /// are none, of closed loops of the unguided model: scenarios that were guided or planned happen as often as they
    /// were asked for.
    pub(super) fn of(&mut self, record: &ScenarioRecord) -> Option<BucketRate> {
        let behavior = &record.main_event()?.behavior;
        let place = &record.scenario.scene.source.place;
        let bucket = record.request.as_ref().and_then(|request| request.bucket.as_ref());
        let ranges = bucket.map_or("", |bucket| &bucket.ranges);
        let key = [place.clone(), behavior.clone(), ranges.to_owned()];
        let find = || {
            let Ok(within) = ranges.parse() else { return Some(BucketRate::UNKNOWN) };
            let asked = Asked { place: Some(place), split: None, behavior, within: &within };
            let recorded = BucketRate::from(&self.traffic.rate(asked)?);
            let modeled = || Some(BucketRate::from(&self.modeled.as_ref()?.rate(asked).ok()?));
            Some(if recorded.source == RateSource::None { modeled().unwrap_or(recorded) } else { recorded })
        };
        *self.known.entry(key).or_insert_with(find)
    }
}

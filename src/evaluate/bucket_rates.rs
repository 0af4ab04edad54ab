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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::behavior::BehaviorEvent;
    use crate::evaluate::testing::{record, recorded};
    use crate::rates::{CLASSES, ExposureRow};
    use crate::scene::{Dataset, Split};

    #[test]
    fn a_rate_is_that_of_the_place_of_the_scenario() {
        // Recordings of 1,000 km each.
        let row = |place: &str| ExposureRow {
            dataset: Dataset::Interaction,
            place: place.to_owned(),
            split: Split::Val,
            recording: place.to_owned(),
            shares_with: None,
            n_scenes: 1,
            observed_h: 10.0,
            class_h: [0.0; CLASSES.len()],
            class_km: std::array::from_fn(|i| if i == 0 { 1000.0 } else { 0.0 }),
        };
        let mut traffic = RecordedTraffic::new(["A", "B"].map(row).into());
        let scenario = record(0.0, true, false, recorded());
        for place in [vec!["A"; 10], vec!["B"; 40]].concat() {
            traffic.add(&BehaviorEvent { scene_id: place.into(), ..scenario.events[0].clone() });
        }
        let mut rates = BucketRates::new(traffic, None);
        let found = ["A", "B", "A"].map(|place| {
            let mut scenario = scenario.clone();
            scenario.scenario.scene.source.place = place.to_owned();
            rates.of(&scenario).unwrap().per_1000_km.unwrap()
        });
        assert!(found.iter().zip([10.0, 40.0, 10.0]).all(|(a, b)| (a - b).abs() < 1e-9), "{found:?}");
    }
}

//! Does it happen in closed loops of the model as often as in recordings that the model has never seen?

use super::tail::WIDEST;
use super::{Asked, ModeledTraffic, RateRow, RecordedTraffic, Within};
use crate::statistics::{Estimate, Interval};
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

/// Rates are given only where modeled and recorded ones of the behavior differ by no larger factor.
const LARGEST_FACTOR: f64 = 1.5;
/// The fewest recorded events that can tell.
const LEAST_EVENTS: u64 = 10;

/// A behavior at a place: as often as recorded?
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Calibration {
    /// The place; empty for all together.
    pub place: String,
    /// The behavior.
    pub behavior: String,
    /// Events in the recordings that loops begin with.
    pub n_recorded: u64,
    /// Recorded events in 1,000 km, with their interval.
    pub recorded: Estimate,
    /// Events in 1,000 km of the loops.
    pub modeled: Estimate,
    /// The latter over the former; missing if either is zero.
    pub factor: Option<Estimate>,
}

impl Calibration {
    /// Whether enough was recorded to tell.
    pub const fn is_judged(&self) -> bool {
        self.n_recorded >= LEAST_EVENTS
    }

    /// Whether rates of the behavior at the place are given.
    pub fn is_met(&self) -> bool {
        self.is_judged() && self.most() <= LARGEST_FACTOR
    }

    /// The factor between both rates, at least 1.
    pub fn most(&self) -> f64 {
        self.factor.map_or(f64::INFINITY, |factor| factor.value.max(1.0 / factor.value))
    }

    /// A factor of 1 with the interval of what the comparison allows in both directions.
    fn discrepancy(&self) -> Option<Estimate> {
        let Interval { low, high } = self.factor?.interval;
        let most = high.max(1.0 / low);
        Some(Estimate::new(1.0, Interval { low: 1.0 / most, high: most }))
    }
}

/// Rates of the model, where it is calibrated.
#[derive(Debug, Clone, Default)]
pub struct ModeledRates {
    traffic: ModeledTraffic,
    calibrations: Vec<Calibration>,
}

impl ModeledRates {
    /// Compares loops with the recordings that they begin with, which the model has not learned from: each behavior at
    /// each place, and at all together.
    pub fn new(traffic: ModeledTraffic, recorded: &RecordedTraffic, behaviors: &[&str]) -> Self {
        let names: BTreeSet<&str> = traffic.loops.iter().map(|one| one.recording.as_str()).collect();
        let recorded = recorded.among(|row| names.contains(row.recording.as_str()));
        let places = traffic.places();
        let everywhere = (places.len() > 1).then_some(None);
        let all = Within::default();
        let mut calibrations = Vec::new();
        for behavior in behaviors {
            for place in everywhere.into_iter().chain(places.iter().map(|place| Some(*place))) {
                let asked = Asked { place, split: None, behavior, within: &all };
                calibrations.extend(calibration(recorded.rate(asked), traffic.rate(asked)));
            }
        }
        Self { traffic, calibrations }
    }

    /// All comparisons.
    pub fn calibrations(&self) -> &[Calibration] {
        &self.calibrations
    }

    /// The rate of a bucket at a place. Its interval is that of the loops and of the discrepancy between modeled and
    /// recorded rates of all events of the behavior there, combined on logarithms.
    ///
    /// # Errors
    /// Why none is given, in words.
    pub fn rate(&self, asked: Asked<'_>) -> Result<RateRow, String> {
        let place = asked.place.unwrap_or_default();
        let of_behavior = |one: &&Calibration| one.place == place && one.behavior == asked.behavior;
        let known = self.calibrations.iter().find(of_behavior).filter(|known| known.is_judged());
        let Some(known) = known else {
            return Err(format!("fewer than {LEAST_EVENTS} events were recorded there to compare with"));
        };
        if !known.is_met() {
            return Err(format!("modeled and recorded rates differ by a factor of {:.2}", known.most()));
        }
        let (row, discrepancy) = self.traffic.rate(asked).zip(known.discrepancy()).ok_or("no loop was there")?;
        let rate = |value: f64, interval: Interval| Estimate::new(value, interval).times(discrepancy);
        let per_hour = rate(row.rate_per_hour, row.per_hour);
        let per_km = row.rate_per_1000_km.zip(row.per_1000_km).map(|(value, interval)| rate(value, interval));
        if row.n_events == 0 || per_hour.span() > WIDEST {
            return Err(format!("the interval of {} events of loops would span more than 100", row.n_events));
        }
        let note = format!(
            "of all {} recorded there, {:.2} times as many are modeled",
            known.n_recorded,
            known.factor.map_or(f64::NAN, |factor| factor.value)
        );
        let (per_hour, per_1000_km) = (per_hour.interval, per_km.map(|rate| rate.interval));
        Ok(RateRow { per_hour, per_1000_km, note: Some(note), ..row })
    }

    /// The rates that are given of all events of these behaviors and of buckets, over all places and at each.
    pub fn rates(&self, buckets: &[(String, Within)]) -> Vec<RateRow> {
        let all = Within::default();
        let mut rows = Vec::new();
        for Calibration { place, behavior, .. } in self.calibrations.iter().filter(|known| known.is_met()) {
            let place = Some(place.as_str()).filter(|place| !place.is_empty());
            let own = buckets.iter().filter(|(of, _)| of == behavior).map(|(_, within)| within);
            let asked = std::iter::once(&all).chain(own);
            let asked = asked.map(|within| Asked { place, split: None, behavior, within });
            rows.extend(asked.filter_map(|asked| self.rate(asked).ok()));
        }
        rows
    }
}

/// The comparison of two rows; `None` without road users that are counted.
fn calibration(recorded: Option<RateRow>, modeled: Option<RateRow>) -> Option<Calibration> {
    let (recorded, modeled) = recorded.zip(modeled)?;
    let of = |row: &RateRow| Some(Estimate::new(row.rate_per_1000_km?, row.per_1000_km?));
    let (of_recorded, of_modeled) = of(&recorded).zip(of(&modeled))?;
    let factor = (of_recorded.value > 0.0 && of_modeled.value > 0.0).then(|| of_modeled.over(of_recorded));
    Some(Calibration {
        place: recorded.place,
        behavior: recorded.behavior,
        n_recorded: recorded.n_events,
        recorded: of_recorded,
        modeled: of_modeled,
        factor,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::behavior::{BehaviorEvent, EventLabel};
    use crate::rates::{CLASSES, ExposureRow, ModeledEvent, ModeledLoop, RateMethod};
    use crate::scene::testing::{Drive, scene};
    use crate::scene::{Dataset, Split};
    use std::collections::BTreeMap;

    /// Two recordings of 500 km each with so many cut-ins, and one that no loop begins with.
    fn recorded(n_events: usize) -> RecordedTraffic {
        let row = |recording: &str| ExposureRow {
            dataset: Dataset::Interaction,
            place: "A".to_owned(),
            split: Split::Val,
            recording: recording.to_owned(),
            shares_with: None,
            n_scenes: 1,
            observed_h: 10.0,
            class_h: [0.0; CLASSES.len()],
            class_km: std::array::from_fn(|i| if i == 0 { 500.0 } else { 0.0 }),
        };
        let mut traffic = RecordedTraffic::new(["0", "1", "2"].map(row).into());
        let scene = scene(&[Drive::straight(0.0, 0.0, 0.0, 1.0)]);
        for i in 0..n_events {
            let mut event = BehaviorEvent::new(("cut_in", &["ego"]), &scene, EventLabel::Positive, &[0], 0..=1);
            event.scene_id = ["0", "1"][i % 2].into();
            event.parameters = BTreeMap::from([("gap_m".to_owned(), 20.0)]);
            traffic.add(&event);
        }
        traffic
    }

    /// 400 loops of 1 km: so many cut-ins, and four copies of a close one of a quarter each in four of them.
    fn modeled(n_events: usize) -> ModeledTraffic {
        let event = |gap_m: f64, weight: f64| {
            let parameters = vec![("gap_m".to_owned(), gap_m)];
            ModeledEvent { behavior: "cut_in".to_owned(), parameters, weight }
        };
        let one = |i: usize| ModeledLoop {
            place: "A".to_owned(),
            recording: (i % 2).to_string(),
            observed_h: 0.02,
            motorized_km: 1.0,
            events: match i {
                0..4 => vec![event(2.0, 0.25); 2],
                _ if i < 4 + n_events => vec![event(20.0, 1.0)],
                _ => Vec::new(),
            },
        };
        ModeledTraffic { loops: (0..400).map(one).collect() }
    }

    #[test]
    fn a_rate_is_given_where_modeled_and_recorded_ones_agree_and_carries_their_discrepancy() {
        let close: Within = "gap_m 0..5".parse().unwrap();
        let asked = Asked { place: Some("A"), split: None, behavior: "cut_in", within: &close };
        let rates = |n_recorded: usize, n_modeled: usize| {
            ModeledRates::new(modeled(n_modeled), &recorded(n_recorded), &["cut_in", "near_miss"])
        };
        // 100 in 1,000 km, and 48 with 8 of a quarter in 400 km: 125.
        let given = rates(100, 48);
        let known = &given.calibrations()[0];
        assert_eq!((given.calibrations().len(), known.n_recorded, known.is_met()), (2, 100, true));
        let factor = known.factor.unwrap();
        assert!((known.recorded.value - 100.0).abs() < 1e-9 && (factor.value - 1.25).abs() < 1e-9);
        let row = given.rate(asked).unwrap();
        assert_eq!((row.method, row.n_events, row.n_recordings), (RateMethod::Modeled, 8, 2));
        assert!((row.rate_per_1000_km.unwrap() - 5.0).abs() < 1e-9 && (row.rate_per_hour - 0.25).abs() < 1e-9);
        // Two of four alike: as sure as four events, and less for the discrepancy.
        let own = given.traffic.rate(asked).unwrap();
        assert_eq!(own.dispersion, Some(0.5));
        let most = factor.interval.high;
        let (own, found) = (own.per_1000_km.unwrap(), row.per_1000_km.unwrap());
        for (end, own) in [(found.low, own.low), (found.high, own.high)] {
            let expected = (own / 5.0).ln().hypot(most.ln());
            assert!(((end / 5.0).ln().abs() - expected).abs() < 1e-9, "{found:?} of {own:?} and {factor:?}");
        }
        assert_eq!(given.rates(&[("cut_in".to_owned(), close.clone())]).len(), 2);
        // Too few to tell, too often, and never in the loops.
        for (n_recorded, n_modeled, why) in [(9, 2, "fewer than 10"), (100, 70, "factor of 1.80"), (100, 20, "factor")]
        {
            assert!(rates(n_recorded, n_modeled).rate(asked).unwrap_err().contains(why), "{why}");
        }
        let far: Within = "gap_m 50..60".parse().unwrap();
        assert!(given.rate(Asked { within: &far, ..asked }).unwrap_err().contains("0 events"));
        assert!(given.rate(Asked { behavior: "near_miss", ..asked }).is_err());
    }

    #[test]
    fn a_rate_may_be_as_much_too_low_as_fewer_events_are_modeled() {
        let close: Within = "gap_m 0..5".parse().unwrap();
        let asked = Asked { place: Some("A"), split: None, behavior: "cut_in", within: &close };
        // 100 in 1,000 km, and 30 with 8 of a quarter in 400 km: 80.
        let given = ModeledRates::new(modeled(30), &recorded(100), &["cut_in"]);
        let factor = given.calibrations()[0].factor.unwrap();
        assert!((factor.value - 0.8).abs() < 1e-9 && 1.0 / factor.interval.low > factor.interval.high);
        let [own, found] = [given.traffic.rate(asked).unwrap(), given.rate(asked).unwrap()]
            .map(|row| (row.per_1000_km.unwrap().high / row.rate_per_1000_km.unwrap()).ln());
        assert!((found - own.hypot(-factor.interval.low.ln())).abs() < 1e-9, "{found} of {own} and {factor:?}");
    }
}

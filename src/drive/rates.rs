//! How often would a driver fail on the roads of the corpus? The rates of the events that it was tested with, times the
//! shares of them that it fails.

use crate::behavior::BehaviorEvent;
use crate::generate::NamedDriver;
use crate::rates::{Asked, BucketRate, ModeledTraffic, Within};
use crate::scenario::{DriveRow, ScenarioRecord};
use crate::simulate::{FAILURE, Outcome, TESTED_FAILURE};
use crate::statistics::{Estimate, wilson_interval};
use crate::store::CorpusManifest;
use serde::Serialize;
use std::collections::BTreeMap;

/// A bucket: the place, the behavior, and the ranges of parameters.
pub(super) type Bucket = [String; 3];

/// The buckets of driven scenarios, by scenario, with the rates that the corpus gives.
pub(super) type Buckets = BTreeMap<String, (Bucket, BucketRate)>;

/// The bucket of a scenario: of its request or, without one, its behavior. `None` without an event. Without a rate, the
/// scenario tells nothing of failures in it: the corpus gives none, or its sweep aims at hard events.
pub(super) fn bucket(record: &ScenarioRecord, corpus: &CorpusManifest) -> Option<(Bucket, BucketRate)> {
    let rate = record.assessment.as_ref().and_then(|assessment| assessment.rate);
    let rate = rate.filter(|_| !corpus.aims_at_hard_events(&record.sweep)).unwrap_or(BucketRate::UNKNOWN);
    let ranges = record.request.as_ref().and_then(|request| request.bucket.as_ref()).map(|bucket| &bucket.ranges);
    let behavior = record.main_event()?.behavior.clone();
    let place = record.scenario.scene.source.place.clone();
    Some(([place, behavior, ranges.cloned().unwrap_or_default()], rate))
}

/// Failures in 1,000 km at a place by loops that begin with recorded scenes and are split, without buckets.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SplitFailures {
    /// The place; empty for all together.
    pub place: String,
    /// Failures of the driver under test in 1,000 km.
    pub per_1000_km: Estimate,
    /// Failures of the careful driver.
    pub careful_per_1000_km: Estimate,
    /// Ends of loops in which either fails.
    pub n_failed: [u64; 2],
    /// Those failures of both in events that the driven buckets hold. They are what the sum over buckets is of.
    pub in_buckets: [Estimate; 2],
    /// Whether the intervals of these and of the sum over buckets overlap, for either driver; `None` without such a
    /// sum, as for all places together.
    pub agree: Option<[bool; 2]>,
    /// The other failures of both, by outcome.
    pub others: BTreeMap<&'static str, [Estimate; 2]>,
}

impl SplitFailures {
    /// Those at each place, from the loops of the driver under test and of the careful one, beside sums over buckets.
    pub(super) fn of(traffic: &[ModeledTraffic; 2], by_buckets: &[FailureRates]) -> Vec<Self> {
        let places = traffic[0].places();
        let everywhere = (places.len() > 1).then_some(None);
        let all = Within::default();
        let rates = |place: Option<&str>, behavior: &str| {
            let [own, careful] = traffic.each_ref().map(|traffic| {
                let row = traffic.rate(Asked { place, split: None, behavior, within: &all })?;
                Some((Estimate::new(row.rate_per_1000_km?, row.per_1000_km?), row.n_events))
            });
            let ((own, n_own), (careful, n_careful)) = own.zip(careful)?;
            Some(([own, careful], [n_own, n_careful]))
        };
        let at = |place: Option<&str>| {
            let ([per_1000_km, careful_per_1000_km], n_failed) = rates(place, FAILURE)?;
            let (in_buckets, _) = rates(place, TESTED_FAILURE)?;
            let sums = by_buckets.iter().find(|at| place == Some(at.place.as_str()));
            let sums = sums.and_then(|at| at.per_1000_km.zip(at.careful_per_1000_km));
            let agree = sums.map(|(own, careful)| [own.overlaps(in_buckets[0]), careful.overlaps(in_buckets[1])]);
            let others = Outcome::ALL.iter().filter_map(|outcome| {
                let (others, n) = rates(place, outcome.name())?;
                (n != [0, 0]).then_some((outcome.name(), others))
            });
            let (others, place) = (others.collect(), place.unwrap_or_default().to_owned());
            Some(Self { place, per_1000_km, careful_per_1000_km, n_failed, in_buckets, agree, others })
        };
        everywhere.into_iter().chain(places.iter().map(|place| Some(*place))).filter_map(at).collect()
    }
}

/// Failures in 1,000 km at a place: of the driver under test, and of the careful one.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FailureRates {
    /// The place.
    pub place: String,
    /// Failures of the driver under test in 1,000 km; `None` without buckets that have a rate.
    pub per_1000_km: Option<Estimate>,
    /// Failures of the careful driver.
    pub careful_per_1000_km: Option<Estimate>,
    /// The sum's parts, the largest first.
    pub buckets: Vec<BucketFailures>,
    /// Scenarios whose bucket has no rate or which aim at hard events, and which are not in the sum.
    pub n_without_rate: u64,
}

/// Failures of a bucket.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct BucketFailures {
    /// The behavior.
    pub behavior: String,
    /// The ranges of parameters; empty for all events.
    pub within: String,
    /// How often it happens in 1,000 km.
    pub rate: Estimate,
    /// What that is from.
    pub rate_source: &'static str,
    /// Judged scenarios.
    pub n_scenarios: u64,
    /// Scenarios in which the driver under test fails.
    pub n_failed: u64,
    /// Its failures in 1,000 km.
    pub per_1000_km: Estimate,
    /// Those of the careful driver.
    pub careful_per_1000_km: Estimate,
    /// The part of the sum, and of the squared widths of intervals, that is from this bucket.
    pub of_rate: f64,
    /// See `of_rate`.
    pub of_interval: f64,
}

impl BucketFailures {
    /// Its name for people.
    pub fn name(&self) -> String {
        format!("{} {}", self.behavior, self.within).trim_end().to_owned()
    }
}

impl FailureRates {
    /// The behaviors of the buckets.
    pub(super) fn behaviors(&self) -> impl Iterator<Item = &str> {
        self.buckets.iter().map(|bucket| bucket.behavior.as_str())
    }

    /// Whether a bucket of the sum holds an event at a place.
    pub(super) fn holds(&self, place: &str, event: &BehaviorEvent) -> bool {
        let value = |name: &str| event.parameters.get(name).copied();
        let is_in = |bucket: &BucketFailures| {
            let within = bucket.within.parse::<Within>();
            bucket.behavior == event.behavior && within.is_ok_and(|within| within.holds(value))
        };
        self.place == place && self.buckets.iter().any(is_in)
    }

    /// The bucket whose interval contributes most to that of the sum: more scenarios or recordings of it tell most.
    pub fn widest(&self) -> Option<&BucketFailures> {
        self.buckets.iter().max_by(|a, b| a.of_interval.total_cmp(&b.of_interval))
    }
}

/// The rate at each place, from the drives of `asked` and of the careful driver; buckets add up.
pub(super) fn failure_rates(rows: &[DriveRow], asked: &str, buckets: &Buckets) -> Vec<FailureRates> {
    let mut counts: BTreeMap<&Bucket, (BucketRate, [[u64; 2]; 2])> = BTreeMap::new();
    let drivers = [asked, NamedDriver::Careful.name()];
    for row in rows.iter().filter(|row| row.outcome != Outcome::NotSampled.name()) {
        let Some((bucket, rate)) = buckets.get(&row.scenario_id) else { continue };
        let (_, counts) = counts.entry(bucket).or_insert((*rate, [[0; 2]; 2]));
        for (counts, _) in counts.iter_mut().zip(drivers).filter(|(_, driver)| row.driver == *driver) {
            counts[0] += 1;
            counts[1] += u64::from(has_failed(row));
        }
    }
    let mut places: BTreeMap<&str, (Vec<BucketFailures>, u64)> = BTreeMap::new();
    for ([place, behavior, within], (rate, counts)) in counts {
        let [[n_scenarios, n_failed], _] = counts;
        let (found, n_without_rate) = places.entry(place).or_default();
        let shares = counts.map(|[n, n_failed]| {
            wilson_interval(n_failed, n).map(|interval| Estimate::new(n_failed as f64 / n as f64, interval))
        });
        let (Some(interval), [Some(own), Some(careful)]) = (rate.interval, shares) else {
            *n_without_rate += n_scenarios;
            continue;
        };
        // Where none was found, the upper end is what that still allows.
        let often = Estimate::new(rate.per_1000_km.unwrap_or(0.0), interval);
        found.push(BucketFailures {
            behavior: behavior.clone(),
            within: within.clone(),
            rate: often,
            rate_source: rate.source.name(),
            n_scenarios,
            n_failed,
            per_1000_km: often.times(own),
            careful_per_1000_km: often.times(careful),
            of_rate: 0.0,
            of_interval: 0.0,
        });
    }
    let of_place = |(place, (mut buckets, n_without_rate)): (&str, (Vec<BucketFailures>, u64))| {
        let per_1000_km = Estimate::sum(buckets.iter().map(|bucket| bucket.per_1000_km));
        let careful_per_1000_km = Estimate::sum(buckets.iter().map(|bucket| bucket.careful_per_1000_km));
        let squared =
            |Estimate { value, interval }: Estimate| (interval.high - value).powi(2) + (value - interval.low).powi(2);
        let all: f64 = buckets.iter().map(|bucket| squared(bucket.per_1000_km)).sum();
        let part = |of: f64, whole: f64| if whole > 0.0 { of / whole } else { 0.0 };
        for bucket in &mut buckets {
            bucket.of_rate = part(bucket.per_1000_km.value, per_1000_km.value);
            bucket.of_interval = part(squared(bucket.per_1000_km), all);
        }
        buckets
            .sort_by(|a, b| b.per_1000_km.value.total_cmp(&a.per_1000_km.value).then_with(|| a.name().cmp(&b.name())));
        let known = |sum: Estimate| (!buckets.is_empty()).then_some(sum);
        let [per_1000_km, careful_per_1000_km] = [per_1000_km, careful_per_1000_km].map(known);
        FailureRates { place: place.to_owned(), per_1000_km, careful_per_1000_km, buckets, n_without_rate }
    };
    places.into_iter().map(of_place).collect()
}

/// Whether the driver fails.
pub(super) fn has_failed(row: &DriveRow) -> bool {
    Outcome::ALL.iter().any(|outcome| outcome.is_failure() && outcome.name() == row.outcome)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rates::{ModeledEvent, ModeledLoop, RateSource};
    use crate::statistics::Interval;

    #[test]
    fn rates_times_shares_add_up_and_tell_what_to_sample_next() {
        let rate = |value: f64, low: f64, high: f64| BucketRate {
            per_1000_km: (value > 0.0).then_some(value),
            per_hour: None,
            interval: Some(Interval { low, high }),
            source: if value > 0.0 { RateSource::Recorded } else { RateSource::None },
        };
        // Often and sometimes failed; rarely and always failed; never recorded; and without a rate.
        let buckets = [
            ("gap_m 5..10", rate(20.0, 16.0, 25.0), 100, 10),
            ("gap_m 0..5", rate(1.0, 0.1, 10.0), 50, 50),
            ("gap_m -5..0", rate(0.0, 0.0, 0.5), 10, 5),
            ("?", BucketRate::UNKNOWN, 10, 10),
        ];
        let (mut rows, mut known) = (Vec::new(), Buckets::new());
        for (ranges, rate, n, n_failed) in buckets {
            for i in 0..n {
                let id = format!("{ranges} {i}");
                let drive = |driver: &str, has_failed: bool| DriveRow {
                    scenario_id: id.clone(),
                    driver: driver.to_owned(),
                    outcome: if has_failed { "hit" } else { "survived" }.to_owned(),
                    ..DriveRow::default()
                };
                rows.extend([drive("planner", i < n_failed), drive("careful", false), drive("idm", true)]);
                known.insert(id, (["A", "cut_in", ranges].map(str::to_owned), rate));
            }
        }
        let found = failure_rates(&rows, "planner", &known);
        let [at] = found.as_slice() else { panic!("one place") };
        assert_eq!((at.place.as_str(), at.n_without_rate, at.buckets.len()), ("A", 10, 3));
        let [own, careful] = [at.per_1000_km, at.careful_per_1000_km].map(Option::unwrap);
        assert!((own.value - 3.0).abs() < 1e-9 && careful.value == 0.0);
        let Interval { low, high } = own.interval;
        assert!(low > 0.0 && low < 2.0 && high > 11.0 && high < 13.0, "{low} to {high}");
        let names: Vec<String> = at.buckets.iter().map(BucketFailures::name).collect();
        assert_eq!(names, ["cut_in gap_m 5..10", "cut_in gap_m 0..5", "cut_in gap_m -5..0"]);
        assert!((at.buckets[0].of_rate - 2.0 / 3.0).abs() < 1e-9);
        let widest = at.widest().unwrap();
        assert!(widest.within == "gap_m 0..5" && widest.of_interval > 0.9, "{widest:?}");
        // What was never recorded adds what that allows.
        let never = &at.buckets[2];
        assert!(never.per_1000_km.value == 0.0 && (0.2..0.5).contains(&never.per_1000_km.interval.high), "{never:?}");
    }

    #[test]
    fn loops_are_compared_in_the_events_of_the_buckets_and_other_failures_are_named() {
        let interval = Interval { low: 1.0, high: 5.0 };
        let sum = Some(Estimate::new(3.0, interval));
        let bucket = BucketFailures {
            behavior: "cut_in".to_owned(),
            within: "gap_m 0..5".to_owned(),
            rate: Estimate::new(10.0, interval),
            rate_source: "recorded",
            n_scenarios: 10,
            n_failed: 3,
            per_1000_km: Estimate::new(3.0, interval),
            careful_per_1000_km: Estimate::new(3.0, interval),
            of_rate: 1.0,
            of_interval: 1.0,
        };
        let (place, buckets) = ("A".to_owned(), vec![bucket]);
        let at = FailureRates { place, per_1000_km: sum, careful_per_1000_km: sum, buckets, n_without_rate: 0 };
        let record = crate::simulate::testing::record();
        let event = |behavior: &str, gap_m: f64| BehaviorEvent {
            behavior: behavior.to_owned(),
            parameters: [("gap_m".to_owned(), gap_m)].into(),
            ..record.main_event().unwrap().clone()
        };
        let held = [("A", "cut_in", 4.0), ("A", "cut_in", 5.0), ("A", "cut_out", 4.0), ("B", "cut_in", 4.0)]
            .map(|(place, behavior, gap_m)| at.holds(place, &event(behavior, gap_m)));
        assert_eq!(held, [true, false, false, false]);
        // Of two loops of 1 km, half of the copies of each fail: one in an event of the buckets, the other by itself.
        let traffic = |kinds: &[&str]| ModeledTraffic {
            loops: [0, 1]
                .map(|i| ModeledLoop {
                    place: "A".to_owned(),
                    recording: "1".to_owned(),
                    observed_h: 0.1,
                    motorized_km: 1.0,
                    events: (kinds.get(i).into_iter().flat_map(|kind| [FAILURE, *kind]))
                        .map(|of| ModeledEvent { behavior: of.to_owned(), parameters: Vec::new(), weight: 0.5 })
                        .collect(),
                })
                .into(),
        };
        let found = SplitFailures::of(&[traffic(&[TESTED_FAILURE, "left_road"]), traffic(&[])], &[at]);
        let [found] = found.as_slice() else { panic!("one place") };
        assert_eq!((found.per_1000_km.value, found.n_failed, found.agree), (500.0, [2, 0], Some([false, true])));
        // The exact intervals of one event and of none (Garwood 1936), at half the weight and at the whole.
        let [own, careful] = found.in_buckets;
        let expected = [250.0, 0.025_318 * 250.0, 5.571_643 * 250.0, 0.0, 0.0, 3.688_879 * 500.0];
        let ends = [own, careful].map(|of| [of.value, of.interval.low, of.interval.high]).concat();
        assert!(ends.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-3 * b.max(1.0)), "{ends:?}");
        assert_eq!(found.others, [("left_road", [own, careful])].into());
    }
}

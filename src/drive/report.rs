//! The result of driving a corpus in figures: how many drives failed and how, and which failures matter.

use super::rates::has_failed;
use super::{EgoDriver, FailureRates, Margins, SplitFailures};
use crate::generate::NamedDriver;
use crate::quantile::quantile;
use crate::scenario::DriveRow;
use crate::simulate::{BANDS_S, Driven, Outcome, RolloutConfig, Side, Traffic, is_decided_by_ego};
use serde::Serialize;
use std::collections::BTreeMap;

/// Values of a parameter are divided into this many intervals with equally many scenarios.
const N_PARTS: usize = 3;

/// The figures of a drive of a corpus; the file `drive.json`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DriveReport {
    /// Version of this report.
    pub schema: &'static str,
    /// The driver under test.
    pub ego: String,
    /// The seed.
    pub seed: u64,
    /// Hash of the model's file.
    pub model: String,
    /// The settings of the drives; missing in an open loop.
    pub rollout: Option<RolloutConfig>,
    /// Driven scenarios.
    pub n_scenarios: u64,
    /// Scenarios that were left out, by reason.
    pub left_out: BTreeMap<String, u64>,
    /// Scenarios that say nothing of the driver under test: left out, or without a future for the others.
    pub n_unjudged: u64,
    /// Saved states.
    pub n_saved: u64,
    /// By driver: scenarios by outcome.
    pub outcomes: BTreeMap<String, BTreeMap<&'static str, u64>>,
    /// Scenarios of those judged that an ego at constant velocity survives, too; missing if nobody drove so.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub n_survived_at_constant_velocity: Option<u64>,
    /// Failures of the driver under test.
    pub failures: Failures,
    /// Failures by behavior.
    pub by_behavior: BTreeMap<String, Failures>,
    /// Failures by behavior and parameter, in intervals with equally many scenarios.
    pub by_parameter: Vec<Part>,
    /// The scenarios that the careful driver survives and the driver under test does not, those first in which the
    /// careful driver has to brake hardest.
    pub that_matter: Vec<Matters>,
    /// How much later the others of the event could be; missing if that was not requested.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub margins: Option<Margins>,
    /// Failures in 1,000 km at each place, by the rates of events and the shares that fail; missing if that was not
    /// requested.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rates: Option<Vec<FailureRates>>,
    /// The same by splitting, without buckets; missing if that was not requested.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub split_rates: Option<Vec<SplitFailures>>,
    /// By driver: traffic over the stretches of `bands_s`.
    pub traffic: BTreeMap<String, Traffic>,
    /// The stretches of `traffic`, seconds after the present.
    pub bands_s: [[f64; 2]; 4],
}

/// Failures of a driver among some scenarios.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct Failures {
    /// Scenarios.
    pub n_scenarios: u64,
    /// Scenarios in which the driver fails.
    pub n_failed: u64,
    /// Failures that the careful driver avoids.
    pub n_avoidable: u64,
    /// Scenarios in which the ego touches another agent, and those of them that the careful driver survives.
    pub n_hit: u64,
    /// See `n_hit`.
    pub n_hit_avoidable: u64,
    /// Hits in which the other drives into its rear.
    pub n_hit_in_rear: u64,
    /// Scenarios that the careful driver does not survive.
    pub n_careful_failed: u64,
    /// Scenarios in which the event happens as its behavior is defined.
    pub n_event_happens: u64,
    /// Collisions and near misses that do not happen because the driver avoids them in time.
    pub n_event_avoided: u64,
}

/// An interval of a parameter.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Part {
    /// The behavior.
    pub behavior: String,
    /// The parameter.
    pub parameter: String,
    /// Its least and greatest value.
    pub range: [f64; 2],
    /// The failures there.
    #[serde(flatten)]
    pub failures: Failures,
}

/// A failure that the careful driver avoids.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Matters {
    /// The scenario.
    pub scenario_id: String,
    /// The requested behavior.
    pub behavior: Option<String>,
    /// How it ended.
    pub outcome: String,
    /// More about it.
    pub why: Option<String>,
    /// The side of the ego that is touched.
    pub contact_side: Option<String>,
    /// How hard the careful driver brakes, m/s².
    pub careful_braking_mps2: f64,
    /// The parameters of the event.
    pub parameters: BTreeMap<String, f64>,
}

impl Failures {
    fn count(&mut self, row: &DriveRow) {
        let has_failed = has_failed(row);
        let is_hit = row.outcome == Outcome::Hit.name();
        let is_avoidable = row.careful_survives == Some(true);
        self.n_scenarios += 1;
        self.n_failed += u64::from(has_failed);
        self.n_avoidable += u64::from(has_failed && is_avoidable);
        self.n_hit += u64::from(is_hit);
        self.n_hit_avoidable += u64::from(is_hit && is_avoidable);
        let is_in_rear = row.contact.as_ref().is_some_and(|(_, side, _)| side == Side::Rear.name());
        self.n_hit_in_rear += u64::from(is_hit && is_in_rear);
        self.n_careful_failed += u64::from(row.careful_survives == Some(false));
        self.n_event_happens += u64::from(row.event_happens == Some(true));
        let is_avoided = row.event_happens == Some(false) && is_decided_by_ego(row.behavior.as_deref());
        self.n_event_avoided += u64::from(is_avoided && !has_failed);
    }

    fn of<'r>(rows: impl IntoIterator<Item = &'r DriveRow>) -> Self {
        let mut failures = Self::default();
        rows.into_iter().for_each(|row| failures.count(row));
        failures
    }
}

impl DriveReport {
    /// The driven scenarios in which the others had a future.
    pub fn n_judged(&self) -> u64 {
        self.n_scenarios + self.left_out.values().sum::<u64>() - self.n_unjudged
    }

    pub(super) fn new(ego: &EgoDriver, rollout: Option<RolloutConfig>, seed: u64, model: &str) -> Self {
        Self {
            schema: "drive_report.v6",
            ego: ego.name().to_owned(),
            seed,
            model: model.to_owned(),
            rollout,
            n_scenarios: 0,
            left_out: BTreeMap::new(),
            n_unjudged: 0,
            n_saved: 0,
            outcomes: BTreeMap::new(),
            n_survived_at_constant_velocity: None,
            failures: Failures::default(),
            by_behavior: BTreeMap::new(),
            by_parameter: Vec::new(),
            that_matter: Vec::new(),
            margins: None,
            rates: None,
            split_rates: None,
            traffic: BTreeMap::new(),
            bands_s: BANDS_S,
        }
    }

    pub(super) fn count(&mut self, driver: &str, driven: &Driven) {
        *self.outcomes.entry(driver.to_owned()).or_default().entry(driven.outcome.name()).or_default() += 1;
        let traffic = self.traffic.entry(driver.to_owned()).or_default();
        *traffic = traffic.with(&driven.traffic);
    }

    /// Counts the rows of all drives; `asked` is the driver under test.
    pub(super) fn finish(&mut self, rows: &[DriveRow], asked: &str) {
        let own: Vec<&DriveRow> = rows.iter().filter(|row| row.driver == asked).collect();
        self.n_scenarios = own.len() as u64;
        let is_unjudged = |row: &&&DriveRow| row.outcome == Outcome::NotSampled.name();
        self.n_unjudged = self.left_out.values().sum::<u64>() + own.iter().filter(is_unjudged).count() as u64;
        let steady: Vec<&DriveRow> =
            rows.iter().filter(|row| row.driver == NamedDriver::ConstantVelocity.name()).collect();
        let n_survived = steady.iter().filter(|row| row.outcome == Outcome::Survived.name()).count() as u64;
        self.n_survived_at_constant_velocity = (!steady.is_empty()).then_some(n_survived);
        self.failures = Failures::of(own.iter().copied());
        let mut by_behavior: BTreeMap<&str, Vec<&DriveRow>> = BTreeMap::new();
        for row in &own {
            by_behavior.entry(row.behavior.as_deref().unwrap_or("none")).or_default().push(row);
        }
        for (behavior, rows) in &by_behavior {
            self.by_behavior.insert((*behavior).to_owned(), Failures::of(rows.iter().copied()));
            self.by_parameter.extend(parts(behavior, rows));
        }
        let careful: BTreeMap<&str, &DriveRow> = (rows.iter().filter(|row| row.driver == NamedDriver::Careful.name()))
            .map(|row| (row.scenario_id.as_str(), row))
            .collect();
        for row in own {
            if Failures::of([row]).n_avoidable == 0 {
                continue;
            }
            let careful = careful.get(row.scenario_id.as_str());
            self.that_matter.push(Matters {
                scenario_id: row.scenario_id.clone(),
                behavior: row.behavior.clone(),
                outcome: row.outcome.clone(),
                why: row.why.clone(),
                contact_side: row.contact.as_ref().map(|(_, side, _)| side.clone()),
                careful_braking_mps2: careful.map_or(0.0, |row| row.max_braking_mps2),
                parameters: row.parameters.clone(),
            });
        }
        self.that_matter.sort_by(|a, b| {
            b.careful_braking_mps2.total_cmp(&a.careful_braking_mps2).then_with(|| a.scenario_id.cmp(&b.scenario_id))
        });
    }
}

/// The failures in the intervals of each parameter.
fn parts(behavior: &str, rows: &[&DriveRow]) -> Vec<Part> {
    let mut names: Vec<&str> = rows.iter().flat_map(|row| row.parameters.keys()).map(String::as_str).collect();
    names.sort_unstable();
    names.dedup();
    let of_parameter = |parameter: &str| {
        let mut valued: Vec<(f64, &DriveRow)> =
            rows.iter().filter_map(|row| Some((*row.parameters.get(parameter)?, *row))).collect();
        valued.sort_by(|a, b| a.0.total_cmp(&b.0));
        let values: Vec<f64> = valued.iter().map(|(value, _)| *value).collect();
        let bound = |i: usize| quantile(&values, i as f64 / N_PARTS as f64).unwrap_or_default();
        let part = |i: usize| {
            let (low, high) = (bound(i), bound(i + 1));
            let is_within = |value: f64| (value > low || i == 0) && value <= high;
            let within = valued.iter().filter(|(value, _)| is_within(*value)).map(|(_, row)| *row);
            let failures = Failures::of(within);
            let (behavior, parameter) = (behavior.to_owned(), parameter.to_owned());
            (failures.n_scenarios > 0).then_some(Part { behavior, parameter, range: [low, high], failures })
        };
        (0..N_PARTS).filter_map(part).collect::<Vec<_>>()
    };
    names.into_iter().flat_map(of_parameter).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(id: &str, driver: &str, outcome: Outcome, careful_survives: bool, gap_m: f64) -> DriveRow {
        DriveRow {
            scenario_id: id.to_owned(),
            behavior: Some("cut_in".to_owned()),
            driver: driver.to_owned(),
            outcome: outcome.name().to_owned(),
            careful_survives: Some(careful_survives),
            max_braking_mps2: gap_m,
            parameters: BTreeMap::from([("gap_m".to_owned(), gap_m)]),
            event_happens: Some(gap_m > 1.0),
            ..DriveRow::default()
        }
    }

    #[test]
    fn what_matters_is_what_the_careful_driver_survives_hardest_first() {
        use Outcome::{Hit, LeftRoad, Survived};
        let mut rows: Vec<DriveRow> =
            [(1.0, Hit, Survived), (2.0, Hit, Hit), (3.0, LeftRoad, Survived), (4.0, Survived, Hit)]
                .into_iter()
                .enumerate()
                .flat_map(|(i, (gap_m, own, careful))| {
                    let (id, survives) = (format!("s{i}"), careful == Survived);
                    let drives = [("planner", own), ("careful", careful), ("constant_velocity", own)];
                    drives.map(|(driver, outcome)| row(&id, driver, outcome, survives, gap_m))
                })
                .collect();
        // The first scenario ends with a hit in the rear; who leaves the road with somebody in its rear is not hit.
        for (at, side) in [(0, Side::Rear), (3, Side::Front), (6, Side::Rear)] {
            rows[at].contact = Some(("7".to_owned(), side.name().to_owned(), 3.0));
        }
        let mut report = DriveReport::new(&EgoDriver::from_name("./drive"), Some(RolloutConfig::default()), 1, "m");
        report.left_out.insert("has no ego".to_owned(), 2);
        report.finish(&rows, "planner");
        assert_eq!((report.n_scenarios, report.n_unjudged, report.n_judged()), (4, 2, 4));
        assert_eq!(report.n_survived_at_constant_velocity, Some(1));
        let failures = Failures {
            n_scenarios: 4,
            n_failed: 3,
            n_avoidable: 2,
            n_hit: 2,
            n_hit_avoidable: 1,
            n_hit_in_rear: 1,
            n_careful_failed: 2,
            n_event_happens: 3,
            n_event_avoided: 0,
        };
        assert_eq!((report.failures, report.by_behavior["cut_in"]), (failures, failures));
        let lost = |behavior: &str| {
            let row = row("s", "planner", Survived, true, 0.0);
            Failures::of([&DriveRow { behavior: Some(behavior.to_owned()), ..row }])
        };
        let counts = |f: Failures| (f.n_hit, f.n_event_happens, f.n_event_avoided);
        assert_eq!(["near_miss", "cut_in"].map(|id| counts(lost(id))), [(0, 0, 1), (0, 0, 0)]);
        let ids: Vec<&str> = report.that_matter.iter().map(|matters| matters.scenario_id.as_str()).collect();
        assert_eq!(ids, ["s2", "s0"]);
        let parts: Vec<(u64, u64)> =
            report.by_parameter.iter().map(|part| (part.failures.n_scenarios, part.failures.n_failed)).collect();
        assert_eq!((parts, report.by_parameter[0].range), (vec![(2, 2), (1, 1), (1, 0)], [1.0, 2.0]));
    }
}

//! Decides which scenarios are accepted, which become the corpus, and why the others are left out: one after the other,
//! in the order of the samples.

use super::config::{EvaluateConfig, Keep};
use crate::behavior::{Behavior, needs_cause};
use crate::generate::{RejectedSample, Rejection};
use crate::metrics::{Check, PairPath, PathIndex};
use crate::scenario::{Assessment, RequestOutcome, ScenarioRecord, VerdictRow};
use crate::scene::GuidanceLevel;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// The reason not to accept a scenario without a requested behavior.
const NOTHING_ASKED: &str = "nothing_asked";
/// The reason not to accept a scenario in which the miner does not find the requested behavior.
const NOT_VERIFIED: &str = "not_verified";
/// The reason not to accept a scenario whose event happens without a cause.
const NO_CAUSE: &str = "no_cause";
/// The reason not to accept a scenario in which somebody moves as drivers do not.
const NOT_AS_DRIVEN: &str = "not_as_driven";
/// The reason not to accept a scenario that resembles an earlier one.
const NEAR_DUPLICATE: &str = "near_duplicate";
/// The reason why a sample is not a scenario.
const NOT_FINITE: &str = "not_finite";

/// The verdicts on the scenarios of one sweep at one level.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct AcceptanceRow {
    /// The sweep.
    pub sweep: String,
    /// The level of its guidance.
    #[serde(flatten)]
    pub level: GuidanceLevel,
    /// Scenarios sampled.
    pub n_scenarios: u64,
    /// Scenarios in which the miner finds the requested behavior in the requested roles.
    pub n_verified: u64,
    /// Scenarios that pass every check of validity.
    pub n_valid: u64,
    /// Verified and valid scenarios.
    pub n_verified_valid: u64,
    /// Verified and valid scenarios that are not near-duplicates of accepted ones before.
    pub n_accepted: u64,
    /// Scenarios in the corpus.
    pub n_kept: u64,
}

/// The number of samples of a sweep with one reason not to be accepted.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LeftOutRow {
    /// The stage that found the reason.
    pub stage: String,
    /// The sweep.
    pub sweep: String,
    /// The level of guidance.
    #[serde(flatten)]
    pub level: GuidanceLevel,
    /// The reason: `not_verified`, `near_duplicate`, the name of a check of validity, …
    pub reason: String,
    /// The number left out of the corpus for this reason before any other.
    pub n_left_out: u64,
    /// The number with this reason, alone or with others.
    pub n_found: u64,
}

/// For each sweep, how many samples are not in the corpus, by their first reason.
pub fn left_out_by_sweep(rows: &[LeftOutRow]) -> BTreeMap<String, BTreeMap<String, u64>> {
    let mut by_sweep: BTreeMap<String, BTreeMap<String, u64>> = BTreeMap::new();
    for row in rows.iter().filter(|row| row.n_left_out > 0) {
        *by_sweep.entry(row.sweep.clone()).or_default().entry(row.reason.clone()).or_default() += row.n_left_out;
    }
    by_sweep
}

/// Decides and counts.
pub(super) struct Verdicts<'a> {
    config: &'a EvaluateConfig,
    behaviors: &'a [Box<dyn Behavior>],
    accepted: PathIndex,
    rows: Vec<AcceptanceRow>,
    left_out: Vec<LeftOutRow>,
}

impl<'a> Verdicts<'a> {
    /// A tally without decisions on events of these behaviors.
    pub(super) fn new(config: &'a EvaluateConfig, behaviors: &'a [Box<dyn Behavior>]) -> Self {
        Self { config, behaviors, accepted: PathIndex::default(), rows: Vec::new(), left_out: Vec::new() }
    }

    /// Counts a sample that is not a scenario.
    pub(super) fn count_rejected(&mut self, rejected: &RejectedSample) {
        let reason = match rejected.reason {
            Rejection::RepeatedTemplate => NEAR_DUPLICATE,
            Rejection::Unfit(_) => NOT_FINITE,
        };
        self.count(("generate", &rejected.sweep, rejected.level), reason, true);
    }

    /// Completes the judgment of a record and returns the verdict. Records must come in the order of the samples,
    /// because the first of several near-duplicates is accepted. `not_checked` lists the checks of validity that were
    /// not made.
    pub(super) fn decide(&mut self, record: &mut ScenarioRecord, not_checked: &[Check]) -> VerdictRow {
        let path = PairPath::of(&record.scenario.scene, &record.scenario.provenance.guidance.roles);
        let (scenario_id, level) = (record.scenario.id.clone(), record.scenario.provenance.guidance.level);
        let asked = record.requested_behavior.clone();
        let mut assessment = record.assessment.take().unwrap_or_default();
        if let Some((behavior, path)) = asked.as_deref().zip(path.as_ref())
            && let Some((nearest, distance_m)) = self.accepted.nearest(behavior, path)
        {
            assessment.nearest_scenario_m = Some(distance_m);
            let is_near = distance_m < self.config.duplicate_distance_m;
            assessment.near_duplicate_of = is_near.then(|| nearest.to_owned());
        }
        let reasons = self.reasons_against(record, &assessment);
        assessment.accepted = reasons.is_empty();
        let is_kept = match self.config.keep {
            Keep::Accepted => assessment.accepted,
            Keep::Verified => record.verified && unwanted_outcome(record).is_none(),
            Keep::All => true,
        };
        self.count_judged((&record.sweep, level), record.verified, &assessment, is_kept);
        for (i, reason) in reasons.iter().enumerate() {
            self.count(("evaluate", &record.sweep, level), reason, i == 0 && !is_kept);
        }
        if let (true, Some(behavior), Some(path)) = (assessment.accepted, asked, path) {
            self.accepted.insert(&behavior, path, &scenario_id);
        }
        let verdict = VerdictRow {
            accepted: assessment.accepted,
            kept: is_kept,
            reasons: reasons.into_iter().map(str::to_owned).collect(),
            preventable: assessment.careful.map(|careful| careful.preventable),
            careful_margin_s: assessment.careful.and_then(|careful| careful.margin_s),
            not_checked: not_checked.iter().map(|check| check.name().to_owned()).collect(),
            scenario_id,
            sweep: record.sweep.clone(),
            level,
        };
        record.assessment = Some(assessment);
        verdict
    }

    /// The counts, in the order of first appearance.
    pub(super) fn finish(self) -> (Vec<AcceptanceRow>, Vec<LeftOutRow>) {
        (self.rows, self.left_out)
    }

    /// Why a scenario is not accepted; empty if it is.
    fn reasons_against(&self, record: &ScenarioRecord, assessment: &Assessment) -> Vec<&'static str> {
        let mut reasons = Vec::new();
        if !record.verified {
            reasons.push(if record.requested_behavior.is_some() { NOT_VERIFIED } else { NOTHING_ASKED });
        }
        // A scenario that a request did not take is named by its outcome, unless nothing was found, which is a reason
        // already.
        reasons.extend(unwanted_outcome(record).filter(|_| record.verified).map(RequestOutcome::name));
        reasons.extend(assessment.violations.iter().map(|violation| violation.check.name()));
        let needs_cause =
            self.config.require_cause && record.main_event().is_some_and(|event| needs_cause(&event.behavior));
        reasons.extend((needs_cause && assessment.explanation.is_none()).then_some(NO_CAUSE));
        reasons.extend((!record.is_as_driven(self.behaviors)).then_some(NOT_AS_DRIVEN));
        reasons
            .extend(assessment.near_duplicate_of.as_ref().map(|_| NEAR_DUPLICATE).filter(|why| !reasons.contains(why)));
        reasons
    }

    /// Counts a scenario among those of its sweep and level.
    fn count_judged(
        &mut self,
        (sweep, level): (&str, GuidanceLevel),
        verified: bool,
        assessment: &Assessment,
        is_kept: bool,
    ) {
        let is_valid = assessment.is_valid();
        let row = self.row(sweep, level);
        row.n_scenarios += 1;
        row.n_verified += u64::from(verified);
        row.n_valid += u64::from(is_valid);
        row.n_verified_valid += u64::from(verified && is_valid);
        row.n_accepted += u64::from(assessment.accepted);
        row.n_kept += u64::from(is_kept);
    }

    fn row(&mut self, sweep: &str, level: GuidanceLevel) -> &mut AcceptanceRow {
        let is_same = |row: &AcceptanceRow| row.sweep == sweep && row.level == level;
        let at = self.rows.iter().position(is_same).unwrap_or_else(|| {
            self.rows.push(AcceptanceRow { sweep: sweep.to_owned(), level, ..AcceptanceRow::default() });
            self.rows.len() - 1
        });
        &mut self.rows[at]
    }

    fn count(&mut self, (stage, sweep, level): (&str, &str, GuidanceLevel), reason: &str, is_first: bool) {
        let is_same =
            |row: &LeftOutRow| row.stage == stage && row.sweep == sweep && row.level == level && row.reason == reason;
        let at = self.left_out.iter().position(is_same).unwrap_or_else(|| {
            let (stage, sweep, reason) = (stage.to_owned(), sweep.to_owned(), reason.to_owned());
            self.left_out.push(LeftOutRow { stage, sweep, level, reason, n_left_out: 0, n_found: 0 });
            self.left_out.len() - 1
        });
        self.left_out[at].n_found += 1;
        self.left_out[at].n_left_out += u64::from(is_first);
    }
}

/// The outcome of a scenario that its request did not take. `None` if the request took it, or there is no request.
fn unwanted_outcome(record: &ScenarioRecord) -> Option<RequestOutcome> {
    record.request.as_ref().map(|tag| tag.outcome).filter(|outcome| *outcome != RequestOutcome::Accepted)
}

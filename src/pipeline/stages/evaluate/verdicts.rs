//! Which scenarios are accepted, which become the corpus, and why are the others left out? Decided one by one, in the order of the samples.

use super::config::{EvaluateConfig, Keep};
use crate::metrics::{PairPath, PathIndex};
use crate::pipeline::stages::SampleManifest;
use crate::report::{AcceptanceRow, LeftOutRow};
use crate::store::{RequestOutcome, ScenarioRecord, VerdictRow};
use std::collections::BTreeMap;

/// Why a scenario of which nothing was asked is not accepted.
const NOTHING_ASKED: &str = "nothing_asked";
/// Why a scenario is not accepted in which the miner does not find what was asked.
const NOT_VERIFIED: &str = "not_verified";
/// Why a scenario is not accepted that is like one before it.
const NEAR_DUPLICATE: &str = "near_duplicate";
/// Why a sample is no scenario.
const NOT_FINITE: &str = "not_finite";

/// Decides and counts.
pub(super) struct Verdicts<'a> {
    config: &'a EvaluateConfig,
    accepted: PathIndex,
    rows: Vec<AcceptanceRow>,
    left_out: Vec<LeftOutRow>,
    decided: Vec<VerdictRow>,
}

impl<'a> Verdicts<'a> {
    /// Nothing decided yet; what generation itself left out is counted already.
    pub(super) fn new(config: &'a EvaluateConfig, samples: &SampleManifest) -> Self {
        let mut verdicts = Self {
            config,
            accepted: PathIndex::default(),
            rows: Vec::new(),
            left_out: Vec::new(),
            decided: Vec::new(),
        };
        for rejected in samples.shards.iter().flat_map(|shard| &shard.rejected) {
            verdicts.count(("generate", &rejected.sweep, Some(rejected.strength)), NOT_FINITE, 1, true);
        }
        for (sweep, reasons) in &samples.unselected {
            for (reason, n) in reasons {
                verdicts.count(("generate", sweep, None), &format!("selection: {reason}"), *n, true);
            }
        }
        verdicts
    }

    /// Completes the judgment of a record and says whether it becomes part of the corpus. Records must come in the order of the samples:
    /// of near-duplicates the first is accepted.
    pub(super) fn decide(&mut self, record: &mut ScenarioRecord) -> bool {
        let path = PairPath::of(&record.scenario.scene, &record.scenario.provenance.guidance.roles);
        let (scenario_id, strength) = (record.scenario.id.clone(), record.scenario.provenance.guidance.strength);
        let (sweep, verified) = (record.sweep.clone(), record.verified);
        let asked = record.requested_behavior.clone();
        let mut assessment = record.assessment.take().unwrap_or_default();
        if let Some((behavior, path)) = asked.as_deref().zip(path.as_ref())
            && let Some((nearest, distance_m)) = self.accepted.nearest(behavior, path)
        {
            assessment.nearest_scenario_m = Some(distance_m);
            let is_near = distance_m < self.config.duplicate_distance_m;
            assessment.near_duplicate_of = is_near.then(|| nearest.to_owned());
        }
        let mut reasons: Vec<&str> = Vec::new();
        if !verified {
            reasons.push(if asked.is_some() { NOT_VERIFIED } else { NOTHING_ASKED });
        }
        // What a request did not take is named by its outcome; that nothing was found is said already.
        let outcome = record.request.as_ref().map(|tag| tag.outcome);
        let is_wanted = outcome.is_none_or(|outcome| outcome == RequestOutcome::Accepted);
        reasons.extend(outcome.filter(|_| verified && !is_wanted).map(RequestOutcome::name));
        reasons.extend(assessment.violations.iter().map(|violation| violation.check.id()));
        reasons.extend(assessment.near_duplicate_of.as_ref().map(|_| NEAR_DUPLICATE));
        assessment.accepted = reasons.is_empty();
        let is_kept = match self.config.keep {
            Keep::Accepted => assessment.accepted,
            Keep::Verified => verified && is_wanted,
            Keep::All => true,
        };
        let is_valid = assessment.is_valid();
        let row = self.row(&sweep, strength);
        row.n_scenarios += 1;
        row.n_verified += u64::from(verified);
        row.n_valid += u64::from(is_valid);
        row.n_verified_valid += u64::from(verified && is_valid);
        row.n_accepted += u64::from(assessment.accepted);
        row.n_kept += u64::from(is_kept);
        for (i, reason) in reasons.iter().enumerate() {
            self.count(("evaluate", &sweep, Some(strength)), reason, 1, i == 0 && !is_kept);
        }
        if let (true, Some(behavior), Some(path)) = (assessment.accepted, asked, path) {
            self.accepted.insert(&behavior, path, &scenario_id);
        }
        self.decided.push(VerdictRow {
            accepted: assessment.accepted,
            kept: is_kept,
            reasons: reasons.into_iter().map(str::to_owned).collect(),
            scenario_id,
            sweep,
            strength,
        });
        record.assessment = Some(assessment);
        is_kept
    }

    /// What was decided, scenario by scenario, in their order.
    pub(super) fn decided(&self) -> &[VerdictRow] {
        &self.decided
    }

    /// The counts, in the order of first appearance.
    pub(super) fn finish(self) -> (Vec<AcceptanceRow>, Vec<LeftOutRow>) {
        (self.rows, self.left_out)
    }

    /// Of each sweep why samples of it are not kept, and how many, each for its first reason.
    pub(super) fn left_out_by_sweep(left_out: &[LeftOutRow]) -> BTreeMap<String, BTreeMap<String, u64>> {
        let mut by_sweep: BTreeMap<String, BTreeMap<String, u64>> = BTreeMap::new();
        for row in left_out.iter().filter(|row| row.n_left_out > 0) {
            *by_sweep.entry(row.sweep.clone()).or_default().entry(row.reason.clone()).or_default() += row.n_left_out;
        }
        by_sweep
    }

    fn row(&mut self, sweep: &str, strength: f64) -> &mut AcceptanceRow {
        let is_same = |row: &AcceptanceRow| row.sweep == sweep && row.strength.to_bits() == strength.to_bits();
        let at = self.rows.iter().position(is_same).unwrap_or_else(|| {
            self.rows.push(AcceptanceRow { sweep: sweep.to_owned(), strength, ..AcceptanceRow::default() });
            self.rows.len() - 1
        });
        &mut self.rows[at]
    }

    fn count(&mut self, (stage, sweep, strength): (&str, &str, Option<f64>), reason: &str, n: u64, is_first: bool) {
        let is_same = |row: &LeftOutRow| {
            row.stage == stage
                && row.sweep == sweep
                && row.strength.map(f64::to_bits) == strength.map(f64::to_bits)
                && row.reason == reason
        };
        let at = self.left_out.iter().position(is_same).unwrap_or_else(|| {
            let (stage, sweep, reason) = (stage.to_owned(), sweep.to_owned(), reason.to_owned());
            self.left_out.push(LeftOutRow { stage, sweep, strength, reason, n_left_out: 0, n_found: 0 });
            self.left_out.len() - 1
        });
        self.left_out[at].n_found += n;
        self.left_out[at].n_left_out += if is_first { n } else { 0 };
    }
}

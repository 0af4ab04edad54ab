//! How many scenarios of each sweep are valid, and how many of the recordings that they continue? Counts failures by
//! check.

use super::judge::ReferenceJudgment;
use crate::metrics::{Check, Group, SeriesKey, Violation};
use crate::scenario::Assessment;
use crate::scene::GuidanceLevel;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// How many scenes of a group are valid, and how many fail each check.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ValidityRow {
    /// The group that the scenes belong to.
    pub group: Group,
    /// The judged sweep, or the one that continues these recordings.
    pub sweep: String,
    /// The level of its guidance.
    #[serde(flatten)]
    pub level: GuidanceLevel,
    /// The place; empty for all.
    pub place: String,
    /// Scenes judged.
    pub n: u64,
    /// Scenes that pass every check.
    pub n_valid: u64,
    /// Check → the number of failures; checks without failures are missing.
    pub violations: BTreeMap<String, u64>,
    /// Check → the number of scenes for which it was not made; checks that were always made are missing.
    pub not_checked: BTreeMap<String, u64>,
    /// Mean share of motion within the recorded ranges.
    pub plausibility: Option<f64>,
}

impl ValidityRow {
    /// The counted series.
    pub fn series(&self) -> SeriesKey {
        SeriesKey { group: self.group.clone(), sweep: self.sweep.clone(), level: self.level }
    }
}

/// Counts group by group, in order of first appearance.
#[derive(Default)]
pub(super) struct ValidityTable {
    rows: Vec<ValidityRow>,
    /// Sum and number of the plausibilities of each row.
    plausibilities: Vec<(f64, u64)>,
}

impl ValidityTable {
    /// Counts the scenarios of a cell of `series` that continue a scene of `place`, and its recording and baseline if
    /// they are measured.
    pub(super) fn add(
        &mut self,
        (series, place): (&SeriesKey, &str),
        (references, assessments): (Option<&[ReferenceJudgment; 2]>, &[Assessment]),
        not_checked: &[Check],
    ) {
        let reference = |group| SeriesKey::reference(group, &series.sweep);
        let reference_keys = [Group::Recorded, Group::ConstantVelocity].map(reference);
        // All places together first, then each by itself.
        for place in ["", place] {
            for (key, judgment) in reference_keys.iter().zip(references.into_iter().flatten()) {
                self.count(key, place, (&judgment.violations, not_checked), judgment.plausibility);
            }
            for assessment in assessments {
                self.count(series, place, (&assessment.violations, not_checked), assessment.plausibility);
            }
        }
    }

    fn count(
        &mut self,
        key: &SeriesKey,
        place: &str,
        (violations, not_checked): (&[Violation], &[Check]),
        plausibility: Option<f64>,
    ) {
        let is_same = |row: &ValidityRow| row.place == place && row.series() == *key;
        let at = self.rows.iter().position(is_same).unwrap_or_else(|| {
            let SeriesKey { group, sweep, level } = key.clone();
            self.rows.push(ValidityRow {
                group,
                sweep,
                level,
                place: place.to_owned(),
                n: 0,
                n_valid: 0,
                violations: BTreeMap::new(),
                not_checked: BTreeMap::new(),
                plausibility: None,
            });
            self.plausibilities.push((0.0, 0));
            self.rows.len() - 1
        });
        let row = &mut self.rows[at];
        row.n += 1;
        row.n_valid += u64::from(violations.is_empty());
        for violation in violations {
            *row.violations.entry(violation.check.name().to_owned()).or_default() += 1;
        }
        for check in not_checked {
            *row.not_checked.entry(check.name().to_owned()).or_default() += 1;
        }
        if let Some(plausibility) = plausibility {
            self.plausibilities[at].0 += plausibility;
            self.plausibilities[at].1 += 1;
        }
    }

    /// The rows: of all places together, then place by place.
    pub(super) fn finish(self) -> Vec<ValidityRow> {
        let mut rows: Vec<ValidityRow> = self
            .rows
            .into_iter()
            .zip(self.plausibilities)
            .map(|(row, (sum, n))| ValidityRow { plausibility: (n > 0).then(|| sum / n as f64), ..row })
            .collect();
        rows.sort_by(|a, b| a.place.cmp(&b.place));
        rows
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evaluate::metric_rows::{CellNames, MetricRows};
    use crate::evaluate::testing::{evaluated_cell, record, recorded};
    use crate::scene::GuidanceTag;

    /// The tables of single scenes and of validity must not disagree on what is unguided.
    #[test]
    fn every_table_puts_edited_scenarios_with_their_sweep() {
        let groups = |edit_tau: Option<f64>| -> Vec<Group> {
            let mut record = record(0.0, false, false, recorded());
            record.scenario.provenance.guidance.kind = GuidanceTag::NONE.to_owned();
            record.scenario.provenance.edit_tau = edit_tau;
            let (cell, figures, docs) = evaluated_cell(&record, &recorded());
            let mut validity = ValidityTable::default();
            let judged = (figures.references_judged.as_ref(), figures.assessments.as_slice());
            let series = cell.series("s");
            validity.add((&series, "X"), judged, &[]);
            let scratch = tempfile::tempdir().unwrap();
            let mut rows = MetricRows::create(docs, scratch.path()).unwrap();
            let names = CellNames { series: &series, place: "X", scene_id: &recorded().id, scenario_ids: &[] };
            rows.add(&names, &figures).unwrap();
            let rows = rows.finish().unwrap();
            let last = |groups: Vec<Group>| groups.last().cloned().expect("rows");
            vec![
                last(validity.finish().into_iter().map(|row| row.group).collect()),
                last(rows.of_scenes().unwrap().map(|row| row.unwrap().group).collect()),
            ]
        };
        assert_eq!(groups(None), vec![Group::Unguided; 2]);
        assert_eq!(groups(Some(0.4)), vec![Group::Sweep("s".to_owned()); 2]);
    }
}

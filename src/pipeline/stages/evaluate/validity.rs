//! How many scenarios of each sweep are valid, and how many of the recordings they continue are? Counted by check.

use super::cells::Cell;
use super::judge::ReferenceJudgment;
use crate::metrics::Violation;
use crate::report::ValidityRow;
use crate::scene::Scene;
use crate::store::Assessment;

/// Counts group by group, in order of first appearance.
#[derive(Default)]
pub(super) struct ValidityTable {
    rows: Vec<ValidityRow>,
    /// Sum and number of the plausibilities of each row.
    plausibilities: Vec<(f64, u64)>,
}

impl ValidityTable {
    /// Counts the scenarios of a cell of `sweep`, and its recording and baseline where they are measured.
    pub(super) fn add(
        &mut self,
        sweep: &str,
        (cell, recorded): (&Cell<'_>, &Scene),
        references: Option<&[ReferenceJudgment; 2]>,
        assessments: &[Assessment],
    ) {
        let strength = cell.records[0].scenario.provenance.guidance.strength;
        // All places together first, and each by itself.
        for place in ["", &recorded.source.place] {
            for (name, judgment) in ["recorded", "constant_velocity"].into_iter().zip(references.into_iter().flatten())
            {
                self.count((name, sweep, 0.0, place), &judgment.violations, judgment.plausibility);
            }
            let name = if strength == 0.0 { "unguided" } else { sweep };
            for assessment in assessments {
                self.count((name, sweep, strength, place), &assessment.violations, assessment.plausibility);
            }
        }
    }

    fn count(
        &mut self,
        (group, sweep, strength, place): (&str, &str, f64, &str),
        violations: &[Violation],
        plausibility: Option<f64>,
    ) {
        let is_same = |row: &ValidityRow| {
            row.group == group
                && row.sweep == sweep
                && row.place == place
                && row.strength.to_bits() == strength.to_bits()
        };
        let at = self.rows.iter().position(is_same).unwrap_or_else(|| {
            let (group, sweep, place) = (group.to_owned(), sweep.to_owned(), place.to_owned());
            self.rows.push(ValidityRow { group, sweep, strength, place, ..ValidityRow::default() });
            self.plausibilities.push((0.0, 0));
            self.rows.len() - 1
        });
        let row = &mut self.rows[at];
        row.n += 1;
        row.n_valid += u64::from(violations.is_empty());
        for violation in violations {
            *row.violations.entry(violation.check.id().to_owned()).or_default() += 1;
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

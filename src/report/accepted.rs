//! The accepted scenarios of a run, and how hard they are.

use crate::metrics::MetricRow;
use crate::scenario::VerdictRow;
use std::collections::BTreeMap;

/// The metric by which scenarios are sorted, the hardest first: the shortest time to collision.
pub(super) const HARDNESS: &str = "pair_min_ttc_s";
/// A time to collision below this is critical, seconds.
const CRITICAL_S: f64 = 1.5;

/// The accepted scenarios of a run.
#[derive(Debug, Clone, Default)]
pub struct Accepted {
    /// The shortest time to collision of each scenario by its id, seconds; infinite without a collision course.
    min_ttc_s: BTreeMap<String, f64>,
    /// Scenarios in which the careful driver was judged, and those of them in which it could not prevent a collision.
    n_careful: u64,
    n_not_preventable: u64,
    /// Whether any scenario, accepted or not, has a time to collision: if not, it was not measured.
    has_ttc: bool,
}

/// The number of accepted scenarios, and how hard they are.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct HardnessSummary {
    /// The situations that they continue: a recorded scene with the road users of the event.
    pub n_situations: u64,
    /// Scenarios with a time to collision below 1.5 s; `None` if it was not measured.
    pub n_critical: Option<u64>,
    /// Scenarios without a time to collision; `None` if it was not measured.
    pub n_without_ttc: Option<u64>,
    /// Scenarios in which a careful driver was judged, and of them, those that it could not have prevented.
    pub n_careful: u64,
    /// See `n_careful`.
    pub n_not_preventable: u64,
}

impl Accepted {
    /// Adds a scenario if it was accepted.
    pub fn add_verdict(&mut self, row: VerdictRow) {
        if row.accepted {
            self.n_careful += u64::from(row.preventable.is_some());
            self.n_not_preventable += u64::from(row.preventable == Some(false));
            self.min_ttc_s.insert(row.scenario_id, f64::INFINITY);
        }
    }

    /// Adds a figure, after all verdicts.
    pub fn add_metric(&mut self, row: &MetricRow) {
        let Some(id) = &row.scenario_id else { return };
        let accepted = self.min_ttc_s.get_mut(id);
        if row.metric == HARDNESS {
            self.has_ttc = true;
            accepted.into_iter().for_each(|min_ttc_s| *min_ttc_s = row.value);
        }
    }

    /// The shortest time to collision of a scenario, seconds; `None` if it was not accepted.
    pub(super) fn min_ttc_s(&self, id: &str) -> Option<f64> {
        self.min_ttc_s.get(id).copied()
    }

    pub(super) fn summary(&self, n_situations: usize) -> HardnessSummary {
        let n_of = |is: fn(f64) -> bool| {
            self.has_ttc.then(|| self.min_ttc_s.values().filter(|ttc_s| is(**ttc_s)).count() as u64)
        };
        HardnessSummary {
            n_situations: n_situations as u64,
            n_critical: n_of(|ttc_s| ttc_s < CRITICAL_S),
            n_without_ttc: n_of(f64::is_infinite),
            n_careful: self.n_careful,
            n_not_preventable: self.n_not_preventable,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_name_is_that_of_a_metric() {
        assert!(crate::metrics::by_id(HARDNESS).is_some());
    }

    #[test]
    fn what_was_not_measured_is_not_counted() {
        let nothing = HardnessSummary { n_situations: 2, ..HardnessSummary::default() };
        assert_eq!(Accepted::default().summary(2), nothing);
    }
}

//! The accepted scenarios of a run, and how hard they are.

use crate::metrics::MetricRow;
use crate::scenario::VerdictRow;
use std::collections::BTreeMap;

/// The metric by which scenarios are sorted, the hardest first: the shortest time to collision.
pub(super) const HARDNESS: &str = "pair_min_ttc_s";
/// The metric that is 0 where a careful driver could not have prevented the event from becoming a collision.
const PREVENTABLE: &str = "preventable_rate";
/// A time to collision below this is critical, seconds.
const CRITICAL_S: f64 = 1.5;

/// The accepted scenarios of a run.
#[derive(Debug, Clone, Default)]
pub struct Accepted {
    /// The shortest time to collision of each scenario by its id, seconds; infinite without a collision course.
    min_ttc_s: BTreeMap<String, f64>,
    /// `None` where no scenario, accepted or not, has the metric.
    n_not_preventable: Option<u64>,
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
    /// Scenarios that a careful driver could not have prevented; `None` if that was not judged.
    pub n_not_preventable: Option<u64>,
}

impl Accepted {
    /// Adds a scenario if it was accepted.
    pub fn add_verdict(&mut self, row: VerdictRow) {
        if row.accepted {
            self.min_ttc_s.insert(row.scenario_id, f64::INFINITY);
        }
    }

    /// Adds a figure, after all verdicts.
    pub fn add_metric(&mut self, row: &MetricRow) {
        let Some(id) = &row.scenario_id else { return };
        let accepted = self.min_ttc_s.get_mut(id);
        match row.metric.as_str() {
            HARDNESS => {
                self.has_ttc = true;
                accepted.into_iter().for_each(|min_ttc_s| *min_ttc_s = row.value);
            }
            PREVENTABLE => {
                *self.n_not_preventable.get_or_insert(0) += u64::from(accepted.is_some() && row.value == 0.0);
            }
            _ => {}
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
            n_not_preventable: self.n_not_preventable,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_names_are_those_of_metrics() {
        assert!([HARDNESS, PREVENTABLE].into_iter().all(|name| crate::metrics::by_id(name).is_some()));
    }

    #[test]
    fn what_was_not_measured_is_not_counted() {
        let nothing = HardnessSummary { n_situations: 2, ..HardnessSummary::default() };
        assert_eq!(Accepted::default().summary(2), nothing);
    }
}

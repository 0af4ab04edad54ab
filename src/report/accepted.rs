//! The accepted scenarios of a run, and how hard they are.

use crate::metrics::MetricRow;
use crate::scenario::VerdictRow;
use std::collections::BTreeMap;

/// The metric by which scenarios are sorted, the hardest first: the least time to collision.
pub(super) const HARDNESS: &str = "pair_min_ttc_s";
/// The metric that is 0 where a careful driver could not have prevented the event from becoming a collision.
const PREVENTABLE: &str = "preventable_rate";
/// A time to collision below this is critical, seconds.
const CRITICAL_S: f64 = 1.5;

/// The accepted scenarios of a run.
#[derive(Debug, Clone, Default)]
pub struct Accepted {
    /// Their least times to collision, seconds, by their ids; infinite without a course to collide.
    min_ttc_s: BTreeMap<String, f64>,
    n_not_preventable: u64,
}

/// How many scenarios were accepted, and how hard they are.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct HardnessSummary {
    /// Situations, a recorded scene with the road users of the event, that they continue.
    pub n_situations: u64,
    /// Those with a time to collision below 1.5 s.
    pub n_critical: u64,
    /// Those that a careful driver could not have prevented.
    pub n_not_preventable: u64,
    /// Those in which the two are never on course to collide.
    pub n_without_course: u64,
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
        let known = row.scenario_id.as_ref().and_then(|id| self.min_ttc_s.get_mut(id));
        match (known, row.metric.as_str()) {
            (Some(min_ttc_s), HARDNESS) => *min_ttc_s = row.value,
            (Some(_), PREVENTABLE) if row.value == 0.0 => self.n_not_preventable += 1,
            _ => {}
        }
    }

    /// The least time to collision of a scenario, seconds; `None` if it was not accepted.
    pub(super) fn min_ttc_s(&self, id: &str) -> Option<f64> {
        self.min_ttc_s.get(id).copied()
    }

    pub(super) fn summary(&self, n_situations: usize) -> HardnessSummary {
        let n_of = |is: fn(f64) -> bool| self.min_ttc_s.values().filter(|ttc_s| is(**ttc_s)).count() as u64;
        HardnessSummary {
            n_situations: n_situations as u64,
            n_critical: n_of(|ttc_s| ttc_s < CRITICAL_S),
            n_not_preventable: self.n_not_preventable,
            n_without_course: n_of(f64::is_infinite),
        }
    }
}

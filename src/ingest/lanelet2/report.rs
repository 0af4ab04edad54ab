//! The defects of a map, and the lanelets left out because of them.

use crate::ingest::RejectCount;
use std::collections::BTreeMap;

/// How many examples of each warning are kept.
const MAX_EXAMPLES: usize = 5;

/// The report on the lanelets of a map.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct MapReport {
    /// Relations of type `lanelet`.
    pub n_lanelets: u64,
    /// Lanelets that vehicles may not use, such as crosswalks; not lanes.
    pub n_not_drivable: u64,
    /// Lanes read.
    pub n_lanes: u64,
    /// The faults of the map by reason, with the ids of the first few elements.
    pub warnings: BTreeMap<&'static str, RejectCount>,
}

impl MapReport {
    pub(super) fn warn(&mut self, reason: &'static str, detail: String) {
        let entry = self.warnings.entry(reason).or_default();
        entry.count += 1;
        if entry.examples.len() < MAX_EXAMPLES {
            entry.examples.push(detail);
        }
    }

    /// The warnings on one line; empty when there are none.
    pub fn summary(&self) -> String {
        let one = |(reason, warnings): (&&str, &RejectCount)| {
            format!("{} {reason} ({})", warnings.count, warnings.examples.join("; "))
        };
        self.warnings.iter().map(one).collect::<Vec<_>>().join(", ")
    }
}

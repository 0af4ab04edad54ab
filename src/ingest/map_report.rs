//! The defects of a map, and the lanes left out because of them.

use super::raw::Finding;
use super::report::RejectCount;
use std::collections::BTreeMap;

/// The report on the lanes of a map.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct MapReport {
    /// Lanelet2: relations of type `lanelet`.
    pub n_lanelets: u64,
    /// Lanelet2: lanelets that vehicles may not use, such as crosswalks; not lanes.
    pub n_not_drivable: u64,
    /// Lanes read.
    pub n_lanes: u64,
    /// The faults of the map by reason, with the ids of the first few elements.
    pub warnings: BTreeMap<&'static str, RejectCount>,
}

impl MapReport {
    pub(super) fn warn(&mut self, reason: &'static str, detail: String) {
        self.warnings.entry(reason).or_default().add(1, detail);
    }

    /// The warnings for the report on the scene with this map, which is in `file`.
    pub(super) fn findings(&self, file: &str) -> Vec<Finding> {
        let one = |(what, found): (&&'static str, &RejectCount)| {
            let detail = format!("{file}: {}", found.examples.join("; "));
            Finding { what, n: found.count, detail }
        };
        self.warnings.iter().map(one).collect()
    }

    /// The warnings on one line; empty when there are none.
    pub fn summary(&self) -> String {
        let one = |(reason, warnings): (&&str, &RejectCount)| {
            format!("{} {reason} ({})", warnings.count, warnings.examples.join("; "))
        };
        self.warnings.iter().map(one).collect::<Vec<_>>().join(", ")
    }
}

//! The report of an ingest: what it read, kept and left out, by reason.

use super::raw::{Finding, Reject};
use crate::scene::SceneSource;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// The number of examples kept for each reject reason.
const MAX_EXAMPLES: usize = 5;

/// Counts of what was read, kept and left out. Reports of consecutive batches add up with [`IngestReport::merge`].
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct IngestReport {
    /// Units read: files, cases or recordings.
    pub n_units: u64,
    /// Bytes of those units, uncompressed.
    pub n_bytes: u64,
    /// Scenes kept.
    pub n_scenes: u64,
    /// Agents in those scenes.
    pub n_agents: u64,
    /// Scenes by `split/place`.
    pub scenes_by: BTreeMap<String, u64>,
    /// Rejected units and scenes by reason.
    pub rejects: BTreeMap<String, RejectCount>,
    /// Counts of units, scenes and agents left out by the configuration, such as agents over the cap and scenes of
    /// other places.
    pub dropped: BTreeMap<String, u64>,
    /// Counts of assumptions for data that is not recorded, such as headings of standing vehicles.
    pub assumed: BTreeMap<String, u64>,
    /// Doubts about the scenes kept and their maps, by kind.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub warnings: BTreeMap<String, RejectCount>,
}

/// Rejects or warnings of one reason.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct RejectCount {
    /// Their number.
    pub count: u64,
    /// File, line and detail of the first few.
    pub examples: Vec<String>,
}

impl RejectCount {
    /// Counts `n` more, with an example.
    pub(super) fn add(&mut self, n: u64, example: String) {
        self.count += n;
        if self.examples.len() < MAX_EXAMPLES {
            self.examples.push(example);
        }
    }
}

impl IngestReport {
    /// Adds the counts of a later batch.
    pub fn merge(&mut self, later: &Self) {
        self.n_units += later.n_units;
        self.n_bytes += later.n_bytes;
        self.n_scenes += later.n_scenes;
        self.n_agents += later.n_agents;
        for (counts, added) in [
            (&mut self.scenes_by, &later.scenes_by),
            (&mut self.dropped, &later.dropped),
            (&mut self.assumed, &later.assumed),
        ] {
            for (key, n) in added {
                add(counts, key, *n);
            }
        }
        for (counts, added) in [(&mut self.rejects, &later.rejects), (&mut self.warnings, &later.warnings)] {
            for (reason, found) in added {
                let entry = counts.entry(reason.clone()).or_default();
                entry.count += found.count;
                let room = MAX_EXAMPLES.saturating_sub(entry.examples.len());
                entry.examples.extend(found.examples.iter().take(room).cloned());
            }
        }
    }

    /// Counts a reject.
    pub fn count_reject(&mut self, reject: &Reject) {
        self.rejects.entry(reject.reason.to_owned()).or_default().add(1, reject.detail.clone());
    }

    pub(super) fn count_warning(&mut self, Finding { what, n, detail }: Finding) {
        self.warnings.entry(what.to_owned()).or_default().add(n, detail);
    }

    /// The doubts, a sentence for each kind.
    pub fn warnings(&self) -> impl Iterator<Item = String> {
        self.warnings.iter().map(|(what, found)| {
            let first = found.examples.first().map_or("", String::as_str);
            format!("{} {}, the first: {first}", found.count, what.replace('_', " "))
        })
    }

    /// The agents that scenes lack although they are there at present, in a sentence; `None` without any.
    pub(super) fn agents_left_out(&self) -> Option<String> {
        let counts = [
            ("agents_over_cap", "over the cap of ingest.max_agents"),
            ("agents_static", "static"),
            ("agents_of_unknown_type", "of unknown type"),
        ];
        let one = |(key, what)| self.dropped.get(key).map(|n| format!("{n} {what}"));
        let found: Vec<String> = counts.into_iter().filter_map(one).collect();
        (!found.is_empty()).then(|| format!("agents left out of scenes: {}", found.join(", ")))
    }

    /// Counts `n` things left out.
    pub fn count_dropped(&mut self, what: &str, n: u64) {
        add(&mut self.dropped, what, n);
    }

    /// Counts `n` assumptions.
    pub fn count_assumed(&mut self, what: &str, n: u64) {
        add(&mut self.assumed, what, n);
    }

    pub(super) fn count_scene(&mut self, source: &SceneSource, n_agents: usize) {
        self.n_scenes += 1;
        self.n_agents += n_agents as u64;
        add(&mut self.scenes_by, &format!("{}/{}", source.split.name(), source.place), 1);
    }

    /// Number of rejects of all reasons.
    pub fn n_rejects(&self) -> u64 {
        self.rejects.values().map(|rejects| rejects.count).sum()
    }

    /// A summary in one line.
    pub fn summary(&self) -> String {
        let mut parts = vec![format!("{} units read, {} scenes kept", self.n_units, self.n_scenes)];
        parts.extend(self.rejects.iter().map(|(reason, rejects)| {
            let first = rejects.examples.first().map_or(String::new(), |example| format!(" (first: {example})"));
            format!("{} rejected as {reason}{first}", rejects.count)
        }));
        parts.extend(self.dropped.iter().map(|(what, n)| format!("{n} {} dropped", what.replace('_', " "))));
        parts.extend(self.assumed.iter().map(|(what, n)| format!("{n} {}", what.replace('_', " "))));
        parts.join("; ")
    }
}

fn add(counts: &mut BTreeMap<String, u64>, key: &str, n: u64) {
    if n > 0 {
        *counts.entry(key.to_owned()).or_default() += n;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn with_rejects(range: std::ops::Range<usize>) -> IngestReport {
        let mut report = IngestReport { n_units: range.len() as u64, ..Default::default() };
        for i in range {
            report.count_reject(&Reject { reason: "non_finite", detail: format!("file{i}.csv:2: x is NaN") });
        }
        report.count_dropped("agents_over_cap", 3);
        report
    }

    #[test]
    fn merging_batches_is_counting_all_at_once() {
        let mut merged = with_rejects(0..2);
        merged.merge(&with_rejects(2..9));
        let mut at_once = with_rejects(0..9);
        at_once.count_dropped("agents_over_cap", 3);
        assert_eq!(merged, at_once);
        assert_eq!(merged.rejects["non_finite"].examples.len(), MAX_EXAMPLES);
        assert_eq!(merged.n_rejects(), 9);
    }

    #[test]
    fn the_summary_names_the_first_example() {
        let summary = with_rejects(0..2).summary();
        assert!(summary.contains("2 rejected as non_finite (first: file0.csv:2: x is NaN)"), "{summary}");
        let mut report = with_rejects(0..1);
        report.count_dropped("agents_static", 2);
        report.count_dropped("agents_absent", 9);
        let expected = "agents left out of scenes: 3 over the cap of ingest.max_agents, 2 static";
        assert_eq!(report.agents_left_out().as_deref(), Some(expected));
        assert_eq!(IngestReport::default().agents_left_out(), None);
    }
}

//! What is left out of a recording or noteworthy in it, by reason, each with the first place.

use crate::ingest::raw::MAX_BAD_SHARE;
use crate::ingest::{Finding, Reject};
use std::collections::BTreeMap;

/// Counts of a recording, or of a part of it.
#[derive(Debug, Default)]
pub(super) struct LeftOut {
    pub(super) n_rows: usize,
    pub(super) n_agents: usize,
    rows: Bad,
    agents: Bad,
    findings: BTreeMap<&'static str, (u64, String)>,
}

/// The number of bad ones, and what is wrong with the first.
#[derive(Debug, Default)]
struct Bad(usize, Option<Reject>);

impl Bad {
    fn add(&mut self, reject: Reject) {
        self.0 += 1;
        self.1.get_or_insert(reject);
    }
}

impl LeftOut {
    /// Leaves out a row; `is_counted` unless another part of the table counts it.
    pub(super) fn row(&mut self, reject: Reject, is_counted: bool) {
        if is_counted {
            let what = match reject.reason {
                "implausible_positions" => "rows_out_of_place",
                _ => "rows_out_of_range",
            };
            self.note(what, 1, &reject.detail);
        }
        self.rows.add(reject);
    }

    /// Leaves out an agent.
    pub(super) fn agent(&mut self, reject: Reject, is_counted: bool) {
        if is_counted {
            let what = match reject.reason {
                "unknown_class" => "agents_of_unlisted_class",
                "missing_track" => "agents_missing_in_their_table",
                "duplicate_time" => "agents_at_two_places_at_one_time",
                "implausible_times" => "agents_with_rows_far_apart",
                _ => "agents_with_bad_values",
            };
            self.note(what, 1, &reject.detail);
        }
        self.agents.add(reject);
    }

    /// Counts `n` things that are no reason to leave anything out.
    pub(super) fn note(&mut self, what: &'static str, n: usize, detail: &str) {
        if n > 0 {
            self.findings.entry(what).or_insert_with(|| (0, detail.to_owned())).0 += n as u64;
        }
    }

    /// What was noted, or why the recording is rejected.
    pub(super) fn findings(self) -> Result<Vec<Finding>, Reject> {
        let Self { n_rows, n_agents, rows: Bad(n_bad_rows, row), agents: Bad(n_bad_agents, agent), findings } = self;
        let so_are = |reject: Reject, n_bad: usize, n: usize, what: &str| {
            let others = if n > 1 { format!("; {n_bad} of {n} {what} cannot be used") } else { String::new() };
            Err(Reject { detail: reject.detail + &others, ..reject })
        };
        match (agent, row) {
            (Some(reject), _) if 2 * n_bad_agents > n_agents => so_are(reject, n_bad_agents, n_agents, "agents"),
            (_, Some(reject)) if n_bad_rows as f64 > MAX_BAD_SHARE * n_rows as f64 => {
                so_are(reject, n_bad_rows, n_rows, "rows")
            }
            _ => Ok(findings.into_iter().map(|(what, (n, detail))| Finding { what, n, detail }).collect()),
        }
    }
}

//! The report of an export: what was written, and what was left out.

use super::{EgoMotion, ExportFormat, Selection, Written};
use crate::scenario::EgoChoice;
use serde::Serialize;
use std::collections::BTreeMap;

/// Things that were left out for one reason.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize)]
pub struct LeftOut {
    /// The number.
    pub count: u64,
    /// The first one.
    pub first: String,
}

/// The outcome of an export; its JSON form is `export.json`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct ExportReport {
    /// Version of this report.
    pub schema: &'static str,
    /// The format.
    pub format: ExportFormat,
    /// The selection.
    pub selection: Selection,
    /// Which track is the ego.
    pub ego: EgoChoice,
    /// How the ego moves.
    pub ego_motion: EgoMotion,
    /// Number of scenarios written.
    pub n_scenarios: u64,
    /// Number of tracks written.
    pub n_tracks: u64,
    /// Scenarios that the format cannot represent, by reason.
    pub scenarios_left_out: BTreeMap<&'static str, LeftOut>,
    /// Tracks of written scenarios that are not in the files, by reason.
    pub tracks_left_out: BTreeMap<&'static str, LeftOut>,
    /// Counts of values that the format requires and scenarios lack, or that the format cannot represent.
    pub assumed: BTreeMap<&'static str, u64>,
    /// Dataset → license and citation, which apply to the export.
    pub sources: BTreeMap<String, String>,
}

impl ExportReport {
    pub(super) fn new(format: ExportFormat, selection: &Selection, ego: &EgoChoice, ego_motion: EgoMotion) -> Self {
        Self {
            schema: "export.v1",
            format,
            selection: selection.clone(),
            ego: ego.clone(),
            ego_motion,
            n_scenarios: 0,
            n_tracks: 0,
            scenarios_left_out: BTreeMap::new(),
            tracks_left_out: BTreeMap::new(),
            assumed: BTreeMap::new(),
            sources: BTreeMap::new(),
        }
    }

    pub(super) fn count_written(&mut self, scenario_id: &str, written: &Written) {
        self.n_scenarios += 1;
        for (agent_idx, track) in written.tracks.iter().enumerate() {
            match track {
                Ok(_) => self.n_tracks += 1,
                Err(reason) => {
                    count(&mut self.tracks_left_out, reason, || format!("{scenario_id}, track number {agent_idx}"));
                }
            }
        }
        written.assumed.iter().for_each(|(what, n)| self.count_assumed(what, *n));
    }

    pub(super) fn count_assumed(&mut self, what: &'static str, n: u64) {
        if n > 0 {
            *self.assumed.entry(what).or_default() += n;
        }
    }

    pub(super) fn count_left_out(&mut self, scenario_id: &str, reason: &'static str) {
        count(&mut self.scenarios_left_out, reason, || scenario_id.to_owned());
    }

    /// Number of scenarios that the format cannot represent.
    pub fn n_left_out(&self) -> u64 {
        self.scenarios_left_out.values().map(|left_out| left_out.count).sum()
    }

    /// The warnings, a sentence each.
    pub fn warnings(&self) -> Vec<String> {
        let lines = |what: &str, left_out: &BTreeMap<&'static str, LeftOut>| -> Vec<String> {
            let line = |(reason, LeftOut { count, first }): (&&str, &LeftOut)| {
                format!("{count} {what} left out: {}; the first: {first}", meaning(reason))
            };
            left_out.iter().map(line).collect()
        };
        let assumed = self.assumed.iter().map(|(what, n)| format!("{}: {n} in all", meaning(what)));
        [lines("scenarios", &self.scenarios_left_out), lines("tracks", &self.tracks_left_out), assumed.collect()]
            .concat()
    }
}

fn count(counts: &mut BTreeMap<&'static str, LeftOut>, reason: &'static str, first: impl FnOnce() -> String) {
    let entry = counts.entry(reason).or_insert_with(|| LeftOut { count: 0, first: first() });
    entry.count += 1;
}

/// The meaning of a code of a reason or of an assumption.
pub(super) fn meaning(code: &str) -> &str {
    match code {
        "no_lanes" => "the scenario has no lanes, which the format requires (no_lanes)",
        "no_future" => "the scenario ends at the present (no_future)",
        "no_ego" => "the ego has no state at present (no_ego)",
        "no_such_track" => "it has no track of that name, which was to be the ego (no_such_track)",
        "no_subject" => {
            "a scenario shows no event that happens to somebody; its ego is the center of the recorded window \
             (no_subject)"
        }
        "not_10_hz" => "the format requires 10 Hz, which the scenario does not have (not_10_hz)",
        "no_states" => "the track has no state in the format's time window (no_states)",
        "static_object" => "the format has no class for static objects (static_object)",
        "absent_at_present" => "the format starts at the present, where the track has no state (absent_at_present)",
        "ends_at_present" => "the track ends at the present, where the format starts (ends_at_present)",
        "ego_is_free" => "the ego is left to the driving function under test (ego_is_free)",
        "nominal_size" => {
            "the size of a road user is not recorded; a typical one for its class is written (nominal_size)"
        }
        "nominal_lane_width" => "a lane without boundaries is given a width of 3.8 m (nominal_lane_width)",
        "lane_without_extent" => "a lane of no length is left out (lane_without_extent)",
        "states_after_gap" => "states after a gap in a track are left out (states_after_gap)",
        "split_at_gap" => "a track with a gap becomes two entities (split_at_gap)",
        "cut_to_window" => "timesteps beyond the 40 of a case are left out (cut_to_window)",
        "renumbered_track" => "a track is renamed, because the format requires numbers (renumbered_track)",
        other => other,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_written_and_assumed_is_counted() {
        let selection = Selection::default();
        let mut report = ExportReport::new(ExportFormat::Womd, &selection, &EgoChoice::Scene, EgoMotion::Replayed);
        let notice = crate::export::notice::text(&report);
        assert!(notice.ends_with("\n\nNothing.\n"), "{notice}");
        report.count_left_out("0a", "no_ego");
        assert!(!crate::export::notice::text(&report).contains("Nothing."));
        for (what, n) in [("no_subject", 0), ("nominal_size", 12), ("nominal_size", 3)] {
            report.count_assumed(what, n);
        }
        assert_eq!(report.assumed, BTreeMap::from([("nominal_size", 15)]));
        let notice = crate::export::notice::text(&report);
        let told = "\n\n1 scenarios left out: the ego has no state at present (no_ego).\nthe size of a road user is not \
                    recorded; a typical one for its class is written (nominal_size): 15\n  in all.\n";
        assert!(notice.ends_with(told), "{notice}");
    }
}

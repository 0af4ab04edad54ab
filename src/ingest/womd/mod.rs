//! Waymo Open Motion: `Scenario` protos, some hundred of them in a TFRecord.
//!
//! Records are read one after the other, and each is a unit. The ego is the vehicle that recorded them; those without
//! it are rejected.

mod crosswalks;
mod map;
pub(crate) mod messages;
#[cfg(test)]
mod tests;
mod tfrecord;
mod tracks;

pub(crate) use self::map::{LANE_TYPES, LIGHTS, LINE_TYPES, MPS_PER_MPH};

use self::messages::Scenario;
use self::tfrecord::{Records, framed};
use super::archive::Entry;
use super::config::IngestConfig;
use super::error::Error;
use super::files::{file_name, split_of_entry};
use super::raw::{Finding, RawScene, RawUnit, Reject, UnitSplit, map_id};
use super::source::{EmitUnit, Horizon, PendingScene, RecordingSource, UnitReader};
use crate::scene::{AgentClass, Dataset, SceneId, Split, Track, TrackRole};
use prost::Message;
use std::io::BufRead;
use std::ops::{ControlFlow, Range};
use std::sync::Arc;

/// The length of recordings: 1.1 s of past and 8 s of future at 10 Hz.
const RECORDED: Horizon = Horizon { n_history: 11, n_future: 80 };
const DT_S: f64 = 0.1;
/// The largest distance of a timestamp from an even one, seconds, and one that published scenarios do not reach.
const MAX_UNEVEN_S: f64 = 0.05;
const USUAL_UNEVEN_S: f64 = 0.025;

pub(crate) fn record(scenario: &Scenario) -> Vec<u8> {
    framed(&scenario.encode_to_vec())
}

/// The format of Waymo Open Motion.
pub(super) struct Womd<'a> {
    config: &'a IngestConfig,
    horizon: Horizon,
}

impl<'a> Womd<'a> {
    pub(super) fn new(config: &'a IngestConfig) -> Result<Self, Error> {
        Ok(Self { config, horizon: Horizon::within(config, RECORDED)? })
    }

    fn scene(&self, unit: &RawUnit) -> Result<RawScene, Reject> {
        let reject = |reason, detail: String| unit.reject(reason, format!("{}: {detail}", unit.case_id));
        let mut scenario = Scenario::decode(unit.bytes.as_slice()).map_err(|error| match unit.bytes.first() {
            // Its features come first, which no scenario has in such a field.
            Some(0x0a) => reject("not_a_scenario", "is a tf.Example; the files of `scenario` are read".to_owned()),
            _ => reject("not_a_scenario", error.to_string()),
        })?;
        let split = unit.split.of_scene();
        if scenario.scenario_id.trim().is_empty() || scenario.tracks.is_empty() {
            let detail = "has no scenario_id or no tracks; files of lidar and camera features alone have none";
            return Err(reject("not_a_scenario", detail.to_owned()));
        }
        let steps = self.timesteps(&scenario, split).map_err(|(reason, detail)| reject(reason, detail))?;
        let (tracks, mut findings) = tracks::read(&scenario, &steps, self.horizon.n_history);
        let is_ego = |track: &&Track| track.role == TrackRole::Recorder && track.class == AgentClass::Vehicle;
        let states = tracks.iter().find(is_ego).map(|track| &track.trajectory);
        let Some(states) = states.filter(|states| states.is_valid(self.horizon.n_history.saturating_sub(1))) else {
            let found = scenario.sdc_track_index.map_or("missing".to_owned(), |index| index.to_string());
            let detail = "expected that of the vehicle that records, which is there at present";
            return Err(reject("no_recorder", format!("sdc_track_index is {found}, {detail}")));
        };
        if states.n_valid() < steps.len() {
            let detail = format!("the recorder is there at {} of {} timesteps", states.n_valid(), steps.len());
            findings.push(Finding { what: "recorders_absent_at_times", n: 1, detail });
        }
        if let Some(detail) = uneven(&scenario, &steps, USUAL_UNEVEN_S) {
            findings.push(Finding { what: "uneven_times", n: 1, detail: format!("{detail}; taken as that") });
        }
        let map = self.config.wants_maps().then(|| map::read(&mut scenario, steps.start));
        let at = format!("{}: {}", unit.file, unit.case_id);
        findings.iter_mut().for_each(|finding| finding.detail = format!("{at}: {}", finding.detail));
        findings.extend(map.iter().flat_map(|(_, report)| report.findings(&at)));
        let own_map = map.map(|(graph, _)| graph).filter(|graph| !graph.is_empty());
        let (dataset, id) = (Dataset::Womd, scenario.scenario_id);
        // The sets of long and of interactive scenarios have some that are in others, too.
        let of_set = if unit.version.is_empty() { String::new() } else { format!("@{}", unit.version) };
        Ok(RawScene {
            id: SceneId(format!("{}/{}//{id}{of_set}", dataset.name(), split.name())),
            map_id: map_id(dataset, &format!("{id}{of_set}")),
            source: unit.source(dataset, split, String::new(), id, steps.start.to_string()),
            dt_s: DT_S,
            n_timesteps: steps.len(),
            n_history: self.horizon.n_history,
            tracks,
            heading_gaps: Vec::new(),
            own_map: own_map.map(Arc::new),
            findings,
        })
    }

    /// The timesteps of the scene among those of the scenario, or why it has none: reason and detail. Those of test
    /// files end at the present.
    fn timesteps(&self, scenario: &Scenario, split: Split) -> Result<Range<usize>, (&'static str, String)> {
        let Horizon { n_history, n_future } = self.horizon;
        let times_s = &scenario.timestamps_seconds;
        let n_states = scenario.tracks.iter().map(|track| track.states.len()).max().unwrap_or_default();
        let n_recorded = n_states.min(times_s.len());
        let present = scenario.current_time_index.and_then(|index| usize::try_from(index).ok());
        let Some(end) = present.map(|present| present + 1).filter(|end| *end <= n_recorded) else {
            let found = scenario.current_time_index.map_or("missing".to_owned(), |index| index.to_string());
            let detail = format!("current_time_index is {found}, expected one of {n_recorded} timesteps");
            return Err(("wrong_timestamp_count", detail));
        };
        let is_cut = end == n_recorded && matches!(split, Split::Test | Split::Unsplit);
        if end < n_history || (end + n_future > n_recorded && !is_cut) {
            let (n_after, expected) = (n_recorded - end, format!("{n_history} and {n_future}"));
            let detail = format!(
                "has {end} timesteps up to the present and {n_after} after it, expected {expected}: set \
                 ingest.n_history and ingest.n_future for shorter scenes"
            );
            return Err(("wrong_timestamp_count", detail));
        }
        let steps = end - n_history..n_recorded.min(end + n_future);
        match uneven(scenario, &steps, MAX_UNEVEN_S) {
            Some(detail) => Err(("uneven_times", detail)),
            None => Ok(steps),
        }
    }
}

/// The first of these timesteps that is further than this from an even time, in words.
fn uneven(Scenario { timestamps_seconds: times_s, .. }: &Scenario, steps: &Range<usize>, max_s: f64) -> Option<String> {
    let is_even = |step: &usize| (times_s[*step] - times_s[0] - *step as f64 * DT_S).abs() <= max_s;
    let step = steps.clone().find(|step| !is_even(step))?;
    let after_s = times_s[step] - times_s[0];
    Some(format!("timestep {step} is {after_s:.3} s after the first, expected 10 Hz"))
}

impl RecordingSource for Womd<'_> {
    fn horizon(&self) -> Horizon {
        self.horizon
    }

    fn is_recording(&self, path: &str) -> bool {
        let is_wanted = |(split, _)| self.config.wants_split(split);
        file_name(path).contains(".tfrecord") && set_of(path).is_none_or(is_wanted)
    }

    fn pattern(&self) -> &'static str {
        "*.tfrecord*"
    }

    fn unit_reader(&self) -> Box<dyn UnitReader + '_> {
        Box::new(Shards)
    }

    fn parse(&self, unit: RawUnit) -> Vec<PendingScene<'_>> {
        vec![Box::new(move || self.scene(&unit))]
    }

    fn n_bytes_parsed(&self, unit: &RawUnit) -> u64 {
        // The record, and the three lines of each of its lanes.
        unit.n_bytes() * 4
    }

    fn has_own_maps(&self) -> bool {
        true
    }
}

/// Cuts files into records.
struct Shards;

impl UnitReader for Shards {
    fn read(
        &mut self,
        entry: &Entry,
        reader: &mut dyn BufRead,
        emit: &mut EmitUnit<'_>,
    ) -> Result<ControlFlow<()>, Error> {
        let (split, version) = set_of(&entry.path).unwrap_or_else(|| (split_of_entry(entry), ""));
        let whole = RawUnit {
            file: entry.path.clone(),
            container: entry.container.clone(),
            version,
            split: UnitSplit::All(split),
            ..RawUnit::default()
        };
        let mut is_empty = true;
        for (offset, record) in Records::new(reader) {
            is_empty = false;
            let case_id = format!("record at byte {offset}");
            let unit = match record {
                Ok(bytes) => Ok(RawUnit { case_id, bytes, ..whole.clone() }),
                Err((reason, detail)) => Err(whole.reject(reason, format!("{case_id}: {detail}"))),
            };
            if emit(unit).is_break() {
                return Ok(ControlFlow::Break(()));
            }
        }
        Ok(if is_empty { emit(Err(whole.reject("no_records", "is empty"))) } else { ControlFlow::Continue(()) })
    }
}

/// The split and the set, if it is not the usual one, that a path names in the dataset's own way: by its file, as in
/// `uncompressed_scenario_validation_interactive_validation_interactive.tfrecord-00000-of-00150`, or a folder.
fn set_of(path: &str) -> Option<(Split, &'static str)> {
    const SPLITS: [(&str, Split); 3] =
        [("training", Split::Train), ("validation", Split::Val), ("testing", Split::Test)];
    const SETS: [(&str, &str); 3] = [("_20s", "20s"), ("_interactive", "interactive"), ("", "")];
    let of_name = |name: &str| {
        let name = name.split_once(".tfrecord").map_or(name, |(stem, _)| stem);
        let (name, set) = SETS.iter().find_map(|(suffix, set)| Some((name.strip_suffix(suffix)?, *set)))?;
        let is_split = |word: &str| name == word || name.ends_with(&format!("_{word}"));
        SPLITS.into_iter().find(|(word, _)| is_split(word)).map(|(_, split)| (split, set))
    };
    path.rsplit('/').find_map(of_name)
}

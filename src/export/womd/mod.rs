//! Waymo Open Motion: scenarios as the dataset's own protos, in a TFRecord for each split.

mod map;
#[cfg(test)]
mod tests;

use super::{Error, ExportOutcome, Exporter, Item, Result, Written};
use crate::ingest::womd::messages::{
    DynamicMapState, ObjectState, RequiredPrediction, Scenario, Track as TrackMessage,
};
use crate::ingest::womd::record;
use crate::scene::{AgentClass, INGESTED_DT_S, Scene, Split, State, Track, TrackRole};
use crate::store::AtomicFile;
use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::io::Write;
use std::path::{Path, PathBuf};

pub(super) const NOTES: &str = "<split>.tfrecord-00000-of-00001: Scenario protos as in the scenario files of Waymo \
    Open Motion, one a scenario, with as many timesteps as it has: 91 only if 11 were observed and 80 follow. \
    sdc_track_index is the ego; tracks_to_predict and objects_of_interest are the agents of the event, or else those \
    that the recording marks. Heights are 0. Maps hold the lanes near the scenario with their boundaries, lights, stop \
    signs (which stand at the beginning of their lanes) and crosswalks, and no driveways or speed bumps.";

/// Writes a file for each split.
pub(super) struct Womd {
    dir: PathBuf,
    files: BTreeMap<Split, AtomicFile>,
}

impl Womd {
    pub(super) fn new(dir: &Path) -> Self {
        Self { dir: dir.to_owned(), files: BTreeMap::new() }
    }
}

impl Exporter for Womd {
    fn add(&mut self, item: &Item<'_>) -> Result<ExportOutcome> {
        let scene = item.scene();
        if (scene.dt_s - INGESTED_DT_S).abs() > 1e-6 {
            return Ok(ExportOutcome::LeftOut("not_10_hz"));
        }
        if scene.state(item.ego_idx, scene.current_timestep()).is_none() {
            return Ok(ExportOutcome::LeftOut("no_ego"));
        }
        let written: Vec<usize> =
            (0..scene.tracks.len()).filter(|i| scene.tracks[*i].trajectory.n_valid() > 0).collect();
        let ids = ids(scene);
        let index =
            |agent_idx: usize| written.iter().position(|other| *other == agent_idx).and_then(|i| i32::try_from(i).ok());
        let predicted = predicted(item);
        let (map_features, mut assumed) = map::features(scene);
        let scenario = Scenario {
            timestamps_seconds: (0..scene.n_timesteps).map(|timestep| timestep as f64 * INGESTED_DT_S).collect(),
            tracks: written.iter().map(|agent_idx| track(item, *agent_idx, ids[*agent_idx])).collect(),
            objects_of_interest: predicted.iter().map(|agent_idx| ids[*agent_idx]).collect(),
            scenario_id: item.stem.clone(),
            sdc_track_index: index(item.ego_idx),
            dynamic_map_states: (0..scene.n_timesteps)
                .map(|t| DynamicMapState { lane_states: map::lights(scene, t) })
                .collect(),
            map_features,
            current_time_index: i32::try_from(scene.current_timestep()).ok(),
            tracks_to_predict: predicted
                .iter()
                .filter_map(|i| index(*i))
                .map(|track_index| RequiredPrediction { track_index })
                .collect(),
        };
        let file = file_name(scene.source.split);
        let out = match self.files.entry(scene.source.split) {
            Entry::Occupied(open) => open.into_mut(),
            Entry::Vacant(new) => new.insert(AtomicFile::create(&self.dir.join(&file))?),
        };
        out.write_all(&record(&scenario)).map_err(Error::Io)?;
        let name = |(track, id): (&Track, &i32)| match track.trajectory.n_valid() {
            0 => Err("no_states"),
            _ => Ok(id.to_string()),
        };
        let tracks = || scene.tracks.iter().zip(&ids);
        let n_nominal = written.iter().filter(|i| scene.tracks[**i].extent.is_none()).count() as u64;
        let n_renumbered = tracks().filter(|(track, id)| track.id.0 != id.to_string()).count() as u64;
        assumed.extend([("nominal_size", n_nominal), ("renumbered_track", n_renumbered)]);
        let name_of_scenario = scenario.scenario_id;
        Ok(ExportOutcome::Written(Written {
            file,
            name: name_of_scenario,
            first_timestep: 0,
            tracks: tracks().map(name).collect(),
            assumed,
        }))
    }

    fn finish(self: Box<Self>) -> Result<()> {
        self.files.into_values().try_for_each(|file| file.commit().map(|_| ()).map_err(Error::Io))
    }
}

/// As the dataset calls its files.
fn file_name(split: Split) -> String {
    let name = match split {
        Split::Train => "training",
        Split::Val => "validation",
        Split::Test => "testing",
        Split::Unsplit => "scenarios",
    };
    format!("{name}.tfrecord-00000-of-00001")
}

/// The ids of the tracks: their own if all are different numbers, else consecutive numbers.
fn ids(scene: &Scene) -> Vec<i32> {
    let own: Option<Vec<i32>> = scene.tracks.iter().map(|track| track.id.0.parse().ok()).collect();
    let mut distinct = own.clone().unwrap_or_default();
    distinct.sort_unstable();
    distinct.dedup();
    own.filter(|own| own.len() == distinct.len()).unwrap_or_else(|| (1..).take(scene.tracks.len()).collect())
}

/// The agents of the event, or else those that the recording marks, as far as they are there at present.
fn predicted(item: &Item<'_>) -> Vec<usize> {
    let scene = item.scene();
    let is_there = |i: &usize| scene.state(*i, scene.current_timestep()).is_some();
    let all = || (0..scene.tracks.len()).filter(is_there);
    let of_event: Vec<usize> = all().filter(|i| item.event_role(*i).is_some()).collect();
    if !of_event.is_empty() {
        return of_event;
    }
    all().filter(|i| matches!(scene.tracks[*i].role, TrackRole::Focal | TrackRole::Scored)).collect()
}

fn track(item: &Item<'_>, agent_idx: usize, id: i32) -> TrackMessage {
    let track = &item.scene().tracks[agent_idx];
    let extent = track.extent_or_nominal();
    let of = |State { position, heading_rad, velocity }: State| ObjectState {
        center_x: position.x,
        center_y: position.y,
        length: extent.length_m as f32,
        width: extent.width_m as f32,
        heading: heading_rad as f32,
        velocity_x: velocity.x as f32,
        velocity_y: velocity.y as f32,
        valid: true,
    };
    let states = item.world_states(agent_idx).into_iter().map(|state| state.map(of).unwrap_or_default()).collect();
    TrackMessage { id, object_type: object_type(item.scene(), track), states }
}

/// `Track.ObjectType`: buses and motorcycles are vehicles, and so is everybody in datasets without classes.
const fn object_type(scene: &Scene, track: &Track) -> i32 {
    match track.class {
        AgentClass::Vehicle | AgentClass::Bus | AgentClass::Motorcyclist => 1,
        AgentClass::Unknown if !scene.source.dataset.facts().has_classes => 1,
        AgentClass::Pedestrian | AgentClass::PedestrianOrCyclist => 2,
        AgentClass::Cyclist => 3,
        AgentClass::Static | AgentClass::Unknown => 4,
    }
}

//! Scores planned trajectories in an open loop: all other agents move as in the scenario, whatever the ego does.

use super::output::{DRIVE_FILE, DRIVES_FILE, row};
use super::report::DriveReport;
use super::{EgoDriver, Error, Result};
use crate::export::Selection;
use crate::files::NewFolder;
use crate::generate::NamedDriver;
use crate::metrics::CarefulReplay;
use crate::progress::Progress;
use crate::scenario::{DriveRow, EgoChoice, ScenarioRecord};
use crate::scene::{Scene, State, Track, TrackId};
use crate::simulate::{
    self, Careful, Driven, Driver, Failed, Log, Maps, Others, Outcome, RolloutConfig, Situation, World, moved, named,
    roll_out,
};
use crate::store::{CorpusReader, Planned, read_planned, write_drives, write_json_atomically};
use rayon::prelude::*;
use std::collections::VecDeque;
use std::path::Path;

/// Scenarios in memory at a time.
const CHUNK: usize = 64;
/// The names in tables of the planned trajectories, of the scenario's ego and of the recording.
const PLANNED: &str = "planner";
const SCENARIO: &str = "scenario";
const RECORDED: &str = "recorded";

/// Scores the trajectories in `planned` for scenarios of the corpus in `corpus`, and writes the table of drives and the
/// report into the folder `out`, which must be new or empty. Beside each it scores the careful driver, who answers to
/// the others as they are, an ego at constant velocity, the ego of the scenario, and the recording.
///
/// # Errors
/// [`Error::Config`] when the file has other scenarios than the corpus; errors of the corpus, the file and the folder.
pub fn score(
    (corpus, planned, out): (&Path, &Path, &Path),
    selection: &Selection,
    ego: &EgoChoice,
    progress: &dyn Progress,
) -> Result<DriveReport> {
    let reader = CorpusReader::open(corpus)?;
    let planned_by = read_planned(planned)?;
    let known: std::collections::BTreeSet<&str> = reader.scenario_ids()?.collect();
    if let Some(foreign) = planned_by.keys().find(|id| !known.contains(id.as_str())) {
        let (path, corpus) = (planned.display(), corpus.display());
        return Err(Error::Config(format!("{path} has scenario {foreign}, which is not in the corpus {corpus}")));
    }
    let folder = NewFolder::begin(out, [("corpus", corpus), ("planned states", planned)])?;
    let mut report = DriveReport::new(&EgoDriver::External(planned.display().to_string()), None, 0, "");
    let positions = selection.positions(&reader)?;
    let (mut rows, mut maps) = (Vec::new(), Maps::new(&reader, &reader));
    progress.start("score", positions.len() as u64, "scenarios");
    for positions in positions.chunks(CHUNK) {
        let mut chunk = Vec::new();
        for position in positions {
            let record = reader.scenario(*position)?;
            if !selection.wants(&record) {
                continue;
            }
            let Some(states) = planned_by.get(&record.scenario.id) else {
                *report.left_out.entry("has no planned states".to_owned()).or_default() += 1;
                continue;
            };
            match maps.situation(&record, ego) {
                Ok(situation) => chunk.push((recorded(&record, ego, &reader, &mut maps)?, situation, states)),
                Err(simulate::Error::Unfit { why, .. }) => *report.left_out.entry(why).or_default() += 1,
                Err(error) => return Err(error.into()),
            }
        }
        let all = chunk.par_iter().map(|(recorded, situation, states)| drives(recorded.as_ref(), situation, states));
        let all = all.collect::<Result<Vec<_>>>()?;
        for ((_, situation, _), drives) in chunk.iter().zip(all) {
            let careful_survives = Some(drives[1].1.outcome == Outcome::Survived);
            for (name, driven) in &drives {
                report.count(name, driven);
                rows.push(row(situation, name, driven, careful_survives));
            }
        }
        progress.advance(positions.len() as u64);
    }
    progress.finish();
    if rows.is_empty() {
        let (n_scenarios, wanted) = (reader.len(), format!("{} and has planned states", selection.words()));
        return Err(Error::NothingSelected { corpus: corpus.to_owned(), n_scenarios, wanted });
    }
    let own = || rows.iter().filter(|row| row.driver == PLANNED);
    if own().all(|row| row.outcome == Outcome::PlannerFailed.name()) {
        let why = own().find_map(|row| Some(format!("{}: {}", row.scenario_id, row.why.as_deref()?)));
        let (path, n) = (planned.display(), own().count());
        let why = why.unwrap_or_default();
        return Err(Error::Config(format!("{path}: none of the {n} plans can be driven; the first, of {why}")));
    }
    finish(&folder, &mut report, &rows)?;
    folder.commit()?;
    Ok(report)
}

fn finish(folder: &NewFolder, report: &mut DriveReport, rows: &[DriveRow]) -> Result<()> {
    write_drives(&folder.path().join(DRIVES_FILE), rows)?;
    report.finish(rows, PLANNED);
    write_json_atomically(&folder.path().join(DRIVE_FILE), report)?;
    Ok(())
}

/// The drive of a driver to the end of the scenario, with all others moving as in it.
fn replayed(situation: &Situation, driver: &mut dyn Driver) -> Result<Driven> {
    let scene = &situation.scene;
    let horizon_s = (scene.n_timesteps - scene.n_history) as f64 * scene.dt_s;
    let config = RolloutConfig { horizon_s, replan_s: horizon_s };
    Ok(roll_out(situation, situation.start(0), driver, &Others::Replayed, &config, None)?)
}

/// The drives of a scenario, by their names in tables: with the planned states first, then with the careful driver.
fn drives(
    recorded: Option<&Situation>,
    situation: &Situation,
    states: &Planned,
) -> Result<Vec<(&'static str, Driven)>> {
    let steady = NamedDriver::ConstantVelocity;
    let mut drives = vec![
        (PLANNED, replayed(situation, &mut Plan { states, judged: VecDeque::new() })?),
        (NamedDriver::Careful.name(), careful(situation)?),
        (steady.name(), replayed(situation, named(steady).as_mut())?),
        (SCENARIO, replayed(situation, &mut Log)?),
    ];
    if let Some(recorded) = recorded {
        drives.push((RECORDED, replayed(recorded, &mut Log)?));
    }
    Ok(drives)
}

/// The drive of the careful driver. Whether it survives is what the corpus says, too ([`CarefulReplay`]): whoever hits
/// its rear does not answer here, and what must happen right after the end of the scenario counts.
fn careful(situation: &Situation) -> Result<Driven> {
    let driven = replayed(situation, &mut Careful::default())?;
    let contact = CarefulReplay::of(&situation.scene, situation.ego_idx).and_then(|replay| replay.contact());
    let is_hit = driven.outcome == Outcome::Hit;
    Ok(match contact {
        None if is_hit => {
            let why = driven.why.map(|why| format!("{why}, by who does not answer"));
            Driven { outcome: Outcome::Survived, why, ..driven }
        }
        Some((time_s, agent_idx)) if !is_hit => {
            let track = &situation.scene.tracks[agent_idx].id;
            let why = Some(format!("touches track {track} {time_s:.1} s after the present if all go on"));
            Driven { outcome: Outcome::Hit, why, ..driven }
        }
        _ => driven,
    })
}

/// The recorded scene in place of the scenario that continues it. `None` without a recorded future of the ego.
fn recorded(
    record: &ScenarioRecord,
    ego: &EgoChoice,
    reader: &CorpusReader,
    maps: &mut Maps<'_>,
) -> Result<Option<Situation>> {
    let scene = &record.scenario.scene;
    let Some(tracks) = reader.recorded_tracks(&scene.id, scene.n_timesteps)? else { return Ok(None) };
    let Some((ego_idx, _)) = ego.of(record) else { return Ok(None) };
    let Some(recorded_idx) = recorded_ego(&tracks, &scene.tracks[ego_idx].id) else { return Ok(None) };
    let mut record = record.clone();
    record.scenario.scene.tracks = tracks;
    record.scenario.scene.ego_idx = recorded_idx;
    match maps.situation(&record, &EgoChoice::Scene) {
        Ok(situation) => Ok(Some(situation)),
        Err(simulate::Error::Unfit { .. }) => Ok(None),
        Err(error) => Err(error.into()),
    }
}

/// The recorded track of the ego, if it lasts to the end.
fn recorded_ego(tracks: &[Track], id: &TrackId) -> Option<usize> {
    let lasts = |track: &Track| track.trajectory.entries().last().is_some_and(Option::is_some);
    tracks.iter().position(|track| track.id == *id && lasts(track))
}

/// The driver that follows planned states.
struct Plan<'a> {
    states: &'a Planned,
    /// Those of a motion that a vehicle can do, in the frame of the scene.
    judged: VecDeque<State>,
}

impl Driver for Plan<'_> {
    /// Judges the whole plan before any of it is driven.
    fn begin(&mut self, situation: &Situation, world: &World) -> Result<(), Failed> {
        let Scene { n_history, n_timesteps, dt_s, world_from_scene, tracks, .. } = &situation.scene;
        let wanted = *n_history..*n_timesteps;
        if let Some(missing) = wanted.clone().find(|timestep| !self.states.contains_key(timestep)) {
            let from = |first: &usize| *first < *n_history && self.states.len() <= wanted.len();
            let first = self.states.keys().next().filter(|first| from(first));
            let counted = first.map_or_else(String::new, |first| {
                format!("; they begin at {first}, but timesteps count from the beginning of the past")
            });
            return Err(Failed::because(format!(
                "there is no planned state at timestep {missing}, expected {n_history} to {}{counted}",
                n_timesteps - 1
            )));
        }
        let mut before = world.present(situation.ego_idx).unwrap_or_default();
        let sizes = (tracks[situation.ego_idx].extent_or_nominal().length_m, *dt_s);
        let next = |timestep: usize| {
            let state = moved(&before, self.states[&timestep], world_from_scene, sizes);
            before = state.map_err(|why| Failed::because(format!("planned state at timestep {timestep}: {why}")))?;
            Ok(before)
        };
        self.judged = wanted.map(next).collect::<Result<_, Failed>>()?;
        Ok(())
    }

    fn next(&mut self, _situation: &Situation, _world: &World, _sampled: Option<State>) -> Result<State, Failed> {
        self.judged.pop_front().ok_or_else(|| Failed::because("the plan is too short"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::testing::without_states;
    use crate::simulate::testing::{records, situation};

    #[test]
    fn a_recording_that_ends_before_the_scenario_is_not_driven() {
        let scene = records().remove(0).scenario.scene;
        let id = scene.ego().id.clone();
        assert_eq!(recorded_ego(&scene.tracks, &id), Some(scene.ego_idx));
        let (ego_idx, last) = (scene.ego_idx, scene.n_timesteps - 1);
        let ending = without_states(scene, ego_idx, |timestep| timestep == last);
        assert_eq!(recorded_ego(&ending.tracks, &id), None);
    }

    #[test]
    fn the_careful_driver_survives_what_the_corpus_calls_preventable() {
        for record in records() {
            let (situation, scene) = (situation(&record), &record.scenario.scene);
            let expected = CarefulReplay::of(scene, situation.ego_idx).unwrap().judgment(None);
            let driven = replayed(&situation, &mut Log).unwrap();
            assert_eq!((driven.outcome, driven.world.n_timesteps()), (Outcome::Survived, scene.n_timesteps));
            let driven = careful(&situation).unwrap();
            assert_eq!(
                driven.outcome == Outcome::Survived,
                expected.preventable,
                "{}: {:?}",
                record.scenario.id,
                driven.why
            );
            let found = record.assessment.as_ref().unwrap().careful.unwrap();
            assert_eq!((found.preventable, found.braking_from_s), (expected.preventable, expected.braking_from_s));
        }
    }
}

//! Lets the scenarios of a sweep go on in closed loops.
//!
//! The first plan of everybody is the sample itself; if it is driven to the end, nothing changes, but that the ego
//! `log` answers to events that guidance has brought about. Nothing ends the drive while the sample lasts, so that
//! scenarios and recordings are compared over the same time.

use super::drivers::named;
use super::maps::Maps;
use super::rollout::{Others, roll_out};
use super::workers::{CHUNK, in_parallel, pool_of_worker};
use super::{Driven, Error, Outcome, Result, RolloutConfig, Situation};
use crate::behavior::Behavior;
use crate::generate::{
    self, Futures, NamedDriver, RejectedSample, Rejection, ShardOutput, SweepRollout, requested_events,
};
use crate::metrics::{DELAY_S, WANDERING_M};
use crate::progress::Progress;
use crate::scenario::{EgoChoice, ScenarioRecord};
use crate::scene::{ObservationMask, Scene, Trajectory};
use crate::store::{SceneStore, as_stored};
use std::sync::Arc;

/// The ego answers with the delay of UN R157's careful driver, whose 0.4 s of perception are left out, after the event
/// begins or somebody has come closer to its way than by wandering; and no sooner than this after it begins, seconds.
const SOONEST_S: f64 = 0.3;

/// Drives on the scenarios of a shard that show the requested behavior, or all if none is requested; arrivals are those
/// of places in `store`. A scenario whose ego has no way stays as it is, and one without a future is rejected.
///
/// # Errors
/// When the model does not fit, the device fails or the store is damaged; [`generate::Error::Stopped`] when the process
/// must stop between scenarios.
pub fn roll_out_samples(
    output: &mut ShardOutput,
    config: &SweepRollout,
    behavior: Option<&dyn Behavior>,
    futures: &Futures<'_>,
    store: &SceneStore,
    progress: &dyn Progress,
) -> Result<()> {
    let own = RolloutConfig { horizon_s: config.horizon_s, replan_s: config.replan_s };
    own.check(futures)?;
    let mut workers = (0..rayon::current_num_threads()).map(|_| pool_of_worker()).collect::<Result<Vec<_>>>()?;
    let mut maps = Maps::new(store, store);
    let is_wanted = |record: &ScenarioRecord| behavior.is_none() || record.verified;
    let (wanted, mut unfit) = (0..output.records.len()).partition::<Vec<_>, _>(|i| is_wanted(&output.records[*i]));
    let mut lost = Vec::new();
    for (n_done, chunk) in wanted.chunks(CHUNK * workers.len()).enumerate() {
        progress.note(&format!("{} of {} driven on", n_done * CHUNK * workers.len(), wanted.len()));
        if progress.must_stop() {
            return Err(generate::Error::Stopped.into());
        }
        let mut situations = Vec::new();
        for i in chunk {
            let mut situation = match maps.situation(&output.records[*i], &EgoChoice::Event) {
                Ok(situation) => situation,
                Err(Error::Unfit { .. }) => {
                    unfit.push(*i);
                    continue;
                }
                Err(error) => return Err(error),
            };
            // Others that the template has in it keep to it, too, such as a leader that brakes.
            let follows = |idx: &usize| {
                let later = situation.scene.tracks[*idx].trajectory.entries().get(futures.n_timesteps()..);
                later.is_some_and(|later| later.iter().any(Option::is_some))
            };
            let others = (0..situation.scene.tracks.len()).filter(|idx| *idx != situation.ego_idx).filter(follows);
            let others: Vec<usize> = others.filter(|idx| !situation.planned.contains(idx)).collect();
            situation.planned.extend(others);
            if config.ego == NamedDriver::Log {
                let until = answers_from(&output.records[*i], &situation);
                forget(&mut situation.scene, situation.ego_idx, until);
            }
            let [n_steps, _] = own.n_steps(situation.scene.dt_s);
            maps.expect_arrivals(&mut situation, futures.seed(), [n_steps, 0, n_steps])?;
            situations.push((*i, situation));
        }
        let driven = in_parallel(&situations, &mut workers, |pool, (_, situation)| {
            let others = Others::Continued(futures);
            let start = situation.start(futures.seed());
            pool.install(|| roll_out(situation, start, named(config.ego).as_mut(), &others, &own, None))
        })?;
        for ((i, situation), driven) in situations.iter().zip(driven) {
            match driven.outcome {
                Outcome::NotSampled | Outcome::PlannerFailed | Outcome::TimedOut => {
                    lost.push((*i, driven.why.unwrap_or_default()));
                }
                _ => continue_with(&mut output.records[*i], situation, &driven, (config, &own), behavior),
            }
        }
    }
    // The maneuver of a template needs the closed loop for its end.
    unfit.into_iter().for_each(|i| end_with_sample(&mut output.records[i], futures.n_timesteps(), behavior));
    for (i, reason) in lost.into_iter().rev() {
        let record = output.records.remove(i);
        let provenance = record.scenario.provenance;
        output.rejected.push(RejectedSample {
            scene_id: provenance.scene_id,
            sweep: record.sweep,
            level: provenance.guidance.level,
            sample_idx: provenance.sample_idx,
            seed: provenance.seed,
            reason: Rejection::Unfit(reason),
        });
    }
    Ok(())
}

/// The timestep from which the ego of a sample without a template answers to what it did not see: guidance moves the
/// others, and the sample lets the ego drive on.
fn answers_from(record: &ScenarioRecord, situation: &Situation) -> usize {
    let event = record.events.first().filter(|_| !record.scenario.provenance.guidance.has_template());
    let Some(event) = event else { return usize::MAX };
    let scene = &situation.scene;
    // From the present on: before, the recorded driver has seen it.
    let comes_over = |agent_idx: &usize| {
        let track = &scene.tracks[*agent_idx];
        let mut farthest_m = f64::NEG_INFINITY;
        (scene.current_timestep()..scene.n_timesteps).find(|timestep| {
            let place = scene.state(*agent_idx, *timestep).and_then(|state| situation.way.place(track, state));
            let Some(offset_m) = place.map(|place| place.seen_from(0.0, 0.0, 0.0).offset_m) else { return false };
            farthest_m = farthest_m.max(offset_m);
            farthest_m - offset_m > WANDERING_M
        })
    };
    let began = situation.planned.iter().filter_map(comes_over).min();
    let [n_reacts, n_soonest] = [DELAY_S, SOONEST_S].map(|s| (s / scene.dt_s).round() as usize);
    let seen = began.map_or(event.start_timestep, |began| began.min(event.start_timestep));
    (seen + n_reacts).max(event.start_timestep + n_soonest)
}

/// Leaves out the states of an agent from a timestep on.
fn forget(scene: &mut Scene, agent_idx: usize, from: usize) {
    let trajectory = &mut scene.tracks[agent_idx].trajectory;
    let known = |(timestep, state): (usize, &Option<_>)| state.filter(|_| timestep < from);
    *trajectory = Trajectory::new(trajectory.entries().iter().enumerate().map(known).collect());
}

/// Leaves out what a template plans after the end of the sample.
fn end_with_sample(record: &mut ScenarioRecord, n_timesteps: usize, behavior: Option<&dyn Behavior>) {
    let scenario = &mut record.scenario;
    if scenario.scene.n_timesteps <= n_timesteps {
        return;
    }
    let is_observed = |agent_idx: usize, timestep: usize| scenario.observed.is_observed(agent_idx, timestep);
    let mask = ObservationMask::from_fn(scenario.scene.tracks.len(), n_timesteps, is_observed);
    (scenario.observed, scenario.scene) = (mask, scenario.scene.lasting(n_timesteps));
    if let Some(behavior) = behavior {
        let roles = &scenario.provenance.guidance.roles;
        (record.verified, record.events) = requested_events(behavior, roles, &scenario.scene);
    }
}

/// Makes the scenario what was driven.
fn continue_with(
    record: &mut ScenarioRecord,
    situation: &Situation,
    driven: &Driven,
    (config, own): (&SweepRollout, &RolloutConfig),
    behavior: Option<&dyn Behavior>,
) {
    let sampled = &record.scenario.scene;
    let [_, n_plan] = own.n_steps(sampled.dt_s);
    let n_followed = match config.ego {
        NamedDriver::Model => usize::MAX,
        NamedDriver::Log => {
            let known = situation.scene.tracks[situation.ego_idx].trajectory.valid().next_back();
            known.map_or(0, |(timestep, _)| timestep + 1)
        }
        _ => sampled.n_history,
    };
    let n_given = |agent_idx: usize| match agent_idx == situation.ego_idx {
        true => n_followed.min(sampled.n_history + n_plan),
        false => sampled.n_history + n_plan,
    };
    let mut scene = situation.driven(&driven.world);
    for (agent_idx, track) in scene.tracks.iter_mut().enumerate() {
        // The states of the sample stay as they are, velocities included.
        let entry = |(timestep, state): (usize, &Option<_>)| match timestep < n_given(agent_idx) {
            true if agent_idx == situation.ego_idx => sampled.state(agent_idx, timestep).copied(),
            true => driven.world.state(agent_idx, timestep),
            false => *state,
        };
        track.trajectory = Trajectory::new(track.trajectory.entries().iter().enumerate().map(entry).collect());
    }
    let n_before = sampled.tracks.len();
    let mut idx = 0;
    scene.tracks.retain(|track| {
        idx += 1;
        idx <= n_before || track.trajectory.valid().next().is_some()
    });
    let lanes = situation.lanes_along(sampled, &scene, sampled.n_history + n_plan);
    let scene = Scene { lanes: lanes.unwrap_or_else(|| Arc::clone(&sampled.lanes)), ego_idx: sampled.ego_idx, ..scene };
    let observed = &record.scenario.observed;
    let mask = ObservationMask::from_fn(scene.tracks.len(), scene.n_timesteps, |agent_idx, timestep| {
        agent_idx < observed.n_agents()
            && timestep < observed.n_timesteps()
            && observed.is_observed(agent_idx, timestep)
    });
    let scene = as_stored(&scene);
    if let Some(behavior) = behavior {
        let roles = &record.scenario.provenance.guidance.roles;
        (record.verified, record.events) = requested_events(behavior, roles, &scene);
    }
    record.scenario.observed = mask;
    record.scenario.scene = scene;
    record.scenario.provenance.ego_driver = Some(config.ego.name().to_owned());
}

#[cfg(test)]
mod tests {
    use super::super::testing::{corpus, model, record, write_scenes};
    use super::*;
    use crate::behavior::BehaviorConfig;
    use crate::progress::Silent;
    use crate::scene::GuidanceTag;
    use crate::store::CorpusReader;
    use candle_core::Device;

    /// A scenario with a cut-in, and one in which none was found, after a closed loop with this driver of the ego.
    fn rolled_out(ego: NamedDriver, times_s: [f64; 2], n_threads: usize) -> [ScenarioRecord; 3] {
        rolled_out_from(record(), ego, times_s, n_threads)
    }

    fn rolled_out_from(
        sampled: ScenarioRecord,
        ego: NamedDriver,
        [horizon_s, replan_s]: [f64; 2],
        n_threads: usize,
    ) -> [ScenarioRecord; 3] {
        let dir = tempfile::tempdir().unwrap();
        write_scenes(
            dir.path(),
            &CorpusReader::open(&corpus()).unwrap(),
            std::slice::from_ref(&sampled.scenario.scene),
        );
        let store = SceneStore::open(dir.path()).unwrap();
        let model = model();
        let futures = Futures::new(&model, 3, &Device::Cpu).unwrap();
        let unverified = ScenarioRecord { verified: false, events: Vec::new(), ..sampled.clone() };
        let mut output = ShardOutput { records: vec![sampled.clone(), unverified], ..ShardOutput::default() };
        let behavior = BehaviorConfig::from_id("cut_in").unwrap().build();
        let config = SweepRollout { horizon_s, replan_s, ego };
        let pool = rayon::ThreadPoolBuilder::new().num_threads(n_threads).build().unwrap();
        pool.install(|| roll_out_samples(&mut output, &config, Some(behavior.as_ref()), &futures, &store, &Silent))
            .unwrap();
        let [verified, unverified] = <[ScenarioRecord; 2]>::try_from(output.records).unwrap();
        [sampled, verified, unverified]
    }

    #[test]
    fn a_sample_that_is_driven_to_its_end_stays_as_it_is() {
        let [sampled, mut driven, unverified] = rolled_out(NamedDriver::Model, [3.0, 3.0], 1);
        assert_eq!(driven.scenario.provenance.ego_driver.take().as_deref(), Some("model"));
        // The corpus may come from a program that rounded differently.
        for (found, expected) in driven.events.iter().zip(&sampled.events) {
            let mut both = found.parameters.iter().zip(&expected.parameters);
            assert!(both.all(|(a, b)| a.0 == b.0 && (a.1 - b.1).abs() < 1e-9));
        }
        driven.events.clone_from(&sampled.events);
        assert_eq!(driven, sampled);
        assert_eq!(unverified.scenario, sampled.scenario);
        // What guidance made the others do, the ego answers to once it could have seen it.
        let mut guided = record();
        guided.scenario.provenance.guidance.kind = "cut_in".to_owned();
        let [_, logged, _] = rolled_out_from(guided, NamedDriver::Log, [3.0, 3.0], 1);
        let (before, after, ego_idx) =
            (&sampled.scenario.scene, &logged.scenario.scene, sampled.subject_idx().unwrap());
        let n = before.n_timesteps;
        // Three timesteps before the event begins, the other has come over to the ego's path, straight on, by 0.375 m.
        let other_idx = before.track_idx(sampled.events[0].roles.track("other").unwrap()).unwrap();
        let began = sampled.events[0].start_timestep - 3;
        let mut path: Vec<_> = (9..n).map(|timestep| before.state(ego_idx, timestep).unwrap().position).collect();
        path.push(path[path.len() - 1] + before.state(ego_idx, n - 1).unwrap().velocity * 5.0);
        let path = crate::geometry::Polyline(path);
        let aside_m =
            |timestep: usize| path.project(before.state(other_idx, timestep).unwrap().position).unwrap().offset_m.abs();
        let over_m = |timestep: usize| (9..timestep).map(aside_m).fold(0.0, f64::max) - aside_m(timestep);
        assert!(over_m(began - 1) < WANDERING_M + 0.05 && over_m(began) > WANDERING_M - 0.05);
        let answers = began + 8;
        let same = |idx: usize, timestep: usize| before.state(idx, timestep) == after.state(idx, timestep);
        assert_eq!((0..n).find(|timestep| !same(ego_idx, *timestep)), (answers < n).then_some(answers));
        assert!((0..before.tracks.len()).all(|idx| idx == ego_idx || (0..n).all(|timestep| same(idx, timestep))));
    }

    #[test]
    fn a_maneuver_is_driven_to_its_end_after_that_of_the_sample_or_ends_with_it() {
        let (plain, other) = (record(), record().events[0].roles.track("other").cloned().unwrap());
        let n_steps = plain.scenario.scene.n_timesteps;
        let mut planned = plain.clone();
        let scene = &mut planned.scenario.scene;
        *scene = scene.lasting(n_steps + 8);
        let (other_idx, ego_idx) = (scene.track_idx(&other).unwrap(), plain.subject_idx().unwrap());
        let is_there = |idx: &usize| ![other_idx, ego_idx].contains(idx) && scene.state(*idx, n_steps - 1).is_some();
        let leader_idx = (0..scene.tracks.len()).find(is_there).unwrap();
        for idx in [other_idx, leader_idx] {
            let track = &mut scene.tracks[idx];
            let last = *track.trajectory.get(n_steps - 1).unwrap();
            let further = (1..=8).map(|step| {
                let position = last.position + last.velocity * (f64::from(step) * scene.dt_s);
                Some(crate::scene::State { position, ..last })
            });
            let states = track.trajectory.entries()[..n_steps].iter().copied().chain(further).collect();
            track.trajectory = Trajectory::new(states);
        }
        // The event would be found later than it is, so that the plan is kept to its end.
        planned.events[0].end_timestep = n_steps + 7;
        planned.scenario.provenance.guidance.kind = GuidanceTag::TEMPLATE.to_owned();
        let [_, driven, unverified] = rolled_out_from(planned.clone(), NamedDriver::Log, [3.8, 3.0], 1);
        let (scene, planned) = (&driven.scenario.scene, &planned.scenario.scene);
        assert_eq!(scene.n_timesteps, n_steps + 8);
        let apart_m = |idx: usize, timestep: usize| {
            let [a, b] = [scene, planned].map(|scene| scene.state(idx, timestep).unwrap().position);
            a.distance(b)
        };
        assert!((0..n_steps + 8).all(|timestep| apart_m(other_idx, timestep) < 1e-3), "everybody else is sampled");
        assert!((0..n_steps).all(|timestep| apart_m(ego_idx, timestep) < 1e-3), "its ego has reacted as planned");
        // And so does somebody whom the template has in it without a role.
        assert!((0..n_steps + 8).all(|timestep| apart_m(leader_idx, timestep) < 1e-3));
        let bystander = (0..planned.tracks.len()).find(|idx| planned.state(*idx, n_steps).is_none()).unwrap();
        assert!(scene.state(bystander, n_steps).is_some());
        assert_eq!(unverified.scenario, plain.scenario);
    }

    #[test]
    fn a_closed_loop_goes_on_from_the_first_plan_to_the_same_bytes() {
        let [sampled, driven, _] = rolled_out(NamedDriver::Model, [3.6, 0.5], 1);
        assert_eq!(driven, rolled_out(NamedDriver::Model, [3.6, 0.5], 2)[1]);
        let (before, scene) = (&sampled.scenario.scene, &driven.scenario.scene);
        assert_eq!((scene.n_timesteps, scene.n_history, scene.ego_idx), (46, 10, before.ego_idx));
        assert_eq!(*scene, as_stored(scene), "what was verified is what is written");
        let same =
            |timestep: usize| (0..before.tracks.len()).all(|i| before.state(i, timestep) == scene.state(i, timestep));
        assert_eq!((0..40).position(|timestep| !same(timestep)), Some(15), "the first plan is the sample");
        let observed = &driven.scenario.observed;
        assert_eq!((observed.n_agents(), observed.n_timesteps()), (scene.tracks.len(), 46));
        assert!(observed.is_observed(0, 9) && !observed.is_observed(0, 45));
        // The event is kept in aim, and its parameters are those of the closed loop.
        assert!(driven.verified && driven.events[0].roles == sampled.events[0].roles);
        let [_, by_idm, _] = rolled_out(NamedDriver::Idm, [3.6, 0.5], 1);
        let ego_idx = sampled.subject_idx().unwrap();
        assert_ne!(by_idm.scenario.scene.state(ego_idx, 12), before.state(ego_idx, 12), "it drives from the present");
        assert_eq!(by_idm.scenario.provenance.ego_driver.as_deref(), Some("idm"));
    }
}

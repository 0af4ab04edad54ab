//! Drives on from a world, replanning again and again, until the ego is through or has failed.

use super::drivers::free_m;
use super::outcome::{contact, ttc_s};
use super::peek::peek;
use super::situation::Situation;
use super::traffic::Traffic;
use super::world::World;
use super::{Contact, Driver, Error, Failed, Outcome, Result};
use crate::generate::{Futures, check_times};
use crate::scene::{Scene, State};
use serde::{Deserialize, Serialize};
use std::cell::Cell;

/// The longest drive, seconds.
pub(crate) const MOST_HORIZON_S: f64 = 600.0;
/// How far off the road the center of the ego may be, meters: as in the check of validity.
pub(super) const OFF_ROAD_SLACK_M: f64 = 0.3;
/// An ego that stands for this long, seconds, below this speed, m/s, with this much free road ahead, meters, has
/// stopped dead.
const STOPPED_S: f64 = 4.0;
const STANDING_MPS: f64 = 0.3;
const FREE_M: f64 = 10.0;

/// The settings of a drive.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct RolloutConfig {
    /// Its length, seconds after the present.
    pub horizon_s: f64,
    /// How long each plan is driven, seconds.
    pub replan_s: f64,
}

impl Default for RolloutConfig {
    fn default() -> Self {
        Self { horizon_s: 8.0, replan_s: 0.5 }
    }
}

impl RolloutConfig {
    /// Timesteps of the horizon, and of a plan.
    pub(crate) fn n_steps(&self, dt_s: f64) -> [usize; 2] {
        [self.horizon_s, self.replan_s].map(|s| ((s / dt_s).round() as usize).max(1))
    }

    /// Rejects settings with which this model cannot drive.
    pub fn check(&self, futures: &Futures<'_>) -> Result<()> {
        let future_s = (futures.n_timesteps() - futures.n_history()) as f64 * futures.dt_s();
        let refuse = |why: String| Err(Error::Config(why));
        match (self.horizon_s, self.replan_s) {
            (horizon_s, _) if !(horizon_s > 0.0 && horizon_s <= MOST_HORIZON_S) => {
                refuse(format!("horizon_s is {horizon_s:?}, expected more than 0 and at most {MOST_HORIZON_S} s"))
            }
            times => check_times(times.into(), [futures.dt_s(), future_s]).or_else(|issue| refuse(issue.to_string())),
        }
    }
}

/// The source of the motion of all agents but the ego.
pub enum Others<'a> {
    /// The model, which answers to the ego.
    Sampled(&'a Futures<'a>),
    /// The scenario for the first plan, then the model. Nothing ends the drive while the scenario lasts.
    Continued(&'a Futures<'a>),
    /// The scenario, whatever the ego does.
    Replayed,
}

/// A finished drive.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Driven {
    /// The reached states.
    pub world: World,
    /// How it ended.
    pub outcome: Outcome,
    /// More about it, for people.
    pub why: Option<String>,
    /// The first contact of the ego.
    pub contact: Option<Contact>,
    /// The shortest time to collision of the ego during the drive, seconds.
    pub min_ttc_s: Option<f64>,
    /// The hardest braking of the ego within a timestep, m/s².
    pub max_braking_mps2: f64,
    /// How far the ego came, meters.
    pub progress_m: f64,
    /// Whether the other agents of the event gave up their plan because of the ego.
    pub gave_up_plan: bool,
    /// Whether the event happens in the driven states; missing for a scenario without an event, and for one that is
    /// continued, in which the miner looks for it anyway.
    pub event_happens: Option<bool>,
    /// The traffic around it.
    pub traffic: Traffic,
    /// The world at the first replanning at or after the requested timestep.
    pub saved: Option<World>,
    /// What the driver has said to people.
    pub said: String,
}

/// The end of a drive, and more about it.
pub(super) type End = (Outcome, Option<String>);

/// Drives on from `world` with this driver of the ego. The world is saved at timestep `save_at`.
///
/// # Errors
/// When the model does not fit the scenario or the device fails; failures of the driver are an outcome.
pub fn roll_out(
    situation: &Situation,
    world: World,
    driver: &mut dyn Driver,
    others: &Others<'_>,
    config: &RolloutConfig,
    save_at: Option<usize>,
) -> Result<Driven> {
    let scene = &situation.scene;
    let unfit = |why: String| Error::Unfit { scenario_id: situation.scenario_id.clone(), why };
    if let Others::Sampled(futures) | Others::Continued(futures) = others
        && (scene.n_history < futures.n_history() || (scene.dt_s - futures.dt_s()).abs() > 1e-6)
    {
        return Err(unfit(format!(
            "has {} timesteps of {} s before the present, but the model observes {} of {} s",
            scene.n_history,
            scene.dt_s,
            futures.n_history(),
            futures.dt_s()
        )));
    }
    let n_arrivals = situation.arrivals.n_expected();
    let n_known = scene.tracks.len() - n_arrivals;
    if !(n_known..=scene.tracks.len()).contains(&world.n_tracks()) || world.n_timesteps() < scene.n_history {
        return Err(unfit("does not have the tracks or timesteps of the saved state".to_owned()));
    }
    let [n_horizon, n_plan] = config.n_steps(scene.dt_s);
    let last = scene.current_timestep() + n_horizon;
    let world = world.with_tracks(scene.tracks.len());
    let mut drive = Drive { situation, world, driver, min_ttc_s: None, contact: None, gave_up_plan: false };
    let mut saved = None;
    let mut end = drive.driver.begin(situation, &drive.world).err().map(ended).transpose()?;
    while end.is_none() && drive.world.now() < last {
        if save_at.is_some_and(|timestep| saved.is_none() && drive.world.now() >= timestep) {
            saved = Some(drive.world.clone());
        }
        let n_steps = n_plan.min(last - drive.world.now());
        let n_planned = drive.n_planned(n_steps);
        // What becomes of agents of the event after their plan is decided when they are there.
        let is_cut = matches!(others, Others::Continued(_)) && n_planned > 0;
        end = drive.replan(others, if is_cut { n_planned } else { n_steps })?;
    }
    let (outcome, why) = end.unwrap_or_else(|| came_through(situation, &drive.world));
    let said = drive.driver.end(outcome, why.as_deref());
    let Drive { world, min_ttc_s, contact, gave_up_plan, .. } = drive;
    let ego = |timestep: usize| world.state(situation.ego_idx, timestep);
    let steps = (scene.n_history..world.n_timesteps()).filter_map(|t| ego(t - 1).zip(ego(t)));
    let (mut max_braking_mps2, mut progress_m) = (0.0_f64, 0.0);
    for (before, after) in steps {
        max_braking_mps2 = max_braking_mps2.max((before.speed_mps() - after.speed_mps()) / scene.dt_s);
        progress_m += after.position.distance(before.position);
    }
    let traffic = Traffic::of(situation, &world);
    let is_asked = !situation.roles.is_empty() && !matches!(others, Others::Continued(_));
    let event_happens = is_asked.then(|| situation.event_in(&situation.driven(&world)).is_some());
    Ok(Driven {
        world,
        outcome,
        why,
        contact,
        min_ttc_s,
        max_braking_mps2,
        progress_m,
        gave_up_plan,
        event_happens,
        traffic,
        saved,
        said,
    })
}

/// Drives on for a plan. Returns the world, and the end of the drive if it is reached.
pub(super) fn drive_on(
    situation: &Situation,
    world: World,
    driver: &mut dyn Driver,
    futures: &Futures<'_>,
    n_steps: usize,
) -> Result<(World, Option<End>)> {
    let mut drive = Drive { situation, world, driver, min_ttc_s: None, contact: None, gave_up_plan: false };
    let end = drive.replan(&Others::Sampled(futures), n_steps)?;
    Ok((drive.world, end))
}

/// Begins a drive in the midst of it: a driver that may remember is asked again at every plan since the present, and
/// its answers are not driven.
pub(super) fn begin_at(
    situation: &Situation,
    world: &World,
    driver: &mut dyn Driver,
    futures: &Futures<'_>,
    n_plan: usize,
) -> Result<(), Failed> {
    let present = situation.scene.current_timestep();
    driver.begin(situation, &world.until(present))?;
    let past = if driver.is_model() { present..present } else { present..world.now() };
    for now in past.step_by(n_plan) {
        let then = world.until(now);
        driver.plan(situation, &then, n_plan, &peeker(situation, &then, Some(futures)))?;
        (now..now + n_plan).try_for_each(|timestep| driver.next(situation, &world.until(timestep), None).map(drop))?;
    }
    Ok(())
}

/// Futures that the driver may peek into; others come each time.
fn peeker<'a>(
    situation: &'a Situation,
    world: &'a World,
    futures: Option<&'a Futures<'a>>,
) -> impl Fn(usize) -> Result<Vec<Scene>, Failed> + use<'a> {
    let n_peeked = Cell::new(0);
    move |n| match futures {
        Some(futures) => peek(situation, world, futures, n_peeked.replace(n_peeked.get() + n)..n_peeked.get()),
        None => Err(Failed::because("others that do not answer have no futures")),
    }
}

/// The end of a drive whose driver does not drive on.
pub(super) fn ended(failed: Failed) -> Result<End> {
    match failed {
        Failed::TimedOut(why) => Ok((Outcome::TimedOut, Some(why))),
        Failed::Driver(why) => Ok((Outcome::PlannerFailed, Some(why))),
        Failed::NotSampled(why) => Ok((Outcome::NotSampled, Some(why))),
        Failed::Error(error) => Err(error),
    }
}

/// The end of a drive that was not ended early.
pub(super) fn came_through(situation: &Situation, world: &World) -> End {
    let scene = &situation.scene;
    if world.present(situation.ego_idx).is_none() {
        return (Outcome::Survived, Some("came to the end of the map".to_owned()));
    }
    let n_stopped = (STOPPED_S / scene.dt_s).round() as usize;
    let first = world.now().saturating_sub(n_stopped).max(scene.current_timestep());
    let speed = |timestep: usize| world.state(situation.ego_idx, timestep).map_or(0.0, |s| s.speed_mps());
    let stands = world.now() - first >= n_stopped
        && (first..=world.now()).all(|timestep| speed(timestep) < STANDING_MPS)
        && situation.way.target_speed_mps > 1.0;
    match stands && free_m(situation, world) > FREE_M {
        true => (Outcome::StoppedDead, Some("stands with free road ahead".to_owned())),
        false => (Outcome::Survived, None),
    }
}

pub(super) struct Drive<'a> {
    pub(super) situation: &'a Situation,
    pub(super) world: World,
    pub(super) driver: &'a mut dyn Driver,
    min_ttc_s: Option<f64>,
    contact: Option<Contact>,
    pub(super) gave_up_plan: bool,
}

impl Drive<'_> {
    /// For how many of the next `n_steps` timesteps the agents of the event have a plan.
    fn n_planned(&self, n_steps: usize) -> usize {
        let (situation, now) = (self.situation, self.world.now());
        let has_plan = |idx: usize, timestep: usize| situation.plan(&self.world, idx, timestep).is_some();
        let is_planned = |step: &usize| situation.planned.iter().any(|idx| has_plan(*idx, now + step));
        (1..=n_steps).take_while(is_planned).count()
    }

    /// Replans and drives the plan; returns the end of the drive if it is reached.
    fn replan(&mut self, others: &Others<'_>, n_steps: usize) -> Result<Option<End>> {
        let (situation, now, center_idx) = (self.situation, self.world.now(), self.situation.ego_idx);
        situation.arrivals.enter(situation, &mut self.world);
        let futures = match others {
            Others::Sampled(futures) => Some(futures),
            Others::Continued(futures) => Some(futures).filter(|_| now > situation.scene.current_timestep()),
            Others::Replayed => None,
        };
        let is_continued = matches!(others, Others::Continued(_));
        let sampled = match futures {
            Some(futures) => match self.sample(futures, is_continued, n_steps)? {
                Ok(sampled) => Some((sampled, futures.n_history())),
                Err(why) => return Ok(Some((Outcome::NotSampled, Some(why.to_string())))),
            },
            None => None,
        };
        let (world, futures) = (&self.world, futures.map(|futures| &**futures));
        if let Err(why) = self.driver.plan(situation, world, n_steps, &peeker(situation, world, futures)) {
            return ended(why).map(Some);
        }
        for step in 0..n_steps {
            let then = |agent_idx: usize| match &sampled {
                Some((sampled, n_history)) => sampled.state(agent_idx, n_history + step).copied(),
                None => situation.scene.state(agent_idx, now + 1 + step).copied(),
            };
            let ego = match self.world.present(center_idx) {
                Some(_) => self.driver.next(situation, &self.world, then(center_idx)).map(Some),
                None => Ok(None),
            };
            let ego = match ego {
                Ok(ego) => ego,
                Err(why) => return ended(why).map(Some),
            };
            let timestep = self.world.n_timesteps();
            // Who has left since the last replanning does not come back.
            let is_there = |agent_idx: usize| sampled.is_none() || self.world.present(agent_idx).is_some();
            let next = |agent_idx: usize| match agent_idx == center_idx {
                true => ego,
                false => (situation.plan(&self.world, agent_idx, timestep).or_else(|| then(agent_idx)))
                    .filter(|_| is_there(agent_idx)),
            };
            let next: Vec<Option<State>> = (0..self.world.n_tracks()).map(next).collect();
            self.world.push(next);
            let (goes_on, since) = match others {
                Others::Continued(_) if futures.is_none() => continue,
                // Nobody leaves during the first plan, but after it.
                Others::Continued(_) if step == 0 => (timestep < situation.scene.n_timesteps, now - n_steps),
                Others::Continued(_) => (timestep < situation.scene.n_timesteps, timestep - 1),
                Others::Sampled(_) | Others::Replayed => (false, timestep - 1),
            };
            if let Some(end) = self.look(since).filter(|_| !goes_on) {
                return Ok(Some(end));
            }
        }
        Ok(None)
    }

    /// Removes agents that have left since an earlier timestep, and returns the end of the drive if it is reached.
    fn look(&mut self, since: usize) -> Option<End> {
        let (situation, ego_idx) = (self.situation, self.situation.ego_idx);
        // Where the model drives everybody, traffic goes on without the ego.
        let goes_on = self.driver.is_model();
        let left = |agent_idx: &usize| {
            let state = self.world.present(*agent_idx);
            let is_traffic = goes_on || *agent_idx != ego_idx;
            state.is_some_and(|state| situation.has_left_map(*agent_idx, &state))
                || (is_traffic && situation.goes_out_of_sight(&self.world, *agent_idx, since))
        };
        let gone: Vec<usize> = (0..self.world.n_tracks()).filter(left).collect();
        let has_left = gone.contains(&ego_idx);
        let is_removed = |agent_idx: &&usize| goes_on || **agent_idx != ego_idx;
        gone.iter().filter(is_removed).for_each(|agent_idx| self.world.remove(*agent_idx));
        let ttc_s = ttc_s(situation, &self.world);
        self.min_ttc_s = [self.min_ttc_s, ttc_s].into_iter().flatten().reduce(f64::min);
        self.contact = contact(situation, &self.world);
        if let Some(Contact { track, side, relative_mps }) = &self.contact {
            let why = format!("touches track {track} with its {} at {relative_mps:.1} m/s", side.name());
            return Some((Outcome::Hit, Some(why)));
        }
        let off_m = self.world.present(ego_idx).and_then(|state| situation.ego_off_road_m(&state));
        if let Some(off_m) = off_m.filter(|off_m| *off_m > OFF_ROAD_SLACK_M) {
            return Some((Outcome::LeftRoad, Some(format!("is {off_m:.1} m off the road"))));
        }
        (has_left && !goes_on).then(|| (Outcome::Survived, Some("came to the end of the map".to_owned())))
    }
}

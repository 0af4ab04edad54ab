//! A closed loop that is split, and what counts of its ends.

use super::{RatesConfig, Severity};
use crate::behavior::{Behavior, BehaviorEvent};
use crate::generate::Futures;
use crate::rates::{ExposureTally, ModeledEvent, ModeledLoop, OccurrenceTally, SceneExposure};
use crate::scene::SceneId;
use crate::simulate::rollout::{End, begin_at, came_through, drive_on, ended};
use crate::simulate::{Driver, Error, Outcome, Result, Situation, World};
use crate::statistics::{Levels, Process, split};
use std::cell::RefCell;

/// Events that begin in the last seconds of a loop do not count, for they may not be complete.
const TO_COMPLETE_S: f64 = 3.0;

/// What a failure of a driver is counted as. It is counted a second time: as [`TESTED_FAILURE`], or as its outcome.
pub const FAILURE: &str = "failure";
/// What a failure in an event that the driver is tested with is also counted as.
pub const TESTED_FAILURE: &str = "tested_failure";

/// Whether a driver is tested with such an event at a place.
pub(crate) type IsTested<'a> = dyn Fn(&str, &BehaviorEvent) -> bool + Sync + 'a;

pub(super) struct Start {
    pub(super) situation: Situation,
    pub(super) recording: String,
    /// Timesteps from one recorded scene to the next.
    pub(super) n_every: usize,
}

/// What all loops have in common.
pub(super) struct Common<'a> {
    pub(super) config: &'a RatesConfig,
    pub(super) futures: &'a Futures<'a>,
    pub(super) behaviors: &'a [Box<dyn Behavior>],
    pub(super) severities: Vec<f64>,
    pub(super) is_tested: &'a IsTested<'a>,
}

/// A split loop: what counts, how many futures were sampled, and the weights of the ends that passed each level.
pub(super) struct Looped {
    pub(super) counted: ModeledLoop,
    pub(super) n_futures: u64,
    pub(super) passed: Vec<f64>,
}

/// A loop, or a copy of it.
#[derive(Clone)]
struct Loop<'a> {
    situation: &'a Situation,
    futures: &'a Futures<'a>,
    driver: &'a RefCell<&'a mut Box<dyn Driver>>,
    severity: Severity,
    /// Timesteps of a plan, the last timestep, and the first at which no event that counts can begin any more.
    n_plan: usize,
    last: usize,
    until: usize,
    world: World,
    most: f64,
    end: Option<End>,
    /// Whether the driver does not know this past yet, or has driven another copy since.
    is_strange: bool,
}

impl Process for Loop<'_> {
    type Error = Error;

    fn step(&mut self) -> Result<Option<f64>> {
        let now = self.world.now();
        let n_steps = self.n_plan.min(self.last.saturating_sub(now));
        if self.end.is_some() || n_steps == 0 {
            return Ok(None);
        }
        let Self { situation, futures, n_plan, .. } = *self;
        let driver = &mut ***self.driver.borrow_mut();
        if std::mem::take(&mut self.is_strange)
            && let Err(why) = begin_at(situation, &self.world, driver, futures, n_plan)
        {
            self.end = Some(ended(why)?);
            return Ok(None);
        }
        (self.world, self.end) = drive_on(situation, self.world.clone(), driver, futures, n_steps)?;
        let of = (!driver.is_model()).then_some(situation.ego_idx);
        let at = |timestep: usize| self.severity.at(situation, &self.world, of, timestep);
        // Copies that begin later only cost.
        let severity = (now + 1..(self.world.now() + 1).min(self.until)).map(at).fold(f64::NEG_INFINITY, f64::max);
        self.most = self.most.max(severity);
        Ok(Some(severity))
    }

    fn draw_anew(&mut self, copy: usize) {
        self.world.draw_anew(copy);
        self.is_strange = copy > 0;
    }
}

impl Common<'_> {
    /// Follows a loop and its copies to their ends.
    pub(super) fn follow(&self, start: &Start, driver: &mut Box<dyn Driver>) -> Result<Looped> {
        let Self { config, futures, .. } = self;
        let driver = RefCell::new(driver);
        let scene = &start.situation.scene;
        let [n_steps, n_plan] = config.rollout().n_steps(scene.dt_s);
        let first = Loop {
            situation: &start.situation,
            futures,
            driver: &driver,
            severity: config.severity,
            n_plan,
            last: scene.current_timestep() + n_steps,
            until: scene.n_history + self.n_counted(scene.dt_s, driver.borrow().is_model()),
            world: start.situation.start(futures.seed()).with_tracks(scene.tracks.len()),
            most: f64::NEG_INFINITY,
            end: None,
            is_strange: true,
        };
        let (place, recording) = (scene.source.place.clone(), start.recording.clone());
        let mut counted = ModeledLoop { place, recording, ..ModeledLoop::default() };
        let mut passed = vec![0.0; self.severities.len()];
        let levels = Levels { severities: &self.severities, n_copies: config.copies };
        let n_futures = split(first, levels, &mut |end: Loop<'_>, weight| {
            let (outcome, why) = end.end.unwrap_or_else(|| came_through(&start.situation, &end.world));
            let mut driver = driver.borrow_mut();
            driver.end(outcome, why.as_deref());
            let of_driver = (!driver.is_model()).then_some(outcome);
            self.count(start, &end.world, of_driver, weight, &mut counted);
            let both = passed.iter_mut().zip(&self.severities);
            both.filter(|(_, level)| end.most >= **level).for_each(|(passed, _)| *passed += weight);
        })?;
        Ok(Looped { counted, n_futures, passed })
    }

    /// The timesteps of a loop in which events count, if they begin then; failures of a driver count to the end.
    fn n_counted(&self, dt_s: f64, is_of_model: bool) -> usize {
        let to_complete_s = if is_of_model { TO_COMPLETE_S } else { 0.0 };
        ((self.config.horizon_s - to_complete_s) / dt_s).round() as usize
    }

    /// Adds an end: its time, its way, and the events that begin after the present and long enough before the horizon;
    /// of a driver that is not the model, its own way and whether it failed, in an event that it is tested with or not.
    fn count(&self, start: &Start, world: &World, of_driver: Option<Outcome>, weight: f64, counted: &mut ModeledLoop) {
        let (scene, ego_idx) = (&start.situation.scene, start.situation.ego_idx);
        let from = scene.n_history;
        let until = (from + self.n_counted(scene.dt_s, of_driver.is_none())).min(world.n_timesteps());
        counted.observed_h += weight * (until - from) as f64 * scene.dt_s / 3600.0;
        let is_counted = |idx: &usize| match of_driver {
            Some(_) => *idx == ego_idx,
            None => scene.tracks[*idx].class.is_motorized(),
        };
        for idx in (0..world.n_tracks()).filter(is_counted) {
            let driven_m: f64 =
                (from..until).filter_map(|t| world.state(idx, t)).map(|state| state.speed_mps() * scene.dt_s).sum();
            counted.motorized_km += weight * driven_m / 1000.0;
        }
        if let Some(outcome) = of_driver {
            let is_tested = |(frame, event): &(usize, BehaviorEvent)| {
                *frame < world.now() && (self.is_tested)(&scene.source.place, event)
            };
            if outcome.is_failure() {
                let is_tested = self.events(start, world, Some(ego_idx)).iter().any(is_tested);
                let kind = if is_tested { TESTED_FAILURE } else { outcome.name() };
                let failure = |of: &str| ModeledEvent { behavior: of.to_owned(), parameters: Vec::new(), weight };
                counted.events.extend([FAILURE, kind].map(failure));
            }
            return;
        }
        for (frame, event) in self.events(start, world, None) {
            if (from..until).contains(&frame) {
                let BehaviorEvent { behavior, parameters, .. } = event;
                counted.events.push(ModeledEvent { behavior, parameters: parameters.into_iter().collect(), weight });
            }
        }
    }

    /// The events of a loop, each once, with their first timesteps: found in windows as of recordings, and counted by
    /// the same code; all of them, or those that happen to one agent.
    fn events(&self, start: &Start, world: &World, to: Option<usize>) -> Vec<(usize, BehaviorEvent)> {
        let scene = &start.situation.scene;
        let n_timesteps = scene.n_timesteps.min(world.n_timesteps());
        let last = world.n_timesteps() - n_timesteps;
        let firsts = (0..last).step_by(start.n_every).chain([last]);
        let (mut exposure, mut occurrences) = (ExposureTally::default(), OccurrenceTally::default());
        let mut found = Vec::new();
        for first in firsts {
            let mut window = start.situation.piece(world, first, n_timesteps);
            window.tracks.retain(|track| track.trajectory.valid().next().is_some());
            window.id = SceneId(format!("loop@{first}"));
            let events = self.behaviors.iter().flat_map(|behavior| behavior.detect(&window));
            let happens_to = |event: &BehaviorEvent| event.subject_idx(&window).map(|idx| &window.tracks[idx].id);
            let is_asked = |event: &BehaviorEvent| to.is_none_or(|to| happens_to(event) == Some(&scene.tracks[to].id));
            let is_counted = |event: &BehaviorEvent| is_asked(event) && !event.is_of_parked(&window);
            let events: Vec<BehaviorEvent> = events.filter(is_counted).collect();
            let shown = SceneExposure::of(&window);
            if let Some(at) = exposure.add(&shown) {
                found.extend(occurrences.add(&shown, at, &events, &exposure));
            }
        }
        found.extend(occurrences.finish());
        let first_frame = |event: &BehaviorEvent| SceneId::window_of(&event.scene_id.0).map_or(0, |(_, first)| first);
        found.into_iter().map(|(event, _)| (first_frame(&event) as usize + event.start_timestep, event)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::behavior::BehaviorConfig;
    use crate::simulate::testing::{model, record, situation};

    #[test]
    fn a_failure_is_tested_in_an_event_that_happens_to_the_ego_and_began_before() {
        let (record, model) = (record(), model());
        let futures = Futures::new(&model, 3, &candle_core::Device::Cpu).unwrap();
        let (event, scene) = (record.main_event().unwrap(), &record.scenario.scene);
        let behaviors = [BehaviorConfig::from_id(&event.behavior).unwrap().build()];
        let tracks = scene.tracks.iter().map(|track| track.trajectory.entries());
        let whole = World::new(&record.scenario.id, 3, 0, tracks);
        let kinds = |ego_idx: usize, world: &World, place: &str, [from, to]: [f64; 2]| {
            let is_tested = |at: &str, event: &BehaviorEvent| {
                at == place && event.parameters.get("gap_m").is_some_and(|gap_m| (from..to).contains(gap_m))
            };
            let (futures, config) = (&futures, &RatesConfig::default());
            let common =
                Common { config, futures, behaviors: &behaviors, severities: Vec::new(), is_tested: &is_tested };
            let mut situation = situation(&record);
            situation.ego_idx = ego_idx;
            let start = Start { situation, recording: String::new(), n_every: scene.n_timesteps };
            let mut counted = ModeledLoop::default();
            common.count(&start, world, Some(Outcome::Survived), 0.5, &mut counted);
            common.count(&start, world, Some(Outcome::Hit), 0.5, &mut counted);
            // Each end counts for as long as it was driven, times its weight.
            let driven_s = (world.n_timesteps() - scene.n_history) as f64 * scene.dt_s;
            assert!((counted.observed_h * 3600.0 - driven_s).abs() < 1e-9, "{}", counted.observed_h);
            counted.events.into_iter().map(|event| (event.behavior, event.weight)).collect::<Vec<_>>()
        };
        let (place, gap_m) = (scene.source.place.as_str(), event.parameters["gap_m"]);
        let (bucket, ego_idx) = ([gap_m - 0.5, gap_m + 0.5], record.subject_idx().unwrap());
        let other_idx = event.roles.tracks().filter_map(|id| scene.track_idx(id)).find(|idx| *idx != ego_idx).unwrap();
        let of = |kind: &str| vec![(FAILURE.to_owned(), 0.5), (kind.to_owned(), 0.5)];
        assert_eq!(kinds(ego_idx, &whole, place, bucket), of(TESTED_FAILURE));
        assert_eq!(kinds(ego_idx, &whole, place, [gap_m + 0.5, gap_m + 9.0]), of("hit"));
        assert_eq!(kinds(ego_idx, &whole, "elsewhere", bucket), of("hit"));
        assert_eq!(kinds(other_idx, &whole, place, bucket), of("hit"));
        assert_eq!(kinds(ego_idx, &whole.until(event.start_timestep), place, bucket), of("hit"));
    }
}

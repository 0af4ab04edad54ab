//! Keeps the event in aim: where it would not happen as planned, because the ego drives otherwise or keeps its
//! distance, the plan of the other agents is solved again from the present.
//!
//! The agents keep their paths, and one of them drives faster or slower within the limits of vehicles: by as little as
//! suffices for the definition of the behavior to find the event in the driven states and those expected of the ego.

use super::drivers::{Idm, ahead};
use super::reaction::retimed;
use super::situation::Situation;
use super::world::World;
use crate::geometry::angle_difference;
use crate::scene::{Scene, State, Track, Trajectory};

/// Additional accelerations of the other agents, m/s²: the weakest first.
const MORE_MPS2: [f64; 13] = [0.0, 0.5, -0.5, 1.0, -1.0, 1.5, -1.5, 2.0, -2.0, 3.0, -3.0, -4.5, -6.0];
/// The largest accelerations forward, in braking and across, m/s², as for templates. A plan that exceeded them may stay
/// as hard.
const MOST_MPS2: [f64; 3] = [3.5, 8.0, 3.6];
/// Time over which velocities are compared, seconds; over a shorter one they are noise.
const OVER_S: f64 = 0.3;

/// A plan that was solved again: the states of each agent from now on, and its last timestep.
struct Plan {
    states: Vec<(usize, Vec<State>)>,
    ends: usize,
}

impl Situation {
    /// Ends the plan once the event has happened, but not before it happens in the scenario.
    pub(super) fn let_go(&self, world: &mut World) {
        let is_due = (self.event[1]..world.plan_ends).contains(&world.now());
        if is_due && self.event_in(&self.foreseen(world, &[], &[])).is_some() {
            world.plan_ends = world.now();
        }
    }

    /// Solves the plan of the other agents again if the event would not happen as planned. `expected` are the states
    /// that the ego is expected to have at the next timesteps.
    pub(super) fn keep_in_aim(&self, world: &mut World, expected: &[State]) {
        let is_over = world.now() >= world.plan_ends || expected.is_empty();
        let Some(who) = self.planned.first().copied().filter(|_| self.aims && !is_over) else { return };
        let n_steps = expected.len();
        let as_planned = self.planned_again(world, (who, 0.0), n_steps);
        // Nobody dodges an ego that does not react.
        let is_hit = as_planned.is_some_and(|plan| self.is_hit(expected, &plan));
        let n_wanted = if is_hit { 1 } else { 2 };
        let mut best: Option<(usize, Plan)> = None;
        let tried = MORE_MPS2.iter().flat_map(|more_mps2| self.planned.iter().map(move |who| (*more_mps2, *who)));
        for (more_mps2, who) in tried {
            let Some(mut plan) = self.planned_again(world, (who, more_mps2), n_steps) else { continue };
            // An ego that keeps its distance once somebody is in its way should not undo the event, nor be hurt.
            let then = |idx, timestep| self.then(world, &plan, idx, timestep);
            let reacting = ahead(&mut Idm, self, world, n_steps, then);
            let is_fair = self.is_hit(expected, &plan) == is_hit && !self.is_hit(&reacting, &plan);
            if more_mps2 != 0.0 && !(is_fair && self.is_free(world, &plan)) {
                continue;
            }
            let foreseen = [expected, reacting.as_slice()].map(|ego| self.foreseen(world, ego, &plan.states));
            let events = foreseen.iter().filter_map(|scene| self.event_in(scene));
            let found: Vec<usize> = events.map(|event| event.end_timestep).collect();
            if found.len() > best.as_ref().map_or(0, |(n_found, _)| *n_found) {
                plan.ends = found.iter().copied().fold(world.plan_ends, usize::max);
                best = Some((found.len(), plan));
            }
            if found.len() >= n_wanted {
                break;
            }
        }
        if let Some((_, plan)) = best {
            world.plan_anew(plan.ends, &plan.states);
        }
    }

    /// Whether an ego with these states at the next timesteps touches an agent that follows the plan.
    fn is_hit(&self, ego: &[State], plan: &Plan) -> bool {
        plan.states.iter().filter(|(idx, _)| self.can_touch(*idx)).any(|(agent_idx, states)| {
            let mut pairs = ego.iter().zip(states.iter().skip(1));
            pairs.any(|(ego, other)| self.overlap([(self.ego_idx, ego), (*agent_idx, other)]))
        })
    }

    /// The state of an agent other than the ego at a timestep under this plan; agents without a plan go straight on.
    fn then(&self, world: &World, plan: &Plan, agent_idx: usize, timestep: usize) -> Option<State> {
        let step = timestep - world.now();
        match plan.states.iter().find(|(idx, _)| *idx == agent_idx) {
            Some((_, states)) => states.get(step).copied(),
            None => self.straight_on(world, agent_idx, timestep),
        }
    }

    /// The plans of the other agents if one of them accelerates by this much more. `None` if it cannot.
    fn planned_again(&self, world: &World, (who, more_mps2): (usize, f64), n_steps: usize) -> Option<Plan> {
        let states = self.planned.iter().filter(|idx| world.present(**idx).is_some()).map(|agent_idx| {
            let planned = self.course(world, *agent_idx, n_steps);
            if *agent_idx != who || more_mps2 == 0.0 {
                return Some((*agent_idx, planned));
            }
            let again = retimed(&planned, more_mps2, self.scene.dt_s);
            self.is_drivable(&planned, &again).then_some((*agent_idx, again))
        });
        Some(Plan { states: states.collect::<Option<_>>()?, ends: world.plan_ends })
    }

    /// The planned states of an agent of the event from now on; straight on after the end of the scenario.
    fn course(&self, world: &World, agent_idx: usize, n_steps: usize) -> Vec<State> {
        let mut states: Vec<State> = world.present(agent_idx).into_iter().collect();
        while let Some(last) = states.last().copied().filter(|_| states.len() <= n_steps) {
            let timestep = world.now() + states.len();
            let planned = world.planned(agent_idx, timestep);
            let as_first =
                || self.scene.state(agent_idx, timestep).filter(|_| !world.is_planned_anew(agent_idx)).copied();
            let planned = planned.or_else(as_first);
            let on = || State { position: last.position + last.velocity * self.scene.dt_s, ..last };
            states.push(planned.unwrap_or_else(on));
        }
        states
    }

    /// The agents of the event and the ego with their driven states, then the planned and expected ones.
    fn foreseen(&self, world: &World, expected: &[State], planned: &[(usize, Vec<State>)]) -> Scene {
        let n_timesteps = world.n_timesteps() + expected.len();
        let mut tracks: Vec<Track> = Vec::new();
        let mut agents: Vec<usize> = self.planned.iter().copied().chain([self.ego_idx]).collect();
        agents.sort_unstable();
        for agent_idx in &agents {
            let driven = (0..world.n_timesteps()).map(|timestep| world.state(*agent_idx, timestep));
            let planned = planned.iter().find(|(idx, _)| idx == agent_idx).map(|(_, states)| &states[1..]);
            let then = if *agent_idx == self.ego_idx { Some(expected) } else { planned };
            let states = driven.chain(then.unwrap_or_default().iter().copied().map(Some));
            let mut states: Vec<Option<State>> = states.collect();
            states.resize(n_timesteps, None);
            let trajectory = Trajectory::new(states);
            let trajectory = trajectory.with_velocities_from_positions(self.scene.n_history, self.scene.dt_s);
            tracks.push(Track { trajectory, ..self.scene.tracks[*agent_idx].clone() });
        }
        let ego_idx = agents.iter().position(|idx| *idx == self.ego_idx).unwrap_or_default();
        Scene { tracks, n_timesteps, ego_idx, ..self.scene.clone() }
    }

    /// Whether no agent but the ego touches another under this plan if agents without a plan go straight on.
    fn is_free(&self, world: &World, plan: &Plan) -> bool {
        plan.states.iter().all(|(agent_idx, own)| {
            (0..world.n_tracks()).filter(|idx| idx != agent_idx && *idx != self.ego_idx).all(|other_idx| {
                let touches = |step: usize| {
                    let other = self.then(world, plan, other_idx, world.now() + step);
                    let states = own.get(step).zip(other);
                    states.is_some_and(|(own, other)| self.overlap([(*agent_idx, own), (other_idx, &other)]))
                };
                touches(0) || !(1..own.len()).any(touches)
            })
        })
    }

    /// Whether a vehicle can drive `again`, or `again` is no harder than `before`.
    fn is_drivable(&self, before: &[State], again: &[State]) -> bool {
        let n = (OVER_S / self.scene.dt_s).round().max(1.0) as usize;
        let hardest = |states: &[State]| {
            let mut hardest = [0.0_f64; 3];
            for (a, b) in states.iter().zip(states.iter().skip(n)) {
                let over_s = n as f64 * self.scene.dt_s;
                let along = (b.speed_mps() - a.speed_mps()) / over_s;
                let turned_rad = match a.speed_mps().min(b.speed_mps()) > 0.5 {
                    true => angle_difference(a.velocity.angle(), b.velocity.angle()).abs(),
                    false => 0.0,
                };
                let across = f64::midpoint(a.speed_mps(), b.speed_mps()) * turned_rad / over_s;
                for (most, value) in hardest.iter_mut().zip([along, -along, across]) {
                    *most = most.max(value);
                }
            }
            hardest
        };
        let limits = hardest(before).into_iter().zip(MOST_MPS2).map(|(before, most)| before.max(most));
        hardest(again).into_iter().zip(limits).all(|(value, most)| value <= most + 1e-6)
    }
}

#[cfg(test)]
mod tests {
    use super::super::drivers::expected;
    use super::super::testing::{record, records, situation};
    use super::*;
    use crate::geometry::Vec2;

    /// Everybody does as in the scenario, but the ego may be elsewhere: when do the others give up their plan?
    #[test]
    fn the_plan_ends_once_the_event_has_happened_and_not_before_nor_without() {
        let situation = situation(&record());
        let (scene, [_, end]) = (&situation.scene, situation.event);
        let let_go_at = |ego_ahead_m: f64| {
            let mut world = situation.start(1);
            let planned = world.plan_ends;
            while world.plan_ends == planned && world.n_timesteps() < scene.n_timesteps {
                let timestep = world.n_timesteps();
                let state = |idx: usize| {
                    let state = *scene.state(idx, timestep)?;
                    let ahead_m = if idx == situation.ego_idx { ego_ahead_m } else { 0.0 };
                    let position = state.position + Vec2::from_angle(state.heading_rad) * ahead_m;
                    Some(State { position, ..state })
                };
                world.push((0..world.n_tracks()).map(state));
                situation.let_go(&mut world);
            }
            (world.plan_ends != planned).then_some((world.now(), world.plan_ends))
        };
        // The end of the event leaves room for letting go too early and too late.
        assert!((scene.n_history + 1..scene.n_timesteps - 1).contains(&end), "{end}");
        let (now, ends) = let_go_at(0.0).unwrap();
        assert!(now == ends && now >= end, "{now} {ends} {end}");
        let cut = Scene { n_timesteps: now + 1, ..scene.clone() };
        assert!(situation.event_in(&cut).is_some());
        // An ego far ahead or far behind is not cut off.
        assert_eq!([150.0, -150.0].map(let_go_at), [None, None]);
    }

    /// Beyond the scenario's end, since an ego that is behind comes to the place later.
    const N_STEPS: usize = 50;

    /// The ego is some meters ahead of its place in the scenario, or behind: is the plan solved again where the event
    /// would be lost, and otherwise left as it is?
    #[test]
    fn the_event_is_planned_anew_where_an_ego_that_is_elsewhere_would_undo_it() {
        let (mut n_lost, mut n_kept) = (0, 0);
        let all: Vec<Situation> = records().iter().map(situation).collect();
        let shifts = all.iter().flat_map(|situation| (-12..=24).map(move |i| (situation, f64::from(i) * 1.5)));
        for (situation, ahead_m) in shifts {
            let other = situation.planned[0];
            let mut moved = situation.clone();
            let track = &mut moved.scene.tracks[situation.ego_idx];
            let ahead = |state: &State| state.position + Vec2::from_angle(state.heading_rad) * ahead_m;
            let states = track.trajectory.entries().iter();
            let states = states.map(|state| state.map(|state| State { position: ahead(&state), ..state })).collect();
            track.trajectory = Trajectory::new(states);
            let mut world = moved.start(1);
            let expected = expected(situation, &world, N_STEPS);
            let found = |world: &World| {
                let states = vec![(other, situation.course(world, other, N_STEPS))];
                situation.event_in(&situation.foreseen(world, &expected, &states)).is_some()
            };
            let (happened, planned) = (found(&world), situation.course(&world, other, N_STEPS));
            situation.keep_in_aim(&mut world, &expected);
            let again = situation.course(&world, other, N_STEPS);
            assert!(found(&world) || !happened, "{ahead_m} m");
            n_lost += usize::from(!happened);
            if !happened && found(&world) {
                n_kept += 1;
                // Along the same path, no harder than vehicles can.
                assert!(planned != again && situation.is_drivable(&planned, &again), "{ahead_m} m");
                let is_on_way = |at: &State| {
                    let mut pairs = planned.windows(2).map(|pair| (pair[0].position, pair[1].position));
                    let last = planned[N_STEPS].position;
                    at.position.distance(last) < again[N_STEPS].position.distance(last) + 0.1
                        || pairs.any(|(a, b)| a.distance(at.position) + b.distance(at.position) < a.distance(b) + 0.1)
                };
                assert!(again.iter().all(is_on_way), "{ahead_m} m");
            }
        }
        assert!(n_kept > 0 && n_kept < n_lost, "{n_kept} of {n_lost}");
    }
}

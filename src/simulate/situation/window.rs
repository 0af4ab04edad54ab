//! What is a world as a scene: all that was driven, or what the model observes of it?

use super::Situation;
use super::whereabouts::near;
use crate::geometry::Vec2;
use crate::scene::{LaneGraph, LaneId, ObservationMask, Scene, State, Track, Trajectory};
use crate::simulate::World;
use std::sync::Arc;

/// The model sees lanes this close to an agent, meters, as in scenes.
const LANES_WITHIN_M: f64 = 100.0;

impl Situation {
    /// The scene of all reached states; its past is the scenario's.
    pub fn driven(&self, world: &World) -> Scene {
        self.piece(world, 0, world.n_timesteps())
    }

    /// The scene of `n_timesteps` reached states from `first` on, with as long a past as the scenario's.
    pub(in crate::simulate) fn piece(&self, world: &World, first: usize, n_timesteps: usize) -> Scene {
        let mut scene = self.cut(world, first, n_timesteps, self.scene.n_history);
        for track in &mut scene.tracks {
            track.trajectory = track.trajectory.with_velocities_from_positions(scene.n_history, scene.dt_s);
        }
        scene
    }

    /// The lanes of a `sampled` scene with those around what was `driven` from a timestep on; `None` if there are no
    /// more.
    pub(in crate::simulate) fn lanes_along(
        &self,
        sampled: &Scene,
        driven: &Scene,
        from: usize,
    ) -> Option<Arc<LaneGraph>> {
        let later = driven.tracks.iter().flat_map(|track| track.trajectory.valid().filter(|(t, _)| *t >= from));
        let later: Vec<Vec2> = later.map(|(_, state)| state.position).collect();
        let mut ids: Vec<LaneId> = sampled.lanes.lanes().iter().map(|lane| lane.id).collect();
        let n_before = ids.len();
        let more = near(&self.scene.lanes, &self.lane_bounds, &later, LANES_WITHIN_M);
        ids.extend(more.into_iter().filter(|id| sampled.lanes.get(*id).is_none()));
        (ids.len() > n_before).then(|| Arc::new(self.scene.lanes.subset(&ids)))
    }

    /// The last `n_history` timesteps of the world as the past of a scene of `n_timesteps`, with the plans of the
    /// agents of the event if it `knows_plans`, and the `expected` states of the ego; and the mask that shows just
    /// these.
    pub(in crate::simulate) fn window(
        &self,
        world: &World,
        expected: Option<&[State]>,
        knows_plans: bool,
        [n_history, n_timesteps]: [usize; 2],
    ) -> (Scene, ObservationMask) {
        let first = world.n_timesteps() - n_history;
        let mut scene = self.cut(world, first, n_timesteps, n_history);
        self.bring_in_arrivals(world, &mut scene);
        let planned = if knows_plans { self.planned.as_slice() } else { &[] };
        for agent_idx in planned.iter().copied().filter(|idx| world.present(*idx).is_some()) {
            let trajectory = &mut scene.tracks[agent_idx].trajectory;
            let entry = |(t, state): (usize, &Option<State>)| {
                if t < n_history { *state } else { self.plan(world, agent_idx, first + t) }
            };
            *trajectory = Trajectory::new(trajectory.entries().iter().enumerate().map(entry).collect());
        }
        if let Some(expected) = expected {
            let trajectory = &mut scene.tracks[self.ego_idx].trajectory;
            let past = trajectory.entries()[..n_history].iter().copied();
            let states = past.chain(expected.iter().map(|state| Some(*state))).take(n_timesteps).collect();
            *trajectory = Trajectory::new(states);
        }
        for track in &mut scene.tracks {
            track.trajectory = track.trajectory.with_velocities_from_positions(n_history, scene.dt_s);
        }
        let present: Vec<Vec2> = (0..scene.tracks.len()).filter_map(|i| world.present(i)).map(|s| s.position).collect();
        let ids = near(&self.scene.lanes, &self.lane_bounds, &present, LANES_WITHIN_M);
        if ids.len() < self.scene.lanes.lanes().len() {
            scene.lanes = Arc::new(self.scene.lanes.subset(&ids));
        }
        let mask = ObservationMask::from_fn(scene.tracks.len(), n_timesteps, |agent_idx, timestep| {
            let is_known = scene.state(agent_idx, timestep).is_some();
            timestep < n_history || (is_known && (agent_idx == self.ego_idx || planned.contains(&agent_idx)))
        });
        (scene, mask)
    }

    /// Leaves out the last tracks that have not arrived yet, and lets the others have come along as they arrived.
    fn bring_in_arrivals(&self, world: &World, scene: &mut Scene) {
        let n_before = scene.tracks.len() - self.arrivals.n_expected();
        let is_there = |idx: &usize| world.present(*idx).is_some();
        let n_kept = (n_before..scene.tracks.len()).rev().find(is_there).map_or(n_before, |idx| idx + 1);
        scene.tracks.truncate(n_kept);
        for track in &mut scene.tracks[n_before..] {
            track.trajectory = came_along(&track.trajectory, scene.dt_s);
        }
    }

    /// The planned state of an agent of the event at a timestep, while it follows the scenario.
    pub(in crate::simulate) fn plan(&self, world: &World, agent_idx: usize, timestep: usize) -> Option<State> {
        let is_planned = timestep <= world.plan_ends && self.planned.contains(&agent_idx);
        is_planned.then(|| match world.is_planned_anew(agent_idx) {
            true => world.planned(agent_idx, timestep),
            false => self.scene.state(agent_idx, timestep).copied(),
        })?
    }

    /// The state of an agent at a later timestep if it goes straight on at its present velocity.
    pub(in crate::simulate) fn straight_on(&self, world: &World, agent_idx: usize, timestep: usize) -> Option<State> {
        let later_s = (timestep - world.now()) as f64 * self.scene.dt_s;
        world.present(agent_idx).map(|now| State { position: now.position + now.velocity * later_s, ..now })
    }

    /// `n_timesteps` of the world from `first` on; states not reached yet are missing.
    fn cut(&self, world: &World, first: usize, n_timesteps: usize, n_history: usize) -> Scene {
        let track = |(agent_idx, track): (usize, &Track)| {
            let states = (first..first + n_timesteps).map(|timestep| world.state(agent_idx, timestep)).collect();
            Track { trajectory: Trajectory::new(states), ..track.clone() }
        };
        let tracks = self.scene.tracks.iter().enumerate().map(track).collect();
        Scene { tracks, n_timesteps, n_history, ego_idx: self.ego_idx, ..self.scene.clone() }
    }
}

/// The trajectory, extended to before its first state at the velocity of that one.
fn came_along(trajectory: &Trajectory, dt_s: f64) -> Trajectory {
    let Some((first, state)) = trajectory.valid().next().map(|(timestep, state)| (timestep, *state)) else {
        return trajectory.clone();
    };
    let entry = |(timestep, entry): (usize, &Option<State>)| {
        let before_s = first.checked_sub(timestep).map(|n_steps| n_steps as f64 * dt_s);
        before_s.map_or(*entry, |s| Some(State { position: state.position - state.velocity * s, ..state }))
    };
    Trajectory::new(trajectory.entries().iter().enumerate().map(entry).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulate::testing::{record, situation};

    #[test]
    fn a_window_shows_the_last_second_and_the_plan_of_the_event() {
        let situation = situation(&record());
        let mut world = situation.start(1);
        for timestep in world.n_timesteps()..world.n_timesteps() + 5 {
            world.push((0..situation.scene.tracks.len()).map(|idx| situation.scene.state(idx, timestep).copied()));
        }
        let (scene, mask) = situation.window(&world, None, true, [10, 40]);
        assert_eq!((scene.n_history, scene.n_timesteps, mask.n_timesteps()), (10, 40, 40));
        let planned = situation.planned[0];
        for (agent_idx, timestep, is_shown) in
            [(situation.ego_idx, 9, true), (situation.ego_idx, 10, false), (planned, 10, true), (planned, 39, false)]
        {
            assert_eq!(mask.is_observed(agent_idx, timestep), is_shown, "{agent_idx} at {timestep}");
            let state = scene.state(agent_idx, timestep).map(|state| state.position);
            let expected = situation.scene.state(agent_idx, timestep + 5).filter(|_| is_shown).map(|s| s.position);
            assert_eq!(state, expected);
        }
        let expected = vec![State::default(); 30];
        let (scene, mask) = situation.window(&world, Some(&expected), true, [10, 40]);
        assert!(mask.is_observed(situation.ego_idx, 39) && scene.state(situation.ego_idx, 9) != Some(&expected[0]));
        assert_eq!(scene.state(situation.ego_idx, 20).map(|state| state.position), Some(Vec2::ZERO));
    }
}

//! A situation whose event comes later.

use super::Situation;
use crate::scene::{Scene, State, Trajectory};

impl Situation {
    /// The situation with the other agents of the event `n_steps` timesteps later in everything they do. `None` if
    /// there are none, or one of them would overlap an agent in the past that was apart from it.
    pub(crate) fn delayed(&self, n_steps: usize) -> Option<Self> {
        let mut delayed = self.clone();
        for agent_idx in &self.planned {
            delayed.scene.tracks[*agent_idx].trajectory = later(&self.scene, *agent_idx, n_steps);
        }
        delayed.event = self.event.map(|timestep| timestep + n_steps);
        // The delay is intended, so the event is not aimed for.
        delayed.aims = false;
        delayed.look_at_present(&self.scene.state(self.ego_idx, self.scene.current_timestep()).copied()?);
        let meets = |situation: &Self, one: usize, other: usize, timestep: usize| {
            let [a, b] = [one, other].map(|idx| situation.scene.state(idx, timestep).map(|state| (idx, state)));
            a.zip(b).is_some_and(|(a, b)| situation.overlap([a, b]))
        };
        let is_free = |one: usize| {
            (0..self.scene.tracks.len()).filter(|other| *other != one).all(|other| {
                let mut past = 0..self.scene.n_history;
                past.all(|timestep| !meets(&delayed, one, other, timestep) || meets(self, one, other, timestep))
            })
        };
        (!self.planned.is_empty() && self.planned.iter().all(|idx| is_free(*idx))).then_some(delayed)
    }
}

/// The trajectory of an agent `n_steps` later; before, it comes along at its first velocity.
fn later(scene: &Scene, agent_idx: usize, n_steps: usize) -> Trajectory {
    let entries = scene.tracks[agent_idx].trajectory.entries();
    let first = entries.iter().enumerate().find_map(|(t, state)| state.map(|state| (t, state)));
    let entry = |timestep: usize| {
        let (t, state) = first?;
        match timestep.checked_sub(n_steps).filter(|before| *before >= t) {
            Some(before) => entries[before],
            None if timestep < t => None,
            None => {
                let missing_s = (t + n_steps - timestep) as f64 * scene.dt_s;
                Some(State { position: state.position - state.velocity * missing_s, ..state })
            }
        }
    };
    Trajectory::new((0..entries.len()).map(entry).collect())
}

#[cfg(test)]
mod tests {
    use crate::simulate::testing::{record, situation};

    #[test]
    fn the_others_of_the_event_come_later_along_the_same_path() {
        let situation = situation(&record());
        let other = situation.planned[0];
        let delayed = situation.delayed(3).unwrap();
        for t in 3..situation.scene.n_timesteps {
            assert_eq!(delayed.scene.state(other, t), situation.scene.state(other, t - 3));
        }
        let [first, second] = [0, 1].map(|t| *delayed.scene.state(other, t).unwrap());
        let missed_m = (second.position - first.position - first.velocity * situation.scene.dt_s).norm();
        assert!(missed_m < 1e-9 && delayed.event == situation.event.map(|t| t + 3));
        for idx in (0..situation.scene.tracks.len()).filter(|idx| *idx != other) {
            assert_eq!(delayed.scene.tracks[idx].trajectory, situation.scene.tracks[idx].trajectory);
        }
    }
}

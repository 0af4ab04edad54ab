//! The agents of a row and their frame, and the conversion of its samples to scenes.

use crate::geometry::{Transform2, Vec2, wrap_angle};
use crate::scene::{ObservationMask, STANDING_STEP_M, Scene, State, Track, Trajectory, velocity_at};

/// The agents of a row and the frame its coordinates are in.
#[derive(Debug, Clone, PartialEq)]
pub struct AgentFrame {
    /// From the scene frame to the row's ego frame.
    pub ego_from_scene: Transform2,
    /// Indices of the scene's tracks, in the order of the batch's agent axis.
    pub agents: Vec<usize>,
    pub(super) ego_idx: usize,
    pub(super) mask: ObservationMask,
    /// Whether headings that are not recorded follow from the motion instead of being generated.
    pub(super) derives_headings: bool,
    /// Whether the scene's dataset records headings.
    pub(super) has_headings: bool,
}

impl AgentFrame {
    /// Whether the mask observes this state of the scene's track.
    pub fn observed(&self, track_idx: usize, timestep: usize) -> bool {
        timestep < self.mask.n_timesteps() && self.mask.is_observed(track_idx, timestep)
    }

    /// The place on the batch's agent axis of the ego agent, if it is in the batch.
    pub fn ego_slot(&self) -> Option<usize> {
        self.slot(self.ego_idx)
    }

    /// Whether the heading of this track follows from its motion.
    pub(super) fn derives_heading(&self, track: &Track) -> bool {
        self.derives_headings && !(self.has_headings && track.class.has_recorded_heading())
    }

    /// The place on the batch's agent axis of the scene's track, if it is in the batch.
    pub fn slot(&self, track_idx: usize) -> Option<usize> {
        self.agents.iter().position(|agent| *agent == track_idx)
    }

    /// Puts decoded states (A, T, 3) of this row, in its ego frame, into a copy of `source`.
    pub(super) fn scene(
        &self,
        source: &Scene,
        states: &[Vec<Vec<f64>>],
        latent: &[Vec<u8>],
        with_heading: bool,
    ) -> Scene {
        let n_timesteps = states.first().map_or(source.n_timesteps, Vec::len);
        let scene_from_ego = self.ego_from_scene.inverse();
        let mut tracks: Vec<Track> = source.tracks.clone();
        for (agent_idx, track) in tracks.iter_mut().enumerate() {
            let slot = self.agents.iter().position(|agent| *agent == agent_idx);
            let mut entries: Vec<Option<State>> = vec![None; n_timesteps];
            for (timestep, entry) in entries.iter_mut().enumerate() {
                *entry = match slot {
                    Some(slot) if latent[slot][timestep] != 0 => {
                        let [x, y, heading_rad] = states[slot][timestep][..] else { continue };
                        let state = State {
                            position: Vec2::new(x, y),
                            heading_rad: wrap_angle(heading_rad),
                            velocity: Vec2::ZERO,
                        };
                        Some(state.transformed(&scene_from_ego))
                    }
                    _ if self.observed(agent_idx, timestep) => track.trajectory.get(timestep).copied(),
                    _ => None,
                };
            }
            if let Some(slot) = slot {
                hold_still(&mut entries, &latent[slot]);
                let with_heading = with_heading && !self.derives_heading(track);
                derive_motion(&mut entries, &latent[slot], source.dt_s, with_heading);
            }
            track.trajectory = Trajectory::new(entries);
        }
        Scene { tracks, n_timesteps, ..source.clone() }
    }
}

/// A step shorter than this is no motion, meters: 0.04 m/s at 10 Hz.
const STILL_STEP_M: f64 = 0.004;

/// Leaves out the steps of a sample that are too short to be motion, after the last observed state: who stands is
/// exactly still. What follows is shifted by the sum of the steps that were left out.
fn hold_still(entries: &mut [Option<State>], latent: &[u8]) {
    let n_entries = entries.len();
    let mut left_out = Vec2::ZERO;
    let first = (0..n_entries).rfind(|t| latent[*t] == 0 && entries[*t].is_some()).map_or(n_entries, |last| last + 1);
    for timestep in first..n_entries {
        let (before, Some(state)) = (entries[timestep - 1], entries[timestep]) else { continue };
        let mut held = State { position: state.position - left_out, ..state };
        if let Some(before) = before.filter(|before| held.position.distance(before.position) < STILL_STEP_M) {
            left_out = left_out + (held.position - before.position);
            held = State { position: before.position, heading_rad: before.heading_rad, ..held };
        }
        entries[timestep] = Some(held);
    }
}

/// Velocities of generated entries ([`velocity_at`]; 0 for one that stands alone) and, if requested, headings along the
/// motion.
fn derive_motion(entries: &mut [Option<State>], latent: &[u8], dt_s: f64, with_heading: bool) {
    for timestep in 0..entries.len() {
        if latent[timestep] == 0 {
            continue;
        }
        let position = |offset: isize| {
            let entry = timestep.checked_add_signed(offset).and_then(|t| entries.get(t));
            entry.copied().flatten().map(|state: State| state.position)
        };
        let velocity = velocity_at(position, dt_s).unwrap_or_default();
        let before = timestep.checked_sub(1).and_then(|t| entries[t]);
        let Some(state) = entries[timestep].as_mut() else { continue };
        state.velocity = velocity;
        if !with_heading {
            let held = before.map_or(state.heading_rad, |before| before.heading_rad);
            state.heading_rad = if velocity.norm() * dt_s > STANDING_STEP_M { velocity.angle() } else { held };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_stands_is_exactly_still_and_who_starts_loses_millimeters() {
        // Half a millimeter of noise about x = 2, then a start at 2 m/s².
        let noise = |t: usize| if t.is_multiple_of(2) { 0.0005 } else { -0.0005 };
        let at = |t: usize| 2.0 + noise(t) + 0.01 * (t.saturating_sub(6) as f64).powi(2);
        let state =
            |t: usize| Some(State { position: Vec2::new(at(t), 0.0), heading_rad: noise(t), ..State::default() });
        let mut entries: Vec<Option<State>> = (0..12).map(state).collect();
        let mut latent = [1; 12];
        latent[..2].fill(0);
        hold_still(&mut entries, &latent);
        assert_eq!(entries[0], state(0));
        for entry in &entries[2..7] {
            assert_eq!(*entry, state(1), "as it was last observed");
        }
        for (t, entry) in entries.iter().enumerate().skip(7) {
            let shift_m = entry.unwrap().position.x - at(t);
            assert!(shift_m.abs() < 0.004, "{t}: {shift_m}");
        }
        // Up to an observed state nothing moves, lest it be missed.
        let mut entries: Vec<Option<State>> = (0..12).map(state).collect();
        latent[11] = 0;
        hold_still(&mut entries, &latent);
        assert_eq!(entries, (0..12).map(state).collect::<Vec<_>>());
        // Without anything observed, too.
        hold_still(&mut entries, &[1; 12]);
        assert_eq!(entries, (0..12).map(state).collect::<Vec<_>>());
    }

    #[test]
    fn velocities_are_those_at_the_timesteps() {
        // x = 3 t + 2 t², observed at first: a speed of 3 + 4 t.
        let at = |t: usize| 3.0 * (0.1 * t as f64) + 2.0 * (0.1 * t as f64).powi(2);
        let state =
            |t: usize| State { position: Vec2::new(at(t), 0.0), velocity: Vec2::new(9.0, 9.0), ..State::default() };
        let mut entries: Vec<Option<State>> = (0..7).map(|t| (t != 3).then(|| state(t))).collect();
        derive_motion(&mut entries, &[0, 1, 1, 1, 1, 1, 1], 0.1, false);
        assert_eq!(entries[0].unwrap().velocity, Vec2::new(9.0, 9.0), "observed states stay as they are");
        // Before and after the gap there are two positions in a row, or three.
        for t in [1, 2, 4, 5, 6] {
            let found = entries[t].unwrap().velocity;
            assert!(found.distance(Vec2::new(3.0 + 0.4 * t as f64, 0.0)) < 1e-9, "{t}: {found:?}");
        }
        let mut lonely = vec![None, Some(state(1)), Some(state(2)), None, Some(state(4))];
        derive_motion(&mut lonely, &[1; 5], 0.1, false);
        let speeds: Vec<f64> = lonely.iter().flatten().map(State::speed_mps).collect();
        assert!(
            speeds.iter().zip([3.6, 3.6, 0.0]).all(|(found, expected)| (found - expected).abs() < 1e-9),
            "{speeds:?}"
        );
    }
}

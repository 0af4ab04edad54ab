//! The agents of a row and their frame, and the conversion of its samples to scenes.

use super::ending::{HeadingSource, derive_motion, hold_still, stands_still, stay, turn_into_motion};
use super::forward::{drives_forward, stay_forward};
use super::lane_keeping::lane_keepers;
use crate::geometry::{Transform2, Vec2, wrap_angle};
use crate::scene::{ObservationMask, Scene, State, Track, Trajectory};

/// The agents of a row and the frame its coordinates are in.
#[derive(Debug, Clone, PartialEq)]
pub struct AgentFrame {
    /// Maps the scene frame to the row's ego frame.
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
        let observed = |agent_idx: usize, track: &Track| -> Vec<Option<State>> {
            let state = |t| track.trajectory.get(t).filter(|_| self.observed(agent_idx, t)).copied();
            (0..n_timesteps).map(state).collect()
        };
        let given: Vec<Vec<Option<State>>> =
            source.tracks.iter().enumerate().map(|(agent_idx, track)| observed(agent_idx, track)).collect();
        let holds = stands_still(&given);
        let keepers = lane_keepers(source, &given);
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
                if let Some(keeper) = &keepers[agent_idx] {
                    keeper.keep(&mut entries, &latent[slot]);
                }
                stay(&mut entries, &latent[slot], source.dt_s);
                if drives_forward(track) {
                    stay_forward(&mut entries, &latent[slot]);
                }
                if holds {
                    hold_still(&mut entries, &latent[slot], source.dt_s);
                }
                let has_headings = source.source.dataset.facts().has_headings;
                let headings = match with_heading && !self.derives_heading(track) {
                    true => HeadingSource::Generated,
                    false if has_headings || !track.class.has_recorded_heading() => HeadingSource::Velocity,
                    false => HeadingSource::Motion,
                };
                derive_motion(&mut entries, &latent[slot], source.dt_s, headings);
                if headings == HeadingSource::Generated && track.class.is_motorized() {
                    turn_into_motion(&mut entries, &latent[slot], source.dt_s, track.extent_or_nominal().length_m);
                }
            }
            track.trajectory = Trajectory::new(entries);
        }
        Scene { tracks, n_timesteps, ..source.clone() }
    }
}

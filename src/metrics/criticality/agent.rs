//! The boxes and velocities of an agent, for measures of criticality.

use crate::behavior::swept_boxes::SweptBoxes;
use crate::geometry::Vec2;
use crate::scene::{Scene, Trajectory};

/// The boxes and velocities of one agent, one entry a timestep.
pub(super) struct MovingAgent {
    pub(super) agent_idx: usize,
    pub(super) sweep: SweptBoxes,
    velocities: Vec<Option<Vec2>>,
}

impl MovingAgent {
    /// An agent of `scene`; `None` if there is no such agent, or none of its states is finite.
    pub(super) fn of(scene: &Scene, agent_idx: usize) -> Option<Self> {
        let track = scene.tracks.get(agent_idx)?;
        let sweep = SweptBoxes::new(track)?;
        Some(Self { agent_idx, sweep, velocities: velocities(&track.trajectory, scene.dt_s) })
    }

    /// Its velocity at `timestep`, meters per second.
    pub(super) fn velocity(&self, timestep: usize) -> Option<Vec2> {
        self.velocities.get(timestep).copied().flatten()
    }
}

/// Velocities from positions: central differences; one-sided differences at the ends of the track; the state's own
/// velocity if it has no neighbor.
fn velocities(trajectory: &Trajectory, dt_s: f64) -> Vec<Option<Vec2>> {
    let velocity = |timestep: usize| {
        let now = trajectory.get(timestep).filter(|state| state.is_finite())?;
        let neighbor = |other: Option<usize>| trajectory.get(other?).filter(|state| state.is_finite());
        let (before, after) = (neighbor(timestep.checked_sub(1)), neighbor(Some(timestep + 1)));
        let span = usize::from(before.is_some()) + usize::from(after.is_some());
        if span == 0 {
            return Some(now.velocity);
        }
        Some((after.unwrap_or(now).position - before.unwrap_or(now).position) * (1.0 / (span as f64 * dt_s)))
    };
    (0..trajectory.n_timesteps()).map(velocity).collect()
}

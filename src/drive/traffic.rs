//! What becomes of traffic over a drive: how many are there, and how often do they drive into each other?

use super::situation::Situation;
use super::world::World;
use crate::metrics::collisions;
use serde::{Deserialize, Serialize};

/// The stretches of a drive over which traffic is counted, seconds after the present.
pub const BANDS_S: [[f64; 2]; 3] = [[0.0, 2.0], [2.0, 5.0], [5.0, 8.0]];

/// Counts over drives, by stretch.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Traffic {
    /// Seconds that agents were there, all together.
    pub agent_s: [f64; 3],
    /// Seconds that were driven.
    pub driven_s: [f64; 3],
    /// Agents that drive into another for the first time, of pairs that do not touch at present and of which one moves.
    pub n_collided: [u64; 3],
}

impl Traffic {
    /// The traffic of a drive.
    pub(super) fn of(situation: &Situation, world: &World) -> Self {
        let (scene, mut traffic) = (situation.driven(world), Self::default());
        let since_s = |timestep: usize| (timestep - scene.current_timestep()) as f64 * scene.dt_s;
        let band = |timestep: usize| BANDS_S.iter().position(|[_, end_s]| since_s(timestep) < end_s + 1e-9);
        for timestep in scene.n_history..scene.n_timesteps {
            let Some(band) = band(timestep) else { continue };
            let n_there = scene.tracks.iter().filter(|track| track.trajectory.is_valid(timestep)).count();
            traffic.agent_s[band] += n_there as f64 * scene.dt_s;
            traffic.driven_s[band] += scene.dt_s;
        }
        let mut first: Vec<Option<usize>> = vec![None; scene.tracks.len()];
        for collision in collisions(&scene) {
            for agent_idx in collision.pair {
                let known = first[agent_idx].unwrap_or(usize::MAX);
                first[agent_idx] = Some(known.min(collision.timestep));
            }
        }
        first.into_iter().flatten().filter_map(band).for_each(|band| traffic.n_collided[band] += 1);
        traffic
    }

    /// Both together.
    #[must_use]
    pub fn with(mut self, other: &Self) -> Self {
        for band in 0..BANDS_S.len() {
            self.agent_s[band] += other.agent_s[band];
            self.driven_s[band] += other.driven_s[band];
            self.n_collided[band] += other.n_collided[band];
        }
        self
    }
}

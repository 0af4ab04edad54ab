//! The moment of a cut-in: how fast, how close, from which side?

use super::BehaviorEvent;
use super::driven_path::DrivenPath;
use crate::geometry::Vec2;
use crate::scene::Scene;

/// Speeds below this count as standing, m/s: a quotient by them would have no meaning.
const STANDING_MPS: f64 = 0.1;

/// The relation of two agents when one intrudes on the path of the other. The fields are the parameters with these
/// names of [`super::CutIn`] and [`super::CutInPaper`].
#[derive(Debug, Clone, Copy)]
pub(super) struct Intrusion {
    pub(super) ego_speed_mps: f64,
    pub(super) other_speed_mps: f64,
    pub(super) relative_speed_mps: f64,
    pub(super) gap_m: f64,
    pub(super) lateral_speed_mps: f64,
    pub(super) side: f64,
    pub(super) ego_length_m: f64,
    pub(super) other_length_m: f64,
    pub(super) shift_m: Option<f64>,
}

impl Intrusion {
    /// The intrusion of `other` at `timestep` into the future path of the ego. `None` if either of the two is not
    /// tracked then.
    pub(super) fn at(scene: &Scene, [ego_idx, other_idx]: [usize; 2], timestep: usize) -> Option<Self> {
        let (ego, other) = (&scene.tracks[ego_idx], &scene.tracks[other_idx]);
        let (ego_state, other_state) = (ego.trajectory.get(timestep)?, other.trajectory.get(timestep)?);
        let path = DrivenPath::from(ego, timestep)?;
        let place = path.project(other_state.position)?;
        let along = Vec2::from_angle(place.heading_rad);
        let other_box = other.footprint(other_state);
        let side = if place.offset_m < 0.0 { -1.0 } else { 1.0 };
        Some(Self {
            ego_speed_mps: ego_state.speed_mps(),
            other_speed_mps: other_state.speed_mps(),
            relative_speed_mps: ego_state.speed_mps() - other_state.velocity.dot(along),
            gap_m: path.gap_m(&other_box)?,
            lateral_speed_mps: -side * along.cross(other_state.velocity),
            side,
            ego_length_m: ego.footprint(ego_state).length_m,
            other_length_m: other_box.length_m,
            shift_m: shift_m(scene, other_idx, -side),
        })
    }

    /// Adds the parameters to an event.
    pub(super) fn describe(&self, event: BehaviorEvent) -> BehaviorEvent {
        let is_ahead = self.gap_m >= 0.0;
        let time_s = |speed_mps: f64| (is_ahead && speed_mps > STANDING_MPS).then(|| self.gap_m / speed_mps);
        event
            .with("ego_speed_mps", self.ego_speed_mps)
            .with("other_speed_mps", self.other_speed_mps)
            .with("relative_speed_mps", self.relative_speed_mps)
            .with("gap_m", self.gap_m)
            .with("ttc_s", time_s(self.relative_speed_mps))
            .with("time_headway_s", time_s(self.ego_speed_mps))
            .with("lateral_speed_mps", self.lateral_speed_mps)
            .with("side", self.side)
            .with("ego_length_m", self.ego_length_m)
            .with("other_length_m", self.other_length_m)
            .with("shift_m", self.shift_m)
    }
}

/// The largest distance that the agent moves in the future to one side (+1 left, -1 right) of the line along its
/// heading at present, meters. `None` if it is not tracked at present or has no future.
fn shift_m(scene: &Scene, agent_idx: usize, toward: f64) -> Option<f64> {
    let start = scene.state(agent_idx, scene.current_timestep())?;
    let forward = Vec2::from_angle(start.heading_rad);
    let moved_m = |timestep: usize| {
        let state = scene.state(agent_idx, timestep)?;
        Some(toward * forward.cross(state.position - start.position))
    };
    (scene.n_history..scene.n_timesteps).filter_map(moved_m).reduce(f64::max)
}

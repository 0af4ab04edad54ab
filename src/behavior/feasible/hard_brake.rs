//! How hard can a vehicle still brake?

use crate::behavior::hard_brake::HardBrake;
use crate::behavior::outcome::Outcome;
use crate::scene::Scene;

/// The hardest braking that can be requested, m/s².
const HARDEST_MPS2: f64 = 8.0;
/// Spacing of the decelerations, m/s².
const SPACING_MPS2: f64 = 0.5;
/// The shortest duration of hard braking, including the smoothing of speeds, seconds.
const LEAST_S: f64 = 0.6;

impl HardBrake {
    /// Decelerations that the agent can keep up long enough from its present speed. Empty if it is too slow.
    pub(in crate::behavior) fn outcomes(&self, scene: &Scene, agent_idx: usize) -> Vec<Outcome> {
        let state = scene.state(agent_idx, scene.current_timestep()).filter(|state| state.is_finite());
        let Some(speed_mps) = state.map(crate::scene::State::speed_mps) else { return Vec::new() };
        let config = self.config();
        if speed_mps < config.min_speed_mps || !config.agents.admits(scene.tracks[agent_idx].class) {
            return Vec::new();
        }
        let n = ((HARDEST_MPS2 - config.min_deceleration_mps2) / SPACING_MPS2).floor().max(0.0) as usize;
        let decelerations = (0..=n).map(|i| config.min_deceleration_mps2 + i as f64 * SPACING_MPS2);
        let possible = decelerations.filter(|mps2| mps2 * LEAST_S.max(config.min_duration_s) <= speed_mps);
        let outcome = |mps2: f64| {
            Outcome::default().with("max_deceleration_mps2", mps2).at_effort((mps2 / HARDEST_MPS2).min(1.0))
        };
        possible.map(outcome).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::super::outcomes;
    use crate::behavior::{HardBrake, HardBrakeConfig};
    use crate::scene::LaneGraph;
    use crate::scene::testing::Drive;

    #[test]
    fn the_slower_the_less() {
        let hardest = |speed_mps: f64| {
            let behavior = HardBrake::new(HardBrakeConfig::default());
            let drives = [Drive::straight(0.0, 0.0, 0.0, speed_mps)];
            let found = outcomes(&behavior, &drives, LaneGraph::default(), &[0]);
            found.iter().filter_map(|outcome| outcome.get("max_deceleration_mps2")).reduce(f64::max)
        };
        assert_eq!((hardest(2.0), hardest(3.5), hardest(12.0)), (None, Some(5.5), Some(8.0)));
    }
}

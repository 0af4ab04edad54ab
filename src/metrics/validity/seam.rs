//! Checks of the seams between given and generated states.

use super::check::exceeds;
use super::{Check, Judged, ValidityConfig, Violation, keep_worse};
use crate::geometry::{Vec2, angle_difference};
use crate::scene::State;

/// Motion is extrapolated from the mean velocity over at most so many timesteps.
const N_BEFORE: usize = 3;

/// Jumps in position and heading between a given state and a generated one, in either order.
pub(super) fn violations(judged: &Judged<'_>, config: &ValidityConfig) -> Vec<Violation> {
    let scene = judged.scene;
    let (mut position, mut heading) = (None, None);
    for agent_idx in judged.generated_agents() {
        for timestep in 1..scene.n_timesteps {
            let is_seam = judged.is_generated(agent_idx, timestep) != judged.is_generated(agent_idx, timestep - 1);
            let state = |timestep: usize| scene.state(agent_idx, timestep).filter(|state| state.is_finite());
            let (Some(now), Some(before)) = (state(timestep).filter(|_| is_seam), state(timestep - 1)) else {
                continue;
            };
            let earlier: Vec<&State> = (2..=N_BEFORE + 1).map_while(|n| state(timestep.checked_sub(n)?)).collect();
            let step = match earlier.last() {
                Some(first) => (before.position - first.position) * (1.0 / earlier.len() as f64),
                None => before.velocity * scene.dt_s,
            };
            let mut check = |check: Check, value: f64, limit: f64| {
                if exceeds(value, limit) {
                    let worst = if check == Check::StartPosition { &mut position } else { &mut heading };
                    keep_worse(worst, Violation::new(check, scene, agent_idx, timestep, (value, limit)));
                }
            };
            let expected: Vec2 = before.position + step;
            check(Check::StartPosition, now.position.distance(expected), config.max_start_offset_m);
            if judged.is_vehicle(agent_idx) {
                let turn_rad = angle_difference(now.heading_rad, before.heading_rad).abs();
                check(Check::StartHeading, turn_rad, config.max_start_turn_rad);
            }
        }
    }
    position.into_iter().chain(heading).collect()
}

//! Checks of the seams between given and generated states.

use super::check::exceeds;
use super::{Check, Judged, ValidityConfig, Violation, keep_worse};
use crate::geometry::{Vec2, angle_difference};
use crate::scene::State;

/// Largest change of acceleration within two timesteps, m/s², beyond the largest one among the given states of the
/// vehicle, which shows how smooth its recording is.
const MAX_START_ACCELERATION_MPS2: f64 = 2.0;
/// An agent slower than this around the present, m/s, moves off or stops, and may do so at once.
const IN_MOTION_MPS: f64 = 0.5;
/// Motion is extrapolated from the mean velocity over at most this many timesteps.
const N_BEFORE: usize = 3;

/// Jumps in position and heading between an observed state and a generated one, in either order, and in acceleration
/// where generated states begin.
pub(super) fn violations(judged: &Judged<'_>, config: &ValidityConfig) -> Vec<Violation> {
    let scene = judged.scene;
    let mut worst: [Option<Violation>; 3] = [const { None }; 3];
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
                    let place = &mut worst[check as usize - Check::StartPosition as usize];
                    keep_worse(place, Violation::new(check, scene, agent_idx, timestep, (value, limit)));
                }
            };
            let expected: Vec2 = before.position + step;
            check(Check::StartPosition, now.position.distance(expected), config.max_start_offset_m);
            if judged.is_vehicle(agent_idx) {
                let turn_rad = angle_difference(now.heading_rad, before.heading_rad).abs();
                check(Check::StartHeading, turn_rad, config.max_start_turn_rad);
                if let Some(beyond_mps2) = acceleration_step(judged, agent_idx, timestep) {
                    check(Check::StartAcceleration, beyond_mps2, MAX_START_ACCELERATION_MPS2);
                }
            }
        }
    }
    worst.into_iter().flatten().collect()
}

/// The change of acceleration from before `timestep`, the first generated one, to the two timesteps after, beyond the
/// largest such change among the observed states before, m/s². `None` if there are too few states, or the vehicle moves
/// off or stops in them.
fn acceleration_step(judged: &Judged<'_>, agent_idx: usize, timestep: usize) -> Option<f64> {
    let (scene, first) = (judged.scene, timestep.checked_sub(N_BEFORE)?);
    let acceleration = |from: usize| -> Option<Vec2> {
        let position = |timestep: usize| scene.state(agent_idx, timestep).map(|state| state.position);
        let bend = position(from)? - position(from + 1)? * 2.0 + position(from + 2)?;
        Some(bend * (1.0 / (scene.dt_s * scene.dt_s)))
    };
    // Changes from the acceleration over three states to those one and two timesteps later.
    let change = |from: usize| -> Option<f64> {
        let now = acceleration(from)?;
        Some(now.distance(acceleration(from + 1)?).max(now.distance(acceleration(from + 2)?)))
    };
    let is_given = |timestep: usize| !judged.is_generated(agent_idx, timestep);
    let of_given = (0..first.saturating_sub(1)).filter(|from| (*from..=from + 4).all(is_given)).filter_map(change);
    let is_start = judged.is_generated(agent_idx, timestep) && (first..timestep).all(is_given);
    let step_m = |from: usize| -> Option<f64> {
        Some(scene.state(agent_idx, from)?.position.distance(scene.state(agent_idx, from + 1)?.position))
    };
    if (first..timestep + 1).filter_map(step_m).any(|step_m| step_m < IN_MOTION_MPS * scene.dt_s) {
        return None;
    }
    Some(change(first).filter(|_| is_start)? - of_given.fold(0.0, f64::max))
}

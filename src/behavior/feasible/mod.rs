//! Which events can agents still show? Judged from the past, the map and the limits of driving, never from the recorded
//! future.
//!
//! One behavior per file; cut-in and near miss have theirs in their own folders.

mod collision;
mod courses;
mod cut_out;
mod hard_brake;
mod lane_change;
mod pedestrian_steps_out;
mod tailgating;
mod turn;
mod ways;

pub(super) use turn::outcomes as turn_outcomes;
pub(super) use ways::{Way, ways};

/// The limits of braking and accelerating, m/s².
pub(super) const ACCELERATIONS_MPS2: std::ops::RangeInclusive<f64> = -4.0..=2.5;
/// The limit of lateral acceleration, m/s².
pub(super) const LATERAL_ACCELERATION_MPS2: f64 = 2.0;

/// The share of the limits that an acceleration takes.
pub(super) fn effort(acceleration_mps2: f64) -> f64 {
    let limit = if acceleration_mps2 < 0.0 { *ACCELERATIONS_MPS2.start() } else { *ACCELERATIONS_MPS2.end() };
    acceleration_mps2 / limit
}

/// Distance and speed of an agent that accelerates or brakes; once it stands, it stays.
pub(super) fn driven(speed_mps: f64, acceleration_mps2: f64, time_s: f64) -> (f64, f64) {
    let moving_s = if acceleration_mps2 < 0.0 { time_s.min(-speed_mps / acceleration_mps2) } else { time_s };
    let then_mps = speed_mps + acceleration_mps2 * moving_s;
    (f64::midpoint(speed_mps, then_mps) * moving_s, then_mps)
}

/// The time from the present to the end of a scene, seconds.
pub(super) fn horizon_s(scene: &crate::scene::Scene) -> f64 {
    scene.n_timesteps.saturating_sub(scene.n_history) as f64 * scene.dt_s
}

/// A behavior in a scene with 4 s of future.
#[cfg(test)]
pub(super) fn outcomes(
    behavior: &dyn super::Behavior,
    drives: &[crate::scene::testing::Drive],
    lanes: crate::scene::LaneGraph,
    agents: &[usize],
) -> Vec<super::Outcome> {
    let mut scene = crate::scene::testing::scene(drives);
    scene.dt_s = 0.5;
    scene.lanes = lanes.into();
    outcomes_of(behavior, &scene, agents)
}

/// A behavior in this scene, which is the same whatever the recorded future.
#[cfg(test)]
fn outcomes_of(behavior: &dyn super::Behavior, scene: &crate::scene::Scene, agents: &[usize]) -> Vec<super::Outcome> {
    let mut unknown = scene.clone();
    for track in &mut unknown.tracks {
        let observed = |t: usize| track.trajectory.get(t).copied().filter(|_| t < scene.n_history);
        track.trajectory = crate::scene::Trajectory::new((0..scene.n_timesteps).map(observed).collect());
    }
    let found = behavior.feasible(scene, agents);
    assert_eq!(found, behavior.feasible(&unknown, agents), "the recorded future was looked at");
    found
}

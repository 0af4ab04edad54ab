//! Checks of a vehicle's motion, by polynomials fitted to its path.

use super::check::exceeds;
use super::fit::Fitter;
use super::{Check, Judged, LocalFit, ValidityConfig, Violation, keep_worse};
use crate::geometry::{Vec2, angle_difference};
use crate::scene::{State, Track};

/// Positions and headings are fitted over this time, seconds: long enough for noise to fade, shorter than a brake.
const WINDOW_S: f64 = 0.7;
/// Added to the largest yaw rate, rad/s, so that noise of agents that stand or creep does not count.
const YAW_RATE_SLACK_RADPS: f64 = 0.2;
/// Below this speed the heading is taken as the direction of motion, m/s.
const MOVING_MPS: f64 = 1.0;
/// Below this speed the angle between heading and motion is not checked, m/s: a maneuvering vehicle may go backward.
const SLIP_FROM_MPS: f64 = 2.0;

/// The checks of motion that vehicles fail, each at its worst place.
pub(super) fn violations(judged: &Judged<'_>, config: &ValidityConfig) -> Vec<Violation> {
    let scene = judged.scene;
    let fitter = Fitter::new(WINDOW_S, scene.dt_s);
    let mut worst: [Option<Violation>; Check::ALL.len()] = [const { None }; Check::ALL.len()];
    for agent_idx in judged.generated_agents().filter(|agent_idx| judged.is_vehicle(*agent_idx)) {
        let track = &scene.tracks[agent_idx];
        let (mut generated, mut given_slip_rad) = (Vec::new(), 0.0_f64);
        for middle in fitter.half..scene.n_timesteps.saturating_sub(fitter.half) {
            let trajectory = &track.trajectory;
            let (Some(fit), Some(state)) = (fitter.at(trajectory, middle), trajectory.get(middle)) else { continue };
            let slip_rad = unexplained_slip_rad(&fit, state, track);
            let mut window = middle - fitter.half..=middle + fitter.half;
            match window.any(|timestep| judged.is_generated(agent_idx, timestep)) {
                true => generated.push((middle, fit, state, slip_rad)),
                false => given_slip_rad = given_slip_rad.max(slip_rad),
            }
        }
        for (middle, fit, state, slip_rad) in generated {
            let slip = (Check::Heading, slip_rad - given_slip_rad, config.max_slip_rad);
            for (check, value, limit) in limits(&fit, state, config).into_iter().chain([slip]) {
                if exceeds(value, limit) {
                    let violation = Violation::new(check, scene, agent_idx, middle, (value, limit));
                    keep_worse(&mut worst[check as usize], violation);
                }
            }
        }
    }
    worst.into_iter().flatten().collect()
}

fn limits(fit: &LocalFit, state: &State, config: &ValidityConfig) -> [(Check, f64, f64); 6] {
    let speed_mps = fit.velocity.norm();
    let forward = match speed_mps >= MOVING_MPS {
        true => fit.velocity * (1.0 / speed_mps),
        false => Vec2::from_angle(state.heading_rad),
    };
    let (along, yaw_rate) = (fit.acceleration.dot(forward), fit.yaw_rate_radps.abs());
    let tightest = config.max_curvature_per_m * speed_mps + YAW_RATE_SLACK_RADPS;
    [
        (Check::Acceleration, along, config.max_acceleration_mps2),
        (Check::Deceleration, -along, config.max_deceleration_mps2),
        (Check::LateralAcceleration, forward.cross(fit.acceleration).abs(), config.max_lateral_acceleration_mps2),
        (Check::Jerk, fit.jerk.norm(), config.max_jerk_mps3),
        (Check::YawRate, yaw_rate, config.max_yaw_rate_radps),
        (Check::Curvature, yaw_rate, tightest),
    ]
}

/// The angle between motion and heading beyond that of a vehicle that turns about a point of its axis between its ends,
/// radians: at a yaw rate ω and a speed v, the center moves at tan β = l ω / v to the heading where that point is l
/// behind it, such as a rear axle. (Simulators may steer the front end along the lane.) 0 for slow vehicles.
fn unexplained_slip_rad(fit: &LocalFit, state: &State, track: &Track) -> f64 {
    let speed_mps = fit.velocity.norm();
    if speed_mps < SLIP_FROM_MPS {
        return 0.0;
    }
    let slip_rad = angle_difference(fit.velocity.angle(), state.heading_rad).abs();
    let turning_rad = (track.extent_or_nominal().length_m / 2.0 * fit.yaw_rate_radps / speed_mps).atan().abs();
    (slip_rad - turning_rad).max(0.0)
}

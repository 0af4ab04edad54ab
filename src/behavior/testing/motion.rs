//! The motion of a written-down agent: from a start pose through segments of steady acceleration, turning and shifting.

use crate::geometry::{Vec2, wrap_angle};
use crate::scene::State;
use serde::Deserialize;
use std::f64::consts::TAU;

/// Steps of integration within a timestep.
const SUBSTEPS: usize = 20;

/// The state of an agent at timestep 0.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Start {
    x_m: f64,
    y_m: f64,
    #[serde(default)]
    heading_deg: f64,
    speed_mps: f64,
}

/// A piece of an agent's motion; after the last one it goes on straight at its speed.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Segment {
    duration_s: f64,
    /// Along the motion; a stopped agent stays stopped.
    #[serde(default)]
    acceleration_mps2: f64,
    /// Change of heading over the segment, positive to the left, spread evenly.
    #[serde(default)]
    turn_deg: f64,
    /// Sideways move over the segment, positive to the left, on a smooth curve.
    #[serde(default)]
    shift_m: f64,
}

pub(crate) fn drive(start: &Start, segments: &[Segment], dt_s: f64, n_timesteps: usize) -> Vec<State> {
    let rest = Segment { duration_s: f64::INFINITY, acceleration_mps2: 0.0, turn_deg: 0.0, shift_m: 0.0 };
    let mut segments = segments.iter().chain([&rest]);
    let mut segment = segments.next().expect("there is always the rest");
    let (mut position, mut heading_rad, mut speed_mps) =
        (Vec2::new(start.x_m, start.y_m), start.heading_deg.to_radians(), start.speed_mps);
    let mut elapsed_s = 0.0;
    let mut states = Vec::new();
    let step_s = dt_s / SUBSTEPS as f64;
    for substep in 0..n_timesteps * SUBSTEPS {
        // A sideways move of d over time T follows d (u - sin(2πu) / 2π) with u = time / T: it starts and ends gently.
        let lateral_mps = match segment.duration_s.is_finite() {
            true => segment.shift_m / segment.duration_s * (1.0 - (TAU * elapsed_s / segment.duration_s).cos()),
            false => 0.0,
        };
        let velocity = Vec2::new(speed_mps, lateral_mps).rotated(heading_rad);
        if substep % SUBSTEPS == 0 {
            let facing_rad = if speed_mps > 0.0 { velocity.angle() } else { heading_rad };
            states.push(State { position, heading_rad: wrap_angle(facing_rad), velocity });
        }
        position = position + velocity * step_s;
        if segment.duration_s.is_finite() {
            heading_rad += segment.turn_deg.to_radians() * step_s / segment.duration_s;
        }
        speed_mps = (speed_mps + segment.acceleration_mps2 * step_s).max(0.0);
        elapsed_s += step_s;
        if elapsed_s >= segment.duration_s - 1e-9 {
            segment = segments.next().expect("the rest never ends");
            elapsed_s = 0.0;
        }
    }
    states
}

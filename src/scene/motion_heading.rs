//! Headings of agents with recorded positions only.

use crate::geometry::Vec2;

/// Once an agent has moved this far, meters, its heading is the direction of its velocity above this speed, m/s. At
/// lower speeds, at which the velocity is too noisy, it is the direction from the last position that far away; if the
/// agent is slower still, it is held.
const HEADING_DISTANCE_M: f64 = 2.0;
const VELOCITY_HEADING_SPEED_MPS: f64 = 2.0;
const MIN_HEADING_SPEED_MPS: f64 = 0.5;

/// The heading that follows from the motion to `position`, radians, with the positions `before` it, latest first.
/// `None` if the agent is too slow or has moved too little: it then keeps its last heading.
pub fn motion_heading(position: Vec2, velocity: Vec2, before: impl IntoIterator<Item = Vec2>) -> Option<f64> {
    let speed_mps = velocity.norm();
    if speed_mps < MIN_HEADING_SPEED_MPS {
        return None;
    }
    let far = before.into_iter().find(|before| before.distance(position) >= HEADING_DISTANCE_M)?;
    Some(if speed_mps >= VELOCITY_HEADING_SPEED_MPS { velocity } else { position - far }.angle())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slow_velocities_do_not_turn_the_heading() {
        let passed = |spacing_m: f64| (1..=20).map(move |step| Vec2::new(-spacing_m * f64::from(step), 0.0));
        for (spacing_m, velocity, expected) in [
            (0.5, Vec2::new(5.0, 1.0), Some(0.2_f64.atan())),
            (0.15, Vec2::new(1.5, 0.3), Some(0.0)),
            (0.15, Vec2::new(0.4, 0.0), None),
            (0.05, Vec2::new(5.0, 1.0), None),
        ] {
            let found = motion_heading(Vec2::ZERO, velocity, passed(spacing_m));
            assert!(
                found.map_or(expected.is_none(), |found| expected.is_some_and(|angle| (found - angle).abs() < 1e-12)),
                "{spacing_m} m, {velocity:?}: {found:?}"
            );
        }
    }
}

//! Turns the action of a planner into states of the ego, or says why that is impossible.

use super::protocol::Action;
use crate::geometry::{Transform2, Vec2, wrap_angle};
use crate::scene::State;
use crate::simulate::{most_curvature_1pm, moved};

/// The limits of the bicycle model beside its curvature: acceleration and deceleration, m/s².
const MOST_MPS2: f64 = 5.0;
const HARDEST_MPS2: f64 = 9.0;

/// The next `n_steps` states of an ego of this length, meters, whose present state is `now`, in the scene frame.
pub(super) fn states(
    action: &Action,
    now: &State,
    world_from_scene: &Transform2,
    (length_m, dt_s): (f64, f64),
    n_steps: usize,
) -> Result<Vec<State>, String> {
    match action {
        Action { trajectory: Some(points), acceleration_mps2: None, curvature_1pm: None } => {
            follow(points, now, world_from_scene, (length_m, dt_s), n_steps)
        }
        Action { trajectory: None, acceleration_mps2: Some(acceleration), curvature_1pm } => {
            let curvature = curvature_1pm.unwrap_or(0.0);
            match acceleration.is_finite() && curvature.is_finite() {
                true => Ok(steer(now, [*acceleration, curvature], dt_s, n_steps)),
                false => Err("acceleration_mps2 or curvature_1pm is not finite".to_owned()),
            }
        }
        _ => Err("expected either trajectory or acceleration_mps2 (with curvature_1pm)".to_owned()),
    }
}

/// The states of a trajectory if a vehicle could drive it.
fn follow(
    points: &[[f64; 3]],
    now: &State,
    world_from_scene: &Transform2,
    (length_m, dt_s): (f64, f64),
    n_steps: usize,
) -> Result<Vec<State>, String> {
    if points.len() < n_steps {
        return Err(format!("the trajectory has {} points, expected at least {n_steps}", points.len()));
    }
    let mut before = *now;
    let next = |(i, point): (usize, &[f64; 3])| {
        let state = moved(&before, *point, world_from_scene, (length_m, dt_s));
        before = state.map_err(|why| format!("point {i} of the trajectory: {why}"))?;
        Ok(before)
    };
    points.iter().take(n_steps).enumerate().map(next).collect()
}

/// The states of a bicycle model within its limits.
fn steer(now: &State, [acceleration, curvature]: [f64; 2], dt_s: f64, n_steps: usize) -> Vec<State> {
    let acceleration = acceleration.clamp(-HARDEST_MPS2, MOST_MPS2);
    let mut state = *now;
    let mut speed_mps = now.velocity.dot(Vec2::from_angle(now.heading_rad)).max(0.0);
    let step = |_| {
        let then_mps = (speed_mps + acceleration * dt_s).max(0.0);
        let moved_m = f64::midpoint(speed_mps, then_mps) * dt_s;
        let most_1pm = most_curvature_1pm(speed_mps.max(then_mps));
        let turned_rad = curvature.clamp(-most_1pm, most_1pm) * moved_m;
        // The chord of an arc points along its middle.
        let position = state.position + Vec2::from_angle(state.heading_rad + turned_rad / 2.0) * moved_m;
        let heading_rad = wrap_angle(state.heading_rad + turned_rad);
        speed_mps = then_mps;
        state = State { position, heading_rad, velocity: Vec2::from_angle(heading_rad) * then_mps };
        state
    };
    (0..n_steps).map(step).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const NOW: State = State { position: Vec2::ZERO, heading_rad: 0.0, velocity: Vec2::new(10.0, 0.0) };

    fn act(action: &Action) -> Result<Vec<State>, String> {
        states(action, &NOW, &Transform2::from_pose(Vec2::new(100.0, 50.0), 0.0), (4.0, 0.1), 5)
    }

    #[test]
    fn a_trajectory_is_followed_in_the_frame_of_the_recording() {
        let points = (1..=7).map(|i| [100.0 + f64::from(i), 50.0, 0.0]).collect();
        let found = act(&Action { trajectory: Some(points), ..Action::default() }).unwrap();
        assert_eq!(found.len(), 5);
        assert!(found[4].position.distance(Vec2::new(5.0, 0.0)) < 1e-9 && (found[4].velocity.x - 10.0).abs() < 1e-9);
    }

    #[test]
    fn a_bicycle_brakes_to_a_stand_and_turns_within_its_limits() {
        let bicycle = |acceleration_mps2: f64, curvature_1pm: f64| {
            let [acceleration_mps2, curvature_1pm] = [Some(acceleration_mps2), Some(curvature_1pm)];
            act(&Action { acceleration_mps2, curvature_1pm, ..Action::default() }).unwrap()[4]
        };
        // Half a second at -9 m/s²: 5.5 m/s, 3.875 m.
        let braked = bicycle(-50.0, 0.0);
        assert!((braked.velocity.x - 5.5).abs() < 1e-9 && (braked.position.x - 3.875).abs() < 1e-9);
        // 9 m/s² across at 10 m/s: 0.09 1/m over 5 m.
        let turned = bicycle(0.0, 1.0);
        assert!((turned.heading_rad - 0.45).abs() < 1e-9 && turned.position.y > 0.0);
    }

    #[test]
    fn what_is_no_motion_is_named() {
        let jump = vec![[100.0, 90.0, 0.0]; 5];
        let nan = vec![[f64::NAN, 50.0, 0.0]; 5];
        let short = vec![[101.0, 50.0, 0.0]; 3];
        let trajectory = |points: Vec<[f64; 3]>| Action { trajectory: Some(points), ..Action::default() };
        for (action, why) in [
            (trajectory(jump), "point 0 of the trajectory: no vehicle moves"),
            (trajectory(nan), "point 0 of the trajectory: x, y or heading is not finite"),
            (trajectory(short), "has 3 points, expected at least 5"),
            (Action::default(), "expected either"),
            (Action { acceleration_mps2: Some(f64::INFINITY), ..Action::default() }, "not finite"),
        ] {
            let found = act(&action).unwrap_err();
            assert!(found.contains(why), "{found}");
        }
    }
}

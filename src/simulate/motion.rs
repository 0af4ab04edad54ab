//! Could a vehicle move like this? Asked of every state that a planner gives, in a loop or as a planned trajectory.

use crate::geometry::{Transform2, Vec2, angle_difference};
use crate::scene::State;
use std::f64::consts::{FRAC_PI_2, PI};

/// A motion that is faster than this, m/s, whose velocity changes faster from one timestep to the next, m/s², or that
/// turns faster, rad/s, is none of a vehicle, however uncomfortable or slippery.
const MOST_MPS: f64 = 100.0;
const MOST_MPS2: f64 = 30.0;
const MOST_TURN_RADPS: f64 = 5.0;
/// A vehicle that is faster than this, m/s, points along its motion but for this, radians, and for what its turning
/// explains. Up to the second speed it may go backward.
const SLIP_FROM_MPS: f64 = 3.0;
const MOST_SLIP_RAD: f64 = 0.25;
const BACKWARD_TO_MPS: f64 = 6.0;
/// More turns than any unwrapped heading makes.
const MOST_HEADING_RAD: f64 = 4.0 * PI;
/// A heading is recognized as written in another way if that is as close to the right one as this, radians.
const ALIKE_RAD: f64 = 0.15;
/// A position is recognized as one in another frame if it is this close to the last one there, meters, and this far
/// away here.
const NEAR_M: f64 = 5.0;
/// Makes a heading of one that is written in another way.
type ToHeading = fn(f64) -> f64;
/// Other ways of writing a heading, and from which number on: a smaller one is as likely in radians.
const WRITTEN: [(&str, f64, ToHeading); 3] = [
    ("in degrees", PI, f64::to_radians),
    ("clockwise from north", 0.0, |heading| FRAC_PI_2 - heading),
    ("in degrees clockwise from north", PI, |heading| FRAC_PI_2 - heading.to_radians()),
];

/// How tightly a vehicle turns at most, 1/m: the least circle, and 9 m/s² across.
pub(crate) fn most_curvature_1pm(speed_mps: f64) -> f64 {
    (9.0 / speed_mps.powi(2).max(f64::MIN_POSITIVE)).min(0.3)
}

/// A number for people: without hundreds of digits.
pub(crate) fn plain(number: f64) -> String {
    if number.abs() < 1e6 { format!("{}", (number * 1e3).round() / 1e3) } else { format!("{number:.3e}") }
}

/// The state a timestep after `before` of a vehicle of this length, meters, that is then at [x, y, heading] in the
/// frame of the recording. Both states are in the frame of the scene.
///
/// # Errors
/// Why no vehicle moves like this, and what may be meant.
pub(crate) fn moved(
    before: &State,
    [x, y, heading]: [f64; 3],
    world_from_scene: &Transform2,
    (length_m, dt_s): (f64, f64),
) -> Result<State, String> {
    let position = Vec2::new(x, y);
    if !(position.is_finite() && heading.is_finite()) {
        return Err("x, y or heading is not finite".to_owned());
    }
    let scene_from_world = world_from_scene.inverse();
    // As in tables, so that the scenario's own states come back as they are.
    let single = |number: f64| f64::from(number as f32);
    let Vec2 { x, y } = scene_from_world.point(position);
    let (at, heading_rad) = (Vec2::new(single(x), single(y)), single(scene_from_world.heading(heading)));
    let moved = at - before.position;
    let velocity = moved * (1.0 / dt_s);
    let (speed_mps, change_mps2) = (velocity.norm(), (velocity - before.velocity).norm() / dt_s);
    // Comparisons with what is not a number fail.
    if !(speed_mps <= MOST_MPS && change_mps2 <= MOST_MPS2) {
        let frame = match moved.norm() > NEAR_M {
            true if position.distance(before.position) < NEAR_M => {
                "; x and y seem to be in the frame of the scene, expected that of the recording (world_x_m, world_y_m)"
            }
            true => "; x and y are expected in the frame of the recording (world_x_m, world_y_m)",
            false => "",
        };
        let (moved, speed, change) = (plain(moved.norm()), plain(speed_mps), plain(change_mps2));
        return Err(format!(
            "no vehicle moves {moved} m within {dt_s} s: {speed} m/s, changed by {change} m/s²{frame}"
        ));
    }
    let turned_rad = angle_difference(heading_rad, before.heading_rad);
    let is_moving = speed_mps > SLIP_FROM_MPS;
    let along_rad = if is_moving { velocity.angle() } else { before.heading_rad };
    let refused = |what: String| {
        let is_meant =
            |meant: ToHeading| angle_difference(scene_from_world.heading(meant(heading)), along_rad).abs() < ALIKE_RAD;
        let written = WRITTEN.iter().find(|(_, from, meant)| heading.abs() >= *from && is_meant(*meant));
        let seems = written.map_or_else(String::new, |(name, ..)| format!("; it seems to be {name}"));
        let heading = plain(heading);
        Err(format!("heading {heading} {what}; expected radians, counterclockwise from x{seems}"))
    };
    if heading.abs() > MOST_HEADING_RAD {
        return refused("is more than two turns".to_owned());
    }
    if turned_rad.abs() > MOST_TURN_RADPS * dt_s {
        return refused(format!("is a turn by {} rad within {dt_s} s", plain(turned_rad)));
    }
    // On an arc, the chord points along the heading in the middle. Where the vehicle turns about a point behind its
    // center, that points inward.
    let middle_rad = before.heading_rad + turned_rad / 2.0;
    let curvature_1pm = (turned_rad.abs() / moved.norm()).min(most_curvature_1pm(speed_mps));
    let turning_rad = (length_m / 2.0 * curvature_1pm).atan();
    let off = |along_rad: f64| (angle_difference(along_rad, middle_rad).abs() - turning_rad).max(0.0);
    let slip_rad = if speed_mps < BACKWARD_TO_MPS { off(along_rad).min(off(along_rad + PI)) } else { off(along_rad) };
    if is_moving && slip_rad > MOST_SLIP_RAD {
        let slip = plain(angle_difference(along_rad, heading_rad).abs());
        return refused(format!("is {slip} rad off the motion at {} m/s", plain(speed_mps)));
    }
    Ok(State { position: at, heading_rad, velocity })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// To the northwest in the recording, which is along x in the scene.
    const TURNED_RAD: f64 = 0.75 * PI;
    const AT: Vec2 = Vec2::new(7000.0, -3000.0);

    /// The state a tenth of a second after one at `speed_mps` along x of the scene, which moves on by this, meters, in
    /// the directions of the recording.
    fn judged(speed_mps: f64, by: Vec2, heading: f64) -> Result<State, String> {
        let now = State { velocity: Vec2::new(speed_mps, 0.0), ..State::default() };
        let to = AT + by;
        moved(&now, [to.x, to.y, heading], &Transform2::from_pose(AT, TURNED_RAD), (4.0, 0.1))
    }

    #[test]
    fn a_state_is_turned_into_the_scene_and_judged_by_what_vehicles_do() {
        let on = |m: f64, across_m: f64| Vec2::new(m, across_m).rotated(TURNED_RAD);
        let state = judged(10.0, on(1.0, 0.0), TURNED_RAD - 2.0 * PI).unwrap();
        assert!(state.position.distance(Vec2::new(1.0, 0.0)) < 1e-9 && state.heading_rad.abs() < 1e-6);
        assert!((state.velocity - Vec2::new(10.0, 0.0)).norm() < 1e-6);
        let says = |found: Result<State, String>, why: &str| {
            let found = found.unwrap_err();
            assert!(found.contains(why) && found.len() < 250, "{found}");
        };
        // A full stop within a timestep, a jump, and the scene's own coordinates.
        says(judged(10.0, on(0.0, 0.0), TURNED_RAD), "no vehicle moves 0 m within 0.1 s");
        says(judged(10.0, on(-60.0, 0.0), TURNED_RAD), "no vehicle moves 60 m within 0.1 s");
        says(judged(10.0, Vec2::new(1e308, 1e308), TURNED_RAD), "m/s");
        says(judged(10.0, Vec2::new(1.0, 0.0) - AT, 0.0), "seem to be in the frame of the scene");
        // Degrees, the compass, sideways, backward, and no angle at all.
        says(judged(10.0, on(1.0, 0.0), 135.0), "it seems to be in degrees");
        says(judged(10.0, on(1.0, 0.0), FRAC_PI_2 - TURNED_RAD), "it seems to be clockwise from north");
        says(judged(10.0, on(1.0, 0.0), -45.0), "it seems to be in degrees clockwise from north");
        says(judged(10.0, on(1.0, 0.0), TURNED_RAD + FRAC_PI_2), "is a turn by 1.571 rad");
        // A quarter of a turn, along 2 degrees: as degrees, it would be right.
        let east = |heading| {
            moved(
                &State { velocity: Vec2::new(10.0, 0.0), ..State::default() },
                [1.0, 0.0, heading],
                &Transform2::from_pose(Vec2::ZERO, 0.0),
                (4.0, 0.1),
            )
        };
        assert!(!east(FRAC_PI_2 + 0.3).unwrap_err().contains("degrees"));
        says(judged(10.0, on(1.0, 0.29), TURNED_RAD - 0.49), "off the motion at 10.412 m/s");
        says(judged(10.0, on(1.0, 0.0), 1e300), "more than two turns");
        says(judged(10.0, on(1.0, 0.0), f64::NAN), "not finite");
        // Slow vehicles reverse, fast ones do not; a long one that turns about its rear axle slips.
        assert!(judged(-4.0, on(-0.4, 0.0), TURNED_RAD).is_ok() && judged(-20.0, on(-2.0, 0.0), TURNED_RAD).is_err());
        assert!(judged(5.0, on(0.47, 0.16), TURNED_RAD + 0.1).is_ok());
    }
}

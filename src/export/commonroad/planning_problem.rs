//! The planning problem of the ego: from its present state to its last one.

use super::{exact, point, position, speed_mps};
use crate::export::Item;
use crate::export::text::number;
use crate::export::xml::{Element, element, leaf};
use crate::geometry::wrap_angle;

/// The goal may be reached this long before the scenario ends, seconds.
const GOAL_DURATION_S: f64 = 1.0;

/// The planning problem of a scenario. The goal is reached when the
/// ego's center lies in its own footprint at the end, within the last second. `None` if the ego has no state at
/// present, or none after it.
pub(super) fn of(item: &Item<'_>) -> Option<Element> {
    let (scene, states) = (item.scene(), item.world_states(item.ego_idx));
    let present = scene.current_timestep();
    let now = (*states.get(present)?)?;
    let (last, end) = states.iter().enumerate().rev().find_map(|(timestep, state)| Some((timestep, (*state)?)))?;
    let n_steps = last.checked_sub(present).filter(|n| *n > 0)?;
    let before = present.checked_sub(1).and_then(|timestep| states[timestep]);
    let (yaw_rate_radps, acceleration_mps2) = before.map_or((0.0, 0.0), |before| {
        let turned_rad = wrap_angle(now.heading_rad - before.heading_rad);
        (turned_rad / scene.dt_s, (speed_mps(&now) - speed_mps(&before)) / scene.dt_s)
    });
    let initial = element("initialState")
        .child(position(&now))
        .child(exact("velocity", number(speed_mps(&now))))
        .child(exact("orientation", number(now.heading_rad)))
        .child(exact("yawRate", number(yaw_rate_radps)))
        .child(exact("slipAngle", "0"))
        .child(exact("time", 0))
        .child(exact("acceleration", number(acceleration_mps2)));
    let extent = item.ego().extent_or_nominal();
    let region = element("rectangle")
        .child(leaf("length", number(extent.length_m)))
        .child(leaf("width", number(extent.width_m)))
        .child(leaf("orientation", number(end.heading_rad)))
        .child(point("center", end.position));
    let n_goal_steps = (GOAL_DURATION_S / scene.dt_s).round() as usize;
    let time = element("time")
        .child(leaf("intervalStart", n_steps.saturating_sub(n_goal_steps).max(1)))
        .child(leaf("intervalEnd", n_steps));
    let goal = element("goalState").child(time).child(element("position").child(region));
    Some(element("planningProblem").child(initial).child(goal))
}

//! The planning problem of the ego: from its present state through the time of the scenario.

use super::{exact, position, speed_mps};
use crate::export::Item;
use crate::export::text::number;
use crate::export::xml::{Element, element, leaf};
use crate::geometry::wrap_angle;

/// The goal may be reached this long before the scenario ends, seconds.
const GOAL_DURATION_S: f64 = 1.0;

/// The planning problem of a scenario. The goal is to come through: to drive in the last second, anywhere. The end of
/// the scenario's ego is not a goal, because a planner that brakes for the event would miss it; nor are the lanes
/// ahead, because planners lead their paths only to the first of them. `None` if the ego has no state at present, or
/// none after it.
pub(super) fn of(item: &Item<'_>) -> Option<Element> {
    let (scene, states) = (item.scene(), item.world_states(item.ego_idx));
    let present = scene.current_timestep();
    let now = (*states.get(present)?)?;
    let last = states.iter().rposition(Option::is_some)?;
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
    let n_goal_steps = (GOAL_DURATION_S / scene.dt_s).round() as usize;
    let time = element("time")
        .child(leaf("intervalStart", n_steps.saturating_sub(n_goal_steps).max(1)))
        .child(leaf("intervalEnd", n_steps));
    Some(element("planningProblem").child(initial).child(element("goalState").child(time)))
}

//! The storyboard: initial positions, trajectories, and the end.

use super::Actor;
use crate::export::text::number;
use crate::export::xml::{Element, element};

/// Triggers fire this much before their timestep, because a player's sum of time steps is slightly below the decimal
/// value, and the trigger would be late by a whole step. Far below any player's step.
const TRIGGER_LEAD_S: f64 = 1e-3;

/// The storyboard of these actors over `n_timesteps`.
pub(super) fn of(actors: &[Actor], n_timesteps: usize, dt_s: f64) -> Element {
    let at_start = actors.iter().filter(|actor| actor.first_timestep == 0);
    let init = element("Init").child(element("Actions").children(at_start.map(begin)));
    let groups: Vec<Element> = actors.iter().filter_map(|actor| maneuver_group(actor, n_timesteps, dt_s)).collect();
    // A story needs at least one actor.
    let story = (!groups.is_empty()).then(|| {
        let act = element("Act").attr("name", "replay").children(groups).child(start_trigger("start_of_act", 0.0));
        element("Story").attr("name", "scenario").child(act)
    });
    let end_s = n_timesteps.saturating_sub(1) as f64 * dt_s;
    let stop = element("StopTrigger").child(after("end_of_scenario", end_s));
    element("Storyboard").child(init).children(story).child(stop)
}

/// Places an actor at its first state, with its speed.
fn begin(actor: &Actor) -> Element {
    let teleport =
        element("PrivateAction").child(element("TeleportAction").children(actor.positions().into_iter().take(1)));
    let speed_mps = actor.states.first().map_or(0.0, crate::scene::State::speed_mps);
    let dynamics = element("SpeedActionDynamics")
        .attr("dynamicsShape", "step")
        .attr("dynamicsDimension", "time")
        .attr("value", "0");
    let target = element("SpeedActionTarget").child(element("AbsoluteTargetSpeed").attr("value", number(speed_mps)));
    let speed = element("PrivateAction")
        .child(element("LongitudinalAction").child(element("SpeedAction").child(dynamics).child(target)));
    element("Private").attr("entityRef", &actor.name).child(teleport).child(speed)
}

/// The actions of an actor: it is added if it appears later, follows its trajectory, and is deleted if it leaves before
/// the end, unless a driving function takes it over. `None` if it is taken over from the start.
fn maneuver_group(actor: &Actor, n_timesteps: usize, dt_s: f64) -> Option<Element> {
    let name = &actor.name;
    let begin_s = actor.first_timestep as f64 * dt_s;
    let mut events = Vec::new();
    if actor.first_timestep > 0 {
        let added = element("AddEntityAction").children(actor.positions().into_iter().take(1));
        events.push(event(&format!("add_{name}"), entity_action(name, added), begin_s));
    }
    if !actor.is_free || actor.states.len() > 1 {
        events.push(event(&format!("follow_{name}"), follow(actor, dt_s), begin_s));
    }
    let end_timestep = actor.first_timestep + actor.states.len();
    if end_timestep < n_timesteps && !actor.is_free {
        let deleted = entity_action(name, element("DeleteEntityAction"));
        events.push(event(&format!("delete_{name}"), deleted, end_timestep as f64 * dt_s));
    }
    if events.is_empty() {
        return None;
    }
    let actors =
        element("Actors").attr("selectTriggeringEntities", "false").child(element("EntityRef").attr("entityRef", name));
    let maneuver = element("Maneuver").attr("name", format!("maneuver_{name}"));
    let group = element("ManeuverGroup").attr("name", format!("group_{name}")).attr("maximumExecutionCount", 1);
    Some(group.child(actors).child(maneuver.children(events)))
}

fn entity_action(name: &str, action: Element) -> Element {
    element("GlobalAction").child(element("EntityAction").attr("entityRef", name).child(action))
}

/// The action that follows an actor's trajectory, whose vertices have the times of the scenario.
fn follow(actor: &Actor, dt_s: f64) -> Element {
    let vertex = |(i, position): (usize, Element)| {
        element("Vertex").attr("time", number((actor.first_timestep + i) as f64 * dt_s)).child(position)
    };
    let mut positions = actor.positions();
    // A polyline has at least two vertices, and some players require one for every actor: an actor with a single
    // timestep stands for as long.
    if actor.states.len() == 1 {
        positions.extend(actor.positions());
    }
    let polyline = element("Polyline").children(positions.into_iter().enumerate().map(vertex));
    let trajectory = element("Trajectory")
        .attr("name", format!("trajectory_{}", actor.name))
        .attr("closed", "false")
        .child(element("Shape").child(polyline));
    let timing =
        element("Timing").attr("domainAbsoluteRelative", "absolute").attr("offset", "0.0").attr("scale", "1.0");
    let action = element("FollowTrajectoryAction")
        .child(element("TrajectoryRef").child(trajectory))
        .child(element("TimeReference").child(timing))
        .child(element("TrajectoryFollowingMode").attr("followingMode", "position"));
    element("PrivateAction").child(element("RoutingAction").child(action))
}

fn event(name: &str, action: Element, begin_s: f64) -> Element {
    element("Event")
        .attr("name", name)
        .attr("priority", "parallel")
        .attr("maximumExecutionCount", 1)
        .child(element("Action").attr("name", format!("action_{name}")).child(action))
        .child(start_trigger(&format!("start_of_{name}"), begin_s))
}

fn start_trigger(name: &str, begin_s: f64) -> Element {
    element("StartTrigger").child(after(name, begin_s))
}

/// True from a time on. It has no edge, so that it is true at the start, too.
fn after(name: &str, time_s: f64) -> Element {
    let time_s = (time_s - TRIGGER_LEAD_S).max(0.0);
    let time = element("SimulationTimeCondition").attr("value", number(time_s)).attr("rule", "greaterOrEqual");
    let condition = element("Condition")
        .attr("name", name)
        .attr("delay", "0")
        .attr("conditionEdge", "none")
        .child(element("ByValueCondition").child(time));
    element("ConditionGroup").child(condition)
}

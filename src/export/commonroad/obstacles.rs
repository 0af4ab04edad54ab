//! Road users as dynamic obstacles.

use super::state;
use crate::export::text::number;
use crate::export::xml::{Element, element, leaf};
use crate::export::{EgoMotion, Item};
use crate::scene::{AgentClass, State, Track};

/// Obstacles, and for each track its obstacle's id or the reason why there is none.
pub(super) struct Obstacles {
    pub(super) elements: Vec<Element>,
    pub(super) tracks: Vec<Result<String, &'static str>>,
    pub(super) assumed: Vec<(&'static str, u64)>,
}

/// The obstacles of a scenario; track i has number `first_id` + i.
pub(super) fn of(item: &Item<'_>, ego: EgoMotion, first_id: usize) -> Obstacles {
    let scene = item.scene();
    let mut obstacles = Obstacles { elements: Vec::new(), tracks: Vec::new(), assumed: Vec::new() };
    let (mut n_nominal, mut n_after_gap) = (0, 0);
    for (agent_idx, track) in scene.tracks.iter().enumerate() {
        let future = item.world_states(agent_idx).split_off(scene.current_timestep());
        let states: Vec<State> = future.iter().map_while(|state| *state).collect();
        let left_out = if ego == EgoMotion::Free && agent_idx == item.ego_idx {
            Some("ego_is_free")
        } else {
            match states.len() {
                0 => Some("absent_at_present"),
                1 => Some("ends_at_present"),
                _ => None,
            }
        };
        if let Some(reason) = left_out {
            obstacles.tracks.push(Err(reason));
            continue;
        }
        n_nominal += u64::from(track.extent.is_none());
        n_after_gap += (future.iter().flatten().count() - states.len()) as u64;
        let id = first_id + agent_idx;
        obstacles.elements.push(obstacle(track, &states).attr("id", id));
        obstacles.tracks.push(Ok(id.to_string()));
    }
    obstacles.assumed = vec![("nominal_size", n_nominal), ("states_after_gap", n_after_gap)];
    obstacles
}

fn obstacle(track: &Track, states: &[State]) -> Element {
    let extent = track.extent_or_nominal();
    let rectangle = element("rectangle")
        .child(leaf("length", number(extent.length_m)))
        .child(leaf("width", number(extent.width_m)));
    let later = states.iter().enumerate().skip(1).map(|(time_step, at)| state("state", at, time_step));
    element("dynamicObstacle")
        .child(leaf("type", kind(track.class)))
        .child(element("shape").child(rectangle))
        .children(states.first().map(|first| state("initialState", first, 0)))
        .child(element("trajectory").children(later))
}

/// The format's type of a road user. Pedestrians and cyclists that the recording does not distinguish become
/// pedestrians.
const fn kind(class: AgentClass) -> &'static str {
    match class {
        AgentClass::Vehicle => "car",
        AgentClass::Bus => "bus",
        AgentClass::Motorcyclist => "motorcycle",
        AgentClass::Cyclist => "bicycle",
        AgentClass::Pedestrian | AgentClass::PedestrianOrCyclist => "pedestrian",
        AgentClass::Static | AgentClass::Unknown => "unknown",
    }
}

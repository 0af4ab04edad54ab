//! Lanes as lanelets.

use super::point;
use crate::export::lane_bounds::LaneBounds;
use crate::export::xml::{Element, element, leaf};
use crate::geometry::Vec2;
use crate::scene::{Lane, LaneGraph, LaneId};
use std::collections::BTreeMap;

/// Lanelets and the assumptions about them.
pub(super) struct Lanelets {
    /// Numbered from 1, in the order of the lanes.
    pub(super) elements: Vec<Element>,
    pub(super) assumed: Vec<(&'static str, u64)>,
}

pub(super) fn of(map: &LaneGraph) -> Lanelets {
    let bounded: Vec<(&Lane, LaneBounds)> =
        map.lanes().iter().filter_map(|lane| Some((lane, LaneBounds::of(lane)?))).collect();
    let numbers: BTreeMap<LaneId, usize> = bounded.iter().enumerate().map(|(i, (lane, _))| (lane.id, i + 1)).collect();
    let n_nominal = bounded.iter().filter(|(_, bounds)| bounds.is_nominal).count();
    let n_left_out = map.lanes().len() - bounded.len();
    Lanelets {
        elements: bounded.iter().map(|(lane, bounds)| lanelet(lane, bounds, &numbers)).collect(),
        assumed: vec![("nominal_lane_width", n_nominal as u64), ("lane_without_extent", n_left_out as u64)],
    }
}

fn lanelet(lane: &Lane, bounds: &LaneBounds, numbers: &BTreeMap<LaneId, usize>) -> Element {
    let (left, right) = bounds.paired();
    let bound = |name, points: Vec<Vec2>| element(name).children(points.into_iter().map(|p| point("point", p)));
    let refer = |name, ids: &[LaneId]| -> Vec<Element> {
        ids.iter().filter_map(|id| numbers.get(id)).map(|number| element(name).attr("ref", number)).collect()
    };
    let beside = |name, id: Option<LaneId>| {
        let found = id.and_then(|id| numbers.get(&id));
        found.map(|number| element(name).attr("ref", number).attr("drivingDir", "same"))
    };
    let user = if lane.attributes.one_way { "userOneWay" } else { "userBidirectional" };
    element("lanelet")
        .attr("id", numbers.get(&lane.id).copied().unwrap_or_default())
        .child(bound("leftBound", left))
        .child(bound("rightBound", right))
        .children(refer("predecessor", &lane.predecessors))
        .children(refer("successor", &lane.successors))
        .children(beside("adjacentLeft", lane.left_neighbor))
        .children(beside("adjacentRight", lane.right_neighbor))
        .child(leaf("laneletType", kind(lane)))
        .child(leaf(user, "vehicle"))
}

/// The format's type of a lane, if the map has it.
fn kind(lane: &Lane) -> &'static str {
    match lane.attributes.kind.as_str() {
        "BUS" | "bus_lane" => "busLane",
        _ if lane.attributes.is_intersection => "intersection",
        "highway" | "freeway" => "highway",
        "road" | "VEHICLE" | "surface_street" => "urban",
        _ => "unknown",
    }
}

//! Makes a consistent graph of the lanes and connections that a map lists.

use crate::geometry::angle_difference;
use crate::scene::{Lane, LaneGraph, LaneId};
use std::collections::{BTreeMap, BTreeSet};
use std::f64::consts::FRAC_PI_2;
use std::sync::Arc;

/// Makes a graph of lanes from the connections that a map lists.
///
/// Maps list a connection at one end only, to lanes outside the file, or to the lane itself: here every successor has
/// its predecessor and nothing dangles. Maps also list the lane across the dividing line as a neighbor: a neighbor in
/// the opposite direction is kept as the tag `opposite_left_neighbor` or `opposite_right_neighbor`.
pub(super) fn connect(mut lanes: Vec<Lane>) -> LaneGraph {
    let opposite = opposite_neighbors(&lanes);
    for (lane, [left, right]) in lanes.iter_mut().zip(opposite) {
        for (is_opposite, neighbor, tag) in [
            (left, &mut lane.left_neighbor, "opposite_left_neighbor"),
            (right, &mut lane.right_neighbor, "opposite_right_neighbor"),
        ] {
            if is_opposite && let Some(id) = neighbor.take() {
                Arc::make_mut(&mut lane.attributes).tags.insert(tag.to_owned(), id.0.to_string());
            }
        }
    }
    connect_one_way(lanes)
}

/// [`connect`] for a map whose neighbors are all in the direction of the lane.
pub(super) fn connect_one_way(mut lanes: Vec<Lane>) -> LaneGraph {
    let mut links: BTreeSet<(LaneId, LaneId)> = BTreeSet::new();
    for lane in &lanes {
        links.extend(lane.successors.iter().map(|next| (lane.id, *next)));
        links.extend(lane.predecessors.iter().map(|previous| (*previous, lane.id)));
    }
    links.retain(|(from, to)| from != to);
    let mut successors: BTreeMap<LaneId, Vec<LaneId>> = BTreeMap::new();
    let mut predecessors: BTreeMap<LaneId, Vec<LaneId>> = BTreeMap::new();
    for (from, to) in links {
        successors.entry(from).or_default().push(to);
        predecessors.entry(to).or_default().push(from);
    }
    for lane in &mut lanes {
        lane.successors = successors.remove(&lane.id).unwrap_or_default();
        lane.predecessors = predecessors.remove(&lane.id).unwrap_or_default();
    }
    LaneGraph::new(lanes)
}

/// For each lane, whether its left and its right neighbor run against it.
fn opposite_neighbors(lanes: &[Lane]) -> Vec<[bool; 2]> {
    let by_id: BTreeMap<LaneId, &Lane> = lanes.iter().map(|lane| (lane.id, lane)).collect();
    let opposes = |lane: &Lane, neighbor: Option<LaneId>| {
        neighbor.and_then(|id| by_id.get(&id)).and_then(|neighbor| runs_against(lane, neighbor)).unwrap_or(false)
    };
    lanes.iter().map(|lane| [opposes(lane, lane.left_neighbor), opposes(lane, lane.right_neighbor)]).collect()
}

/// Compares directions at the middle of `lane`. `None` if a centerline has no direction.
fn runs_against(lane: &Lane, neighbor: &Lane) -> Option<bool> {
    let middle = lane.centerline.point_at(lane.centerline.length_m() / 2.0)?;
    let own = lane.centerline.project(middle)?.heading_rad;
    let other = neighbor.centerline.project(middle)?.heading_rad;
    Some(angle_difference(own, other).abs() > FRAC_PI_2)
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::geometry::{Polyline, Vec2};

    pub(in crate::ingest) fn lane(id: i64, from: (f64, f64), to: (f64, f64)) -> Lane {
        let centerline = Polyline(vec![Vec2::new(from.0, from.1), Vec2::new(to.0, to.1)]);
        Lane::unconnected(id, centerline, Default::default())
    }

    #[test]
    fn links_are_mutual_and_nothing_dangles() {
        let mut first = lane(1, (0.0, 0.0), (10.0, 0.0));
        first.successors = vec![LaneId(2), LaneId(99), LaneId(1)];
        let second = lane(2, (10.0, 0.0), (20.0, 0.0));
        let mut third = lane(3, (20.0, 0.0), (30.0, 0.0));
        third.predecessors = vec![LaneId(2), LaneId(2)];
        let graph = connect(vec![third, first, second]);
        let links = |id| {
            let lane = graph.get(LaneId(id)).expect("all three lanes are kept");
            (lane.predecessors.clone(), lane.successors.clone())
        };
        assert_eq!(links(1), (vec![], vec![LaneId(2)]));
        assert_eq!(links(2), (vec![LaneId(1)], vec![LaneId(3)]));
        assert_eq!(links(3), (vec![LaneId(2)], vec![]));
    }

    #[test]
    fn neighbors_against_the_direction_become_tags() {
        let mut here = lane(1, (0.0, 0.0), (10.0, 0.0));
        here.left_neighbor = Some(LaneId(2));
        here.right_neighbor = Some(LaneId(3));
        let oncoming = lane(2, (10.0, 3.8), (0.0, 3.8));
        let beside = lane(3, (0.0, -3.8), (10.0, -3.8));
        let graph = connect(vec![here, oncoming, beside]);
        let here = graph.get(LaneId(1)).expect("kept");
        assert_eq!((here.left_neighbor, here.right_neighbor), (None, Some(LaneId(3))));
        assert_eq!(here.attributes.tags["opposite_left_neighbor"], "2");
    }
}

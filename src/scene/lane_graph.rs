//! Lanes: their geometry and how they connect.

use super::LaneId;
use crate::geometry::{Polyline, Transform2};
use crate::settings::named;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Which way a lane turns at an intersection (Argoverse 1).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, Default)]
#[serde(rename_all = "snake_case")]
pub enum TurnDirection {
    /// Straight on, or unknown.
    #[default]
    None,
    /// To the left.
    Left,
    /// To the right.
    Right,
}

named! { TurnDirection { None = "none", Left = "left", Right = "right" } }

/// Attributes of a lane in its map.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct LaneAttributes {
    /// Lanelet2 `subtype` or Argoverse 2 `lane_type`, as written; empty if the map has none.
    pub kind: String,
    /// Turn at an intersection.
    pub turn: TurnDirection,
    /// Whether the lane lies in an intersection.
    pub is_intersection: bool,
    /// Whether traffic on it is controlled by lights or signs.
    pub has_traffic_control: bool,
    /// Whether traffic runs one way only.
    pub one_way: bool,
    /// Further tags, such as regulatory elements with the part of the lane in them (`regulatory:40001` →
    /// `role=yield;subtype=right_of_way;…`).
    pub tags: BTreeMap<String, String>,
}

/// The duty that a rule of the map gives to vehicles that come along a lane.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LaneDuty {
    /// Nothing: others yield.
    HasRightOfWay,
    /// To let vehicles with the right of way pass.
    Yields,
    /// To stop at the end of the lane.
    Stops,
}

impl LaneAttributes {
    /// Prefix of the names of tags of regulatory elements.
    pub const REGULATORY: &str = "regulatory:";
    /// The key, in such a tag, of the part that the lane has in the rule.
    pub const ROLE: &str = "role";

    /// The rules at the end of the lane, each with the name of its tag, by name: Lanelet2's `right_of_way`, in which
    /// lanes have the role `right_of_way` or `yield`, and `all_way_stop`.
    pub fn duties(&self) -> impl Iterator<Item = (&str, LaneDuty)> {
        let rules = self.tags.iter().filter(|(key, _)| key.starts_with(Self::REGULATORY));
        rules.filter_map(|(key, rule)| {
            let value = |name: &str| {
                let mut pairs = rule.split(';').filter_map(|pair| pair.split_once('='));
                pairs.find(|(found, _)| *found == name).map_or("", |(_, value)| value)
            };
            let duty = match (value("subtype"), value(Self::ROLE)) {
                ("right_of_way", "right_of_way") => LaneDuty::HasRightOfWay,
                ("right_of_way", "yield") => LaneDuty::Yields,
                ("all_way_stop", "yield") => LaneDuty::Stops,
                _ => return None,
            };
            Some((key.as_str(), duty))
        })
    }
}

/// One driving lane.
#[derive(Debug, Clone, PartialEq)]
pub struct Lane {
    /// The map's name for it.
    pub id: LaneId,
    /// Points in driving direction, meters.
    pub centerline: Polyline,
    /// Left boundary in driving direction; empty if the map has none.
    pub left: Polyline,
    /// Right boundary in driving direction; empty if the map has none.
    pub right: Polyline,
    /// Lanes that follow on from its end.
    pub successors: Vec<LaneId>,
    /// Lanes that end where it begins.
    pub predecessors: Vec<LaneId>,
    /// The lane beside it on the left, in the same direction.
    pub left_neighbor: Option<LaneId>,
    /// The lane beside it on the right, in the same direction.
    pub right_neighbor: Option<LaneId>,
    /// Everything else: shared by all copies of the lane, in whichever frame.
    pub attributes: Arc<LaneAttributes>,
}

impl Lane {
    /// A lane with these boundaries, left and right, without connections and attributes.
    pub fn unconnected(id: i64, centerline: Polyline, [left, right]: [Polyline; 2]) -> Self {
        Self {
            id: LaneId(id),
            centerline,
            left,
            right,
            successors: Vec::new(),
            predecessors: Vec::new(),
            left_neighbor: None,
            right_neighbor: None,
            attributes: Arc::default(),
        }
    }

    /// The outline of the lane: left boundary, then right boundary backwards. `None` without boundaries.
    pub fn outline(&self) -> Option<Vec<crate::geometry::Vec2>> {
        (self.left.0.len() >= 2 && self.right.0.len() >= 2)
            .then(|| self.left.0.iter().chain(self.right.0.iter().rev()).copied().collect())
    }
}

/// The lanes around a scene or of a whole map. Connections name only lanes of the graph.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct LaneGraph {
    lanes: Vec<Lane>,
}

impl LaneGraph {
    /// Sorts lanes by id, keeps the first of each id, and drops connections to other lanes.
    pub fn new(mut lanes: Vec<Lane>) -> Self {
        lanes.sort_by_key(|lane| lane.id);
        lanes.dedup_by_key(|lane| lane.id);
        let known: Vec<LaneId> = lanes.iter().map(|lane| lane.id).collect();
        let is_known = |id: &LaneId| known.binary_search(id).is_ok();
        for lane in &mut lanes {
            lane.successors.retain(is_known);
            lane.predecessors.retain(is_known);
            lane.left_neighbor = lane.left_neighbor.filter(is_known);
            lane.right_neighbor = lane.right_neighbor.filter(is_known);
        }
        Self { lanes }
    }

    /// The lanes, by ascending id.
    pub fn lanes(&self) -> &[Lane] {
        &self.lanes
    }

    /// Whether there are no lanes.
    pub const fn is_empty(&self) -> bool {
        self.lanes.is_empty()
    }

    /// The lane of this id.
    pub fn get(&self, id: LaneId) -> Option<&Lane> {
        self.lanes.binary_search_by_key(&id, |lane| lane.id).ok().map(|i| &self.lanes[i])
    }

    /// The ways from a lane, itself first, to `length_m` beyond its end or to the end of the map: one for each choice
    /// at each fork, in the order of connections, and at most `n_ways` of them. No way contains a lane twice.
    pub fn ways_ahead(&self, start: LaneId, length_m: f64, n_ways: usize) -> Vec<Vec<&Lane>> {
        let mut ways = Vec::new();
        let mut open: Vec<(Vec<&Lane>, f64)> = self.get(start).map(|lane| (vec![lane], 0.0)).into_iter().collect();
        while let Some((way, added_m)) = open.pop().filter(|_| ways.len() < n_ways) {
            let ahead = way.last().map_or(&[][..], |lane| &lane.successors);
            let next =
                ahead.iter().filter_map(|id| self.get(*id)).filter(|lane| way.iter().all(|own| own.id != lane.id));
            let next: Vec<&Lane> = next.filter(|_| added_m < length_m).collect();
            if next.is_empty() {
                ways.push(way);
                continue;
            }
            for lane in next.into_iter().rev() {
                let longer = way.iter().copied().chain([lane]).collect();
                open.push((longer, added_m + lane.centerline.length_m()));
            }
        }
        ways
    }

    /// This graph in another frame.
    pub fn transformed(&self, to_from_here: &Transform2) -> Self {
        self.clone().into_frame(to_from_here)
    }

    /// This graph, moved to another frame in place.
    #[must_use]
    pub fn into_frame(mut self, to_from_here: &Transform2) -> Self {
        for lane in &mut self.lanes {
            let lines = [&mut lane.centerline, &mut lane.left, &mut lane.right];
            lines.into_iter().flat_map(|line| &mut line.0).for_each(|point| *point = to_from_here.point(*point));
        }
        self
    }

    /// The lanes of these ids, with connections among them.
    pub fn subset(&self, ids: &[LaneId]) -> Self {
        Self::new(ids.iter().filter_map(|id| self.get(*id)).cloned().collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn duties_are_the_roles_in_the_rules_of_the_map() {
        let tags = [
            ("regulatory:1", "role=yield;subtype=right_of_way;type=regulatory_element"),
            ("regulatory:2", "role=right_of_way;subtype=right_of_way"),
            ("regulatory:3", "role=yield;subtype=all_way_stop"),
            // Neither named by the rule, nor a rule about the right of way, nor a rule.
            ("regulatory:4", "subtype=right_of_way"),
            ("regulatory:5", "role=refers;subtype=speed_limit"),
            ("location", "role=yield;subtype=right_of_way"),
        ];
        let tags = tags.map(|(key, value)| (key.to_owned(), value.to_owned())).into();
        let attributes = LaneAttributes { tags, ..LaneAttributes::default() };
        let expected = [
            ("regulatory:1", LaneDuty::Yields),
            ("regulatory:2", LaneDuty::HasRightOfWay),
            ("regulatory:3", LaneDuty::Stops),
        ];
        assert_eq!(attributes.duties().collect::<Vec<_>>(), expected);
    }
}

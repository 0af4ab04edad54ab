//! Which lanes is a point on, and how are two lanes related?

use super::footprint::Bounds;
use crate::geometry::{Polyline, Vec2, angle_difference};
use crate::scene::{Lane, LaneGraph, LaneId};
use std::collections::{BTreeMap, BTreeSet};
use std::f64::consts::PI;

/// Half the width to assume of a lane without boundaries, meters; Argoverse 1's own reader assumes 3.8 m.
pub(crate) const HALF_NOMINAL_WIDTH_M: f64 = 1.9;
/// Lanes that follow on may leave a gap of this size between them, meters.
const END_TOLERANCE_M: f64 = 0.5;
/// The most connections between two lanes of which one still counts as following the other.
const MAX_HOPS: usize = 3;
/// Lanes whose directions differ by less than this run side by side, radians (20 degrees).
pub(crate) const PARALLEL_RAD: f64 = 0.35;

/// The place of a point on a lane.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct LanePlace {
    /// Signed distance from the center line, meters; positive to its left.
    pub(crate) offset_m: f64,
    /// Distance to the nearer side of the lane, meters; negative outside.
    pub(crate) margin_m: f64,
    /// Direction of the lane, radians.
    pub(crate) heading_rad: f64,
}

/// A lane with precomputed values for repeated queries.
#[derive(Debug)]
pub(crate) struct IndexedLane<'a> {
    pub(crate) lane: &'a Lane,
    bounds: Bounds,
    outline: Option<Vec<Vec2>>,
    length_m: f64,
}

impl<'a> IndexedLane<'a> {
    /// `None` for a lane without points.
    fn new(lane: &'a Lane) -> Option<Self> {
        let points = lane.centerline.0.iter().chain(&lane.left.0).chain(&lane.right.0);
        let bounds = Bounds::around(points.copied())?;
        Some(Self { lane, bounds, outline: lane.outline(), length_m: lane.centerline.length_m() })
    }

    /// Whether `point` can have a margin: quicker than its place.
    fn may_hold(&self, point: Vec2) -> bool {
        self.bounds.contains(point, HALF_NOMINAL_WIDTH_M)
            && self.outline.as_ref().is_none_or(|outline| is_in_polygon(outline, point))
    }

    /// The place of `point` on the lane. `None` before its start and past its end.
    pub(crate) fn place(&self, point: Vec2) -> Option<LanePlace> {
        let projection = self.lane.centerline.project(point)?;
        let is_at_end = projection.station_m <= 0.0 || projection.station_m >= self.length_m - 1e-9;
        let beyond_m = (point - projection.point).dot(Vec2::from_angle(projection.heading_rad)).abs();
        let is_beyond = is_at_end && beyond_m > END_TOLERANCE_M;
        let is_inside = self.outline.as_ref().is_some_and(|outline| is_in_polygon(outline, point));
        if is_beyond && !is_inside {
            return None;
        }
        let to_side_m = |side: &Polyline| side.project(point).map_or(f64::INFINITY, |p| p.offset_m.abs());
        let margin_m = match &self.outline {
            None => HALF_NOMINAL_WIDTH_M - projection.offset_m.abs(),
            Some(_) => {
                let nearer_m = to_side_m(&self.lane.left).min(to_side_m(&self.lane.right));
                if is_inside { nearer_m } else { -nearer_m }
            }
        };
        Some(LanePlace { offset_m: projection.offset_m, margin_m, heading_rad: projection.heading_rad })
    }
}

/// Whether `point` lies within the closed polygon (even-odd rule).
pub(crate) fn is_in_polygon(polygon: &[Vec2], point: Vec2) -> bool {
    let edges = polygon.iter().zip(polygon.iter().cycle().skip(1));
    edges.fold(false, |is_inside, (a, b)| {
        let crosses = (a.y > point.y) != (b.y > point.y) && point.x < a.x + (b.x - a.x) * (point.y - a.y) / (b.y - a.y);
        is_inside != crosses
    })
}

/// The relation of another lane to a lane, at a point on its edge.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum LaneRelation {
    /// One follows the other, both fork from one lane, or both end in one.
    Along,
    /// Beside it, in the same direction.
    Beside,
    /// Neither: crossing, oncoming or elsewhere.
    Elsewhere,
}

/// The lanes of a scene, with rectangles that quickly exclude lanes a point cannot be on.
pub(crate) struct SceneLanes<'a> {
    graph: &'a LaneGraph,
    lanes: Vec<IndexedLane<'a>>,
}

impl<'a> SceneLanes<'a> {
    pub(crate) fn new(graph: &'a LaneGraph) -> Self {
        Self { graph, lanes: graph.lanes().iter().filter_map(IndexedLane::new).collect() }
    }

    /// The lane with this id. `None` for one without points.
    pub(crate) fn get(&self, id: LaneId) -> Option<&IndexedLane<'a>> {
        self.lanes.binary_search_by_key(&id, |lane| lane.lane.id).ok().map(|i| &self.lanes[i])
    }

    /// The lanes that `point` is on, with its place there, by ascending lane id.
    pub(crate) fn lanes_at(&self, point: Vec2) -> impl Iterator<Item = (&IndexedLane<'a>, LanePlace)> {
        self.lanes
            .iter()
            .filter(move |lane| lane.may_hold(point))
            .filter_map(move |lane| Some((lane, lane.place(point)?)))
            .filter(|(_, place)| place.margin_m >= 0.0)
    }

    /// Whether `point` is on a lane: quicker than finding its place there.
    pub(crate) fn is_road(&self, point: Vec2) -> bool {
        let holds = |lane: &IndexedLane<'_>| {
            lane.outline.is_some() || lane.place(point).is_some_and(|place| place.margin_m >= 0.0)
        };
        self.lanes.iter().any(|lane| lane.may_hold(point) && holds(lane))
    }

    /// The relation of `to` to `from` at `point`, which is on `to` and next to `from`.
    pub(crate) fn relation(&self, from: &IndexedLane<'_>, to: &IndexedLane<'_>, point: Vec2) -> LaneRelation {
        self.connection(from.lane, to.lane).unwrap_or_else(|| {
            let is_beside = from.place(point).zip(to.place(point)).is_some_and(|(old, new)| {
                old.offset_m * new.offset_m < 0.0
                    && angle_difference(old.heading_rad, new.heading_rad).abs() < PARALLEL_RAD
                    && (old.offset_m - new.offset_m).abs() > HALF_NOMINAL_WIDTH_M
            });
            if is_beside { LaneRelation::Beside } else { LaneRelation::Elsewhere }
        })
    }

    /// The lanes beside `from` at `point`, a point on it, with their side: +1 left, -1 right.
    pub(crate) fn beside(&self, from: &IndexedLane<'_>, point: Vec2) -> Vec<(&IndexedLane<'a>, f64)> {
        let near = self.lanes.iter().filter(|lane| lane.lane.id != from.lane.id);
        let near = near.filter(|lane| lane.bounds.contains(point, 2.0 * HALF_NOMINAL_WIDTH_M));
        near.filter_map(|lane| {
            let there = lane.lane.centerline.project(point)?;
            let is_next = (HALF_NOMINAL_WIDTH_M..3.0 * HALF_NOMINAL_WIDTH_M).contains(&there.offset_m.abs());
            let edge = from.lane.centerline.project(point)?.point.lerp(there.point, 0.5);
            let is_beside = is_next && self.relation(from, lane, edge) == LaneRelation::Beside;
            // A point to the right of a line has a negative offset from it.
            is_beside.then_some((lane, -there.offset_m.signum()))
        })
        .collect()
    }

    /// The oncoming lanes beside a vehicle at `point`, with their side: +1 left, -1 right.
    pub(crate) fn oncoming(&self, point: Vec2, heading_rad: f64) -> Vec<(&IndexedLane<'a>, f64)> {
        let near = self.lanes.iter().filter(|lane| lane.bounds.contains(point, 3.0 * HALF_NOMINAL_WIDTH_M));
        let beside = near.filter_map(|lane| {
            let there = lane.lane.centerline.project(point)?;
            let is_next = (HALF_NOMINAL_WIDTH_M..3.0 * HALF_NOMINAL_WIDTH_M).contains(&there.offset_m.abs());
            let is_passed = (point - there.point).dot(Vec2::from_angle(there.heading_rad)).abs() < END_TOLERANCE_M;
            let is_opposite = angle_difference(there.heading_rad, heading_rad).abs() > PI - PARALLEL_RAD;
            // A point to the left of an oncoming lane has that lane on its own left.
            (is_next && is_passed && is_opposite).then_some((lane, there.offset_m.signum()))
        });
        beside.collect()
    }

    /// The ways that lead on from `start` for at least `length_m`, or to the end of the map.
    pub(crate) fn ways_ahead(&self, start: &Lane, length_m: f64, n_ways: usize) -> Vec<Vec<&Lane>> {
        self.graph.ways_ahead(start.id, length_m, n_ways)
    }

    /// Whether `start` leads back to itself within `length_m`, as on a roundabout.
    pub(crate) fn is_on_loop(&self, start: &Lane, length_m: f64) -> bool {
        // Lanes, with the shortest distance from the end of `start` to their own end.
        let mut reached: BTreeMap<LaneId, f64> = BTreeMap::new();
        let mut open = vec![(start.id, 0.0)];
        while let Some((id, before_m)) = open.pop() {
            for next in self.get(id).into_iter().flat_map(|lane| &lane.lane.successors) {
                let Some(lane) = self.get(*next) else { continue };
                let end_m = before_m + lane.length_m;
                if end_m > length_m || reached.get(next).is_some_and(|known| *known <= end_m) {
                    continue;
                }
                if *next == start.id {
                    return true;
                }
                reached.insert(*next, end_m);
                open.push((*next, end_m));
            }
        }
        false
    }

    /// The relation of two lanes according to the map, if it has one.
    fn connection(&self, from: &Lane, to: &Lane) -> Option<LaneRelation> {
        let (ahead, behind) = (self.reachable(from, |l| &l.successors), self.reachable(from, |l| &l.predecessors));
        let names = |lane: &Lane, id: LaneId| lane.left_neighbor == Some(id) || lane.right_neighbor == Some(id);
        let mut family = ahead.union(&behind).filter_map(|id| self.graph.get(*id));
        // A declared neighbor counts as one even if both lanes come from the same lane.
        if family.any(|lane| names(lane, to.id) || names(to, lane.id)) {
            return Some(LaneRelation::Beside);
        }
        // A lane that follows on or leads here counts as the agent's own.
        let forks = self.reachable(to, |l| &l.predecessors).intersection(&behind).next().is_some();
        let merges = self.reachable(to, |l| &l.successors).intersection(&ahead).next().is_some();
        (forks || merges).then_some(LaneRelation::Along)
    }

    /// The lanes at most [`MAX_HOPS`] connections from `start`, itself included.
    fn reachable(&self, start: &Lane, connections: impl Fn(&Lane) -> &Vec<LaneId>) -> BTreeSet<LaneId> {
        let mut reached = BTreeSet::from([start.id]);
        let mut frontier = vec![start.id];
        for _ in 0..MAX_HOPS {
            let next = frontier.iter().filter_map(|id| self.graph.get(*id)).flat_map(&connections).copied();
            frontier = next.filter(|id| reached.insert(*id)).collect();
        }
        reached
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::behavior::testing::lane_graph as graph;

    #[test]
    fn places_have_a_margin_with_and_without_boundaries() {
        let graph = graph(
            "lanes = [{ id = 1, centerline = [[0, 0], [50, 0]], width_m = 3.0 }, { id = 2, centerline = [[0, 0], [50, \
             0]] }]",
        );
        let index = SceneLanes::new(&graph);
        let margins = |x: f64, y: f64| {
            index.lanes.iter().map(|lane| lane.place(Vec2::new(x, y)).map(|place| place.margin_m)).collect::<Vec<_>>()
        };
        let close = |found: Vec<Option<f64>>, expected: [f64; 2]| {
            found.iter().zip(expected).all(|(f, e)| f.is_some_and(|f| (f - e).abs() < 1e-9))
        };
        assert!(close(margins(20.0, 1.0), [0.5, 0.9]));
        assert!(close(margins(20.0, -1.7), [-0.2, 0.2]));
        // A small gap at the end is bridged, a larger distance is not on the lane any more.
        assert!(close(margins(50.4, 0.0), [-(0.4f64.hypot(1.5)), 1.5]));
        assert_eq!(margins(50.6, 0.0), [None, None]);
        assert_eq!(index.lanes_at(Vec2::new(20.0, -1.7)).map(|(lane, _)| lane.lane.id.0).collect::<Vec<_>>(), [2]);
    }

    #[test]
    fn lanes_follow_fork_merge_or_lie_side_by_side() {
        // 1 forks into 2 and 3; 4 runs beside 2 without being declared a neighbor; 5 is declared by 1; 6 crosses.
        let graph = graph(
            "lanes = [
                { id = 1, centerline = [[0, 0], [20, 0]], successors = [2, 3], left_neighbor = 5 },
                { id = 2, centerline = [[20, 0], [60, 0]], predecessors = [1] },
                { id = 3, centerline = [[20, 0], [60, 4]], predecessors = [1] },
                { id = 4, centerline = [[20, -3.6], [60, -3.6]] },
                { id = 5, centerline = [[0, 3.6], [20, 3.6]] },
                { id = 6, centerline = [[40, -20], [40, 20]] },
            ]",
        );
        let index = SceneLanes::new(&graph);
        let relation = |from: i64, to: i64, x: f64, y: f64| {
            let lane = |id: i64| index.lanes.iter().find(|lane| lane.lane.id == LaneId(id)).expect("a lane");
            index.relation(lane(from), lane(to), Vec2::new(x, y))
        };
        assert_eq!(relation(1, 2, 20.0, 0.0), LaneRelation::Along);
        assert_eq!(relation(2, 3, 40.0, 2.0), LaneRelation::Along);
        assert_eq!(relation(2, 4, 40.0, -1.9), LaneRelation::Beside);
        assert_eq!(relation(1, 5, 10.0, 1.9), LaneRelation::Beside);
        assert_eq!(relation(5, 1, 10.0, 1.7), LaneRelation::Beside);
        assert_eq!(relation(2, 5, 20.0, 1.9), LaneRelation::Beside);
        assert_eq!(relation(2, 6, 40.0, 1.0), LaneRelation::Elsewhere);
    }
}

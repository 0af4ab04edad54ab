//! Which lanes is a point on, and how do two lanes lie to each other?

use super::footprint::Bounds;
use crate::geometry::{Polyline, Vec2, angle_difference};
use crate::scene::{Lane, LaneGraph, LaneId};
use std::collections::BTreeSet;

/// Half the width to assume of a lane without boundaries, metres; Argoverse 1's own reader assumes 3.8 m.
pub(crate) const HALF_NOMINAL_WIDTH_M: f64 = 1.9;
/// Lanes that follow on may leave a gap of this size between them, metres.
const END_TOLERANCE_M: f64 = 0.5;
/// How many connections apart two lanes may be and still count as one following the other.
const MAX_HOPS: usize = 3;
/// Lanes whose directions differ by less than this run side by side, radians (20 degrees).
const PARALLEL_RAD: f64 = 0.35;

/// Where a point is on a lane.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct LanePlace {
    /// Signed distance from the centre line, metres; positive to its left.
    pub(crate) offset_m: f64,
    /// Distance to the nearer side of the lane, metres; negative outside.
    pub(crate) margin_m: f64,
    /// Direction of the lane, radians.
    pub(crate) heading_rad: f64,
}

impl LanePlace {
    /// Where `point` is on `lane`. `None` before its start and past its end.
    pub(crate) fn on(lane: &Lane, point: Vec2) -> Option<Self> {
        let projection = lane.centerline.project(point)?;
        let beyond_m = (point - projection.point).dot(Vec2::from_angle(projection.heading_rad)).abs();
        let is_at_end = projection.station_m <= 0.0 || projection.station_m >= lane.centerline.length_m() - 1e-9;
        let is_beyond = is_at_end && beyond_m > END_TOLERANCE_M;
        let place =
            |margin_m: f64| Self { offset_m: projection.offset_m, margin_m, heading_rad: projection.heading_rad };
        let Some(outline) = lane.outline() else {
            return (!is_beyond).then(|| place(HALF_NOMINAL_WIDTH_M - projection.offset_m.abs()));
        };
        let is_inside = is_in_polygon(&outline, point);
        if is_beyond && !is_inside {
            return None;
        }
        let to_side_m = |side: &Polyline| side.project(point).map_or(f64::INFINITY, |p| p.offset_m.abs());
        let nearer_m = to_side_m(&lane.left).min(to_side_m(&lane.right));
        Some(place(if is_inside { nearer_m } else { -nearer_m }))
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

/// How another lane lies to a lane, seen from a point at its edge.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum LaneRelation {
    /// One follows the other, or both fork from one lane, or both end in one.
    Along,
    /// Beside it, in the same direction.
    Beside,
    /// Neither: crossing, oncoming or elsewhere.
    Elsewhere,
}

/// The lanes of a scene, with rectangles that say quickly which of them a point cannot be on.
pub(crate) struct LaneIndex<'a> {
    graph: &'a LaneGraph,
    bounds: Vec<Option<Bounds>>,
}

impl<'a> LaneIndex<'a> {
    /// An index of all lanes of `graph`.
    pub(crate) fn new(graph: &'a LaneGraph) -> Self {
        let bounds_of =
            |lane: &Lane| Bounds::around(lane.centerline.0.iter().chain(&lane.left.0).chain(&lane.right.0).copied());
        Self { graph, bounds: graph.lanes().iter().map(bounds_of).collect() }
    }

    /// The lanes that `point` is on, with its place there, by ascending lane id.
    pub(crate) fn lanes_at(&self, point: Vec2) -> impl Iterator<Item = (&'a Lane, LanePlace)> + '_ {
        let could_be = move |bounds: &Option<Bounds>| bounds.is_some_and(|b| b.contains(point, HALF_NOMINAL_WIDTH_M));
        let candidates = self.graph.lanes().iter().zip(&self.bounds).filter(move |(_, bounds)| could_be(bounds));
        candidates
            .filter_map(move |(lane, _)| Some((lane, LanePlace::on(lane, point)?)))
            .filter(|(_, place)| place.margin_m >= 0.0)
    }

    /// How `to` lies to `from` at `point`, a point on `to` and next to `from`.
    pub(crate) fn relation(&self, from: &Lane, to: &Lane, point: Vec2) -> LaneRelation {
        let (ahead, behind) = (self.reachable(from, |l| &l.successors), self.reachable(from, |l| &l.predecessors));
        let family = || ahead.union(&behind).filter_map(|id| self.graph.get(*id));
        let names = |lane: &Lane, id: LaneId| lane.left_neighbor == Some(id) || lane.right_neighbor == Some(id);
        // A declared neighbor counts as one even where both lanes come from the same one.
        if family().any(|lane| names(lane, to.id) || names(to, lane.id)) {
            return LaneRelation::Beside;
        }
        let follows = ahead.contains(&to.id) || behind.contains(&to.id);
        let forks = self.reachable(to, |l| &l.predecessors).intersection(&behind).next().is_some();
        let merges = self.reachable(to, |l| &l.successors).intersection(&ahead).next().is_some();
        if follows || forks || merges {
            return LaneRelation::Along;
        }
        let places = LanePlace::on(from, point).zip(LanePlace::on(to, point));
        let is_between = places.is_some_and(|(old, new)| {
            old.offset_m * new.offset_m < 0.0
                && angle_difference(old.heading_rad, new.heading_rad).abs() < PARALLEL_RAD
                && (old.offset_m - new.offset_m).abs() > HALF_NOMINAL_WIDTH_M
        });
        if is_between { LaneRelation::Beside } else { LaneRelation::Elsewhere }
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

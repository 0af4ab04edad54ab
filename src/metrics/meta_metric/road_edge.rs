//! The edges of the road that lanes form, and signed distances to them.
//!
//! Maps have lanes, not edges: an edge is the part of a lane's outline beyond which there is no other lane. It runs
//! with the road on its left. Where the map ends there is no edge; the sides continue straight.

use crate::behavior::footprint::Bounds;
use crate::behavior::lane_relation::is_in_polygon;
use crate::geometry::{SegmentIndex, Vec2};
use crate::metrics::road::map_ends;
use crate::scene::LaneGraph;

/// Boundaries are cut into pieces of at most this length, meters, each an edge or not.
const PIECE_M: f64 = 0.5;
/// Gaps between lanes up to this width belong to the road, meters.
const GAP_M: f64 = 0.3;
/// An edge is continued by another that begins within this distance, meters; around tips, for example.
const JOIN_M: f64 = 1.0;

pub(super) struct RoadEdges {
    segments: Vec<Segment>,
    index: SegmentIndex,
}

struct Segment {
    start: Vec2,
    along: Vec2,
    length_squared: f64,
    /// The segments before and after it on the same edge, and whether the edge turns left on the way.
    neighbors: [Option<(usize, bool)>; 2],
}

impl RoadEdges {
    /// The edges of the road of these lanes. `None` if a lane has no boundaries, or there are no lanes.
    pub(super) fn of(lanes: &LaneGraph) -> Option<Self> {
        let outlines = lanes.lanes().iter().map(|lane| {
            let outline = lane.outline()?;
            Some((Bounds::around(outline.iter().copied())?, outline))
        });
        let outlines: Vec<(Bounds, Vec<Vec2>)> = outlines.collect::<Option<_>>()?;
        let is_road = |point: Vec2| {
            outlines.iter().any(|(bounds, outline)| bounds.contains(point, 0.0) && is_in_polygon(outline, point))
        };
        let mut edges: Vec<Vec<Vec2>> = Vec::new();
        for lane in lanes.lanes() {
            let left: Vec<Vec2> = lane.left.0.iter().rev().copied().collect();
            let across = |from: &[Vec2], to: &[Vec2]| from.last().into_iter().chain(to.first()).copied().collect();
            let [start, end]: [Vec<Vec2>; 2] = [across(&left, &lane.right.0), across(&lane.right.0, &left)];
            let [is_start, is_end] = map_ends(lanes, lane);
            let sides = [(&lane.right.0, true), (&end, !is_end), (&left, true), (&start, !is_start)];
            let meant = sides.into_iter().filter(|(_, is_known)| *is_known);
            meant.for_each(|(side, _)| edges.extend(edges_along(side, &is_road)));
        }
        let edges = Self::new(&joined(edges));
        (!edges.segments.is_empty()).then_some(edges)
    }

    /// The edges along these lines, which have the road on their left.
    pub(super) fn new(lines: &[Vec<Vec2>]) -> Self {
        let mut segments: Vec<Segment> = Vec::new();
        for line in lines {
            let first = segments.len();
            let ends = line.windows(2).map(|ends| (ends[0], ends[1] - ends[0]));
            segments.extend(ends.filter(|(_, along)| along.norm() > 1e-6).map(|(start, along)| Segment {
                start,
                along,
                length_squared: along.norm_squared(),
                neighbors: [None; 2],
            }));
            let is_closed = line.first().zip(line.last()).is_some_and(|(a, b)| a.distance(*b) < JOIN_M);
            let n = segments.len() - first;
            for i in 0..n {
                let next = if i + 1 < n { i + 1 } else { 0 };
                if n > 1 && (next > 0 || is_closed) {
                    let (own, next) = (first + i, first + next);
                    let turns_left = segments[own].along.cross(segments[next].along) > 0.0;
                    segments[own].neighbors[1] = Some((next, turns_left));
                    segments[next].neighbors[0] = Some((own, turns_left));
                }
            }
        }
        let index = SegmentIndex::new(segments.iter().map(|segment| [segment.start, segment.start + segment.along]));
        Self { segments, index }
    }

    /// The greatest signed distance of these points: above 0 off the road.
    pub(super) fn most_off_road_m(&self, points: &[Vec2]) -> f64 {
        points.iter().map(|point| self.signed_distance_m(*point)).fold(f64::NEG_INFINITY, f64::max)
    }

    /// The distance from the nearest edge, below 0 on the road.
    fn signed_distance_m(&self, point: Vec2) -> f64 {
        let distance_squared = |i: usize| Some(self.segments[i].distance_squared(point));
        let Some((nearest, squared)) = self.index.nearest(point, |squared| squared, distance_squared) else {
            return f64::NAN;
        };
        side(&self.segments, nearest, point) * squared.sqrt()
    }
}

impl Segment {
    /// The foot of `point`, as a share of the segment.
    fn share(&self, point: Vec2) -> f64 {
        (point - self.start).dot(self.along) / self.length_squared
    }

    fn distance_squared(&self, point: Vec2) -> f64 {
        (point - self.start - self.along * self.share(point).clamp(0.0, 1.0)).norm_squared()
    }

    /// 1 for a point to the right, -1 for one to the left.
    fn side(&self, point: Vec2) -> f64 {
        let right = (point - self.start).cross(self.along);
        if right == 0.0 { 0.0 } else { right.signum() }
    }
}

/// The side of the edge on which `point` is, given its `nearest` segment. Around a vertex, a point is on the road
/// beside either segment where the edge turns right, and beside both where it turns left.
fn side(segments: &[Segment], nearest: usize, point: Vec2) -> f64 {
    let own = &segments[nearest];
    let share = own.share(point);
    let neighbor = match share {
        _ if share < 0.0 => own.neighbors[0],
        _ if share > 1.0 => own.neighbors[1],
        _ => None,
    };
    let side = own.side(point);
    neighbor.map_or(side, |(other, turns_left)| {
        let other = segments[other].side(point);
        if turns_left { side.max(other) } else { side.min(other) }
    })
}

/// The parts of a side of a lane, which is on its left, beyond which there is no road.
fn edges_along(side: &[Vec2], is_road: &dyn Fn(Vec2) -> bool) -> Vec<Vec<Vec2>> {
    let mut edges: Vec<Vec<Vec2>> = Vec::new();
    let mut was_edge = false;
    for ends in side.windows(2) {
        let along = ends[1] - ends[0];
        let length_m = along.norm();
        let n_pieces = (length_m / PIECE_M).ceil().max(1.0) as usize;
        let outward = Vec2::new(along.y, -along.x) * (GAP_M / length_m.max(1e-9));
        for i in 0..n_pieces {
            let at = |i: f64| ends[0] + along * (i / n_pieces as f64);
            let is_edge = !is_road(at(i as f64 + 0.5) + outward);
            match edges.last_mut().filter(|_| was_edge && is_edge) {
                Some(edge) => {
                    // Within a segment of the side the piece before grows.
                    edge.truncate(edge.len() - usize::from(i > 0));
                    edge.push(at(i as f64 + 1.0));
                }
                None if is_edge => edges.push(vec![at(i as f64), at(i as f64 + 1.0)]),
                None => {}
            }
            was_edge = is_edge;
        }
    }
    edges
}

/// Edges that continue each other as one.
fn joined(mut open: Vec<Vec<Vec2>>) -> Vec<Vec<Vec2>> {
    let mut joined = Vec::new();
    while let Some(mut edge) = open.pop() {
        let gap_m = |from: &[Vec2], to: &[Vec2]| from.last().zip(to.first()).map_or(f64::MAX, |(a, b)| a.distance(*b));
        loop {
            let after = (0..open.len()).map(|i| (i, false, gap_m(&edge, &open[i])));
            let before = (0..open.len()).map(|i| (i, true, gap_m(&open[i], &edge)));
            let nearest = after.chain(before).min_by(|a, b| a.2.total_cmp(&b.2));
            let Some((i, is_before, _)) = nearest.filter(|nearest| nearest.2 <= JOIN_M) else { break };
            let other = open.swap_remove(i);
            edge = if is_before { [other, edge].concat() } else { [edge, other].concat() };
        }
        joined.push(edge);
    }
    joined
}

//! The lanes of a scene cut into short pieces of evenly spaced points, with distances to the edges of the road.

use crate::geometry::{Vec2, wrap_angle};
use crate::scene::{Lane, LaneGraph, LaneId, TurnDirection};
use std::collections::BTreeMap;

/// Points of a piece; neighbors in a lane share a point.
pub const PIECE_POINTS: usize = 10;
/// Pieces are at most this long, meters.
const MAX_PIECE_M: f64 = 18.0;
/// Distances to the edges of the road are capped at this, meters.
const MAX_EDGE_M: f64 = 15.0;
/// Outlines with at most this gap between them are one road, meters.
const GAP_M: f64 = 0.3;
/// The line across a lane runs this far behind its point, meters: rounding then does not decide on which side of it
/// the corners of the lane's end are.
const BEHIND_M: f64 = 1e-6;
/// Yes-or-no attributes of a piece.
pub const PIECE_FLAGS: usize = 6;

/// A point of a centerline, in the row's ego frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LanePoint {
    /// Position, meters.
    pub x: f32,
    /// Position, meters.
    pub y: f32,
    /// Direction of the lane, radians.
    pub heading_rad: f32,
    /// Distances to the edges of the road on the left and on the right, across the lane, meters; `None` if the map has
    /// no outlines.
    pub edges_m: Option<[f32; 2]>,
}

/// A piece of a lane.
#[derive(Debug, Clone, PartialEq)]
pub struct LanePiece {
    /// Its points, in driving direction.
    pub points: [LanePoint; PIECE_POINTS],
    /// The place of its lane in the scene's lane graph.
    pub lane: u32,
    /// Length along the lane, meters.
    pub length_m: f32,
    /// Turns left, turns right, lies in an intersection, is under traffic control, leads one way, is not for cars.
    pub flags: [bool; PIECE_FLAGS],
}

/// The pieces of all lanes of a scene, and their connections.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct LanePieces {
    pub(super) pieces: Vec<LanePiece>,
    /// The successors of each piece.
    pub(super) next: Vec<Vec<u32>>,
    /// The neighbors of each piece, in lanes of the same direction.
    pub(super) beside: Vec<Vec<u32>>,
}

impl LanePieces {
    /// Cuts the lanes of a scene, given in the row's ego frame.
    pub(super) fn new(lanes: &LaneGraph) -> Self {
        let outlines = Outlines::new(lanes);
        let mut pieces = Vec::new();
        // For each lane its first and last piece.
        let mut ends: BTreeMap<LaneId, (u32, u32)> = BTreeMap::new();
        for (i, lane) in lanes.lanes().iter().enumerate() {
            let first = pieces.len() as u32;
            pieces.extend(cut(lane, i as u32, &outlines));
            if pieces.len() as u32 > first {
                ends.insert(lane.id, (first, pieces.len() as u32 - 1));
            }
        }
        let mut next = vec![Vec::new(); pieces.len()];
        let mut beside = vec![Vec::new(); pieces.len()];
        for lane in lanes.lanes() {
            let Some(&(first, last)) = ends.get(&lane.id) else { continue };
            (first..last).for_each(|piece| next[piece as usize].push(piece + 1));
            let begin = |id: &LaneId| ends.get(id).map(|(first, _)| *first);
            next[last as usize].extend(lane.successors.iter().filter_map(begin));
            for neighbor in lane.left_neighbor.iter().chain(&lane.right_neighbor).filter_map(|id| ends.get(id)) {
                let n = f64::from(neighbor.1 - neighbor.0);
                for piece in first..=last {
                    let share = f64::from(piece - first) / f64::from((last - first).max(1));
                    beside[piece as usize].push(neighbor.0 + (share * n).round() as u32);
                }
            }
        }
        Self { pieces, next, beside }
    }
}

fn cut(lane: &Lane, idx: u32, outlines: &Outlines) -> Vec<LanePiece> {
    let length_m = lane.centerline.length_m();
    if !length_m.is_finite() || length_m < 0.1 {
        return Vec::new();
    }
    let n_pieces = (length_m / MAX_PIECE_M).ceil().max(1.0) as usize;
    let points = lane.centerline.resampled(n_pieces * (PIECE_POINTS - 1) + 1).0;
    let lane_points: Vec<LanePoint> = (0..points.len())
        .map(|i| {
            let (before, after) = (points[i.saturating_sub(1)], points[(i + 1).min(points.len() - 1)]);
            let heading = (after - before).angle();
            let Vec2 { x, y } = points[i];
            let edges_m = outlines.edges(points[i], heading).map(|edges| edges.map(|edge| edge as f32));
            LanePoint { x: x as f32, y: y as f32, heading_rad: heading as f32, edges_m }
        })
        .collect();
    let attributes = &lane.attributes;
    let flags = [
        attributes.turn == TurnDirection::Left,
        attributes.turn == TurnDirection::Right,
        attributes.is_intersection,
        attributes.has_traffic_control,
        attributes.one_way,
        matches!(attributes.kind.as_str(), "crosswalk" | "walkway" | "bicycle_lane" | "BIKE"),
    ];
    (0..n_pieces)
        .filter_map(|i| {
            let points = lane_points.get(i * (PIECE_POINTS - 1)..)?.first_chunk::<PIECE_POINTS>()?;
            Some(LanePiece { points: *points, lane: idx, length_m: (length_m / n_pieces as f64) as f32, flags })
        })
        .collect()
}

struct Outlines {
    outlines: Vec<Outline>,
}

struct Outline {
    points: Vec<Vec2>,
    center: Vec2,
    radius_m: f64,
}

impl Outlines {
    fn new(lanes: &LaneGraph) -> Self {
        let outline = |lane: &Lane| {
            let points = lane.outline()?;
            let n = points.len() as f64;
            let center = points.iter().fold(Vec2::ZERO, |sum, p| sum + *p) * n.recip();
            let radius_m = points.iter().map(|p| p.distance(center)).fold(0.0, f64::max);
            Some(Outline { points, center, radius_m })
        };
        Self { outlines: lanes.lanes().iter().filter_map(outline).collect() }
    }

    /// Distances from `point` to the left and right edges of the road (the union of all outlines), across
    /// `heading_rad`.
    fn edges(&self, point: Vec2, heading_rad: f64) -> Option<[f64; 2]> {
        let along = Vec2::from_angle(heading_rad);
        let mut inside: Vec<(f64, f64)> = Vec::new();
        let near = self.outlines.iter().filter(|o| o.center.distance(point) < o.radius_m + MAX_EDGE_M);
        for outline in near {
            crossings(&outline.points, point, along, &mut inside);
        }
        inside.sort_by(|a, b| a.0.total_cmp(&b.0));
        let (mut left, mut right) = (None::<f64>, 0.0f64);
        // Intervals are visited from right to left; the run that holds the point, or nearly, is the road it is on.
        let mut run: Option<(f64, f64)> = None;
        for (from, to) in inside.into_iter().chain([(f64::INFINITY, f64::INFINITY)]) {
            run = match run {
                Some((begin, end)) if from <= end + GAP_M => Some((begin, end.max(to))),
                Some((begin, end)) => {
                    if begin <= GAP_M && end >= -GAP_M && left.is_none() {
                        (left, right) = (Some(end), begin);
                    }
                    Some((from, to))
                }
                None => Some((from, to)),
            };
        }
        Some([left?.clamp(0.0, MAX_EDGE_M), (-right).clamp(0.0, MAX_EDGE_M)])
    }
}

/// Adds the intervals in which the line through `point` across `along` is inside of a closed outline, meters to the
/// left.
fn crossings(outline: &[Vec2], point: Vec2, along: Vec2, inside: &mut Vec<(f64, f64)>) {
    let mut at: Vec<f64> = Vec::new();
    let n = outline.len();
    for i in 0..n {
        let (a, b) = (outline[i] - point, outline[(i + 1) % n] - point);
        // Coordinates along the heading and to the left of it.
        let (ahead_a, ahead_b) = (along.dot(a) + BEHIND_M, along.dot(b) + BEHIND_M);
        if (ahead_a < 0.0) != (ahead_b < 0.0) {
            let share = ahead_a / (ahead_a - ahead_b);
            let (left_a, left_b) = (along.cross(a), along.cross(b));
            at.push(left_a + share * (left_b - left_a));
        }
    }
    at.sort_by(f64::total_cmp);
    inside.extend(at.chunks_exact(2).map(|pair| (pair[0], pair[1])));
}

/// The signed difference of two headings.
pub(super) fn turn_rad(to: f32, from: f32) -> f32 {
    wrap_angle(f64::from(to) - f64::from(from)) as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Polyline;

    /// Straight lanes of 40 m along x, side by side from right to left, each 3 m wide.
    fn road(n_lanes: i64) -> LaneGraph {
        let line = |y: f64| Polyline((0..=4).map(|i| Vec2::new(f64::from(i) * 10.0, y)).collect());
        let lane = |i: i64| Lane {
            id: LaneId(i),
            centerline: line(3.0 * i as f64),
            left: line(3.0 * i as f64 + 1.5),
            right: line(3.0 * i as f64 - 1.5),
            successors: Vec::new(),
            predecessors: Vec::new(),
            left_neighbor: (i + 1 < n_lanes).then_some(LaneId(i + 1)),
            right_neighbor: (i > 0).then_some(LaneId(i - 1)),
            attributes: std::sync::Arc::default(),
        };
        LaneGraph::new((0..n_lanes).map(lane).collect())
    }

    #[test]
    fn edges_are_those_of_the_whole_road() {
        let LanePieces { pieces, next, beside } = LanePieces::new(&road(3));
        assert_eq!(pieces.len(), 9);
        for piece in &pieces {
            let i = piece.lane as f32;
            for point in &piece.points[1..9] {
                let [left, right] = point.edges_m.unwrap();
                assert!((left - (1.5 + 3.0 * (2.0 - i))).abs() < 1e-4 && (right - (1.5 + 3.0 * i)).abs() < 1e-4);
                assert!(point.heading_rad.abs() < 1e-6);
            }
        }
        assert_eq!((next[0].as_slice(), next[2].as_slice()), ([1].as_slice(), [].as_slice()));
        assert_eq!(beside[1], [4]);
        assert_eq!(beside[4], [7, 1]);
    }

    #[test]
    fn lanes_without_outlines_have_no_edges() {
        let bare = LaneGraph::new(
            road(1)
                .lanes()
                .iter()
                .map(|lane| Lane { left: Polyline::default(), right: Polyline::default(), ..lane.clone() })
                .collect(),
        );
        let pieces = LanePieces::new(&bare).pieces;
        assert!(pieces.len() == 3 && pieces.iter().all(|piece| piece.points.iter().all(|p| p.edges_m.is_none())));
        assert!(LanePieces::new(&LaneGraph::default()).pieces.is_empty());
    }
}

//! The drivable surface of the lanes of a scene.

use crate::behavior::footprint::Bounds;
use crate::behavior::lane_relation::{HALF_NOMINAL_WIDTH_M, is_in_polygon};
use crate::geometry::{Polyline, Vec2};
use crate::scene::{Lane, LaneGraph, LaneId};

/// Points this far outside the outlines still count as on the road, meters (nuPlan's tolerance).
const SLACK_M: f64 = 0.3;
/// How far a lane is extended straight beyond the map's end, meters, because the road is unknown there.
const EXTENSION_M: f64 = 100.0;

/// The union of the outlines of all lanes; for lanes without boundaries, the strip of 3.8 m around the center line.
pub(crate) struct Road {
    pieces: Vec<(Bounds, Piece)>,
}

enum Piece {
    /// An area with a closed outline, and that outline.
    Outline(Vec<Vec2>, Polyline),
    /// A strip around a center line.
    Strip(Polyline),
}

impl Road {
    /// The road of these lanes. Lanes are extended straight beyond ends that no lane of `lanes` continues, unless a
    /// neighbor continues there: such a lane ends on the road.
    pub(crate) fn new(lanes: &LaneGraph) -> Self {
        let pieces = lanes.lanes().iter().flat_map(|lane| {
            let outline = lane.outline().map(|outline| {
                let closed = outline.iter().chain(outline.first()).copied().collect();
                Piece::Outline(outline, Polyline(closed))
            });
            let piece = outline.unwrap_or_else(|| Piece::Strip(lane.centerline.clone()));
            open_ends(lanes, lane).into_iter().chain([piece])
        });
        Self { pieces: pieces.filter_map(|piece| Some((piece.bounds()?, piece))).collect() }
    }

    /// Whether `point` is on the road, or off it by no more than the slack.
    pub(super) fn holds(&self, point: Vec2) -> bool {
        let candidates = || {
            let could_hold = |bounds: &Bounds| bounds.contains(point, HALF_NOMINAL_WIDTH_M);
            self.pieces.iter().filter(move |(bounds, _)| could_hold(bounds)).map(|(_, piece)| piece)
        };
        // Most points are inside some outline, which is quicker to check.
        candidates().any(|piece| piece.contains(point)) || candidates().any(|piece| piece.is_near(point))
    }

    /// The distance of `point` from the road, meters; 0 on it. NaN if the point is NaN.
    pub(crate) fn distance_m(&self, point: Vec2) -> f64 {
        if !point.is_finite() {
            return f64::NAN;
        }
        let is_inside = |(bounds, piece): &(Bounds, Piece)| bounds.contains(point, 0.0) && piece.contains(point);
        match self.pieces.iter().any(is_inside) {
            true => 0.0,
            false => self.pieces.iter().map(|(_, piece)| piece.distance_m(point)).fold(f64::INFINITY, f64::min),
        }
    }
}

impl Piece {
    fn bounds(&self) -> Option<Bounds> {
        let (Self::Outline(_, line) | Self::Strip(line)) = self;
        Bounds::around(line.0.iter().copied())
    }

    fn contains(&self, point: Vec2) -> bool {
        matches!(self, Self::Outline(outline, _) if is_in_polygon(outline, point))
    }

    /// The distance of `point`, which is within no outline, from the piece, meters.
    fn distance_m(&self, point: Vec2) -> f64 {
        let (line, half_width_m) = match self {
            Self::Outline(_, closed) => (closed, 0.0),
            Self::Strip(line) => (line, HALF_NOMINAL_WIDTH_M),
        };
        line.project(point).map_or(f64::INFINITY, |place| (place.offset_m.abs() - half_width_m).max(0.0))
    }

    /// Whether `point` is within the slack of an outline, or on a strip.
    fn is_near(&self, point: Vec2) -> bool {
        let (line, limit_m) = match self {
            Self::Outline(_, closed) => (closed, SLACK_M),
            Self::Strip(line) => (line, HALF_NOMINAL_WIDTH_M),
        };
        line.project(point).is_some_and(|projection| projection.offset_m.abs() <= limit_m)
    }
}

/// Whether the map ends at the start of a lane, and at its end: no lane continues there, nor from a neighbor.
pub(super) fn map_ends(lanes: &LaneGraph, lane: &Lane) -> [bool; 2] {
    let is_map_end = |connected: fn(&Lane) -> &Vec<LaneId>| {
        let mut neighbors =
            [lane.left_neighbor, lane.right_neighbor].into_iter().flatten().filter_map(|id| lanes.get(id));
        connected(lane).is_empty() && neighbors.all(|neighbor| connected(neighbor).is_empty())
    };
    [is_map_end(|lane| &lane.predecessors), is_map_end(|lane| &lane.successors)]
}

/// The continuations of a lane before its start and beyond its end, if the map ends there.
fn open_ends(lanes: &LaneGraph, lane: &Lane) -> Vec<Piece> {
    let points = &lane.centerline.0;
    let ray = |from: Option<&Vec2>, end: Option<&Vec2>| {
        let (from, end) = (*from?, *end?);
        let onward = Vec2::from_angle((end - from).angle()) * EXTENSION_M;
        Some(Piece::Strip(Polyline(vec![end, end + onward])))
    };
    let [is_start, is_end] = map_ends(lanes, lane);
    let before = is_start.then(|| ray(points.get(1), points.first())).flatten();
    let beyond = is_end.then(|| ray(points.iter().rev().nth(1), points.last())).flatten();
    before.into_iter().chain(beyond).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::testing;

    #[test]
    fn a_lane_without_boundaries_is_as_wide_as_usual() {
        let mut lane = testing::scene(&[]).lanes.lanes()[0].clone();
        for boundary in [&mut lane.left, &mut lane.right] {
            boundary.0.clear();
        }
        let road = Road::new(&LaneGraph::new(vec![lane]));
        for (x, offset_m, distance_m) in [(0.0, 0.0, 0.0), (0.0, 1.8, 0.0), (0.0, -5.0, 3.1), (130.0, 4.9, 3.0)] {
            let found = road.distance_m(Vec2::new(x, offset_m));
            assert!((found - distance_m).abs() < 1e-9, "{offset_m} m from its middle: {found}");
        }
    }
}

//! The road: lanes as strips around their center lines, and the strip nearest to a point.

use crate::geometry::{Polyline, SegmentIndex, Transform2, Vec2};
use crate::scene::{Lane, LaneGraph, LaneId};

/// Half the width of a lane without boundaries in the map, meters.
const HALF_NOMINAL_WIDTH_M: f64 = 1.75;
/// How far lanes continue straight where the map ends, meters: the road is unknown there.
const EXTENSION_M: f64 = 100.0;

/// The road of a scene: each lane as a chain of straight strips.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct RoadCorridors {
    strips: Vec<Strip>,
    index: SegmentIndex,
    /// Half the width of the widest strip.
    most_half_width_m: f64,
}

/// All points at most `half_width_m` from a line of `length_m` that leads from `start` in the direction of `along`.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Strip {
    start: Vec2,
    along: Vec2,
    length_m: f64,
    half_width_m: f64,
}

/// The nearest place on the road.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct NearestRoad {
    /// The nearest point of the center line of the nearest strip.
    pub(super) point: Vec2,
    /// Half the width of that strip, meters.
    pub(super) half_width_m: f64,
}

impl RoadCorridors {
    /// The road of these lanes, in the frame that `to_from_here` leads to.
    pub(super) fn new(lanes: &LaneGraph, to_from_here: &Transform2) -> Self {
        let strips: Vec<Strip> = lanes.lanes().iter().flat_map(|lane| strips(lanes, lane, to_from_here)).collect();
        let index = SegmentIndex::new(strips.iter().map(|strip| [strip.start, strip.end()]));
        let most_half_width_m = strips.iter().map(|strip| strip.half_width_m).fold(0.0, f64::max);
        Self { strips, index, most_half_width_m }
    }

    /// The center line of the strip that `point` is the least distance outside of, or farthest inside. `None` without
    /// lanes.
    pub(super) fn nearest(&self, point: Vec2) -> Option<NearestRoad> {
        let excess_m = |i: usize| {
            let nearest = self.strips[i].nearest(point);
            Some(nearest.point.distance(point) - nearest.half_width_m)
        };
        let (i, _) = self.index.nearest(point, |squared| squared.sqrt() - self.most_half_width_m, excess_m)?;
        Some(self.strips[i].nearest(point))
    }
}

impl Strip {
    fn new(start: Vec2, end: Vec2, half_width_m: f64) -> Option<Self> {
        let length_m = start.distance(end);
        (length_m > 0.0).then(|| Self { start, along: (end - start) * (1.0 / length_m), length_m, half_width_m })
    }

    fn end(&self) -> Vec2 {
        self.start + self.along * self.length_m
    }

    fn nearest(&self, point: Vec2) -> NearestRoad {
        let station_m = (point - self.start).dot(self.along).clamp(0.0, self.length_m);
        NearestRoad { point: self.start + self.along * station_m, half_width_m: self.half_width_m }
    }
}

/// The strips of a lane, with extensions beyond ends that no other lane continues. A lane that ends while one beside it
/// goes on has none: the road becomes narrower there.
fn strips(lanes: &LaneGraph, lane: &Lane, to_from_here: &Transform2) -> Vec<Strip> {
    let beside = [lane.left_neighbor, lane.right_neighbor].map(|id| id.and_then(|id| lanes.get(id)));
    let is_open = |connections: fn(&Lane) -> &[LaneId]| {
        connections(lane).is_empty() && !beside.iter().flatten().any(|lane| !connections(lane).is_empty())
    };
    let points: Vec<Vec2> = lane.centerline.0.iter().map(|point| to_from_here.point(*point)).collect();
    let middles = lane.centerline.0.windows(2).map(|pair| half_width_m(lane, pair[0].lerp(pair[1], 0.5)));
    let mut strips: Vec<Strip> = points
        .windows(2)
        .zip(middles)
        .filter_map(|(pair, half_width_m)| Strip::new(pair[0], pair[1], half_width_m))
        .collect();
    if let (true, Some(first)) = (is_open(|lane| &lane.predecessors), strips.first().copied()) {
        let start = first.start - first.along * EXTENSION_M;
        strips.extend(Strip::new(start, first.start, first.half_width_m));
        strips.rotate_right(1);
    }
    if let (true, Some(last)) = (is_open(|lane| &lane.successors), strips.last().copied()) {
        strips.extend(Strip::new(last.end(), last.end() + last.along * EXTENSION_M, last.half_width_m));
    }
    strips
}

/// Half the width of a lane at a point of its center line: the mean distance of its boundaries.
fn half_width_m(lane: &Lane, point: Vec2) -> f64 {
    let distance_m = |line: &Polyline| line.project(point).map(|projection| projection.offset_m.abs());
    let both = distance_m(&lane.left).zip(distance_m(&lane.right));
    both.map_or(HALF_NOMINAL_WIDTH_M, |(left, right)| (left + right) / 2.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::testing::{Drive, scene};

    #[test]
    fn the_nearest_strip_is_the_one_by_excess() {
        // One lane along y = 0 from x = -40 to 80, boundaries at ±1.75 m.
        let lanes = scene(&[Drive::straight(0.0, 0.0, 0.0, 1.0)]).lanes;
        let road = RoadCorridors::new(&lanes, &Transform2::IDENTITY);
        let near = road.nearest(Vec2::new(7.0, 4.0)).expect("a lane");
        assert!(near.point.distance(Vec2::new(7.0, 0.0)) < 1e-9 && (near.half_width_m - 1.75).abs() < 1e-9);
        // Carried on by 100 m at both ends, and no further.
        assert!(road.nearest(Vec2::new(150.0, 1.0)).expect("a lane").point.distance(Vec2::new(150.0, 0.0)) < 1e-9);
        assert!(road.nearest(Vec2::new(-150.0, 1.0)).expect("a lane").point.distance(Vec2::new(-140.0, 0.0)) < 1e-9);
        // In another frame: the lane turned by 90 degrees and moved.
        let moved = Transform2::from_pose(Vec2::new(3.0, 0.0), std::f64::consts::FRAC_PI_2);
        let near = RoadCorridors::new(&lanes, &moved).nearest(Vec2::new(0.0, 7.0)).expect("a lane");
        assert!(near.point.distance(Vec2::new(3.0, 7.0)) < 1e-9);
    }

    #[test]
    fn a_lane_that_ends_beside_one_that_goes_on_is_not_carried_on() {
        let graph = scene(&[Drive::straight(0.0, 0.0, 0.0, 1.0)]).lanes;
        let dropped = &graph.lanes()[0];
        let line = |from: f64, to: f64| Polyline(vec![Vec2::new(from, 3.5), Vec2::new(to, 3.5)]);
        let (beside, onward) = (LaneId(7001), LaneId(7002));
        let lane = |id, centerline, predecessors, successors| Lane {
            id,
            centerline,
            predecessors,
            successors,
            left: Polyline::default(),
            right: Polyline::default(),
            left_neighbor: None,
            right_neighbor: None,
            ..dropped.clone()
        };
        let road = |left_neighbor| {
            let lanes = vec![
                Lane { left_neighbor, ..dropped.clone() },
                lane(beside, line(-40.0, 80.0), Vec::new(), vec![onward]),
                lane(onward, line(80.0, 200.0), vec![beside], Vec::new()),
            ];
            RoadCorridors::new(&LaneGraph::new(lanes), &Transform2::IDENTITY)
        };
        let at = |road: RoadCorridors| road.nearest(Vec2::new(120.0, 0.0)).expect("a lane").point;
        assert!(at(road(None)).distance(Vec2::new(120.0, 0.0)) < 1e-9);
        assert!(at(road(Some(beside))).distance(Vec2::new(120.0, 3.5)) < 1e-9);
    }

    #[test]
    fn lanes_without_boundaries_have_a_nominal_width_and_no_lanes_are_nowhere() {
        let graph = scene(&[Drive::straight(0.0, 0.0, 0.0, 1.0)]).lanes;
        let bare = graph.lanes().iter().map(|lane| Lane { left: Polyline::default(), ..lane.clone() }).collect();
        let road = RoadCorridors::new(&LaneGraph::new(bare), &Transform2::IDENTITY);
        assert_eq!(road.nearest(Vec2::ZERO).map(|near| near.half_width_m), Some(HALF_NOMINAL_WIDTH_M));
        assert_eq!(RoadCorridors::default().nearest(Vec2::ZERO), None);
    }
}

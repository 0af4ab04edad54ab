//! Finds the lanes of a map near points.

use crate::geometry::{Vec2, angle_difference};
use crate::scene::{Lane, LaneGraph, LaneId};
use std::sync::Arc;

/// Lanes run the same way if their directions differ by less, radians: as branches of a fork do.
const SAME_WAY_RAD: f64 = std::f64::consts::FRAC_PI_6;

/// A map with the bounds of its lanes, to skip far ones quickly.
#[derive(Debug, Clone)]
pub(super) struct LaneIndex {
    graph: Arc<LaneGraph>,
    /// Least and greatest coordinates of each centerline.
    bounds: Vec<(Vec2, Vec2)>,
}

impl LaneIndex {
    pub(super) fn new(graph: Arc<LaneGraph>) -> Self {
        let bounds = graph.lanes().iter().map(bounds).collect();
        Self { graph, bounds }
    }

    /// The whole map.
    pub(super) fn graph(&self) -> &LaneGraph {
        &self.graph
    }

    /// Least and greatest coordinates of all centerlines.
    pub(super) fn bounds(&self) -> Option<(Vec2, Vec2)> {
        self.bounds.iter().copied().reduce(|(least, greatest), (a, b)| {
            (Vec2::new(least.x.min(a.x), least.y.min(a.y)), Vec2::new(greatest.x.max(b.x), greatest.y.max(b.y)))
        })
    }

    /// Whether the centerline of any lane comes within the circle.
    pub(super) fn has_any_within(&self, circle: Circle) -> bool {
        self.candidates(circle.center, circle.radius_m).any(|lane| circle.meets(lane))
    }

    /// The lanes whose centerline comes within any of the circles, by ascending id.
    pub(super) fn within_any(&self, circles: &[Circle]) -> Vec<LaneId> {
        let lanes = self.graph.lanes().iter().zip(&self.bounds);
        let is_within = |(lane, bounds): &(&Lane, &(Vec2, Vec2))| {
            circles.iter().any(|circle| circle.may_meet(**bounds) && circle.meets(lane))
        };
        lanes.filter(is_within).map(|(lane, _)| lane.id).collect()
    }

    /// Direction of the lane nearest to `point`, if one comes within `radius_m`.
    pub(super) fn heading_at(&self, point: Vec2, radius_m: f64) -> Option<f64> {
        self.candidates(point, radius_m)
            .filter_map(|lane| lane.centerline.project(point))
            .filter(|projection| projection.offset_m.abs() <= radius_m)
            .min_by(|a, b| a.offset_m.abs().total_cmp(&b.offset_m.abs()))
            .map(|projection| projection.heading_rad)
    }

    /// Direction of the lanes that come within `radius_m` of `point`: of the nearest, if all run the same way.
    pub(super) fn sole_heading_at(&self, point: Vec2, radius_m: f64) -> Option<f64> {
        let nearest_rad = self.heading_at(point, radius_m)?;
        let near = self.candidates(point, radius_m).filter_map(|lane| lane.centerline.project(point));
        let mut near = near.filter(|projection| projection.offset_m.abs() <= radius_m);
        near.all(|lane| angle_difference(lane.heading_rad, nearest_rad).abs() <= SAME_WAY_RAD).then_some(nearest_rad)
    }

    fn candidates(&self, point: Vec2, radius_m: f64) -> impl Iterator<Item = &Lane> {
        let circle = Circle { center: point, radius_m };
        let near = self.graph.lanes().iter().zip(&self.bounds).filter(move |(_, bounds)| circle.may_meet(**bounds));
        near.map(|(lane, _)| lane)
    }
}

/// All points within a distance of a center.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Circle {
    pub(super) center: Vec2,
    pub(super) radius_m: f64,
}

impl Circle {
    /// Whether a lane within these bounds may come within the circle.
    fn may_meet(&self, (least, greatest): (Vec2, Vec2)) -> bool {
        let Self { center, radius_m } = *self;
        center.x >= least.x - radius_m
            && center.x <= greatest.x + radius_m
            && center.y >= least.y - radius_m
            && center.y <= greatest.y + radius_m
    }

    /// Whether the centerline of `lane` comes within the circle.
    fn meets(&self, lane: &Lane) -> bool {
        lane.centerline.project(self.center).is_some_and(|place| place.offset_m.abs() <= self.radius_m)
    }
}

fn bounds(lane: &Lane) -> (Vec2, Vec2) {
    let nothing = (Vec2::new(f64::INFINITY, f64::INFINITY), Vec2::new(f64::NEG_INFINITY, f64::NEG_INFINITY));
    lane.centerline.0.iter().fold(nothing, |(least, greatest), p| {
        (Vec2::new(least.x.min(p.x), least.y.min(p.y)), Vec2::new(greatest.x.max(p.x), greatest.y.max(p.y)))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ingest::lane_topology::tests::lane;

    #[test]
    fn lanes_are_found_by_their_closest_point() {
        // A diagonal lane whose bounds hold the point though the lane itself is 10 / √2 m away.
        let lanes = vec![lane(1, (0.0, 0.0), (100.0, 100.0)), lane(2, (0.0, 200.0), (100.0, 200.0))];
        let index = LaneIndex::new(Arc::new(LaneGraph::new(lanes)));
        let point = Vec2::new(60.0, 50.0);
        let circle = |radius_m: f64| Circle { center: point, radius_m };
        assert_eq!(index.within_any(&[circle(7.0)]), []);
        assert_eq!(index.within_any(&[circle(7.2)]), [LaneId(1)]);
        assert_eq!(index.within_any(&[circle(150.0)]), [LaneId(1), LaneId(2)]);
        assert_eq!((index.has_any_within(circle(7.0)), index.has_any_within(circle(7.2))), (false, true));
        let at_the_other = Circle { center: Vec2::new(0.0, 200.0), radius_m: 1.0 };
        let found = index.within_any(&[circle(7.2), at_the_other]);
        assert_eq!(found, [LaneId(1), LaneId(2)], "each circle brings its lanes");
        assert!(index.heading_at(point, 7.0).is_none());
        let heading = index.heading_at(point, 160.0).expect("both lanes are near");
        assert!((heading - std::f64::consts::FRAC_PI_4).abs() < 1e-12);
    }

    #[test]
    fn lanes_tell_a_heading_if_they_run_the_same_way() {
        // Two lanes east, and one back.
        let lanes = [(0.0, (0.0, 50.0)), (3.0, (0.0, 50.0)), (6.0, (50.0, 0.0))];
        let lanes = (1..).zip(lanes).map(|(id, (y, (from, to)))| lane(id, (from, y), (to, y)));
        let index = LaneIndex::new(Arc::new(LaneGraph::new(lanes.collect())));
        let at = |y: f64| index.sole_heading_at(Vec2::new(20.0, y), 2.0);
        let found = [at(1.5), at(4.5), at(6.5).map(f64::abs), at(9.0)];
        assert_eq!(found, [Some(0.0), None, Some(std::f64::consts::PI), None]);
    }
}

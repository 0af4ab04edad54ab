//! The center lines of ways that lead on from the lane beside an agent.

use crate::geometry::{Polyline, Transform2, Vec2, angle_difference};
use crate::scene::{Lane, LaneGraph, LaneId};
use std::collections::BTreeSet;
use std::f64::consts::{FRAC_PI_4, FRAC_PI_8};
use std::sync::Arc;

/// An agent is in a lane whose center line is within half a wide lane of it, meters, and whose direction is within this
/// angle of its heading.
const IN_LANE_M: f64 = 2.0;
const ALONG_RAD: f64 = FRAC_PI_4;
/// Lanes beside each other have parallel center lines, and distances between them in this range, meters.
const PARALLEL_RAD: f64 = FRAC_PI_8;
const BESIDE_M: std::ops::Range<f64> = 2.0..5.5;
/// How far ways lead on from the lane in which they begin, meters, and their largest number.
const AHEAD_M: f64 = 120.0;
const N_WAYS: usize = 12;
/// How far they run straight on at both ends, meters.
const EXTENSION_M: f64 = 60.0;
/// Points closer together than this are one, meters.
const MIN_SPACING_M: f64 = 0.05;

/// The lanes of a row's scene, and the way from their frame into the row's.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct LaneWays {
    lanes: Arc<LaneGraph>,
    row_from_scene: Transform2,
}

/// A pose in the row's frame.
#[derive(Debug, Clone, Copy)]
pub(super) struct WayPose {
    pub(super) position: Vec2,
    pub(super) heading_rad: f64,
}

impl LaneWays {
    /// The ways of these lanes, in the frame that `row_from_scene` leads to.
    pub(super) fn new(lanes: &Arc<LaneGraph>, row_from_scene: &Transform2) -> Self {
        Self { lanes: Arc::clone(lanes), row_from_scene: *row_from_scene }
    }

    /// The lines, in the row's frame, of the lanes beside those that an agent at `pose` is in, on its left (`side` > 0)
    /// or right: lanes that the map names as neighbors, and parallel ones that do not join.
    pub(super) fn beside(&self, pose: WayPose, side: f64) -> Vec<Polyline> {
        let scene_from_row = self.row_from_scene.inverse();
        let heading_rad = scene_from_row.heading(pose.heading_rad);
        let pose = WayPose { position: scene_from_row.point(pose.position), heading_rad };
        let mut lines = self.beside_in_scene(pose, side);
        lines.iter_mut().flat_map(|line| &mut line.0).for_each(|point| *point = self.row_from_scene.point(*point));
        lines
    }

    /// [`Self::beside`] in the scene's frame.
    fn beside_in_scene(&self, pose: WayPose, side: f64) -> Vec<Polyline> {
        let own = self.own(pose);
        let named: BTreeSet<LaneId> = own
            .iter()
            .filter_map(|lane| if side > 0.0 { lane.left_neighbor } else { lane.right_neighbor })
            .filter(|id| self.lanes.get(*id).is_some_and(|lane| self.is_beside(lane, pose, side)))
            .collect();
        if !named.is_empty() {
            return named.into_iter().flat_map(|id| self.lines(id)).collect();
        }
        let joined: BTreeSet<LaneId> = own.iter().flat_map(|lane| self.ids_ahead(lane.id)).collect();
        let parallel = self.lanes.lanes().iter().filter(|lane| self.is_beside(lane, pose, side));
        let parallel = parallel.filter(|lane| !own.is_empty() && self.ids_ahead(lane.id).is_disjoint(&joined));
        parallel.flat_map(|lane| self.lines(lane.id)).collect()
    }

    /// The lanes that an agent at `pose` is in.
    fn own(&self, pose: WayPose) -> Vec<&Lane> {
        let is_own = |lane: &&Lane| passes(lane, pose, ALONG_RAD).is_some_and(|offset_m| offset_m.abs() < IN_LANE_M);
        self.lanes.lanes().iter().filter(is_own).collect()
    }

    fn is_beside(&self, lane: &Lane, pose: WayPose, side: f64) -> bool {
        // An agent to the right of a line has a negative offset from it.
        passes(lane, pose, PARALLEL_RAD).is_some_and(|offset_m| BESIDE_M.contains(&(-side.signum() * offset_m)))
    }

    fn ids_ahead(&self, start: LaneId) -> BTreeSet<LaneId> {
        self.lanes.ways_ahead(start, AHEAD_M, N_WAYS).into_iter().flatten().map(|lane| lane.id).collect()
    }

    fn lines(&self, start: LaneId) -> Vec<Polyline> {
        let ways = self.lanes.ways_ahead(start, AHEAD_M, N_WAYS);
        ways.into_iter().filter_map(|way| carried_on(way.into_iter().flat_map(|lane| &lane.centerline.0))).collect()
    }
}

/// The offset of an agent at `pose` to the left of the lane's center line, if the lane passes it in its direction.
fn passes(lane: &Lane, pose: WayPose, within_rad: f64) -> Option<f64> {
    let place = lane.centerline.project(pose.position)?;
    let is_along = angle_difference(place.heading_rad, pose.heading_rad).abs() < within_rad;
    let aside = (pose.position - place.point).dot(Vec2::from_angle(place.heading_rad)).abs();
    (is_along && aside < 1.0).then_some(place.offset_m)
}

/// The line through `points`, carried straight on at both ends.
fn carried_on<'a>(points: impl Iterator<Item = &'a Vec2>) -> Option<Polyline> {
    let mut line: Vec<Vec2> = Vec::new();
    for point in points {
        if line.last().is_none_or(|last| last.distance(*point) > MIN_SPACING_M) {
            line.push(*point);
        }
    }
    let onward = |from: Vec2, to: Vec2| to + Vec2::from_angle((to - from).angle()) * EXTENSION_M;
    let [first, second, ..] = line[..] else { return None };
    let end = onward(line[line.len() - 2], line[line.len() - 1]);
    line.insert(0, onward(second, first));
    line.push(end);
    Some(Polyline(line))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lane(id: i64, points: &[(f64, f64)], successors: &[i64]) -> Lane {
        let centerline = Polyline(points.iter().map(|(x, y)| Vec2::new(*x, *y)).collect());
        let successors = successors.iter().map(|id| LaneId(*id)).collect();
        Lane { successors, ..Lane::unconnected(id, centerline, Default::default()) }
    }

    /// Lane 1 along x forks into 2, straight on, and 3, to the left; 4 is to its left, 5 beyond that, 6 is to its right
    /// and joins 2, and 7 is oncoming.
    fn ways() -> LaneWays {
        let lanes = vec![
            lane(1, &[(0.0, 0.0), (50.0, 0.0)], &[2, 3]),
            lane(2, &[(50.0, 0.0), (100.0, 0.0)], &[]),
            lane(3, &[(50.0, 0.0), (60.0, 10.0), (60.0, 60.0)], &[]),
            lane(4, &[(0.0, 3.5), (100.0, 3.5)], &[]),
            lane(5, &[(0.0, 7.0), (100.0, 7.0)], &[]),
            lane(6, &[(0.0, -3.5), (50.0, -3.5)], &[2]),
            lane(7, &[(100.0, 3.4), (0.0, 3.4)], &[]),
        ];
        LaneWays::new(&Arc::new(LaneGraph::new(lanes)), &Transform2::IDENTITY)
    }

    fn pose(x: f64, y: f64) -> WayPose {
        WayPose { position: Vec2::new(x, y), heading_rad: 0.05 }
    }

    #[test]
    fn the_lane_beside_leads_the_same_way_and_does_not_join() {
        let beside = |side: f64| ways().beside(pose(20.0, 0.2), side);
        let left = beside(1.0);
        assert_eq!(left.len(), 1);
        assert!(left[0].0.iter().all(|point| (point.y - 3.5).abs() < 1e-9));
        assert!(beside(-1.0).is_empty());
        // In another frame the same line, moved.
        let moved = Transform2::from_pose(Vec2::new(3.0, -2.0), 1.0);
        let own = WayPose { position: moved.point(Vec2::new(20.0, 0.2)), heading_rad: moved.heading(0.05) };
        let there = LaneWays::new(&ways().lanes, &moved).beside(own, 1.0);
        assert!(there[0].0.iter().zip(&left[0].0).all(|(a, b)| a.distance(moved.point(*b)) < 1e-9));
        // The map's declaration counts if lanes join.
        let mut named = ways().lanes.lanes().to_vec();
        named[0].right_neighbor = Some(LaneId(6));
        let named = LaneWays::new(&Arc::new(LaneGraph::new(named)), &Transform2::IDENTITY);
        assert_eq!(named.beside(pose(20.0, 0.2), -1.0).len(), 1);
    }
}

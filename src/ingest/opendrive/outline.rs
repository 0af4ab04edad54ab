//! The edges of lanes as points.

use super::cubic::{bend_between, value_at};
use super::plan_view::pose_at;
use super::road::Road;
use super::section::{RoadLane, Section};
use super::{MAX_ROUNDING_M, SAME_M};
use crate::geometry::{Polyline, Vec2, angle_difference};

/// Points are at most this far apart along the road, meters, and as close as a bend requires for an error of
/// millimeters.
const MAX_STEP_M: f64 = 2.0;
const MIN_STEP_M: f64 = 0.1;
const MAX_ERROR_M: f64 = 0.005;

/// The edges of each lane of a section, from left to right in the direction of the road: the left edge of the first,
/// the right one of the first, … Points of all edges correspond. `None` if the section has no length.
pub(super) fn edges(road: &Road, section: &Section) -> Option<Vec<Edges>> {
    let Section { start_m, lanes, .. } = section;
    let distances_m = distances(road, section)?;
    let mut edges: Vec<Edges> = lanes.iter().map(|_| Edges::default()).collect();
    for s_m in distances_m {
        let (at, heading_rad) = pose_at(&road.plan_view, s_m)?;
        let aside = Vec2::new(-heading_rad.sin(), heading_rad.cos());
        let center_m = value_at(&road.lane_offset, s_m);
        let mut place = |index: usize, [left_m, right_m]: [f64; 2]| {
            let point = |t_m: f64| at + aside * (center_m + t_m);
            edges[index].left.0.push(point(left_m));
            edges[index].right.0.push(point(right_m));
        };
        let mut outward_m = 0.0;
        for (index, lane) in lanes.iter().enumerate().rev().filter(|(_, lane)| lane.id > 0) {
            let inner_m = outward_m;
            outward_m = outer_m(lane, s_m - *start_m, inner_m, 1.0);
            place(index, [outward_m, inner_m]);
        }
        outward_m = 0.0;
        for (index, lane) in lanes.iter().enumerate().filter(|(_, lane)| lane.id < 0) {
            let inner_m = outward_m;
            outward_m = outer_m(lane, s_m - *start_m, inner_m, -1.0);
            place(index, [inner_m, outward_m]);
        }
    }
    Some(edges)
}

/// The edges of a lane, left and right in the direction of the road.
#[derive(Debug, Clone, Default)]
pub(super) struct Edges {
    pub(super) left: Polyline,
    pub(super) right: Polyline,
}

impl Edges {
    /// The part of a lane from where it opens to where it closes again, each in a point; `None` if it has no width.
    pub(super) fn open(mut self) -> Option<Self> {
        let is_open = |(left, right): (&Vec2, &Vec2)| left.distance(*right) > MAX_ROUNDING_M;
        let mut places = self.left.0.iter().zip(&self.right.0);
        let first = places.clone().position(is_open)?;
        let last = places.rposition(is_open)?;
        for line in [&mut self.left, &mut self.right] {
            line.0.truncate(last + 2);
            line.0.drain(..first.saturating_sub(1));
        }
        Some(self)
    }

    /// The line midway between the edges.
    pub(super) fn middle(&self) -> Polyline {
        Polyline(self.left.0.iter().zip(&self.right.0).map(|(left, right)| left.lerp(*right, 0.5)).collect())
    }

    /// Center, left and right edge in the direction of traffic.
    pub(super) fn in_direction(mut self, is_along: bool) -> [Polyline; 3] {
        if !is_along {
            self.left.0.reverse();
            self.right.0.reverse();
            std::mem::swap(&mut self.left, &mut self.right);
        }
        [self.middle(), self.left, self.right]
    }
}

/// The offset of the outer edge of a lane; `side` is 1 on the left.
fn outer_m(lane: &RoadLane, along_m: f64, inner_m: f64, side: f64) -> f64 {
    if lane.widths.is_empty() && !lane.borders.is_empty() {
        return value_at(&lane.borders, along_m);
    }
    inner_m + side * value_at(&lane.widths, along_m).max(0.0)
}

/// The distances along a road at which the edges of a section have points.
fn distances(road: &Road, section: &Section) -> Option<Vec<f64>> {
    let Section { start_m, end_m, lanes, .. } = section;
    let (start_m, end_m) = (*start_m, *end_m);
    if end_m - start_m < SAME_M {
        return None;
    }
    let of_lanes =
        lanes.iter().flat_map(|lane| lane.widths.iter().chain(&lane.borders)).map(|cubic| cubic.start_m + start_m);
    let is_before = |from_m: f64| from_m <= start_m;
    let pieces = road.plan_view.iter().skip(road.plan_view.partition_point(|piece| is_before(piece.start_m)));
    let offsets = road.lane_offset.iter().skip(road.lane_offset.partition_point(|cubic| is_before(cubic.start_m)));
    let of_road = pieces.map(|piece| piece.start_m).take_while(|s_m| *s_m < end_m);
    let of_road = of_road.chain(offsets.map(|cubic| cubic.start_m).take_while(|s_m| *s_m < end_m));
    let within = of_lanes.chain(of_road).filter(|s_m| *s_m > start_m + SAME_M && *s_m < end_m - SAME_M);
    let mut knots_m: Vec<f64> = within.chain([start_m, end_m]).collect();
    knots_m.sort_by(f64::total_cmp);
    knots_m.dedup_by(|a, b| (*a - *b).abs() < SAME_M);
    let mut distances_m = vec![start_m];
    for pair in knots_m.windows(2) {
        let [from_m, to_m] = [pair[0], pair[1]];
        // The largest curvature at a few places, with every lane within a road's width.
        let heading =
            |share: f64| pose_at(&road.plan_view, from_m + share * (to_m - from_m) * 0.999).map(|pose| pose.1);
        let turns = [0.0, 0.25, 0.5, 0.75].map(|share| {
            let turned_rad = heading(share).zip(heading(share + 0.25)).map(|(a, b)| angle_difference(b, a).abs());
            turned_rad.unwrap_or_default() / (0.25 * (to_m - from_m))
        });
        // Edges bend beside the reference line, too.
        let of_road = bend_between(&road.lane_offset, [from_m, to_m]);
        let of_lane = |lane: &RoadLane| {
            let within = [from_m - start_m, to_m - start_m];
            bend_between(&lane.widths, within).max(bend_between(&lane.borders, within))
        };
        let curvature_per_m = turns.into_iter().chain([of_road]).chain(lanes.iter().map(of_lane)).fold(0.0, f64::max);
        let step_m = (8.0 * MAX_ERROR_M / curvature_per_m).sqrt().clamp(MIN_STEP_M, MAX_STEP_M);
        let n_steps = ((to_m - from_m) / step_m).ceil().max(1.0);
        distances_m.extend((1..=n_steps as usize).map(|step| from_m + (to_m - from_m) * step as f64 / n_steps));
    }
    // Where the next section begins, the lanes may be shifted by a new offset, which does not belong to this section.
    if let Some(last_m) = distances_m.last_mut() {
        *last_m -= SAME_M;
    }
    Some(distances_m)
}

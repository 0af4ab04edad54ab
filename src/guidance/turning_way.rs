//! Along which line does an agent turn? Along a lane that bends, or, without a map, along an arc.

use super::lane_ways::{LaneWays, WayPose};
use crate::geometry::{Polyline, Vec2, angle_difference};

/// A turn begins and ends where these shares of its change of heading are reached.
const START_SHARE: f64 = 0.1;
const END_SHARE: f64 = 0.9;
/// The radii of turns without a map, meters.
const LEAST_RADIUS_M: f64 = 6.0;
const MOST_RADIUS_M: f64 = 40.0;
/// The share of the way that an agent drives at its speed on which it turns without a map.
const TURNING_SHARE: f64 = 0.7;
/// Length of the pieces of an arc, meters, and of the straight lines at its ends.
const PIECE_M: f64 = 0.5;
const EXTENSION_M: f64 = 60.0;

/// A line that turns, in the row's frame.
#[derive(Debug, Clone)]
pub(super) struct TurningWay {
    pub(super) line: Polyline,
    /// The station of the present place, meters.
    pub(super) start_m: f64,
    /// The stations between which the target change of heading is reached, meters.
    pub(super) wanted_m: [f64; 2],
    /// The stations between which it turns, meters.
    pub(super) bend_m: [f64; 2],
}

/// The target of a turn.
#[derive(Debug, Clone, Copy)]
pub(super) struct WantedTurn {
    /// +1 to the left, -1 to the right.
    pub(super) sign: f64,
    /// The range of the change of heading toward that side, radians.
    pub(super) change_rad: [f64; 2],
    /// The heading from which it is measured, radians.
    pub(super) from_rad: f64,
}

impl TurningWay {
    /// The way on from `pose` along the lanes that reaches the target change of heading first; without lanes, an arc
    /// that an agent that drives `reach_m` meters within the scene can drive. `None` if no lane turns in this way.
    pub(super) fn of(lanes: &LaneWays, pose: WayPose, wanted: WantedTurn, reach_m: f64) -> Option<Self> {
        if lanes.is_empty() {
            return Self::along(arc(pose, wanted, reach_m), pose, wanted);
        }
        let ways = lanes.ahead(pose).into_iter().filter_map(|line| Self::along(line, pose, wanted));
        let ahead_m = |way: &Self| way.wanted_m[0] - way.start_m;
        ways.min_by(|a, b| ahead_m(a).total_cmp(&ahead_m(b)))
    }

    /// The stations at which an agent that drives steps of these lengths should be on the line after each of them,
    /// meters: as far as it has driven, but with a target mean speed in the bend, and evenly farther or less far if
    /// that does not end at a target station.
    pub(super) fn stations_m(&self, steps_m: &[f64], wanted_step_m: [f64; 2]) -> Vec<f64> {
        let driven_m = |steps_m: &[f64]| -> Vec<f64> {
            let so_far = steps_m.iter().scan(self.start_m, |at_m, step_m| {
                *at_m += step_m;
                Some(*at_m)
            });
            so_far.collect()
        };
        let is_in_bend = |at_m: f64| (self.bend_m[0]..=self.bend_m[1]).contains(&at_m);
        let before = driven_m(steps_m);
        let in_bend = steps_m.iter().zip(&before).filter(|(_, at_m)| is_in_bend(**at_m)).map(|(step_m, _)| *step_m);
        let (n, sum_m) = in_bend.fold((0, 0.0), |(n, sum_m), step_m| (n + 1, sum_m + step_m));
        let mean_m = sum_m / f64::from(n.max(1));
        let factor = if mean_m > 0.0 { mean_m.clamp(wanted_step_m[0], wanted_step_m[1]) / mean_m } else { 1.0 };
        let scaled = |(step_m, at_m): (&f64, &f64)| if is_in_bend(*at_m) { step_m * factor } else { *step_m };
        let mut stations_m = driven_m(&steps_m.iter().zip(&before).map(scaled).collect::<Vec<_>>());
        let end_m = stations_m.last().copied().unwrap_or(self.start_m);
        let lack_m = end_m.clamp(self.wanted_m[0], self.wanted_m[1]) - end_m;
        let n_steps = stations_m.len() as f64;
        stations_m.iter_mut().enumerate().for_each(|(i, at_m)| *at_m += lack_m * (i + 1) as f64 / n_steps);
        stations_m
    }

    /// The point `station_m` along the line, and the heading there, radians.
    pub(super) fn at(&self, station_m: f64) -> (Vec2, f64) {
        let mut left_m = station_m;
        let mut last = (self.line.0[0], 0.0);
        for pair in self.line.0.windows(2) {
            let along = pair[1] - pair[0];
            let length_m = along.norm();
            last = (pair[0] + along * (left_m / length_m), along.angle());
            if left_m <= length_m {
                break;
            }
            left_m -= length_m;
        }
        last
    }

    /// The way along `line`, if it reaches the target turn ahead of `pose`.
    fn along(line: Polyline, pose: WayPose, wanted: WantedTurn) -> Option<Self> {
        let start_m = line.project(pose.position)?.station_m;
        // The change of heading on each piece ahead, with the station at which the piece begins.
        let (mut station_m, mut previous_rad, mut turned_rad) = (0.0, wanted.from_rad, 0.0);
        let mut turned: Vec<(f64, f64)> = Vec::new();
        for pair in line.0.windows(2) {
            let (begin_m, piece) = (station_m, pair[1] - pair[0]);
            station_m += piece.norm();
            if station_m > start_m {
                turned_rad += wanted.sign * angle_difference(piece.angle(), previous_rad);
                previous_rad = piece.angle();
                turned.push((begin_m.max(start_m), turned_rad));
            }
        }
        let reached = |rad: f64| turned.iter().find(|(_, turned_rad)| *turned_rad >= rad).map(|(at_m, _)| *at_m);
        let [least, most] = wanted.change_rad;
        let wanted_m = [reached(least)?, reached(most).unwrap_or(f64::MAX)];
        let bend_m = [reached(START_SHARE * least)?, reached(END_SHARE * least)?];
        Some(Self { line, start_m, wanted_m, bend_m })
    }
}

/// Straight on, then an arc, then straight on again.
fn arc(pose: WayPose, wanted: WantedTurn, reach_m: f64) -> Polyline {
    let done_rad = wanted.sign * angle_difference(pose.heading_rad, wanted.from_rad);
    let [least, most] = wanted.change_rad;
    let angle_rad = (f64::midpoint(least, most) - done_rad).max(0.0);
    let radius_m = (TURNING_SHARE * reach_m / angle_rad.max(0.1)).clamp(LEAST_RADIUS_M, MOST_RADIUS_M);
    let forward = Vec2::from_angle(pose.heading_rad);
    let center =
        pose.position + Vec2::from_angle(pose.heading_rad + wanted.sign * std::f64::consts::FRAC_PI_2) * radius_m;
    let n_pieces = (angle_rad * radius_m / PIECE_M).ceil().max(1.0) as usize;
    let on_arc = |i: usize| {
        let turned = wanted.sign * angle_rad * i as f64 / n_pieces as f64;
        let outward = pose.heading_rad - wanted.sign * std::f64::consts::FRAC_PI_2 + turned;
        center + Vec2::from_angle(outward) * radius_m
    };
    let onward = Vec2::from_angle(pose.heading_rad + wanted.sign * angle_rad) * EXTENSION_M;
    let mut points = vec![pose.position - forward * EXTENSION_M];
    points.extend((0..=n_pieces).map(on_arc));
    points.push(on_arc(n_pieces) + onward);
    Polyline(points)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Transform2;
    use crate::scene::LaneGraph;
    use std::f64::consts::FRAC_PI_2;

    const POSE: WayPose = WayPose { position: Vec2::ZERO, heading_rad: 0.0 };

    #[test]
    fn without_lanes_the_way_is_an_arc_to_the_wanted_side() {
        let none = LaneWays::new(&LaneGraph::default().into(), &Transform2::IDENTITY);
        for sign in [1.0, -1.0] {
            let wanted = WantedTurn { sign, change_rad: [FRAC_PI_2 - 0.2, FRAC_PI_2 + 0.2], from_rad: 0.0 };
            // 70 % of 22.44 m are a quarter of a circle of 10 m, which ends 10 m ahead and aside.
            let way = TurningWay::of(&none, POSE, wanted, 5.0 * std::f64::consts::PI / 0.7).unwrap();
            assert!(way.line.0[way.line.0.len() - 2].distance(Vec2::new(10.0, sign * 10.0)) < 1e-9);
            // The target change is reached after 1.371 rad at 10 m, and 60 m before the pose.
            assert!((way.wanted_m[0] - 60.0 - 13.71).abs() < 0.5, "{:?}", way.wanted_m);
            assert!(way.bend_m[0] < 62.5 && way.bend_m[1] < way.wanted_m[0]);
        }
    }

    #[test]
    fn stations_follow_the_steps_with_the_wanted_speed_in_the_bend_to_the_wanted_end() {
        let line = Polyline(vec![Vec2::ZERO, Vec2::new(100.0, 0.0)]);
        let way = |wanted_m| TurningWay { line: line.clone(), start_m: 10.0, wanted_m, bend_m: [13.0, 17.0] };
        let steps_m = [2.0; 5];
        let (anywhere, any) = ([0.0, 1e3], [0.0, 1e3]);
        assert_eq!(way(anywhere).stations_m(&steps_m, any), [12.0, 14.0, 16.0, 18.0, 20.0]);
        // Two of the steps end in the bend.
        assert_eq!(way(anywhere).stations_m(&steps_m, [0.0, 1.0]), [12.0, 13.0, 14.0, 16.0, 18.0]);
        assert_eq!(way(anywhere).stations_m(&steps_m, [3.0, 4.0]), [12.0, 15.0, 18.0, 20.0, 22.0]);
        // All steps share the shortfall at the end.
        assert_eq!(way([25.0, 30.0]).stations_m(&steps_m, any), [13.0, 16.0, 19.0, 22.0, 25.0]);
        assert_eq!(way([10.0, 15.0]).stations_m(&steps_m, any), [11.0, 12.0, 13.0, 14.0, 15.0]);
        assert_eq!(way([10.0, 10.0]).stations_m(&[0.0; 3], [1.0, 2.0]), [10.0; 3]);
        assert_eq!(way(anywhere).at(12.5), (Vec2::new(12.5, 0.0), 0.0));
    }

    #[test]
    fn what_was_turned_before_counts() {
        let none = LaneWays::new(&LaneGraph::default().into(), &Transform2::IDENTITY);
        let wanted = WantedTurn { sign: 1.0, change_rad: [1.0, 1.4], from_rad: -1.5 };
        let way = TurningWay::of(&none, POSE, wanted, 20.0).unwrap();
        // It has turned by 1.5 rad already: more than the maximum.
        assert!((way.wanted_m[0] - 60.0).abs() < 1e-9, "{:?}", way.wanted_m);
    }
}

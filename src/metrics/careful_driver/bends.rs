//! Routes that vehicles can drive, and how fast they take the bends. Middles of lanes turn in corners at their nodes,
//! and where lanes meet.

use crate::behavior::driven_path::DrivenPath;
use crate::geometry::{Path, Polyline, Vec2, angle_difference};

/// Points of a rounded route are this far apart, meters.
const SPACING_M: f64 = 0.5;
/// Each point is the mean of those up to this distance before and after it, twice over, meters: a corner of 50 degrees
/// becomes a bend with a radius of 7 m.
const ROUNDED_OVER_M: f64 = 3.0;
/// Drivers take bends with at most this lateral acceleration, and brake for them with at most this deceleration, m/s².
const LATERAL_MPS2: f64 = 3.0;
const BRAKES_MPS2: f64 = 1.5;
/// Directions are compared over this distance, meters.
const CURVATURE_OVER_M: f64 = 2.0;

/// The points of a way, rounded, without the first. The way begins and ends where it did, in its own direction.
pub(super) fn rounded(way: &[Vec2]) -> Vec<Vec2> {
    let way = Path::new(Polyline(way.to_vec()));
    let n_points = (way.length_m() / SPACING_M).ceil() as usize;
    let point = |i: usize| way.pose_at(i as f64 * SPACING_M).map(|(point, _)| point);
    let mut points: Vec<Vec2> = (0..=n_points).filter_map(point).collect();
    for _ in 0..2 {
        let mean = |i: usize| {
            let n = ((ROUNDED_OVER_M / SPACING_M) as usize).min(i).min(points.len() - 1 - i);
            points[i - n..=i + n].iter().fold(Vec2::ZERO, |sum, point| sum + *point) * (1.0 / (2 * n + 1) as f64)
        };
        points = (0..points.len()).map(mean).collect();
    }
    points.drain(..1.min(points.len()));
    points
}

/// The fastest speeds along the part of a route that has not been driven.
#[derive(Debug, Clone, Default)]
pub(super) struct BendSpeeds {
    from_m: f64,
    /// At each meter from there on, m/s.
    most_mps: Vec<f64>,
}

impl BendSpeeds {
    /// The speeds on `route` from `from_m` on.
    pub(super) fn new(route: &DrivenPath, from_m: f64) -> Self {
        let n = (route.length_m() - from_m).max(0.0) as usize;
        let headings: Vec<f64> = (0..=n).map(|i| route.pose_at(from_m + i as f64).1).collect();
        let half = (CURVATURE_OVER_M / 2.0) as usize;
        let in_bend_mps = |i: usize| {
            let turn_rad = angle_difference(headings[(i + half).min(n)], headings[i.saturating_sub(half)]);
            (LATERAL_MPS2 * CURVATURE_OVER_M / turn_rad.abs()).sqrt()
        };
        let mut most_mps: Vec<f64> = (0..=n).map(in_bend_mps).collect();
        for i in (0..n).rev() {
            most_mps[i] = most_mps[i].min(before(most_mps[i + 1], 1.0));
        }
        Self { from_m, most_mps }
    }

    /// The fastest speed after `driven_m`, m/s; infinite where the route is straight.
    pub(super) fn at(&self, driven_m: f64) -> f64 {
        let after_m = driven_m - self.from_m;
        match self.most_mps.get(after_m.max(0.0) as usize) {
            Some(mps) => before(*mps, (-after_m).max(0.0)),
            None => f64::INFINITY,
        }
    }
}

/// The fastest speed this distance before a place with a fastest speed, m/s.
fn before(mps: f64, distance_m: f64) -> f64 {
    (mps * mps + 2.0 * BRAKES_MPS2 * distance_m).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Ten meters along x, then forty at 50 degrees to it.
    fn corner() -> (Vec<Vec2>, f64) {
        let turn_rad = 50.0_f64.to_radians();
        let corner = Vec2::new(10.0, 0.0);
        (vec![Vec2::ZERO, corner, corner + Vec2::from_angle(turn_rad) * 40.0], turn_rad)
    }

    #[test]
    fn corners_become_bends_that_vehicles_can_drive() {
        let (way, turn_rad) = corner();
        let points = [&way[..1], &rounded(&way)].concat();
        let headings: Vec<f64> = points.windows(2).map(|pair| (pair[1] - pair[0]).angle()).collect();
        let turns: Vec<f64> = headings.windows(2).map(|pair| pair[1] - pair[0]).collect();
        assert!(headings[0].abs() < 1e-9 && (headings[headings.len() - 1] - turn_rad).abs() < 1e-9);
        // The means of means turn at most by one part in thirteen of the corner at each of their points.
        assert!(turns.iter().all(|turn| (-1e-9..turn_rad / 12.0).contains(turn)), "{turns:?}");
        assert!(points.last().unwrap().distance(way[2]) < SPACING_M);
        assert_eq!(rounded(&way[..1]), []);
    }

    #[test]
    fn bends_are_taken_slowly_and_braked_for() {
        let circle: Vec<Vec2> = (0..60).map(|i| Vec2::from_angle(0.05 * f64::from(i)) * 12.0).collect();
        let mut way: Vec<Vec2> = (1..=50).rev().map(|i| Vec2::new(12.0, -f64::from(i))).collect();
        way.extend(circle);
        let speeds = BendSpeeds::new(&DrivenPath::along(&way, 4.0).unwrap(), 5.0);
        // v² = 3 · 12 in the bend, and 2 · 1.5 · 30 more 30 m before it; its corners are 0.6 m apart.
        assert!((speeds.at(60.0) - 6.0).abs() < 0.3, "{}", speeds.at(60.0));
        assert!((speeds.at(20.0) - (36.0_f64 + 90.0).sqrt()).abs() < 0.3, "{}", speeds.at(20.0));
        assert!(speeds.at(0.0) > speeds.at(5.0) && speeds.at(1e4).is_infinite());
    }
}

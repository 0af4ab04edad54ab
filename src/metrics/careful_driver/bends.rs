//! How fast vehicles take the bends of a route.

use crate::behavior::driven_path::DrivenPath;
use crate::geometry::angle_difference;

/// Drivers take bends with at most this lateral acceleration, and brake for them with at most this deceleration, m/s².
const LATERAL_MPS2: f64 = 3.0;
const BRAKES_MPS2: f64 = 1.5;
/// Directions are compared over this distance, meters.
const CURVATURE_OVER_M: f64 = 2.0;

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
    use crate::geometry::Vec2;

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

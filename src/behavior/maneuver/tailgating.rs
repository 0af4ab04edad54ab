//! Closing in on the vehicle ahead, and staying close behind it.

use super::{Driver, Maneuver, Pace};
use crate::behavior::following::{Ahead, Follower};
use crate::behavior::lane_relation::SceneLanes;
use crate::behavior::limits::effort;
use crate::behavior::tailgating::Tailgating;
use crate::behavior::template::InTheWay;
use crate::scene::Scene;

/// Final headways, as shares of the longest one that counts as tailgating.
const SHARES: [f64; 5] = [0.4, 0.55, 0.7, 0.8, 0.9];
/// How long the follower takes to reach its place, seconds, and how fast it still closes in then, m/s.
const COMES_S: [f64; 5] = [0.8, 1.2, 1.6, 2.0, 2.6];
const CLOSES_MPS: [f64; 2] = [0.0, 0.5];
/// Accelerations of the leader, m/s².
const LEADER_MPS2: [f64; 3] = [0.0, 0.3, -0.3];
/// The largest gap that can be closed within a scene, and the smallest that is left, meters.
const REACH_M: f64 = 60.0;
const LEAST_GAP_M: f64 = 2.0;

impl Tailgating {
    /// Maneuvers in which the follower closes in on the leader, or falls back, to a short headway.
    pub(in crate::behavior) fn approaches(&self, scene: &Scene, [own_idx, leader_idx]: [usize; 2]) -> Vec<Maneuver> {
        let lanes = SceneLanes::new(&scene.lanes);
        let is_admitted = [own_idx, leader_idx].iter().all(|idx| scene.tracks[*idx].class.is_motorized());
        let follower = is_admitted.then(|| Follower::as_observed(scene, &lanes, own_idx)).flatten();
        let ahead = follower.and_then(|own| own.ahead(scene.current_timestep(), REACH_M).first().copied());
        let Some(now) = ahead.filter(|ahead| ahead.agent_idx == leader_idx) else { return Vec::new() };
        let drivers = [own_idx, leader_idx].map(|agent_idx| Driver::new(scene, &lanes, agent_idx));
        let [Some(own), Some(leader)] = drivers else { return Vec::new() };
        let gaps = gaps(&now, self.max_headway_s);
        let mut maneuvers = Vec::new();
        for (rail, mps2) in (0..leader.rails.len()).flat_map(|rail| LEADER_MPS2.map(|mps2| (rail, mps2))) {
            let led_m = leader.travel(rail, &Pace::steady(mps2)).driven_m;
            for gap in &gaps {
                let gap_m = |step: usize| gap.at((step + 1) as f64 * scene.dt_s);
                let own_m = |(step, led_m): (usize, &f64)| led_m + now.gap_m - gap_m(step);
                let driven_m: Vec<f64> = led_m.iter().enumerate().map(own_m).collect();
                let hardest = gap.second_derivatives().map(|gap_mps2| effort(mps2 - gap_mps2));
                let effort = hardest.into_iter().fold(0.0, f64::max);
                let least_m = (0..led_m.len()).map(gap_m).fold(f64::INFINITY, f64::min);
                let goes_on = driven_m.windows(2).all(|pair| pair[0] <= pair[1]);
                if effort > 1.0 || least_m < LEAST_GAP_M || !goes_on {
                    continue;
                }
                let maneuver = |own_rail: usize| Maneuver {
                    kind: [(gap.to * 2.0) as usize, 0],
                    effort,
                    parameters: &["time_headway_s", "mean_speed_mps"],
                    in_the_way: Some(InTheWay::Ahead),
                    others: Vec::new(),
                    positions: vec![own.positions(own_rail, &driven_m), leader.positions(rail, &led_m)],
                };
                maneuvers.extend((0..own.rails.len()).map(maneuver));
            }
        }
        maneuvers
    }
}

/// Ways in which the gap becomes short, in meters over seconds.
fn gaps(now: &Ahead, max_headway_s: f64) -> Vec<Cubic> {
    let to = SHARES.map(|share| share * max_headway_s * now.their_mps);
    let tried = to.into_iter().flat_map(|to| COMES_S.map(|within| (to, within)));
    let tried = tried.flat_map(|(to, within)| CLOSES_MPS.map(|closes_mps| (to, within, closes_mps)));
    let slope = now.their_mps - now.own_mps;
    tried.map(|(to, within, closes_mps)| Cubic { from: now.gap_m, slope, to, then: -closes_mps, within }).collect()
}

/// A cubic with given values and slopes at time 0 and `within`, continued with its final slope.
#[derive(Clone, Copy)]
struct Cubic {
    from: f64,
    slope: f64,
    to: f64,
    then: f64,
    within: f64,
}

impl Cubic {
    fn at(&self, time: f64) -> f64 {
        let u = (time / self.within).min(1.0);
        let (rest, smooth) = (1.0 - u, u * u * (3.0 - 2.0 * u));
        let slopes = self.slope * u * rest * rest - self.then * u * u * rest;
        self.from + (self.to - self.from) * smooth + self.within * slopes + self.then * (time - self.within).max(0.0)
    }

    /// The second derivatives at both ends; the larger one is the largest in between, too.
    fn second_derivatives(&self) -> [f64; 2] {
        let (change, start, end) =
            ((self.to - self.from) / self.within.powi(2), self.slope / self.within, self.then / self.within);
        [6.0 * change - 4.0 * start - 2.0 * end, 2.0 * start + 4.0 * end - 6.0 * change]
    }
}

#[cfg(test)]
mod tests {
    use super::Cubic;

    #[test]
    fn a_cubic_has_the_ends_slopes_and_second_derivatives_that_are_said_of_it() {
        let gap = Cubic { from: 20.0, slope: -3.0, to: 6.0, then: -1.0, within: 2.0 };
        let h = 1e-4;
        let slope = |t: f64| (gap.at(t + h) - gap.at(t - h)) / (2.0 * h);
        let bend = |t: f64| (gap.at(t + h) - 2.0 * gap.at(t) + gap.at(t - h)) / (h * h);
        assert!((gap.at(0.0) - 20.0).abs() < 1e-12 && (gap.at(2.0) - 6.0).abs() < 1e-12);
        assert!((gap.at(5.0) - 3.0).abs() < 1e-12);
        assert!(
            (slope(h) + 3.0).abs() < 1e-2 && (slope(2.0 - h) + 1.0).abs() < 1e-2 && (slope(3.0) + 1.0).abs() < 1e-6
        );
        let [first, last] = gap.second_derivatives();
        assert!((bend(h) - first).abs() < 1e-2 && (bend(2.0 - 2.0 * h) - last).abs() < 1e-2, "{first} {last}");
    }
}

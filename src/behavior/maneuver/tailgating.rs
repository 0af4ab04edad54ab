//! Closing in on the vehicle ahead, and staying close behind it.

use super::{Driver, Maneuver, Pace};
use crate::behavior::feasible::effort;
use crate::behavior::following::Follower;
use crate::behavior::lane_relation::SceneLanes;
use crate::behavior::tailgating::Tailgating;
use crate::behavior::template::InTheWay;
use crate::scene::Scene;

/// Headways, as shares of the longest that is too short.
const SHARES: [f64; 5] = [0.4, 0.55, 0.7, 0.8, 0.9];
/// Within how long the follower comes to one, seconds.
const COMES_S: [f64; 5] = [0.8, 1.2, 1.6, 2.0, 2.6];
/// How the leader goes on, m/s².
const LEADER_MPS2: [f64; 3] = [0.0, 0.3, -0.3];
/// Farther ahead is nobody whom one could catch up with in a scene, meters; and nobody drives closer behind another, meters.
const REACH_M: f64 = 60.0;
const LEAST_GAP_M: f64 = 2.0;

impl Tailgating {
    /// How the follower closes in on the leader, or falls back, to a short headway that it keeps.
    pub(in crate::behavior) fn approaches(&self, scene: &Scene, [own_idx, leader_idx]: [usize; 2]) -> Vec<Maneuver> {
        let (config, lanes) = (self.config(), SceneLanes::new(&scene.lanes));
        let is_admitted = [own_idx, leader_idx].iter().all(|idx| config.agents.admits(scene.tracks[*idx].class));
        let follower = is_admitted.then(|| Follower::as_observed(scene, &lanes, config.agents, own_idx)).flatten();
        let ahead = follower.and_then(|own| own.ahead(scene.current_timestep(), REACH_M).first().copied());
        let Some(now) = ahead.filter(|ahead| ahead.agent_idx == leader_idx) else { return Vec::new() };
        let drivers = [own_idx, leader_idx].map(|agent_idx| Driver::new(scene, &lanes, agent_idx));
        let [Some(own), Some(leader)] = drivers else { return Vec::new() };
        let mut maneuvers = Vec::new();
        for mps2 in LEADER_MPS2 {
            let led = leader.progress(&Pace::steady(mps2));
            for (i, share) in SHARES.into_iter().enumerate() {
                let then_m = share * config.max_headway_s * now.their_mps;
                for comes_s in COMES_S.into_iter().filter(|_| then_m >= LEAST_GAP_M) {
                    // The gap as a cubic that begins as the two move and ends with both equally fast; m, and m/s².
                    let closing_mps = now.own_mps - now.their_mps;
                    let gap = Cubic { from: now.gap_m, slope: -closing_mps, to: then_m, within: comes_s };
                    let driven_m: Vec<f64> = led
                        .driven_m
                        .iter()
                        .enumerate()
                        .map(|(step, led_m)| led_m + now.gap_m - gap.at((step + 1) as f64 * scene.dt_s))
                        .collect();
                    let hardest = gap.second_derivatives().map(|gap_mps2| effort(mps2 - gap_mps2)).into_iter();
                    let effort = hardest.fold(0.0, f64::max);
                    if effort > 1.0 || driven_m.windows(2).any(|pair| pair[1] < pair[0]) {
                        continue;
                    }
                    for (a, b) in (0..own.rails.len()).flat_map(|a| (0..leader.rails.len()).map(move |b| (a, b))) {
                        maneuvers.push(Maneuver {
                            kind: [i, (comes_s * 10.0) as usize],
                            effort,
                            parameters: &["time_headway_s", "mean_speed_mps"],
                            in_the_way: Some(InTheWay::Ahead),
                            positions: vec![own.positions(a, &driven_m), leader.positions(b, &led.driven_m)],
                        });
                    }
                }
            }
        }
        maneuvers
    }
}

/// A value that changes from one to another within some time, with a slope at first and none in the end, where it stays.
#[derive(Clone, Copy)]
struct Cubic {
    from: f64,
    slope: f64,
    to: f64,
    within: f64,
}

impl Cubic {
    fn at(&self, time: f64) -> f64 {
        let u = (time / self.within).min(1.0);
        let (rest, smooth) = (1.0 - u, u * u * (3.0 - 2.0 * u));
        self.from + (self.to - self.from) * smooth + self.slope * self.within * u * rest * rest
    }

    /// Its second derivatives at both ends of that time, of which one is the largest.
    fn second_derivatives(&self) -> [f64; 2] {
        let (change, start) = ((self.to - self.from) / self.within.powi(2), self.slope / self.within);
        [6.0 * change - 4.0 * start, 2.0 * start - 6.0 * change]
    }
}

#[cfg(test)]
mod tests {
    use super::Cubic;

    #[test]
    fn a_cubic_has_the_ends_slopes_and_second_derivatives_that_are_said_of_it() {
        let gap = Cubic { from: 20.0, slope: -3.0, to: 6.0, within: 2.0 };
        let h = 1e-4;
        let slope = |t: f64| (gap.at(t + h) - gap.at(t - h)) / (2.0 * h);
        let bend = |t: f64| (gap.at(t + h) - 2.0 * gap.at(t) + gap.at(t - h)) / (h * h);
        assert!((gap.at(0.0) - 20.0).abs() < 1e-12 && (gap.at(2.0) - 6.0).abs() < 1e-12 && gap.at(5.0) == gap.at(2.0));
        assert!((slope(h) + 3.0).abs() < 1e-2 && slope(2.0 - h).abs() < 1e-2);
        let [first, last] = gap.second_derivatives();
        assert!((bend(h) - first).abs() < 1e-2 && (bend(2.0 - 2.0 * h) - last).abs() < 1e-2, "{first} {last}");
    }
}

//! Braking hard along the lane for a reason: behind somebody ahead, who may brake first, or before a line at which to
//! stop.

use super::{Driver, Maneuver, Pace};
use crate::behavior::cause::{STANDSTILL_GAP_M, not_enough_mps2};
use crate::behavior::following::Follower;
use crate::behavior::hard_brake::HardBrake;
use crate::behavior::lane_relation::SceneLanes;
use crate::behavior::template::InTheWay;
use crate::geometry::Vec2;
use crate::scene::{LaneDuty, Scene};

/// Decelerations that are tried, above the least one of an event, because the measured one is smoothed; and the
/// hardest, m/s².
const MORE_MPS2: [f64; 4] = [0.5, 1.25, 2.25, 3.25];
const HARDEST_MPS2: f64 = 7.75;
/// When braking begins and how long it lasts, seconds.
const BEGINS_S: [f64; 4] = [0.4, 0.9, 1.4, 1.9];
const LASTS_S: [f64; 3] = [0.9, 1.5, 2.5];
/// How hard the one ahead brakes, m/s², and how long before the agent, which needs that long to react, seconds.
const LEADER_MPS2: [f64; 5] = [0.0, 2.5, 3.5, 4.5, 6.0];
const REACTION_S: f64 = 0.75;
/// How far ahead somebody, or a line, is looked for, meters.
const REACH_M: f64 = 60.0;

/// What to brake for.
enum Reason {
    /// A line, this far ahead of the front, meters.
    Line(f64),
    /// Somebody this far ahead of the front, meters, with the distances that it drives and its positions at present and
    /// at each timestep after it.
    Leader { gap_m: f64, driven_m: Vec<f64>, agent_idx: usize, positions: Vec<Vec2> },
}

impl Reason {
    /// Whether braking with `mps2`, after `driven_m` with this speed at timestep `begins`, is too little for it, and
    /// the planned drive is enough.
    fn explains(&self, mps2: f64, (begins, speed_mps): (usize, f64), driven_m: &[f64], dt_s: f64) -> bool {
        let braked_m = |time_s: f64| {
            let time_s = time_s.min(speed_mps / mps2);
            driven_m[begins] + speed_mps * time_s - mps2 * time_s * time_s / 2.0
        };
        let (Some(end_m), Some(last)) = (driven_m.last(), driven_m.len().checked_sub(1)) else { return false };
        match self {
            Self::Line(line_m) => braked_m(f64::INFINITY) > *line_m && end_m <= line_m,
            Self::Leader { gap_m, driven_m: led_m, .. } => {
                let last_mps = (led_m[last] - led_m[last - 1]) / dt_s;
                let led_m =
                    |step: usize| led_m[step.min(last)] + step.saturating_sub(last) as f64 * dt_s * last_mps + gap_m;
                let n_steps = (speed_mps / mps2 / dt_s) as usize;
                let hits = (begins..=begins + n_steps)
                    .any(|step| led_m(step) - braked_m((step - begins) as f64 * dt_s) < STANDSTILL_GAP_M);
                hits && driven_m.iter().enumerate().all(|(step, own_m)| led_m(step) - own_m >= STANDSTILL_GAP_M)
            }
        }
    }
}

impl HardBrake {
    /// Maneuvers of an agent that keeps its speed, or brakes on, and then brakes hard for a reason.
    pub(in crate::behavior) fn brakings(&self, scene: &Scene, agent_idx: usize) -> Vec<Maneuver> {
        let lanes = SceneLanes::new(&scene.lanes);
        let is_admitted = scene.tracks[agent_idx].class.is_motorized();
        let driver = is_admitted.then(|| Driver::new(scene, &lanes, agent_idx)).flatten();
        let Some(driver) = driver.filter(|driver| driver.state.speed_mps() >= self.min_speed_mps) else {
            return Vec::new();
        };
        let Some(own) = Follower::as_observed(scene, &lanes, agent_idx) else { return Vec::new() };
        let mut maneuvers = Vec::new();
        let tried = MORE_MPS2.iter().map(|more_mps2| self.min_deceleration_mps2 + more_mps2);
        for (i, deceleration_mps2) in tried.enumerate().filter(|(_, mps2)| *mps2 <= HARDEST_MPS2) {
            for from_s in BEGINS_S {
                let reasons = reasons(scene, &lanes, &own, agent_idx, from_s);
                for (rail, lasts_s) in (0..driver.rails.len()).flat_map(|rail| LASTS_S.map(|lasts_s| (rail, lasts_s))) {
                    let pace = Pace::steady(driver.braking_mps2().min(0.0));
                    let pace = pace.then(from_s, -deceleration_mps2).then(from_s + lasts_s, 0.0);
                    let travel = driver.travel(rail, &pace);
                    let begins = ((from_s / scene.dt_s) as usize).min(travel.driven_m.len() - 1);
                    let then = (begins, travel.speeds_mps[begins]);
                    let mps2 = not_enough_mps2(deceleration_mps2);
                    let is_explained = |reason: &&Reason| reason.explains(mps2, then, &travel.driven_m, scene.dt_s);
                    let Some(reason) = reasons.iter().find(is_explained) else { continue };
                    let others = match reason {
                        Reason::Line(_) => Vec::new(),
                        Reason::Leader { agent_idx, positions, .. } => vec![(*agent_idx, positions.clone())],
                    };
                    maneuvers.push(Maneuver {
                        kind: [i, (from_s * 10.0) as usize],
                        effort: deceleration_mps2 / HARDEST_MPS2,
                        parameters: &["max_deceleration_mps2"],
                        in_the_way: Some(InTheWay::Ahead),
                        positions: vec![driver.positions(rail, &travel.driven_m)],
                        others,
                    });
                }
            }
        }
        maneuvers
    }
}

/// What an agent could brake for that begins to at `from_s`: the line ahead, and whoever is ahead and goes on or
/// brakes.
fn reasons(scene: &Scene, lanes: &SceneLanes<'_>, own: &Follower<'_>, agent_idx: usize, from_s: f64) -> Vec<Reason> {
    let front_m = scene.tracks[agent_idx].extent_or_nominal().length_m / 2.0;
    let place = scene.state(agent_idx, scene.current_timestep()).and_then(|now| own.lane.project(now.position));
    let ends = own.lane.ids().iter().filter_map(|id| lanes.get(*id)).map(|lane| lane.lane);
    let ends = ends.filter(|lane| lane.attributes.duties().any(|(_, duty)| duty != LaneDuty::HasRightOfWay));
    let ahead_m = |end: Vec2| Some(own.lane.project(end)?.station_m - place?.station_m - front_m);
    let lines = ends.filter_map(|lane| ahead_m(*lane.centerline.0.last()?));
    let mut reasons: Vec<Reason> = lines.filter(|m| (0.0..REACH_M).contains(m)).map(Reason::Line).collect();
    let ahead = own.ahead(scene.current_timestep(), REACH_M).first().copied();
    let leader = ahead.and_then(|ahead| Some((ahead, Driver::new(scene, lanes, ahead.agent_idx)?)));
    if let Some((ahead, leader)) = leader.filter(|(_, leader)| !leader.rails.is_empty()) {
        reasons.extend(LEADER_MPS2.map(|mps2| {
            let pace = Pace::steady(leader.braking_mps2().min(0.0)).then((from_s - REACTION_S).max(0.0), -mps2);
            let driven_m = leader.travel(0, &pace).driven_m;
            let positions = leader.positions(0, &driven_m);
            Reason::Leader { gap_m: ahead.gap_m, driven_m, agent_idx: ahead.agent_idx, positions }
        }));
    }
    reasons
}

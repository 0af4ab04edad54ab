//! Cut-out: does the vehicle ahead leave the lane and reveal one that stands or is much slower?

use super::following::{Ahead, Follower};
use super::lane_relation::SceneLanes;
use super::maneuver::Maneuver;
use super::{Behavior, BehaviorEvent, EventLabel};
use crate::geometry::{Vec2, angle_difference};
use crate::scene::Scene;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::f64::consts::FRAC_PI_6;

/// Name of the behavior in configs and tables.
pub(super) const ID: &str = "cut_out";
/// The follower, the revealed vehicle, and the one that leaves from between them.
pub(super) const ROLES: &[&str] = &["ego", "revealed", "leader"];
/// Names of the parameters of its events, defined at [`CutOut`].
pub(super) const PARAMETERS: &[&str] =
    &["ttc_s", "gap_m", "relative_speed_mps", "ego_speed_mps", "revealed_speed_mps", "side"];

/// How long the leader must stay out of the lane, seconds.
const SETTLING_S: f64 = 1.0;
/// The revealed vehicle drives at most at this share of the ego's speed, and the leader faster.
const SLOW_SHARE: f64 = 0.5;
/// The leader is at most this far ahead of the ego at present, as a time headway, seconds: one farther ahead hides
/// nothing.
const MAX_HEADWAY_S: f64 = 4.0;
/// Until it is out of the lane, the leader heads along it within this, radians: one that turns off surprises nobody.
const ALONG_RAD: f64 = FRAC_PI_6;
/// The ego drives at least this fast at the reveal, m/s.
const MIN_SPEED_MPS: f64 = 4.0;

/// The vehicle (`leader`) that another (`ego`) follows leaves the lane and reveals one (`revealed`) that stands or is
/// much slower.
///
/// The lane of the ego is the one it is in at present, with those that lead to it and follow on. The future is every
/// timestep after the present.
///
/// **Positive**: all of
///
/// - At present the leader is the nearest vehicle ahead in the lane of the ego, within a time headway of 4 s, and the
///   revealed one is the next beyond it. Both are in the ego's way: the boxes overlap across the lane by at least half
///   the width of the narrower one.
/// - In the future the leader's center leaves the lane (by more than 0.3 m beyond a side), and stays out for a second
///   or to the end of the scene. It heads along the lane until then (within 30 degrees).
/// - At that timestep, the *reveal*, the ego is still in the lane, and the revealed vehicle is the nearest ahead of it.
///   The ego drives at least 4 m/s, the revealed one at most half as fast along the lane, the leader faster than that,
///   and at these speeds ego and revealed vehicle touch in less than 4 s.
///
/// The event *starts* when the leader's box begins to reach over the side of the lane for good, and is *complete* at
/// the reveal. UN Regulation No. 157 (annex 3) knows the cut-out as one of three scenarios that a system must master,
/// with the time to collision at the reveal and a standing vehicle.
///
/// *What does not count*: leaders that turn off, or that are slow themselves (the ego has to brake for them anyway);
/// vehicles that come into the lane after the present; agents that are in no lane at present.
///
/// **Negative**: a leader that leaves the lane in the same way, but the next one ahead is too fast or too far away, or
/// the leader is too slow.
///
/// Parameters, all at the reveal: `ttc_s` (gap per relative speed; absent where they do not close in), `gap_m` (from
/// the ego's front to the revealed vehicle, along the lane), `relative_speed_mps` (positive when closing),
/// `ego_speed_mps` and `revealed_speed_mps` (along the lane), `side` (to which the leader leaves: +1 left, -1 right).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct CutOut {
    /// The ego must be on course to reach the revealed vehicle in less than this, seconds. Default 4.
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 100.0))]
    pub max_ttc_s: f64,
}

impl Default for CutOut {
    fn default() -> Self {
        Self { max_ttc_s: 4.0 }
    }
}

/// The timestep at which the leader is out of the lane.
struct Reveal {
    timestep: usize,
    side: f64,
    leader_mps: f64,
}

impl CutOut {
    /// The vehicle that the ego follows at present, and the next one beyond it.
    pub(super) fn queue(&self, ego: &Follower<'_>, present: usize) -> Option<[Ahead; 2]> {
        let speed_mps = ego.speed_mps(present);
        if speed_mps < MIN_SPEED_MPS {
            return None;
        }
        // To be reached in time at the reveal, it can be at most this far away now, plus the distance that the ego
        // drives until then.
        match ego.ahead(present, (MAX_HEADWAY_S + self.max_ttc_s) * speed_mps)[..] {
            [leader, revealed, ..] if leader.gap_m <= MAX_HEADWAY_S * speed_mps => Some([leader, revealed]),
            _ => None,
        }
    }

    /// Whether a vehicle at this speed is slow compared with an ego at that speed.
    pub(super) fn is_slow(speed_mps: f64, ego_mps: f64) -> bool {
        speed_mps <= SLOW_SHARE * ego_mps
    }

    /// Whether the ego reaches a vehicle at this gap in time.
    pub(super) fn is_reached(&self, revealed: &Ahead) -> bool {
        let closing_mps = revealed.own_mps - revealed.their_mps;
        revealed.own_mps >= MIN_SPEED_MPS
            && Self::is_slow(revealed.their_mps, revealed.own_mps)
            && revealed.gap_m > 0.0
            && revealed.gap_m < self.max_ttc_s * closing_mps
    }

    fn reveal(&self, scene: &Scene, ego: &Follower<'_>, leader_idx: usize) -> Option<Reveal> {
        let lane = &ego.lane;
        let state = |t: usize| scene.state(leader_idx, t).filter(|state| state.is_finite());
        let is_out = |t: usize| state(t).is_some_and(|state| !lane.holds(state.position));
        let timestep = (scene.n_history..scene.n_timesteps).find(|t| is_out(*t))?;
        let is_along = |t: usize| {
            state(t).is_none_or(|state| {
                let heading_rad = lane.project(state.position).map_or(state.heading_rad, |place| place.heading_rad);
                angle_difference(state.heading_rad, heading_rad).abs() < ALONG_RAD
            })
        };
        let settled = scene.n_timesteps.min(timestep + (SETTLING_S / scene.dt_s).round() as usize);
        let stays_out = (timestep..settled).all(|t| state(t).is_none_or(|state| !lane.holds(state.position)));
        if !stays_out || !(scene.current_timestep()..=timestep).all(is_along) {
            return None;
        }
        let out = state(timestep)?;
        let place = lane.project(out.position)?;
        let side = if place.offset_m < 0.0 { -1.0 } else { 1.0 };
        Some(Reveal { timestep, side, leader_mps: out.velocity.dot(Vec2::from_angle(place.heading_rad)) })
    }

    /// The first timestep from which the leader's box reaches over the side of the lane without a break until the
    /// reveal.
    fn start(scene: &Scene, ego: &Follower<'_>, leader_idx: usize, reveal: &Reveal) -> usize {
        let half_width_m = scene.tracks[leader_idx].extent_or_nominal().width_m / 2.0;
        let reaches_over = |t: &usize| {
            let beyond_m = |position| ego.lane.beyond_m(position, reveal.side);
            let position = scene.state(leader_idx, *t).filter(|state| state.is_finite()).map(|state| state.position);
            position.and_then(beyond_m).is_some_and(|beyond_m| beyond_m > -half_width_m)
        };
        (0..=reveal.timestep).rev().take_while(reaches_over).last().unwrap_or(reveal.timestep)
    }

    fn event(&self, scene: &Scene, lanes: &SceneLanes<'_>, ego_idx: usize) -> Option<BehaviorEvent> {
        let ego = Follower::of(scene, lanes, ego_idx)?;
        let [leader, next] = self.queue(&ego, scene.current_timestep())?;
        let reveal = self.reveal(scene, &ego, leader.agent_idx)?;
        let reach_m = next.gap_m + ego.speed_mps(reveal.timestep) * self.max_ttc_s;
        let revealed = ego.ahead(reveal.timestep, reach_m).first().copied()?;
        if revealed.agent_idx != next.agent_idx {
            return None;
        }
        let is_sudden = self.is_reached(&revealed) && !Self::is_slow(reveal.leader_mps, revealed.own_mps);
        let label = if is_sudden { EventLabel::Positive } else { EventLabel::Negative };
        let relative_mps = revealed.own_mps - revealed.their_mps;
        let agents = [ego_idx, revealed.agent_idx, leader.agent_idx];
        let timesteps = Self::start(scene, &ego, leader.agent_idx, &reveal)..=reveal.timestep;
        let event = BehaviorEvent::new((ID, ROLES), scene, label, &agents, timesteps)
            .with("ttc_s", (relative_mps > 0.1 && revealed.gap_m > 0.0).then(|| revealed.gap_m / relative_mps))
            .with("gap_m", revealed.gap_m)
            .with("relative_speed_mps", relative_mps)
            .with("ego_speed_mps", revealed.own_mps)
            .with("revealed_speed_mps", revealed.their_mps)
            .with("side", reveal.side);
        Some(event)
    }
}

impl Behavior for CutOut {
    fn id(&self) -> &'static str {
        ID
    }

    fn completed(&self, scene: &Scene, [ego_idx, revealed_idx]: [usize; 2]) -> Option<Vec<usize>> {
        let lanes = SceneLanes::new(&scene.lanes);
        let ego = Follower::as_observed(scene, &lanes, ego_idx)?;
        let [leader, next] = self.queue(&ego, scene.current_timestep())?;
        (next.agent_idx == revealed_idx).then(|| vec![ego_idx, revealed_idx, leader.agent_idx])
    }

    fn template_parameters(&self) -> &'static [&'static str] {
        &["ttc_s", "gap_m", "relative_speed_mps", "side"]
    }

    fn maneuvers(&self, scene: &Scene, agents: &[usize]) -> Vec<Maneuver> {
        agents.try_into().map_or_else(|_| Vec::new(), |agents| self.reveals_by(scene, agents))
    }

    /// At most one event an ego, in the order of tracks.
    fn detect(&self, scene: &Scene) -> Vec<BehaviorEvent> {
        let lanes = SceneLanes::new(&scene.lanes);
        let may_follow = |idx: &usize| {
            let present = scene.state(*idx, scene.current_timestep()).filter(|state| state.is_finite());
            let is_fast = present.is_some_and(|state| state.speed_mps() >= MIN_SPEED_MPS);
            is_fast && scene.tracks[*idx].class.is_motorized()
        };
        let egos = (0..scene.tracks.len()).filter(may_follow);
        egos.filter_map(|ego_idx| self.event(scene, &lanes, ego_idx)).collect()
    }
}

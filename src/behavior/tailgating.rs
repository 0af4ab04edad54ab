//! Tailgating: does one vehicle drive too close behind another, fast and for some time?

use super::following::Follower;
use super::lane_relation::SceneLanes;
use super::maneuver::Maneuver;
use super::{Behavior, BehaviorEvent, EventLabel};
use crate::scene::Scene;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Name of the behavior in configs and tables.
pub(super) const ID: &str = "tailgating";
/// The vehicle that drives too close, and the one ahead of it.
pub(super) const ROLES: &[&str] = &["follower", "leader"];
/// Names of the parameters of its events, defined at [`Tailgating`].
pub(super) const PARAMETERS: &[&str] = &["time_headway_s", "mean_speed_mps", "duration_s"];

/// Headways that are too long by less than this, over the same duration, are a hard negative, seconds.
const NEGATIVE_MORE_S: f64 = 0.5;
/// Both drive at least this fast, m/s (29 km/h): slower is dense traffic.
const MIN_SPEED_MPS: f64 = 8.0;

/// One vehicle (`follower`) drives too close behind another (`leader`).
///
/// **Positive**: over at least 2 s without a break, all of
///
/// - The leader is the nearest vehicle ahead in the lane that the follower keeps (the one it is in at present, with
///   those that lead to it and follow on), and in its way: both centers are in the lane, with a hysteresis of 0.3 m,
///   and the boxes overlap across it by at least half the width of the narrower one.
/// - The time headway, that is the gap from the follower's front to the leader's rear along the lane by the follower's
///   speed, is below 0.9 s.
/// - Both drive along the lane with at least 8 m/s.
///
/// The event is the longest such stretch of a pair; what happens before and after the scene is not known. 0.9 s is half
/// of the distance that German drivers learn to keep ("half the speedometer"); below it they are fined (BKatV no. 12),
/// except for brief moments. Vogel (2003, Accident Analysis and Prevention 35) calls headways below 1 s dangerous, and
/// UN Regulation No. 157 requires 1.0 to 1.6 s at 2 to 17 m/s.
///
/// *What does not count*: queues and their ends, where one of the two is slow; short gaps after merging that open again
/// within 2 s; boxes that overlap; two vehicles that drive staggered in one lane; agents that are in no lane at
/// present.
///
/// **Negative**: any other pair with headways below 1.4 s by the same rules.
///
/// Parameters: `time_headway_s` and `mean_speed_mps` (means of the headway and of the follower's speed over the event),
/// `duration_s`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Tailgating {
    /// Time headways below this are too short, seconds. Default 0.9.
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 10.0))]
    pub max_headway_s: f64,
    /// How long this lasts without a break, from the first to the last timestep, seconds. Default 2.
    #[schemars(range(min = 0.0, max = 100.0))]
    pub min_duration_s: f64,
}

impl Default for Tailgating {
    fn default() -> Self {
        Self { max_headway_s: 0.9, min_duration_s: 2.0 }
    }
}

/// A timestep at which one vehicle follows another fast enough.
#[derive(Debug, Clone, Copy)]
pub(super) struct FollowingMoment {
    pub(super) timestep: usize,
    pub(super) gap_m: f64,
    pub(super) own_mps: f64,
}

impl FollowingMoment {
    pub(super) fn headway_s(&self) -> f64 {
        self.gap_m / self.own_mps
    }
}

/// The means over some moments of the headway, seconds, and of the follower's speed, m/s.
pub(super) fn means(moments: &[FollowingMoment]) -> (f64, f64) {
    let n = moments.len().max(1) as f64;
    (
        moments.iter().map(FollowingMoment::headway_s).sum::<f64>() / n,
        moments.iter().map(|m| m.own_mps).sum::<f64>() / n,
    )
}

impl Tailgating {
    /// The vehicles that the agent follows at `timesteps`.
    pub(super) fn moments(
        &self,
        follower: &Follower<'_>,
        timesteps: std::ops::Range<usize>,
    ) -> BTreeMap<usize, Vec<FollowingMoment>> {
        let mut by_leader: BTreeMap<usize, Vec<FollowingMoment>> = BTreeMap::new();
        for timestep in timesteps {
            let Some(nearest) = follower.ahead(timestep, self.reach_m(follower.speed_mps(timestep))).first().copied()
            else {
                continue;
            };
            if nearest.gap_m > 0.0 && nearest.own_mps.min(nearest.their_mps) >= MIN_SPEED_MPS {
                let moment = FollowingMoment { timestep, gap_m: nearest.gap_m, own_mps: nearest.own_mps };
                by_leader.entry(nearest.agent_idx).or_default().push(moment);
            }
        }
        by_leader
    }

    /// The longest stretch of timesteps without a break in which headways are below `limit_s`, if it is long enough.
    pub(super) fn longest(&self, moments: &[FollowingMoment], limit_s: f64, dt_s: f64) -> Option<Vec<FollowingMoment>> {
        let short: Vec<FollowingMoment> =
            moments.iter().copied().filter(|moment| moment.headway_s() < limit_s).collect();
        let runs = short.chunk_by(|a, b| b.timestep == a.timestep + 1);
        // The first among equally long ones.
        let longest = runs.rev().max_by_key(|run| run.len())?;
        let duration_s = (longest.len() - 1) as f64 * dt_s;
        (duration_s >= self.min_duration_s - 1e-9).then(|| longest.to_vec())
    }

    /// Headways below this are a hard negative, seconds.
    fn negative_headway_s(&self) -> f64 {
        self.max_headway_s + NEGATIVE_MORE_S
    }

    /// The gap beyond which a vehicle at this speed follows nobody, meters.
    fn reach_m(&self, speed_mps: f64) -> f64 {
        self.negative_headway_s() * speed_mps
    }

    /// Whether any agent is ever near enough ahead for this one to follow it; faster than a test by lanes.
    fn may_follow(&self, scene: &Scene, agent_idx: usize) -> bool {
        let length_m = |idx: usize| scene.tracks[idx].extent_or_nominal().length_m;
        let finite = |idx: usize, timestep: usize| scene.state(idx, timestep).filter(|state| state.is_finite());
        (0..scene.n_timesteps).any(|timestep| {
            let own = finite(agent_idx, timestep).filter(|own| own.speed_mps() >= MIN_SPEED_MPS);
            own.is_some_and(|own| {
                (0..scene.tracks.len()).filter(|other| *other != agent_idx).any(|other| {
                    let near_m = self.reach_m(own.speed_mps()) + length_m(agent_idx) + length_m(other);
                    finite(other, timestep).is_some_and(|theirs| theirs.position.distance(own.position) < near_m)
                })
            })
        })
    }

    fn events_of(&self, scene: &Scene, follower: &Follower<'_>, agent_idx: usize) -> Vec<BehaviorEvent> {
        let event = |(leader_idx, moments): (usize, Vec<FollowingMoment>)| {
            let run = |limit_s: f64| self.longest(&moments, limit_s, scene.dt_s);
            let positive = run(self.max_headway_s).map(|run| (EventLabel::Positive, run));
            let negative = || run(self.negative_headway_s()).map(|run| (EventLabel::Negative, run));
            let (label, run) = positive.or_else(negative)?;
            let (headway_s, speed_mps) = means(&run);
            let timesteps = run.first()?.timestep..=run.last()?.timestep;
            let duration_s = (timesteps.end() - timesteps.start()) as f64 * scene.dt_s;
            let event = BehaviorEvent::new((ID, ROLES), scene, label, &[agent_idx, leader_idx], timesteps)
                .with("time_headway_s", headway_s)
                .with("mean_speed_mps", speed_mps)
                .with("duration_s", duration_s);
            Some(event)
        };
        self.moments(follower, 0..scene.n_timesteps).into_iter().filter_map(event).collect()
    }
}

impl Behavior for Tailgating {
    fn id(&self) -> &'static str {
        ID
    }

    fn template_parameters(&self) -> &'static [&'static str] {
        &["time_headway_s", "mean_speed_mps"]
    }

    fn maneuvers(&self, scene: &Scene, agents: &[usize]) -> Vec<Maneuver> {
        agents.try_into().map_or_else(|_| Vec::new(), |agents| self.approaches(scene, agents))
    }

    /// At most one event an ordered pair, in the order of the tracks of followers, then of leaders.
    fn detect(&self, scene: &Scene) -> Vec<BehaviorEvent> {
        let lanes = SceneLanes::new(&scene.lanes);
        let drives = |idx: &usize| scene.tracks[*idx].class.is_motorized() && self.may_follow(scene, *idx);
        let followers = (0..scene.tracks.len()).filter(drives);
        let with_lane = |idx: usize| Some((Follower::of(scene, &lanes, idx)?, idx));
        followers.filter_map(with_lane).flat_map(|(follower, idx)| self.events_of(scene, &follower, idx)).collect()
    }
}

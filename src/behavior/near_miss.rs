//! Near miss: do two road users come dangerously close without touching?

use super::driven_path::DrivenPath;
use super::pairs::unordered;
use super::sweep::Sweep;
use super::time_to_collision::time_to_collision_s;
use super::{AgentFilter, Behavior, BehaviorEvent, EventLabel, Outcome};
use crate::geometry::{OrientedBox, angle_difference};
use crate::scene::{AgentClass, Extent, Scene, Track};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use std::f64::consts::FRAC_PI_6;
use std::ops::RangeInclusive;

/// Name of the behavior in configs and tables.
pub(super) const ID: &str = "near_miss";
/// The two road users, in the order of tracks.
pub(super) const ROLES: &[&str] = &["first", "second"];
/// What events say beyond their times; [`NearMiss`] has the definitions.
pub(super) const PARAMETERS: &[&str] = &[
    "min_distance_m",
    "min_ttc_s",
    "pet_s",
    "relative_speed_mps",
    "first_speed_mps",
    "second_speed_mps",
    "heading_difference_rad",
];

/// Times to collision beyond this say nothing: nobody keeps course and speed for so long, seconds.
const MAX_TTC_S: f64 = 10.0;
/// Steps in which agents are moved on along their paths, seconds.
const PATH_STEP_S: f64 = 0.1;
/// Who is where the other was, heading within this of it, follows it, radians.
pub(super) const FOLLOWING_RAD: f64 = FRAC_PI_6;

/// Options of [`NearMiss`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct NearMissConfig {
    /// Road users that take part. Default `road_users`: includes pedestrians, excludes static objects.
    pub agents: AgentFilter,
    /// Boxes that pass each other closer than this are a near miss, meters. Default 0.3: mirrors touch; in dense traffic 1 m is usual.
    /// Not of road users whose size the recording does not give.
    #[schemars(range(min = 0.0))]
    pub max_distance_m: f64,
    /// Whoever passes so closely differs in velocity by at least this, m/s. Default 3: driving side by side is no passing.
    #[schemars(range(min = 0.0))]
    pub min_passing_mps: f64,
    /// Boxes on a course to touch in less than this are a near miss, seconds. Default 1.5.
    #[schemars(range(min = 0.0, max = 100.0))]
    pub max_ttc_s: f64,
    /// So hard must one of the two brake on that course to avoid it, m/s². Default 3.4: less is how people stop behind each other.
    #[schemars(range(min = 0.0))]
    pub min_drac_mps2: f64,
    /// Being where the other was less than this before, on another course, is a near miss, seconds. Default 1.
    #[schemars(range(min = 0.0, max = 100.0))]
    pub max_pet_s: f64,
    /// Boxes that come closer than this without a near miss are a hard negative, meters. Default 2.
    #[schemars(range(min = 0.0))]
    pub negative_distance_m: f64,
    /// Boxes on a course to touch in less than this without a near miss are a hard negative, seconds. Default 3.
    #[schemars(range(min = 0.0, max = 100.0))]
    pub negative_ttc_s: f64,
    /// One of the two must move at least this fast, m/s. Default 1.
    #[schemars(range(min = 0.0))]
    pub min_speed_mps: f64,
}

impl Default for NearMissConfig {
    fn default() -> Self {
        Self {
            agents: AgentFilter::RoadUsers,
            max_distance_m: 0.3,
            min_passing_mps: 3.0,
            max_ttc_s: 1.5,
            min_drac_mps2: 3.4,
            max_pet_s: 1.0,
            negative_distance_m: 2.0,
            negative_ttc_s: 3.0,
            min_speed_mps: 1.0,
        }
    }
}

impl NearMissConfig {
    /// Whether a collision in `time_s` is soon, and hard to avoid for road users with this relative speed.
    pub(super) fn is_urgent(&self, time_s: f64, relative_mps: f64) -> bool {
        time_s < self.max_ttc_s && relative_mps >= 2.0 * time_s * self.min_drac_mps2
    }
}

/// Two road users (`first` and `second`) barely avoid each other.
///
/// **Positive**: at some timestep of the scene, any of
///
/// - The boxes would touch in less than 1.5 s if both kept their velocities and headings, and also if both went on at these speeds along the
///   paths that they drive: who waits beside a bend is in nobody's way. To avoid it takes a deceleration of at least 3.4 m/s² (DRAC: their relative
///   speed by twice that time), and both are tracked until then: what comes after the last state is not known. At least one of the two moves with
///   1 m/s or more.
/// - One is where the other was less than 1 s before, on courses that differ by at least 30 degrees, both with 1 m/s or more.
/// - The boxes are less than 0.3 m apart, their velocities differ by at least 3 m/s, and the sizes of both are recorded.
///
/// The event *starts* at the first such timestep and is *complete* at the last one, with or without breaks between.
///
/// *What does not count*: pairs whose boxes overlap at any timestep, which collide; two that stand; static objects; following and driving side
/// by side, however long; stopping in good time, however near. Agents whose size is not recorded count with half the length and width that are
/// usual for them.
///
/// **Negative**: boxes that come closer than 2 m, or whose time to collision in the first sense is less than 3 s, where nothing meets the
/// stricter limits.
///
/// Parameters over the whole scene: `min_distance_m`, `min_ttc_s` (absent where the courses do not meet within 10 s), `pet_s` (post-encroachment
/// time: the least time between the two being on the same place; absent where they never are). At the closest timestep:
/// `relative_speed_mps`, `first_speed_mps`, `second_speed_mps`, `heading_difference_rad` (0 to π: following, crossing, oncoming).
#[derive(Debug, Clone, PartialEq, Default)]
pub struct NearMiss {
    config: NearMissConfig,
}

/// One timestep at which two agents are close by the wider limits.
struct Encounter {
    timestep: usize,
    distance_m: f64,
    relative_mps: f64,
    ttc_s: Option<f64>,
    /// The time to collision, or that along the paths where it is longer. `None` where either is too long for any limit.
    conflict_s: Option<f64>,
}

impl NearMiss {
    /// The behavior with these options.
    pub const fn new(config: NearMissConfig) -> Self {
        Self { config }
    }

    /// Its options.
    pub(super) const fn config(&self) -> &NearMissConfig {
        &self.config
    }

    fn detect_pair(
        &self,
        scene: &Scene,
        pair: [usize; 2],
        [first, second]: [&Sweep; 2],
        are_sized: bool,
    ) -> Option<BehaviorEvent> {
        let encounters = self.encounters(scene, pair, [first, second])?;
        let config = &self.config;
        let span = |is_meant: &dyn Fn(&Encounter) -> bool| {
            let mut hits = encounters.iter().filter(|e| is_meant(e)).map(|e| e.timestep);
            let start = hits.next()?;
            Some(start..=hits.next_back().unwrap_or(start))
        };
        let passes = |e: &Encounter| {
            are_sized && e.distance_m < config.max_distance_m && e.relative_mps >= config.min_passing_mps
        };
        let last =
            |agent_idx: usize| scene.tracks[agent_idx].trajectory.valid().next_back().map(|(timestep, _)| timestep);
        let known_s = last(pair[0])?.min(last(pair[1])?) as f64 * scene.dt_s;
        let escapes = |e: &Encounter| {
            e.conflict_s.is_some_and(|time_s| {
                e.timestep as f64 * scene.dt_s + time_s <= known_s && config.is_urgent(time_s, e.relative_mps)
            })
        };
        let close = span(&|e| passes(e) || escapes(e));
        let crossing = self.crossing(scene, pair, [first, second]);
        let both = close.clone().zip(crossing.clone());
        let joined = both.map(|(a, b)| *a.start().min(b.start())..=*a.end().max(b.end()));
        let positive = joined.or(close).or(crossing).map(|span| (EventLabel::Positive, span));
        let is_near = |e: &Encounter| {
            e.distance_m < config.negative_distance_m
                || e.conflict_s.is_some_and(|time_s| time_s < config.negative_ttc_s)
        };
        let negative = || span(&is_near).map(|span| (EventLabel::Negative, span));
        let (label, timesteps) = positive.or_else(negative)?;
        let (min_distance_m, closest) = first.min_distance_m(second, 0..scene.n_timesteps)?;
        let state = |agent_idx: usize| scene.state(agent_idx, closest).copied().unwrap_or_default();
        let [one, other] = pair.map(state);
        let event = BehaviorEvent::new((ID, ROLES), scene, label, &pair, timesteps)
            .with("min_distance_m", min_distance_m)
            .with("min_ttc_s", encounters.iter().filter_map(|e| e.ttc_s).reduce(f64::min))
            .with("pet_s", post_encroachment_s(scene, first, second))
            .with("relative_speed_mps", (one.velocity - other.velocity).norm())
            .with("first_speed_mps", one.speed_mps())
            .with("second_speed_mps", other.speed_mps())
            .with("heading_difference_rad", angle_difference(one.heading_rad, other.heading_rad).abs());
        Some(event)
    }

    /// The timesteps at which the pair could meet the wider limits. `None` when the boxes ever overlap.
    fn encounters(&self, scene: &Scene, pair: [usize; 2], [first, second]: [&Sweep; 2]) -> Option<Vec<Encounter>> {
        let config = &self.config;
        let wide_distance_m = config.max_distance_m.max(config.negative_distance_m);
        let wide_ttc_s = config.max_ttc_s.max(config.negative_ttc_s);
        let mut encounters = Vec::new();
        for (timestep, one, other) in first.both_at(second, 0..scene.n_timesteps) {
            let (Some(a), Some(b)) = (scene.state(pair[0], timestep), scene.state(pair[1], timestep)) else { continue };
            let relative_mps = (a.velocity - b.velocity).norm();
            if one.distance_lower_bound_m(other) > wide_distance_m.max(relative_mps * wide_ttc_s) {
                continue;
            }
            if one.overlaps(other) {
                return None;
            }
            if a.speed_mps().max(b.speed_mps()) >= config.min_speed_mps {
                let ttc_s = time_to_collision_s(one, a.velocity, other, b.velocity).filter(|ttc| *ttc <= MAX_TTC_S);
                let conflict_s = ttc_s
                    .filter(|ttc_s| *ttc_s < wide_ttc_s)
                    .and_then(|ttc_s| Some(ttc_s.max(time_along_paths_s(scene, pair, timestep, wide_ttc_s)?)));
                let distance_m = one.distance_m(other);
                encounters.push(Encounter { timestep, distance_m, relative_mps, ttc_s, conflict_s });
            }
        }
        Some(encounters)
    }

    /// The timesteps at which one leaves and the other reaches a place that both cover within the longest time, on different courses.
    fn crossing(&self, scene: &Scene, pair: [usize; 2], [first, second]: [&Sweep; 2]) -> Option<RangeInclusive<usize>> {
        if !first.may_come_within(second, 0.0) {
            return None;
        }
        let moves = |agent_idx: usize, timestep: usize| {
            scene.state(agent_idx, timestep).is_some_and(|state| state.speed_mps() >= self.config.min_speed_mps)
        };
        let crosses = |[a, b]: [usize; 2], [one, other]: [&Sweep; 2], t: usize, u: usize| {
            one.at(t).zip(other.at(u)).is_some_and(|(one, other)| {
                one.overlaps(other)
                    && one.forward.dot(other.forward) < FOLLOWING_RAD.cos()
                    && moves(a, t)
                    && moves(b, u)
            })
        };
        // Delays that are a whole number of timesteps but for rounding are excluded.
        let max_delay = (self.config.max_pet_s / scene.dt_s - 1e-6).floor().max(0.0) as usize;
        let found = |t: usize, u: usize| {
            crosses(pair, [first, second], t, u) || crosses([pair[1], pair[0]], [second, first], t, u)
        };
        let timesteps = 0..scene.n_timesteps;
        (0..=max_delay).find_map(|delay| timesteps.clone().find(|t| found(*t, t + delay)).map(|t| t..=t + delay))
    }

    /// Farther apart than this, over the whole scene, no two agents have an encounter.
    fn reach_m(&self, scene: &Scene) -> f64 {
        let config = &self.config;
        let states = scene.tracks.iter().flat_map(|track| track.trajectory.valid());
        let max_speed_mps = states.map(|(_, state)| state.speed_mps()).filter(|v| v.is_finite()).fold(0.0, f64::max);
        let wide_ttc_s = config.max_ttc_s.max(config.negative_ttc_s);
        config.max_distance_m.max(config.negative_distance_m).max(2.0 * max_speed_mps * wide_ttc_s)
    }
}

impl Behavior for NearMiss {
    fn id(&self) -> &'static str {
        ID
    }

    fn roles(&self) -> &'static [&'static str] {
        ROLES
    }

    fn admits(&self, class: AgentClass) -> bool {
        self.config.agents.admits(class)
    }

    fn feasible(&self, scene: &Scene, agents: &[usize]) -> Vec<Outcome> {
        match agents {
            [first, second] => self.outcomes(scene, [*first, *second]),
            _ => Vec::new(),
        }
    }

    /// At most one event a pair, in the order of tracks.
    fn detect(&self, scene: &Scene) -> Vec<BehaviorEvent> {
        let reach_m = self.reach_m(scene);
        let is_sized = |agent_idx: usize| scene.tracks[agent_idx].extent.is_some();
        let cores = with_cores(scene);
        unordered(&cores, self.config.agents, reach_m, |pair, sweeps| {
            self.detect_pair(&cores, pair, sweeps, pair.iter().all(|agent_idx| is_sized(*agent_idx)))
        })
    }
}

/// The scene with agents whose size is not recorded at half their nominal one: whole boxes touch where nobody does.
pub(super) fn with_cores(scene: &Scene) -> Cow<'_, Scene> {
    if scene.tracks.iter().all(|track| track.extent.is_some()) {
        return Cow::Borrowed(scene);
    }
    let core = |track: &Track| {
        let Extent { length_m, width_m } = track.extent_or_nominal();
        let half = Extent { length_m: length_m / 2.0, width_m: width_m / 2.0 };
        Track { extent: track.extent.or(Some(half)), ..track.clone() }
    };
    Cow::Owned(Scene { tracks: scene.tracks.iter().map(core).collect(), ..scene.clone() })
}

/// When the boxes first touch if both go on along the paths that they drive, at their speeds of `timestep`, seconds; `None` where they do not
/// within `limit_s`.
fn time_along_paths_s(scene: &Scene, pair: [usize; 2], timestep: usize, limit_s: f64) -> Option<f64> {
    let [one, other] = pair.map(|agent_idx| {
        let track = &scene.tracks[agent_idx];
        let speed_mps = track.trajectory.get(timestep)?.speed_mps();
        Some((track.extent_or_nominal(), speed_mps, DrivenPath::from(track, timestep)?))
    });
    let (one, other) = (one?, other?);
    let body = |(extent, speed_mps, path): &(Extent, f64, DrivenPath), time_s: f64| {
        let (center, heading_rad) = path.pose_at(speed_mps * time_s);
        OrientedBox { center, heading_rad, length_m: extent.length_m, width_m: extent.width_m }
    };
    let times_s = (0..=(limit_s / PATH_STEP_S).floor() as usize).map(|step| step as f64 * PATH_STEP_S);
    times_s.into_iter().find(|time_s| body(&one, *time_s).overlaps(&body(&other, *time_s)))
}

/// The least time between the two agents covering the same place, seconds. `None` where they never do.
fn post_encroachment_s(scene: &Scene, first: &Sweep, second: &Sweep) -> Option<f64> {
    let timesteps = 0..scene.n_timesteps;
    if !first.may_come_within(second, 0.0) {
        return None;
    }
    let meets = |one: &Sweep, other: &Sweep, delay: usize| {
        timesteps.clone().any(|t| one.at(t).zip(other.at(t + delay)).is_some_and(|(a, b)| a.overlaps(b)))
    };
    let delay = timesteps.clone().find(|delay| meets(first, second, *delay) || meets(second, first, *delay))?;
    Some(delay as f64 * scene.dt_s)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::behavior::testing::SceneSpec;

    fn events(second: &str) -> [Vec<EventLabel>; 2] {
        let spec: Result<SceneSpec, _> = toml::from_str(&format!(
            "agents = [{{ id = \"a\", start = {{ x_m = 0, y_m = 0, speed_mps = 10 }} }}, {{ id = \"b\", {second} }}]"
        ));
        let sized = spec.expect("valid").build("near");
        let mut unsized_ = sized.clone();
        unsized_.tracks.iter_mut().for_each(|track| track.extent = None);
        [sized, unsized_].map(|scene| NearMiss::default().detect(&scene).iter().map(|event| event.label).collect())
    }

    #[test]
    fn whose_size_is_not_recorded_is_no_near_miss_in_passing() {
        // A car that stands 0.2 m beside the way of the other.
        let parked = events("start = { x_m = 20, y_m = 2.0, speed_mps = 0 }");
        assert_eq!(parked, [[EventLabel::Positive], [EventLabel::Negative]]);
        // Crossing half a second behind each other is, whatever the size.
        let crossing = events("start = { x_m = 20, y_m = -28, heading_deg = 90, speed_mps = 10 }");
        assert_eq!(crossing, [[EventLabel::Positive], [EventLabel::Positive]]);
    }

    #[test]
    fn what_would_come_after_the_last_state_is_not_known() {
        // At the end of the scene, after 3.9 s, the first is at 39 m, 7.5 m or 0.75 s from one who stands there.
        let at_the_end = events("start = { x_m = 51, y_m = 0, speed_mps = 0 }");
        assert_eq!(at_the_end[0], [EventLabel::Negative]);
    }
}
